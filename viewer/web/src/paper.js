// Annexes A and B of FORMAT.md: profiles paper-l, paper-m, paper-s.
import { BinaryCoder } from './binary.js';
import { RawBits, Reader } from './bytes.js';
import { check } from './errors.js';
import { Neighbours } from './neighbours.js';
import { bitLength, inRange } from './numbers.js';
import { LANES, Words, checkLastStates, firstStates, frequencies, sentTables } from './tables.js';
import { addBits, axesOf, walkTree } from './tree.js';
import { counted } from './wording.js';

const BANDS = [
  [0, 3],
  [3, 8],
  [8, 15],
];
const NORMAL = normalTable();

/** A channel: its quantiser, and the table of its symbols. */
class Channel {
  constructor(stream, plane) {
    this.stream = stream;
    this.plane = plane; // plane within the part of its stream
    this.depth = 0; // 0 if constant
    this.first = 0;
    this.step = 0;
  }

  /** Fill a plane with the values of symbols. */
  fill(plane, symbols) {
    const { first, step } = this;
    if (this.depth === 0) {
      plane.fill(first);
      return;
    }
    for (let i = 0; i < plane.length; i++) plane[i] = inRange(first + symbols[i] * step);
  }

  /** Read the quantiser. */
  read(reader) {
    const where = `channels: ${this.stream}`;
    const kind = reader.u8();
    check(kind <= 2, where, `quantiser of kind ${kind}`);
    if (kind === 0) {
      this.first = reader.f32();
      check(Number.isFinite(this.first), where, 'value is not finite');
      return;
    }
    const depth = reader.u8();
    const [low, high] = [reader.f32(), reader.f32()];
    check(depth >= 1 && depth <= (this.stream === 'geometry' ? 21 : 12), where, `depth ${depth}`);
    check(Number.isFinite(low) && Number.isFinite(high), where, 'parameters are not finite');
    this.depth = depth;
    if (kind === 1) {
      check(low < high, where, 'low is not below high');
      this.first = low;
      this.step = (high - low) / (2 ** depth - 1);
    } else {
      check(high > 0, where, 'half_range is not above 0');
      this.step = (2 * high) / (2 ** depth - 1);
      this.first = low - 2 ** (depth - 1) * this.step;
    }
  }

  /** Set the table: symbol, frequency and offset of each slot. */
  setTable(weights) {
    const size = 2 ** this.precision;
    this.symbols = new Uint16Array(size);
    this.runs = new Uint16Array(size);
    this.places = new Uint16Array(size);
    let slot = 0;
    frequencies(weights, this.precision, 'channels').forEach((frequency, symbol) => {
      for (let k = 0; k < frequency; k++, slot++) {
        this.symbols[slot] = symbol;
        this.runs[slot] = frequency;
        this.places[slot] = k;
      }
    });
  }
}

/** The section `channels`. */
export class Channels {
  constructor(content, degree) {
    const streams = ['x', 'y', 'z'].map((_, k) => new Channel('geometry', k));
    for (let c = 0; c < 3; c++) streams.push(new Channel('sh-dc', c));
    streams.push(new Channel('opacity', 0));
    for (let k = 0; k < 3; k++) streams.push(new Channel('scaling', k));
    for (let k = 0; k < 4; k++) streams.push(new Channel('rotation', k));
    BANDS.slice(0, degree).forEach(([first, end], band) => {
      for (let k = 0; k < 3 * (end - first); k++) streams.push(new Channel(`sh${band + 1}`, k));
    });
    this.all = streams;
    this.#read(new Reader(content, 'channels'));
  }

  #read(reader) {
    const sent = [];
    for (const channel of this.all) {
      channel.read(reader);
      if (['geometry', 'sh-dc'].includes(channel.stream) || channel.depth === 0) continue;
      const size = 2 ** channel.depth;
      const kind = reader.u8();
      check(kind <= 2, 'channels', `model of kind ${kind}`);
      channel.precision = reader.u8();
      const fits = channel.precision >= Math.max(8, channel.depth) && channel.precision <= 15;
      check(fits, 'channels', `precision ${channel.precision} of ${counted(size, 'symbol')}`);
      if (kind === 0) channel.setTable(laplaceWeights(reader, size));
      else if (kind === 1) channel.setTable(mixtureWeights(reader, size));
      else {
        const mantissa = reader.u8();
        check(mantissa <= 15, 'channels', `mantissa of ${counted(mantissa, 'bit')}`);
        sent.push({ channel, size, mantissa });
      }
    }
    sentTables(reader.rest(), sent).forEach((weights, k) => sent[k].channel.setTable(weights));
  }

  /** The channels of a stream. */
  of(stream) {
    return this.all.filter((channel) => channel.stream === stream);
  }

  /** Names of the sections of each block. */
  get sections() {
    const names = new Set(this.all.filter((c) => c.depth > 0).map((c) => c.stream));
    if ([...names].some((name) => !['geometry', 'sh-dc'].includes(name))) names.add('states');
    return [...names];
  }
}

function weightsOf(cumulative) {
  return Float64Array.from({ length: cumulative.length - 1 }, (_, q) =>
    Math.max(cumulative[q + 1] - cumulative[q], 1),
  );
}

function laplaceWeights(reader, size) {
  const decay = reader.u16();
  check(decay >= 1, 'channels', 'decay 0');
  const half = size / 2;
  const tail = [decay * 32768];
  while (tail.length < half) {
    const before = Math.floor((tail[tail.length - 1] * decay) / 65536);
    tail.push(Math.floor((before * decay) / 65536));
  }
  const cumulative = new Float64Array(size + 1);
  for (let q = 1; q < size; q++) {
    cumulative[q] = q <= half ? tail[half - q] : 2 ** 32 - tail[q - half - 1];
  }
  cumulative[size] = 2 ** 32;
  return weightsOf(cumulative);
}

function mixtureWeights(reader, size) {
  const count = reader.u8();
  check(count >= 1 && count <= 4, 'channels', counted(count, 'component'));
  const parts = Array.from({ length: count }, () => [reader.u16(), reader.u32(), reader.u32()]);
  check(
    parts.every(([w, , sigma]) => w >= 1 && sigma >= 1),
    'channels',
    'weight or sigma 0',
  );
  const cumulative = new Float64Array(size + 1);
  for (let q = 1; q < size; q++) {
    let total = 0;
    for (const [weight, mean, sigma] of parts) {
      total += weight * normal(q * 65536 - 32768, mean, sigma);
    }
    cumulative[q] = Math.floor(total / 65536);
  }
  const whole = parts.reduce((sum, [weight]) => sum + weight, 0);
  cumulative[size] = Math.floor((whole * 2 ** 30) / 65536);
  return weightsOf(cumulative);
}

/** The normal distribution function at an edge, in 1 / 2^30. */
function normal(edge, mean, sigma) {
  const z = Math.min(Math.floor((Math.abs(edge - mean) * 65536) / sigma), 2 ** 19 - 1);
  const i = z >> 10;
  const found = NORMAL[i] + Math.floor(((NORMAL[i + 1] - NORMAL[i]) * (z & 1023)) / 1024);
  return edge < mean ? 2 ** 30 - found : found;
}

/** T_0 to T_512 of Annex B. */
function normalTable() {
  let density = 1n << 60n;
  let ratio = 1152780775708076725n;
  const factor = (ratio * ratio) >> 60n;
  const sums = [0n];
  for (let i = 0; i < 512; i++) {
    const following = (density * ratio) >> 60n;
    sums.push(sums[i] + density + following);
    density = following;
    ratio = (ratio * factor) >> 60n;
  }
  return Float64Array.from(sums, (sum) => 2 ** 29 + Number(((1n << 29n) * sum) / sums[512]));
}

/** A block decoded in parts, like `LatticeBlock`. */
export class PaperBlock {
  constructor(channels, count, degree) {
    this.channels = channels;
    this.count = count;
    this.degree = degree;
    this.varies = channels.sections.includes('states');
  }

  base(sections) {
    const { channels, count } = this;
    if (this.varies) {
      this.states = firstStates(new Reader(sections.states, 'states'), Math.min(LANES, count));
    }
    const planes = new Float32Array(14 * count);
    const cells = [0, 1, 2].map(() => new Int32Array(count));
    const positions = channels.of('geometry');
    if (sections.geometry) this.#geometry(sections.geometry, positions, cells);
    positions.forEach((channel, k) =>
      channel.fill(planes.subarray(k * count, (k + 1) * count), cells[k]),
    );
    this.#dc(sections['sh-dc'], cells, planes.subarray(3 * count, 6 * count));
    this.#stream('opacity', sections, planes.subarray(6 * count, 7 * count));
    this.#stream('scaling', sections, planes.subarray(7 * count, 10 * count));
    this.#stream('rotation', sections, planes.subarray(10 * count));
    if (this.degree === 0 && this.varies) checkLastStates(this.states);
    return planes;
  }

  band(band, content) {
    const name = `sh${band + 1}`;
    const planes = new Float32Array((6 * band + 9) * this.count);
    this.#stream(name, { [name]: content }, planes);
    if (band + 1 === this.degree && this.varies) checkLastStates(this.states);
    return planes;
  }

  #geometry(content, channels, cells) {
    const reader = new Reader(content, 'geometry');
    const coded = reader.take(reader.u32());
    const raw = new RawBits(reader.rest(), 'geometry');
    const axes = axesOf(channels.map((channel) => channel.depth));
    let i = 0;
    walkTree(coded, this.count, axes, (x, y, z, missing, points) => {
      const cell = [x, y, z];
      if (points === 1) addBits(cell, axes, axes.length - missing, axes.length, raw);
      for (let axis = 0; axis < 3; axis++) cells[axis].fill(cell[axis], i, i + points);
      i += points;
    });
    raw.finish();
  }

  #dc(content, cells, planes) {
    const { count } = this;
    const [red, green, blue] = this.channels.of('sh-dc');
    const values = [0, 1, 2].map(() => new Int32Array(count)); // of G, R - G, B - G
    if (content) {
      const near = new Neighbours(cells);
      const coder = new BinaryCoder(content, 9408, 'sh-dc');
      const coded = [green, red, blue];
      for (let i = 0; i < count; i++) {
        let residual = 0;
        for (let kind = 0; kind < 3; kind++) {
          if (coded[kind].depth === 0) continue;
          const guess = near.predict(i, values[kind]);
          const spread = near.spread(i, values[kind], guess);
          const mean = Math.floor((4 * spread) / Math.max(near.totals[i], 1));
          const activity = Math.min(bitLength(mean), 13);
          const size = Math.min(bitLength(Math.abs(residual)) >> 1, 3);
          residual = readResidual(coder, 56 * ((14 * kind + activity) * 4 + size));
          values[kind][i] = guess + residual;
        }
      }
      coder.finish();
    }
    const [base, ...others] = values;
    for (const plane of others) for (let i = 0; i < count; i++) plane[i] += base[i];
    [others[0], base, others[1]].forEach((symbols, c) => {
      const channel = [red, green, blue][c];
      const inside = channel.depth === 0 || symbols.every((s) => s >= 0 && s < 2 ** channel.depth);
      check(inside, 'sh-dc', 'a symbol is out of range');
      channel.fill(planes.subarray(c * count, (c + 1) * count), symbols);
    });
  }

  /** Decode the channels of a stream with rANS. */
  #stream(name, sections, planes) {
    const { count, states } = this;
    const words = new Words(sections[name] ?? new Uint8Array(0), name);
    const symbols = new Uint16Array(count);
    for (const channel of this.channels.of(name)) {
      if (channel.depth > 0) {
        const { symbols: table, runs, places, precision } = channel;
        const mask = 2 ** precision - 1;
        for (let i = 0; i < count; i++) {
          const state = states[i % LANES];
          const slot = state & mask;
          states[i % LANES] = words.next(state, precision, runs[slot], places[slot]);
          symbols[i] = table[slot];
        }
      }
      channel.fill(planes.subarray(channel.plane * count, (channel.plane + 1) * count), symbols);
    }
    words.finish();
  }
}

function readResidual(coder, base) {
  let bits = 0;
  while (bits < 13 && coder.bit(base + bits)) bits++;
  if (bits === 0) return 0;
  const negative = coder.bit(base + 14);
  let size = 1;
  for (let j = 0; j < bits - 1; j++) {
    size = 2 * size + coder.bit(base + 14 * (1 + Math.min(j, 2)) + bits);
  }
  return negative ? -size : size;
}
