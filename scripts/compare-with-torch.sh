#!/usr/bin/env bash
# Times a training step of the same networks in this program and in PyTorch, in turn, with the same
# number of threads.
# Usage: scripts/compare-with-torch.sh [PYTHON]   (a Python with torch; default python3)
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

python=${1:-python3}
cargo bench --locked -p bailando-train --bench steps --no-run
for threads in 1 2; do
    for round in 1 2 3; do
        own=$(RAYON_NUM_THREADS=$threads cargo bench --quiet --locked -p bailando-train --bench steps)
        torch=$("$python" scripts/torch_steps.py --threads $threads)
        "$python" - "$threads" "$round" "$own" "$torch" <<'PY'
import json, sys
threads, round, own, torch = sys.argv[1:]
own, torch = json.loads(own), json.loads(torch)
for part in ("vqvae", "gpt"):
    print(f"threads {threads}, round {round}, {part}: {own[part]:.3f} s, torch {torch['torch']} {torch[part]:.3f} s,"
          f" ratio {own[part] / torch[part]:.2f}", flush=True)
PY
    done
done
