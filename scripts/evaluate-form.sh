#!/usr/bin/env bash
# What the option `form` does: dances with and without it, to six songs of known form that
# scripts/compose-songs.py writes and to the test split of a data folder, measured.
# Usage: scripts/evaluate-form.sh [MODEL [DATA [OUT]]]
#   MODEL  model directory           (default models/default)
#   DATA   data folder with a test split and test_beats.json  (default ../shared/data/salsa)
#   OUT    where songs and dances go                          (default target/form)
# BAILANDO names the binary (default target/release/bailando), SEEDS is the number of dances for
# every song (default 3).
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

model=${1:-models/default}
data=${2:-../shared/data/salsa}
out=${3:-target/form}
bailando=${BAILANDO:-target/release/bailando}
seeds=${SEEDS:-3}

mkdir -p "$out"
[ -e "$out/songs" ] || scripts/compose-songs.py "$out/songs" --form
songs() {
    for song in "$out"/songs/*; do
        printf '%s %s\n' "$(basename "${song%.*}")" "$song"
    done
}
pieces() {
    python3 -c 'import json, sys
for piece in json.load(open(sys.argv[1] + "/index.json"))["pieces"]:
    if piece["split"] == "test":
        print(piece["id"], sys.argv[1] + "/" + piece["audio"])' "$data"
}

# dances LIST: of each song of a list, with and without the option.
dances() {
    for form in false true; do
        rm -rf "$out/$1-$form"
        for ((seed = 1; seed <= seeds; seed++)); do
            mkdir -p "$out/$1-$form/seed$seed"
            number=0
            while read -r id song; do
                number=$((number + 1))
                "$bailando" generate "$song" -o "$out/$1-$form/seed$seed/$id.npy" \
                    --model-dir "$model" --form "$form" --music false \
                    --seed $((seed * 1000 + number)) --threads 1 > "$out/generate.log" 2>&1 \
                    || { cat "$out/generate.log" >&2; exit 1; }
            done < <("$1")
        done
    done
}
measure() {
    local list=$1 form
    shift
    for form in false true; do
        printf '\n## %s, form=%s\n\n' "$list" "$form"
        "$bailando" evaluate --generated "$out/$list-$form" --seeds "$seeds" --reference "$data" \
            --window 300 --stride 150 --form "$@"
    done
}

dances songs
measure songs --new-songs "$out/songs"
dances pieces
measure pieces --split test --beats "$data/test_beats.json"
