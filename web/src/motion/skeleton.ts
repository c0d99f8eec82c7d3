import type { SkeletonJson } from '../api/types';

/** A rest skeleton with what the viewer derives from it. */
export class Skeleton {
  readonly joints: string[];
  readonly parents: number[];
  readonly offsets: [number, number, number][];
  /** Number of the joint on the other side; the joint itself in the middle. */
  readonly mirrored: number[];
  /** Rest positions in metres, the root at the origin. */
  readonly rest: [number, number, number][];

  constructor(json: SkeletonJson) {
    this.joints = json.joints;
    this.parents = json.parents;
    this.offsets = json.offsets;
    this.mirrored = json.joints.map((name, own) => {
      const other = name.startsWith('l_') ? `r_${name.slice(2)}` : `l_${name.slice(2)}`;
      const found = /^[lr]_/.test(name) ? json.joints.indexOf(other) : -1;
      return found < 0 ? own : found;
    });
    this.rest = [];
    json.offsets.forEach((offset, joint) => {
      const parent = this.rest[json.parents[joint]] ?? [0, 0, 0];
      const [x, y, z] = joint === 0 ? [0, 0, 0] : offset;
      this.rest.push([parent[0] + x, parent[1] + y, parent[2] + z]);
    });
  }

  /** Number of a joint by its name. */
  index(name: string): number {
    const found = this.joints.indexOf(name);
    if (found < 0) throw new Error(`The skeleton has no joint ${name}.`);
    return found;
  }
}

/** One moment of a motion. */
export interface Pose {
  /** World position of the root in metres. */
  root: Float32Array;
  /** Local unit quaternions, x y z w of each joint. */
  rotations: Float32Array;
}

export function emptyPose(joints: number): Pose {
  const rotations = new Float32Array(joints * 4);
  for (let joint = 0; joint < joints; joint++) rotations[joint * 4 + 3] = 1;
  return { root: new Float32Array(3), rotations };
}

/** Somebody who stands at ease: arms down, elbows a little bent. */
export function standingPose(skeleton: Skeleton): Pose {
  const pose = emptyPose(skeleton.joints.length);
  const lowest = Math.min(...skeleton.rest.map((position) => position[1]));
  pose.root[1] = 0.015 - lowest;
  const turn = (name: string, axis: number, degrees: number) => {
    const at = skeleton.index(name) * 4;
    pose.rotations[at + axis] = Math.sin((degrees * Math.PI) / 360);
    pose.rotations[at + 3] = Math.cos((degrees * Math.PI) / 360);
  };
  turn('l_collar', 2, -6);
  turn('r_collar', 2, 6);
  turn('l_shoulder', 2, -66);
  turn('r_shoulder', 2, 66);
  turn('l_elbow', 1, -16);
  turn('r_elbow', 1, 16);
  turn('l_hip', 2, 4);
  turn('r_hip', 2, -4);
  turn('l_ankle', 2, -4);
  turn('r_ankle', 2, 4);
  return pose;
}
