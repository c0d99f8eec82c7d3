// npm install && npx tsc && node build/main.js song.mp3 http://127.0.0.1:8080
// Streams a dance, tells what arrives, and writes it as GLB.

import { openAsBlob } from 'node:fs';
import { writeFile } from 'node:fs/promises';
import { Bailando, BailandoError } from './client.js';

const [path = 'song.mp3', url = 'http://127.0.0.1:8080'] = process.argv.slice(2);
const bailando = new Bailando(url, process.env['BAILANDO_API_KEY']);
const song = await openAsBlob(path);
const options = { duration_s: 8, seed: 7 };
const started = performance.now();

try {
  let joints: string[] = [];
  for await (const event of bailando.stream(song, options)) {
    const after = `${((performance.now() - started) / 1000).toFixed(2)} s`;
    if (event.event === 'start') {
      joints = event.skeleton.joints;
      console.log(`${after}: ${event.frames} frames of ${joints.length} joints will come`);
    } else if (event.event === 'frames') {
      const head = joints.indexOf('head') * 3;
      const place = event.positions.slice(head, head + 3).map((metres) => Math.round(metres * 100));
      console.log(`${after}: ${event.count} frames from ${event.first}, head at ${place} cm`);
    } else {
      console.log(`${after}: done`);
    }
  }
  const glb = await bailando.generate(song, 'glb', options);
  await writeFile('dance.glb', new Uint8Array(await glb.arrayBuffer()));
  console.log(`dance.glb: ${glb.size} bytes`);
} catch (error) {
  if (!(error instanceof BailandoError)) throw error;
  console.error(`${error.kind}: ${error.message}`);
  process.exitCode = 1;
}
