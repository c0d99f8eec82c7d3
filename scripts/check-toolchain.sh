#!/bin/sh
# Says what to install before cargo fails in a way that only Rust programmers can read.
# Usage: scripts/check-toolchain.sh [COMPONENT ..]   (cargo subcommands such as fmt, clippy)
set -eu

fail() {
    printf '%s\n' "$1" >&2
    exit 1
}

install_rust="  Install Rust with rustup: https://rustup.rs
  or, where rustup is already there: rustup update stable"

command -v cargo >/dev/null 2>&1 || fail "cargo was not found.
$install_rust
  and open a new shell (or run: . \"\$HOME/.cargo/env\")"
command -v rustc >/dev/null 2>&1 || fail "rustc was not found.
$install_rust"

needed=$(sed -n 's/^rust-version = "\([0-9.]*\)".*/\1/p' "$(dirname "$0")/../Cargo.toml")
found=$(rustc --version | cut -d ' ' -f 2)
major_minor() {
    echo "$1" | awk -F '[.-]' '{ print $1 * 1000 + $2 }'
}
[ "$(major_minor "$found")" -ge "$(major_minor "$needed")" ] ||
    fail "Rust $needed or newer is needed, found $found.
$install_rust"

command -v cc >/dev/null 2>&1 || fail "no linker ('cc') was found.
  Debian, Ubuntu: sudo apt-get install gcc libc6-dev
  Fedora:         sudo dnf install gcc
  macOS:          xcode-select --install"

for component in "$@"; do
    cargo "$component" --version >/dev/null 2>&1 || fail "'cargo $component' is missing.
  Install it: rustup component add rustfmt clippy"
done
