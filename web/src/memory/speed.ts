import type { Dance } from '../motion/dance';

/** Pairs that a preview repeats each of its two: the decoder sees no end in their middle. */
export const REPEATS = 12;
/** Frames of a pair. */
const FRAMES = 8;
/** Pairs in the middle of a run, over which its rest is measured, and around a change. */
const MIDDLE = 4;

/** Mean speeds of all joints in metres a second. */
export interface Speeds {
  /** While each pair is held. */
  held: number[];
  /** The fastest frame between them; none of a pair alone. */
  change: number | null;
}

/** Measures a preview: one or two pairs, each repeated. */
export function speeds(dance: Dance): Speeds {
  const pairs = Math.round(dance.available / FRAMES / REPEATS);
  const middle = (pair: number) => (pair + 0.5) * REPEATS * FRAMES;
  const half = (MIDDLE / 2) * FRAMES;
  const held = Array.from({ length: pairs }, (_, pair) => {
    const found = between(dance, middle(pair) - half, middle(pair) + half);
    return found.reduce((sum, speed) => sum + speed, 0) / Math.max(found.length, 1);
  });
  const edge = REPEATS * FRAMES;
  const change = pairs < 2 ? null : Math.max(...between(dance, edge - half, edge + half));
  return { held, change };
}

/** The part of a preview that is shown: without its ends, which the decoder takes for rests. */
export function shown(pairs: number): [number, number] {
  const all = pairs * REPEATS * FRAMES;
  const away = ((REPEATS - MIDDLE) / 2) * FRAMES;
  return [away / 60, (all - away) / 60];
}

/** The mean speed of the joints in each frame of a range. */
function between(dance: Dance, from: number, to: number): number[] {
  const joints = dance.skeleton.joints.length;
  const { positions, fps } = dance;
  return Array.from({ length: Math.max(to - from, 0) }, (_, i) => {
    let sum = 0;
    for (let joint = 0; joint < joints; joint++) {
      const at = ((from + i) * joints + joint) * 3;
      const next = at + joints * 3;
      sum += Math.hypot(
        positions[next] - positions[at],
        positions[next + 1] - positions[at + 1],
        positions[next + 2] - positions[at + 2],
      );
    }
    return (sum / joints) * fps;
  });
}
