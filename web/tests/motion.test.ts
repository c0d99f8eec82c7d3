import { Bone, Group, Object3D, Quaternion, Vector3 } from 'three';
import { expect, test } from 'vitest';
import { Dance } from '../src/motion/dance';
import { footContacts } from '../src/motion/contacts';
import { emptyPose, Skeleton, standingPose } from '../src/motion/skeleton';
import { bonesByName } from '../src/scene/bones';
import { bodyOf, BUILDS } from '../src/scene/body';
import { bodyDistance } from '../src/scene/distance';
import { Retarget } from '../src/scene/retarget';
import { mesh } from '../src/scene/surface';
import { REPEATS, shown, speeds } from '../src/memory/speed';
import fixture from '../../tests/fixtures/motion/skeleton.json';

const json = fixture as never as {
  joints: string[];
  parents: number[];
  offsets: [number, number, number][];
};
const skeleton = new Skeleton(json);

function packed(values: number[]): string {
  const bytes = new Uint8Array(Float32Array.from(values).buffer);
  return btoa(String.fromCharCode(...bytes));
}

/** A dance of which only the left foot moves, and the left arm turns. */
function dance(frames: number, rotation: (frame: number) => number[]): Dance {
  const start = { event: 'start', seed: 1, fps: 60, frames, skeleton: json } as const;
  const made = new Dance(start);
  const joints = json.joints.length;
  const arm = json.joints.indexOf('l_shoulder');
  const foot = json.joints.indexOf('l_foot');
  for (let frame = 0; frame < frames; frame++) {
    const rotations = Array.from({ length: joints }, (_, joint) =>
      joint === arm ? rotation(frame) : [0, 0, 0, 1],
    ).flat();
    const positions = new Array<number>(joints * 3).fill(0);
    positions[foot * 3 + 1] = frame < frames / 2 ? 0.01 : 0.3;
    made.append({
      event: 'frames',
      first: frame,
      count: 1,
      positions: packed(positions),
      rotations: packed(rotations),
      root: packed([frame, 1, 2]),
    });
  }
  return made;
}

test('poses between frames are interpolated, and never beyond what has arrived', () => {
  const turned = Math.SQRT1_2;
  const made = dance(2, (frame) => (frame === 0 ? [0, 0, 0, 1] : [0, 0, -turned, -turned]));
  const pose = emptyPose(24);
  made.sample(0.5 / 60, false, pose);
  const arm = skeleton.index('l_shoulder') * 4;
  expect(pose.root[0]).toBeCloseTo(0.5);
  // Half of a quarter turn, the short way although the signs differ.
  expect(pose.rotations[arm + 2]).toBeCloseTo(Math.sin(Math.PI / 8));
  made.sample(99, false, pose);
  expect(pose.root[0]).toBe(1);
});

test('a mirrored pose is the reflection of the pose', () => {
  const made = dance(1, () => [0.1, 0.2, 0.3, Math.sqrt(1 - 0.14)]);
  const pose = emptyPose(24);
  made.sample(0, true, pose);
  const at = (name: string) => {
    const joint = skeleton.index(name) * 4;
    return [...pose.rotations.subarray(joint, joint + 4)];
  };
  expect(at('l_shoulder')).toEqual([0, -0, -0, 1]);
  const [x, y, z, w] = at('r_shoulder');
  const direction = new Vector3(-1, 0, 0).applyQuaternion(new Quaternion(x, y, z, w));
  const given = new Quaternion(0.1, 0.2, 0.3, Math.sqrt(1 - 0.14));
  const original = new Vector3(1, 0, 0).applyQuaternion(given);
  expect(direction.x).toBeCloseTo(-original.x);
  expect(direction.y).toBeCloseTo(original.y);
  expect(direction.z).toBeCloseTo(original.z);
});

test('a foot stands where it is low and slow', () => {
  const { left, right } = footContacts(dance(60, () => [0, 0, 0, 1]));
  expect(left).toHaveLength(1);
  expect(left[0][0]).toBe(0);
  expect(left[0][1]).toBeCloseTo(0.5, 1);
  expect(right).toEqual([[0, 1]]);
});

test('the mannequin is closed and as tall as its skeleton', { timeout: 60_000 }, () => {
  const body = bodyOf(skeleton, BUILDS.female);
  const low = [-1, -1.4, -0.4];
  const made = mesh((x, y, z) => bodyDistance(body, x, y, z), low, [1, 1, 0.4], 0.03);
  const edges = new Map<string, number>();
  for (let i = 0; i < made.indices.length; i += 3) {
    for (let k = 0; k < 3; k++) {
      const [a, b] = [made.indices[i + k], made.indices[i + ((k + 1) % 3)]];
      edges.set(`${a} ${b}`, (edges.get(`${a} ${b}`) ?? 0) + 1);
    }
  }
  // Each edge is walked once in either direction.
  for (const [edge, count] of edges) {
    const back = edges.get(edge.split(' ').reverse().join(' '));
    expect(back, edge).toBe(count);
  }
  const heights = made.positions.filter((_, i) => i % 3 === 1);
  const top = Math.max(...heights);
  const head = skeleton.rest[skeleton.index('head')][1];
  expect(Math.min(...heights)).toBeCloseTo(body.floor, 2);
  expect(top - head).toBeGreaterThan(0.15);
  expect(top - head).toBeLessThan(0.25);
});

/** Another character: names of Mixamo, centimetres, arms down by 45°, bones with turned axes. */
function character(): Group {
  const names: Record<string, string> = {
    pelvis: 'Hips',
    spine1: 'Spine',
    spine2: 'Spine1',
    spine3: 'Spine2',
    neck: 'Neck',
    head: 'Head',
    l_shoulder: 'LeftArm',
    l_elbow: 'LeftForeArm',
    l_wrist: 'LeftHand',
    r_shoulder: 'RightArm',
    r_elbow: 'RightForeArm',
    r_wrist: 'RightHand',
    l_hip: 'LeftUpLeg',
    l_knee: 'LeftLeg',
    l_ankle: 'LeftFoot',
    r_hip: 'RightUpLeg',
    r_knee: 'RightLeg',
    r_ankle: 'RightFoot',
  };
  const root = new Group();
  const lowest = Math.min(...skeleton.rest.map(([, y]) => y));
  const made = new Map<number, Object3D>();
  skeleton.joints.forEach((joint, i) => {
    if (!names[joint]) return;
    let above = skeleton.parents[i];
    while (above >= 0 && !made.has(above)) above = skeleton.parents[above];
    const bone = new Bone();
    bone.name = `mixamorig${names[joint]}`;
    const place = new Vector3(...skeleton.rest[i]).setY(skeleton.rest[i][1] - lowest);
    const side = joint.startsWith('l_') ? 1 : -1;
    if (/elbow|wrist/.test(joint)) {
      const pivot = new Vector3(...skeleton.rest[skeleton.index(`${joint[0]}_shoulder`)]);
      pivot.y -= lowest;
      place
        .sub(pivot)
        .applyAxisAngle(new Vector3(0, 0, 1), (-side * Math.PI) / 4)
        .add(pivot);
    }
    root.add(bone);
    bone.position.copy(place);
    bone.rotation.set(0.3 * i, 0.2, -0.1 * i);
    bone.updateMatrixWorld(true);
    made.get(above)?.attach(bone);
    made.set(i, bone);
  });
  return root;
}

test('another character points its limbs where the motion does', () => {
  const root = character();
  const bones = bonesByName(root, skeleton.joints);
  expect(bones.get('l_shoulder')?.name).toBe('mixamorigLeftArm');
  expect(bones.get('r_knee')?.name).toBe('mixamorigRightLeg');
  const retarget = new Retarget(skeleton, root, bones);
  const pose = standingPose(skeleton);
  retarget.pose(pose);
  const place = (name: string) => bones.get(name)!.getWorldPosition(new Vector3());
  const upper = place('l_elbow').sub(place('l_shoulder')).normalize();
  const lower = place('r_ankle').sub(place('r_knee')).normalize();
  // Collar 6° and shoulder 66° down; the skeleton's own arm hangs by a few degrees more.
  expect((Math.asin(-upper.y) * 180) / Math.PI).toBeGreaterThan(69);
  expect((Math.asin(-upper.y) * 180) / Math.PI).toBeLessThan(78);
  expect(lower.y).toBeLessThan(-0.99);
  expect(place('pelvis').y).toBeCloseTo(pose.root[1], 1);
});

test('a held pair is measured in its middle, a change where it is fastest', () => {
  const frames = 2 * REPEATS * 8;
  const made = dance(frames, () => [0, 0, 0, 1]);
  const joints = json.joints.length;
  // All joints rise at 0.6 m/s before the change, and stand after it; in it they leap by 10 cm.
  for (let frame = 0; frame < frames; frame++) {
    const height = frame < frames / 2 ? frame * 0.01 : (frames / 2) * 0.01 + 0.1;
    for (let joint = 0; joint < joints; joint++)
      made.positions.set([0, height, 0], (frame * joints + joint) * 3);
  }
  const { held, change } = speeds(made);
  expect(held[0]).toBeCloseTo(0.6, 4);
  expect(held[1]).toBeCloseTo(0, 4);
  expect(change).toBeCloseTo(6.6, 3);
  expect(speeds(dance(REPEATS * 8, () => [0, 0, 0, 1])).change).toBeNull();
  expect(shown(2)).toEqual([32 / 60, 160 / 60]);
});

test('a dance in a file is that of a stream, in numbers or packed', () => {
  const numbers = (width: number) => [json.joints.map((_, i) => Array(width).fill(i / 8))];
  const flat = (values: number[][][]) => packed(values.flat(2));
  const head = { seed: 1, fps: 60, frames: 1, skeleton: json };
  const [positions, rotations, root] = [numbers(3), numbers(4), [[1, 2, 3]]];
  const written = Dance.of({ ...head, positions, rotations, root });
  const text = { positions: flat(positions), rotations: flat(rotations), root: packed(root[0]) };
  expect(Dance.of({ ...head, ...text })).toEqual(written);
  expect(written.available).toBe(1);
  expect([...written.positions.slice(3, 6)]).toEqual([0.125, 0.125, 0.125]);
});
