// Files that the tests bring: songs and a character, made here.

/** 16-bit WAV of `seconds` with a click every `beat` seconds. */
export function clicks(seconds, beat = 0.5, rate = 22_050) {
  const samples = new Int16Array(Math.round(seconds * rate));
  for (let start = 0; start < seconds; start += beat) {
    const from = Math.round(start * rate);
    for (let i = 0; i < 0.03 * rate && from + i < samples.length; i++) {
      const fade = Math.exp((-i / rate) * 120);
      samples[from + i] = Math.round(26_000 * fade * Math.sin((2 * Math.PI * 1200 * i) / rate));
    }
  }
  return wav(Buffer.from(samples.buffer), rate, 16);
}

/** Silence of `seconds`, as small as WAV can be. */
export function silence(seconds) {
  return wav(Buffer.alloc(seconds * 8000, 128), 8000, 8);
}

function wav(data, rate, bits) {
  const head = Buffer.alloc(44);
  head.write('RIFF', 0);
  head.writeUInt32LE(36 + data.length, 4);
  head.write('WAVEfmt ', 8);
  head.writeUInt32LE(16, 16);
  head.writeUInt16LE(1, 20);
  head.writeUInt16LE(1, 22);
  head.writeUInt32LE(rate, 24);
  head.writeUInt32LE((rate * bits) / 8, 28);
  head.writeUInt16LE(bits / 8, 32);
  head.writeUInt16LE(bits, 34);
  head.write('data', 36);
  head.writeUInt32LE(data.length, 40);
  return Buffer.concat([head, data]);
}

/** Bones of a small humanoid: name, parent, place from the parent in metres. */
const BONES = [
  ['hips', null, [0, 0.9, 0]],
  ['spine', 'hips', [0, 0.12, 0]],
  ['chest', 'spine', [0, 0.15, 0]],
  ['neck', 'chest', [0, 0.22, 0]],
  ['head', 'neck', [0, 0.08, 0]],
  ...['left', 'right'].flatMap((side) => {
    const x = side === 'left' ? 1 : -1;
    return [
      [`${side}UpperArm`, 'chest', [x * 0.17, 0.16, 0]],
      [`${side}LowerArm`, `${side}UpperArm`, [x * 0.26, 0, 0]],
      [`${side}Hand`, `${side}LowerArm`, [x * 0.24, 0, 0]],
      [`${side}UpperLeg`, 'hips', [x * 0.09, -0.05, 0]],
      [`${side}LowerLeg`, `${side}UpperLeg`, [0, -0.4, 0]],
      [`${side}Foot`, `${side}LowerLeg`, [0, -0.38, 0]],
    ];
  }),
];

/** A VRM character of boxes; of version 1, or of version 0, which faces the other way. */
export function vrm(version = 1) {
  const turn = version === 0 ? -1 : 1;
  const bones = BONES.map(([name, parent, [x, y, z]]) => [name, parent, [x * turn, y, z * turn]]);
  const named = BONES.map(([name], node) => [name, node]);
  return character(bones, version === 0 ? version0(named) : version1(named));
}

/** The same character as a GLB whose bones are named as by Mixamo. */
export function mixamo() {
  const parts = {
    spine: 'Spine1',
    chest: 'Spine2',
    UpperArm: 'Arm',
    LowerArm: 'ForeArm',
    UpperLeg: 'UpLeg',
    LowerLeg: 'Leg',
  };
  const renamed = (name) => {
    const [, side = '', part] = /^(left|right)?(.*)$/.exec(name);
    const word = parts[part] ?? part;
    return `mixamorig:${[side, word].map((s) => s.slice(0, 1).toUpperCase() + s.slice(1)).join('')}`;
  };
  return character(
    BONES.map(([name, parent, at]) => [renamed(name), parent && renamed(parent), at]),
  );
}

/** A glTF character with a box at each bone. */
export function character(bones, more = {}) {
  const nodes = bones.map(([name, , translation]) => ({
    name: `bone_${name}`,
    mesh: 0,
    translation,
    children: bones.flatMap(([, parent], i) => (parent === name ? [i] : [])),
  }));
  for (const node of nodes) if (node.children.length === 0) delete node.children;
  const bin = box();
  const json = {
    asset: { version: '2.0' },
    scene: 0,
    scenes: [{ nodes: [0] }],
    nodes,
    meshes: [{ primitives: [{ attributes: { POSITION: 0 }, indices: 1, material: 0 }] }],
    materials: [{ pbrMetallicRoughness: { baseColorFactor: [0.3, 0.5, 0.8, 1] } }],
    accessors: [
      {
        bufferView: 0,
        componentType: 5126,
        count: 8,
        type: 'VEC3',
        min: [-0.06, -0.06, -0.06],
        max: [0.06, 0.06, 0.06],
      },
      { bufferView: 1, componentType: 5123, count: 36, type: 'SCALAR' },
    ],
    bufferViews: [
      { buffer: 0, byteOffset: 0, byteLength: 96 },
      { buffer: 0, byteOffset: 96, byteLength: 72 },
    ],
    buffers: [{ byteLength: bin.length }],
    ...more,
  };
  return glb(json, bin);
}

function version1(bones) {
  const humanBones = Object.fromEntries(bones.map(([name, node]) => [name, { node }]));
  const meta = {
    name: 'Boxes',
    version: '1',
    authors: ['bailando'],
    licenseUrl: 'https://vrm.dev/licenses/1.0/',
  };
  const VRMC_vrm = { specVersion: '1.0', meta, humanoid: { humanBones } };
  return { extensionsUsed: ['VRMC_vrm'], extensions: { VRMC_vrm } };
}

function version0(bones) {
  const humanBones = bones.map(([bone, node]) => ({ bone, node, useDefaultValues: true }));
  const VRM = {
    specVersion: '0.0',
    meta: { title: 'Boxes' },
    humanoid: { humanBones },
    materialProperties: [
      {
        name: 'x',
        shader: 'VRM_USE_GLTFSHADER',
        keywordMap: {},
        tagMap: {},
        floatProperties: {},
        vectorProperties: {},
        textureProperties: {},
      },
    ],
  };
  return { extensionsUsed: ['VRM'], extensions: { VRM } };
}

function box() {
  const corners = new Float32Array(24);
  for (let i = 0; i < 8; i++)
    for (let k = 0; k < 3; k++) corners[i * 3 + k] = (i >> k) & 1 ? 0.06 : -0.06;
  const faces = [
    0, 2, 1, 1, 2, 3, 4, 5, 6, 5, 7, 6, 0, 1, 4, 1, 5, 4, 2, 6, 3, 3, 6, 7, 0, 4, 2, 2, 4, 6, 1, 3,
    5, 3, 7, 5,
  ];
  return Buffer.concat([Buffer.from(corners.buffer), Buffer.from(Uint16Array.from(faces).buffer)]);
}

function glb(json, bin) {
  const text = Buffer.from(JSON.stringify(json));
  const padded = Buffer.concat([text, Buffer.alloc((4 - (text.length % 4)) % 4, 32)]);
  const chunk = (kind, data) => {
    const head = Buffer.alloc(8);
    head.writeUInt32LE(data.length, 0);
    head.write(kind, 4, 'latin1');
    return Buffer.concat([head, data]);
  };
  const body = Buffer.concat([chunk('JSON', padded), chunk('BIN\0', bin)]);
  const head = Buffer.alloc(12);
  head.write('glTF', 0);
  head.writeUInt32LE(2, 4);
  head.writeUInt32LE(12 + body.length, 8);
  return Buffer.concat([head, body]);
}
