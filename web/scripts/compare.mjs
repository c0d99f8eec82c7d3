// Compares the build in .check with the committed one in dist: `npm run check`.
import { readdirSync, readFileSync, rmSync } from 'node:fs';
import { join } from 'node:path';

const root = join(import.meta.dirname, '..');
const list = (folder) =>
  readdirSync(join(root, folder), { withFileTypes: true, recursive: true })
    .filter((entry) => entry.isFile() && entry.name !== 'build.json')
    .map((entry) => join(entry.parentPath, entry.name).slice(join(root, folder).length + 1))
    .sort();
const [fresh, kept] = [list('.check'), list('dist')];
const differing = fresh.filter(
  (file) =>
    !kept.includes(file) ||
    !readFileSync(join(root, '.check', file)).equals(readFileSync(join(root, 'dist', file))),
);
const gone = kept.filter((file) => !fresh.includes(file));
rmSync(join(root, '.check'), { recursive: true });
if (differing.length + gone.length > 0) {
  console.error(`web/dist is not what the sources build: ${[...differing, ...gone].join(', ')}`);
  console.error('Build it again: make web');
  process.exit(1);
}
console.log(`web/dist is what the sources build: ${kept.length} files`);
