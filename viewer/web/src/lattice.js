// Section "Lattices" of FORMAT.md: what all blocks share, and the rules.
import { BinaryCoder } from './binary.js';
import { Reader } from './bytes.js';
import { check } from './errors.js';
import { bitLength } from './numbers.js';
import { frequencies, sentTables } from './tables.js';
import { counted } from './wording.js';

/** 1 in fixed point. */
export const ONE = 2 ** 20;

/** Values are below this magnitude. */
const MOST = 1600 * ONE;

export const PRECISION = 12;
export const SLOTS = 2 ** PRECISION;

/** Entries per table in the arrays of all tables, which thus fit into a processor's cache. */
const SYMBOLS = 256;

/** Base-2 logarithm of the number of slots per entry, which gives the token of the first of them. */
export const COARSE_BITS = 4;

/** Number of contexts of the lists of the shape pass and the f_dc pass. */
const LISTS = [31, 16, 256, 256, 256, 256, 32, 32, 32, 288];

/** Powers of 2, which are slow to compute. */
export const POWERS = Float64Array.from({ length: 32 }, (_, k) => 2 ** k);

/** Check that a value is below 1600 in magnitude. */
export function fixedPoint(value) {
  check(Math.abs(value) < MOST, 'section', 'a value of 1600 or more');
  return value;
}

class Rule {
  constructor(reader, weight) {
    this.a = reader.i32();
    this.b = reader.i32();
    this.c = [reader.i32(), reader.i32(), reader.i32()];
    this.limit = reader.u8();
    this.weight = 65536 * weight;
    const small = [this.b, ...this.c].every((number) => Math.abs(number) < 2 ** 22);
    check(small, reader.where, 'a rule');
  }

  /** The shift of a Gaussian of a class, with opacity and scales in fixed point. */
  shift(number, opacity, s0, s1, s2, extra = 0) {
    const c = this.c;
    const total =
      this.a +
      this.weight * number +
      Math.floor((this.b * Math.min(opacity, 0)) / ONE) +
      Math.floor((c[0] * s0) / ONE) +
      Math.floor((c[1] * s1) / ONE) +
      Math.floor((c[2] * s2) / ONE);
    return Math.min(Math.max(Math.floor(total / 65536) + extra, 0), this.limit);
  }
}

/** Shifts of the turns, and the pole, of a Gaussian of a class; the shifts go to `found`. */
export function turnShifts({ turns }, number, o, s0, s1, s2, found) {
  for (let axis = 0; axis < 3; axis++) {
    const apart = Math.abs((axis === 0 ? s1 : s0) - (axis === 2 ? s1 : s2));
    const extra = Math.max(20 - bitLength(apart), 0);
    found[axis] = turns[axis].shift(number, o, s0, s1, s2, extra);
  }
  return found[2] > found[0] ? 2 : 0;
}

/** The section `lattice`. */
export class Lattice {
  constructor(content, degree) {
    const reader = new Reader(content, 'lattice');
    this.origin = [reader.f32(), reader.f32(), reader.f32()];
    this.step = reader.f32();
    const finite = [...this.origin, this.step].every(Number.isFinite);
    check(finite && this.step > 0, 'lattice', 'origin or step');
    this.bits = [...reader.take(3)];
    check(Math.max(...this.bits) <= 21, 'lattice', `bits ${this.bits}`);
    this.classes = [...reader.take(2)];
    check(
      this.classes.every((n) => n >= 1 && n <= 16),
      'lattice',
      `classes ${this.classes}`,
    );
    this.centres = [reader.i32(), reader.i32()];
    const near = this.centres.every((centre) => Math.abs(centre) <= 400 * ONE);
    check(near, 'lattice', 'a centre above 400');
    const [opacity, scaling, rotation, dc, ...bands] = Array.from({ length: 7 }, () =>
      reader.u32(),
    );
    this.units = { opacity, scaling, rotation, dc, bands };
    const rules = Array.from({ length: 9 }, (_, k) => new Rule(reader, k === 7 ? 3 : 1));
    this.opacity = rules[0];
    this.scales = rules.slice(1, 4);
    this.turns = rules.slice(4, 7);
    this.positions = rules[7];
    this.colour = rules[8];
    this.#checkUnits();
    this.#readTables(reader, degree);
  }

  /** Check the conditions for far Gaussians. */
  checkFar() {
    const [x, y, z] = this.bits;
    check(x + y + z <= 62, 'lattice', `bits ${this.bits} with far Gaussians`);
  }

  /** Check what holds if there are bases. */
  checkBasis() {
    const [unit, ...others] = this.units.bands;
    check(others.every((other) => other === unit), 'lattice', 'units of SH-AC in a local basis');
  }

  #checkUnits() {
    const { opacity, scaling, rotation, dc, bands } = this.units;
    const most = (rules) => Math.max(...rules.map((rule) => rule.limit));
    const pairs = [
      [opacity, this.opacity.limit],
      [scaling, most(this.scales)],
      [rotation, most(this.turns)],
      ...[dc, ...bands].map((unit) => [unit, this.colour.limit]),
    ];
    for (const [unit, limit] of pairs) {
      const fits = unit > 0 && bitLength(unit) + limit <= 31;
      check(fits, 'lattice', `unit ${unit} with limit ${limit}`);
    }
    check(this.positions.limit <= 93, 'lattice', 'limit of positions');
  }

  /**
   * Read the tables. `lists` has the start of each context's table in `starts` (first slot of each
   * token) and in `tokens` (token of every sixteenth slot).
   */
  #readTables(reader, degree) {
    const sizes = [...LISTS];
    if (degree > 0) sizes.push(256);
    for (let band = 0; band < degree; band++) {
      if (band + 1 < degree) sizes.push(16);
      sizes.push(384, 384, 384);
    }
    const marked = reader.u16();
    const count = reader.u16();
    const marks = new BinaryCoder(reader.take(marked), 2, 'lattice: marks');
    let total = 0;
    this.lists = sizes.map((size) => {
      const begins = new Uint32Array(size);
      const first = total;
      let mark = 0;
      begins[0] = total++ * SYMBOLS;
      for (let context = 1; context < size; context++) {
        mark = marks.bit(mark);
        total += mark;
        begins[context] = (total - 1) * SYMBOLS;
      }
      check(total - first <= 64, 'lattice', 'a list of more than 64 tables');
      return begins;
    });
    marks.finish();
    check(total === count, 'lattice', `${counted(count, 'table')}, expected ${total}`);
    const alphabets = [...reader.take(count)];
    check(
      alphabets.every((n) => n >= 1 && n <= 240),
      'lattice',
      'size of an alphabet',
    );
    const sent = sentTables(
      reader.rest(),
      alphabets.map((size) => ({ size, mantissa: 3 })),
    );
    this.starts = new Uint16Array(count * SYMBOLS).fill(SLOTS);
    this.tokens = new Uint8Array(count * SYMBOLS);
    sent.forEach((weights, table) => {
      const base = table * SYMBOLS;
      let end = 0;
      frequencies(weights, PRECISION, 'lattice').forEach((frequency, token) => {
        this.starts[base + token] = end;
        const first = base + Math.ceil(end / 2 ** COARSE_BITS);
        end += frequency;
        this.tokens.fill(token, first, base + Math.ceil(end / 2 ** COARSE_BITS));
      });
    });
  }
}
