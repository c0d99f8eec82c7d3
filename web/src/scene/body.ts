import type { Skeleton } from '../motion/skeleton';

type Point = [number, number, number];

/** A part of the body: a cone with round ends from `a` to `b`, that one joint moves. */
export interface Part {
  joint: number;
  a: Point;
  b: Point;
  /** Radii at `a` and `b`. */
  ra: number;
  rb: number;
  /** Stretch of the cross-section along x and z. */
  width: number;
  depth: number;
}

/** Limbs, each a smooth union of parts; limbs join the trunk, not one another. */
export interface Body {
  trunk: Part[];
  limbs: Part[][];
  /** Height of the soles. */
  floor: number;
  /** Centre and radius of the face. */
  face: { centre: Point; radius: number };
}

/** Proportions: factors of the shapes below. */
export interface Build {
  shoulders: number;
  chest: number;
  waist: number;
  hips: number;
  limbs: number;
}

export const BUILDS = {
  female: { shoulders: 0.94, chest: 0.95, waist: 0.93, hips: 1.08, limbs: 0.92 },
  male: { shoulders: 1.14, chest: 1.1, waist: 1.08, hips: 0.98, limbs: 1.05 },
} satisfies Record<string, Build>;

export type BuildName = keyof typeof BUILDS;

/** Lays the parts of a body along a rest skeleton. */
export function bodyOf(skeleton: Skeleton, build: Build): Body {
  const at = (name: string): Point => [...skeleton.rest[skeleton.index(name)]];
  const part = (
    joint: string,
    a: Point,
    b: Point,
    ra: number,
    rb: number,
    flat = [1, 1],
  ): Part => ({
    joint: skeleton.index(joint),
    a,
    b,
    ra,
    rb,
    width: flat[0],
    depth: flat[1],
  });
  const floor = Math.min(at('l_foot')[1], at('r_foot')[1]) - 0.015;
  const limb = build.limbs;
  const arm = (side: 'l' | 'r'): Part[] => {
    const sign = side === 'l' ? 1 : -1;
    const [shoulder, elbow, wrist, hand] = ['shoulder', 'elbow', 'wrist', 'hand'].map((name) =>
      at(`${side}_${name}`),
    );
    const tip = add(hand, [sign * 0.075, -0.004, 0.004]);
    const thumb = add(wrist, [sign * 0.035, -0.004, 0.022]);
    const r = 0.054 * limb;
    return [
      part(`${side}_shoulder`, shoulder, elbow, r * build.shoulders ** 0.5, 0.039 * limb),
      part(`${side}_elbow`, elbow, mix(elbow, wrist, 0.3), 0.037 * limb, 0.04 * limb),
      part(`${side}_elbow`, mix(elbow, wrist, 0.3), wrist, 0.04 * limb, 0.027 * limb),
      part(`${side}_wrist`, wrist, hand, 0.026, 0.03, [1, 1.25]),
      part(`${side}_wrist`, hand, tip, 0.027, 0.014, [1, 1.35]),
      part(`${side}_wrist`, thumb, add(thumb, [sign * 0.05, -0.008, 0.03]), 0.016, 0.011),
    ];
  };
  const leg = (side: 'l' | 'r'): Part[] => {
    const sign = side === 'l' ? 1 : -1;
    const [hip, knee, ankle, foot] = ['hip', 'knee', 'ankle', 'foot'].map((name) =>
      at(`${side}_${name}`),
    );
    const top = add(hip, [sign * 0.026, -0.02, 0.004]);
    const calf = add(mix(knee, ankle, 0.28), [sign * 0.004, 0, -0.016]);
    const heel: Point = [ankle[0], floor + 0.036, ankle[2] - 0.034];
    const ball: Point = [foot[0], floor + 0.034, foot[2] + 0.004];
    const toes: Point = [foot[0] + sign * 0.006, floor + 0.026, foot[2] + 0.068];
    return [
      part(`${side}_hip`, top, knee, 0.083 * limb * build.hips ** 0.5, 0.052 * limb),
      part(`${side}_knee`, knee, calf, 0.05 * limb, 0.054 * limb),
      part(`${side}_knee`, calf, ankle, 0.054 * limb, 0.034 * limb),
      part(`${side}_ankle`, ankle, heel, 0.034, 0.034),
      part(`${side}_ankle`, add(ankle, [0, -0.015, 0.01]), ball, 0.036, 0.034, [1.1, 1]),
      part(`${side}_foot`, ball, toes, 0.034, 0.025, [1.25, 1]),
    ];
  };
  const [pelvis, spine1, spine2, spine3, neck, head] = [
    'pelvis',
    'spine1',
    'spine2',
    'spine3',
    'neck',
    'head',
  ].map(at);
  const shoulder = (side: 'l' | 'r', sign: number): Part => {
    const outer = add(at(`${side}_shoulder`), [-sign * 0.008, -0.01, 0]);
    const inner = add(neck, [sign * 0.03, -0.05, 0.008]);
    return part(`${side}_collar`, inner, outer, 0.05, 0.052 * build.shoulders, [1, 1.1]);
  };
  const { chest, waist, hips } = build;
  const across = (joint: string, centre: Point, half: number, radius: number, flat: number[]) =>
    part(joint, add(centre, [-half, 0, 0]), add(centre, [half, 0, 0]), radius, radius, flat);
  const trunk = [
    across('pelvis', add(pelvis, [0, -0.045, -0.014]), 0.048 * hips, 0.096 * hips, [1, 0.96]),
    part(
      'spine1',
      add(pelvis, [0, 0.04, -0.008]),
      add(spine1, [0, 0.03, 0.014]),
      0.102 * waist,
      0.09 * waist,
      [1.2, 0.95],
    ),
    part(
      'spine2',
      add(spine1, [0, 0.05, 0.014]),
      add(spine2, [0, 0.02, 0.002]),
      0.09 * waist,
      0.1 * chest,
      [1.22, 0.92],
    ),
    across('spine3', add(spine3, [0, 0.005, 0.008]), 0.044 * chest, 0.098 * chest, [1, 0.9]),
    across('spine3', add(neck, [0, -0.105, 0.01]), 0.082 * build.shoulders, 0.078 * chest, [1, 1]),
    shoulder('l', 1),
    shoulder('r', -1),
  ];
  const centre = add(head, [0, 0.083, 0.018]);
  const skull = [
    part(
      'neck',
      add(neck, [0, -0.02, 0]),
      add(head, [0, 0.01, -0.012]),
      0.053 * limb,
      0.049 * limb,
    ),
    part(
      'head',
      add(centre, [0, 0.03, -0.012]),
      add(centre, [0, -0.03, 0.006]),
      0.088,
      0.07,
      [0.88, 1.04],
    ),
    part(
      'head',
      add(centre, [0, -0.03, 0.012]),
      add(centre, [0, -0.062, 0.034]),
      0.066,
      0.04,
      [0.94, 1],
    ),
  ];
  return {
    trunk,
    limbs: [skull, arm('l'), arm('r'), leg('l'), leg('r')],
    floor,
    face: { centre, radius: 0.1 },
  };
}

function add(a: Point, b: Point): Point {
  return [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
}

function mix(a: Point, b: Point, part: number): Point {
  return [a[0] + (b[0] - a[0]) * part, a[1] + (b[1] - a[1]) * part, a[2] + (b[2] - a[2]) * part];
}
