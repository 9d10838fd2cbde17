// Section "Sequences" of FORMAT.md: frames that are read and decoded a group at a time.
import { partDegrees } from './basis.js';
import { Reader } from './bytes.js';
import { checkBox, checkKeyFrame, checked, paddedSize, readComments } from './container.js';
import { Ending } from './ending.js';
import { EgsError, TooLargeError, UnsupportedError, check } from './errors.js';
import { Opened, readHeader, takeRun } from './opened.js';
import { createPool } from './pool.js';
import { Scene, checkFloats } from './scene.js';
import { openParts } from './source.js';
import { counted } from './wording.js';

/**
 * Open an .egs file that is a sequence.
 *
 * @param {ArrayBuffer | ArrayBufferView | Blob | Response | ReadableStream | string | URL} source
 *   the file, or its address; a URL is read by ranges, a group at a time
 * @param {object} [options]
 * @param {number} [options.workers] number of workers; 0 decodes in this thread
 * @param {() => Worker} [options.createWorker] makes a worker that runs `worker.js`
 * @param {number} [options.maxBytes] maximum bytes of the floats of a frame; by default 1 GiB or,
 *   if that is more, 1000 times the bytes of its key frame
 * @param {AbortSignal} [options.signal] aborts opening, and later closes the sequence
 * @returns {Promise<Sequence>}
 * @throws {EgsError} or a subclass; the signal's reason
 */
export async function openSequence(source, options = {}) {
  const { signal } = options;
  signal?.throwIfAborted();
  const input = await openParts(source, signal);
  const ending = new Ending(signal);
  return ending.before(new Sequence(input, options, ending).begin());
}

/** Bytes of groups that are kept; always those of two. */
const KEPT = 2 ** 25;

/** Name the frame in errors of the format. */
async function within(frame, work) {
  try {
    return await work();
  } catch (error) {
    if (error instanceof EgsError) error.message = `frame ${frame}: ${error.message}`;
    throw error;
  }
}

/**
 * An open sequence.
 *
 * `count` is the number of frames, `fps` of those a second, `names` are theirs (maybe none), `keys`
 * the numbers of the frames that begin groups, ascending; `degree`, `profile`, `coordinates`,
 * `antialiased` are those of all frames, `bytes` those of the file by section, `size` the file's,
 * `fetched` the number of bytes read so far.
 */
export class Sequence {
  #input;
  #options;
  #ending;
  #pool;
  #header;
  #frames;
  #opened = 0; // groups, ever
  #coming = new Map(); // promises of bytes of the latest groups
  #current = null; // the group of `frame`
  #last = Promise.resolve();

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
  async read(begin, end) {
    const data = await this.#input.read(begin, end);
    this.fetched += end - begin;
    return data;
  }

  /** Read the header and the timeline. */
  async begin() {
    const header = (this.#header = await readHeader(this));
    if (!header.isSequence) throw new UnsupportedError('one scene: use decode or open', 'header');
    header.checkSize(this.#input.size);
    check(header.count > 0, 'header', 'a sequence without Gaussians');
    const [timeline] = header.sections.filter(({ name }) => name === 'timeline');
    check(timeline, 'header', 'a sequence without timeline');
    const known = header.sections.filter(({ name }) => name && name !== 'timeline');
    const wrong = known.find(({ name }) => name !== 'key-frame' && name !== 'motion');
    check(!wrong, 'header', `section ${wrong?.name} in a sequence`);
    this.#frames = known;
    const end = timeline.at + paddedSize(timeline);
    this.#readTimeline(checked(timeline, await this.read(timeline.at, end)));
    const isInOrder = known.every(({ block }, k) => block === k) && known.length === this.count;
    check(isInOrder, 'header', `not one section of each of ${counted(this.count, 'frame')}, ascending`);
    this.keys = known.filter(({ name }) => name === 'key-frame').map(({ block }) => block);
    check(this.keys[0] === 0, 'header', 'the first frame is not a key frame');
    for (const name of ['degree', 'profile', 'coordinates', 'antialiased', 'bytes']) {
      this[name] = header[name];
    }
    this.size = header.end;
    this.#ending.signal.throwIfAborted();
    this.#pool = createPool([], header.blocks, this.#options);
    return this;
  }

  #readTimeline(content) {
    const reader = new Reader(content, 'timeline');
    const [count, above, below] = [reader.u32(), reader.u32(), reader.u32()];
    const isRight = count >= 1 && count <= 2 ** 24 && above > 0 && below > 0;
    check(isRight, 'timeline', `${counted(count, 'frame')}, ${above}/${below} a second`);
    const rest = reader.rest();
    this.count = count;
    this.fps = above / below;
    this.names = [];
    if (rest.length === 0) return;
    let text = '';
    try {
      text = new TextDecoder('utf-8', { fatal: true, ignoreBOM: true }).decode(rest.slice());
    } catch {
      check(false, 'timeline', 'names that are not UTF-8');
    }
    this.names = text.split('\n');
    const isPlain = rest.length <= 2 ** 26 && !/[^\n\P{Cc}]/u.test(text);
    check(isPlain && this.names.length === count, 'timeline', 'names of frames');
  }

  /** The number of the group of a frame. */
  groupOf(frame) {
    if (!(Number.isInteger(frame) && frame >= 0 && frame < this.count)) {
      throw new RangeError(`frame ${frame}, expected 0 to ${this.count - 1}`);
    }
    return this.keys.findLastIndex((key) => key <= frame);
  }

  /** First frame of a group; of their number, the end. */
  #begin(group) {
    return this.keys[group] ?? this.count;
  }

  /** Fetch the bytes of a group that will be opened next. */
  fetch(group) {
    const first = this.#frames[this.#begin(group)];
    const last = this.#frames[this.#begin(group + 1) - 1];
    const size = last.at + paddedSize(last) - first.at;
    const { coming } = this.#coming.get(group) ?? { coming: this.read(first.at, first.at + size) };
    this.#coming.delete(group);
    this.#coming.set(group, { coming, size }); // as the latest
    const bytes = () => [...this.#coming.values()].reduce((sum, one) => sum + one.size, 0);
    while (this.#coming.size > 2 && bytes() > KEPT) {
      this.#coming.delete(this.#coming.keys().next().value);
    }
    coming.catch(() => this.#coming.delete(group)); // of interest when it is opened
    return coming;
  }

  /**
   * Decode the key frame of a group.
   *
   * @param {number} number
   * @returns {Promise<Group>}
   * @throws {EgsError} or a subclass; the signal's reason
   */
  async group(number) {
    this.#ending.signal.throwIfAborted();
    const [first, end] = [this.#begin(number), this.#begin(number + 1)];
    const ending = new Ending(this.#ending.signal);
    try {
      const data = await ending.before(this.fetch(number));
      const group = new Group(this.#frames.slice(first, end), data, this.#pool, this.#opened++);
      await within(first, () => group.begin(this.#header, this.#options.maxBytes));
      return group;
    } finally {
      ending.release();
    }
  }

  /**
   * Decode a frame: from the last one if that was in its group before it, otherwise from its key
   * frame.
   *
   * @param {number} number from 0
   * @returns {Promise<Scene>} changed by the next call
   * @throws {EgsError} or a subclass; the signal's reason; RangeError
   */
  frame(number) {
    const wanted = this.groupOf(number);
    const found = this.#last.then(() => this.#frame(number, wanted));
    this.#last = found.catch(() => {});
    return found;
  }

  async #frame(number, wanted) {
    let group = this.#current;
    this.#current = null; // if it cannot be decoded
    if (group?.first !== this.#begin(wanted) || group.frame > number) {
      group?.close();
      group = await this.group(wanted);
    }
    try {
      while (group.frame < number) group.scene.move(await group.next());
    } catch (error) {
      group.close();
      throw error;
    }
    return (this.#current = group).scene;
  }

  /** End everything in progress; later calls fail. */
  close(reason = new EgsError('closed')) {
    this.#ending.end(reason);
  }
}

/** A key frame and the frames after it: `first` to `end`. `frame` is the last that was decoded. */
class Group {
  #entries;
  #data;
  #pool;
  #id;
  #header;

  constructor(entries, data, pool, id) {
    this.#entries = entries;
    this.#data = data;
    this.#pool = pool;
    this.#id = id;
    this.first = this.frame = entries[0].block;
    this.end = this.first + entries.length;
  }

  /** Bytes from a section on. */
  #from({ at }) {
    return this.#data.subarray(at - this.#entries[0].at);
  }

  /** Decode the key frame. */
  async begin(file, maxBytes) {
    const { size } = this.#entries[0];
    const data = this.#data.subarray(0, size);
    const header = (this.#header = await readHeader(await openParts(data)));
    checkKeyFrame(header, this.first, file);
    header.checkSize(size);
    const opened = new Opened(header);
    const take = (entries, work) => takeRun({ begin: 0, entries }, data, work);
    take(opened.first, (entry, content) => opened.take(entry, content));
    opened.begin(header.degree);
    const limit = maxBytes ?? Math.max(2 ** 30, 1000 * size);
    checkFloats(header.count, header.degree, limit);
    const contexts = 4 * header.blocks * (10040 + 768 * header.coefficients);
    if (this.end - this.first > 1 && contexts > Math.max(limit, 2 ** 24)) {
      throw new TooLargeError(`${counted(header.blocks, 'block')}, too many for ${limit} bytes`);
    }
    this.scene = new Scene(header, header.count, header.degree);
    const blocks = Array.from({ length: header.blocks }, () => ({}));
    take(opened.rest, ({ name, block }, content) => {
      if (name === 'comments') this.scene.comments = readComments(content);
      else if (name) blocks[block][name] = content.slice(); // its memory moves to a worker
    });
    await Promise.all(blocks.map((sections, block) => this.#decode(opened, block, sections)));
  }

  async #decode({ setup, boxes }, block, sections) {
    const { degree, hasBasis, blockSize } = this.#header;
    const count = this.#header.blockCount(block);
    const job = { file: this.#id, setup, block, count, degree, sections, moves: true };
    const parts = await this.#pool.decode(job);
    checkBox(boxes[block].centres, parts[0], count, block);
    const degrees = partDegrees(degree, hasBasis);
    parts.forEach((planes, part) =>
      this.scene.put(degrees[part - 1] ?? -1, degrees[part], planes, block * blockSize, count),
    );
  }

  /**
   * Decode the next frame.
   *
   * @returns {Promise<object>} its changes, for `scene.move`: `blocks` of `{first, parts}`
   */
  next() {
    const entry = this.#entries[++this.frame - this.first];
    return within(this.frame, async () => {
      const { blocks: count, blockSize } = this.#header;
      const reader = new Reader(checked(entry, this.#from(entry)), 'motion');
      const sizes = Array.from({ length: count }, () => reader.u32());
      const motions = sizes.map((size) => reader.take(size).slice());
      reader.finish();
      const decoded = motions.map(async (motion, block) => {
        const parts = await this.#pool.decode({ file: this.#id, block, sections: { motion } });
        return { first: block * blockSize, parts };
      });
      return { blocks: await Promise.all(decoded) };
    });
  }

  /** Free its memory. */
  close() {
    this.#pool.release(this.#id);
  }
}
