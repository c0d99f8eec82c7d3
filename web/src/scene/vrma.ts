import { type VRMAnimation, VRMAnimationLoaderPlugin } from '@pixiv/three-vrm-animation';
import { type KeyframeTrack, Quaternion, Vector3 } from 'three';
import type { SkeletonJson } from '../api/types';
import { Dance } from '../motion/dance';
import type { Skeleton } from '../motion/skeleton';
import { VRM_BONES } from './bones';
import { readGltf } from './gltf';

const FPS = 60;
/** Longest animation that is read, in seconds. */
const LONGEST = 3600;
/** Height of the feet of somebody who stands, in metres. */
const STANDING = 0.015;

/** Reads a VRM animation as a motion of `skeleton`, as tall as that is. */
export async function readAnimation(file: Blob, skeleton: Skeleton): Promise<Dance> {
  const gltf = await readGltf(file, (parser) => new VRMAnimationLoaderPlugin(parser));
  const [animation] = (gltf.userData.vrmAnimations ?? []) as VRMAnimation[];
  if (!animation || animation.humanoidTracks.rotation.size === 0)
    throw new Error('The file holds no animation of a humanoid.');
  if (animation.duration > LONGEST)
    throw new Error(`The animation is longer than ${LONGEST} seconds.`);
  return motion(animation, skeleton);
}

function motion(animation: VRMAnimation, skeleton: Skeleton): Dance {
  const { rotation, translation } = animation.humanoidTracks;
  const joints = skeleton.joints.map((joint) => sampler(rotation.get(VRM_BONES[joint] as never)));
  const hips = sampler(translation.get('hips'));
  const height = STANDING - Math.min(...skeleton.rest.map(([, y]) => y));
  const scale = height / (animation.restHipsPosition.y || 1);
  const frames = Math.max(Math.round(animation.duration * FPS), 1);
  const count = joints.length;
  const positions = new Float32Array(frames * count * 3);
  const rotations = new Float32Array(frames * count * 4);
  const root = new Float32Array(frames * 3);
  for (let frame = 0; frame < frames; frame++) {
    const time = frame / FPS;
    const place = hips?.(time).map((value) => value * scale) ?? [0, height, 0];
    root.set(place, frame * 3);
    joints.forEach((sample, joint) => {
      rotations.set(sample?.(time) ?? [0, 0, 0, 1], (frame * count + joint) * 4);
    });
    forward(skeleton, root, rotations, positions, frame);
  }
  const { parents, offsets } = skeleton;
  const json: SkeletonJson = { joints: skeleton.joints, parents, offsets };
  return Dance.of({ seed: 0, fps: FPS, frames, skeleton: json, positions, rotations, root });
}

type Sampler = (time: number) => number[];

function sampler(track: KeyframeTrack | undefined): Sampler | null {
  if (!track) return null;
  const between = track.InterpolantFactoryMethodLinear(undefined as never);
  return (time) => Array.from(between.evaluate(time) as ArrayLike<number>);
}

const turn = new Quaternion();
const offset = new Vector3();

/** Writes the positions of a frame's joints. */
function forward(
  skeleton: Skeleton,
  root: Float32Array,
  rotations: Float32Array,
  positions: Float32Array,
  frame: number,
): void {
  const count = skeleton.joints.length;
  const world: Quaternion[] = [];
  for (let joint = 0; joint < count; joint++) {
    const at = frame * count + joint;
    turn.fromArray(rotations, at * 4);
    const parent = skeleton.parents[joint];
    const above = world[parent];
    if (above) {
      offset.fromArray(skeleton.offsets[joint]).applyQuaternion(above);
      const from = (frame * count + parent) * 3;
      offset.x += positions[from];
      offset.y += positions[from + 1];
      offset.z += positions[from + 2];
    } else offset.fromArray(root, frame * 3);
    offset.toArray(positions, at * 3);
    world.push(above ? above.clone().multiply(turn) : turn.clone());
  }
}
