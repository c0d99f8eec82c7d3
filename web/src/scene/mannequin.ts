import {
  Bone,
  BufferAttribute,
  BufferGeometry,
  Color,
  Matrix4,
  MeshStandardMaterial,
  type Object3D,
  Skeleton as Bones,
  SkinnedMesh,
  type Vector3,
} from 'three';
import type { Pose, Skeleton } from '../motion/skeleton';
import { type Body, bodyOf, BUILDS, type BuildName } from './body';
import { bodyDistance, partDistance } from './distance';
import type { Figure } from './figure';
import { mesh } from './surface';

/** Edge of the cells that the body is meshed with, in metres: fine and coarse. */
const CELLS = { fine: 0.017, coarse: 0.032 };
/** How far bones share the skin around a joint, in metres. */
const SHARE = 0.014;

/** How finely a body is meshed. */
export type Detail = keyof typeof CELLS;

/** Geometry of each build on each skeleton; there are few, for models share a skeleton. */
const shapes = new Map<string, BufferGeometry>();

/** A mannequin whose body is computed from the skeleton. */
export class Mannequin implements Figure {
  readonly object: SkinnedMesh;
  private readonly bones: Bone[];
  private readonly names: string[];
  private readonly geometry: BufferGeometry;
  private readonly material: MeshStandardMaterial;

  constructor(skeleton: Skeleton, build: BuildName, detail: Detail, skin: Color, accent: Color) {
    this.names = skeleton.joints;
    this.bones = skeleton.joints.map(() => new Bone());
    skeleton.offsets.forEach((offset, joint) => {
      if (joint > 0) this.bones[joint].position.fromArray(offset);
      this.bones[skeleton.parents[joint]]?.add(this.bones[joint]);
    });
    this.geometry = shape(skeleton, build, detail).clone();
    this.material = materialOf(skin, accent);
    this.object = new SkinnedMesh(this.geometry, this.material);
    this.object.add(this.bones[0]);
    // The rest pose is the bind pose.
    const inverses = skeleton.rest.map(([x, y, z]) => new Matrix4().makeTranslation(-x, -y, -z));
    this.object.bind(new Bones(this.bones, inverses), new Matrix4());
    this.object.castShadow = true;
    this.object.frustumCulled = false;
  }

  pose(pose: Pose): void {
    this.bones[0].position.fromArray(pose.root);
    this.bones.forEach((bone, joint) => bone.quaternion.fromArray(pose.rotations, joint * 4));
    this.object.updateMatrixWorld(true);
  }

  joint(name: string, into: Vector3): Vector3 {
    const bone: Object3D = this.bones[this.names.indexOf(name)] ?? this.object;
    return into.setFromMatrixPosition(bone.matrixWorld);
  }

  tick(): void {
    // Nothing swings.
  }

  dispose(): void {
    this.object.removeFromParent();
    this.object.skeleton.dispose();
    this.geometry.dispose();
    this.material.dispose();
  }
}

function shape(skeleton: Skeleton, build: BuildName, detail: Detail): BufferGeometry {
  const key = `${build} ${detail} ${skeleton.joints} ${skeleton.rest}`;
  const known =
    shapes.get(key) ?? geometryOf(bodyOf(skeleton, BUILDS[build]), skeleton, CELLS[detail]);
  shapes.set(key, known);
  return known;
}

function geometryOf(body: Body, skeleton: Skeleton, cell: number): BufferGeometry {
  const low = [0, 1, 2].map((axis) => Math.min(...skeleton.rest.map((p) => p[axis])) - 0.26);
  const high = [0, 1, 2].map((axis) => Math.max(...skeleton.rest.map((p) => p[axis])) + 0.26);
  const surface = mesh((x, y, z) => bodyDistance(body, x, y, z), low, high, cell);
  const geometry = new BufferGeometry();
  geometry.setAttribute('position', new BufferAttribute(surface.positions, 3));
  geometry.setAttribute('normal', new BufferAttribute(surface.normals, 3));
  geometry.setIndex(new BufferAttribute(surface.indices, 1));
  const { numbers, weights } = skinning(body, surface.positions, skeleton.joints.length);
  geometry.setAttribute('skinIndex', new BufferAttribute(numbers, 4));
  geometry.setAttribute('skinWeight', new BufferAttribute(weights, 4));
  geometry.setAttribute('mark', new BufferAttribute(marks(body, skeleton, surface.positions), 1));
  return geometry;
}

/** Gives each vertex the four joints whose parts are nearest, by how near they are. */
function skinning(body: Body, positions: Float32Array, joints: number) {
  const count = positions.length / 3;
  const numbers = new Uint16Array(count * 4);
  const weights = new Float32Array(count * 4);
  const parts = [...body.trunk, ...body.limbs.flat()];
  const distances = new Float32Array(joints);
  for (let vertex = 0; vertex < count; vertex++) {
    const [x, y, z] = positions.subarray(vertex * 3, vertex * 3 + 3);
    distances.fill(Infinity);
    for (const part of parts) {
      const distance = partDistance(part, x, y, z);
      if (distance < distances[part.joint]) distances[part.joint] = distance;
    }
    let nearest = 0;
    let sum = 0;
    for (let i = 0; i < 4; i++) {
      let joint = 0;
      for (let j = 1; j < joints; j++) if (distances[j] < distances[joint]) joint = j;
      if (i === 0) nearest = distances[joint];
      const share = Math.exp((nearest - distances[joint]) / SHARE);
      numbers[vertex * 4 + i] = joint;
      weights[vertex * 4 + i] = share;
      sum += share;
      distances[joint] = Infinity;
    }
    for (let i = 0; i < 4; i++) weights[vertex * 4 + i] /= sum;
  }
  return { numbers, weights };
}

/**
 * How far inside the accent's areas each vertex lies, in metres: hands, feet, and a visor, which
 * shows the heading.
 */
function marks(body: Body, skeleton: Skeleton, positions: Float32Array): Float32Array {
  const out = new Float32Array(positions.length / 3);
  const { centre, radius } = body.face;
  const ankle = skeleton.rest[skeleton.index('l_ankle')][1];
  const wrist = Math.abs(skeleton.rest[skeleton.index('l_wrist')][0]);
  for (let i = 0; i < out.length; i++) {
    const [x, y, z] = positions.subarray(i * 3, i * 3 + 3);
    const foot = ankle - y;
    const hand = Math.abs(x) - wrist - 0.006;
    const band = 0.021 - Math.abs(y - centre[1] - 0.018 + x * x * 1.5);
    const visor = Math.min(z - centre[2] - radius * 0.18, band, radius - Math.abs(x));
    out[i] = Math.max(foot, hand, visor);
  }
  return out;
}

/** Skin with the accent where the mark is above zero; the edge is as sharp as the picture. */
function materialOf(skin: Color, accent: Color): MeshStandardMaterial {
  const material = new MeshStandardMaterial({ color: skin, roughness: 0.58 });
  material.onBeforeCompile = (shader) => {
    shader.uniforms.accent = { value: accent };
    shader.vertexShader =
      `attribute float mark; varying float vMark;\n${shader.vertexShader}`.replace(
        '#include <begin_vertex>',
        '#include <begin_vertex>\nvMark = mark;',
      );
    shader.fragmentShader =
      `uniform vec3 accent; varying float vMark;\n${shader.fragmentShader}`.replace(
        '#include <color_fragment>',
        `#include <color_fragment>
        float edge = max(fwidth(vMark), 1e-5);
        diffuseColor.rgb = mix(diffuseColor.rgb, accent, smoothstep(-edge, edge, vMark));`,
      );
  };
  return material;
}
