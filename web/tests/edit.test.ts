import { expect, test } from 'vitest';
import { repeated, replaced, runs } from '../src/edit/codes';

const codes = { upper: [5, 5, 7, 7, 7, 5], lower: [1, 2, 2, 3, 3, 3] };

test('equal codes next to each other are one block', () => {
  expect(runs(codes, 'upper').map(({ from, to }) => [from, to])).toEqual([
    [0, 2],
    [2, 5],
    [5, 6],
  ]);
  expect(runs({ upper: [], lower: [] }, 'lower')).toEqual([]);
});

test('a block gets another code, of its own half only', () => {
  const { upper, lower } = replaced(codes, { from: 2, to: 5, halves: ['upper'] }, 9);
  expect(upper).toEqual([5, 5, 9, 9, 9, 5]);
  expect(lower).toBe(codes.lower);
});

test('a block comes once more, in place of what came after it', () => {
  const both = { from: 1, to: 3, halves: ['upper', 'lower'] } as const;
  expect(repeated(codes, both)).toEqual({ upper: [5, 5, 7, 5, 7, 5], lower: [1, 2, 2, 2, 2, 3] });
  // The dance keeps its length.
  const late = { from: 2, to: 5, halves: ['lower'] } as const;
  expect(repeated(codes, late).lower).toEqual([1, 2, 2, 3, 3, 2]);
  expect(codes.lower).toEqual([1, 2, 2, 3, 3, 3]);
});
