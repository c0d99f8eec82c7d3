/** What plays: an audio element, or a silent stand-in with the same face. */
export interface Transport {
  currentTime: number;
  playbackRate: number;
  readonly paused: boolean;
  readonly seeking: boolean;
  readonly ended: boolean;
  play(): Promise<void>;
  pause(): void;
}

/** A clock this far off is set, in seconds; below that it is steered. */
const JUMP = 0.08;
/** Furthest distance between clock and sound while it is steered, in seconds. */
const FURTHEST = 0.02;
/** Share of an error that one reading corrects. */
const GAIN = 0.1;

/**
 * A smooth clock that follows the sound: browsers move `currentTime` in steps, and a dance that
 * followed the steps would shake.
 */
export class MediaClock {
  private time = 0;
  private wall = 0;
  private lastRead = -1;

  /** Returns the time of the song in seconds; `now` is `performance.now()`. */
  read(media: Transport, now: number): number {
    const sound = media.currentTime;
    const elapsed = ((now - this.wall) / 1000) * media.playbackRate;
    this.wall = now;
    if (media.paused || media.seeking) {
      this.lastRead = -1;
      return (this.time = sound);
    }
    const expected = this.time + elapsed;
    const error = sound - expected;
    if (this.lastRead < 0 || Math.abs(error) > JUMP) this.time = sound;
    else this.time = sound === this.lastRead ? expected : expected + error * GAIN;
    this.lastRead = sound;
    this.time = Math.min(Math.max(this.time, sound - FURTHEST), sound + FURTHEST);
    return this.time;
  }
}

/** Time without sound, for songs that the browser cannot play. */
export class SilentTransport implements Transport {
  readonly seeking = false;
  readonly ended = false;
  private at = 0;
  private since: number | null = null;
  private rate = 1;

  get paused(): boolean {
    return this.since === null;
  }

  get currentTime(): number {
    const elapsed = this.since === null ? 0 : ((performance.now() - this.since) / 1000) * this.rate;
    return this.at + elapsed;
  }

  set currentTime(time: number) {
    this.at = time;
    if (this.since !== null) this.since = performance.now();
  }

  get playbackRate(): number {
    return this.rate;
  }

  set playbackRate(rate: number) {
    this.currentTime = this.currentTime;
    this.rate = rate;
  }

  play(): Promise<void> {
    this.since ??= performance.now();
    return Promise.resolve();
  }

  pause(): void {
    this.at = this.currentTime;
    this.since = null;
  }
}
