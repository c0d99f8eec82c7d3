import type { Player } from '../audio/player';
import type { Music } from '../api/types';
import type { Span } from '../motion/contacts';
import type { Stage } from '../scene/stage';
import { byId, clockText, press } from './dom';
import { Timeline } from './timeline';

const SPEEDS = [0.25, 0.5, 0.75, 1, 1.25];
/** Beats of a loop that is switched on without a range. */
const LOOP_BEATS = 8;
/** Where the camera stands: around the dancer and down from the zenith, in radians. */
export const VIEWS: Record<string, [number, number]> = {
  front: [0, 1.42],
  side: [Math.PI / 2, 1.42],
  top: [0, 0.12],
};

/** Playback and camera: buttons, timeline and keys. */
export class TransportBar {
  readonly timeline = new Timeline();
  mirror = false;
  private music: Music | undefined;
  private range: Span | null = null;

  constructor(
    private readonly player: Player,
    private readonly stage: Stage,
  ) {
    this.on('play', () => this.toggle());
    this.on('loop', () => this.setLoop(player.loop ? null : (this.range ?? this.defaultLoop())));
    this.on('mirror', () => this.setMirror(!this.mirror));
    this.on('mute', () => {
      player.muted = !player.muted;
      press(byId('mute'), player.muted);
    });
    this.on('follow', () => {
      stage.view.follow = !stage.view.follow;
      press(byId('follow'), stage.view.follow);
      stage.invalidate();
    });
    this.on('help', () => byId<HTMLDialogElement>('keys').showModal());
    for (const button of document.querySelectorAll<HTMLElement>('[data-look]')) {
      button.addEventListener('click', () => this.look(button.dataset.look ?? ''));
    }
    const speed = byId<HTMLSelectElement>('speed');
    speed.addEventListener('change', () => (player.rate = Number(speed.value)));
    this.timeline.onseek = (time) => this.seek(time);
    this.timeline.onloop = (loop) => this.setLoop(loop);
    document.addEventListener('keydown', (event) => this.key(event));
  }

  /** Prepares for another dance. */
  reset(music: Music | undefined): void {
    this.music = music;
    this.range = null;
    this.setLoop(null);
    const tempo = Math.round(music?.tempo_bpm ?? 0);
    const metre = music?.metre ? ` · ${music.metre}/4` : '';
    byId('tempo').textContent = tempo > 0 ? `${tempo} BPM${metre}` : '';
  }

  /** Shows time and state. */
  show(time: number): void {
    this.timeline.setTime(time);
    byId('time').textContent = `${clockText(time)} / ${clockText(this.player.duration)}`;
    byId('play').setAttribute('aria-label', this.player.playing ? 'Pause' : 'Play');
    byId<HTMLButtonElement>('play').disabled = this.player.duration === 0;
  }

  setMirror(mirror: boolean): void {
    this.mirror = mirror;
    press(byId('mirror'), mirror);
    this.stage.invalidate();
  }

  private on(id: string, action: () => void): void {
    byId(id).addEventListener('click', action);
  }

  private toggle(): void {
    if (this.player.playing) this.player.pause();
    else void this.player.play();
    this.stage.invalidate();
  }

  private seek(time: number): void {
    this.player.seek(time);
    this.stage.invalidate();
  }

  private setLoop(loop: Span | null): void {
    if (loop && this.player.duration === 0) return;
    this.player.loop = loop;
    this.range = loop ?? this.range;
    press(byId('loop'), loop !== null);
    this.timeline.setLoop(loop);
    this.stage.invalidate();
  }

  /** Two bars around the playhead, on beats where there are any. */
  private defaultLoop(): Span {
    const { duration } = this.player;
    const time = this.time;
    const beats = this.music?.beats_s ?? [];
    const first = beats.findLastIndex((beat) => beat <= time + 0.01);
    const from = beats[first] ?? Math.min(time, Math.max(duration - 1, 0));
    return [from, Math.min(beats[first + LOOP_BEATS] ?? from + 4, duration)];
  }

  private get time(): number {
    return this.player.tick(performance.now());
  }

  private look(name: string): void {
    const [around, down] = VIEWS[name] ?? [0.32, 1.38];
    this.stage.view.look(around, down);
    this.stage.invalidate();
  }

  private faster(steps: number): void {
    const speed = byId<HTMLSelectElement>('speed');
    const at = SPEEDS.indexOf(this.player.rate) + steps;
    this.player.rate = SPEEDS[Math.min(Math.max(at, 0), SPEEDS.length - 1)];
    speed.value = String(this.player.rate);
  }

  private key(event: KeyboardEvent): void {
    const target = event.target as HTMLElement;
    const typing = target.matches('select, input:not([type=radio]):not([type=checkbox])');
    const modified = event.ctrlKey || event.metaKey || event.altKey;
    if (typing || modified || document.querySelector('dialog[open]')) return;
    // A focused button or choice keeps the keys that work it.
    if (target.matches('button, summary, a, input') && /^( |Enter|Arrow.*)$/.test(event.key))
      return;
    const step = event.shiftKey ? 1 / 60 : 1;
    const view = this.stage.view;
    const actions: Record<string, () => void> = {
      ' ': () => this.toggle(),
      ArrowLeft: () => this.seek(this.time - step),
      ArrowRight: () => this.seek(this.time + step),
      Home: () => this.seek(0),
      End: () => this.seek(this.player.duration),
      '[': () => this.setLoop([this.time, this.range?.[1] ?? this.player.duration]),
      ']': () => this.setLoop([this.range?.[0] ?? 0, this.time]),
      l: () => byId('loop').click(),
      m: () => byId('mirror').click(),
      s: () => byId('mute').click(),
      f: () => byId('follow').click(),
      e: () => byId('edit').click(),
      '-': () => this.faster(-1),
      '+': () => this.faster(1),
      '=': () => this.faster(1),
      Escape: () => byId('dismiss').click(),
      '?': () => byId('help').click(),
      '1': () => this.look('front'),
      '2': () => this.look('side'),
      '3': () => this.look('top'),
      a: () => view.nudge(-0.15, 0, 1),
      d: () => view.nudge(0.15, 0, 1),
      w: () => view.nudge(0, -0.1, 1),
      x: () => view.nudge(0, 0.1, 1),
      z: () => view.nudge(0, 0, 0.9),
      c: () => view.nudge(0, 0, 1.1),
    };
    const action = actions[event.key] ?? actions[event.key.toLowerCase()];
    if (!action) return;
    event.preventDefault();
    action();
  }
}
