"""Characters for the load tests: a humanoid as BVH and GLB, and what strangers make of it."""

import json
import struct

# Characters: part, the part that it hangs on, its place in metres.
BODY = {
    "Hips": ("", (0, 0.9, 0)), "Spine": ("Hips", (0, 1, 0)), "Head": ("Spine", (0, 1.5, 0)),
} | {
    f"{side}{part}": (above.format(side), (x * sign, y, z))
    for side, sign in (("Left", 1), ("Right", -1))
    for part, above, (x, y, z) in (
        ("UpLeg", "Hips", (0.1, 0.85, 0)), ("Leg", "{}UpLeg", (0.1, 0.45, 0)),
        ("Foot", "{}Leg", (0.1, 0.08, 0)), ("ToeBase", "{}Foot", (0.1, 0.02, 0.1)),
        ("Arm", "Spine", (0.18, 1.4, 0)), ("ForeArm", "{}Arm", (0.45, 1.4, 0)),
        ("Hand", "{}ForeArm", (0.7, 1.4, 0)),
    )
}  # fmt: skip


def offsets(bones):
    """Bones as name, number of the parent or none, and offset from it."""
    names = list(bones)
    for above, place in bones.values():
        parent = names.index(above) if above else None
        start = bones[above][1] if above else (0, 0, 0)
        yield parent, [a - b for a, b in zip(place, start)]


def bvh(more=0, name=lambda number: f"x{number}", channels=6, offset=(0, 0.01, 0)):
    """A humanoid, and so many joints on its head that are none of its body."""
    kinds = "Xposition Yposition Zposition Zrotation Xrotation Yrotation"

    def joint(kind, name, offset, inside, channels=6):
        words = " ".join(kinds.split()[-channels:])
        offset = " ".join(map(str, offset))
        return f"{kind} {name}\n{{\nOFFSET {offset}\nCHANNELS {channels} {words}\n{inside}}}\n"

    extra = "".join(joint("JOINT", name(k), offset, "", channels) for k in range(more))
    plan = list(offsets(BODY))

    def below(at):
        names = list(BODY)
        inside = "".join(below(child) for child, (parent, _) in enumerate(plan) if parent == at)
        inside += extra if names[at] == "Head" else ""
        return joint("JOINT" if at else "ROOT", names[at], plan[at][1], inside)

    return f"HIERARCHY\n{below(0)}MOTION\nFrames: 1\nFrame Time: 0.04\n0\n".encode()


def glb(document, binary=b""):
    text = document if isinstance(document, bytes) else json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I", len(text)) + b"JSON" + text
    if binary:
        chunks += struct.pack("<I", len(binary)) + b"BIN\0" + binary
    return b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks


def humanoid(spine=(), **more):
    """A GLB whose spine has these bones besides."""
    nodes = [{"name": name, "translation": offset, "children": []}
             for name, (_, offset) in zip(BODY, offsets(BODY))]  # fmt: skip
    for child, (parent, _) in enumerate(offsets(BODY)):
        if parent is not None:
            nodes[parent]["children"].append(child)
    at = 0
    for name in spine:
        # Between the hips, or the one before, and the spine.
        nodes[at]["children"].remove(1)
        nodes[at]["children"].append(len(nodes))
        at = len(nodes)
        nodes.append({"name": name, "children": [1]})
    return {"asset": {"version": "2.0"}, "nodes": nodes} | more
