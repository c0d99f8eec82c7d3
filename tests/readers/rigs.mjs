// Opens dances on rigs with three.js, three-vrm and the Khronos validator, and says what else of a
// file has changed (see scripts/check-rigs.sh).
//
// Usage: node rigs.mjs FOLDER NODE_MODULES; writes FOLDER/three/NAME.json, {frame: {bone: place}}.

import fs from 'node:fs';
import { createRequire } from 'node:module';
import path from 'node:path';
import { pathToFileURL } from 'node:url';

const EVERY = 36;
const [folder, modules] = process.argv.slice(2).map((name) => path.resolve(name));
const load = (file) => import(pathToFileURL(path.join(modules, file)));
const require = createRequire(path.join(modules, 'none.js'));
const THREE = await load('three/build/three.module.js');
const { GLTFLoader } = await load('three/examples/jsm/loaders/GLTFLoader.js');
const { BVHLoader } = await load('three/examples/jsm/loaders/BVHLoader.js');
const vrm = await load('@pixiv/three-vrm/lib/three-vrm.module.js');
const validator = require('gltf-validator');
const { fps, frames } = JSON.parse(fs.readFileSync(path.join(folder, 'dance.json')));
// Textures are nothing for node, and none of this concern.
globalThis.self ??= globalThis;
const silent = () => {};
console.error = silent;
console.warn = silent;
fs.mkdirSync(path.join(folder, 'three'), { recursive: true });
let failed = false;

const read = (...names) => new Uint8Array(fs.readFileSync(path.join(folder, ...names)));
const mapped = (file) => {
  const { bones } = JSON.parse(fs.readFileSync(path.join(folder, 'mapping', `${file}.json`)));
  return new Set(Object.values(bones).flat());
};

function chunks(bytes) {
  const view = new DataView(bytes.buffer, bytes.byteOffset);
  const size = view.getUint32(12, true);
  const json = JSON.parse(new TextDecoder().decode(bytes.subarray(20, 20 + size)));
  return { json, binary: bytes.subarray(28 + size) };
}

/** What differs of a file but for the dance. */
function changes(before, after) {
  const [old, now] = [before, after].map(chunks);
  const wrong = [];
  // Bytes beyond the buffer's length pad the chunk.
  const length = old.json.buffers[0].byteLength;
  if (!Buffer.from(old.binary.subarray(0, length)).equals(now.binary.subarray(0, length))) {
    wrong.push('BIN');
  }
  now.json.buffers[0].byteLength = length;
  for (const key of ['accessors', 'bufferViews', 'animations']) {
    const count = old.json[key]?.length ?? 0;
    now.json[key].length = count;
    if (count === 0) delete now.json[key];
  }
  for (const key of new Set([...Object.keys(old.json), ...Object.keys(now.json)])) {
    if (JSON.stringify(old.json[key]) !== JSON.stringify(now.json[key])) wrong.push(key);
  }
  return wrong;
}

function sample(root, clip, bones, file) {
  const mixer = new THREE.AnimationMixer(root);
  const action = mixer.clipAction(clip);
  action.setLoop(THREE.LoopOnce);
  action.clampWhenFinished = true;
  action.play();
  const seen = {};
  for (let frame = 0; frame < frames; frame += EVERY) {
    mixer.setTime(frame / fps);
    root.updateMatrixWorld(true);
    seen[frame] = Object.fromEntries(bones.map(([index, bone]) =>
      [index, bone.getWorldPosition(new THREE.Vector3()).toArray()]));
  }
  fs.writeFileSync(path.join(folder, 'three', `${file}.json`), JSON.stringify(seen));
}

async function gltf(file) {
  const loader = new GLTFLoader();
  // A VRM that poses itself would overwrite the dance on its bones.
  if (file.endsWith('.vrm')) {
    const options = { autoUpdateHumanBones: false };
    loader.register((parser) => new vrm.VRMLoaderPlugin(parser, options));
  }
  const bytes = read('danced', file);
  const loaded = await loader.parseAsync(bytes.buffer.slice(bytes.byteOffset), '');
  const names = mapped(file);
  const bones = [];
  for (const [object, { nodes }] of loaded.parser.associations) {
    if (nodes === undefined || !object.isObject3D) continue;
    if (names.has(loaded.parser.json.nodes[nodes].name)) bones.push([nodes, object]);
  }
  const clip = loaded.animations.find((animation) => animation.name === 'Dance');
  sample(loaded.scene, clip, bones, file);
  loaded.userData.vrm?.update(0);
  return `${bones.length} bones, ${clip.tracks.length} tracks, ${clip.duration.toFixed(3)} s`;
}

function bvh(file) {
  const text = new TextDecoder().decode(read('danced', file));
  const { skeleton, clip } = new BVHLoader().parse(text);
  const names = mapped(file);
  const bones = [...skeleton.bones.entries()].filter(([, bone]) => names.has(bone.name));
  // three.js displaces what has an OFFSET at its root, with the file's own motion, too.
  const offset = /OFFSET\s+(\S+)\s+(\S+)\s+(\S+)/.exec(text).slice(1).map(Number);
  if (offset.every((number) => number === 0)) sample(skeleton.bones[0], clip, bones, file);
  return `${bones.length} bones, ${clip.tracks.length} tracks, ${clip.duration.toFixed(3)} s`;
}

for (const file of fs.readdirSync(path.join(folder, 'danced')).sort()) {
  let note;
  if (file.endsWith('.bvh')) {
    const [before, after] = ['rigs', 'danced'].map((name) => Buffer.from(read(name, file)));
    const end = before.indexOf('MOTION');
    const same = before.subarray(0, end).equals(after.subarray(0, end));
    failed ||= !same;
    note = `${bvh(file)}; hierarchy ${same ? 'byte for byte' : 'CHANGED'}`;
  } else {
    const reports = [];
    for (const name of ['rigs', 'danced']) {
      const report = await validator.validateBytes(read(name, file), { maxIssues: 0 });
      reports.push([report.issues.numErrors, report.issues.numWarnings]);
    }
    const changed = changes(read('rigs', file), read('danced', file));
    // A rig's own mistakes are its own.
    const worse = reports[1].some((count, kind) => count > reports[0][kind]);
    failed ||= worse || changed.length > 0;
    note = `${await gltf(file)}; validator ${reports[1].join(' errors, ')} warnings, ` +
      `before ${reports[0].join(' and ')}; changed: ${changed.join(', ') || 'nothing'}`;
  }
  console.log(`${file.padEnd(24)} ${note}`);
}
process.exitCode = failed ? 1 : 0;
