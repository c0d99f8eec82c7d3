"""Reads the files of a folder with programs that share nothing with this project, those that can be
imported, and compares joints with forward kinematics (see scripts/check-formats.sh).

Usage: read.py FOLDER; prints a line per reader and file, and fails where one is over 2 mm.
"""

import csv
import importlib
import json
import pathlib
import re
import sys
import tempfile

import numpy as np

from expected import Dance, names

MOST_MM = 2.0
folder = pathlib.Path(sys.argv[1])
dance = Dance(folder / "dance.json")
failed = False


def tell(reader, file, millimetres, note=""):
    global failed
    failed |= not millimetres < MOST_MM
    print(f"{reader:12} {file.name:16} {millimetres:8.3f} mm  {note}")


def package(name):
    try:
        return importlib.import_module(name)
    except ImportError:
        print(f"{name:12} not installed: skipped")
        return None


def files(pattern):
    return [(path, path.stem) for path in sorted(folder.glob(pattern))]


def bvh_names(skeleton):
    return [name.replace(":", "") for name in names(skeleton)]


def of_one_root(reader):
    """BVH files for a reader that moves no joint but the ROOT: Unreal's pelvis moves below it."""
    print(f"{reader:12} unreal.bvh       moves the ROOT alone: skipped")
    return [(path, skeleton) for path, skeleton in files("*.bvh") if skeleton != "unreal"]


def with_bvhio(bvhio):
    for path, skeleton in files("*.bvh"):
        root = bvhio.readAsHierarchy(str(path))
        joints = {joint.Name: joint for joint, _, _ in root.layout()}
        frames = range(0, len(dance), max(1, len(dance) // 12))
        seen = []
        for frame in frames:
            root.loadPose(frame)
            seen.append([np.array(joints[name].PositionWorld) / 100 for name in bvh_names(skeleton)])
        tell("bvhio", path, dance.error(frames, seen))


def with_bvhtoolbox(_):
    from bvhtoolbox import BvhTree
    from bvhtoolbox.convert.bvh2csv import write_joint_positions

    for path, skeleton in of_one_root("bvhtoolbox"):
        tree = BvhTree(path.read_text())
        with tempfile.NamedTemporaryFile("r", suffix=".csv") as table:
            write_joint_positions(tree, table.name)
            rows = list(csv.DictReader(open(table.name)))
        seen = [
            [[float(row[f"{name}.{axis}"]) / 100 for axis in "xyz"] for name in bvh_names(skeleton)]
            for row in rows
        ]
        tell("bvhtoolbox", path, dance.error(range(len(dance)), seen))


def with_bvhsdk(bvhsdk):
    for path, skeleton in files("*.bvh"):
        animation = bvhsdk.ReadFile(str(path))
        joints = [animation.getJoint(name) for name in bvh_names(skeleton)]
        frames = range(0, len(dance), max(1, len(dance) // 12))
        seen = [[np.array(joint.getPosition(frame)) / 100 for joint in joints] for frame in frames]
        tell("bvhsdk", path, dance.error(frames, seen))


def with_pybvh(pybvh):
    for path, skeleton in of_one_root("pybvh"):
        bvh = pybvh.Bvh.from_file(str(path))
        order = [bvh.joint_names.index(name) for name in bvh_names(skeleton)]
        seen = bvh.joint_positions()[:, order] / 100
        tell("pybvh", path, dance.error(range(len(dance)), seen), f"{bvh.fps:g} fps")


def with_numpy():
    path = folder / "dance.npz"
    data = np.load(path)
    frames = len(dance)
    assert data["poses"].shape == (frames, 156) and data["trans"].shape == (frames, 3)
    assert data["mocap_framerate"] == dance.fps and str(data["gender"]) == "neutral"
    assert data["betas"].shape == (16,)
    vectors = data["poses"].reshape(frames, 52, 3).astype(float)
    angle = np.linalg.norm(vectors, axis=-1)[..., None, None]
    axis = vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)
    cross = np.zeros(axis.shape + (3,))
    for a, b, c in [(0, 1, 2), (1, 2, 0), (2, 0, 1)]:
        cross[..., b, a], cross[..., a, b] = axis[..., c], -axis[..., c]
    local = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    world, seen = {}, np.zeros((frames, 24, 3))
    for joint in range(22):
        parent = dance.parents[joint]
        if parent < 0:
            world[joint], seen[:, joint] = local[:, joint], data["trans"]
        else:
            world[joint] = world[parent] @ local[:, joint]
            seen[:, joint] = seen[:, parent] + world[parent] @ dance.offsets[joint]
    seen = np.stack([seen[..., 0], seen[..., 2], -seen[..., 1]], -1)
    seen[:, 22:] = dance.positions[:, 22:]
    tell("numpy", path, dance.error(range(frames), seen))


def with_godot():
    path = folder / "godot" / "dance.json"
    if not path.exists():
        print(f"{'Godot':12} not installed, or it did not import: skipped")
        return
    rows = json.loads(path.read_text())
    # It writes an underscore before the digits of a name.
    wanted = [re.sub(r"(\d)", r"_\1", name) for name in names("smpl")]
    seen = [[joints[name] for name in wanted] for _, joints in rows]
    tell("Godot", folder / "smpl.glb", dance.error([frame for frame, _ in rows], seen))


def with_bpy(bpy):
    """Blender is z up, and imports make it so; frames are its own."""
    jobs = files("*.bvh") + files("*.glb") + files("*.fbx")
    for path, skeleton in jobs:
        bpy.ops.wm.read_factory_settings(use_empty=True)
        scene = bpy.context.scene
        scene.render.fps = dance.fps
        if path.suffix == ".bvh":
            bpy.ops.import_anim.bvh(
                filepath=str(path), global_scale=0.01, update_scene_fps=True,
                update_scene_duration=True,
            )
        elif path.suffix == ".glb":
            bpy.ops.import_scene.gltf(filepath=str(path))
        else:
            bpy.ops.import_scene.fbx(filepath=str(path), anim_offset=0.0)
        armature = next(o for o in scene.objects if o.type == "ARMATURE")
        action = armature.animation_data.action
        first, last = (int(frame) for frame in action.frame_range)
        fps = scene.render.fps / scene.render.fps_base
        frames = range(0, len(dance), max(1, len(dance) // 40))
        seen = []
        for frame in frames:
            scene.frame_set(first + frame)
            bones = armature.pose.bones
            bone_names = bvh_names(skeleton) if path.suffix == ".bvh" else names(skeleton)
            heads = [armature.matrix_world @ bones[name].head for name in bone_names]
            seen.append([(head.x, head.z, -head.y) for head in heads])
        note = f"{fps:g} fps, frames {first} to {last}, action {action.name!r}"
        tell("Blender", path, dance.error(frames, seen), note)


with_numpy()
with_godot()
readers = {
    "bvhio": with_bvhio, "bvhtoolbox": with_bvhtoolbox, "bvhsdk": with_bvhsdk,
    "pybvh": with_pybvh, "bpy": with_bpy,
}
for name, read in readers.items():
    if module := package(name):
        read(module)
sys.exit(failed)
