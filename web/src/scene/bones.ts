import type { Object3D } from 'three';

/** Joint → bone of the VRM humanoid. */
export const VRM_BONES: Record<string, string> = {
  pelvis: 'hips',
  spine1: 'spine',
  spine2: 'chest',
  spine3: 'upperChest',
  neck: 'neck',
  head: 'head',
  l_collar: 'leftShoulder',
  l_shoulder: 'leftUpperArm',
  l_elbow: 'leftLowerArm',
  l_wrist: 'leftHand',
  r_collar: 'rightShoulder',
  r_shoulder: 'rightUpperArm',
  r_elbow: 'rightLowerArm',
  r_wrist: 'rightHand',
  l_hip: 'leftUpperLeg',
  l_knee: 'leftLowerLeg',
  l_ankle: 'leftFoot',
  l_foot: 'leftToes',
  r_hip: 'rightUpperLeg',
  r_knee: 'rightLowerLeg',
  r_ankle: 'rightFoot',
  r_foot: 'rightToes',
};

/** Names that a bone has in Mixamo, Unreal, Blender and SMPL rigs, in lower case without marks. */
const NAMES: Record<string, string[]> = {
  pelvis: ['hips', 'pelvis', 'hip'],
  spine1: ['spine', 'spine01', 'spine1'],
  spine2: ['spine1', 'spine02', 'chest', 'spine2'],
  spine3: ['spine2', 'spine03', 'upperchest', 'spine3'],
  neck: ['neck', 'neck01'],
  head: ['head'],
  collar: ['shoulder', 'clavicle', 'collar'],
  shoulder: ['arm', 'upperarm', 'shoulder'],
  elbow: ['forearm', 'lowerarm', 'elbow'],
  wrist: ['hand', 'wrist'],
  hip: ['upleg', 'thigh', 'upperleg', 'hip'],
  knee: ['leg', 'calf', 'shin', 'lowerleg', 'knee'],
  ankle: ['foot', 'ankle'],
  foot: ['toebase', 'ball', 'toe', 'toes', 'foot'],
};

/** Finds the humanoid bones of a character by their names. */
export function bonesByName(root: Object3D, joints: string[]): Map<string, Object3D> {
  const nodes = new Map<string, Object3D>();
  root.traverse((node) => {
    const name = plain(node.name);
    if (!nodes.has(name)) nodes.set(name, node);
  });
  const found = new Map<string, Object3D>();
  const taken = new Set<Object3D>();
  for (const joint of joints) {
    const [, side, part] = /^(?:([lr])_)?(.*)$/.exec(joint) ?? [];
    const names = (NAMES[part] ?? []).flatMap((name) => sided(name, side));
    // Skeletons of the motion's own names first: there, `shoulder` is what others call `arm`.
    const candidates = [plain(joint), ...names].map((name) => nodes.get(name));
    const node = candidates.find((candidate) => candidate && !taken.has(candidate));
    if (!node) continue;
    found.set(joint, node);
    taken.add(node);
  }
  return found;
}

/** `mixamorig:LeftUpLeg` → `leftupleg`; `thigh_l`, `Thigh.L` → `thighl`. */
function plain(name: string): string {
  return name
    .toLowerCase()
    .replace(/^.*(mixamorig\d*|armature|def|bip0?1)[:_\- |]*/, '')
    .replace(/[^a-z0-9]/g, '');
}

function sided(name: string, side: string | undefined): string[] {
  if (!side) return [name];
  const long = side === 'l' ? 'left' : 'right';
  return [`${long}${name}`, `${name}${side}`, `${side}${name}`, `${name}${long}`];
}
