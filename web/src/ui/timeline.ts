import type { Waveform } from '../audio/waveform';
import type { Music } from '../api/types';
import type { Span } from '../motion/contacts';
import { byId, clockText } from './dom';

/** Room for the names of the lanes, in pixels. */
const GUTTER = 18;
/** How near a pointer must be to an end of the loop to take hold of it, in pixels. */
const NEAR = 9;
const LANES = 2;
const LANE = 7;
const GAP = 5;

/** What the timeline shows. */
export interface Track {
  duration: number;
  available: number;
  /** Where in the song the dance begins, in seconds. */
  offset: number;
  music: Music | undefined;
  waveform: Waveform | null;
  left: Span[];
  right: Span[];
}

const EMPTY: Track = {
  duration: 0,
  available: 0,
  offset: 0,
  music: undefined,
  waveform: null,
  left: [],
  right: [],
};

type Drag = 'scrub' | 'from' | 'to' | null;

/** Waveform, beats, foot contacts, loop and playhead; a slider for the keyboard. */
export class Timeline {
  onseek: (time: number) => void = () => undefined;
  onloop: (loop: Span) => void = () => undefined;
  private readonly element = byId('timeline');
  private readonly canvas = this.element.querySelector('canvas') as HTMLCanvasElement;
  /** The track as it is before and after it was played. */
  private readonly layers = [document.createElement('canvas'), document.createElement('canvas')];
  private track = EMPTY;
  private loop: Span | null = null;
  private time = 0;
  private drag: Drag = null;
  private anchor = 0;
  private stale = true;
  private spoken = -1;

  constructor() {
    this.element.addEventListener('pointerdown', (event) => this.down(event));
    this.element.addEventListener('pointermove', (event) => this.moved(event));
    this.element.addEventListener('pointerup', () => (this.drag = null));
    this.element.addEventListener('pointercancel', () => (this.drag = null));
    new ResizeObserver(() => this.refresh()).observe(this.element);
    matchMedia('(prefers-color-scheme: dark)').addEventListener('change', () => this.refresh());
  }

  show(track: Partial<Track>): void {
    this.track = { ...this.track, ...track };
    this.refresh();
  }

  clear(): void {
    this.track = EMPTY;
    this.loop = null;
    this.time = 0;
    this.refresh();
  }

  setLoop(loop: Span | null): void {
    this.loop = loop;
    this.draw();
  }

  setTime(time: number): void {
    this.time = time;
    this.draw();
    const tenth = Math.round(time * 10);
    if (tenth === this.spoken) return;
    this.spoken = tenth;
    const { duration } = this.track;
    this.element.setAttribute('aria-valuemax', duration.toFixed(1));
    this.element.setAttribute('aria-valuenow', time.toFixed(1));
    const text = `${clockText(time)} of ${clockText(duration)}`;
    this.element.setAttribute('aria-valuetext', text);
  }

  private refresh(): void {
    this.stale = true;
    this.draw();
  }

  private get width(): number {
    return this.element.clientWidth;
  }

  private x(time: number): number {
    return GUTTER + (time / (this.track.duration || 1)) * (this.width - GUTTER);
  }

  private timeAt(event: PointerEvent): number {
    const x = event.clientX - this.element.getBoundingClientRect().left;
    const part = (x - GUTTER) / Math.max(this.width - GUTTER, 1);
    return Math.min(Math.max(part, 0), 1) * this.track.duration;
  }

  private down(event: PointerEvent): void {
    if (this.track.duration === 0 || event.button !== 0) return;
    this.element.setPointerCapture(event.pointerId);
    const x = event.clientX - this.element.getBoundingClientRect().left;
    const near = (time: number | undefined) =>
      time !== undefined && Math.abs(this.x(time) - x) < NEAR;
    this.anchor = this.timeAt(event);
    if (event.shiftKey) this.drag = 'to';
    else if (near(this.loop?.[0])) [this.drag, this.anchor] = ['from', this.loop?.[1] ?? 0];
    else if (near(this.loop?.[1])) [this.drag, this.anchor] = ['to', this.loop?.[0] ?? 0];
    else {
      this.drag = 'scrub';
      this.onseek(this.anchor);
    }
  }

  private moved(event: PointerEvent): void {
    if (!this.drag) return;
    const time = this.timeAt(event);
    if (this.drag === 'scrub') this.onseek(time);
    else if (Math.abs(time - this.anchor) > 0.1)
      this.onloop([Math.min(time, this.anchor), Math.max(time, this.anchor)]);
  }

  private draw(): void {
    const { clientWidth: width, clientHeight: height } = this.element;
    if (width === 0) return;
    const ratio = Math.min(devicePixelRatio, 2);
    if (this.stale) {
      this.stale = false;
      const style = getComputedStyle(document.documentElement);
      const colour = (name: string) => style.getPropertyValue(`--${name}`).trim();
      this.paint(this.layers[0], width, height, ratio, colour, colour('wave'));
      this.paint(this.layers[1], width, height, ratio, colour, colour('accent'));
    }
    fit(this.canvas, width, height, ratio);
    const context = this.canvas.getContext('2d');
    if (!context) return;
    context.clearRect(0, 0, this.canvas.width, this.canvas.height);
    context.drawImage(this.layers[0], 0, 0);
    if (this.track.duration === 0) return;
    const at = Math.round(this.x(this.time) * ratio);
    if (at > 0) {
      context.clearRect(0, 0, at, this.canvas.height);
      context.drawImage(this.layers[1], 0, 0, at, this.canvas.height, 0, 0, at, this.canvas.height);
    }
    const ink = getComputedStyle(this.element).color;
    context.fillStyle = ink;
    if (this.loop) this.paintLoop(context, this.loop, ratio);
    context.fillRect(at - ratio, 0, 2 * ratio, this.canvas.height);
  }

  private paintLoop(context: CanvasRenderingContext2D, loop: Span, ratio: number): void {
    const [from, to] = loop.map((time) => this.x(time) * ratio);
    context.globalAlpha = 0.09;
    context.fillRect(from, 0, to - from, this.canvas.height);
    context.globalAlpha = 1;
    for (const [x, side] of [
      [from, 0],
      [to, -6],
    ]) {
      context.fillRect(x + side * ratio, 0, 6 * ratio, 14 * ratio);
      context.fillRect(x - ratio / 2, 0, ratio, this.canvas.height);
    }
  }

  private paint(
    layer: HTMLCanvasElement,
    width: number,
    height: number,
    ratio: number,
    colour: (name: string) => string,
    wave: string,
  ): void {
    fit(layer, width, height, ratio);
    const context = layer.getContext('2d');
    if (!context) return;
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, width, height);
    const { duration, music, left, right, available } = this.track;
    const lanes = height - LANES * (LANE + GAP);
    const tall = lanes - 6;
    context.fillStyle = colour('line');
    context.fillRect(GUTTER, Math.round(tall / 2), width - GUTTER, 1);
    if (duration > 0) {
      this.paintBeats(context, music, tall, colour);
      context.fillStyle = wave;
      this.paintWave(context, tall, available);
    }
    context.font = '9px system-ui, sans-serif';
    context.textBaseline = 'middle';
    [left, right].forEach((spans, lane) => {
      const y = lanes + lane * (LANE + GAP);
      context.fillStyle = colour('quiet');
      context.fillText('LR'[lane], 4, y + LANE / 2 + 0.5);
      context.fillStyle = colour('line');
      context.fillRect(GUTTER, y + LANE / 2, width - GUTTER, 1);
      context.fillStyle = wave;
      for (const [from, to] of spans) {
        const x = this.x(from);
        context.beginPath();
        context.roundRect(x, y, Math.max(this.x(to) - x - 0.5, 1), LANE, 2);
        context.fill();
      }
    });
  }

  private paintBeats(
    context: CanvasRenderingContext2D,
    music: Music | undefined,
    tall: number,
    colour: (name: string) => string,
  ): void {
    const beats = music?.beats_s ?? [];
    // Too many to tell apart say nothing.
    const apart = (this.width - GUTTER) / Math.max(beats.length, 1);
    context.fillStyle = colour('beat');
    if (apart > 3) for (const beat of beats) context.fillRect(this.x(beat), 3, 1, tall - 3);
    context.fillStyle = colour('downbeat');
    for (const beat of music?.downbeats_s ?? []) context.fillRect(this.x(beat), 0, 1.5, tall + 3);
  }

  private paintWave(context: CanvasRenderingContext2D, tall: number, available: number): void {
    const { waveform, offset, duration } = this.track;
    if (!waveform) return;
    const loudest = waveform.peaks.reduce((most, peak) => Math.max(most, peak), 0.05);
    const step = 3;
    for (let x = GUTTER; x < this.width; x += step) {
      const time = ((x - GUTTER) / (this.width - GUTTER)) * duration;
      const next = ((x + step - GUTTER) / (this.width - GUTTER)) * duration;
      const from = Math.floor((offset + time) * waveform.rate);
      const to = Math.max(Math.floor((offset + next) * waveform.rate), from + 1);
      let peak = 0;
      for (let i = from; i < to; i++) peak = Math.max(peak, waveform.peaks[i] ?? 0);
      const half = Math.max((peak / loudest) * (tall / 2 - 3), 0.5);
      context.globalAlpha = time < available ? 1 : 0.35;
      context.fillRect(x, tall / 2 - half, step - 1, half * 2);
    }
    context.globalAlpha = 1;
  }
}

function fit(canvas: HTMLCanvasElement, width: number, height: number, ratio: number): void {
  const [w, h] = [Math.round(width * ratio), Math.round(height * ratio)];
  if (canvas.width !== w) canvas.width = w;
  if (canvas.height !== h) canvas.height = h;
}
