import { floats } from '../api/lines';
import type { Codes, FramesEvent, Music, Numbers, StartEvent } from '../api/types';
import { Skeleton, type Pose } from './skeleton';

/** A whole motion, as `POST /generate` returns it with `include=rotations`. */
export type DanceJson = Omit<StartEvent, 'event'> & Omit<FramesEvent, 'event' | 'first' | 'count'>;

/** A motion that grows while it is streamed. */
export class Dance {
  readonly skeleton: Skeleton;
  readonly fps: number;
  /** Frames of the whole motion. */
  readonly frames: number;
  readonly seed: number;
  readonly style: string | undefined;
  music: Music | undefined;
  /** Its pose codes, once it is complete. */
  codes: Codes | null = null;
  /** Frames that have arrived. */
  available = 0;
  /** World positions `[frames][joints][3]`. */
  readonly positions: Float32Array;
  private readonly rotations: Float32Array;
  private readonly root: Float32Array;

  /** A motion that is complete. */
  static of(json: DanceJson): Dance {
    const dance = new Dance({ event: 'start', ...json });
    dance.append({ event: 'frames', first: 0, count: json.frames, ...json });
    return dance;
  }

  constructor(start: StartEvent) {
    this.skeleton = new Skeleton(start.skeleton);
    this.fps = start.fps;
    this.frames = start.frames;
    this.seed = start.seed;
    this.style = start.style;
    this.music = start.music;
    const joints = this.skeleton.joints.length;
    this.positions = new Float32Array(start.frames * joints * 3);
    this.rotations = new Float32Array(start.frames * joints * 4);
    this.root = new Float32Array(start.frames * 3);
  }

  /** Seconds of the whole motion. */
  get duration(): number {
    return this.frames / this.fps;
  }

  /** Seconds that have arrived. */
  get availableSeconds(): number {
    return this.available / this.fps;
  }

  append(frames: FramesEvent): void {
    const joints = this.skeleton.joints.length;
    const end = Math.min(frames.first + frames.count, this.frames);
    const put = (into: Float32Array, numbers: Numbers, width: number) => {
      const room = (end - frames.first) * width;
      const values = typeof numbers === 'string' ? floats(numbers) : flat(numbers);
      into.set(values.subarray(0, room), frames.first * width);
    };
    put(this.positions, frames.positions, joints * 3);
    put(this.rotations, frames.rotations, joints * 4);
    put(this.root, frames.root, 3);
    this.available = end;
  }

  /** Writes the pose at `time` into `pose`, between frames by interpolation. */
  sample(time: number, mirror: boolean, pose: Pose): void {
    const last = Math.max(this.available - 1, 0);
    const at = Math.min(Math.max(time * this.fps, 0), last);
    const first = Math.floor(at);
    const next = Math.min(first + 1, last);
    const part = at - first;
    for (let axis = 0; axis < 3; axis++) {
      const from = this.root[first * 3 + axis];
      pose.root[axis] = from + (this.root[next * 3 + axis] - from) * part;
    }
    if (mirror) pose.root[0] = -pose.root[0];
    const joints = this.skeleton.joints.length;
    for (let joint = 0; joint < joints; joint++) {
      const source = mirror ? this.skeleton.mirrored[joint] : joint;
      const from = (first * joints + source) * 4;
      const to = (next * joints + source) * 4;
      blend(this.rotations, from, to, part, pose.rotations, joint * 4);
      // A reflection at x = 0 keeps the turn about x and reverses the others.
      if (mirror) {
        pose.rotations[joint * 4 + 1] *= -1;
        pose.rotations[joint * 4 + 2] *= -1;
      }
    }
  }
}

function flat(numbers: Exclude<Numbers, string>): Float32Array {
  if (numbers instanceof Float32Array) return numbers;
  return Float32Array.from((numbers as number[][][]).flat(2));
}

/** Normalised linear interpolation of two quaternions, the short way. */
function blend(
  values: Float32Array,
  from: number,
  to: number,
  part: number,
  out: Float32Array,
  at: number,
): void {
  let dot = 0;
  for (let i = 0; i < 4; i++) dot += values[from + i] * values[to + i];
  const sign = dot < 0 ? -1 : 1;
  let length = 0;
  for (let i = 0; i < 4; i++) {
    const value = values[from + i] * (1 - part) + sign * values[to + i] * part;
    out[at + i] = value;
    length += value * value;
  }
  const scale = length > 0 ? 1 / Math.sqrt(length) : 1;
  for (let i = 0; i < 4; i++) out[at + i] *= scale;
}
