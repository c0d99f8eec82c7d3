"""What every reader should see of a dance: forward kinematics of the rotations in its JSON."""

import json

import numpy as np

# Joints of SMPL, then the bones that they are called in other skeletons.
TABLE = """
pelvis Hips hips pelvis センター
l_hip LeftUpLeg leftUpperLeg thigh_l 左足
r_hip RightUpLeg rightUpperLeg thigh_r 右足
spine1 Spine spine spine_01 -
l_knee LeftLeg leftLowerLeg calf_l 左ひざ
r_knee RightLeg rightLowerLeg calf_r 右ひざ
spine2 Spine1 chest spine_02 -
l_ankle LeftFoot leftFoot foot_l 左足首
r_ankle RightFoot rightFoot foot_r 右足首
spine3 Spine2 upperChest spine_03 -
l_foot LeftToeBase leftToes ball_l -
r_foot RightToeBase rightToes ball_r -
neck Neck neck neck_01 首
l_collar LeftShoulder leftShoulder clavicle_l 左肩
r_collar RightShoulder rightShoulder clavicle_r 右肩
head Head head head 頭
l_shoulder LeftArm leftUpperArm upperarm_l 左腕
r_shoulder RightArm rightUpperArm upperarm_r 右腕
l_elbow LeftForeArm leftLowerArm lowerarm_l 左ひじ
r_elbow RightForeArm rightLowerArm lowerarm_r 右ひじ
l_wrist LeftHand leftHand hand_l 左手首
r_wrist RightHand rightHand hand_r 右手首
l_hand LeftHandMiddle1 leftMiddleProximal middle_01_l -
r_hand RightHandMiddle1 rightMiddleProximal middle_01_r -
"""
SKELETONS = ("smpl", "mixamo", "vrm", "unreal", "mmd")


def names(skeleton):
    column = [row.split()[SKELETONS.index(skeleton)] for row in TABLE.strip().splitlines()]
    return ["mixamorig:" + name for name in column] if skeleton == "mixamo" else column


def matrices(quaternions):
    x, y, z, w = np.moveaxis(quaternions, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, -1) for row in rows], -2)


class Dance:
    """`positions` [frames, 24, 3] in metres, y up."""

    def __init__(self, path):
        with open(path, encoding="utf-8") as file:
            dance = json.load(file)
        self.fps = dance["fps"]
        self.parents = dance["skeleton"]["parents"]
        self.offsets = np.array(dance["skeleton"]["offsets"])
        local = matrices(np.array(dance["rotations"]))
        world = np.empty_like(local)
        self.positions = np.empty(local.shape[:2] + (3,))
        for joint, parent in enumerate(self.parents):
            if parent < 0:
                world[:, joint] = local[:, joint]
                self.positions[:, joint] = dance["root"]
            else:
                world[:, joint] = world[:, parent] @ local[:, joint]
                step = world[:, parent] @ self.offsets[joint]
                self.positions[:, joint] = self.positions[:, parent] + step
        self.world = world

    def __len__(self):
        return len(self.positions)

    def error(self, frames, seen):
        """The largest distance in millimetres of `seen` [len(frames), 24, 3]."""
        apart = np.linalg.norm(np.array(seen) - self.positions[list(frames)], axis=-1)
        return 1000 * apart.max()
