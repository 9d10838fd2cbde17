// Section "Selection" of FORMAT.md: select the blocks of each level that a camera needs.
import { FANOUT } from './container.js';

/** The eight corners of a box: for each axis, 0 for the lowest and 1 for the highest value. */
const CORNERS = Array.from({ length: 8 }, (_, k) => [k & 1, (k >> 1) & 1, (k >> 2) & 1]);

/** Distance from a position to a box; 0 inside. */
function distanceTo([low, high], place) {
  const [a, b, c] = place.map((p, axis) => Math.max(Math.max(low[axis] - p, p - high[axis]), 0));
  return Math.sqrt(a * a + b * b + c * c);
}

/** Whether a box has corners on the inner side of every edge of a view. */
function isInView(box, { width, height, fx, fy, cx, cy, rotation, position }) {
  const [right, down, forward] = rotation;
  let inside = 0;
  for (const [i, j, k] of CORNERS) {
    const [x, y, z] = [box[i][0] - position[0], box[j][1] - position[1], box[k][2] - position[2]];
    const along = (row) => row[0] * x + row[1] * y + row[2] * z;
    const [across, below, ahead] = [along(right), along(down), along(forward)];
    if (ahead > 0) inside |= 1;
    if (fx * across + cx * ahead >= 0) inside |= 2;
    if (fx * across + (cx - width) * ahead <= 0) inside |= 4;
    if (fy * below + cy * ahead >= 0) inside |= 8;
    if (fy * below + (cy - height) * ahead <= 0) inside |= 16;
    if (inside === 31) return true;
  }
  return false;
}

/**
 * Evaluate all levels for a view.
 *
 * @param {{header: Header, boxes: object[], errors?: Float64Array}[]} levels the scene, then
 *   coarser levels
 * @returns {{count(block: number): number, inView: boolean[], distances: number[], errors:
 *   number[]}[]} for each level; errors in pixels
 */
export function look(levels, view) {
  const focal = Math.max(view.fx, view.fy);
  return levels.map(({ header, boxes, errors }) => {
    const distances = boxes.map(({ reach }) => distanceTo(reach, view.position));
    const pixels = (error, block) => {
      if (error === 0) return 0;
      return distances[block] > 0 ? (error * focal) / distances[block] : Infinity;
    };
    return {
      count: (block) => header.blockCount(block),
      inView: boxes.map(({ reach }) => isInView(reach, view)),
      distances,
      errors: boxes.map((_, block) => pixels(errors?.[block] ?? 0, block)),
    };
  });
}

/** Whether a block is refined before another: larger error, then coarser, then lower number. */
const isBefore = (a, b) =>
  a.error !== b.error
    ? a.error > b.error
    : a.level !== b.level
      ? a.level > b.level
      : a.block < b.block;

/** A heap; its first item comes before all others. */
class Heap {
  items = [];

  push(item) {
    const { items } = this;
    let at = items.length;
    for (let above; at > 0 && isBefore(item, items[(above = (at - 1) >> 1)]); at = above) {
      items[at] = items[above];
    }
    items[at] = item;
  }

  /** Remove and return the first item. */
  pop() {
    const { items } = this;
    const item = items.pop();
    const size = items.length;
    if (size === 0) return;
    let at = 0;
    for (let next; (next = 2 * at + 1) < size; at = next) {
      if (next + 1 < size && isBefore(items[next + 1], items[next])) next++;
      if (isBefore(item, items[next])) break;
      items[at] = items[next];
    }
    items[at] = item;
  }
}

/** The finer blocks that a block replaces. */
export function childrenOf(level, block, blocks) {
  const first = FANOUT * block;
  const count = Math.max(0, Math.min(FANOUT, blocks - first));
  return Array.from({ length: count }, (_, k) => ({ level: level - 1, block: first + k }));
}

/**
 * Refine blocks of the coarsest level, largest error first.
 *
 * @param {object[]} seen result of `look`
 * @param {number[]} first blocks of the coarsest level
 * @param {number} tolerance pixels
 * @param {(parent: object, children: object[]) => boolean} fits whether children may replace their
 *   parent; if not, refinement stops
 * @returns {{chosen: object[], refined: {parent: object, children: object[]}[]}} `{level, block}`
 *   to draw, and the refinements, in order
 */
export function refine(seen, first, tolerance, fits) {
  const heap = new Heap();
  const add = ({ level, block }) => heap.push({ level, block, error: seen[level].errors[block] });
  for (const block of first) add({ level: seen.length - 1, block });
  const refined = [];
  while (heap.items.length > 0 && heap.items[0].error > tolerance) {
    const parent = heap.items[0];
    const finer = seen[parent.level - 1];
    const own = childrenOf(parent.level, parent.block, finer.inView.length);
    const children = own.filter(({ block }) => finer.inView[block]);
    if (!fits(parent, children)) break;
    heap.pop();
    children.forEach(add);
    refined.push({ parent, children });
  }
  return { chosen: heap.items, refined };
}

/** Numbers of the blocks in view. */
export const inView = ({ inView: found }) => [...found.keys()].filter((block) => found[block]);

/** Numbers of the blocks of each level to draw, ascending. */
export function selectBlocks(levels, view, budget, tolerance) {
  const seen = look(levels, view);
  const chosen = levels.map(() => []);
  const top = levels.length - 1;
  const first = inView(seen[top]);
  const count = ({ level, block }) => seen[level].count(block);
  const sum = (blocks) => blocks.reduce((total, block) => total + count(block), 0);
  let total = sum(first.map((block) => ({ level: top, block })));
  if (total > budget) {
    chosen[top] = nearest(seen[top], first, budget);
    return chosen;
  }
  const fits = (parent, children) => {
    const more = sum(children) - count(parent);
    if (total + more > budget) return false;
    total += more;
    return true;
  };
  for (const { level, block } of refine(seen, first, tolerance, fits).chosen) {
    chosen[level].push(block);
  }
  for (const blocks of chosen) blocks.sort((a, b) => a - b);
  return chosen;
}

/** The nearest blocks that fit into the budget, ascending. */
function nearest({ count, distances }, blocks, budget) {
  const sorted = [...blocks].sort((a, b) => distances[a] - distances[b] || a - b);
  const kept = [];
  for (const block of sorted) {
    budget -= count(block);
    if (budget < 0) break;
    kept.push(block);
  }
  return kept.sort((a, b) => a - b);
}
