import type { Codebooks, Codes } from '../api/types';
import { Blocks } from '../ui/blocks';
import { byId, press, typedCode } from '../ui/dom';
import { type Block, repeated, replaced } from './codes';

/** Pairs in a second. */
const PAIRS = 7.5;

/** Changes the codes of a dance block by block. */
export class Editor {
  /** Called with other codes, and the second from which on they are others. */
  onchange: (codes: Codes, from: number) => void = () => undefined;
  open = false;
  private readonly blocks = new Blocks();
  private codes: Codes | null = null;
  private seconds = 0;
  private readonly past: Codes[] = [];
  private block: Block | null = null;

  constructor(private readonly books: () => Promise<Codebooks>) {
    this.blocks.onselect = (block) => void this.selected(block);
    byId('edit').addEventListener('click', () => this.toggle());
    byId('edit-replace').addEventListener('click', () => void this.replace());
    byId('edit-repeat').addEventListener('click', () => this.repeat());
    byId('edit-undo').addEventListener('click', () => this.undo());
    byId('edit-code').addEventListener('keydown', (event) => {
      if (event.key === 'Enter') void this.replace();
    });
  }

  /** Takes the codes of a dance of so many seconds; `null` while there are none. */
  show(codes: Codes | null, seconds: number, isNew: boolean): void {
    this.codes = codes;
    this.seconds = seconds;
    if (isNew) {
      this.past.splice(0);
      this.blocks.select(null);
    }
    if (codes) this.blocks.show(codes, seconds * PAIRS);
    this.refresh();
  }

  /** Moves the playhead. */
  at(time: number): void {
    if (this.open && this.codes) this.blocks.setTime(time * PAIRS);
  }

  private toggle(): void {
    this.open = !this.open;
    this.refresh();
    if (this.open && this.codes) this.blocks.show(this.codes, this.seconds * PAIRS);
  }

  private refresh(): void {
    const shown = this.open && this.codes !== null;
    press(byId('edit'), shown);
    byId<HTMLButtonElement>('edit').disabled = this.codes === null;
    byId('blocks').hidden = byId('edit-bar').hidden = !shown;
    for (const id of ['edit-replace', 'edit-repeat', 'edit-code'])
      byId<HTMLButtonElement>(id).disabled = this.block === null;
    byId<HTMLButtonElement>('edit-undo').disabled = this.past.length === 0;
  }

  private async selected(block: Block | null): Promise<void> {
    this.block = block;
    this.refresh();
    const what = byId('edit-what');
    if (!block || !this.codes) {
      what.textContent = 'Choose a block: click one, or drag over several.';
      return;
    }
    const half = block.halves[0];
    const code = this.codes[half][block.from];
    const span = [block.from, block.to].map((pair) => (pair / PAIRS).toFixed(1)).join('–');
    const name = block.halves.length > 1 ? 'Both' : half === 'upper' ? 'Upper' : 'Lower';
    what.textContent = `${name} ${span} s`;
    byId<HTMLInputElement>('edit-code').value = String(code);
    // What training did after the code before is likely to fit.
    const before = this.codes[half][block.from - 1];
    const books = await this.books().catch(() => null);
    const likely = books?.memory?.[half][before]?.next ?? [];
    byId('edit-likely').replaceChildren(
      ...likely.map(([next, uses]) => new Option(`followed ${before} ${uses}×`, String(next))),
    );
  }

  private async replace(): Promise<void> {
    const { block, codes } = this;
    const input = byId<HTMLInputElement>('edit-code');
    if (!block || !codes) return;
    const books = await this.books().catch(() => null);
    const code = typedCode(
      input,
      Math.min(...block.halves.map((half) => books?.[half] ?? Infinity)),
    );
    if (code === null) return;
    this.change(replaced(codes, block, code), block.from);
  }

  private repeat(): void {
    const { block, codes } = this;
    if (!block || !codes) return;
    this.change(repeated(codes, block), block.to);
    const length = block.to - block.from;
    const to = Math.min(block.to + length, codes.upper.length);
    if (to > block.to) this.blocks.select({ ...block, from: block.to, to });
  }

  private undo(): void {
    const before = this.past.pop();
    if (before) this.apply(before, this.block?.from ?? 0);
  }

  private change(codes: Codes, from: number): void {
    if (this.codes) this.past.push(this.codes);
    this.apply(codes, from);
  }

  private apply(codes: Codes, from: number): void {
    this.show(codes, this.seconds, false);
    this.onchange(codes, from / PAIRS);
  }
}
