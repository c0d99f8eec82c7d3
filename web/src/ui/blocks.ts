import type { Codes } from '../api/types';
import { type Block, type Half, HALVES, runs } from '../edit/codes';
import { byId } from './dom';

/** Room for the names of the rows, in pixels; as in the timeline. */
const GUTTER = 18;
/** Pixels of a pair: its number can be read. */
const PAIR = 19;
/** Widest strip in pixels that browsers draw; longer dances get narrower pairs. */
const WIDEST = 16_000;
const ROW = 18;
const GAP = 3;

/** The codes of a dance as blocks: a row for each half of the body. */
export class Blocks {
  onselect: (block: Block | null) => void = () => undefined;
  private readonly element = byId('blocks');
  private readonly canvas = this.element.querySelector('canvas') as HTMLCanvasElement;
  private readonly head = this.element.querySelector('i') as HTMLElement;
  private codes: Codes = { upper: [], lower: [] };
  private total = 1;
  private block: Block | null = null;
  private anchor: { half: number; pair: number; dragged: boolean } | null = null;

  constructor() {
    this.element.addEventListener('pointerdown', (event) => this.down(event));
    this.element.addEventListener('pointermove', (event) => this.moved(event));
    for (const name of ['pointerup', 'pointercancel'])
      this.element.addEventListener(name, () => (this.anchor = null));
    this.element.addEventListener('keydown', (event) => this.key(event));
    new ResizeObserver(() => this.draw()).observe(this.element);
    matchMedia('(prefers-color-scheme: dark)').addEventListener('change', () => this.draw());
  }

  /** Shows codes of a dance that lasts `pairs` of them, which need not be whole. */
  show(codes: Codes, pairs: number): void {
    this.codes = codes;
    this.total = Math.max(pairs, 1);
    this.draw();
  }

  select(block: Block | null): void {
    this.block = block;
    this.draw();
    this.onselect(block);
  }

  /** Moves the playhead, and the strip with it unless a block is chosen. */
  setTime(pair: number): void {
    const x = GUTTER + Math.min(pair / this.total, 1) * this.wide;
    this.head.style.transform = `translateX(${x}px)`;
    if (!this.block) this.element.scrollLeft = x - this.element.clientWidth / 2;
  }

  /** Pixels of the whole dance. */
  private get wide(): number {
    const least = this.element.clientWidth - GUTTER;
    return Math.max(least, Math.min(this.total * PAIR, WIDEST));
  }

  private place(event: PointerEvent): { half: number; pair: number } {
    const box = this.canvas.getBoundingClientRect();
    const part = (event.clientX - box.left - GUTTER) / this.wide;
    const last = this.codes.upper.length - 1;
    const pair = Math.min(Math.max(Math.floor(part * this.total), 0), last);
    return { half: event.clientY - box.top < ROW + GAP / 2 ? 0 : 1, pair };
  }

  private down(event: PointerEvent): void {
    if (this.codes.upper.length === 0 || event.button !== 0) return;
    this.element.setPointerCapture(event.pointerId);
    const { half, pair } = this.place(event);
    this.anchor = { half, pair, dragged: false };
    this.select(this.run(HALVES[half], pair));
  }

  /** Dragging selects a range; over both rows, of both halves. */
  private moved(event: PointerEvent): void {
    if (!this.anchor) return;
    const { half, pair } = this.place(event);
    const still = pair === this.anchor.pair && half === this.anchor.half;
    if (still && !this.anchor.dragged) return;
    this.anchor.dragged = true;
    const halves = half === this.anchor.half ? [HALVES[half]] : HALVES;
    const [from, to] = [Math.min(pair, this.anchor.pair), Math.max(pair, this.anchor.pair) + 1];
    this.select({ from, to, halves });
  }

  private run(half: Half, pair: number): Block | null {
    return runs(this.codes, half).find(({ from, to }) => pair >= from && pair < to) ?? null;
  }

  private key(event: KeyboardEvent): void {
    const block = this.block ?? this.run('upper', 0);
    if (!block) return;
    const half = block.halves[0];
    const actions: Record<string, () => Block | null> = {
      ArrowLeft: () => this.run(half, block.from - 1),
      ArrowRight: () => this.run(half, block.to),
      ArrowUp: () => this.run('upper', block.from),
      ArrowDown: () => this.run('lower', block.from),
      Escape: () => null,
    };
    const action = actions[event.key];
    if (!action) return;
    event.preventDefault();
    event.stopPropagation();
    const next = action();
    if (!next && event.key !== 'Escape') return;
    this.select(next);
    if (next) this.reveal(next);
  }

  private reveal(block: Block): void {
    const middle = (this.x(block.from) + this.x(block.to)) / 2;
    const { scrollLeft, clientWidth } = this.element;
    if (middle < scrollLeft || middle > scrollLeft + clientWidth)
      this.element.scrollLeft = middle - clientWidth / 2;
  }

  private draw(): void {
    const context = this.canvas.getContext('2d');
    if (!context || this.element.clientWidth === 0) return;
    const [width, height] = [GUTTER + this.wide, 2 * ROW + GAP];
    this.canvas.style.width = `${width}px`;
    const ratio = Math.min(devicePixelRatio, 2);
    this.canvas.width = Math.round(width * ratio);
    this.canvas.height = Math.round(height * ratio);
    context.scale(ratio, ratio);
    const style = getComputedStyle(this.element);
    context.font = '9px system-ui, sans-serif';
    context.textBaseline = 'middle';
    HALVES.forEach((half, row) => {
      const y = row * (ROW + GAP);
      context.fillStyle = style.getPropertyValue('--quiet');
      context.fillText(half[0].toUpperCase(), 4, y + ROW / 2 + 0.5);
      for (const run of runs(this.codes, half)) this.paint(context, run, half, y);
      const { block } = this;
      if (!block?.halves.includes(half)) return;
      context.strokeStyle = style.color;
      context.lineWidth = 2.5;
      const from = this.x(block.from);
      context.strokeRect(from + 1, y + 1, Math.max(this.x(block.to) - from - 2.5, 1), ROW - 2);
    });
  }

  private x(pair: number): number {
    return GUTTER + (Math.min(pair, this.total) / this.total) * this.wide;
  }

  private paint(context: CanvasRenderingContext2D, run: Block, half: Half, y: number): void {
    const [from, to] = [this.x(run.from), this.x(run.to)];
    const code = this.codes[half][run.from];
    // Neighbouring numbers get hues far apart.
    context.fillStyle = `hsl(${(code * 137.5) % 360} 38% 58%)`;
    context.fillRect(from, y, Math.max(to - from - 0.75, 0.75), ROW);
    const text = String(code);
    if (to - from < context.measureText(text).width + 1) return;
    context.fillStyle = '#14110d';
    context.fillText(text, from + 1, y + ROW / 2 + 0.5);
  }
}
