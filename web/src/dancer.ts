import type { Codes, Options } from './api/types';
import type { Dance } from './motion/dance';

export type DancerState = 'waiting' | 'streaming' | 'done' | 'failed';

/** One of the dancers side by side: what was asked for, and what has come of it. */
export interface Dancer {
  /** Place from the left, which also chooses the colour. */
  place: number;
  options: Options;
  dance: Dance | null;
  state: DancerState;
  /** What the server trimmed or assumed. */
  warnings?: string[];
}

/** Options that still mean something where the codes are given. */
const KEPT = ['root_motion', 'clean'];

/** Options of the same dance with other codes. */
export function recoded({ dance, options }: Dancer, codes: Codes): Options {
  const kept = KEPT.filter((name) => options[name] !== undefined);
  return {
    ...Object.fromEntries(kept.map((name) => [name, options[name]])),
    seed: String(dance?.seed ?? 0),
    duration_s: String(dance?.duration ?? 0),
    codes: JSON.stringify(codes),
  };
}

/** Options that give the same dance again. */
export function repeatable(dancer: Dancer): Options {
  const { dance, options } = dancer;
  // Given codes are the dance.
  if (options.codes !== undefined) return options;
  const drawn: Options = dance ? { seed: String(dance.seed) } : {};
  if (dance?.style) drawn.style = dance.style;
  return { ...options, ...drawn };
}
