#!/usr/bin/env bash
# Packs the service for people without a compiler, into target/package/:
#   bailando-VERSION-linux-MACHINE.tar.gz   program, ONNX Runtime, default model: runs from any folder
#   bailando-VERSION-*.whl                  the same for pip; ONNX Runtime comes from its own wheel
#
# Usage: scripts/package.sh [--try SONG]
#   --try SONG   then installs both in empty environments and lets each dance to SONG
# Needs a Rust toolchain, and python3 (3.11 or newer) with pip and venv.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

out=$PWD/target/package
version=$(sed -n 's/^version = "\(.*\)"$/\1/p' Cargo.toml | sed -n 1p)
name=bailando-$version-$(uname -s | tr '[:upper:]' '[:lower:]')-$(uname -m)

fail() {
    printf 'package: %s\n' "$1" >&2
    exit 1
}

versions_agree() {
    local pinned wanted
    pinned=$(sed -n 's/^version=//p' scripts/fetch-onnxruntime.sh)
    wanted=$(sed -n 's/^dependencies = \["onnxruntime==\(.*\)"\]$/\1/p' pyproject.toml)
    [ "$pinned" = "$wanted" ] ||
        fail "scripts/fetch-onnxruntime.sh pins ONNX Runtime $pinned, pyproject.toml $wanted."
}

# Readable by all, whatever the umask of the checkout.
copy_model() {
    mkdir -p "$1/models/beats"
    cp -R models/default "$1/models/"
    # The beat network itself is part of the program.
    cp models/beats/LICENCE.md models/beats/manifest.json "$1/models/beats/"
    chmod -R a+rX "$1"
}

make_archive() {
    cargo build --release --locked --bin bailando
    scripts/fetch-onnxruntime.sh
    rm -rf "${out:?}/$name"
    mkdir -p "$out/$name"
    cp "${CARGO_TARGET_DIR:-target}/release/bailando" .onnxruntime/lib/libonnxruntime.* LICENSE \
        README.md "$out/$name/"
    cp .onnxruntime/LICENSE "$out/$name/LICENSE.onnxruntime"
    cp .onnxruntime/ThirdPartyNotices.txt "$out/$name/"
    copy_model "$out/$name"
    tar -C "$out" --owner=0 --group=0 -czf "$out/$name.tar.gz" "$name"
    rm -rf "${out:?}/$name"
}

make_wheel() {
    rm -rf "$out/data"
    # `data` of a wheel goes to the environment's own folder.
    copy_model "$out/data/data/share/bailando"
    [ -x "$out/tools/bin/maturin" ] || {
        python3 -m venv "$out/tools"
        "$out/tools/bin/pip" install --quiet --disable-pip-version-check 'maturin>=1.9,<2'
    }
    rm -f "$out"/bailando-*.whl
    "$out/tools/bin/maturin" build --release --out "$out"
}

try_archive() {
    local folder song=$1
    folder=$(mktemp -d)
    tar -C "$folder" -xzf "$out/$name.tar.gz"
    (cd / && env -i "$folder/$name/bailando" generate "$song" -o "$folder/dance.bvh")
    grep -q '^HIERARCHY' "$folder/dance.bvh" || fail "the archive's program made no BVH."
    rm -rf "$folder"
}

try_wheel() {
    local folder song=$1
    folder=$(mktemp -d)
    python3 -m venv "$folder/venv"
    "$folder/venv/bin/pip" install --quiet --disable-pip-version-check "$out"/bailando-*.whl
    (cd / && env -i "$folder/venv/bin/bailando" generate "$song" -o "$folder/dance.bvh")
    grep -q '^HIERARCHY' "$folder/dance.bvh" || fail "the wheel's program made no BVH."
    rm -rf "$folder"
}

song=
case "${1:-}" in
--try)
    [ -f "${2:-}" ] || fail "--try needs a song."
    song=$(realpath "$2")
    ;;
'') ;;
*) fail "unknown option '$1'." ;;
esac
versions_agree
mkdir -p "$out"
make_archive
make_wheel
[ -z "$song" ] || { try_archive "$song" && try_wheel "$song"; }
ls -l "$out"/bailando-*
