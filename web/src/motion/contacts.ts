import type { Dance } from './dance';

/** Highest position of a foot on the floor, in metres. */
const HEIGHT = 0.05;
/** Highest speed of a foot that stands, in metres a second. */
const SPEED = 0.35;
/** Shortest contact that is shown, in seconds. */
const SHORTEST = 0.05;

/** A stretch of time in seconds: from, to. */
export type Span = [number, number];

/** The times in which each foot stands: what is drawn below the waveform. */
export function footContacts(dance: Dance): { left: Span[]; right: Span[] } {
  return { left: contacts(dance, 'l_foot'), right: contacts(dance, 'r_foot') };
}

function contacts(dance: Dance, joint: string): Span[] {
  const number = dance.skeleton.joints.indexOf(joint);
  if (number < 0) return [];
  const { positions, fps } = dance;
  const stride = dance.skeleton.joints.length * 3;
  const spans: Span[] = [];
  let since = -1;
  for (let frame = 0; frame <= dance.available; frame++) {
    const at = frame * stride + number * 3;
    // The speed of a frame is that of its step to the next one.
    const next = frame + 1 < dance.available ? at + stride : at;
    const step = Math.hypot(
      positions[next] - positions[at],
      positions[next + 1] - positions[at + 1],
      positions[next + 2] - positions[at + 2],
    );
    const inside = frame < dance.available;
    const stands = inside && positions[at + 1] < HEIGHT && step * fps < SPEED;
    if (stands && since < 0) since = frame;
    if (!stands && since >= 0) {
      if (frame - since >= SHORTEST * fps) spans.push([since / fps, frame / fps]);
      since = -1;
    }
  }
  return spans;
}
