// Decoder of .egs files (gs_codec), written from FORMAT.md.
import { checkBox, checkSupport, readComments } from './container.js';
import { Ending } from './ending.js';
import { CorruptError } from './errors.js';
import { checkExtra } from './extra.js';
import { Opened, readHeader, runsOf, takeRun } from './opened.js';
import { createPool } from './pool.js';
import { Scene, checkFloats, floatBytes } from './scene.js';
import { openSource } from './source.js';

export {
  CorruptError,
  EgsError,
  SourceError,
  TooLargeError,
  UnsupportedError,
  WorkerError,
} from './errors.js';
export { open } from './levels.js';
export { openSequence } from './sequence.js';
export { Scene };

/**
 * Decode an .egs file.
 *
 * @param {ArrayBuffer | ArrayBufferView | Blob | Response | ReadableStream | string | URL} source
 *   the file, or its address
 * @param {object} [options]
 * @param {number} [options.shDegree] highest SH degree to decode, 0-3; higher bands are not even
 *   fetched if they come last in the file, as in ours
 * @param {number[][]} [options.box] lowest and highest x, y, z: only blocks with centres inside are
 *   decoded; from a URL, they are fetched by ranges
 * @param {(scene: Scene, part: object) => void} [options.onBlock] called when block `part.block` is
 *   decoded up to SH degree `part.degree`: `part.count` Gaussians from `part.first` on
 * @param {(block: number, error: CorruptError) => void} [options.onDamage] called once for each
 *   damaged block, which is skipped: its values stay 0, or those decoded before; without it, damage
 *   ends decoding
 * @param {(bytes: number, of: number) => void} [options.onProgress] called with the bytes read
 * @param {number} [options.workers] number of workers; 0 decodes in this thread
 * @param {() => Worker} [options.createWorker] makes a worker that runs `worker.js`, if it is not
 *   next to this module
 * @param {number} [options.maxBytes] maximum bytes of the decoded floats and, of a whole scene, of
 *   extra properties; by default 1 GiB or, if its size is known, 1000 times the file
 * @param {boolean} [options.extra] whether extra properties are fetched and checked, true by default
 * @param {AbortSignal} [options.signal]
 * @returns {Promise<Scene>}
 * @throws {EgsError} or a subclass; the signal's reason; RangeError for invalid options
 */
export async function decode(source, options = {}) {
  checkOptions(options);
  const { signal } = options;
  signal?.throwIfAborted();
  const input = await openSource(source, options.box !== undefined, signal);
  const ending = new Ending(signal);
  const decoding = new Decoding(input, options, ending);
  try {
    return await ending.before(decoding.run());
  } finally {
    ending.release();
    decoding.close();
    input.close();
  }
}

/** Reject invalid options. */
function checkOptions({ shDegree, box, maxBytes }) {
  if (shDegree !== undefined && ![0, 1, 2, 3].includes(shDegree)) {
    throw new RangeError(`shDegree: ${shDegree}, expected 0-3`);
  }
  const isPoint = (point) => point?.length === 3 && [...point].every((value) => value === +value);
  if (box !== undefined && !(box?.length === 2 && isPoint(box[0]) && isPoint(box[1]))) {
    throw new RangeError('box: expected [[x, y, z], [x, y, z]]');
  }
  if (maxBytes !== undefined && !(maxBytes >= 0)) {
    throw new RangeError(`maxBytes: ${maxBytes}, expected a number`);
  }
}

class Decoding {
  constructor(input, options, ending) {
    this.input = input;
    this.options = options;
    this.ending = ending; // no callbacks after it
    this.blocks = new Map(); // by number: first Gaussian of a block, and its pending sections
    this.pending = [];
    this.lost = new Set(); // damaged blocks
    this.broken = new Set(); // damaged blocks that could not be decoded
  }

  close() {
    this.pool?.close();
  }

  async run() {
    const { input, options } = this;
    const header = (this.header = await readHeader(input));
    checkSupport(header);
    header.checkSize(input.size);
    this.degree = Math.min(options.shDegree ?? 3, header.degree);
    const opened = new Opened(header);
    let comments = [];
    await this.#read(opened.first, (entry, content) => opened.take(entry, content));
    this.#begin(opened);
    await this.#read(
      opened.rest.filter((entry) => this.#wants(entry)),
      (entry, content) => {
        if (entry.name === 'comments') comments = readComments(content);
        else if (entry.name === 'extra') this.#await(this.#checkExtra(content.slice()));
        else this.#take(entry, content);
      },
    );
    await Promise.all(this.pending);
    this.ending.signal.throwIfAborted();
    if (this.#isWhole && !(await input.endsAt(header.end))) {
      throw new CorruptError('bytes after the last section', 'file');
    }
    this.scene.comments = comments;
    return this.scene;
  }

  /** Read sections, adjacent ones together, and pass them on. */
  async #read(entries, take) {
    const { input, options, header } = this;
    for (const run of runsOf(entries, input.atOnce)) {
      const data = await input.read(run.begin, run.end);
      this.ending.signal.throwIfAborted();
      takeRun(run, data, take, ({ name, block }, error) => {
        if (!this.#isOfBlocks(name)) throw error;
        this.#lose(block, error);
      });
      options.onProgress?.(run.end, header.end);
      this.ending.signal.throwIfAborted();
    }
  }

  /** Determine blocks and their sections from the first sections. */
  #begin(opened) {
    const { header, options, degree } = this;
    opened.begin(degree);
    this.opened = opened;
    this.boxes = opened.boxes;
    let first = 0;
    for (let block = 0; block < header.blocks; block++) {
      if (!meets(this.boxes[block].centres, options.box)) continue;
      this.blocks.set(block, { first, sections: {}, next: 0 });
      first += header.blockCount(block);
    }
    checkFloats(first, degree, this.#maxBytes);
    this.scene = new Scene(header, first, degree);
    this.pool = createPool([opened.setup], this.blocks.size, options);
    // Values of blocks without sections are constant.
    if (opened.parts[0].length === 0) for (const block of this.blocks.keys()) this.#advance(block);
  }

  get #isWhole() {
    return !this.options.box && this.degree === this.header.degree;
  }

  get #maxBytes() {
    return this.options.maxBytes ?? Math.max(2 ** 30, 1000 * (this.input.size ?? 0));
  }

  #checkExtra(content) {
    const { count, degree } = this.header;
    return checkExtra(content, count, this.#maxBytes - floatBytes(count, degree));
  }

  /** Register work that must be done at the end; its error ends everything. */
  #await(work) {
    work.catch((error) => this.ending.end(error));
    this.pending.push(work);
  }

  #wants({ name, block }) {
    if (name === 'extra') return this.#isWhole && this.options.extra !== false;
    return name === 'comments' || (this.#isOfBlocks(name) && this.blocks.has(block));
  }

  /** Whether blocks have sections of this name. */
  #isOfBlocks(name) {
    return this.opened?.parts.some((names) => names.includes(name));
  }

  /** Skip a damaged block if allowed; rethrow any other error. */
  #lose(block, error) {
    const { onDamage } = this.options;
    if (!onDamage || !(error instanceof CorruptError) || !this.blocks.has(block)) throw error;
    if (!this.lost.has(block)) onDamage(block, error);
    this.lost.add(block);
  }

  /** Like `#lose`, for a part that could not be decoded; later parts are useless. */
  #break(block, error) {
    if (!this.broken.has(block)) this.#lose(block, error);
    this.broken.add(block);
  }

  /** Take a section of a block. */
  #take({ name, block }, content) {
    // A copy: the buffer may contain other sections, and its memory moves to a worker.
    this.blocks.get(block).sections[name] = content.slice();
    this.#advance(block);
  }

  /** Decode the complete parts of a block. */
  #advance(block) {
    const waiting = this.blocks.get(block);
    const { sections } = waiting;
    if (this.broken.has(block)) return;
    for (; waiting.next < this.opened.parts.length; waiting.next++) {
      const names = this.opened.namesOf(block, waiting.next);
      if (!names.every((name) => sections[name])) return;
      const given = Object.fromEntries(names.map((name) => [name, sections[name]]));
      for (const name of names) delete sections[name];
      const done = this.#decode(block, waiting.next, given);
      this.#await(done.catch((error) => this.#break(block, error)));
    }
  }

  async #decode(block, part, sections) {
    const { header, scene, options } = this;
    const { first } = this.blocks.get(block);
    const count = header.blockCount(block);
    const planes = await this.pool.decode({ file: 0, block, count, part, sections });
    this.ending.signal.throwIfAborted();
    if (this.broken.has(block)) return;
    if (part === 0) checkBox(this.boxes[block].centres, planes, count, block);
    const { degrees } = this.opened;
    scene.put(degrees[part - 1] ?? -1, degrees[part], planes, first, count);
    options.onBlock?.(scene, { block, first, count, degree: degrees[part] });
  }
}

/** Whether two boxes intersect. */
function meets([low, high], box) {
  if (box === undefined) return true;
  return low.every((value, axis) => value <= box[1][axis] && high[axis] >= box[0][axis]);
}
