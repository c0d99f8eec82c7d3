// `bailando render` with a real Chromium and, where it is installed, ffmpeg: `make web-test`.
import assert from 'node:assert/strict';
import { spawnSync } from 'node:child_process';
import { mkdtemp, readFile, rm, writeFile } from 'node:fs/promises';
import { tmpdir } from 'node:os';
import { join } from 'node:path';
import { test } from 'node:test';
import { clicks } from './files.mjs';
import { project, settings } from './setup.mjs';

const has = (program) => spawnSync(program, ['-version']).status === 0;

test('a dance becomes a picture and a film', async (context) => {
  const { binary, model } = settings();
  if (/^http/.test(binary)) return context.skip('there is no binary');
  const folder = await mkdtemp(join(tmpdir(), 'bailando-film-'));
  const run = (...args) => spawnSync(binary, args, { cwd: project, encoding: 'utf8' });
  const file = (name) => join(folder, name);
  try {
    await writeFile(file('clicks.wav'), clicks(2));
    const song = ['generate', file('clicks.wav'), '-o', file('dance.json'), '--seed', '2'];
    const danced = run(...song, '--include-rotations', '--model-dir', model);
    assert.equal(danced.status, 0, danced.stderr);
    const size = ['--size', '160x120'];
    const drawn = run('render', file('dance.json'), '-o', file('dance.png'), ...size, '--dark');
    assert.equal(drawn.status, 0, drawn.stderr);
    const png = await readFile(file('dance.png'));
    assert.equal(png.toString('latin1', 1, 4), 'PNG');
    assert.deepEqual([png.readUInt32BE(16), png.readUInt32BE(20)], [160, 120]);
    // Somebody is there: one colour would take a few hundred bytes.
    assert.ok(png.length > 2000, String(png.length));
    if (!has('ffmpeg')) return context.diagnostic('no ffmpeg: no film');
    const film = ['render', file('dance.json'), '-o', file('dance.mp4'), ...size];
    const filmed = run(...film, '--audio', file('clicks.wav'), '--fps', '5');
    assert.equal(filmed.status, 0, filmed.stderr);
    assert.match(filmed.stdout, /10 pictures at 5 a second/);
    const mp4 = await readFile(file('dance.mp4'), 'latin1');
    assert.ok(mp4.includes('ftyp') && mp4.includes('avc1') && mp4.includes('mp4a'));
    const moved = run('render', file('dance.json'), '-o', file('dance.gif'), ...size, '--fps', '2');
    assert.equal(moved.status, 0, moved.stderr);
    assert.equal((await readFile(file('dance.gif'))).toString('latin1', 0, 6), 'GIF89a');
  } finally {
    await rm(folder, { recursive: true, force: true });
  }
});
