import { Mesh, PlaneGeometry, ShaderMaterial, Vector3, Vector4 } from 'three';
import type { Figure } from './figure';

/** What stands between the sky and the floor: joints, and radii in metres. */
const SPHERES: [string, number][] = [
  ['l_foot', 0.055],
  ['r_foot', 0.055],
  ['l_ankle', 0.055],
  ['r_ankle', 0.055],
  ['l_knee', 0.075],
  ['r_knee', 0.075],
  ['l_hip', 0.12],
  ['r_hip', 0.12],
  ['spine2', 0.14],
  ['neck', 0.13],
  ['head', 0.1],
  ['l_elbow', 0.05],
  ['r_elbow', 0.05],
  ['l_wrist', 0.05],
  ['r_wrist', 0.05],
];
/** Edge of the square that is shaded, in metres. */
const SIZE = 3.2;

/**
 * Soft contact shadow of a figure: the share of the sky that spheres around its joints hide from
 * each point of the floor. It needs no second picture of the scene.
 */
export class ContactShadow {
  readonly object: Mesh<PlaneGeometry, ShaderMaterial>;
  private readonly spheres = SPHERES.map(([, radius]) => new Vector4(0, 10, 0, radius));
  private readonly at = new Vector3();

  constructor(strength: number) {
    const material = new ShaderMaterial({
      transparent: true,
      depthWrite: false,
      uniforms: { spheres: { value: this.spheres }, strength: { value: strength } },
      vertexShader: `
        varying vec3 place;
        void main() {
          vec4 world = modelMatrix * vec4(position, 1.0);
          place = world.xyz;
          gl_Position = projectionMatrix * viewMatrix * world;
        }`,
      fragmentShader: `
        uniform vec4 spheres[${SPHERES.length}];
        uniform float strength;
        varying vec3 place;
        void main() {
          float open = 1.0;
          for (int i = 0; i < ${SPHERES.length}; i++) {
            vec3 to = spheres[i].xyz - place;
            float away = dot(to, to);
            float up = max(to.y, 0.0) * inversesqrt(away);
            open *= 1.0 - clamp(up * spheres[i].w * spheres[i].w / away, 0.0, 0.92);
          }
          gl_FragColor = vec4(0.0, 0.0, 0.0, (1.0 - open) * strength);
        }`,
    });
    this.object = new Mesh(new PlaneGeometry(SIZE, SIZE), material);
    this.object.rotation.x = -Math.PI / 2;
    this.object.position.y = 0.002;
    this.object.renderOrder = 1;
  }

  set strength(strength: number) {
    this.object.material.uniforms.strength.value = strength;
  }

  /** Follows the figure's last pose. */
  follow(figure: Figure): void {
    SPHERES.forEach(([name], i) => {
      const { x, y, z } = figure.joint(name, this.at);
      this.spheres[i].set(x, y, z, this.spheres[i].w);
    });
    const hips = figure.joint('pelvis', this.at);
    this.object.position.set(hips.x, this.object.position.y, hips.z);
  }

  dispose(): void {
    this.object.removeFromParent();
    this.object.geometry.dispose();
    this.object.material.dispose();
  }
}
