import type { Span } from '../motion/contacts';
import { MediaClock, SilentTransport, type Transport } from './clock';

/** Seconds of dance that must be there before the song continues. */
const AHEAD = 1;
/** The song stops this long before the dance that has arrived ends. */
const RESERVE = 0.05;

/** Plays the song; times are those of the dance, which begins `offset` seconds into the song. */
export class Player {
  /** Seconds of the dance. */
  duration = 0;
  /** Seconds of it that have arrived. */
  available = 0;
  /** The part that is repeated. */
  loop: Span | null = null;
  /** Whether the song waits for the dance. */
  waiting = false;
  /** Called when the state changes: play, pause, wait, silence. */
  onchange: () => void = () => undefined;
  private readonly audio = new Audio();
  private readonly clock = new MediaClock();
  private transport: Transport = this.audio;
  private offset = 0;
  private speed = 1;
  private address = '';
  private wanted = false;

  constructor() {
    this.audio.preservesPitch = true;
    this.audio.addEventListener('error', () => this.fallSilent());
    this.audio.addEventListener('pause', () => this.paused());
    this.audio.addEventListener('ended', () => this.paused());
  }

  /** Takes another song, of which the dance begins `offset` seconds in. */
  load(song: Blob, offset: number): void {
    this.unload();
    this.address = URL.createObjectURL(song);
    this.audio.src = this.address;
    this.offset = offset;
    this.transport = this.audio;
    this.rate = this.speed;
    this.audio.currentTime = offset;
  }

  /** Plays without a song. */
  loadSilent(): void {
    this.unload();
    this.offset = 0;
    this.transport = new SilentTransport();
    this.rate = this.speed;
  }

  unload(): void {
    this.wanted = this.waiting = false;
    this.transport.pause();
    this.loop = null;
    this.duration = this.available = 0;
    if (this.address !== '') {
      this.audio.removeAttribute('src');
      this.audio.load();
      URL.revokeObjectURL(this.address);
      this.address = '';
    }
  }

  /** Whether the browser plays the song's sound. */
  get silent(): boolean {
    return this.transport !== this.audio;
  }

  get playing(): boolean {
    return this.wanted;
  }

  get rate(): number {
    return this.speed;
  }

  set rate(rate: number) {
    this.speed = rate;
    this.transport.playbackRate = rate;
  }

  get muted(): boolean {
    return this.audio.muted;
  }

  set muted(muted: boolean) {
    this.audio.muted = muted;
  }

  /** The element that plays, for tests that measure it. */
  get element(): HTMLAudioElement {
    return this.audio;
  }

  async play(): Promise<void> {
    if (this.duration === 0) return;
    const over = this.transport.ended || this.now() >= this.duration - 0.02;
    if (over) this.seek(this.loop?.[0] ?? 0);
    this.wanted = true;
    this.waiting = this.now() > this.available - RESERVE && this.available < this.duration;
    this.onchange();
    if (!this.waiting) await this.start();
  }

  pause(): void {
    this.wanted = this.waiting = false;
    this.transport.pause();
    this.onchange();
  }

  seek(time: number): void {
    const within = Math.min(Math.max(time, 0), this.duration);
    this.transport.currentTime = this.offset + within;
  }

  /** The time of the dance at `now`; call it once a frame: it loops, waits and ends. */
  tick(now: number): number {
    const time = this.clock.read(this.transport, now) - this.offset;
    const loop = this.loop;
    // A dance may be a little longer than its song: then the song's end ends the loop.
    const over =
      loop !== null && (time >= Math.min(loop[1], this.duration) || this.transport.ended);
    if (this.wanted && loop && over && !this.transport.seeking) {
      this.seek(loop[0]);
      if (this.transport.paused) void this.start();
      return loop[0];
    }
    if (this.wanted) this.follow(time);
    return Math.min(Math.max(time, 0), this.duration);
  }

  private now(): number {
    return this.transport.currentTime - this.offset;
  }

  private follow(time: number): void {
    const complete = this.available >= this.duration;
    if (complete && time >= this.duration) {
      this.pause();
    } else if (this.waiting && (complete || this.available > time + AHEAD)) {
      this.waiting = false;
      void this.start();
      this.onchange();
    } else if (!this.waiting && !complete && time > this.available - RESERVE) {
      this.waiting = true;
      this.transport.pause();
      this.onchange();
    }
  }

  private async start(): Promise<void> {
    try {
      await this.transport.play();
    } catch (error) {
      // Browsers that want a click first; a pause while it starts is no failure, either.
      if (error instanceof DOMException && error.name === 'NotAllowedError') this.pause();
    }
  }

  private fallSilent(): void {
    if (this.address === '' || this.silent) return;
    const silent = new SilentTransport();
    silent.currentTime = this.offset;
    silent.playbackRate = this.speed;
    this.transport = silent;
    if (this.wanted && !this.waiting) void silent.play();
    this.onchange();
  }

  /** The system paused the sound: a headset was unplugged, a call came in, the song ended. */
  private paused(): void {
    if (!this.wanted || this.waiting || this.silent || this.audio.ended) {
      if (this.audio.ended && this.wanted && !this.loop) this.pause();
      return;
    }
    if (this.audio.paused) this.pause();
  }
}
