// Section "Lattices" of FORMAT.md: the passes of a block of profiles l, m, s.
import { MATRIX_ONE, readBases, runBegin } from './basis.js';
import { RawBits, Reader } from './bytes.js';
import { check } from './errors.js';
import { COARSE_BITS, ONE, POWERS, PRECISION, SLOTS, fixedPoint, turnShifts } from './lattice.js';
import { Neighbours } from './neighbours.js';
import { bitLength, clamp, inRange } from './numbers.js';
import { LANES, Words, checkLastStates, firstStates } from './tables.js';
import { addBits, axesOf, walkTree, widthsOf } from './tree.js';
import { counted } from './wording.js';

/** Gaussians whose components are turned at once. */
const AT_ONCE = 64;

const ROOTS = [1 / Math.sqrt(3), 1 / Math.sqrt(2), 1 / Math.sqrt(6)];

/** Words and raw bits of a section. */
class Stream {
  constructor(content, where) {
    const reader = new Reader(content, where);
    this.where = where;
    this.words = new Words(reader.take(reader.u32()), where);
    this.raw = new RawBits(reader.rest(), where);
  }

  finish() {
    this.words.finish();
    this.raw.finish();
  }
}

/** Decodes integers with lanes in rotation. */
class Pass {
  constructor({ starts, tokens }, states) {
    this.starts = starts;
    this.tokens = tokens;
    this.states = states;
    this.lane = 0;
  }

  /** The next integer, with the table at a position in the lattice's tables. */
  integer(table, stream) {
    const { starts, states, lane } = this;
    const state = states[lane];
    const slot = state & (SLOTS - 1);
    let token = this.tokens[table + (slot >> COARSE_BITS)];
    let end = starts[table + token + 1];
    while (slot >= end) end = starts[table + ++token + 1];
    const start = starts[table + token];
    states[lane] = stream.words.next(state, PRECISION, end - start, slot - start);
    this.lane = (lane + 1) & (LANES - 1);
    let magnitude = token >> 1;
    if (magnitude >= 16) {
      const bits = ((magnitude - 16) >> 2) + 2;
      magnitude = ((4 + ((magnitude - 16) & 3)) << bits) + stream.raw.take(bits);
    }
    return token & 1 ? 0 - magnitude : magnitude; // never -0
  }
}

/** The values of the last two Gaussians in each list of the shape pass. */
class Recent {
  constructor() {
    this.last = new Float64Array(5);
    this.before = new Float64Array(5);
  }

  sum(list) {
    return this.last[list] + this.before[list];
  }

  add(list, value) {
    this.before[list] = this.last[list];
    this.last[list] = value;
  }
}

/** -1, 0 or 1. */
const sign = (n) => (n >> 31) | (-n >>> 31);

/** bucket(n) of section "Passes". */
function bucket(n) {
  if (n < 2) return n;
  const k = 31 - Math.clz32(n);
  return Math.min(2 * k + ((n >> (k - 1)) & 1), 15);
}

/** x, y, z of the far Gaussians of a block; the section may be missing. */
function farCentres(content, count) {
  if (content === undefined) return new Float32Array(0);
  const size = content.length;
  const fits = size > 0 && size <= 12 * count && size % 12 === 0;
  check(fits, 'far', `${counted(size, 'byte')} for a block of ${counted(count, 'Gaussian')}`);
  const reader = new Reader(content, 'far');
  const centres = Float32Array.from({ length: size / 4 }, () => reader.f32());
  check(centres.every(Number.isFinite), 'far', 'a centre is not finite');
  return centres;
}

/** A block decoded in parts: `base`, then `band` for each band of SH-AC. */
export class LatticeBlock {
  /**
   * @param {Lattice} lattice
   * @param {number} count Gaussians of the block
   * @param {number} degree SH degree of the file
   * @param {boolean} moves whether to keep, in `kept`, what frames of a sequence change
   */
  constructor(lattice, count, degree, moves = false) {
    this.lattice = lattice;
    this.count = count;
    this.degree = degree;
    this.colourShifts = new Uint8Array(count);
    this.left = new Int32Array(0);
    const planes = (size) => Array.from({ length: size }, () => new Int32Array(count));
    this.kept = moves
      ? { shape: planes(4), classes: planes(2), missing: new Uint8Array(count), levels: [[], [], []] }
      : null;
  }

  /**
   * Everything but SH-AC.
   *
   * @param {object} sections `Uint8Array`s by name
   * @returns {Float32Array} 14 planes: x, y, z, f_dc, opacity, scales, rotation
   */
  base(sections) {
    const { count } = this;
    this.states = firstStates(new Reader(sections.states, 'states'), LANES);
    const planes = new Float32Array(14 * count);
    const positionShifts = this.#shapes(sections, planes.subarray(6 * count));
    const places = this.#places(sections, positionShifts, planes);
    const near = new Neighbours(places);
    this.nearest = near.nearest; // all that bands need of `near`
    this.#dc(sections['sh-dc'], near, planes.subarray(3 * count, 6 * count));
    if (this.degree === 0) checkLastStates(this.states);
    return planes;
  }

  /** Shape pass: opacity, scales and rotation into `planes`; returns the shifts of positions. */
  #shapes(sections, planes) {
    const { lattice, count } = this;
    const { units, centres, lists } = lattice;
    const pass = new Pass(lattice, this.states);
    const names = ['classes', 'opacity', 'scaling', 'rotation'];
    const [classes, opacities, scaling, rotation] = names.map((k) => new Stream(sections[k], k));
    const shifts = new Uint8Array(count);
    const recent = new Recent();
    const scales = new Float64Array(3);
    const turns = new Int32Array(3);
    const angles = new Float64Array(3);
    for (let i = 0; i < count; i++) {
      const shape = pass.integer(lists[0][recent.sum(0)], classes);
      check(shape >= 0 && shape < lattice.classes[0], 'classes', `class ${shape}`);
      recent.add(0, shape);
      const colour = pass.integer(lists[1][shape], classes);
      check(colour >= 0 && colour < lattice.classes[1], 'classes', `class ${colour}`);

      const shift = lattice.opacity.shift(shape, 0, 0, 0, 0);
      const near = clamp(Math.floor(recent.sum(1) / (2 * ONE)) + 4, 0, 7);
      const table = lists[2][8 * Math.min(shift, 31) + near];
      const level = pass.integer(table, opacities) * units.opacity * POWERS[shift];
      recent.add(1, level);
      const o = fixedPoint(centres[0] + level);

      scales[0] = scales[1] = scales[2] = 0;
      for (let k = 0; k < 3; k++) {
        const by = lattice.scales[k].shift(shape, o, scales[0], scales[1], scales[2]);
        const bucket = clamp(Math.floor(recent.sum(2 + k) / ONE) + (k === 0 ? 4 : 0), 0, 7);
        const found = pass.integer(lists[3 + k][8 * Math.min(by, 31) + bucket], scaling);
        const value = found * units.scaling * POWERS[by];
        recent.add(2 + k, value);
        scales[k] = fixedPoint(k === 0 ? centres[1] + value : scales[k - 1] - value);
      }
      const s0 = scales[0];
      const s1 = scales[1];
      const s2 = scales[2];

      const pole = turnShifts(lattice, shape, o, s0, s1, s2, turns);
      for (let k = 0; k < 3; k++) {
        const by = turns[k === 0 ? pole : k === 1 ? 1 : 2 - pole];
        const found = pass.integer(lists[6 + k][Math.min(by, 31)], rotation);
        angles[k] = fixedPoint(found * units.rotation * POWERS[by]) / ONE;
      }

      planes[i] = o / ONE;
      for (let k = 0; k < 3; k++) planes[(1 + k) * count + i] = scales[k] / ONE;
      quaternion(pole, angles[0], angles[1], angles[2], planes, 4 * count + i, count);
      shifts[i] = lattice.positions.shift(shape, o, s0, s1, s2);
      this.colourShifts[i] = lattice.colour.shift(colour, o, s0, s1, s2);
      if (this.kept) {
        [o, s0, s1, s2].forEach((value, k) => (this.kept.shape[k][i] = value));
        [shape, colour].forEach((value, k) => (this.kept.classes[k][i] = value));
      }
    }
    for (const stream of [classes, opacities, scaling, rotation]) stream.finish();
    return shifts;
  }

  /** Positions on the axes, also converted into `planes`. */
  #places(sections, shifts, planes) {
    const { lattice, count } = this;
    const axes = axesOf(lattice.bits);
    const raw = new RawBits(sections['low-bits'], 'low-bits');
    const places = [0, 1, 2].map(() => new Int32Array(count));
    const among = widthsOf(axes);
    const far = farCentres(sections.far, count);
    const near = count - far.length / 3;
    let i = 0;
    walkTree(sections.geometry, near, axes, (x, y, z, missing, points) => {
      const cells = [x, y, z];
      const dropped = points === 1 ? Math.min(shifts[i], missing) : 0;
      addBits(cells, axes, axes.length - missing, axes.length - dropped, raw);
      for (let axis = 0; axis < 3; axis++) {
        const width = among[axis][dropped];
        const place = (cells[axis] << (width + 1)) + (1 << width);
        for (let k = i; k < i + points; k++) places[axis][k] = place;
      }
      this.kept?.missing.fill(missing, i, i + points);
      i += points;
    });
    raw.finish();
    if (this.kept) Object.assign(this.kept, { places, near });
    const half = lattice.step / 2;
    for (let axis = 0; axis < 3; axis++) {
      const origin = lattice.origin[axis];
      const found = places[axis].fill(2 ** (lattice.bits[axis] + 1) - 1, near); // the last cell
      for (let k = 0; k < near; k++) planes[axis * count + k] = inRange(origin + found[k] * half);
      for (let k = near; k < count; k++) planes[axis * count + k] = far[3 * (k - near) + axis];
    }
    return places;
  }

  /** f_dc pass. */
  #dc(content, near, planes) {
    const { lattice, count, colourShifts } = this;
    const stream = new Stream(content, 'sh-dc');
    const pass = new Pass(lattice, this.states);
    const contexts = lattice.lists[9];
    const values = [0, 1, 2].map(() => new Int32Array(count));
    for (let i = 0; i < count; i++) {
      const shift = colourShifts[i];
      const step = lattice.units.dc * POWERS[shift];
      const total = Math.max(near.totals[i], 1);
      for (let channel = 0; channel < 3; channel++) {
        const plane = values[channel];
        const guess = near.predict(i, plane);
        const spread = (4 * near.spread(i, plane, guess)) / (total * step);
        const activity = spread >= 16 ? 5 : bitLength(spread);
        const context = 96 * channel + 6 * Math.min(shift, 15) + activity;
        plane[i] = fixedPoint(guess + pass.integer(contexts[context], stream) * step);
      }
    }
    stream.finish();
    if (this.kept) this.kept.colours = values;
    toColours(values, new Float64Array(count).fill(1), planes, count);
  }

  /**
   * The next band of SH-AC, from 0.
   *
   * @returns {Float32Array} 3 (2 band + 3) planes: R of its coefficients, then G, then B
   */
  band(band, content) {
    const levels = this.#levels(band, content);
    return this.#colours(levels, levels[0].length, band);
  }

  /**
   * SH-AC of a file with local bases, up to a degree.
   *
   * @returns {Float32Array} planes: R of the coefficients, then G, then B
   */
  bands(wanted, sections) {
    const levels = [[], [], []];
    for (let band = 0; band < this.degree; band++) {
      this.#levels(band, sections[`sh${band + 1}`]).forEach((own, k) => levels[k].push(...own));
    }
    const kept = (wanted + 1) ** 2 - 1;
    if (!sections.basis) return this.#colours(levels, kept, 0);
    const bases = readBases(sections.basis, levels[0].length, this.count);
    if (this.kept) this.kept.bases = bases;
    return turnedColours(levels, kept, this.#steps(0), bases, (run) =>
      runBegin(run, bases.length, this.count),
    );
  }

  /** Levels of the next band: planes of Y, of Co, of Cg. */
  #levels(band, content) {
    const { lattice, count, degree } = this;
    const where = `sh${band + 1}`;
    const stream = new Stream(content, where);
    const pass = new Pass(lattice, this.states);
    const hasMore = band + 1 < degree;
    // Lists: the sum of all bands; then for each band its own sum, unless it is the last, and
    // colours.
    let list = 10 + (band > 0 ? 1 + 4 * band : 0);
    if (band === 0) this.left = this.#sums(pass, lattice.lists[list++], stream);
    let sums = this.left;
    if (hasMore) {
      sums = this.#bandSums(pass, lattice.lists[list++], stream);
      for (let i = 0; i < count; i++) this.left[i] -= sums[i];
    }
    const size = 2 * band + 3;
    const levels = [[], [], []];
    // Gaussians with a remaining sum.
    const active = new Int32Array(count);
    let some = 0;
    for (let i = 0; i < count; i++) if (sums[i] > 0) active[some++] = i;
    for (let colour = 0; colour < 3; colour++) {
      const contexts = lattice.lists[list++];
      for (let j = 0; j < size; j++) {
        const plane = new Int32Array(count + 1); // 0 for neighbours that do not exist
        const isLast = colour === 2 && j === size - 1;
        some = this.#plane(pass, contexts, stream, plane, sums, active, some, j, isLast);
        levels[colour].push(plane);
      }
    }
    stream.finish();
    if (!hasMore) checkLastStates(this.states);
    levels.forEach((own, colour) => this.kept?.levels[colour].push(...own));
    return levels;
  }

  #sums(pass, contexts, stream) {
    const sums = new Int32Array(this.count);
    let [last, before] = [0, 0];
    for (let i = 0; i < this.count; i++) {
      const context = 16 * Math.min(this.colourShifts[i], 15) + bucket(last + before);
      const sum = pass.integer(contexts[context], stream);
      check(sum >= 0, stream.where, 'a sum below 0');
      sums[i] = sum;
      before = last;
      last = sum;
    }
    return sums;
  }

  #bandSums(pass, contexts, stream) {
    const { count, left } = this;
    const sums = new Int32Array(count);
    for (let i = 0; i < count; i++) {
      if (left[i] === 0) continue;
      const sum = pass.integer(contexts[bucket(left[i])], stream);
      check(sum >= 0 && sum <= left[i], stream.where, 'a sum below 0 or above what is left');
      sums[i] = sum;
    }
    return sums;
  }

  /**
   * Levels of one coefficient of one colour; returns the number of Gaussians with a remaining sum.
   */
  #plane(pass, contexts, stream, plane, left, active, some, j, isLast) {
    const { nearest } = this;
    let kept = 0;
    for (let k = 0; k < some; k++) {
      const i = active[k];
      const most = left[i];
      const trend = sign(plane[nearest[2 * i]]) + sign(plane[nearest[2 * i + 1]]);
      const context = 8 * (3 * bucket(most) + Math.abs(trend)) + j;
      let level = pass.integer(contexts[context], stream);
      if (isLast) {
        check(level === 1 || level === -1, stream.where, 'the last level is not a sign');
        level *= most;
      }
      const magnitude = Math.abs(level);
      check(magnitude <= most, stream.where, 'a level above what is left');
      plane[i] = trend < 0 ? -level : level;
      left[i] = most - magnitude;
      if (magnitude < most) active[kept++] = i;
    }
    return kept;
  }

  /** The first coefficients of levels, in steps of a band. */
  #colours(levels, size, band) {
    const { count } = this;
    const steps = this.#steps(band);
    const planes = new Float32Array(3 * size * count);
    for (let j = 0; j < size; j++) {
      const values = levels.map((own) => own[j]);
      toColours(values, steps, planes.subarray(j * count), size * count);
    }
    return planes;
  }

  #steps(band) {
    const unit = this.lattice.units.bands[band];
    const steps = new Float64Array(this.count);
    for (let i = 0; i < steps.length; i++) steps[i] = unit * POWERS[this.colourShifts[i]];
    return steps;
  }
}

/**
 * The first `size` coefficients of levels of components.
 *
 * @param {Int32Array[][]} levels planes of Y, of Co, of Cg
 * @param {number} size
 * @param {Float64Array} steps of each Gaussian
 * @param {Int32Array[]} bases from `readBases`
 * @param {(run: number) => number} begins gives the first Gaussian of a run, or the end of the last
 */
export function turnedColours(levels, size, steps, bases, begins) {
  const count = steps.length;
  const planes = new Float32Array(3 * size * count);
  const sums = levels.map(() => new Float64Array(size * AT_ONCE));
  const rows = Array.from({ length: size }, (_, k) =>
    sums.map((own) => own.subarray(k * AT_ONCE, (k + 1) * AT_ONCE)),
  );
  const units = steps.map((step) => step / MATRIX_ONE);
  bases.forEach((matrix, run) => {
    const end = begins(run + 1);
    for (let begin = begins(run); begin < end; begin += AT_ONCE) {
      const some = Math.min(AT_ONCE, end - begin);
      levels.forEach((own, colour) => turn(own, begin, some, matrix, sums[colour]));
      const own = units.subarray(begin, begin + some);
      rows.forEach((row, k) => {
        toColours(row, own, planes.subarray(k * count + begin), size * count);
      });
    }
  });
  return planes;
}

/**
 * Sums over components j of column k of a matrix times levels of `some` Gaussians from `begin` on,
 * each column `AT_ONCE` after the one before.
 */
function turn(levels, begin, some, matrix, sums) {
  sums.fill(0);
  levels.forEach((plane, j) => {
    for (let i = 0; i < some; i++) {
      const level = plane[begin + i];
      if (level === 0) continue;
      for (let at = i, entry = j; at < sums.length; at += AT_ONCE, entry += levels.length) {
        sums[at] += matrix[entry] * level;
      }
    }
  });
}

/** w, x, y, z of a rotation into `planes`, `stride` apart. */
function quaternion(pole, roll, tilt0, tilt1, planes, at, stride) {
  const r = clamp(roll, -1, 1);
  const c = Math.sqrt(1 - r * r);
  const squares = tilt0 * tilt0 + tilt1 * tilt1;
  const n = Math.sqrt(Math.max(squares, 1));
  const h = Math.sqrt(Math.max(1 - squares, 0));
  const a = tilt0 / n;
  const b = tilt1 / n;
  const across = c * a - r * b;
  const along = c * b + r * a;
  planes[at] = c * h;
  if (pole === 0) {
    planes[at + stride] = r * h;
    planes[at + 2 * stride] = across;
    planes[at + 3 * stride] = along;
  } else {
    planes[at + stride] = c * b - r * a;
    planes[at + 2 * stride] = c * a + r * b;
    planes[at + 3 * stride] = r * h;
  }
}

/** R, G, B from Y, Co, Cg in steps, into zeroed planes that are `stride` apart. */
export function toColours([ys, cos, cgs], steps, planes, stride) {
  for (let i = 0; i < steps.length; i++) {
    if (ys[i] === 0 && cos[i] === 0 && cgs[i] === 0) continue;
    const step = steps[i];
    const a = (fixedPoint(ys[i] * step) / ONE) * ROOTS[0];
    const b = (fixedPoint(cos[i] * step) / ONE) * ROOTS[1];
    const c = (fixedPoint(cgs[i] * step) / ONE) * ROOTS[2];
    planes[i] = a - c + b;
    planes[stride + i] = a + 2 * c;
    planes[2 * stride + i] = a - c - b;
  }
}
