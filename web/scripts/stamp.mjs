// Writes dist/build.json: a hash of the sources, and one of every built file. A Rust test compares
// both with what lies in the repository (tests/server/viewer.rs).
import { createHash } from 'node:crypto';
import { readdirSync, readFileSync, writeFileSync } from 'node:fs';
import { join, relative } from 'node:path';

const root = join(import.meta.dirname, '..');

/** What a build depends on, beside the folders `src` and `public`. */
const FILES = [
  'index.html',
  'package.json',
  'package-lock.json',
  'tsconfig.json',
  'vite.config.ts',
];

function filesIn(folder) {
  return readdirSync(folder, { withFileTypes: true, recursive: true })
    .filter((entry) => entry.isFile())
    .map((entry) => relative(root, join(entry.parentPath, entry.name)).replaceAll('\\', '/'));
}

const hash = (bytes) => createHash('sha256').update(bytes).digest('hex');
const read = (file) => readFileSync(join(root, file));

/** SHA-256 over lines of `hash  path`, in the order of the paths. */
function sources() {
  const files = [...FILES, ...filesIn(join(root, 'src')), ...filesIn(join(root, 'public'))].sort();
  return hash(files.map((file) => `${hash(read(file))}  ${file}\n`).join(''));
}

const built = filesIn(join(root, 'dist'))
  .filter((file) => file !== 'dist/build.json')
  .sort();
const files = Object.fromEntries(built.map((file) => [file.slice(5), hash(read(file))]));
const json = JSON.stringify({ sources: sources(), files }, null, 2);
writeFileSync(join(root, 'dist/build.json'), `${json}\n`);
