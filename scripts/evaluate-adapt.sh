#!/usr/bin/env bash
# What `bailando-train adapt` gains: a model is adapted to each song of a folder by the settings of
# train/presets/default.toml, and dances by the model and by its adaptations are measured alike.
# Usage: scripts/evaluate-adapt.sh SONGS [MODEL [DATA [OUT]]]
#   SONGS  folder of songs
#   MODEL  model directory                        (default models/default)
#   DATA   data folder, whose motion is compared  (default ../shared/data/salsa)
#   OUT    where everything goes                  (default target/adapt)
# BAILANDO and BAILANDO_TRAIN name the binaries (default target/release/bailando and
# bailando-train), SEEDS is the number of dances to each song (default 5).
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

songs=${1:?a folder of songs}
model=${2:-models/default}
data=${3:-../shared/data/salsa}
out=${4:-target/adapt}
bailando=${BAILANDO:-target/release/bailando}
trainer=${BAILANDO_TRAIN:-target/release/bailando-train}
seeds=${SEEDS:-5}

rm -rf "$out"
mkdir -p "$out"
awk -v folder="$out/run" '/^folder = "runs\/default"$/ { $0 = "folder = \"" folder "\"" } { print }' \
    train/presets/default.toml > "$out/settings.toml"

printf '## Time to adapt\n\n'
for song in "$songs"/*; do
    name=$(basename "${song%.*}")
    begun=$(date +%s)
    "$trainer" adapt "$out/settings.toml" --model "$model" --song "$song" \
        --out "$out/models/$name" > "$out/adapt.log" || { cat "$out/adapt.log" >&2; exit 1; }
    printf '%s: %d s\n' "$name" $(($(date +%s) - begun))
    for ((seed = 1; seed <= seeds; seed++)); do
        for of in before after; do
            mkdir -p "$out/$of/seed$seed"
            from=$model
            [ "$of" = before ] || from=$out/models/$name
            "$bailando" generate "$song" -o "$out/$of/seed$seed/$name.json" --model-dir "$from" \
                --seed "$seed" -q > "$out/generate.log"
        done
    done
done
scripts/heard-beats.py "$out/before/seed1" > "$out/beats.json"
# measure SET WHOSE-BEATS [OPTION..]
measure() {
    printf '\n## Dances %s, beats of %s\n\n' "$1" "$2"
    "$bailando" evaluate --reference "$data" --window 300 --stride 150 --generated "$out/$1" \
        --seeds "$seeds" --new-songs "$songs" "${@:3}"
}
for of in before after; do
    measure "$of" 'column 53, as published'
    measure "$of" 'the beat network' --beats "$out/beats.json"
done
