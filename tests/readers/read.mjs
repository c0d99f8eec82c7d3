// Reads the files of a folder with packages from npm that share nothing with this project, and
// compares joints with forward kinematics (see scripts/check-formats.sh).
//
// Usage: node read.mjs FOLDER NODE_MODULES; prints a line per reader and file, and fails where one
// is over 2 mm or a validator has something to say.

import fs from 'node:fs';
import { createRequire } from 'node:module';
import path from 'node:path';
import { pathToFileURL } from 'node:url';

const MOST_MM = 2;
const [folder, modules] = process.argv.slice(2).map((name) => path.resolve(name));
const load = (file) => import(pathToFileURL(path.join(modules, file)));
const require = createRequire(path.join(modules, 'none.js'));
const THREE = await load('three/build/three.module.js');
const json = JSON.parse(fs.readFileSync(path.join(folder, 'dance.json')));
const table = fs.readFileSync(new URL('expected.py', import.meta.url), 'utf8').split('"""')[3];
const columns = table.trim().split('\n').map((row) => row.split(' '));
const SKELETONS = ['smpl', 'mixamo', 'vrm', 'unreal', 'mmd'];
let failed = false;

function names(skeleton) {
  const column = columns.map((row) => row[SKELETONS.indexOf(skeleton)]);
  return skeleton === 'mixamo' ? column.map((name) => `mixamorig:${name}`) : column;
}

/** World positions in metres of all joints in a frame. */
function forward(frame) {
  const world = [];
  return json.skeleton.parents.map((parent, joint) => {
    const local = new THREE.Quaternion(...json.rotations[frame][joint]);
    if (parent < 0) {
      world.push({ turn: local, place: new THREE.Vector3(...json.root[frame]) });
    } else {
      const place = new THREE.Vector3(...json.skeleton.offsets[joint]);
      place.applyQuaternion(world[parent].turn).add(world[parent].place);
      world.push({ turn: world[parent].turn.clone().multiply(local), place });
    }
    return world[joint].place;
  });
}

function tell(reader, file, millimetres, note = '') {
  failed ||= !(millimetres < MOST_MM);
  console.log(`${reader.padEnd(24)} ${file.padEnd(16)} ${millimetres.toFixed(3)} mm  ${note}`);
}

const files = (extension) => fs.readdirSync(folder).filter((f) => f.endsWith(extension)).sort();
const bytes = (file) => {
  const data = fs.readFileSync(path.join(folder, file));
  return data.buffer.slice(data.byteOffset, data.byteOffset + data.byteLength);
};

/** The largest distance in millimetres of bones under `root` while `clip` plays. */
function largest(root, clip, skeleton, scale = 1, update = () => {}) {
  const bones = names(skeleton).map((name) => {
    const wanted = THREE.PropertyBinding.sanitizeNodeName(name);
    const bone = root.getObjectByName(wanted) ?? root.getObjectByName(name);
    if (!bone) throw new Error(`no bone ${name}`);
    return bone;
  });
  const mixer = new THREE.AnimationMixer(root);
  const action = mixer.clipAction(clip);
  action.setLoop(THREE.LoopOnce);
  action.clampWhenFinished = true;
  action.play();
  let most = 0;
  for (let frame = 0; frame < json.frames; frame += 7) {
    mixer.setTime(frame / json.fps);
    update();
    root.updateMatrixWorld(true);
    forward(frame).forEach((place, joint) => {
      const seen = bones[joint].getWorldPosition(new THREE.Vector3()).multiplyScalar(scale);
      most = Math.max(most, 1000 * seen.distanceTo(place));
    });
  }
  return most;
}

const stem = (file) => path.parse(file).name;
const note = (clip) => `${clip.duration.toFixed(3)} s, ${clip.tracks.length} tracks`;

const { BVHLoader } = await load('three/examples/jsm/loaders/BVHLoader.js');
for (const file of files('.bvh')) {
  const { skeleton, clip } = new BVHLoader().parse(fs.readFileSync(path.join(folder, file), 'utf8'));
  tell('three BVHLoader', file, largest(skeleton.bones[0], clip, stem(file), 0.01), note(clip));
}

const { FBXLoader } = await load('three/examples/jsm/loaders/FBXLoader.js');
for (const file of files('.fbx')) {
  const group = new FBXLoader().parse(bytes(file), '');
  const clip = group.animations[0];
  tell('three FBXLoader', file, largest(group, clip, stem(file), 0.01), `${clip.name}, ${note(clip)}`);
}

const { GLTFLoader } = await load('three/examples/jsm/loaders/GLTFLoader.js');
for (const file of files('.glb')) {
  const gltf = await new GLTFLoader().parseAsync(bytes(file), '');
  const clip = gltf.animations[0];
  tell('three GLTFLoader', file, largest(gltf.scene, clip, stem(file)), note(clip));
}

// Babylon.js has no window here: its engine draws nothing.
if (fs.existsSync(path.join(modules, '@babylonjs/loaders'))) {
  const BABYLON = await load('@babylonjs/core/index.js');
  await load('@babylonjs/loaders/glTF/index.js');
  for (const file of files('.glb')) {
    const scene = new BABYLON.Scene(new BABYLON.NullEngine());
    scene.useRightHandedSystem = true;
    const data = new Uint8Array(bytes(file));
    await BABYLON.AppendSceneAsync(data, scene, { pluginExtension: '.glb' });
    const [clip] = scene.animationGroups;
    clip.start();
    clip.pause();
    let most = 0;
    for (let frame = 0; frame < json.frames; frame += 7) {
      // Its frames are those of 60 a second.
      clip.goToFrame((frame * 60) / json.fps);
      scene.transformNodes.forEach((node) => node.computeWorldMatrix(true));
      const places = forward(frame);
      names(stem(file)).forEach((name, joint) => {
        const { x, y, z } = scene.getTransformNodeByName(name).getAbsolutePosition();
        most = Math.max(most, 1000 * places[joint].distanceTo(new THREE.Vector3(x, y, z)));
      });
    }
    tell('Babylon.js', file, most, `${clip.name}, frames ${clip.from} to ${clip.to}`);
  }
}

const validator = require('gltf-validator');
for (const file of [...files('.glb'), ...files('.vrma')]) {
  const report = await validator.validateBytes(new Uint8Array(bytes(file)), { maxIssues: 50 });
  const { numErrors, numWarnings, numInfos, messages } = report.issues;
  const codes = [...new Set(messages.map((message) => message.code))].join(' ');
  failed ||= numErrors + numWarnings > 0;
  console.log(`${'Khronos validator'.padEnd(24)} ${file.padEnd(16)} ` +
    `${numErrors} errors, ${numWarnings} warnings, ${numInfos} infos  ${codes}`);
}

// An avatar is made of the bones in vrm.glb, and driven as a VRM is.
const vrm = await load('@pixiv/three-vrm/lib/three-vrm.module.js');
const vrma = await load('@pixiv/three-vrm-animation/lib/three-vrm-animation.module.js');
for (const file of files('.vrma')) {
  const loader = new GLTFLoader();
  loader.register((parser) => new vrma.VRMAnimationLoaderPlugin(parser));
  const [animation] = (await loader.parseAsync(bytes(file), '')).userData.vrmAnimations;
  const avatar = await new GLTFLoader().parseAsync(bytes('vrm.glb'), '');
  const bones = {};
  for (const name of names('vrm')) bones[name] = { node: avatar.scene.getObjectByName(name) };
  const humanoid = new vrm.VRMHumanoid(bones);
  avatar.scene.add(humanoid.normalizedHumanBonesRoot);
  const clip = vrma.createVRMAnimationClip(animation, { humanoid, meta: { metaVersion: '1' } });
  const most = largest(avatar.scene, clip, 'vrm', 1, () => humanoid.update());
  tell('three-vrm-animation', file, most, note(clip));
}

// Limbs point where the joints are: a model's own lengths are not known.
const { Parser } = require('mmd-parser');
for (const file of files('.vmd')) {
  const parsed = new Parser().parseVmd(bytes(file), true);
  const tracks = new Map();
  for (const key of parsed.motions) {
    if (!tracks.has(key.boneName)) tracks.set(key.boneName, []);
    tracks.get(key.boneName).push(key);
  }
  const turn = (bone, frame) => {
    const keys = tracks.get(bone);
    const next = Math.max(1, keys.findIndex((key) => key.frameNum >= frame));
    const [from, to] = [keys[next - 1], keys[next]];
    const part = (frame - from.frameNum) / (to.frameNum - from.frameNum);
    return new THREE.Quaternion(...from.rotation).slerp(new THREE.Quaternion(...to.rotation), part);
  };
  const joints = json.skeleton.joints;
  const arm = 35 * Math.PI / 180;
  let most = 0;
  for (let frame = 0; frame < json.frames; frame += 14) {
    const places = forward(frame);
    for (const [side, x] of [['左', 1], ['右', -1]]) {
      const trunk = ['センター', '上半身', '上半身2', `${side}肩`, `${side}腕`];
      const hanging = [x * Math.cos(arm), -Math.sin(arm), 0];
      const letter = side === '左' ? 'l' : 'r';
      for (const [chain, rest, from, to] of [
        [trunk, hanging, 'shoulder', 'elbow'],
        [[...trunk, `${side}ひじ`], hanging, 'elbow', 'wrist'],
        [['センター', `${side}足`], [0, -1, 0], 'hip', 'knee'],
        [['センター', `${side}足`, `${side}ひざ`], [0, -1, 0], 'knee', 'ankle'],
      ]) {
        const world = chain.reduce(
          (all, bone) => all.multiply(turn(bone, frame * 30 / json.fps)), new THREE.Quaternion());
        const [a, b] = [from, to].map((name) => places[joints.indexOf(`${letter}_${name}`)]);
        const bone = b.clone().sub(a);
        const seen = new THREE.Vector3(...rest).applyQuaternion(world).multiplyScalar(bone.length());
        most = Math.max(most, 1000 * seen.distanceTo(bone));
      }
    }
  }
  tell('mmd-parser', file, most, `${parsed.metadata.motionCount} keys of ${tracks.size} bones`);
}

try {
  const assimp = await require('assimpjs')();
  for (const file of [...files('.fbx'), ...files('.glb')]) {
    const list = new assimp.FileList();
    list.AddFile(file, new Uint8Array(bytes(file)));
    const result = assimp.ConvertFileList(list, 'assjson');
    if (!result.IsSuccess()) throw new Error(`${file}: ${result.GetErrorCode()}`);
    const scene = JSON.parse(new TextDecoder().decode(result.GetFile(0).GetContent()));
    const [clip] = scene.animations;
    const seconds = clip.duration / (clip.tickspersecond || 1);
    console.log(`${'assimp'.padEnd(24)} ${file.padEnd(16)} opens: animation ${clip.name}, ` +
      `${seconds.toFixed(3)} s, ${clip.channels.length} channels`);
  }
} catch (error) {
  console.log(`assimp: ${error.message}`);
}
process.exitCode = failed ? 1 : 0;
