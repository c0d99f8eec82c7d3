#!/usr/bin/env bash
# The figures of docs/evaluation.md on the ballroom set: motion for its test songs by a model that was
# trained on its other pieces, three times with three candidates and three times with one; the
# recordings through the VQ-VAE alone; the conditioning on the music; and all that as ratios to the
# recordings' own row, beside those of published tables. Five to seven minutes on two cores.
# Usage: scripts/evaluate-melody.sh MODEL [DATA [OUT]]
#   MODEL  model directory; a model of this set is for this measurement and may not be committed
#   DATA   data folder with a test split, songs and grid_beats_s
#          (default ../shared/data/dance-with-melody)
#   OUT    where motion and scores go  (default target/melody)
# BAILANDO and BAILANDO_TRAIN name the binaries (default target/release/bailando and
# bailando-train).
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

model=${1:?usage: scripts/evaluate-melody.sh MODEL [DATA [OUT]]}
data=${2:-../shared/data/dance-with-melody}
out=${3:-target/melody}
bailando=${BAILANDO:-target/release/bailando}
trainer=${BAILANDO_TRAIN:-target/release/bailando-train}

mkdir -p "$out"
# The test pieces whose song is there: the set may keep all motions and only some of the songs.
pieces() {
    python3 -c 'import json, os, sys
folder = sys.argv[1]
for piece in json.load(open(f"{folder}/index.json"))["pieces"]:
    if piece["split"] == "test" and os.path.exists(os.path.join(folder, piece["audio"])):
        print(piece["id"], piece["audio"])' "$data"
}
[ -n "$(pieces)" ] || { echo "evaluate-melody: no test piece of $data has its song." >&2; exit 1; }

# dance FOLDER CANDIDATES
dance() {
    local folder=$1 candidates=$2 seed number id audio
    rm -rf "$folder"
    for seed in 1 2 3; do
        mkdir -p "$folder/seed$seed"
        number=0
        while read -r id audio; do
            number=$((number + 1))
            "$bailando" generate "$data/$audio" -o "$folder/seed$seed/$id.json" --encoding base64 \
                --model-dir "$model" --music false --seed $((seed * 1000 + number)) --threads 1 \
                --candidates "$candidates" > "$out/generate.log" 2>&1 || { cat "$out/generate.log" >&2; exit 1; }
        done < <(pieces)
    done
}
dance "$out/chosen" 3
dance "$out/alone" 1

rm -rf "$out/encoded" "$out/reconstructed"
"$trainer" encode "$data" --model-dir "$model" --out "$out/encoded" --reconstruct > "$out/encode.log"
mkdir -p "$out/reconstructed"
while read -r id _; do
    ln "$out/encoded/$id.npy" "$out/reconstructed/$id.npy"
done < <(pieces)

# Every recording and every dance, and its mirror image beside it.
rm -rf "$out/both"
python3 - "$data" "$out" <<'PY'
import array, ast, base64, json, os, struct, sys

data, out = sys.argv[1:]
index = json.load(open(f"{data}/index.json"))
joints = index["joints"]
OTHER_SIDE = {"l": "r", "r": "l"}


def opposite(joint):
    side, _, part = joint.partition("_")
    return joints.index(f"{OTHER_SIDE[side]}_{part}" if side in OTHER_SIDE and part else joint)


OPPOSITE = [opposite(joint) for joint in joints]


def positions(path):
    if path.endswith(".json"):
        return array.array("f", base64.b64decode(json.load(open(path))["positions"]))
    raw = open(path, "rb").read()
    end = 10 + struct.unpack("<H", raw[8:10])[0]
    header = ast.literal_eval(raw[10:end].decode())
    assert header["descr"] == "<f4" and not header["fortran_order"], path
    return array.array("f", raw[end:])


def with_mirror_image(path, folder, name):
    os.makedirs(folder, exist_ok=True)
    os.symlink(os.path.realpath(path), f"{folder}/{os.path.basename(path)}")
    places, width = positions(path), 3 * len(joints)
    mirrored = array.array("f", places)
    for frame in range(0, len(places), width):
        for joint, other in enumerate(OPPOSITE):
            x, y, z = places[frame + 3 * other : frame + 3 * other + 3]
            mirrored[frame + 3 * joint : frame + 3 * joint + 3] = array.array("f", (-x, y, z))
    header = str({"descr": "<f4", "fortran_order": False, "shape": (len(places) // width, len(joints), 3)})
    header = header.ljust(117) + "\n"
    with open(f"{folder}/{name}", "wb") as file:
        file.write(b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header.encode() + mirrored.tobytes())


images = []
for piece in index["pieces"]:
    image = {**piece, "id": piece["id"] + "_mirrored", "motion": piece["id"] + "_mirrored.npy"}
    with_mirror_image(f"{data}/{piece['motion']}", f"{out}/both/data", image["motion"])
    images.append(image)
index["pieces"] += images
json.dump(index, open(f"{out}/both/data/index.json", "w"))
for seed in ["seed1", "seed2", "seed3"]:
    for file in sorted(os.listdir(f"{out}/chosen/{seed}")):
        name = os.path.splitext(file)[0] + "_mirrored.npy"
        with_mirror_image(f"{out}/chosen/{seed}/{file}", f"{out}/both/chosen/{seed}", name)
PY

# measure NAME REFERENCE OPTION ..
measure() {
    local name=$1 reference=$2
    shift 2
    "$bailando" evaluate --reference "$reference" --split test --json "$@" > "$out/$name.scores.json"
}
# samples NAME REFERENCE OPTION .. : three ways to cut dances into samples
samples() {
    local name=$1
    shift
    measure "$name.first" "$@"
    measure "$name.long" "$@" --window 1200 --stride 1200
    measure "$name.short" "$@" --window 300 --stride 150
}
samples chosen "$data" --generated "$out/chosen" --seeds 3 --music "$data"
samples alone "$data" --generated "$out/alone" --seeds 3 --music "$data"
samples reconstructed "$data" --generated "$out/reconstructed" --music "$data"
samples both "$out/both/data" --generated "$out/both/chosen" --seeds 3
measure chosen.counts "$data" --generated "$out/chosen" --seeds 3
measure alone.counts "$data" --generated "$out/alone" --seeds 3
measure reconstructed.counts "$data" --generated "$out/reconstructed"

python3 - "$out" <<'PY'
import json, math, sys

SAMPLES = [("first", "first 20 s"), ("long", "every 20 s"), ("short", "5 s windows")]
DISTANCES = [("FID_k ↓", "fid_k", 2), ("FID_g ↓", "fid_g", 2), ("Div_k", "div_k", 2), ("Div_g", "div_g", 2)]
BEATS = [("beat align score (Eq. 15) ↑", "beat_align", 4), ("its chance level", "beat_chance", 4)]
OTHERS = [
    ("margin over chance ↑", "beat_margin", 4),
    ("beat score over dance beats ↑", "beat_align_dance", 4),
    ("dance beats per second", "dance_beats_per_second", 3),
    ("share of frames below 0.15 m/s", "slow_frames", 4),
    ("share of 5 s windows with a tenth of such frames ↓", "sluggish_windows", 4),
    ("their share in the slowest 5 s window ↓", "slowest_window", 4),
    ("mean joint speed, m/s", "mean_speed", 3),
    ("jerk, m/s³", "jerk", 0),
    ("foot skate, cm/s ↓", "foot_skate", 1),
    ("recited share of 2 s windows", "recitation", 3),
    ("entropy of codes, upper body, bits ↑", "entropy_upper", 2),
    ("entropy of codes, lower body, bits ↑", "entropy_lower", 2),
]
ROWS = [(f"{title}, {cut}", of, key, digits) for of, cut in SAMPLES for title, key, digits in [("samples", "samples", 0), *DISTANCES]]
ROWS += [(title, "first", key, digits) for title, key, digits in BEATS + OTHERS]
ROWS += [(f"{title}, counts of the data folder", "counts", key, digits) for title, key, digits in BEATS]
# Table 1 of Bailando (CVPR 2022) and Bailando++ (TPAMI 2023), AIST++: FID_k, FID_g, Div_k, Div_g, beat align score.
RECORDED = [17.10, 10.60, 8.19, 7.45, 0.2374]
PUBLISHED = {
    "FACT, published": [35.35, 22.11, 5.94, 6.18, 0.2209],
    "Bailando, published": [28.16, 9.62, 7.83, 6.34, 0.2332],
    "Bailando++, published": [17.59, 10.10, 8.64, 6.50, 0.2720],
}
STUDENT = {2: 4.3027}
out = sys.argv[1]


def report(name, of):
    return json.load(open(f"{out}/{name}.{of}.scores.json"))


def sets(scores):
    return scores.get("sets", [scores])


def cell(values, digits):
    if None in values:
        return "–"
    mean, others = sum(values) / len(values), len(values) - 1
    text = f"{mean:.{digits}f}"
    if not others or max(values) == min(values):
        return text
    deviation = math.sqrt(sum((value - mean) ** 2 for value in values) / others)
    return f"{text} ± {STUDENT[others] * deviation / math.sqrt(len(values)):.{digits}f}"


def table(titles, rows):
    print("| " + " | ".join(titles) + " |\n" + "|---" * len(titles) + "|")
    for row in rows:
        print("| " + " | ".join(row) + " |")


def ratios(name, of):
    scores = report(name, of)
    columns = [[one[key] / scores["reference"][key] for one in sets(scores)] for _, key, _ in DISTANCES + BEATS[:1]]
    return [cell(column, 2) for column in columns]


names = ["chosen", "alone", "reconstructed"]
print("## Dances\n")
table(
    ["metric", "recordings", "dances, three candidates", "dances, one candidate", "recordings through the VQ-VAE"],
    [
        [title, cell([report("chosen", of)["reference"][key]], digits)]
        + [cell([one.get(key) for one in sets(report(name, of))], digits) for name in names]
        for title, of, key, digits in ROWS
    ],
)
constant = {cut: report("chosen", of)["protocol"]["constant_geometric_columns"] for of, cut in SAMPLES}
print("\nLeft out as constant in the recordings: geometric columns " + "; ".join(f"{', '.join(map(str, columns))} ({cut})" for cut, columns in constant.items()) + ".")
print("\n## Ratios to the recordings\n")
titles = ["dances, three candidates", "dances, one candidate", "recordings through the VQ-VAE"]
rows = [[title, cut, *ratios(name, of)] for title, name in zip(titles, names) for of, cut in SAMPLES]
rows += [["three candidates, all with mirror images", cut, *ratios("both", of)[:4], "–"] for of, cut in SAMPLES]
rows += [[title, "40 of 20 s, AIST++", *(cell([figure / own], 2) for figure, own in zip(figures, RECORDED))] for title, figures in PUBLISHED.items()]
table(["", "samples", *(title for title, *_ in DISTANCES), "beat align score ↑"], rows)
PY

printf '\n## What it hears\n\n'
"$trainer" music-gap "$data" --model-dir "$model"
