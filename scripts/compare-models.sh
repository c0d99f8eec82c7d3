#!/usr/bin/env bash
# The cost of quantisation: equal codes and perplexity on recordings, then the figures of five sets
# of motion each, generated with the same seeds.
# Usage: scripts/compare-models.sh ORIGINAL MODEL [DATA [OUT]]
#   ORIGINAL, MODEL  model directories with one VQ-VAE
#   DATA   data folder with a test split and test_beats.json  (default ../shared/data/salsa)
#   OUT    where dances go                                    (default target/comparison)
# OPTIONS are passed on to `bailando generate`. BAILANDO and BAILANDO_TRAIN name the binaries
# (default target/release/bailando and bailando-train).
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

original=${1:?usage: scripts/compare-models.sh ORIGINAL MODEL [DATA [OUT]]}
model=${2:?usage: scripts/compare-models.sh ORIGINAL MODEL [DATA [OUT]]}
data=${3:-../shared/data/salsa}
out=${4:-target/comparison}
bailando=${BAILANDO:-target/release/bailando}
trainer=${BAILANDO_TRAIN:-target/release/bailando-train}
read -ra options <<< "${OPTIONS:-}"

printf '## Codes of recordings\n\n'
"$trainer" compare "$original" "$model" "$data"

pieces() {
    python3 -c 'import json, sys
for piece in json.load(open(sys.argv[1]))["pieces"]:
    if piece["split"] == "test":
        print(piece["id"], piece["audio"])' "$data/index.json"
}
rm -rf "$out"
for name in original model; do
    for seed in 1 2 3 4 5; do
        mkdir -p "$out/$name/seed$seed"
        number=0
        while read -r id audio; do
            number=$((number + 1))
            "$bailando" generate "$data/$audio" -o "$out/$name/seed$seed/$id.npy" \
                --model-dir "${!name}" --music false --seed $((seed * 1000 + number)) --threads 1 \
                ${options[@]+"${options[@]}"} > "$out/generate.log" 2>&1 \
                || { cat "$out/generate.log" >&2; exit 1; }
        done < <(pieces)
    done
    printf '\n## Dances of the %s\n\n' "$name"
    "$bailando" evaluate --generated "$out/$name" --seeds 5 --reference "$data" --split test \
        --window 300 --stride 150 --beats "$data/test_beats.json"
done
