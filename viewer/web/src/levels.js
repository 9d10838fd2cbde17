// A file from which selected blocks, of selected levels of detail, are read and decoded.
import { partDegrees } from './basis.js';
import { checkBox, checkErrors, checkLevel, checkSupport } from './container.js';
import { Ending } from './ending.js';
import { EgsError, check } from './errors.js';
import { Opened, readHeader, runsOf, takeRun } from './opened.js';
import { createPool } from './pool.js';
import { Scene } from './scene.js';
import { selectBlocks } from './selection.js';
import { openParts } from './source.js';

/** Number of concurrent requests of a call of `decode`. */
const AT_ONCE = 4;

/** Bytes of a level's first sections in addition to its blocks'; more are requested if needed. */
const BESIDE = 512;

/**
 * Open an .egs file, with or without levels of detail, to decode selected blocks.
 *
 * @param {ArrayBuffer | ArrayBufferView | Blob | Response | ReadableStream | string | URL} source
 *   the file, or its address; a URL is read by ranges
 * @param {object} [options]
 * @param {number} [options.workers] number of workers; 0 decodes in this thread
 * @param {() => Worker} [options.createWorker] makes a worker that runs `worker.js`
 * @param {AbortSignal} [options.signal] aborts opening, and later closes the file
 * @returns {Promise<EgsFile>}
 * @throws {EgsError} or a subclass; the signal's reason
 */
export async function open(source, options = {}) {
  const { signal } = options;
  signal?.throwIfAborted();
  const input = await openParts(source, signal);
  const ending = new Ending(signal);
  const file = new EgsFile(input, options, ending);
  return ending.before(file.begin());
}

/** A source at an offset in another source; its start may already be known. */
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

/** Name the level in errors of the format. */
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
 * `levels` has for each level (0 is the scene): `count` (Gaussians), `blocks` (their number),
 * `boxes` (`{centres, reach}` of each block, lowest and highest x, y, z) and `errors` (of each
 * block, scene units; not for level 0). `degree`, `profile`, `coordinates`, `antialiased`, `bytes`
 * are those of the scene; `size` is that of the file, and `fetched` the number of bytes read so
 * far.
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

  /** Read the descriptions of levels and blocks. */
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
      // Request the expected number of bytes at once.
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
   * Select the blocks of each level that a camera needs (FORMAT.md, "Selection").
   *
   * @param {object} view `width`, `height`, `fx`, `fy`, `cx`, `cy` (pixels), `rotation` (its rows
   *   point right, down, forward) and `position`, in the file's axes
   * @param {object} [options]
   * @param {number} [options.budget] maximum number of Gaussians
   * @param {number} [options.tolerance] maximum error in pixels of a block drawn in place of finer
   *   ones
   * @returns {number[][]} numbers of blocks of each level
   */
  select(view, { budget = Infinity, tolerance = 1 } = {}) {
    if (!(budget >= 0)) throw new RangeError(`budget: ${budget}, expected a number`);
    if (!(tolerance >= 0)) throw new RangeError(`tolerance: ${tolerance}, expected a number`);
    return selectBlocks(this.#opened, view, budget, tolerance);
  }

  /** The header, boxes and errors of each level, for `look`. */
  get described() {
    return this.#opened;
  }

  /**
   * Decode blocks of a level.
   *
   * @param {number} level
   * @param {number[]} blocks in the order of their Gaussians in the result
   * @param {object} [options]
   * @param {number} [options.shDegree] highest SH degree to fetch and decode, 0-3
   * @param {(scene: Scene, part: object) => void} [options.onBlock] called when block `part.block`
   *   is decoded: `part.count` Gaussians from `part.first` on
   * @param {AbortSignal} [options.signal]
   * @returns {Promise<Scene>}
   * @throws {EgsError} or a subclass; the signal's reason
   */
  async decode(level, blocks, { shDegree = 3, onBlock, signal } = {}) {
    this.#ending.signal.throwIfAborted();
    signal?.throwIfAborted();
    const opened = this.#opened[level];
    const exist = opened && blocks.every((block) => opened.ofBlock[block]);
    if (!exist || new Set(blocks).size < blocks.length) {
      throw new RangeError(`level ${level}, blocks ${blocks}: expected existing ones, each once`);
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

  /** End everything in progress; later calls fail. */
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
    this.degrees = partDegrees(this.degree, header.hasBasis);
    this.names = new Set(opened.parts.slice(0, this.degrees.length).flat());
    this.blocks = new Map(); // by number: first Gaussian of a block, and its pending sections
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
          waiting.sections[name] = content.slice(); // its memory moves to a worker
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
    done.catch(() => {}); // awaited later, unless others have failed
    this.pending.push(done);
  }

  async #put(pool, block, signal) {
    const { opened, level, degree, degrees, scene } = this;
    const { first, sections } = this.blocks.get(block);
    const count = opened.header.blockCount(block);
    const job = { file: level, block, count, degree, sections };
    const parts = await pool.decode(job);
    signal.throwIfAborted();
    checkBox(opened.boxes[block].centres, parts[0], count, block);
    parts.forEach((planes, part) =>
      scene.put(degrees[part - 1] ?? -1, degrees[part], planes, first, count),
    );
    this.onBlock?.(scene, { level, block, first, count, degree });
  }
}
