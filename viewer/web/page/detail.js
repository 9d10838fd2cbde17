// Levels of detail of a scene: which blocks are fetched, which are on the graphics card, and which are
// drawn.
//
// A block is kept only while that which stands for it is kept, too. So wherever finer blocks are not
// there, or not all of those in view, there is a coarser one to draw in their place.
import { SourceError } from '../src/index.js';
import { childrenOf, inView, look, refine } from '../src/selection.js';
import { ROW } from './limits.js';
import { Splats } from './renderer.js';

/** Error in pixels at which a block is drawn in place of finer ones. */
const TOLERANCE = 1;

/** Requests that wait for an answer at once, each for blocks that one coarser stands for. */
const REQUESTS = 4;

/** Decoded blocks that may wait for a place. */
const MOST_WAITING = 16;

/** Milliseconds after which blocks that a connection lost are asked for again, one time after another. */
const AGAIN = [1000, 2000, 4000];

/** Levels of a file are fewer. */
const LEVELS = 64;

const keyOf = ({ level, block }) => block * LEVELS + level;
const parentOf = ({ level, block }) => ({ level: level + 1, block: block >> 2 });

export class Detail {
  #resident = new Map(); // blocks with a place, by key: {level, block, place, used}
  #waiting = new Map(); // decoded blocks without one, by key: {level, block, scene, first}
  #requests = new Set(); // {blocks, controller}
  #failed = new Map(); // blocks that did not come, by key: how often, and when to ask again
  #free = []; // places
  #leaving = []; // places that are to be free, once they are in no order
  #wanted = []; // blocks, in the order in which they are fetched; the first `needed` for this view
  #wantedKeys = new Map(); // and their place in it
  #refined = new Set(); // keys of blocks in whose place finer ones are wanted
  #seen = null;
  #shown = new Set(); // places of the order that is drawn
  #asked = new Set(); // of that which is made
  #aim = '';
  #moment = 0;
  #top; // decoded, as it is always needed

  /**
   * @param {EgsFile} file with levels
   * @param {WebGL2RenderingContext} gl
   * @param {object} tell `changed()` if others are to be drawn, `progress()`, `put(first, positions)`
   *   of x, y, z of Gaussians that are new, `sized(count)` if there is room for so many,
   *   `failed(error)`
   */
  constructor(file, gl, tell) {
    Object.assign(this, { file, gl, tell });
    this.needed = 0;
    this.drawn = 0; // Gaussians
    this.isStopped = false;
    this.isPictured = false; // whether a first picture of it has been drawn
    this.rows = Math.ceil(file.levels[0].blockSize / ROW); // of a place
    this.top = file.levels.length - 1;
  }

  /** Fetch what everything is drawn by at first. */
  async begin(budget) {
    const blocks = [...Array(this.file.levels[this.top].blocks).keys()];
    const { scene, parts } = await this.#decode(this.top, blocks);
    this.#top = parts.map((part) => ({ ...part, scene }));
    this.resize(budget);
  }

  async #decode(level, blocks, signal) {
    const parts = [];
    const onBlock = (_, part) => parts.push(part);
    return { scene: await this.file.decode(level, blocks, { onBlock, signal }), parts };
  }

  /** Hold so many Gaussians at most, or those of the coarsest level. */
  resize(budget) {
    const { file, gl, rows, top } = this;
    const blocks = file.levels.reduce((sum, level) => sum + level.blocks, 0);
    const most = Math.floor(gl.getParameter(gl.MAX_TEXTURE_SIZE) / rows);
    const wanted = Math.max(Math.floor(budget / (rows * ROW)), file.levels[top].blocks);
    this.places = Math.min(wanted, blocks, most);
    for (const { controller } of this.#requests) controller.abort();
    for (const kept of [this.#resident, this.#waiting, this.#shown, this.#asked]) kept.clear();
    this.#leaving = [];
    this.#free = [...Array(this.places).keys()].reverse();
    this.splats?.dispose();
    this.splats = undefined; // if there is no memory
    this.tell.sized(0);
    const { degree, antialiased } = file;
    const count = this.places * rows * ROW;
    this.splats = new Splats(gl, { count, degree, antialiased });
    this.tell.sized(count);
    this.#aim = '';
    this.#want(this.#top, []);
    for (const part of this.#top) this.#waiting.set(keyOf(part), part);
    this.#place();
  }

  /** See to what a view needs; see `EgsFile.select`. */
  aim(view) {
    if (!this.splats || this.isStopped) return;
    const aim = JSON.stringify(view);
    if (aim !== this.#aim) {
      this.#aim = aim;
      this.#select(view);
    }
    this.#fetch();
  }

  #select(view) {
    const { file, top } = this;
    const seen = (this.#seen = look(file.described, view));
    // In place of blocks that cannot be had, that which stands for them stays.
    for (const [key, { again }] of this.#failed) {
      const { level, block } = parentOf({ level: key % LEVELS, block: Math.floor(key / LEVELS) });
      if (again > performance.now() && level <= top) seen[level].errors[block] = 0;
    }
    let places = file.levels[top].blocks;
    const fits = (_, children) => (places += children.length) <= this.places;
    const { refined } = refine(seen, inView(seen[top]), TOLERANCE, fits);
    const needed = refined.flatMap(({ children }) => children);
    // Neighbours just out of view, but of the finest level: a turn would show coarser blocks instead.
    const beside = refined.flatMap(({ parent: { level, block } }) =>
      level > 1 ? childrenOf(level, block, file.levels[level - 1].blocks) : [],
    );
    this.#refined = new Set(refined.map(({ parent }) => keyOf(parent)));
    this.#want([...this.#top, ...needed], beside);
    for (const request of this.#requests) {
      const isPast = !request.blocks.some((block) => this.#wantedKeys.has(keyOf(block)));
      if (isPast) request.controller.abort();
    }
    this.#drop();
    this.#place();
    this.tell.changed(); // as other blocks are drawn
  }

  #want(needed, beside) {
    const found = new Map();
    this.needed = needed.length;
    this.#moment++;
    for (const { level, block } of [...needed, ...beside]) {
      if (found.size === this.places) break;
      const key = keyOf({ level, block });
      if (!found.has(key)) found.set(key, { level, block });
      const resident = this.#resident.get(key);
      if (resident) resident.used = this.#moment;
    }
    this.#wantedKeys = found;
    this.#wanted = [...found.values()];
  }

  /** Forget decoded blocks that are not wanted any more. */
  #drop() {
    for (const key of this.#waiting.keys()) {
      if (!this.#wantedKeys.has(key)) this.#waiting.delete(key);
    }
  }

  /** Blocks of this view that are not there yet, and those that will be asked for again. */
  get missing() {
    const now = performance.now();
    const again = [...this.#failed.values()].filter(
      (one) => one.again > now && one.again < Infinity,
    );
    const isThere = (block) => this.#resident.has(keyOf(block));
    const wanted = this.#wanted.slice(0, this.needed);
    return wanted.reduce((sum, block) => sum + !isThere(block), again.length);
  }

  /** Whether all that this view needs is there, or nothing more comes. */
  get isComplete() {
    return this.isStopped || (this.splats !== undefined && this.missing === 0);
  }

  /** Ask for what is missing, the coarsest and the largest error first. */
  #fetch() {
    if (this.isStopped || !this.isPictured) return;
    const coming = new Set();
    for (const { blocks } of this.#requests) for (const one of blocks) coming.add(keyOf(one));
    const isMissing = (one) => {
      const key = keyOf(one);
      const again = this.#failed.get(key)?.again ?? 0;
      const isHere = this.#resident.has(key) || this.#waiting.has(key) || coming.has(key);
      return !isHere && again <= performance.now();
    };
    for (let k = 0; k < this.#wanted.length; k++) {
      if (this.#requests.size >= REQUESTS || this.#waiting.size >= MOST_WAITING) return;
      const first = this.#wanted[k];
      if (!isMissing(first)) continue;
      const above = keyOf(parentOf(first));
      const isBeside = (one) => keyOf(parentOf(one)) === above;
      const blocks = this.#wanted.filter((one) => isBeside(one) && isMissing(one));
      for (const one of blocks) coming.add(keyOf(one));
      this.#request(blocks);
    }
  }

  async #request(blocks) {
    const controller = new AbortController();
    const request = { blocks, controller };
    this.#requests.add(request);
    const { level } = blocks[0];
    try {
      const { signal } = controller;
      const numbers = blocks.map(({ block }) => block);
      const { scene, parts } = await this.#decode(level, numbers, signal);
      for (const part of signal.aborted ? [] : parts) {
        this.#failed.delete(keyOf(part));
        this.#waiting.set(keyOf(part), { ...part, scene });
      }
    } catch (error) {
      if (!controller.signal.aborted && !this.isStopped) this.#lose(blocks, error);
    } finally {
      this.#requests.delete(request);
    }
    this.#drop();
    this.#place();
    this.#fetch();
    this.tell.progress();
  }

  /** Take note that blocks did not come. */
  #lose(blocks, error) {
    const times = this.#failed.get(keyOf(blocks[0]))?.times ?? 0;
    const wait = error instanceof SourceError ? AGAIN[times] : undefined;
    const again = performance.now() + (wait ?? Infinity);
    for (const block of blocks) this.#failed.set(keyOf(block), { times: times + 1, again });
    // Then others are needed.
    const aimAgain = () => {
      this.#aim = '';
      this.tell.progress();
    };
    if (wait !== undefined) {
      setTimeout(aimAgain, wait + 1);
    } else {
      this.#aim = '';
      this.tell.failed(error);
    }
  }

  /** Fetch nothing more. */
  stop() {
    this.isStopped = true;
    for (const { controller } of this.#requests) controller.abort();
    this.tell.progress();
  }

  /** Give decoded blocks places, in the order in which they are wanted. */
  #place() {
    let isChanged = false;
    for (const one of this.#wanted) {
      const key = keyOf(one);
      const decoded = this.#waiting.get(key);
      if (!decoded) continue;
      const isTop = one.level === this.top;
      if (!isTop && !this.#resident.has(keyOf(parentOf(one)))) continue;
      const place = this.#free.pop() ?? this.#evict();
      if (place === undefined) break;
      this.#waiting.delete(key);
      this.#resident.set(key, { ...one, place, used: this.#moment });
      this.#load(decoded, place);
      isChanged = true;
    }
    if (isChanged) this.tell.changed();
  }

  #load({ scene, first, count }, place) {
    const { splats, rows } = this;
    const at = place * rows * ROW;
    splats.load(scene, first, at, count, 0);
    if (scene.degree > 0) splats.load(scene, first, at, count, scene.degree);
    const block = new Float32Array(3 * count);
    for (let axis = 0; axis < 3; axis++) {
      const plane = axis * scene.count + first;
      for (let i = 0; i < count; i++) block[3 * i + axis] = scene.positions[plane + i];
    }
    this.tell.put(at, block);
  }

  /** A place of a block that is not wanted; undefined if there is none, or not yet. */
  #evict() {
    if (this.#leaving.length >= this.#waiting.size) return undefined;
    const above = new Set([...this.#resident.values()].map((one) => keyOf(parentOf(one))));
    let last;
    for (const [key, one] of this.#resident) {
      if (this.#wantedKeys.has(key) || above.has(key)) continue;
      if (!last || one.used < last.used || (one.used === last.used && one.level < last.level)) {
        last = one;
      }
    }
    if (!last) return undefined;
    this.#resident.delete(keyOf(last));
    if (!this.#shown.has(last.place) && !this.#asked.has(last.place)) return last.place;
    this.#leaving.push(last.place);
    this.tell.changed();
    return this.#evict();
  }

  /** Blocks to draw: `[first, end]` of their Gaussians, for an order that will be made. */
  ranges() {
    const { file, rows, top } = this;
    const found = [];
    const places = new Set();
    this.drawn = 0;
    const draw = (one) => {
      const resident = this.#resident.get(keyOf(one));
      if (this.#refined.has(keyOf(one))) {
        const children = childrenOf(one.level, one.block, file.levels[one.level - 1].blocks);
        const isIn = ({ level, block }) => this.#seen[level].inView[block];
        const there = children.filter((child) => this.#resident.has(keyOf(child)));
        if (children.every((child) => !isIn(child) || there.includes(child))) {
          there.forEach(draw);
          return;
        }
      }
      const { count, blockSize } = file.levels[one.level];
      const first = resident.place * rows * ROW;
      const size = Math.min(blockSize, count - one.block * blockSize);
      places.add(resident.place);
      found.push([first, first + size]);
      this.drawn += size;
    };
    for (const one of this.#top) if (this.#resident.has(keyOf(one))) draw({ ...one, level: top });
    this.#asked = places;
    return found;
  }

  /** A picture has been drawn: the first comes before all else that is fetched. */
  pictured() {
    if (this.isPictured || this.#shown.size === 0) return;
    this.isPictured = true;
    this.#fetch();
  }

  /** The order of what `ranges` gave last is there. */
  ordered() {
    this.#shown = this.#asked;
    const isIn = (place) => this.#shown.has(place);
    this.#free.push(...this.#leaving.filter((place) => !isIn(place)));
    this.#leaving = this.#leaving.filter(isIn);
    this.#place();
    this.#fetch();
  }
}
