#!/bin/sh
# Runs fuzz targets one after another, from the seeds in fuzz/corpus/ and from the findings of earlier
# runs (fuzz/grown/, which git ignores).
#
# Usage: scripts/fuzz.sh SECONDS [TARGET ..]   (no target: all of them)
# An input that breaks a target is written to fuzz/artifacts/TARGET/ and ends the run.
set -eu
cd "$(dirname "$0")/.."

fail() {
    printf '%s\n' "$1" >&2
    exit 1
}

[ $# -gt 0 ] || fail "usage: scripts/fuzz.sh SECONDS [TARGET ..]"
seconds=$1
shift
[ $# -gt 0 ] || set -- container options manifest graph checkpoint rig

cargo +nightly --version >/dev/null 2>&1 || fail "fuzzing needs a nightly compiler.
  Install it: rustup toolchain install nightly --profile minimal
  Without one, 'make test' runs the seeds and mutations of them."
cargo +nightly fuzz --version >/dev/null 2>&1 || fail "cargo-fuzz is missing.
  Install it: cargo install cargo-fuzz --locked"

# Fuzz the dependencies that are shipped, not newer ones.
[ fuzz/Cargo.lock -nt Cargo.lock ] || cp Cargo.lock fuzz/Cargo.lock

for target in "$@"; do
    mkdir -p "fuzz/grown/$target"
    printf '%s, %s s\n' "$target" "$seconds"
    # Without cargo-fuzz's own checks: fuzz/Cargo.toml says what is checked.
    cargo +nightly fuzz run -O "$target" "fuzz/grown/$target" "fuzz/corpus/$target" -- \
        -max_total_time="$seconds" -max_len=16384 -timeout=10 \
        -rss_limit_mb=1024 -malloc_limit_mb=256 -print_final_stats=1
done
