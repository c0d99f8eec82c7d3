// Uses the types that openapi-typescript makes with openapi-fetch: JSON, BVH and a job.
//
// usage: node use.js ADDRESS SONG
import { readFileSync } from 'node:fs';
import { setTimeout } from 'node:timers/promises';
import createClient from 'openapi-fetch';
import type { components, paths } from './types.js';

type Form = components['schemas']['GenerateForm'];

const [address, song] = process.argv.slice(2);
if (!address || !song) throw new Error('usage: use.js ADDRESS SONG');
const client = createClient<paths, 'application/json'>({ baseUrl: address });
const file = new Blob([readFileSync(song)]);
const form: Form = { file, seed: 7, duration_s: 3, fps: 30 };

/** Writes the parts of a form; a song alone is the body. */
function bodySerializer(body: Form | Blob | undefined): FormData | Blob {
  if (body === undefined || body instanceof Blob) return body ?? new Blob();
  const parts = new FormData();
  for (const [name, value] of Object.entries(body)) {
    parts.append(name, value instanceof Blob ? value : String(value));
  }
  return parts;
}

function expect(holds: boolean, what: unknown): asserts holds {
  if (!holds) throw new Error(JSON.stringify(what));
}

const dance = await client.POST('/generate', { body: form, bodySerializer });
expect(dance.data?.seed === 7 && dance.data.frames === 90, dance.error);

const query = { seed: 7, duration_s: 3, format: 'bvh' } as const;
const headers = { 'content-type': 'audio/mpeg' };
const bvh = await client.POST('/generate', {
  params: { query },
  body: file,
  bodySerializer,
  headers,
  parseAs: 'text',
});
expect(bvh.data?.startsWith('HIERARCHY') === true, bvh.error);

const job = await client.POST('/jobs', { body: form, bodySerializer });
expect(job.data !== undefined, job.error);
const path = { id: job.data.id };
for (let tries = 0; tries < 600; tries += 1) {
  const { data, error } = await client.GET('/jobs/{id}', { params: { path } });
  expect(data !== undefined, error);
  if (data.result) break;
  await setTimeout(100);
}
const result = await client.GET('/jobs/{id}/result', { params: { path } });
expect(result.data?.frames === 90, result.error);
await client.DELETE('/jobs/{id}', { params: { path } });
console.log('openapi-typescript: JSON, BVH and a job');
