#!/usr/bin/env python3
"""The beats that songs were heard with, out of their dances, as `bailando evaluate --beats` reads them.

Usage: scripts/heard-beats.py DANCES

DANCES is a folder of JSON dances. Prints {name: frames of the beats at 60 frames a second}. Needs
only Python's standard library.
"""

import json
import pathlib
import sys

FPS = 60


def main():
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    beats = {}
    for path in sorted(pathlib.Path(sys.argv[1]).glob("*.json")):
        music = json.loads(path.read_text())["music"]
        beats[path.stem] = [round(FPS * second) for second in music["beats_s"]]
    print(json.dumps(beats))


if __name__ == "__main__":
    main()
