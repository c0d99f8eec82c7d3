#!/usr/bin/env bash
# Tries every format with readers that are not ours, those that are installed.
#
# usage: scripts/check-formats.sh READERS [SONG [BAILANDO [OPTIONS..]]]
#
# READERS is a folder outside the repository with what was installed there, all of it optional:
#   npm install --prefix READERS three @pixiv/three-vrm @pixiv/three-vrm-animation gltf-validator \
#       mmd-parser assimpjs @babylonjs/core @babylonjs/loaders
#   python3 -m venv READERS/venv
#   READERS/venv/bin/pip install numpy bvhio bvhtoolbox bvhsdk pybvh
#   apt-get install godot3-server     # Debian 12; no folder
#   python3 -m venv READERS/blender && READERS/blender/bin/pip install bpy   # 350 MB
set -euo pipefail

readers=$(realpath "${1:?usage: $0 READERS [SONG [BAILANDO [OPTIONS..]]]}")
song=${2:-tests/fixtures/audio/demo.mp3}
bailando=${3:-target/release/bailando}
shift $(($# < 3 ? $# : 3))
here=$(dirname "$(realpath "$0")")/../tests/readers
dances=$(mktemp -d)
trap 'rm -rf "$dances"' EXIT

make_dance() {
    "$bailando" generate "$song" -o "$dances/$1" --seed 1 "${@:2}" > "$dances/log" 2>&1 ||
        { cat "$dances/log"; exit 1; }
}
make_dance dance.json --include-rotations "$@"
for skeleton in smpl mixamo vrm unreal; do
    for format in bvh glb fbx; do
        make_dance "$skeleton.$format" --skeleton "$skeleton" "$@"
    done
done
for format in vrma vmd npz; do
    make_dance "dance.$format" "$@"
done
(cd "$dances" && wc -c -- *.* | sort -n)

# Godot samples curves while it imports: at 60 a second, as the dance has it.
if command -v godot3-server > /dev/null; then
    mkdir "$dances/godot"
    cp "$dances/smpl.glb" "$dances/godot/dance.glb"
    cp "$here/godot.gd" "$dances/godot/"
    printf 'config_version=4\n' > "$dances/godot/project.godot"
    printf '[remap]\nimporter="scene"\ntype="PackedScene"\n[params]\n%s\n%s\n' \
        animation/fps=60 animation/optimizer/enabled=false > "$dances/godot/dance.glb.import"
    # The editor imports and does not always end.
    timeout 100 godot3-server --path "$dances/godot" --editor --quit > "$dances/godot/log" 2>&1 || true
    timeout 100 godot3-server --path "$dances/godot" --script godot.gd >> "$dances/godot/log" 2>&1 || true
fi

status=0
if [ -d "$readers/node_modules" ] && command -v node > /dev/null; then
    node "$here/read.mjs" "$dances" "$readers/node_modules" || status=1
fi
for python in "$readers"/*/bin/python; do
    [ -x "$python" ] || continue
    PYTHONDONTWRITEBYTECODE=1 PYTHONPATH="$here" "$python" "$here/read.py" "$dances" || status=1
done
exit $status
