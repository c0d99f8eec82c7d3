#!/usr/bin/env bash
# The figures of a model card: the test split of a data folder danced to by a model, three times, and
# measured against the recordings.
# Usage: scripts/evaluate-model.sh [MODEL [DATA [OUT]]]
#   MODEL  model directory           (default models/default)
#   DATA   data folder with a test split and test_beats.json  (default ../shared/data/salsa)
#   OUT    where dances and the plot go                       (default target/evaluation)
# BAILANDO names the binary (default target/release/bailando).
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

model=${1:-models/default}
data=${2:-../shared/data/salsa}
out=${3:-target/evaluation}
bailando=${BAILANDO:-target/release/bailando}

pieces() {
    python3 -c 'import json, sys
for piece in json.load(open(sys.argv[1]))["pieces"]:
    if piece["split"] == "test":
        print(piece["id"], piece["audio"])' "$data/index.json"
}

rm -rf "$out/dances"
for seed in 1 2 3; do
    mkdir -p "$out/dances/seed$seed"
    number=0
    while read -r id audio; do
        number=$((number + 1))
        "$bailando" generate "$data/$audio" -o "$out/dances/seed$seed/$id.json" --model-dir "$model" \
            --music false --seed $((seed * 1000 + number)) --threads 1 > "$out/generate.log" 2>&1 ||
            { cat "$out/generate.log" >&2; exit 1; }
    done < <(pieces)
done
"$bailando" evaluate --generated "$out/dances" --seeds 3 --reference "$data" --split test \
    --window 300 --stride 150 --beats "$data/test_beats.json" --plot "$out/evaluation.svg"
