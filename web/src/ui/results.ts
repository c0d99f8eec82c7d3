import { curl, type Server } from '../api/server';
import type { Options } from '../api/types';
import { type Dancer, repeatable } from '../dancer';
import { byId, make, save } from './dom';
import type { OptionsForm } from './options';

/** The dances that there are: which one to take along, and in which format. */
export class Results {
  private dancers: Dancer[] = [];
  private song: File | null = null;
  /** Whether the page shows left and right exchanged. */
  mirrored = () => false;

  constructor(
    private readonly server: Server,
    private readonly options: OptionsForm,
    private readonly failed: (error: unknown) => void,
  ) {
    byId('download').addEventListener('click', () => void this.download());
    byId('curl').addEventListener('click', () => void this.copy());
    byId('format').addEventListener('change', () => this.fitOptions());
  }

  show(song: File | null, dancers: Dancer[]): void {
    this.song = song;
    this.dancers = dancers;
    this.say('');
    byId('result').hidden = dancers.length === 0;
    this.fitOptions();
    const list = byId('dancers');
    list.classList.toggle('single', dancers.length === 1);
    list.replaceChildren(
      ...dancers.map((dancer, i) => {
        const choice = { type: 'radio', name: 'dancer', value: String(i), checked: i === 0 };
        const dot = make('span', { className: `dot c${dancer.place}` });
        return make('li', {}, make('label', {}, make('input', choice), dot, make('span')));
      }),
    );
    this.refresh();
  }

  /** Rewrites the lines: seeds are known once a dance has started. */
  refresh(): void {
    const texts = byId('dancers').querySelectorAll('label > span:last-child');
    this.dancers.forEach((dancer, i) => {
      const { dance, state } = dancer;
      const style = dance?.style ?? dancer.options.style;
      const name = dance ? `Seed ${dance.seed}` : 'Listening to the song';
      const part = dance ? Math.floor((100 * dance.available) / dance.frames) : 0;
      const detail = { waiting: '', streaming: `${part} %`, done: '', failed: 'incomplete' }[state];
      const small = [style, detail].filter(Boolean).join(' · ');
      texts[i].replaceChildren(name, ...(small ? [make('small', { textContent: small })] : []));
    });
    const ready = this.chosen?.dance != null;
    byId<HTMLButtonElement>('download').disabled = byId<HTMLButtonElement>('curl').disabled =
      !ready;
  }

  private say(text: string): void {
    byId('result-status').textContent = text;
  }

  private fitOptions(): void {
    this.options.fit(byId<HTMLSelectElement>('format').value);
  }

  /** The dancer that is taken along, and whose codes are edited. */
  get chosen(): Dancer | undefined {
    const checked = document.querySelector<HTMLInputElement>('[name=dancer]:checked');
    return this.dancers[Number(checked?.value ?? 0)];
  }

  /** Options of the file that is asked for; `null` without a dance. */
  private wanted(): { options: Options; format: string; song: File } | null {
    if (!this.chosen || !this.song) return null;
    const options: Options = { ...repeatable(this.chosen), ...this.options.ofFile() };
    if (this.mirrored() && this.options.offers('mirror')) options.mirror = 'true';
    const format = byId<HTMLSelectElement>('format').value;
    if (format === 'json') options.include = 'rotations';
    return { options, format, song: this.song };
  }

  private async download(): Promise<void> {
    const wanted = this.wanted();
    if (!wanted) return;
    const button = byId<HTMLButtonElement>('download');
    button.disabled = true;
    button.textContent = 'Preparing…';
    try {
      const { song, options, format } = wanted;
      const content = await this.server.file(song, options, format);
      save(content, `${song.name.replace(/\.[^.]*$/, '')}.${format}`);
      this.say(`Saved as ${format.toUpperCase()}.`);
    } catch (error) {
      this.failed(error);
    } finally {
      button.disabled = false;
      button.textContent = 'Download';
    }
  }

  private async copy(): Promise<void> {
    const wanted = this.wanted();
    if (!wanted) return;
    const { song, options, format } = wanted;
    const text = curl(this.server.address('generate'), song.name, options, format);
    try {
      await navigator.clipboard.writeText(text);
      this.say('Command copied.');
    } catch {
      this.failed(`The browser gives no access to the clipboard. The command is: ${text}`);
    }
  }
}
