#!/usr/bin/env bash
# What a device changes: the figures of `bailando bench` on both, and how many pose codes at temperature 0
# are the same. Nothing else should run meanwhile.
# Usage: scripts/compare-devices.sh MODEL SONG [DEVICE [OTHER [OUT]]]
#   MODEL          model directory, for instance one of random weights in the published size
#   SONG           a song of about half a minute
#   DEVICE, OTHER  devices as --device has them  (default cpu cuda)
#   OUT            where figures and dances go   (default target/devices)
# BAILANDO names the program (default target/release/bailando); ORT_DYLIB_PATH must be a library with CUDA
# where a device is one (scripts/fetch-onnxruntime.sh --cuda).
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

model=${1:?usage: scripts/compare-devices.sh MODEL SONG [DEVICE [OTHER [OUT]]]}
song=${2:?usage: scripts/compare-devices.sh MODEL SONG [DEVICE [OTHER [OUT]]]}
device=${3:-cpu}
other=${4:-cuda}
out=${5:-target/devices}
bailando=${BAILANDO:-target/release/bailando}

mkdir -p "$out"
# One of the two devices may be named twice, to see what the comparison itself says.
number=0
for name in "$device" "$other"; do
    number=$((number + 1))
    "$bailando" bench "$song" --model-dir "$model" --device "$name" --threads 2 --repeats 3 --lengths 30 \
        --callers 1,4,8 --json "$out/$number.json"
    "$bailando" generate "$song" --model-dir "$model" --device "$name" --temperature 0 --start-upper 0 \
        --start-lower 0 --redo false --candidates 1 --music false -o "$out/$number.dance.json"
    echo
done
python3 - "$out" "$device" "$other" <<'PYTHON'
import json
import sys

out, *devices = sys.argv[1:]
figures, dances = ([json.load(open(f"{out}/{number}{end}")) for number in (1, 2)]
                   for end in (".json", ".dance.json"))
codes = [list(zip(dance["codes"]["upper"], dance["codes"]["lower"])) for dance in dances]
assert len(codes[0]) == len(codes[1]) > 0
same = [one == other for one, other in zip(*codes)]
first = same.index(False) if False in same else None
until = "all of them" if first is None else f"the first {first} in a row"
print(f"codes at temperature 0: {sum(same)} of {len(same)} pairs are the same, {until}")
for callers in range(len(figures[0]["load"])):
    one, other = (figure["load"][callers] for figure in figures)
    print(f"{one['callers']} callers: {one['dances_per_second']:.2f} dances a second on {devices[0]}, "
          f"{other['dances_per_second']:.2f} on {devices[1]}, {other['dances_per_second'] / one['dances_per_second']:.2f} x")
PYTHON
