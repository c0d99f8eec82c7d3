import type { Codebooks, CodeUses } from '../api/types';
import { type Half, HALVES } from '../edit/codes';
import { byId, make, press, typedCode } from '../ui/dom';

/** A pair of codes; `null` where a half has none. */
export type Pair = Record<Half, number>;

/** The choreographic memory: which pair is shown, what follows it, how often it was used. */
export class MemoryPanel {
  /** Called with the pair to show, and the one after it, if any. */
  onshow: (pair: Pair, then: Pair | null) => void = () => undefined;
  onclose: () => void = () => undefined;
  private books: Codebooks | null = null;
  private pair: Pair = { upper: 0, lower: 0 };
  private then: Pair | null = null;
  private half: Half = 'upper';

  constructor() {
    byId('memory-close').addEventListener('click', () => this.onclose());
    byId('memory-clear').addEventListener('click', () => this.choose(this.pair, null));
    byId('memory-half').addEventListener('change', (event) => {
      this.half = (event.target as HTMLInputElement).value as Half;
      this.list();
      this.refresh();
    });
    byId('memory-sort').addEventListener('change', () => {
      this.list();
      this.refresh();
    });
    for (const half of HALVES) {
      this.input(half).addEventListener('change', () => {
        const code = typedCode(this.input(half), this.count(half));
        if (code !== null) this.choose({ ...this.pair, [half]: code }, null);
      });
      this.input(half, 'then-').addEventListener('change', () => {
        const input = this.input(half, 'then-');
        if (input.value === '') return this.choose(this.pair, null);
        const code = typedCode(input, this.count(half));
        if (code !== null) this.choose(this.pair, { ...(this.then ?? this.pair), [half]: code });
      });
    }
    byId('memory-codes').addEventListener('keydown', (event) => this.move(event));
  }

  /** Shows the codebooks of the model, beginning with the pair that dances use most. */
  fill(books: Codebooks): void {
    this.books = books;
    const start = books.start_codes[0] ?? [0, 0];
    const most = (half: Half, at: 0 | 1) => (books.memory ? this.ranking(half)[0] : start[at]);
    byId('memory-sort').parentElement!.hidden = !books.memory;
    byId('memory-uses').hidden = !books.memory;
    this.list();
    this.choose({ upper: most('upper', 0), lower: most('lower', 1) }, null);
  }

  /** Says how still the pairs are, and how fast the change is. */
  tell(text: string): void {
    byId('memory-speed').textContent = text;
  }

  /** Shows a pair, and the one after it. */
  choose(pair: Pair, then: Pair | null): void {
    this.pair = pair;
    this.then = then;
    this.refresh();
    this.onshow(pair, then);
  }

  private input(half: Half, which = ''): HTMLInputElement {
    return byId<HTMLInputElement>(`memory-${which}${half}`);
  }

  private count(half: Half): number {
    return this.books?.[half] ?? 0;
  }

  private uses(half: Half, code: number): CodeUses | undefined {
    return this.books?.memory?.[half][code];
  }

  private ranking(half: Half): number[] {
    const codes = Array.from({ length: this.count(half) }, (_, code) => code);
    const used = (code: number) => this.uses(half, code)?.uses ?? 0;
    const sort = byId<HTMLSelectElement>('memory-sort').value;
    return sort === 'number' ? codes : codes.sort((a, b) => used(b) - used(a));
  }

  private list(): void {
    const { half } = this;
    const codes = this.ranking(half);
    const most = Math.max(...codes.map((code) => this.uses(half, code)?.uses ?? 0), 1);
    const suppressed = this.books?.suppressed_codes[half] ?? [];
    byId('memory-codes').replaceChildren(
      ...codes.map((code) => {
        const uses = this.uses(half, code)?.uses;
        const button = make('button', { type: 'button', textContent: String(code) });
        const never = suppressed.includes(code) ? ', never drawn' : '';
        button.title = uses === undefined ? `Code ${code}` : `Used ${uses} times${never}`;
        button.dataset.code = String(code);
        button.style.setProperty('--share', String((uses ?? 0) / most));
        button.addEventListener('click', () => this.choose({ ...this.pair, [half]: code }, null));
        return button;
      }),
    );
  }

  private refresh(): void {
    const { pair, then, half } = this;
    for (const name of HALVES) {
      this.input(name).value = String(pair[name]);
      this.input(name, 'then-').value = then ? String(then[name]) : '';
    }
    byId<HTMLButtonElement>('memory-clear').disabled = then === null;
    for (const button of byId('memory-codes').querySelectorAll('button')) {
      const chosen = Number(button.dataset.code) === pair[half];
      press(button, chosen);
      button.tabIndex = chosen ? 0 : -1;
    }
    const uses = this.uses(half, pair[half]);
    if (!uses || !this.books?.memory) return;
    const all = this.books.memory[half].reduce((sum, code) => sum + code.uses, 0);
    const percent = ((100 * uses.uses) / Math.max(all, 1)).toFixed(1);
    byId('memory-used').textContent =
      `Training used ${half} code ${pair[half]}: ${uses.uses} times, ${percent}\u00a0% of all.`;
    const other = HALVES.find((name) => name !== half)!;
    this.chips('memory-next', uses.next, then?.[half], (code) =>
      this.choose(pair, { ...(then ?? pair), [half]: code }),
    );
    this.chips('memory-beside', uses.beside, pair[other], (code) =>
      this.choose({ ...pair, [other]: code }, null),
    );
  }

  private chips(
    id: string,
    counts: [number, number][],
    now: number | undefined,
    chosen: (code: number) => void,
  ): void {
    const none = make('span', { className: 'quiet', textContent: 'nothing' });
    const chips = counts.map(([code, uses]) => {
      const small = make('small', { textContent: `${uses}×` });
      const button = make('button', { type: 'button' }, `${code} `, small);
      button.addEventListener('click', () => chosen(code));
      press(button, code === now);
      return button;
    });
    byId(id).replaceChildren(...(chips.length > 0 ? chips : [none]));
  }

  /** Arrow keys go from code to code. */
  private move(event: KeyboardEvent): void {
    const buttons = [...byId('memory-codes').querySelectorAll('button')];
    const at = buttons.indexOf(event.target as HTMLButtonElement);
    const row = buttons.filter(({ offsetTop }) => offsetTop === buttons[0].offsetTop).length;
    const steps: Record<string, number> = {
      ArrowLeft: -1,
      ArrowRight: 1,
      ArrowUp: -row,
      ArrowDown: row,
    };
    const next = buttons[at + (steps[event.key] ?? 0)];
    if (!(event.key in steps) || !next) return;
    event.preventDefault();
    event.stopPropagation();
    next.focus();
    next.click();
  }
}
