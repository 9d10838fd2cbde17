// Show .egs scenes in three.js apps, drawn by Spark.
import { SplatFileType, SplatMesh } from '@sparkjsdev/spark';

import { decode } from '../src/index.js';
import { toPly } from '../src/ply.js';

/**
 * A scene as an object of three.js: `scene.add(await loadEgs('scene.egs'))`.
 *
 * @param {*} source as in `decode`
 * @param {object} [options] of `decode`; `mesh`: options of Spark's `SplatMesh`
 * @returns {Promise<SplatMesh>}
 */
export async function loadEgs(source, { mesh: settings, ...options } = {}) {
  const fileBytes = toPly(await decode(source, options));
  // Spark's more precise numbers: its packed ones lose more than files of profile m.
  const file = { fileBytes, fileType: SplatFileType.PLY, extSplats: true };
  const mesh = new SplatMesh({ ...file, ...settings });
  await mesh.initialized;
  return mesh;
}
