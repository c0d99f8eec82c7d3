#!/usr/bin/env python3
"""Measures whether dances keep the bar of their music.

    scripts/count-lock.py DATA DANCES...

For every quarter of a second of a dance to a test song, the script finds the most similar second of the
training takes, with heading and place removed and mirror images included. That second was danced on a
known count of its own music; its difference from the count of the song at hand shows whether the dance
keeps the bar. The script prints how concentrated these differences are, modulo one, two, four and eight
counts (mean resultant length: 0 for uniform, 1 for always the same), for each folder of dances
(PIECE.npy or PIECE.json, in it or one folder below), and for the test recordings themselves.

Needs numpy.
"""

import argparse
import json
import pathlib

import numpy as np

FPS = 60
# Five poses describe a second.
OFFSETS = np.arange(0, 49, 12)
MIDDLE = 24
# Frames between the starts of described seconds.
KNOWN_EVERY, ASKED_EVERY = 2, 15
CYCLES = (1, 2, 4, 8)
LEFT_HIP, RIGHT_HIP = 1, 2
OTHER_SIDE = [0, 2, 1, 3, 5, 4, 6, 8, 7, 9, 11, 10, 12, 14, 13, 15, 17, 16, 19, 18, 21, 20, 23, 22]


def positions(path):
    """[frames, 24, 3]."""
    if path.suffix == ".npy":
        return np.load(path).astype(np.float32).reshape(-1, 24, 3)
    return np.array(json.loads(path.read_text())["positions"], np.float32)


def described(motion):
    """Returns the frames in the middle of seconds, and these seconds in the dancer's own frame."""
    motion = motion - motion[:, :1]
    across = motion[:, LEFT_HIP] - motion[:, RIGHT_HIP]
    angle = np.arctan2(across[:, 2], across[:, 0])[:, None]
    cosine, sine = np.cos(angle), np.sin(angle)
    x, y, z = (motion[..., axis] for axis in range(3))
    turned = np.stack([cosine * x + sine * z, y, cosine * z - sine * x], -1)
    starts = np.arange(len(turned) - OFFSETS[-1])
    return starts + MIDDLE, lambda every: turned[starts[::every, None] + OFFSETS].reshape(
        len(starts[::every]), -1
    )


def counts(piece, frames):
    """Returns the song's count at these frames, with fractions; NaN outside of the song."""
    grid = np.array(piece["grid_beats_s"])
    count = np.interp(frames / FPS, grid, np.arange(len(grid)), left=np.nan, right=np.nan)
    return count + piece["first_count"] - 1


class Repertoire:
    """Seconds of the training takes and their counts."""

    def __init__(self, data, pieces):
        looks, places = [], []
        first = {piece["motion"]: piece for piece in reversed(pieces) if piece["split"] == "train"}
        for motion, piece in sorted(first.items()):
            take = positions(data / motion)
            mirrored = take[:, OTHER_SIDE] * np.array([-1, 1, 1], np.float32)
            for side in (take, mirrored):
                frames, look = described(side)
                looks.append(look(KNOWN_EVERY))
                places.append(counts(piece, frames[::KNOWN_EVERY]))
        places = np.concatenate(places)
        known = ~np.isnan(places)
        self.looks, self.places = np.concatenate(looks)[known], places[known]
        self.squares = (self.looks**2).sum(1)

    def differences(self, piece, motion):
        """Returns the counts of the most similar seconds, less the song's."""
        frames, look = described(motion)
        look = look(ASKED_EVERY)
        nearest = (self.squares - 2 * look @ self.looks.T).argmin(1)
        return self.places[nearest] - counts(piece, frames[::ASKED_EVERY])


def concentration(differences, cycle):
    return abs(np.exp(2j * np.pi * differences / cycle).mean())


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=pathlib.Path)
    parser.add_argument("dances", type=pathlib.Path, nargs="*")
    options = parser.parse_args()
    pieces = json.loads((options.data / "index.json").read_text())["pieces"]
    tests = {piece["id"]: piece for piece in pieces if piece["split"] == "test"}
    repertoire = Repertoire(options.data, pieces)

    def report(name, dances):
        found = [repertoire.differences(piece, positions(path)) for piece, path in dances]
        found = np.concatenate(found)
        found = found[~np.isnan(found)]
        figures = "  ".join(f"{cycle}: {concentration(found, cycle):.3f}" for cycle in CYCLES)
        print(f"{name}  {figures}  ({len(found)} seconds)")

    recorded = {piece["motion"]: piece for piece in tests.values()}
    report("recordings", [(piece, options.data / motion) for motion, piece in recorded.items()])
    for folder in options.dances:
        files = sorted(path for path in folder.rglob("*") if path.suffix in (".npy", ".json"))
        report(folder, [(tests[path.stem], path) for path in files if path.stem in tests])


if __name__ == "__main__":
    main()
