"""Opens dances on rigs in Blender, and draws them (see scripts/check-rigs.sh).

Usage: rigs_blender.py FOLDER [NAME..]; writes FOLDER/blender/NAME.json, {frame: {bone: place}}, and
with names a sheet of pictures of each of these, FOLDER/NAME.png.
"""

import json
import pathlib
import shutil
import sys

import bpy
import numpy as np
from mathutils import Vector

from rig_files import read

EVERY = 36
folder = pathlib.Path(sys.argv[1])
drawn = sys.argv[2:]
dance = json.loads((folder / "dance.json").read_text())


def open_rig(path):
    """Returns the armature with the dance on it, and the frame at which it begins."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.fps = dance["fps"]
    if path.suffix == ".bvh":
        bpy.ops.import_anim.bvh(filepath=str(path), use_fps_scale=False)
        armature = next(o for o in scene.objects if o.type == "ARMATURE")
        return armature, int(armature.animation_data.action.frame_range[0])
    plain = folder / "plain.glb"
    shutil.copy(path, plain)
    bpy.ops.import_scene.gltf(filepath=str(plain))
    plain.unlink()
    armatures = [o for o in scene.objects if o.type == "ARMATURE"]
    armature = next(o for o in armatures if o.animation_data)
    action = next(a for a in bpy.data.actions if a.name.startswith("Dance"))
    for track in armature.animation_data.nla_tracks:
        track.mute = True
    armature.animation_data.action = action
    armature.animation_data.action_slot = action.slots[0]
    return armature, int(action.frame_range[0])


def joints(armature, first, names):
    scene, seen = bpy.context.scene, {}
    for frame in range(0, dance["frames"], EVERY):
        scene.frame_set(first + frame)
        seen[frame] = {}
        for bone, name in names.items():
            place = armature.matrix_world @ armature.pose.bones[name].head
            seen[frame][bone] = (place.x, place.z, -place.y)
    return seen


def draw(armature, first, file):
    """Twelve moments, by turns from the front and from the side, with Cycles at few samples."""
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.use_denoising = 6, False
    scene.render.resolution_x, scene.render.resolution_y = 200, 260
    world = scene.world = bpy.data.worlds.new("World")
    world.use_nodes = True
    world.node_tree.nodes["Background"].inputs[0].default_value = (0.8, 0.85, 0.9, 1)
    sun = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN"))
    sun.data.energy, sun.rotation_euler = 3, (0.7, 0.2, 0.5)
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    for thing in (sun, camera):
        scene.collection.objects.link(thing)
    scene.camera = camera
    heads = [armature.matrix_world @ bone.head_local for bone in armature.data.bones]
    height = max(head.z for head in heads)
    bpy.ops.mesh.primitive_plane_add(size=12 * height)
    tiles = []
    for tile in range(12):
        scene.frame_set(first + tile * (dance["frames"] - 1) // 11)
        places = [armature.matrix_world @ bone.head for bone in armature.pose.bones]
        middle = sum(places, Vector()) / len(places)
        away = Vector((2.4, -0.6, 0)) if tile % 2 else Vector((0, -2.5, 0))
        target = Vector((middle.x, middle.y, 0.5 * height))
        camera.location = target + height * away
        camera.rotation_euler = (-away).to_track_quat("-Z", "Y").to_euler()
        scene.render.filepath = str(folder / f"tile-{tile}.png")
        bpy.ops.render.render(write_still=True)
        tiles.append(pathlib.Path(scene.render.filepath))
    sheet(tiles, file)


def sheet(tiles, file, columns=6):
    images = [bpy.data.images.load(str(tile)) for tile in tiles]
    width, height = images[0].size
    rows = -(-len(tiles) // columns)
    whole = np.ones((rows * height, columns * width, 4), np.float32)
    for index, image in enumerate(images):
        pixels = np.empty(width * height * 4, np.float32)
        image.pixels.foreach_get(pixels)
        row, column = rows - 1 - index // columns, index % columns
        whole[row * height : (row + 1) * height, column * width : (column + 1) * width] = (
            pixels.reshape(height, width, 4)
        )
    result = bpy.data.images.new("Sheet", columns * width, rows * height)
    result.pixels.foreach_set(whole.ravel())
    result.filepath_raw, result.file_format = str(file), "PNG"
    result.save()
    for tile in tiles:
        tile.unlink()


(folder / "blender").mkdir(exist_ok=True)
for path in sorted((folder / "danced").iterdir()):
    if drawn and path.stem not in drawn and path.name not in drawn:
        continue
    armature, first = open_rig(path)
    bones = json.loads((folder / "mapping" / f"{path.name}.json").read_text())["bones"]
    listed = (names if isinstance(names, list) else [names] for names in bones.values())
    wanted = {name for names in listed for name in names if name in armature.pose.bones}
    names = {index: name for index, name in enumerate(read(path).names) if name in wanted}
    seen = joints(armature, first, names)
    (folder / "blender" / f"{path.name}.json").write_text(json.dumps(seen))
    if drawn:
        draw(armature, first, folder / f"{path.name}.png")
