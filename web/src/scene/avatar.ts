import { type VRM, VRMLoaderPlugin, VRMUtils } from '@pixiv/three-vrm';
import { Box3, Group, type Mesh, type Object3D, Vector3 } from 'three';
import type { Pose, Skeleton } from '../motion/skeleton';
import { bonesByName, VRM_BONES } from './bones';
import type { Figure } from './figure';
import { readGltf } from './gltf';
import { Retarget } from './retarget';

/** Joints without which a character cannot dance. */
const NEEDED = [
  'pelvis',
  'head',
  'l_shoulder',
  'r_shoulder',
  'l_elbow',
  'r_elbow',
  'l_hip',
  'r_hip',
  'l_knee',
  'r_knee',
  'l_ankle',
  'r_ankle',
];

/** The user's own character, driven in the browser. */
export class Avatar implements Figure {
  readonly object = new Group();
  private readonly retarget: Retarget;
  private readonly at = new Vector3();

  private constructor(
    skeleton: Skeleton,
    private readonly model: Object3D,
    private readonly vrm: VRM | null,
    private readonly bones: Map<string, Object3D>,
  ) {
    this.object.add(model);
    this.retarget = new Retarget(skeleton, this.object, bones);
    model.traverse((node) => {
      node.frustumCulled = false;
      node.castShadow = (node as Mesh).isMesh === true;
    });
  }

  /** Reads a .vrm or .glb; the error says what is missing. */
  static async read(file: Blob, skeleton: Skeleton): Promise<Avatar> {
    const gltf = await readGltf(file, (parser) => new VRMLoaderPlugin(parser));
    const vrm = (gltf.userData.vrm as VRM | undefined) ?? null;
    const model = vrm?.scene ?? gltf.scene;
    if (vrm) VRMUtils.rotateVRM0(vrm);
    const bones = vrm ? bonesOfVrm(vrm) : bonesByName(model, skeleton.joints);
    const missing = NEEDED.filter((joint) => !bones.has(joint));
    if (missing.length > 0) {
      VRMUtils.deepDispose(model);
      throw new Error(
        `The character lacks bones for ${missing.join(', ')}. ` +
          'VRM files work, and GLB files with the bone names of Mixamo, Unreal or SMPL.',
      );
    }
    if (!vrm) upright(model, bones);
    return new Avatar(skeleton, model, vrm, bones);
  }

  pose(pose: Pose): void {
    this.retarget.pose(pose);
  }

  joint(name: string, into: Vector3): Vector3 {
    const bone = this.bones.get(name) ?? this.bones.get('pelvis') ?? this.object;
    return bone.getWorldPosition(into);
  }

  tick(seconds: number): void {
    this.vrm?.update(Math.min(seconds, 0.1));
  }

  /** Height in metres. */
  get height(): number {
    return new Box3().setFromObject(this.model).getSize(this.at).y;
  }

  dispose(): void {
    this.object.removeFromParent();
    VRMUtils.deepDispose(this.model);
  }
}

/** The normalised bones of a VRM: T-pose, and rotations that are those of the world. */
function bonesOfVrm(vrm: VRM): Map<string, Object3D> {
  const bones = new Map<string, Object3D>();
  for (const [joint, bone] of Object.entries(VRM_BONES)) {
    const node = vrm.humanoid.getNormalizedBoneNode(bone as never);
    if (node) bones.set(joint, node);
  }
  return bones;
}

/** Turns a character to face +z, which its hips tell, and gives one in centimetres metres. */
function upright(model: Object3D, bones: Map<string, Object3D>): void {
  model.updateMatrixWorld(true);
  const place = (joint: string) =>
    bones.get(joint)?.getWorldPosition(new Vector3()) ?? new Vector3();
  const left = place('l_hip').sub(place('r_hip'));
  model.rotateY(Math.atan2(left.z, left.x));
  const height = place('head').y - Math.min(place('l_ankle').y, place('r_ankle').y);
  if (height > 20) model.scale.multiplyScalar(0.01);
  model.updateMatrixWorld(true);
}
