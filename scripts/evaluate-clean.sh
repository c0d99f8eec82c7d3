#!/usr/bin/env bash
# What clean-up costs in quality: a model's dances to the songs of a test split as decoded and
# cleaned, a few seeds each, as BVH, against the recordings.
# Usage: scripts/evaluate-clean.sh [MODEL [DATA [OUT]]]
#   MODEL  model directory           (default models/default)
#   DATA   data folder with a test split and test_beats.json  (default ../shared/data/salsa)
#   OUT    where dances go           (default target/clean)
# BAILANDO names the binary (default target/release/bailando), SEEDS is the number of dances for
# every song, decoded and cleaned with the same seed (default 10). SONGS is a folder of other songs,
# in place of those of the test split.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

model=${1:-models/default}
data=${2:-../shared/data/salsa}
out=${3:-target/clean}
bailando=${BAILANDO:-target/release/bailando}
seeds=${SEEDS:-10}

rm -rf "$out"
mkdir -p "$out"
measured=(--split test --beats "$data/test_beats.json")
if [ -n "${SONGS:-}" ]; then
    mkdir "$out/songs"
    ln -s "$(realpath "$SONGS")" "$out/songs/0"
    measured=(--new-songs "$SONGS")
else
    # Folders of songs named after their pieces, each song once in a folder, for a folder has one seed.
    python3 - "$data" "$out/songs" <<'PY'
import collections, json, os, sys
data, songs = sys.argv[1:]
times = collections.Counter()
for piece in json.load(open(f"{data}/index.json"))["pieces"]:
    if piece["split"] == "test":
        audio = os.path.realpath(f"{data}/{piece['audio']}")
        folder = f"{songs}/{times[audio]}"
        times[audio] += 1
        os.makedirs(folder, exist_ok=True)
        os.symlink(audio, f"{folder}/{piece['id']}{os.path.splitext(audio)[1]}")
PY
fi
for ((seed = 1; seed <= seeds; seed++)); do
    for songs in "$out"/songs/*; do
        for clean in true false; do
            "$bailando" generate "$songs" --out-dir "$out/$clean/seed$seed" --format bvh --quiet \
                --model-dir "$model" --seed $((100 * seed + $(basename "$songs"))) --clean $clean
        done
    done
done
for clean in false true; do
    printf '## clean=%s\n\n' $clean
    "$bailando" evaluate --generated "$out/$clean" --seeds "$seeds" --reference "$data" \
        "${measured[@]}" --window 300 --stride 150
done
