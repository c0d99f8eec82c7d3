import type { Server } from '../api/server';
import type { Dancer } from '../dancer';
import { generate } from '../generation';
import { byId } from '../ui/dom';
import { MemoryPanel, type Pair } from './panel';
import { REPEATS, shown, speeds } from './speed';

/** Shows what pairs of codes look like, in place of the dance. */
export class Memory {
  readonly panel = new MemoryPanel();
  /** What is shown, while the memory is open. */
  readonly dancer: Dancer = { place: 0, options: {}, dance: null, state: 'waiting' };
  open = false;
  private filled = false;
  private running: AbortController | null = null;
  private range: [number, number] = [0, 0];
  private since = 0;

  constructor(
    private readonly server: Server,
    private readonly changed: () => void,
    private readonly failed: (error: unknown) => void,
  ) {
    this.panel.onshow = (pair, then) => void this.show(pair, then);
  }

  async enter(): Promise<void> {
    this.open = true;
    this.since = performance.now();
    document.body.dataset.mode = 'memory';
    byId('memory-close').focus();
    if (this.filled) return;
    try {
      const books = await this.server.codes();
      this.filled = true;
      this.panel.fill(books);
    } catch (error) {
      this.failed(error);
    }
  }

  leave(): void {
    this.open = false;
    this.running?.abort();
    delete document.body.dataset.mode;
  }

  /** The moment that is shown: the preview goes round. */
  time(now: number): number {
    const [from, to] = this.range;
    return from + (((now - this.since) / 1000) % Math.max(to - from, 1 / 60));
  }

  private async show(pair: Pair, then: Pair | null): Promise<void> {
    this.running?.abort();
    const running = (this.running = new AbortController());
    const pairs = then ? [pair, then] : [pair];
    const codes = pairs.flatMap(({ upper, lower }) =>
      Array.from({ length: REPEATS }, () => [upper, lower]),
    );
    // As decoded: clean-up would hide what the codes do.
    const options = { codes: JSON.stringify(codes), clean: 'false', seed: '0' };
    const dancer: Dancer = { ...this.dancer, options, dance: null, state: 'waiting' };
    try {
      const quiet = { started: () => {}, arrived: () => {} };
      await generate(this.server, null, [dancer], running.signal, quiet);
    } catch (error) {
      if (!running.signal.aborted) this.failed(error);
      return;
    }
    if (running.signal.aborted || !dancer.dance) return;
    this.dancer.dance = dancer.dance;
    this.range = shown(pairs.length);
    this.since = performance.now();
    const { held, change } = speeds(dancer.dance);
    const metres = (speed: number) => `${speed.toFixed(2)} m/s`;
    this.panel.tell(
      change === null
        ? `Held: all joints move by ${metres(held[0])} on average.`
        : `Held: ${held.map(metres).join(', then ')}. The change: ${metres(change)} at most.`,
    );
    this.changed();
  }
}
