"""Measures dances on rigs (see scripts/check-rigs.sh): limbs against the dancer's, feet against the
floor, joints against Blender and three.js, and what else of the files has changed.

Usage: rigs.py FOLDER; it has `dance.json`, `rigs/`, `mapping/NAME.json`, `danced/`, and where these
were at hand `three/NAME.json` and `blender/NAME.json`. Prints a table; fails where a rig is bad.
"""

import json
import pathlib
import sys

import numpy as np

from expected import Dance
from rig_files import Bvh, read

# Limits: issue-wide ones of feet; joints within 2 mm; limbs as the dancer's within a degree.
MOST_SKATE, LEAST_HEIGHT, MOST_MM, MOST_ARM, MOST_KNEE = 5.0, -0.5, 2.0, 1.5, 25.0
LOW = 0.05
DANCER = {
    "LowerArm": "elbow", "UpperArm": "shoulder", "Hand": "wrist", "UpperLeg": "hip",
    "LowerLeg": "knee", "Foot": "ankle", "Toes": "foot",
}
SIDES = {"left": "l", "right": "r"}


def unit(vectors):
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)


def angles(one, other):
    cosines = np.clip((unit(one) * unit(other)).sum(-1), -1, 1)
    return np.degrees(np.arccos(cosines))


class Rig:
    """A rig at rest and dancing, in metres and in the axes of dances."""

    def __init__(self, rig, danced, mapping, dance):
        self.before, self.after = read(rig), read(danced)
        listed = lambda names: names if isinstance(names, list) else [names]
        bones = {part: listed(names) for part, names in mapping.items()}
        self.bones = {part: self.index(names[-1]) for part, names in bones.items()}
        self.bones["hips"] = self.index(bones["hips"][0])
        world = self.after.play(dance.fps)
        assert len(world) >= len(dance), f"{len(world)} of {len(dance)} frames"
        self.world = world[: len(dance)]
        self.axes = self.find_axes()
        rest = self.before.rest[..., :3, 3] @ self.axes.T
        self.up_by = rest[:, 1].min() if isinstance(self.before, Bvh) else 0.0
        self.metres = 1.0
        if isinstance(self.before, Bvh):
            # BVH does not say its unit: its legs are as long as those of somebody of 1.7 m.
            self.metres = 0.85 / np.linalg.norm(self.rest("leftUpperLeg") - self.rest("leftFoot"))

    def index(self, name):
        if name.startswith("#"):
            return int(name[1:])
        assert self.before.names.count(name) == 1, name
        return self.before.names.index(name)

    def find_axes(self):
        """Rows: the rig's left, up and front."""
        place = lambda part: self.before.rest[self.bones[part], :3, 3]
        left = place("leftUpperLeg") - place("rightUpperLeg")
        line = place("leftUpperArm") + place("rightUpperArm")
        line = line - place("leftFoot") - place("rightFoot")
        up, across = np.zeros(3), np.zeros(3)
        up[abs(line).argmax()] = np.sign(line[abs(line).argmax()])
        across[abs(left).argmax()] = np.sign(left[abs(left).argmax()])
        return np.stack([across, up, np.cross(across, up)])

    def into(self, places):
        return (places @ self.axes.T) * self.metres

    def rest(self, part):
        return self.before.rest[self.bones[part], :3, 3] @ self.axes.T * self.metres

    def places(self, part):
        return self.into(self.world[:, self.bones[part], :3, 3])

    def below(self, part):
        tree = [self.bones[part]]
        for joint in tree:
            tree += [child for child, parent in enumerate(self.before.parents) if parent == joint]
        return tree

    def soles(self):
        """Heights in cm of all that feet are made of: how much lower than at rest, at least."""
        feet = [bone for side in SIDES for bone in self.below(f"{side}Foot")]
        rest = self.before.skinned(self.before.rest, feet)
        if rest is not None:
            heights = self.into(self.after.skinned(self.world, feet))[..., 1]
            return 100 * (heights.min() - self.into(rest)[..., 1].min())
        rest = self.into(self.before.rest[feet, :3, 3])[..., 1].min()
        return 100 * (self.into(self.world[:, feet, :3, 3])[..., 1].min() - rest)

    def skate(self, fps):
        """Median speed in cm/s of balls, or of tips of feet without one, on the floor."""
        speeds = []
        for side in SIDES:
            foot, ball = self.bones[f"{side}Foot"], self.bones.get(f"{side}Toes")
            if ball is None:
                rest = self.before.rest[:, :3, 3]
                far = lambda bone: np.linalg.norm(rest[bone] - rest[foot])
                ball = max(self.below(f"{side}Foot"), key=far)
            places = self.into(self.world[:, ball, :3, 3])
            floor = self.into(self.before.rest[ball, :3, 3])[1]
            low = places[:, 1] - floor < LOW
            steps = np.linalg.norm(np.diff(places[:, [0, 2]], axis=0), axis=-1)
            speeds.append(steps[low[1:] & low[:-1]] * fps * 100)
        speeds = np.concatenate(speeds)
        assert len(speeds) > 20, "feet do not come to the floor"
        return np.median(speeds)


class Dancer:
    def __init__(self, dance, joints):
        self.dance, self.joints = dance, joints

    def places(self, part):
        for side, letter in SIDES.items():
            if part.startswith(side):
                part = f"{letter}_{DANCER[part.removeprefix(side)]}"
        name = "pelvis" if part == "hips" else part
        return self.dance.positions[:, self.joints.index(name)]


def facing(figure):
    left = figure.places("leftUpperLeg") - figure.places("rightUpperLeg")
    return unit(left * [1, 0, 1])


def bend(figure, side):
    """From the line between hip and ankle to the knee, and whether the leg is bent."""
    hip, knee, ankle = (figure.places(side + part) for part in ("UpperLeg", "LowerLeg", "Foot"))
    line = unit(ankle - hip)
    off = knee - hip - line * ((knee - hip) * line).sum(-1, keepdims=True)
    return off, angles(knee - hip, ankle - knee) > 20


def jump(figure, parts):
    """Largest change of velocity of parts from one frame to the next, cm a frame."""
    bends = [np.diff(figure.places(part), n=2, axis=0) for part in parts]
    return 100 * max(np.linalg.norm(bend, axis=-1).max() for bend in bends)


HIPS, FEET = ["hips"], ["leftFoot", "rightFoot"]


def measure(rig, dancer):
    arms = max(
        angles(rig.places(side + to) - rig.places(side + of),
               dancer.places(side + to) - dancer.places(side + of)).max()
        for side in SIDES for of, to in [("UpperArm", "LowerArm"), ("LowerArm", "Hand")]
        if side + to in rig.bones
    )
    knees = 0.0
    for side in SIDES:
        (own, bent), (wanted, also) = bend(rig, side), bend(dancer, side)
        if (bent & also).any():
            knees = max(knees, angles(own, wanted)[bent & also].max())
    return {
        "arms": arms,
        "knees": knees,
        "turned": angles(facing(rig), facing(dancer)).max(),
        "skate": rig.skate(dancer.dance.fps),
        "lowest": rig.soles(),
        "jumps": [jump(rig, HIPS), jump(rig, FEET)],
    }


def others(folder, stem, rig):
    """Largest distances in millimetres of joints as another program has them."""
    path = folder / f"{stem}.json"
    if not path.exists():
        return None
    seen = json.loads(path.read_text())
    most = 0.0
    for frame, places in seen.items():
        for bone, place in places.items():
            own = rig.world[int(frame), int(bone), :3, 3]
            most = max(most, np.linalg.norm(own - place) * rig.metres * 1000)
    return most


def main(folder):
    dance = Dance(folder / "dance.json")
    joints = json.loads((folder / "dance.json").read_text())["skeleton"]["joints"]
    dancer, bad = Dancer(dance, joints), []
    print(f"the dancer: jumps {jump(dancer, HIPS):.2f} of the hips, {jump(dancer, FEET):.2f} of feet")
    print(f"{'rig':24} {'bones':>5} {'found by':9} {'skate':>5} {'lowest':>6} {'jumps':>9} "
          f"{'arms':>5} {'knees':>5} {'turned':>6} {'Blender':>7} {'three':>7}")
    for file in sorted((folder / "danced").iterdir()):
        stem = file.name
        mapping = json.loads((folder / "mapping" / f"{stem}.json").read_text())
        rig = Rig(folder / "rigs" / stem, file, mapping["bones"], dance)
        seen = measure(rig, dancer)
        programs = [others(folder / name, stem, rig) for name in ("blender", "three")]
        told = ["      -" if mm is None else f"{mm:7.3f}" for mm in programs]
        print(f"{stem:24} {len(rig.before.names):5} {mapping['found_by']:9} {seen['skate']:5.2f} "
              f"{seen['lowest']:6.2f} {seen['jumps'][0]:4.2f} {seen['jumps'][1]:4.2f} "
              f"{seen['arms']:5.2f} {seen['knees']:5.1f} "
              f"{seen['turned']:6.2f} " + " ".join(told))
        if (
            seen["skate"] > MOST_SKATE or seen["lowest"] < LEAST_HEIGHT or seen["arms"] > MOST_ARM
            or seen["knees"] > MOST_KNEE or seen["turned"] > 5
            or any(mm is not None and not mm < MOST_MM for mm in programs)
        ):
            bad.append(stem)
    print("skate: cm/s, lowest: cm against rest, jumps: cm a frame by which the velocity of hips and "
          "of feet changes at most, arms, knees, turned: degrees from the dancer's, Blender, three: mm")
    if bad:
        sys.exit(f"out of limits: {', '.join(bad)}")


if __name__ == "__main__":
    main(pathlib.Path(sys.argv[1]))
