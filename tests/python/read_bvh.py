"""Reads a BVH file with bvhio, a parser that shares nothing with this project, and prints a JSON
object: joint names, seconds per frame, and world positions [frame][joint][x y z] in the file's unit.
"""

import json
import sys

import bvhio

root = bvhio.readAsHierarchy(sys.argv[1])
container = bvhio.readAsBvh(sys.argv[1])
joints = [joint for joint, _, _ in root.layout()]
frames = []
for frame in range(container.FrameCount):
    root.loadPose(frame)
    frames.append([list(joint.PositionWorld) for joint in joints])
json.dump(
    {
        "names": [joint.Name for joint in joints],
        "frame_time": container.FrameTime,
        "positions": frames,
    },
    sys.stdout,
)
