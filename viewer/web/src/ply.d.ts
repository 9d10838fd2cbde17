import type { Scene } from './index.js';

export function toPly(scene: Scene): Uint8Array;
