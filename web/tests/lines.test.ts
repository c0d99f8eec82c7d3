import { expect, test } from 'vitest';
import { floats, jsonLines } from '../src/api/lines';
import { curl } from '../src/api/server';

function body(...parts: string[]): ReadableStream<Uint8Array> {
  const encoder = new TextEncoder();
  return new ReadableStream({
    start(controller) {
      for (const part of parts) controller.enqueue(encoder.encode(part));
      controller.close();
    },
  });
}

test('lines come whole, however the network cuts them', async () => {
  const found = [];
  for await (const value of jsonLines(body('{"a":', '1}\n{"b":2}', '\n\n{"c":"é', '"}'))) {
    found.push(value);
  }
  expect(found).toEqual([{ a: 1 }, { b: 2 }, { c: 'é' }]);
});

test('packed numbers are little-endian float32', () => {
  expect([...floats(btoa('\0\0\x80?\0\0\0\xc0'))]).toEqual([1, -2]);
});

test('the command survives a shell', () => {
  const options = { seed: '7', style: "can't" };
  expect(curl('http://h/generate', 'my "song".mp3', options, 'bvh')).toBe(
    `curl --fail-with-body -F 'file=@"my \\"song\\".mp3"' -F seed=7 -F 'style=can'\\''t' -F format=bvh ` +
      `http://h/generate -o 'my "song".bvh'`,
  );
});
