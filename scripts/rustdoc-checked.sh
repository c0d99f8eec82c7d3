#!/usr/bin/env bash
# Stands in for rustdoc while `cargo test` runs the examples of a library: first it renders the
# library's documentation, in which a warning is an error. `cargo doc` would do that too, but only
# after a second pass over all dependencies.
#
# Usage: RUSTDOC=$PWD/scripts/rustdoc-checked.sh cargo test --doc
set -euo pipefail

arguments=()
is_test=false
skip=false
for argument in "$@"; do
    if [ "$skip" = true ]; then
        skip=false
        continue
    fi
    case "$argument" in
    --test) is_test=true ;;
    --test-args | --test-run-directory) skip=true ;;
    *) arguments+=("$argument") ;;
    esac
done

if [ "$is_test" = true ]; then
    rustdoc "${arguments[@]}" -D warnings --out-dir "${CARGO_TARGET_DIR:-target}/doc-checked"
fi
exec rustdoc "$@"
