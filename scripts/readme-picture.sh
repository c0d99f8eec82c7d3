#!/bin/sh
# Makes docs/dance.gif, the picture that the README opens with: five seconds of the default model's
# dance to a song, drawn by the viewer. Needs Chromium, ffmpeg and a built bailando (BAILANDO).
# The committed picture is of a dance to "Torus Trooper, tt1" by Kenta Cho.
#
# Usage: scripts/readme-picture.sh SONG [OUT.gif]
set -eu
song=${1:?name a song}
out=${2:-docs/dance.gif}
bailando=${BAILANDO:-target/release/bailando}
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"$bailando" generate "$song" -o "$folder/dance.json" --seed 7 --duration-s 12 --include-rotations
"$bailando" render "$folder/dance.json" -o "$out" --fixed \
  --start-s 4 --duration-s 5 --fps 15 --size 440x380
size=$(wc -c < "$out")
echo "$out: $size bytes"
[ "$size" -lt 1000000 ] || { echo "$out: larger than 1 MB" >&2; exit 1; }
