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
  try {
    return await loader.parseAsync(await file.arrayBuffer(), '');
  } catch (cause) {
    const compressed = /draco|meshopt|ktx2/i.exec(String(cause))?.[0];
    const text = compressed
      ? `Files that are compressed with ${compressed} cannot be read.`
      : 'The file is damaged, or no VRM, GLB or VRM animation.';
    throw new Error(text, { cause });
  }
}
