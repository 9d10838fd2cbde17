// Section "Geometry" of FORMAT.md: the tree of Morton codes.
import { BinaryCoder } from './binary.js';

/** Axis of each bit of a Morton code, most significant bit first. */
export function axesOf(depths) {
  const axes = [];
  for (let level = 20; level >= 0; level--) {
    for (let axis = 0; axis < 3; axis++) if (depths[axis] > level) axes.push(axis);
  }
  return axes;
}

/** How many of the lowest 0, 1, ... bits of a code belong to each axis. */
export const widthsOf = (axes) =>
  [0, 1, 2].map((axis) => {
    const counts = new Uint8Array(axes.length + 1);
    for (let k = 1; k <= axes.length; k++) {
      counts[k] = counts[k - 1] + (axes[axes.length - k] === axis ? 1 : 0);
    }
    return counts;
  });

/** Add raw bits `begin` to `end` of a Morton code to the cells of a point. */
export function addBits(cells, axes, begin, end, raw) {
  for (let k = begin; k < end; k++) cells[axes[k]] = (cells[axes[k]] << 1) | raw.take(1);
}

/**
 * Walk the tree of `count` codes, ascending.
 *
 * @param {Uint8Array} data
 * @param {number} count
 * @param {number[]} axes from `axesOf`
 * @param {(x: number, y: number, z: number, missing: number, count: number) => void} leaf called
 *   with the cells of a node without children, which lack its lowest `missing` bits
 */
export function walkTree(data, count, axes, leaf) {
  const coder = new BinaryCoder(data, 864, 'geometry');
  const bits = axes.length;
  // Pending nodes, at most one for each bit: count, bits left, cells, and whether the parent's
  // points were all on one side.
  const stack = new Int32Array(6 * (bits + 2));
  let top = 0;
  const push = (n, left, x, y, z, lopsided) => {
    stack[top] = n;
    stack[top + 1] = left;
    stack[top + 2] = x;
    stack[top + 3] = y;
    stack[top + 4] = z;
    stack[top + 5] = lopsided;
    top += 6;
  };
  if (count > 0) push(count, bits, 0, 0, 0, 0);
  while (top > 0) {
    top -= 6;
    const n = stack[top];
    const left = stack[top + 1];
    const x = stack[top + 2];
    const y = stack[top + 3];
    const z = stack[top + 4];
    if (n === 1 || left === 0) {
      leaf(x, y, z, left, n);
      continue;
    }
    const zeros = split(coder, n, stack[top + 5]);
    const lopsided = zeros === 0 || zeros === n ? 1 : 0;
    const axis = axes[bits - left];
    const [dx, dy, dz] = [axis === 0, axis === 1, axis === 2];
    const [u, v, w] = [x << dx, y << dy, z << dz];
    if (zeros < n) push(n - zeros, left - 1, u | dx, v | dy, w | dz, lopsided);
    if (zeros > 0) push(zeros, left - 1, u, v, w, lopsided);
  }
  coder.finish();
}

/** How many of the n points of a node have 0 as the next bit. */
function split(coder, n, lopsided) {
  const size = n < 10 ? n - 2 : 8 + Math.max(28 - Math.clz32(n), 0);
  if (coder.bit(4 * size + 2 * lopsided)) return 0;
  if (coder.bit(4 * size + 2 * lopsided + 1)) return n;
  let least = 1;
  let most = n - 1;
  let path = 1;
  while (least < most) {
    const middle = (least + most) >> 1;
    if (coder.bit(96 + 32 * size + Math.min(path, 31))) {
      least = middle + 1;
      path = 2 * path + 1;
    } else {
      most = middle;
      path = 2 * path;
    }
  }
  return least;
}
