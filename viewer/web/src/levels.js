// A file of which chosen blocks, of chosen levels of detail, are read and decoded.
import { checkBox, checkErrors, checkLevel, checkSupport } from './container.js';
import { Ending } from './ending.js';
import { EgsError, check } from './errors.js';
import { Opened, readHeader, runsOf, takeRun } from './opened.js';
import { createPool } from './pool.js';
import { Scene } from './scene.js';
import { selectBlocks } from './selection.js';
import { openParts } from './source.js';

/** Requests that wait for an answer at once, of a call of `decode`. */
const AT_ONCE = 4;

/** Bytes of the first sections of a level beside those of its blocks: more are asked for, if need be. */
const BESIDE = 512;

/**
 * Open an .egs file, with or without levels of detail, to decode chosen blocks.
 *
 * @param {ArrayBuffer | ArrayBufferView | Blob | Response | ReadableStream | string | URL} source
 *   the file, or where it is; of a URL, ranges are asked for
 * @param {object} [options]
 * @param {number} [options.workers] how many decode at once; 0 is this thread
 * @param {() => Worker} [options.createWorker] a worker that runs `worker.js`
 * @param {AbortSignal} [options.signal] ends the opening, and later closes the file
 * @returns {Promise<EgsFile>}
 * @throws {EgsError} one of its classes; the signal's reason
 */
export async function open(source, options = {}) {
  const { signal } = options;
  signal?.throwIfAborted();
  const input = await openParts(source, signal);
  const ending = new Ending(signal);
  const file = new EgsFile(input, options, ending);
  return ending.before(file.begin());
}

/** A source, positions in which count from a place in another, and of which the start may be known. */
class Within {
  constructor(input, at) {
    this.input = input;
    this.at = at;
    this.start = new Uint8Array(0);
  }

  async know(size) {
    this.start = await this.read(0, size);
  }

  async read(begin, end, signal) {
    if (end <= this.start.length) return this.start.subarray(begin, end);
    return this.input.read(this.at + begin, this.at + end, signal);
  }
}

/** Say in errors of the format that they are of a level. */
async function within(level, work) {
  try {
    return await work();
  } catch (error) {
    if (level > 0 && error instanceof EgsError && !error.level) {
      error.message = `level ${level}: ${error.message}`;
      error.level = level;
    }
    throw error;
  }
}

/**
 * An open file.
 *
 * `levels` has for each level, of which 0 is the scene, `count` (Gaussians), `blocks` (how many),
 * `boxes` (`{centres, reach}` of each block, lowest and highest x, y, z) and `errors` (of each block,
 * scene units; none of level 0). `degree`, `profile`, `coordinates`, `antialiased`, `bytes` are those
 * of the scene; `size` is that of the file, and `fetched` how many bytes of it have been read.
 */
export class EgsFile {
  #input;
  #options;
  #pool;
  #opened = [];
  #ending;

  constructor(input, options, ending) {
    this.#input = input;
    this.#options = options;
    this.#ending = ending;
    this.fetched = 0;
    ending.signal.addEventListener('abort', () => {
      ending.release();
      this.#pool?.close();
      input.close();
    });
  }

  /** Read `[begin, end)`. */
  async read(begin, end, signal) {
    const data = await this.#input.read(begin, end, signal);
    this.fetched += end - begin;
    return data;
  }

  /** Read what says which levels and blocks there are. */
  async begin() {
    const header = await readHeader(this);
    checkSupport(header);
    header.checkSize(this.#input.size);
    const scene = await this.#describe(header, this, false);
    this.#opened = [scene];
    const found = header.sections.filter(({ name }) => name === 'level');
    const levels = await Promise.all(found.map((entry) => this.#openLevel(scene, entry)));
    levels.forEach((opened, k) => (this.#opened[found[k].block] = opened));
    for (let level = 1; level < this.#opened.length; level++) {
      const [finer, coarser] = [this.#opened[level - 1], this.#opened[level]];
      const before = finer.errors ?? new Float64Array(finer.header.blocks);
      await within(level, () => checkErrors(before, coarser.errors));
    }
    for (const name of ['degree', 'profile', 'coordinates', 'antialiased', 'bytes']) {
      this[name] = header[name];
    }
    this.size = header.end;
    this.levels = this.#opened.map(({ header: { count, blocks, blockSize }, boxes, errors }) => ({
      count,
      blocks,
      blockSize,
      boxes,
      errors,
    }));
    const all = this.#opened.reduce((sum, opened) => sum + opened.header.blocks, 0);
    const setups = this.#opened.map(({ setup }) => setup);
    this.#ending.signal.throwIfAborted();
    this.#pool = createPool(setups, all, this.#options);
    return this;
  }

  /** Read the first sections of a file, or of a level. */
  async #describe(header, input, isLevel) {
    const opened = new Opened(header, isLevel);
    for (const run of runsOf(opened.first, this.#input.atOnce)) {
      const data = await input.read(run.begin, run.end);
      takeRun(run, data, (entry, content) => opened.take(entry, content));
    }
    opened.begin(header.degree);
    opened.ofBlock = Array.from({ length: header.blocks }, () => []);
    const names = new Set(opened.parts.flat());
    for (const entry of opened.rest) {
      if (names.has(entry.name)) opened.ofBlock[entry.block].push(entry);
    }
    opened.input = input;
    return opened;
  }

  #openLevel({ header, common }, entry) {
    const level = entry.block;
    return within(level, async () => {
      const blocks = Math.ceil(header.levelCounts[level - 1] / header.blockSize);
      // So many bytes as it should take are asked for at once.
      const perBlock = 20 * Math.ceil(header.sections.length / header.blocks) + 52;
      const guess = blocks * perBlock + Math.ceil(1.25 * common.length) + BESIDE;
      const input = new Within(this, entry.at);
      await input.know(Math.min(entry.size, guess));
      check(entry.size >= 16, 'header', 'truncated');
      const found = await readHeader(input);
      checkLevel(found, level, header);
      found.checkSize(entry.size);
      const opened = await this.#describe(found, input, true);
      return opened;
    });
  }

  /**
   * Which blocks of which level a camera needs, as FORMAT.md says under "Selection".
   *
   * @param {object} view `width`, `height`, `fx`, `fy`, `cx`, `cy` (pixels), `rotation` (its rows
   *   point right, down, forward) and `position`, in the file's axes
   * @param {object} [options]
   * @param {number} [options.budget] most Gaussians
   * @param {number} [options.tolerance] largest error of what is drawn in place of finer, pixels
   * @returns {number[][]} numbers of blocks of each level
   */
  select(view, { budget = Infinity, tolerance = 1 } = {}) {
    if (!(budget >= 0)) throw new RangeError(`budget: ${budget}, expected a number`);
    if (!(tolerance >= 0)) throw new RangeError(`tolerance: ${tolerance}, expected a number`);
    return selectBlocks(this.#opened, view, budget, tolerance);
  }

  /** For `look`: the header, boxes and errors of each level. */
  get described() {
    return this.#opened;
  }

  /**
   * Decode blocks of a level.
   *
   * @param {number} level
   * @param {number[]} blocks their Gaussians follow each other in this order
   * @param {object} [options]
   * @param {number} [options.shDegree] highest SH degree that is fetched and decoded, 0-3
   * @param {(scene: Scene, part: object) => void} [options.onBlock] called when the `part.count`
   *   Gaussians, from `part.first` on, of `part.block` are there
   * @param {AbortSignal} [options.signal]
   * @returns {Promise<Scene>}
   * @throws {EgsError} one of its classes; the signal's reason
   */
  async decode(level, blocks, { shDegree = 3, onBlock, signal } = {}) {
    this.#ending.signal.throwIfAborted();
    signal?.throwIfAborted();
    const opened = this.#opened[level];
    if (!opened || !blocks.every((block) => opened.ofBlock[block])) {
      throw new RangeError(`level ${level}, blocks ${blocks}: not all are there`);
    }
    if (![0, 1, 2, 3].includes(shDegree)) throw new RangeError(`shDegree: ${shDegree}`);
    const ending = new Ending(this.#ending.signal, signal);
    try {
      const decoding = new Chosen(opened, level, blocks, shDegree, onBlock);
      const run = () => decoding.run(this.#pool, this.#input.atOnce, ending.signal);
      return await ending.before(within(level, run));
    } finally {
      ending.release();
    }
  }

  /** End all that is under way; what is asked for later fails. */
  close(reason = new EgsError('closed')) {
    this.#ending.end(reason);
  }
}

/** Blocks that are being decoded. */
class Chosen {
  constructor(opened, level, blocks, shDegree, onBlock) {
    Object.assign(this, { opened, level, onBlock });
    const { header } = opened;
    this.degree = Math.min(shDegree, header.degree);
    this.names = new Set(opened.parts.slice(0, this.degree + 1).flat());
    this.blocks = new Map(); // by number: where a block begins, and what of it waits
    let first = 0;
    for (const block of blocks) {
      this.blocks.set(block, { first, sections: {}, left: 0 });
      first += header.blockCount(block);
    }
    this.scene = new Scene(header, first, this.degree);
    this.pending = [];
  }

  async run(pool, atOnce, signal) {
    const { opened, blocks, names } = this;
    const entries = [];
    for (const [block, waiting] of blocks) {
      const own = opened.ofBlock[block].filter(({ name }) => names.has(name));
      waiting.left = own.length;
      entries.push(...own);
    }
    entries.sort((a, b) => a.at - b.at);
    // Values of blocks without sections are constant.
    for (const [block, { left }] of blocks) if (left === 0) this.#decode(pool, block, signal);
    const runs = runsOf(entries, atOnce);
    const readNext = async () => {
      for (let run; (run = runs.shift());) {
        const data = await opened.input.read(run.begin, run.end, signal);
        signal.throwIfAborted();
        takeRun(run, data, ({ name, block }, content) => {
          const waiting = blocks.get(block);
          waiting.sections[name] = content.slice(); // which goes to a worker
          if (--waiting.left === 0) this.#decode(pool, block, signal);
        });
      }
    };
    await Promise.all(Array.from({ length: AT_ONCE }, readNext));
    await Promise.all(this.pending);
    return this.scene;
  }

  #decode(pool, block, signal) {
    const done = this.#put(pool, block, signal);
    done.catch(() => {}); // it is waited for later, or others have failed
    this.pending.push(done);
  }

  async #put(pool, block, signal) {
    const { opened, level, degree, scene } = this;
    const { first, sections } = this.blocks.get(block);
    const count = opened.header.blockCount(block);
    const job = { file: level, block, count, degree, sections };
    const parts = await pool.decode(job);
    signal.throwIfAborted();
    checkBox(opened.boxes[block].centres, parts[0], count, block);
    parts.forEach((planes, part) => scene.put(part, planes, first, count));
    this.onBlock?.(scene, { level, block, first, count, degree });
  }
}
