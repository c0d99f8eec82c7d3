/** Pixels per pixel of the page, best first; the last goes without the light's shadow. */
const STEPS = [2, 1.5, 1, 0.75, 0.5];
/** Pictures that a judgement is made of, and the milliseconds after which fewer will do. */
const WINDOW = 30;
const ENOUGH = 600;
const FEWEST = 3;
/** A picture that takes longer is too slow, in milliseconds. */
const SLOW = 24;

/** Whether the pictures are drawn by the processor: then every pixel and every vertex counts. */
export function drawnInSoftware(): boolean {
  const context = document.createElement('canvas').getContext('webgl2');
  const names = context?.getExtension('WEBGL_debug_renderer_info');
  const name = names ? String(context?.getParameter(names.UNMASKED_RENDERER_WEBGL)) : '';
  context?.getExtension('WEBGL_lose_context')?.loseContext();
  return /swiftshader|llvmpipe|software|basic render/i.test(name);
}

/** Lowers the resolution on machines that cannot draw 60 pictures a second. */
export class Quality {
  private step = 0;
  private sum = 0;
  private count = 0;

  constructor(
    private readonly ratio: number,
    software: boolean,
  ) {
    while (this.step < STEPS.length - 1 && STEPS[this.step] > ratio) this.step++;
    if (software) this.step = STEPS.length - 1;
  }

  get pixelRatio(): number {
    return Math.min(STEPS[this.step], this.ratio);
  }

  get shadows(): boolean {
    return this.step < STEPS.length - 1;
  }

  /** Takes the time from one picture to the next; returns whether the quality has changed. */
  took(milliseconds: number): boolean {
    this.sum += milliseconds;
    this.count++;
    if (this.count < WINDOW && (this.sum < ENOUGH || this.count < FEWEST)) return false;
    const slow = this.sum / this.count > SLOW;
    this.sum = this.count = 0;
    if (!slow || this.step === STEPS.length - 1) return false;
    this.step++;
    return true;
  }
}
