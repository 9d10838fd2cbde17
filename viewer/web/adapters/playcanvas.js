// Load .egs scenes in PlayCanvas apps, like its own formats.
import { GSplatData, GSplatResource } from 'playcanvas';

import { decode } from '../src/index.js';

class EgsParser {
  constructor(app, options) {
    this.app = app;
    this.options = options;
  }

  canParse({ ext }) {
    return ext === 'egs';
  }

  load({ load: url }, callback, asset) {
    const source = asset?.file?.contents ?? url;
    const onProgress = (bytes, of) => asset?.fire('progress', bytes, of);
    decode(source, { onProgress, ...this.options }).then(
      (scene) => callback(null, resourceOf(this.app.graphicsDevice, scene)),
      (error) => callback(error, null),
    );
  }

  open(url, data) {
    return data;
  }
}

/**
 * Let assets of type `gsplat` be `.egs` files: `new Asset('scene', 'gsplat', { url: 'scene.egs' })`.
 *
 * @param {AppBase} app
 * @param {object} [options] of `decode`
 */
export function useEgs(app, options = {}) {
  app.loader.getHandler('gsplat').addParser(new EgsParser(app, options));
}

/** A decoded scene for the component `gsplat`: `entity.gsplat.resource = resourceOf(...)`. */
export function resourceOf(device, scene) {
  const properties = scene.properties.map((name) => ({
    type: 'float',
    name,
    storage: scene.property(name),
    byteSize: 4,
  }));
  const element = { name: 'vertex', count: scene.count, properties };
  return new GSplatResource(device, new GSplatData([element]));
}
