import { LoadingManager } from 'three';
import {
  type GLTF,
  GLTFLoader,
  type GLTFLoaderPlugin,
  type GLTFParser,
} from 'three/addons/loaders/GLTFLoader.js';

/** Reads a binary glTF with a plugin for what it carries beside the scene. */
export async function readGltf(
  file: Blob,
  plugin: (parser: GLTFParser) => GLTFLoaderPlugin,
): Promise<GLTF> {
  const manager = new LoadingManager();
  // Nothing is fetched from elsewhere, whatever the file names.
  manager.setURLModifier((url) => (/^(blob|data):/.test(url) ? url : 'data:,'));
  const loader = new GLTFLoader(manager);
  loader.register(plugin);
  return loader.parseAsync(await file.arrayBuffer(), '');
}
