"""Rigs and dances on them, read without this project's code: bones of GLB and BVH in the world."""

import json
import struct

import numpy as np

WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}
TYPES = {5121: np.uint8, 5123: np.uint16, 5125: np.uint32, 5126: np.float32}


def rotations(quaternions):
    x, y, z, w = np.moveaxis(np.asarray(quaternions, float), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, -1) for row in rows], -2)


class Glb:
    """Nodes of a GLB; `rest` [nodes, 4, 4] and `play` [frames, nodes, 4, 4] are in the world."""

    def __init__(self, path):
        file = path.read_bytes()
        size = struct.unpack_from("<I", file, 12)[0]
        self.json = json.loads(file[20 : 20 + size])
        self.binary = file[28 + size :]
        nodes = self.json["nodes"]
        self.names = [node.get("name", "") for node in nodes]
        self.parents = [-1] * len(nodes)
        for index, node in enumerate(nodes):
            for child in node.get("children", []):
                self.parents[child] = index
        self.order = sorted(range(len(nodes)), key=self.depth)
        self.locals = [self.parts(node) for node in nodes]
        self.rest = self.world([self.matrix(*parts) for parts in self.locals])

    def depth(self, node):
        return 0 if self.parents[node] < 0 else 1 + self.depth(self.parents[node])

    def parts(self, node):
        if "matrix" in node:
            return np.array(node["matrix"], float).reshape(4, 4).T, None, None
        default = {"translation": [0, 0, 0], "rotation": [0, 0, 0, 1], "scale": [1, 1, 1]}
        return tuple(np.array(node.get(key, value), float) for key, value in default.items())

    def matrix(self, place, turn, scale):
        if turn is None:
            return place
        frames = np.broadcast_shapes(place.shape[:-1], turn.shape[:-1])
        matrix = np.zeros(frames + (4, 4))
        matrix[..., :3, :3] = rotations(turn) * scale
        matrix[..., :3, 3] = place
        matrix[..., 3, 3] = 1
        return matrix

    def world(self, local):
        world = list(local)
        for node in self.order:
            if self.parents[node] >= 0:
                world[node] = world[self.parents[node]] @ local[node]
        frames = np.broadcast_shapes(*(matrix.shape for matrix in world))
        return np.stack([np.broadcast_to(matrix, frames) for matrix in world], -3)

    def accessor(self, index):
        accessor = self.json["accessors"][index]
        view = self.json["bufferViews"][accessor["bufferView"]]
        kind, width = TYPES[accessor["componentType"]], WIDTHS[accessor["type"]]
        start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        count = accessor["count"] * width
        return np.frombuffer(self.binary, kind, count, start).reshape(accessor["count"], width)

    def play(self, fps, name="Dance"):
        """Every frame of an animation."""
        clip = next(a for a in self.json["animations"] if a.get("name") == name)
        inputs = [self.accessor(s["input"])[:, 0].astype(float) for s in clip["samplers"]]
        frames = round(max(times[-1] for times in inputs) * fps) + 1
        moved = [list(parts) for parts in self.locals]
        for channel in clip["channels"]:
            sampler = clip["samplers"][channel["sampler"]]
            assert sampler.get("interpolation", "LINEAR") == "LINEAR"
            times, values = inputs[channel["sampler"]], self.accessor(sampler["output"])
            at = np.clip(np.arange(frames) / fps, times[0], times[-1])
            after = np.clip(np.searchsorted(times, at, "right"), 1, max(len(times) - 1, 1))
            before, after = after - 1, np.minimum(after, len(times) - 1)
            span = np.maximum(times[after] - times[before], 1e-9)
            part = ((at - times[before]) / span)[:, None]
            values = values.astype(float)
            value = values[before] * (1 - part) + values[after] * part
            path = channel["target"]["path"]
            if path == "rotation":
                # Keys are so near that a normalised mean is the arc.
                value /= np.linalg.norm(value, axis=-1, keepdims=True)
            place = ["translation", "rotation", "scale"].index(path)
            moved[channel["target"]["node"]][place] = value
        local = [self.matrix(*parts) for parts in moved]
        return self.world([np.broadcast_to(m, (frames, 4, 4)) for m in local])

    def skinned(self, world, bones):
        """Vertices that mainly these bones move, [frames, vertices, 3]."""
        skins, all_places = self.json.get("skins", []), []
        for node in self.json["nodes"]:
            if "skin" not in node or "mesh" not in node:
                continue
            skin = skins[node["skin"]]
            inverse = self.accessor(skin["inverseBindMatrices"]).reshape(-1, 4, 4)
            joints = np.array(skin["joints"])
            bound = world[..., joints, :, :] @ np.swapaxes(inverse.astype(float), -1, -2)
            for primitive in self.json["meshes"][node["mesh"]]["primitives"]:
                own = primitive["attributes"]
                places, at, weights = (
                    self.accessor(own[key]) for key in ("POSITION", "JOINTS_0", "WEIGHTS_0")
                )
                main = joints[at[np.arange(len(at)), weights.argmax(1)]]
                keep = np.isin(main, bones)
                places = np.c_[places[keep], np.ones(keep.sum())].astype(float)
                sum_of = 0.0
                for influence in range(4):
                    matrices = bound[..., at[keep, influence], :3, :]
                    weight = weights[keep, influence, None].astype(float)
                    sum_of = sum_of + weight * np.einsum("...vij,vj->...vi", matrices, places)
                all_places.append(sum_of)
        return np.concatenate(all_places, -2) if all_places else None


class Bvh:
    """Joints of a BVH file, as [`Glb`] has them; its rest pose has no rotations."""

    def __init__(self, path):
        self.names, self.parents, offsets, self.channels, opened = [], [], [], [], []
        lines = iter(path.read_text().splitlines())
        for line in lines:
            word, *rest = line.split() or [""]
            match word.upper():
                case "ROOT" | "JOINT" | "END":
                    self.parents.append(opened[-1] if opened else -1)
                    self.names.append(" ".join(rest) if word.upper() != "END" else "")
                    opened.append(len(self.names) - 1)
                    self.channels.append([])
                    offsets.append([0.0] * 3)
                case "OFFSET":
                    offsets[opened[-1]] = [float(number) for number in rest]
                case "CHANNELS":
                    self.channels[opened[-1]] = [name.lower() for name in rest[1:]]
                case "}":
                    opened.pop()
                case "MOTION":
                    break
        self.offsets = np.array(offsets)
        self.motion = [line for line in lines if line.strip()]
        self.rest = self.world(None)

    def world(self, rows):
        frames = () if rows is None else (len(rows),)
        world, column = [], 0
        for joint, parent in enumerate(self.parents):
            local = np.zeros(frames + (4, 4))
            local[...] = np.eye(4)
            local[..., :3, 3] = self.offsets[joint]
            for channel in self.channels[joint] if frames else []:
                axis, values = "xyz".index(channel[0]), rows[:, column]
                column += 1
                if channel.endswith("position"):
                    local[..., axis, 3] = values
                    continue
                turn = np.zeros(frames + (4, 4))
                turn[...] = np.eye(4)
                cos, sin = np.cos(np.radians(values)), np.sin(np.radians(values))
                one, two = (axis + 1) % 3, (axis + 2) % 3
                turn[..., one, one], turn[..., two, two] = cos, cos
                turn[..., two, one], turn[..., one, two] = sin, -sin
                local = local @ turn
            world.append(local if parent < 0 else world[parent] @ local)
        return np.stack(world, -3)

    def play(self, fps):
        frames, step = (line.split(":")[1] for line in self.motion[:2])
        assert abs(float(step) * fps - 1) < 1e-4, step
        assert len(self.motion) == int(frames) + 2, frames
        return self.world(np.array([line.split() for line in self.motion[2:]], float))

    def skinned(self, world, bones):
        return None


def read(path):
    return Bvh(path) if path.suffix == ".bvh" else Glb(path)
