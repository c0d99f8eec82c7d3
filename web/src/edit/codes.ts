import type { Codes } from '../api/types';

/** Halves of the body that have codes of their own. */
export type Half = 'upper' | 'lower';
export const HALVES: readonly Half[] = ['upper', 'lower'];

/** Pairs from `from` up to `to`, of one half or of both. */
export interface Block {
  from: number;
  to: number;
  halves: readonly Half[];
}

/** The runs of equal codes of a half, in order. */
export function runs(codes: Codes, half: Half): Block[] {
  const found: Block[] = [];
  codes[half].forEach((code, at) => {
    const last = found.at(-1);
    if (last && code === codes[half][at - 1]) last.to = at + 1;
    else found.push({ from: at, to: at + 1, halves: [half] });
  });
  return found;
}

/** The codes with another one throughout a block. */
export function replaced(codes: Codes, block: Block, code: number): Codes {
  return changed(codes, block.halves, (old, at) =>
    at >= block.from && at < block.to ? code : old[at],
  );
}

/** The codes with a block once more after itself, in place of what came there. */
export function repeated(codes: Codes, block: Block): Codes {
  const length = block.to - block.from;
  return changed(codes, block.halves, (old, at) =>
    at >= block.to && at < block.to + length ? old[at - length] : old[at],
  );
}

function changed(
  codes: Codes,
  halves: readonly Half[],
  code: (old: number[], at: number) => number,
): Codes {
  const half = (name: Half) =>
    halves.includes(name) ? codes[name].map((_, at) => code(codes[name], at)) : codes[name];
  return { upper: half('upper'), lower: half('lower') };
}
