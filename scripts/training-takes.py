#!/usr/bin/env python3
"""Training recordings in place of dances: the figures of a model that danced like its training set.

Usage: scripts/training-takes.py DATA OUT [SETS]

For every piece of the test split of DATA a training recording of the same style is drawn, and as many
frames of it as the piece has, from a random one on; SETS times (default 10). Measured by

    bailando evaluate --reference DATA --split test --generated OUT --seeds SETS

with the options that dances are measured with. Needs numpy.
"""

import json
import pathlib
import random
import sys

import numpy


def main():
    if len(sys.argv) not in (3, 4):
        sys.exit(__doc__)
    data, out = map(pathlib.Path, sys.argv[1:3])
    sets = int(sys.argv[3]) if len(sys.argv) == 4 else 10
    pieces = json.loads((data / "index.json").read_text())["pieces"]
    takes = {}
    for piece in pieces:
        if piece["split"] == "train":
            takes.setdefault(piece.get("style"), set()).add(piece["motion"])
    for number in range(1, sets + 1):
        dice = random.Random(number)
        folder = out / f"seed{number}"
        folder.mkdir(parents=True, exist_ok=True)
        for piece in (piece for piece in pieces if piece["split"] == "test"):
            take = numpy.load(data / dice.choice(sorted(takes[piece.get("style")])))
            frames = min(piece["frames"], len(take))
            first = dice.randrange(len(take) - frames + 1)
            part = take[first : first + frames].astype(numpy.float32)
            numpy.save(folder / f"{piece['id']}.npy", part)


if __name__ == "__main__":
    main()
