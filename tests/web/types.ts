// What pages in TypeScript may write, and what they may not; test_web_types.py has it checked.
import { CorruptError, decode, EgsError, open, openSequence } from '../../viewer/web/src/index.js';
import type { DecodeOptions, EgsFile, Scene, Sequence, View } from '../../viewer/web/src/index.js';
import { createViewer } from '../../viewer/web/embed.js';
import type { ViewerState } from '../../viewer/web/embed.js';
import { toPly } from '../../viewer/web/src/ply.js';

const options: DecodeOptions = {
  shDegree: 1,
  box: [
    [0, 0, 0],
    [1, 1, 1],
  ],
  onBlock: (scene, { first, count }) => scene.positions.subarray(first, first + count),
  onDamage: (block, error) => `${block.toFixed()}: ${error.where}`,
  createWorker: () => new Worker('worker.js'),
};
const scene: Scene = await decode('scene.egs', options);
const opacity: Float32Array = scene.property('opacity');
const ply: Uint8Array = toPly(scene);

const view: View = {
  width: 900,
  height: 600,
  fx: 700,
  fy: 700,
  cx: 450,
  cy: 300,
  rotation: [
    [1, 0, 0],
    [0, 1, 0],
    [0, 0, 1],
  ],
  position: [0, 0, -5],
};
const file: EgsFile = await open(new Uint8Array(9), { workers: 0 });
const chosen = file.select(view, { budget: 2e6, tolerance: 1 });
const parts = await Promise.all(chosen.map((blocks, level) => file.decode(level, blocks)));
const errors: Float64Array | undefined = file.levels[parts.length - 1].errors;
file.close();

const viewer = createViewer(document.body, {
  page: new URL('https://example.org/site/'),
  state: { view: 3, show: 'wipe', wipe: 0.4, lang: 'de' },
  onChange: ({ camera: [x, y, z] }) => `${x + y + z}`,
  onMessage: (text, isError) => (isError ? text.length : 0),
});
const { views } = await viewer.ready;
const shown: ViewerState = await viewer.set({ view: views.length - 1, turn: true });
const picture: Blob = await viewer.picture();
viewer.close();

const sequence: Sequence = await openSequence('clip.egs', { maxBytes: 1e9 });
const group = await sequence.group(sequence.groupOf(7));
group.scene.move(await group.next());
export const frame: Scene = await sequence.frame(0);

export function whereOf(error: unknown): string {
  return error instanceof CorruptError || error instanceof EgsError ? error.where : '';
}

// @ts-expect-error a number is no source
decode(7);
// @ts-expect-error there is no such degree
decode('scene.egs', { shDegree: 4 });
// @ts-expect-error arrays are not to be replaced
scene.positions = new Float32Array(3);
// @ts-expect-error there may be none
errors.length;
// @ts-expect-error there is no such background
viewer.set({ background: 'red' });
export { opacity, picture, ply, shown };
