#!/usr/bin/env bash
# The figures of a model card: a model's motion for the test split of a data folder, a few times,
# against the recordings, in windows and by the published protocol; the recordings through its VQ-VAE
# alone, measured the same way; its conditioning on the music; and ten motions each for songs it never
# met: those that scripts/compose-songs.py writes, of other genres and of the styles that the model
# has, and DATA/demo/demo.flac, if it exists.
# Usage: scripts/evaluate-model.sh [MODEL [DATA [OUT]]]
#   MODEL  model directory           (default models/default)
#   DATA   data folder with a test split and test_beats.json  (default ../shared/data/salsa)
#   OUT    where dances and the plot go                       (default target/evaluation)
# A model with styles is asked for the style of each piece, and of each song that is named after one;
# STYLES_FROM are data folders, separated by spaces, whose training recordings teach what tells the
# styles of the dances. SONGS is a folder of songs more that it never met.
# BAILANDO and BAILANDO_TRAIN name the binaries (default target/release/bailando and
# bailando-train), SEEDS is the number of motions for every song of the test split (default 3), JOBS
# that of songs at a time (default: a core each).
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

model=${1:-models/default}
data=${2:-../shared/data/salsa}
out=${3:-target/evaluation}
bailando=${BAILANDO:-target/release/bailando}
trainer=${BAILANDO_TRAIN:-target/release/bailando-train}
seeds=${SEEDS:-3}
read -ra styles_from <<< "${STYLES_FROM:-}"

mkdir -p "$out"
pieces() {
    python3 -c 'import json, sys
for piece in json.load(open(sys.argv[1]))["pieces"]:
    if piece["split"] == "test":
        print(piece["id"], piece["audio"], piece.get("style", "-"))' "$data/index.json"
}
styles=$(python3 -c 'import json, sys
print(*json.load(open(sys.argv[1])).get("styles") or [])' "$model/manifest.json")

# dance OUT SONG SEED MUSIC STYLE: - for none, as for a style that the model does not have.
dance() {
    local style=()
    [[ " $styles " != *" $5 "* ]] || style=(--style "$5")
    "$bailando" generate "$2" -o "$1" --model-dir "$model" --music "$4" --seed "$3" --threads 1 \
        "${style[@]}" > "$1.log" 2>&1 || { cat "$1.log" >&2; exit 255; }
    rm "$1.log"
}
export -f dance
export styles bailando model
# Lines of what `dance` takes.
dance_all() {
    xargs -P "${JOBS:-$(nproc)}" -n 5 bash -c 'dance "$@"' dance
}

rm -rf "$out/dances"
for ((seed = 1; seed <= seeds; seed++)); do
    mkdir -p "$out/dances/seed$seed"
    number=0
    while read -r id audio style; do
        number=$((number + 1))
        echo "$out/dances/seed$seed/$id.json $data/$audio $((seed * 1000 + number)) false $style"
    done < <(pieces)
done | dance_all
measure() {
    "$bailando" evaluate --reference "$data" "$@"
}
windows=(--window 300 --stride 150)
of_test=(--split test --beats "$data/test_beats.json")

printf '## Dances\n\n'
measure --generated "$out/dances" --seeds "$seeds" "${of_test[@]}" "${windows[@]}" \
    --plot "$out/evaluation.svg" "${styles_from[@]/#/--styles-from=}"
printf '\n## Dances, first 20 s: the published protocol\n\n'
measure --generated "$out/dances" --seeds "$seeds" "${of_test[@]}"

rm -rf "$out/encoded" "$out/reconstructed"
"$trainer" encode "$data" --model-dir "$model" --out "$out/encoded" --reconstruct > "$out/encode.log"
mkdir -p "$out/reconstructed"
python3 - "$data/index.json" "$out" <<'PY'
import json, os, sys
index, out = sys.argv[1:]
pieces = [piece for piece in json.load(open(index))["pieces"] if piece["split"] == "test"]
first = {}
for piece in pieces:
    first.setdefault(piece["motion"], piece["id"])
    # One recording goes with many songs: each piece is judged beside its own.
    os.link(f"{out}/encoded/{first[piece['motion']]}.npy", f"{out}/reconstructed/{piece['id']}.npy")
PY
printf '\n## Recordings through the VQ-VAE alone\n\n'
measure --generated "$out/reconstructed" "${of_test[@]}" "${windows[@]}"

printf '\n## Conditioning on the music\n\n'
"$trainer" music-gap "$data" --model-dir "$model"

rm -rf "$out/songs" "$out/new"
scripts/compose-songs.py "$out/songs"
[ -z "$styles" ] || scripts/compose-songs.py "$out/songs" --styles
if [ -f "$data/demo/demo.flac" ]; then
    ln -s "$(realpath "$data/demo/demo.flac")" "$out/songs/demo.flac"
fi
if [ -n "${SONGS:-}" ]; then
    find "$(realpath "$SONGS")" -maxdepth 1 -type f ! -name '*.md' -exec ln -s -t "$out/songs" {} +
fi
for seed in {1..10}; do
    mkdir -p "$out/new/seed$seed"
    for song in "$out"/songs/*; do
        name=$(basename "${song%.*}")
        echo "$out/new/seed$seed/$name.json $song $seed true $name"
    done
done | dance_all
scripts/heard-beats.py "$out/new/seed1" > "$out/new-beats.json"
for beats in 'column 53, as published' 'the beat network'; do
    printf '\n## Songs it never met, beats of %s\n\n' "$beats"
    heard=()
    [ "$beats" != 'the beat network' ] || heard=(--beats "$out/new-beats.json")
    measure --generated "$out/new" --seeds 10 --new-songs "$out/songs" "${windows[@]}" "${heard[@]}"
done
