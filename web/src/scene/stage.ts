import {
  DirectionalLight,
  HemisphereLight,
  PCFShadowMap,
  Scene,
  Vector3,
  WebGLRenderer,
} from 'three';
import { ContactShadow } from './contact';
import type { Figure } from './figure';
import { Floor } from './floor';
import { drawnInSoftware, Quality } from './quality';
import { View } from './view';

/** Colours and lights of the light and the dark page. */
const LOOKS = {
  light: { floor: '#e9e6df', line: '#cfcabf', shade: 0.16, contact: 0.55, sky: 1.5, key: 2.3 },
  dark: { floor: '#1d2024', line: '#343a41', shade: 0.4, contact: 0.85, sky: 0.75, key: 2.4 },
};

export type Look = keyof typeof LOOKS;

/** The scene: floor, lights, dancers, camera. It draws only when something has changed. */
export class Stage {
  readonly view: View;
  /** Called before each picture with the time and the seconds since the last; true: keep going. */
  onframe: (now: number, seconds: number) => boolean = () => false;
  private readonly renderer: WebGLRenderer;
  private readonly scene = new Scene();
  private readonly floor = new Floor();
  private readonly sky = new HemisphereLight('#ffffff', '#b9b2a6', 1);
  private readonly key = new DirectionalLight('#fff4e6', 2);
  private readonly rim = new DirectionalLight('#bcd3ff', 0.9);
  /** Whether there is no graphics card: figures are coarser then. */
  readonly software: boolean;
  private readonly quality: Quality;
  private readonly shadows = new Map<Figure, ContactShadow>();
  private readonly centre = new Vector3();
  private readonly at = new Vector3();
  private look: Look = 'light';
  private pending = false;
  private moving = false;
  private last = 0;

  /** `film`: size of the pictures of a film, which take as long as they take. */
  constructor(
    private readonly canvas: HTMLCanvasElement,
    private readonly film: { width: number; height: number } | null = null,
  ) {
    this.software = film === null && drawnInSoftware();
    this.quality = new Quality(film ? 1 : devicePixelRatio, this.software);
    this.renderer = new WebGLRenderer({ canvas, antialias: !this.software, alpha: true });
    this.renderer.shadowMap.enabled = true;
    this.renderer.shadowMap.type = PCFShadowMap;
    this.view = new View(canvas, () => this.invalidate());
    this.key.castShadow = true;
    this.key.shadow.mapSize.set(1024, 1024);
    this.key.shadow.radius = 4;
    this.key.shadow.bias = -0.0005;
    this.key.shadow.normalBias = 0.02;
    this.rim.position.set(-2, 3, -4);
    this.scene.add(this.floor.object, this.sky, this.key, this.key.target, this.rim);
    // The time in which a tab was hidden says nothing about the machine.
    document.addEventListener('visibilitychange', () => (this.moving = false));
    new ResizeObserver(() => this.resize()).observe(canvas.parentElement ?? canvas);
    this.resize();
    this.paint('light');
  }

  add(figure: Figure): void {
    const shadow = new ContactShadow(LOOKS[this.look].contact);
    this.shadows.set(figure, shadow);
    this.scene.add(figure.object, shadow.object);
    this.reframe();
  }

  remove(figure: Figure): void {
    this.shadows.get(figure)?.dispose();
    this.shadows.delete(figure);
    figure.dispose();
    this.reframe();
  }

  paint(look: Look): void {
    this.look = look;
    const { floor, line, shade, contact, sky, key } = LOOKS[look];
    this.floor.paint(floor, line, shade);
    this.sky.intensity = sky;
    this.key.intensity = key;
    this.rim.intensity = look === 'dark' ? 1.6 : 0.7;
    for (const shadow of this.shadows.values()) shadow.strength = contact;
    this.invalidate();
  }

  /** Asks for a picture. */
  invalidate(): void {
    if (this.pending || this.film) return;
    this.pending = true;
    requestAnimationFrame((now) => this.draw(now));
  }

  /** Draws a picture of a film at once, `seconds` after the last. */
  shoot(seconds: number): HTMLCanvasElement {
    this.follow(seconds);
    this.view.controls.update();
    this.renderer.render(this.scene, this.view.camera);
    return this.canvas;
  }

  /** Geometries and textures on the graphics card, for tests of leaks. */
  get memory(): { geometries: number; textures: number } {
    return this.renderer.info.memory;
  }

  private draw(now: number): void {
    this.pending = false;
    const seconds = this.moving ? Math.min((now - this.last) / 1000, 0.25) : 1 / 60;
    if (this.moving && this.quality.took(now - this.last)) this.resize();
    this.last = now;
    const more = this.onframe(now, seconds);
    this.follow(seconds);
    this.moving = this.view.controls.update() || more;
    this.renderer.render(this.scene, this.view.camera);
    if (this.moving) this.invalidate();
  }

  /** Lets shadows, light and camera follow the dancers. */
  private follow(seconds: number): void {
    this.centre.set(0, 0, 0);
    for (const [figure, shadow] of this.shadows) {
      shadow.follow(figure);
      this.centre.add(figure.joint('pelvis', this.at));
    }
    if (this.shadows.size === 0) return;
    this.centre.divideScalar(this.shadows.size);
    this.view.track(this.centre, seconds);
    this.key.target.position.set(this.centre.x, 0.8, this.centre.z);
    this.key.position.copy(this.key.target.position).add(this.at.set(2.2, 4.6, 2.8));
  }

  private reframe(): void {
    const count = Math.max(this.shadows.size, 1);
    this.view.frame(count);
    const camera = this.key.shadow.camera;
    const reach = 1.7 + (count - 1);
    [camera.left, camera.right, camera.top, camera.bottom] = [-reach, reach, reach, -reach];
    camera.near = 1;
    camera.far = 12;
    camera.updateProjectionMatrix();
    this.invalidate();
  }

  private resize(): void {
    const box = this.film ?? this.canvas.parentElement?.getBoundingClientRect();
    if (!box || box.width === 0) return;
    this.renderer.setPixelRatio(this.quality.pixelRatio);
    this.renderer.setSize(box.width, box.height);
    this.key.castShadow = this.quality.shadows;
    this.view.resize(box.width, box.height);
    this.invalidate();
  }
}
