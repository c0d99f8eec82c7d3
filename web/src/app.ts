import { Server, ServerFault } from './api/server';
import type { Codes, Info } from './api/types';
import { Player } from './audio/player';
import { waveform } from './audio/waveform';
import { Cast } from './cast';
import { type Dancer, recoded } from './dancer';
import { Editor } from './edit/editor';
import { generate } from './generation';
import { Memory } from './memory/memory';
import { footContacts } from './motion/contacts';
import { Skeleton } from './motion/skeleton';
import type { BuildName } from './scene/body';
import { Stage } from './scene/stage';
import { Banner } from './ui/banner';
import { byId, clockText, sizeText } from './ui/dom';
import { Intake } from './ui/intake';
import { OptionsForm } from './ui/options';
import { Results } from './ui/results';
import { TransportBar } from './ui/transport';

/** Seconds between two questions whether the model is loaded. */
const LOADING_RETRY = 1.5;

/** Seconds that are played before what was changed. */
const LEAD = 0.7;

type State = 'empty' | 'generating' | 'ready';

/** The page: takes a song, has it danced, shows and plays the dance. */
export class App {
  readonly player = new Player();
  readonly stage = new Stage(byId<HTMLCanvasElement>('stage'));
  readonly bar = new TransportBar(this.player, this.stage);
  private readonly server = new Server();
  private readonly banner = new Banner();
  private readonly form = new OptionsForm();
  private readonly cast = new Cast(this.stage);
  private readonly results = new Results(this.server, this.form, (error) =>
    this.banner.show(error),
  );
  private readonly memory = new Memory(
    this.server,
    () => this.stage.invalidate(),
    (error) => this.banner.show(error),
  );
  private readonly editor = new Editor(() => this.server.codes());
  private editing: AbortController | null = null;
  private info: Info | null = null;
  private skeleton: Skeleton | null = null;
  private song: File | null = null;
  private dancers: Dancer[] = [];
  private running: AbortController | null = null;
  private shownContacts = -1;
  private figure: BuildName | 'own' = 'female';

  constructor() {
    document.body.dataset.drawing = this.stage.software ? 'software' : 'card';
    new Intake(
      (file) => this.take(file),
      (file) => void this.choose(file),
      (file) => void this.watch(file),
      (error) => this.banner.show(error),
    );
    this.results.mirrored = () => this.bar.mirror;
    this.stage.onframe = (now, seconds) => this.frame(now, seconds);
    this.player.onchange = () => this.stage.invalidate();
    byId('form').addEventListener('submit', (event) => {
      event.preventDefault();
      if (this.running) this.running.abort();
      else void this.dance();
    });
    byId('key').addEventListener('change', () => {
      this.server.key = byId<HTMLInputElement>('key').value.trim();
    });
    byId('memory-open').addEventListener('click', () => void this.openMemory());
    this.memory.panel.onclose = () => this.closeMemory();
    this.editor.onchange = (codes, from) => void this.edited(codes, from);
    // So that its playhead is where the dance is, also while it is paused.
    byId('edit').addEventListener('click', () => this.stage.invalidate());
    byId('dancers').addEventListener('change', () => {
      this.shownContacts = -1;
      this.contacts();
      this.edit(true);
    });
    this.figures();
    const dark = matchMedia('(prefers-color-scheme: dark)');
    const paint = () => this.stage.paint(dark.matches ? 'dark' : 'light');
    dark.addEventListener('change', paint);
    paint();
  }

  /** Asks the server what it offers, until its model is loaded. */
  async start(): Promise<void> {
    for (;;) {
      try {
        this.info = await this.server.info();
        break;
      } catch (error) {
        if (!(error instanceof ServerFault) || error.status !== 503) {
          this.banner.show(error, () => void this.start());
          return;
        }
        this.say('The model is loading…');
        await new Promise((resolve) => setTimeout(resolve, LOADING_RETRY * 1000));
      }
    }
    this.say('');
    this.form.fill(this.info);
    byId('model').textContent = this.info.model.name;
    byId('model').title = `${this.info.model.name}, version ${this.info.version}`;
    this.skeleton = new Skeleton(this.info.model.skeleton);
    await this.cast.rest(this.skeleton);
    byId<HTMLButtonElement>('dance').disabled = this.song === null;
    byId<HTMLButtonElement>('memory-open').disabled = false;
  }

  private async openMemory(): Promise<void> {
    if (!this.skeleton || this.memory.open) return;
    this.player.pause();
    this.banner.hide();
    await Promise.all([this.memory.enter(), this.cast.show(this.skeleton, [this.memory.dancer])]);
    this.stage.invalidate();
  }

  private closeMemory(): void {
    this.memory.leave();
    const dancers = this.dancers.length > 0 ? this.dancers : [null];
    if (this.skeleton) void this.cast.show(this.skeleton, dancers);
    byId('memory-open').focus();
  }

  private take(song: File): void {
    this.song = song;
    byId('song-name').textContent = song.name;
    byId('song-detail').textContent = sizeText(song.size);
    byId<HTMLButtonElement>('dance').disabled = this.info === null;
    if (this.info) void this.dance();
  }

  /** Plays a VRM animation, to the song that there is. */
  private async watch(file: File): Promise<void> {
    const { skeleton, song } = this;
    if (!skeleton) return;
    this.running?.abort();
    this.editing?.abort();
    if (this.memory.open) this.closeMemory();
    this.banner.hide();
    try {
      // Loaded on demand, as characters are.
      const { readAnimation } = await import('./scene/vrma');
      const dance = await readAnimation(file, skeleton);
      this.dancers = [{ place: 0, options: {}, dance, state: 'done' }];
      await this.cast.show(skeleton, this.dancers);
      if (song) this.player.load(song, 0);
      else this.player.loadSilent();
      this.player.duration = this.player.available = dance.duration;
      this.bar.reset(undefined);
      this.bar.timeline.show({ duration: dance.duration, available: dance.duration, offset: 0 });
      this.results.show(song, this.dancers);
      byId('result').hidden = true;
      this.shownContacts = -1;
      this.contacts();
      this.editor.show(null, 0, true);
      this.setState('ready');
      this.say(file.name);
      void this.player.play();
      this.stage.invalidate();
    } catch (error) {
      this.banner.show(error);
    }
  }

  private async dance(): Promise<void> {
    const { song, skeleton } = this;
    if (!song || !skeleton) return;
    this.running?.abort();
    this.editing?.abort();
    if (this.memory.open) this.closeMemory();
    const running = (this.running = new AbortController());
    this.banner.hide();
    // On a phone the form is below the scene.
    scrollTo(0, 0);
    this.editor.show(null, 0, true);
    this.setState('generating');
    this.say('Listening to the song…');
    const asked = this.form.dancers();
    this.dancers = asked.map((options, place) => ({
      place,
      options,
      dance: null,
      state: 'waiting',
    }));
    const offset = Number(this.dancers[0].options.offset_s ?? 0) || 0;
    this.player.load(song, offset);
    this.bar.timeline.clear();
    this.bar.reset(undefined);
    this.shownContacts = -1;
    this.results.show(song, this.dancers);
    try {
      const generated = generate(this.server, song, this.dancers, running.signal, {
        started: (dancer) => this.started(dancer, offset),
        arrived: () => this.arrived(running),
      });
      await Promise.all([generated, this.cast.show(skeleton, this.dancers)]);
    } catch (error) {
      if (!running.signal.aborted) this.banner.show(error, () => void this.dance());
    } finally {
      if (this.running === running) {
        this.running = null;
        this.ended();
      }
    }
  }

  private drawn(song: File, found: Awaited<ReturnType<typeof waveform>>): void {
    this.bar.timeline.show({ waveform: found });
    const length = found ? `${clockText(found.seconds)} · ` : '';
    byId('song-detail').textContent = length + sizeText(song.size);
  }

  private started(dancer: Dancer, offset: number): void {
    const { dance } = dancer;
    if (!dance) return;
    this.results.refresh();
    if (this.player.duration > 0) return;
    this.player.duration = dance.duration;
    this.bar.reset(dance.music);
    this.bar.timeline.show({ duration: dance.duration, offset, music: dance.music });
    this.say('Dancing…');
  }

  /** Frames have arrived: as many seconds can be played as all dancers have. */
  private arrived(running: AbortController): void {
    if (running !== this.running) return;
    const first = this.player.available === 0;
    const going = this.dancers.filter(({ state }) => state !== 'failed');
    const seconds = going.map(({ dance }) => dance?.availableSeconds ?? 0);
    this.player.available = Math.min(...seconds);
    this.bar.timeline.show({ available: this.player.available });
    this.results.refresh();
    this.contacts();
    if (first && this.player.available > 0) {
      // People who want less motion start the dance by hand.
      const calm = matchMedia('(prefers-reduced-motion: reduce)').matches;
      if (!calm) void this.player.play();
      // Only now: it would take time from a server on the same machine.
      const { song } = this;
      if (song)
        void waveform(song).then((found) => {
          if (running === this.running || this.song === song) this.drawn(song, found);
        });
    }
    this.stage.invalidate();
  }

  private contacts(): void {
    const dance = this.results.chosen?.dance;
    if (!dance || dance.available === this.shownContacts) return;
    this.shownContacts = dance.available;
    this.bar.timeline.show(footContacts(dance));
  }

  private ended(): void {
    const some = this.dancers.some(({ dance }) => dance && dance.available > 0);
    this.setState(some ? 'ready' : 'empty');
    if (!some) {
      this.player.unload();
      byId('result').hidden = true;
    } else if (this.dancers.some(({ state }) => state !== 'done')) {
      // What was stopped or has failed plays as far as it came.
      this.player.duration = this.player.available;
      this.bar.timeline.show({ duration: this.player.duration });
    }
    const silent = 'The browser cannot play this song: the dance is shown without sound.';
    const said = this.dancers.flatMap(({ warnings }) => warnings ?? []);
    if (some && this.player.silent) said.unshift(silent);
    this.say([...new Set(said)].join(' '));
    this.results.refresh();
    this.edit(true);
    this.stage.invalidate();
  }

  /** Offers the codes of the chosen dance for changes. */
  private edit(isNew: boolean): void {
    const dance = this.results.chosen?.dance;
    this.editor.show(dance?.codes ?? null, dance?.duration ?? 0, isNew);
  }

  /** Dances other codes from here on; what was danced before plays until they are there. */
  private async edited(codes: Codes, from: number): Promise<void> {
    const dancer = this.results.chosen;
    const before = dancer?.dance;
    if (!dancer || !before) return;
    this.editing?.abort();
    const { signal } = (this.editing = new AbortController());
    const fresh = { ...dancer, options: recoded(dancer, codes), dance: null };
    try {
      const reports = {
        started: () => undefined,
        arrived: () => undefined,
      };
      await generate(this.server, null, [fresh], signal, reports);
    } catch (error) {
      if (!signal.aborted) this.banner.show(error);
      return;
    }
    const { dance, options } = fresh as Dancer;
    if (signal.aborted || !dance) return;
    dance.music = before.music;
    Object.assign(dancer, { dance, options, state: 'done' });
    this.shownContacts = -1;
    this.contacts();
    this.results.refresh();
    this.player.seek(Math.max(from - LEAD, 0));
    void this.player.play();
    this.stage.invalidate();
  }

  private frame(now: number, seconds: number): boolean {
    if (this.memory.open) {
      this.cast.update(this.memory.time(now), false, seconds);
      return this.memory.dancer.dance !== null;
    }
    const time = this.player.tick(now);
    this.cast.update(time, this.bar.mirror, seconds);
    this.bar.show(time);
    this.editor.at(time);
    return this.player.playing;
  }

  private setState(state: State): void {
    document.body.dataset.state = state;
    byId('dance').textContent = state === 'generating' ? 'Stop' : 'Dance';
  }

  private say(text: string): void {
    byId('status').textContent = text;
  }

  private figures(): void {
    const file = byId<HTMLInputElement>('avatar');
    byId('figures').addEventListener('click', (event) => {
      const { value } = event.target as HTMLInputElement;
      // Also where it is chosen already: for another character.
      if (value === 'own') file.click();
      else if (value) void this.choose(value as BuildName);
    });
    file.addEventListener('cancel', () => this.checkFigure());
    file.addEventListener('change', () => {
      const chosen = file.files?.[0];
      file.value = '';
      this.checkFigure();
      if (chosen) void (/\.vrma$/i.test(chosen.name) ? this.watch(chosen) : this.choose(chosen));
    });
  }

  private async choose(figure: BuildName | File): Promise<void> {
    if (!this.skeleton) return;
    const detail = byId('figure-detail');
    try {
      await this.cast.choose(this.skeleton, figure);
      const own = figure instanceof File;
      this.figure = own ? 'own' : figure;
      if (own) detail.textContent = figure.name;
    } catch (error) {
      this.banner.show(error);
    }
    this.checkFigure();
  }

  /** Marks the figure that is shown, whatever was asked for. */
  private checkFigure(): void {
    byId('figures').querySelector<HTMLInputElement>(`[value=${this.figure}]`)!.checked = true;
  }
}
