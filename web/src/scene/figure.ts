import type { Object3D, Vector3 } from 'three';
import type { Pose } from '../motion/skeleton';

/** A character that takes poses of the motion's skeleton. */
export interface Figure {
  readonly object: Object3D;
  /** Takes a pose, in metres, standing on y = 0. */
  pose(pose: Pose): void;
  /** World position of a joint by its name in the skeleton, after the last pose. */
  joint(name: string, into: Vector3): Vector3;
  /** Moves what swings: hair, clothes. `seconds` since the last call. */
  tick(seconds: number): void;
  dispose(): void;
}
