// Section "Motion" of FORMAT.md: a block of a key frame, and what frames change.
import { runBegin } from './basis.js';
import { BinaryCoder } from './binary.js';
import { toColours, turnedColours } from './block.js';
import { check } from './errors.js';
import { ONE, POWERS, fixedPoint, turnShifts } from './lattice.js';
import { bitLength, inRange } from './numbers.js';
import { axesOf, widthsOf } from './tree.js';

/** Parts that change: opacity and log-scales, rotation, centre, SH-DC, SH-AC. */
const [SHAPE, TURN, PLACE, DC, AC] = [0, 1, 2, 3, 4];

/** Number of values of each part but SH-AC, and first context of each. */
const VALUES = [4, 3, 3, 3];
const FIRST = [44, 3119, 5426, 7733, 10040];

/** Contexts of an integer. */
const INTEGER = 128;

/** Gaussians that share a flag. */
const RUN = 16;

/** Places, and levels of SH-AC, are below this magnitude. */
const LIMIT = 2 ** 30;

const inPlace = (value) => {
  check(Math.abs(value) < LIMIT, 'motion', 'a place or level out of range');
  return value;
};

/** The next integer under contexts from `base` on. */
function integer(coder, base) {
  let size = 0;
  while (size < 31 && coder.bit(base + size)) size++;
  if (size === 0) return 0;
  const isNegative = coder.bit(base + 32);
  let found = 1;
  for (let j = 0; j < size - 1; j++) {
    found = 2 * found + coder.bit(base + 32 * (1 + Math.min(j, 2)) + size);
  }
  return isNegative ? -found : found;
}

export class MovingBlock {
  /**
   * @param {LatticeBlock} found a decoded block, with what it has kept
   * @param {Float32Array} planes the floats of its first part
   */
  constructor({ lattice, count, colourShifts, kept }, planes) {
    // Of the current frame: `shape`, `classes`, `places`, `colours`, `levels`, `shifts`, `rotation`.
    Object.assign(this, kept, { lattice, count, shifts: colourShifts });
    this.rotation = Float64Array.from(planes.subarray(10 * count));
    this.flags = new Uint8Array(5 * count);
    this.moves = VALUES.map((size) => new Float64Array(size * count)); // the last changes
    this.members = VALUES.map(() => new Int32Array(0)); // that have these
    this.widths = widthsOf(axesOf(lattice.bits));
    this.coefficients = this.levels[0].length;
    this.contexts = FIRST[AC] + 6 * this.coefficients * INTEGER;
  }

  /**
   * Decode the next frame.
   *
   * @param {Uint8Array} data
   * @returns {(Int32Array | Float32Array)[]} for each part, its members and planes of their values
   */
  next(data) {
    const coder = (this.coder = new BinaryCoder(data, this.contexts + 1, 'motion', this.coder));
    this.#readFlags(coder);
    const listed = [0, 1, 2, 3, 4].map((part) => this.#flagged(part));
    const far = new Map();
    for (const part of [SHAPE, TURN, PLACE, DC]) {
      let members = listed[part];
      if (part === PLACE) {
        for (const i of members) if (i >= this.near) far.set(i, this.#readCentre(coder));
        members = members.filter((i) => i < this.near);
      }
      if (members.length) this.#change(coder, part, members);
      for (const i of this.members[part]) {
        const at = VALUES[part] * i;
        if (!this.flags[5 * i + part]) this.moves[part].fill(0, at, at + VALUES[part]);
      }
      this.members[part] = members;
    }
    if (this.coefficients === 0) listed[AC] = new Int32Array(0);
    this.#readLevels(coder, listed[AC]);
    coder.finish();
    // Copies: their memory moves out of the worker.
    return listed.flatMap((members, part) => [members.slice(), this.#floats(part, members, far)]);
  }

  #readFlags(coder) {
    const { flags } = this;
    const last = new Uint8Array(5);
    let ran = 0;
    for (let begin = 0; begin < flags.length; begin += 5 * RUN) {
      const end = Math.min(begin + 5 * RUN, flags.length);
      let was = 0;
      for (let at = begin; at < end; at++) was |= flags[at];
      ran = coder.bit(2 * was + ran);
      if (!ran) flags.fill(0, begin, end);
      for (let at = begin; ran && at < end; at += 5) {
        let earlier = 0;
        for (let part = 0; part < 5; part++) {
          const context = 4 + 8 * part + 4 * flags[at + part] + 2 * last[part] + earlier;
          flags[at + part] = last[part] = coder.bit(context);
          earlier |= last[part];
        }
      }
    }
  }

  /** Gaussians with the flag of a part. */
  #flagged(part) {
    const found = new Int32Array(this.count);
    let size = 0;
    for (let i = 0; i < this.count; i++) if (this.flags[5 * i + part]) found[size++] = i;
    return found.slice(0, size);
  }

  /** Centre of a far Gaussian. */
  #readCentre(coder) {
    const words = Uint32Array.from([0, 1, 2], () => coder.even(32, this.contexts));
    const centre = new Float32Array(words.buffer);
    check(centre.every(Number.isFinite), 'motion', 'a centre is not finite');
    return centre;
  }

  /** Decode and apply the changes of a part. */
  #change(coder, part, members) {
    const size = VALUES[part];
    const moves = this.moves[part];
    const values = [this.shape, null, this.places, this.colours][part];
    const most = part === PLACE ? 2 * LIMIT : 3200 * ONE;
    const high = coder.bit(FIRST[part]);
    const mode = 2 * high + coder.bit(FIRST[part] + 1 + high);
    const steps = new Float64Array(size);
    const [other, otherBefore, activity] = [0, 1, 2].map(() => new Float64Array(size));
    for (const i of members) {
      this.#steps(part, i, steps);
      for (let v = 0; v < size; v++) {
        const step = steps[v];
        const own = moves[size * i + v];
        let guess = 0;
        if (mode & 1) guess += own;
        if (mode & 2) guess += mode & 1 ? other[v] - otherBefore[v] : other[v];
        const base = FIRST[part] + 3 + INTEGER * (6 * v + activity[v]);
        const rest = integer(coder, base);
        activity[v] = Math.min(bitLength(Math.abs(rest)), 5);
        const change = (rest + Math.floor((2 * guess + step) / (2 * step))) * step;
        check(Math.abs(change) < most, 'motion', 'a change out of range');
        moves[size * i + v] = other[v] = change;
        otherBefore[v] = own;
        if (part === PLACE) values[v][i] = inPlace(values[v][i] + change);
        else if (part !== TURN) values[v][i] = fixedPoint(values[v][i] + change);
      }
      if (part === TURN) turnBy(this.rotation, i, this.count, other);
    }
  }

  /** Step sizes of a part of a Gaussian. */
  #steps(part, i, steps) {
    const { lattice, shape } = this;
    const { units } = lattice;
    const number = this.classes[0][i];
    const [o, s0, s1, s2] = [shape[0][i], shape[1][i], shape[2][i], shape[3][i]];
    if (part === SHAPE) {
      steps[0] = units.opacity * POWERS[lattice.opacity.shift(number, 0, 0, 0, 0)];
      for (let k = 0; k < 3; k++) {
        steps[1 + k] = units.scaling * POWERS[lattice.scales[k].shift(number, o, s0, s1, s2)];
      }
    } else if (part === TURN) {
      turnShifts(lattice, number, o, s0, s1, s2, steps);
      for (let k = 0; k < 3; k++) steps[k] = units.rotation * POWERS[steps[k]];
    } else if (part === PLACE) {
      const shift = lattice.positions.shift(number, o, s0, s1, s2);
      const dropped = Math.min(shift, this.missing[i]);
      for (let k = 0; k < 3; k++) steps[k] = POWERS[this.widths[k][dropped] + 1];
    } else {
      steps.fill(units.dc * POWERS[this.#colourShift(i)]);
    }
  }

  #colourShift(i) {
    const { lattice, shape, classes } = this;
    return lattice.colour.shift(classes[1][i], shape[0][i], shape[1][i], shape[2][i], shape[3][i]);
  }

  /** Decode and apply the changes of levels of SH-AC. */
  #readLevels(coder, members) {
    for (const i of members) {
      const shift = this.#colourShift(i);
      const factor = 2 ** (this.shifts[i] - shift);
      let context = FIRST[AC];
      let some = 0;
      for (const planes of this.levels) {
        for (const plane of planes) {
          let level = plane[i] * factor;
          if (factor < 1) level = Math.floor(level + 0.5);
          else if (Math.abs(level) >= LIMIT) level = 0;
          const change = integer(coder, context + some * INTEGER);
          some = change === 0 ? 0 : 1;
          context += 2 * INTEGER;
          plane[i] = inPlace(level + change);
        }
      }
      this.shifts[i] = shift;
    }
  }

  /** Floats of a part of its members, plane by plane. */
  #floats(part, members, far) {
    const size = members.length;
    if (part === AC) return this.#harmonics(members);
    const found = new Float32Array([4, 4, 3, 3][part] * size);
    const { lattice, count, rotation, places, shape, colours } = this;
    if (part === DC) {
      const own = colours.map((plane) => Int32Array.from(members, (i) => plane[i]));
      toColours(own, new Float64Array(size).fill(1), found, size);
      return found;
    }
    const half = lattice.step / 2;
    const value = [
      (v, i) => shape[v][i] / ONE,
      (v, i) => rotation[v * count + i],
      (v, i) => far.get(i)?.[v] ?? inRange(lattice.origin[v] + places[v][i] * half),
    ][part];
    for (let at = 0; at < found.length; at++) {
      found[at] = value(Math.floor(at / size), members[at % size]);
    }
    return found;
  }

  /** SH-AC of members: planes of R of the coefficients, then of G, then of B. */
  #harmonics(members) {
    const { coefficients, bases, count, shifts, levels } = this;
    const { bands } = this.lattice.units;
    const size = members.length;
    const own = levels.map((planes) =>
      planes.map((plane) => Int32Array.from(members, (i) => plane[i])),
    );
    const powers = Float64Array.from(members, (i) => POWERS[shifts[i]]);
    const steps = bands.map((unit) => powers.map((power) => unit * power));
    if (bases) {
      const begins = (run) => {
        const begin = members.findIndex((i) => i >= runBegin(run, bases.length, count));
        return begin < 0 ? size : begin;
      };
      return turnedColours(own, coefficients, steps[0], bases, begins);
    }
    const found = new Float32Array(3 * coefficients * size);
    for (let k = 0; k < coefficients; k++) {
      const planes = own.map((one) => one[k]);
      const band = Math.floor(Math.sqrt(k + 1)) - 1;
      toColours(planes, steps[band], found.subarray(k * size), coefficients * size);
    }
    return found;
  }
}

/** Turn quaternion `i` of planes of `count` about its own axes, by fixed-point sines of half angles. */
function turnBy(rotation, i, count, turns) {
  let x = turns[0] / ONE;
  let y = turns[1] / ONE;
  let z = turns[2] / ONE;
  const square = x * x + y * y + z * z;
  const norm = Math.sqrt(Math.max(square, 1));
  const w = Math.sqrt(Math.max(1 - square, 0));
  x /= norm;
  y /= norm;
  z /= norm;
  const [a, b, c, d] = [0, 1, 2, 3].map((k) => rotation[k * count + i]);
  const found = [
    a * w - b * x - c * y - d * z,
    a * x + b * w + c * z - d * y,
    a * y - b * z + c * w + d * x,
    a * z + b * y - c * x + d * w,
  ];
  const length = Math.sqrt(found.reduce((sum, value) => sum + value * value, 0));
  found.forEach((value, k) => (rotation[k * count + i] = value / (found[0] < 0 ? -length : length)));
}
