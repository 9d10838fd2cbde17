// Sections "Frequency tables", "Sent tables" and "rANS" of FORMAT.md.
import { BinaryCoder } from './binary.js';
import { check } from './errors.js';

export const LANES = 32;
const LEAST_STATE = 65536;

/** Frequencies, with sum 2^precision, of symbols with these weights. */
export function frequencies(weights, precision, where) {
  const size = 2 ** precision;
  let total = 0;
  let positive = 0;
  for (const weight of weights) {
    total += weight;
    positive += weight > 0;
  }
  check(positive > 0 && positive <= size, where, 'a table without symbols, or of too many');
  const result = new Uint32Array(weights.length);
  const rests = [];
  let difference = size;
  for (let q = 0; q < weights.length; q++) {
    const share = Math.floor((weights[q] * size) / total);
    if (share > 0) rests.push({ q, rest: weights[q] * size - share * total });
    result[q] = weights[q] > 0 ? Math.max(share, 1) : 0;
    difference -= result[q];
  }
  rests.sort((a, b) => b.rest - a.rest || a.q - b.q);
  for (let k = 0; k < difference; k++) result[rests[k].q] += 1;
  lowerLargest(result, -difference);
  return result;
}

/** Subtract 1 from the largest of these numbers (ties: the first), `times` times. */
function lowerLargest(numbers, times) {
  if (times <= 0) return;
  const above = (level) => numbers.reduce((sum, n) => sum + Math.max(n - level, 0), 0);
  // The lowest level to which lowering all larger numbers suffices.
  let level = 0;
  for (let most = Math.max(...numbers); level < most;) {
    const middle = (level + most) >> 1;
    if (above(middle) <= times) most = middle;
    else level = middle + 1;
  }
  let left = times - above(level);
  for (let q = 0; q < numbers.length; q++) {
    if (numbers[q] >= level) numbers[q] = left-- > 0 ? level - 1 : level;
  }
}

/** Weights of tables with these `{size, mantissa}`. */
export function sentTables(data, shapes) {
  const where = 'sent tables';
  if (shapes.length === 0) {
    check(data.length === 0, where, 'bytes after the end');
    return [];
  }
  const coder = new BinaryCoder(data, 94, where);
  const tables = shapes.map((shape) => sentTable(coder, shape));
  coder.finish();
  return tables;
}

function sentTable(coder, { size, mantissa }) {
  const large = size > 32 ? 1 : 0;
  const weights = new Float64Array(size);
  let length = 0;
  let changed = 1;
  for (let q = 0; q < size; q++) {
    const kind = 3 * large + (length === 0 ? 2 : changed);
    changed = 0;
    if (!coder.bit(kind)) {
      changed = 1;
      const shorter = coder.bit(6 + kind);
      let difference = 1;
      while (difference < 33 && coder.bit(12 + 33 * large + difference - 1)) difference++;
      length += shorter ? -difference : difference;
      check(length >= 0 && length <= 32, coder.where, 'length of a weight outside 0-32');
    }
    if (length === 0) continue;
    let weight = 1;
    for (let j = 0; j < length - 1; j++) {
      weight = 2 * weight + (j < mantissa ? coder.bit(78 + j) : 0);
    }
    weights[q] = weight;
  }
  return weights;
}

/** Initial states of `count` lanes. */
export function firstStates(reader, count) {
  const states = new Uint32Array(count);
  for (let lane = 0; lane < count; lane++) {
    states[lane] = reader.u32();
    check(states[lane] >= LEAST_STATE, reader.where, 'a state below 2^16');
  }
  reader.finish();
  return states;
}

export function checkLastStates(states) {
  check(
    states.every((state) => state === LEAST_STATE),
    'states',
    'wrong after the last symbol',
  );
}

/** The words of a section, which lanes read one after another. */
export class Words {
  constructor(bytes, where) {
    this.words = wordsOf(bytes, where);
    this.where = where;
    this.at = 0;
  }

  /** The state after a symbol of `share` slots, at offset `place` in these. */
  next(state, precision, share, place) {
    const next = (Math.imul(share, state >>> precision) + place) >>> 0;
    // Words past the end read as 0; `finish` detects reading too many.
    return next < LEAST_STATE ? ((next << 16) | this.words[this.at++]) >>> 0 : next;
  }

  finish() {
    check(this.at === this.words.length, this.where, 'words after or past the end');
  }
}

/** Words of a section as u16, at any alignment. */
function wordsOf(bytes, where) {
  check(bytes.length % 2 === 0, where, 'half a word');
  if (bytes.byteOffset % 2 === 0) {
    return new Uint16Array(bytes.buffer, bytes.byteOffset, bytes.length / 2);
  }
  return new Uint16Array(bytes.slice().buffer);
}
