import { type Object3D, Quaternion, Vector3 } from 'three';
import type { Pose, Skeleton } from '../motion/skeleton';

/** A bone of the avatar that follows a joint of the motion. */
interface Link {
  node: Object3D;
  /** Number of the joint. */
  joint: number;
  /** World rotation of the bone at rest, the avatar facing +z. */
  rest: Quaternion;
  /** Turns the rest direction of the avatar's limb to that of the motion's skeleton. */
  align: Quaternion;
}

/** Limbs, by joint, with the joint that their direction leads to; the others keep their own. */
const LIMBS: Record<string, string> = {
  l_shoulder: 'l_elbow',
  l_elbow: 'l_wrist',
  r_shoulder: 'r_elbow',
  r_elbow: 'r_wrist',
  l_hip: 'l_knee',
  l_knee: 'l_ankle',
  r_hip: 'r_knee',
  r_knee: 'r_ankle',
};

/**
 * Carries poses over to another skeleton: each bone takes the world rotation of its joint, so that
 * rest poses, axes and numbers of bones may differ; the way of the hips is scaled by their height.
 */
export class Retarget {
  private readonly links: Link[] = [];
  private readonly hips: Object3D;
  private readonly scale: number;
  private readonly globals: Quaternion[];
  private readonly parent = new Quaternion();
  private readonly at = new Vector3();

  /** `bones` maps joint names to the avatar's nodes, in their rest pose under `root`. */
  constructor(
    private readonly skeleton: Skeleton,
    private readonly root: Object3D,
    bones: Map<string, Object3D>,
  ) {
    const hips = bones.get('pelvis');
    if (!hips) throw new Error('The character has no hips.');
    this.hips = hips;
    this.globals = skeleton.joints.map(() => new Quaternion());
    root.updateMatrixWorld(true);
    const place = (name: string) => bones.get(name)?.getWorldPosition(new Vector3());
    skeleton.joints.forEach((name, joint) => {
      const node = bones.get(name);
      if (!node) return;
      const align = new Quaternion();
      const [from, to] = [place(name), place(LIMBS[name] ?? '')];
      if (from && to) {
        const own = to.sub(from).normalize();
        const given = new Vector3(...skeleton.offsets[skeleton.index(LIMBS[name])]).normalize();
        align.setFromUnitVectors(own, given);
      }
      this.links.push({ node, joint, rest: node.getWorldQuaternion(new Quaternion()), align });
    });
    // Parents first: a bone's own rotation is what its parent has not turned yet.
    this.links.sort((a, b) => depth(a.node) - depth(b.node));
    const lowest = Math.min(...skeleton.rest.map((position) => position[1]));
    const ankles = ['l_foot', 'l_ankle', 'r_ankle'].map((name) => place(name)?.y ?? Infinity);
    const ground = Math.min(0, ...ankles.filter(Number.isFinite));
    const height = hips.getWorldPosition(new Vector3()).y - ground;
    this.scale = height / (0.015 - lowest);
  }

  pose(pose: Pose): void {
    this.skeleton.joints.forEach((_, joint) => {
      const global = this.globals[joint].fromArray(pose.rotations, joint * 4);
      const parent = this.globals[this.skeleton.parents[joint]];
      if (parent) global.premultiply(parent);
    });
    this.root.updateMatrixWorld(true);
    // In the space of the root, which may stand anywhere.
    const base = this.root.getWorldQuaternion(new Quaternion()).invert();
    for (const { node, joint, rest, align } of this.links) {
      const parent = node.parent ?? this.root;
      parent.getWorldQuaternion(this.parent).premultiply(base).invert();
      node.quaternion.copy(this.globals[joint]).multiply(align).multiply(rest);
      node.quaternion.premultiply(this.parent);
      if (node === this.hips) {
        this.at.fromArray(pose.root).multiplyScalar(this.scale);
        this.root.localToWorld(this.at);
        node.position.copy(parent.worldToLocal(this.at));
      }
      node.updateMatrixWorld(false);
    }
    this.root.updateMatrixWorld(true);
  }
}

function depth(node: Object3D): number {
  return node.parent ? depth(node.parent) + 1 : 0;
}
