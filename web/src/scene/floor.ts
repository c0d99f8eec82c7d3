import { CircleGeometry, Color, Group, Mesh, ShaderMaterial, ShadowMaterial } from 'three';

const RADIUS = 9;

/** The floor: a disc with a grid of half metres that fades away, and what the key light shadows. */
export class Floor {
  readonly object = new Group();
  private readonly grid: ShaderMaterial;
  private readonly shade = new ShadowMaterial({ opacity: 0.2, depthWrite: false });

  constructor() {
    this.grid = new ShaderMaterial({
      transparent: true,
      depthWrite: false,
      uniforms: { base: { value: new Color() }, line: { value: new Color() } },
      vertexShader: `
        varying vec2 place;
        void main() {
          place = (modelMatrix * vec4(position, 1.0)).xz;
          gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
        }`,
      fragmentShader: `
        uniform vec3 base;
        uniform vec3 line;
        varying vec2 place;
        float lines(float spacing, float width) {
          vec2 at = abs(fract(place / spacing - 0.5) - 0.5) * spacing;
          vec2 soft = fwidth(place);
          vec2 hit = 1.0 - smoothstep(vec2(width), vec2(width) + soft * 1.5, at);
          return max(hit.x, hit.y) * clamp(0.02 / max(soft.x, soft.y), 0.0, 1.0);
        }
        void main() {
          float away = length(place);
          float fade = 1.0 - smoothstep(1.5, ${RADIUS.toFixed(1)}, away);
          float mark = max(lines(0.5, 0.001) * 0.45, lines(2.0, 0.003));
          vec3 colour = mix(base, line, mark);
          gl_FragColor = vec4(colour, fade * fade);
          #include <colorspace_fragment>
        }`,
    });
    const disc = new CircleGeometry(RADIUS, 48);
    const floor = new Mesh(disc, this.grid);
    const shade = new Mesh(disc, this.shade);
    shade.position.z = 0.001;
    shade.receiveShadow = true;
    this.object.add(floor, shade);
    this.object.rotation.x = -Math.PI / 2;
  }

  paint(base: string, line: string, shade: number): void {
    (this.grid.uniforms.base.value as Color).set(base);
    (this.grid.uniforms.line.value as Color).set(line);
    this.shade.opacity = shade;
  }
}
