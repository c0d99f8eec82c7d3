import { PerspectiveCamera, Vector3 } from 'three';
import { OrbitControls } from 'three/addons/controls/OrbitControls.js';

const FIELD = 32;
/** Height that the camera looks at, and of the person in the picture, in metres. */
const MIDDLE = 0.92;
const TALL = 2.25;
/** Metres between dancers side by side. */
export const SPACING = 2;

/** The camera: the user orbits it; on request it follows the dancers. */
export class View {
  readonly camera = new PerspectiveCamera(FIELD, 1, 0.1, 60);
  readonly controls: OrbitControls;
  follow = true;
  private dancers = 1;
  private readonly move = new Vector3();

  constructor(element: HTMLElement, onchange: () => void) {
    this.controls = new OrbitControls(this.camera, element);
    this.controls.enablePan = true;
    this.controls.minDistance = 1.2;
    this.controls.maxDistance = 14;
    this.controls.maxPolarAngle = Math.PI / 2 - 0.02;
    this.controls.enableDamping = !matchMedia('(prefers-reduced-motion: reduce)').matches;
    this.controls.addEventListener('change', onchange);
    this.reset();
  }

  resize(width: number, height: number): void {
    this.camera.aspect = width / Math.max(height, 1);
    this.camera.updateProjectionMatrix();
  }

  /** Looks at so many dancers from the front, a little to the side. */
  frame(dancers: number): void {
    if (dancers === this.dancers) return;
    this.dancers = dancers;
    this.reset();
  }

  reset(): void {
    const target = this.controls.target;
    target.set(this.follow ? target.x : 0, MIDDLE, this.follow ? target.z : 0);
    // Several dancers from the front: none is nearer than the others.
    this.look(this.dancers > 1 ? 0.1 : 0.32, 1.38);
  }

  /** Looks from `around` the dancers in radians, 0 from the front, and `down` from the zenith. */
  look(around: number, down: number): void {
    // Several dancers wander further than one whom the camera follows.
    const several = this.dancers > 1 ? 1 : 0;
    const across = TALL * 0.8 + (this.dancers - 1) * SPACING + several;
    const half = Math.tan((FIELD * Math.PI) / 360);
    const distance = Math.max(TALL / 2 / half, across / 2 / half / this.camera.aspect) + 0.4;
    const target = this.controls.target;
    this.camera.position.setFromSphericalCoords(distance, down, around).add(target);
    this.controls.update();
  }

  /** Moves towards `centre` as far as `seconds` allow. */
  track(centre: Vector3, seconds: number): void {
    if (!this.follow) return;
    const share = 1 - Math.exp(-seconds * 2.5);
    this.move.copy(centre).sub(this.controls.target).multiplyScalar(share);
    this.move.y = 0;
    this.controls.target.add(this.move);
    this.camera.position.add(this.move);
  }

  /** Turns and zooms by keys. */
  nudge(around: number, down: number, closer: number): void {
    const target = this.controls.target;
    const offset = this.camera.position.clone().sub(target);
    const distance = Math.min(Math.max(offset.length() * closer, 1.2), 14);
    const angle = Math.atan2(offset.x, offset.z) + around;
    const height = Math.acos(offset.y / offset.length()) + down;
    const polar = Math.min(Math.max(height, 0.1), Math.PI / 2 - 0.02);
    this.camera.position.setFromSphericalCoords(distance, polar, angle).add(target);
    this.controls.update();
  }
}
