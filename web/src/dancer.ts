import type { Options } from './api/types';
import type { Dance } from './motion/dance';

export type DancerState = 'waiting' | 'streaming' | 'done' | 'failed';

/** One of the dancers side by side: what was asked for, and what has come of it. */
export interface Dancer {
  /** Place from the left, which also chooses the colour. */
  place: number;
  options: Options;
  dance: Dance | null;
  state: DancerState;
}

/** Options that give the same dance again. */
export function repeatable(dancer: Dancer): Options {
  const { dance, options } = dancer;
  const drawn: Options = dance ? { seed: String(dance.seed) } : {};
  if (dance?.style) drawn.style = dance.style;
  return { ...options, ...drawn };
}
