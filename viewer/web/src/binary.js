// Section "Binary coder" of FORMAT.md.
import { check } from './errors.js';
import { counted } from './wording.js';

/** 131072 // (2 n + 3). */
const RATES = Int32Array.from({ length: 256 }, (_, n) => Math.floor(131072 / (2 * n + 3)));

/** Decodes decisions with adaptive contexts: those of another coder, or fresh ones. */
export class BinaryCoder {
  constructor(data, contexts, where, before = undefined) {
    this.data = data;
    this.where = where;
    this.chances = before?.chances ?? new Uint16Array(contexts).fill(32768);
    this.seen = before?.seen ?? new Uint8Array(contexts);
    this.low = 0;
    this.high = 0xffffffff;
    this.code = 0;
    this.shifted = 0;
    for (let k = 0; k < 4; k++) this.code = this.code * 256 + (k < data.length ? data[k] : 0);
  }

  /** The next decision, 0 or 1. */
  bit(context) {
    const chance = this.chances[context];
    const seen = this.seen[context];
    const rate = RATES[seen];
    const range = this.high - this.low;
    const middle = this.low + Math.floor((range * chance) / 65536);
    let decision = 0;
    if (this.code <= middle) {
      decision = 1;
      this.high = middle;
      this.chances[context] = chance + (Math.imul(65536 - chance, rate) >>> 16);
    } else {
      this.low = middle + 1;
      this.chances[context] = chance - (Math.imul(chance, rate) >>> 16);
    }
    if (seen < 255) this.seen[context] = seen + 1;
    while (((this.low ^ this.high) & 0xff000000) === 0) {
      const byte = this.shifted + 4 < this.data.length ? this.data[this.shifted + 4] : 0;
      this.low = (this.low << 8) >>> 0;
      this.high = ((this.high << 8) | 255) >>> 0;
      this.code = ((this.code << 8) | byte) >>> 0;
      this.shifted += 1;
    }
    return decision;
  }

  /** `bits` decisions of even chance as a number; the context is only for them. */
  even(bits, context) {
    let value = 0;
    for (let k = 0; k < bits; k++) {
      this.chances[context] = 32768;
      this.seen[context] = 0;
      value = 2 * value + this.bit(context);
    }
    return value;
  }

  /** Check that the data end after the last decision. */
  finish() {
    let size = 0;
    while (size < 4 && this.high - (this.high % 2 ** (32 - 8 * size)) < this.low) size++;
    const expected = this.shifted + size;
    const found = this.data.length;
    check(found === expected, this.where, `${counted(found, 'byte')} of binary coder, expected ${expected}`);
  }
}
