#!/usr/bin/env bash
# About 20 minutes on two idle cores, and some minutes more the first time, for the songs' features.
#
# Trains a small model and the same model with one part left out at a time (paper Table 2), generates
# motion for the test songs with two seeds, evaluates it, and prints a Markdown table.
# docs/training.md, "Ablations", says what that can show. A second start resumes; finished variants
# stay as they are.
#
# Usage: scripts/ablations.sh [DATA]    (default: ../shared/data/salsa)
#   OUT=DIR       where runs, dances and scores go (default: runs/ablations)
#   BIN=DIR       where bailando and bailando-train are (default: builds them, target/release)
#   PRESET=FILE   settings of the full model (default: train/presets/ablation.toml)
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

data=${1:-../shared/data/salsa}
out=${OUT:-runs/ablations}
preset=${PRESET:-train/presets/ablation.toml}
seeds="1 2"
names=()

fail() {
    printf 'ablations: %s\n' "$1" >&2
    exit 1
}

say() {
    printf '%s %s\n' "$(date +%T)" "$1" >&2
}

# Writes the preset to $1 with other folders and, for each further NAME=VALUE, another line.
settings() {
    local file=$1 edit name value
    shift
    sed -e "s|^folder = \"../shared/data/salsa\"|folder = \"$data\"|" \
        -e "s|\"runs/ablations/full|\"$(dirname "$file")|" "$preset" >"$file.partial"
    for edit in "$@"; do
        name=${edit%%=*} value=${edit#*=}
        [ "$(grep -c "^$name = " "$file.partial")" = 1 ] ||
            fail "$preset needs exactly one line '$name = ..'."
        sed -i "s|^$name = .*|$name = $value|" "$file.partial"
    done
    if [ -e "$file" ] && ! cmp -s "$file" "$file.partial"; then
        fail "$(dirname "$file") was made with other settings: remove it, or set OUT."
    fi
    mv "$file.partial" "$file"
}

# Takes finished stages from the full model: what the variant changes comes after them.
share() {
    local folder=$1 stage
    shift
    for stage in "$@"; do
        [ -e "$folder/$stage" ] && continue
        rm -rf "$folder/shared.partial"
        cp -r "$out/full/$stage" "$folder/shared.partial"
        mv "$folder/shared.partial" "$folder/$stage"
    done
}

dance() {
    local folder=$1 seed
    for seed in $seeds; do
        [ -e "$folder/dances/seed$seed" ] && continue
        rm -rf "$folder/dances.partial"
        "$bin/bailando-train" generate "$folder/settings.toml" --seed "$seed" \
            --out "$folder/dances.partial" >&2
        mkdir -p "$folder/dances"
        mv "$folder/dances.partial" "$folder/dances/seed$seed"
    done
}

score() {
    local folder=$1 beats=()
    [ -e "$data/test_beats.json" ] && beats=(--beats "$data/test_beats.json")
    "$bin/bailando" evaluate --generated "$folder/dances" --seeds "$(wc -w <<<"$seeds")" \
        --reference "$data" --split test --window 300 --stride 150 "${beats[@]}" --json \
        >"$folder/scores.partial"
    mv "$folder/scores.partial" "$folder/scores.json"
}

# variant NAME "STAGES OF THE FULL MODEL" "STAGES TO TRAIN" [SETTING=VALUE ..]
variant() {
    local name=$1 shared=$2 trained=$3 folder=$out/$1 stage
    shift 3
    names+=("$name")
    mkdir -p "$folder"
    settings "$folder/settings.toml" "$@"
    if [ -e "$folder/scores.json" ]; then
        say "$name: finished before"
        return
    fi
    say "$name"
    # shellcheck disable=SC2086 # lists of words
    share "$folder" $shared
    for stage in $trained; do
        "$bin/bailando-train" "$stage" "$folder/settings.toml" >&2
    done
    dance "$folder"
    score "$folder"
}

table() {
    python3 - "$out" "$@" <<'PY'
import json, sys

COLUMNS = [("FID_k ↓", "fid_k", 2), ("FID_g ↓", "fid_g", 2), ("Div_k", "div_k", 2), ("Div_g", "div_g", 2),
           ("beat score ↑", "beat_align", 4), ("its chance", "beat_chance", 4), ("jerk, m/s³", "jerk", 0)]
out, *names = sys.argv[1:]
reports = {name: json.load(open(f"{out}/{name}/scores.json")) for name in names}


def cell(sets, key, digits):
    values = [scores[key] for scores in sets]
    if None in values:
        return "–"
    mean, spread = sum(values) / len(values), (max(values) - min(values)) / 2
    return f"{mean:.{digits}f}" + (f" ± {spread:.{digits}f}" if len(sets) > 1 else "")


def row(title, sets):
    print("| " + " | ".join([title] + [cell(sets, key, digits) for _, key, digits in COLUMNS]) + " |")


print("| variant | " + " | ".join(title for title, *_ in COLUMNS) + " |")
print("|---" * (len(COLUMNS) + 1) + "|")
row("recordings", [reports[names[0]]["reference"]])
for name in names:
    row(name, reports[name]["sets"])
print(f"\nMean of {len(reports[names[0]]['sets'])} seeds of the dances, ± half the distance between them; one training each.")
PY
}

[ -e "$data" ] || fail "$data is not there: scripts/ablations.sh DATA"
say "about 20 minutes on two idle cores, more where the songs' features are not cached yet"
bin=${BIN:-target/release}
[ -n "${BIN:-}" ] || cargo build --release --locked --workspace >&2

all="vqvae velocity gpt actor-critic"
variant full "" "$all"
variant no_actor_critic "vqvae velocity gpt" "" enabled=false
variant separate_halves "vqvae velocity" "gpt actor-critic" separate_halves=true
variant whole_body "" "$all" whole_body=true
variant root_in_pose "" "vqvae gpt actor-critic" root_in_pose=true
variant position_loss "" "$all" velocity_weight=0.0 acceleration_weight=0.0
# Regression has no policy to reward: compare it with no_actor_critic.
variant continuous "" "vqvae velocity gpt" continuous=true enabled=false
table "${names[@]}"
