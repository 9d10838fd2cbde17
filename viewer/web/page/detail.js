// Levels of detail of a scene: which blocks are fetched, which are on the graphics card, and which are
// drawn.
//
// A block is kept only while that which stands for it is kept, too. So wherever finer blocks are not
// there, or not all of those in view, there is a coarser one to draw in their place.
import { CorruptError, SourceError } from '../src/index.js';
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
export const AGAIN = [1000, 3000];

/** Levels of a file are fewer. */
const LEVELS = 64;

const keyOf = ({ level, block }) => block * LEVELS + level;
const parentOf = ({ level, block }) => ({ level: level + 1, block: block >> 2 });

export class Detail {
  #resident = new Map(); // blocks with a place, by key: {level, block, place, used}
  #waiting = new Map(); // decoded blocks without one, by key: {level, block, scene, first}
  #requests = new Set(); // {blocks, controller}
  #failed = new Map(); // blocks that did not come, by key: {times, again, error}, again at a time
  #free; // places
  #leaving = []; // places that are to be free, once they are in no order
  #wanted = []; // blocks, in the order in which they are fetched; the first `needed` for this view
  #wantedKeys = new Map(); // and their place in it
  #refined = new Set(); // keys of blocks in whose place finer ones are wanted
  #seen = null;
  #shown = new Set(); // places of the order that is drawn
  #asked = new Set(); // of that which is made
  #aim = '';
  #moment = 0;
  #top; // decoded, as it is always needed; without `scene` if it is damaged

  /**
   * @param {EgsFile} file with levels
   * @param {WebGL2RenderingContext} gl
   * @param {object} tell `changed()` if others are to be drawn, `progress()`, `put(first, positions)`
   *   of x, y, z of Gaussians that are new, `sized(count, moves, size)` if there is room for so many, of which `size` went from
   *   one place to another by each of `moves`
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
    try {
      const { scene, parts } = await this.#decode(this.top, [0]);
      this.#top = { ...parts[0], scene };
    } catch (error) {
      if (!(error instanceof CorruptError) || this.top === 0) throw error;
      this.#top = { level: this.top, block: 0 };
      this.#failed.set(keyOf(this.#top), { times: 1, again: Infinity, error });
      this.isPictured = true; // as far as it can be
    }
    this.resize(budget);
  }

  async #decode(level, blocks, signal) {
    const parts = [];
    const onBlock = (_, part) => parts.push(part);
    return { scene: await this.file.decode(level, blocks, { onBlock, signal }), parts };
  }

  /** Hold so many Gaussians at most, or those of the coarsest level; what has a place keeps one. */
  resize(budget) {
    const { file, gl, rows, splats: before } = this;
    const blocks = file.levels.reduce((sum, level) => sum + level.blocks, 0);
    const most = Math.floor(gl.getParameter(gl.MAX_TEXTURE_SIZE) / rows);
    const places = Math.min(Math.max(Math.floor(budget / (rows * ROW)), 1), blocks, most);
    if (before && places === this.places) return;
    const { degree, antialiased } = file;
    const count = places * rows * ROW;
    const splats = new Splats(gl, { count, degree, antialiased });
    this.splats = splats;
    this.places = places;
    const moves = this.#move().map((pair) => pair.map((place) => place * rows * ROW));
    if (before) splats.copy(before, moves, rows);
    before?.dispose();
    this.tell.sized(count, moves, rows * ROW);
    this.#aim = '';
    if (!before) {
      this.#want([this.#top], []);
      (this.#top.scene ? this.#waiting : this.#resident).set(keyOf(this.#top), this.#top);
    }
    this.#place();
  }

  /** Give blocks places among others than before, the last used first: where from and to. */
  #move() {
    const { places } = this;
    this.#shown.clear();
    this.#asked.clear();
    this.#leaving = [];
    const before = [...this.#resident.values()];
    before.sort((a, b) => b.used - a.used || b.level - a.level);
    const kept = before.slice(0, places);
    for (const one of before.slice(places)) this.#resident.delete(keyOf(one));
    const taken = new Set(kept.map(({ place }) => place));
    this.#free = [...Array(places).keys()].reverse().filter((place) => !taken.has(place));
    return kept
      .filter(({ place }) => place !== undefined)
      .map((one) => {
        const from = one.place;
        if (from >= places) one.place = this.#free.pop();
        return [from, one.place];
      });
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
    if (!this.#top.scene) seen[top].errors[0] = Infinity;
    let places = 1;
    const fits = (_, children) => (places += children.length) <= this.places;
    const { refined } = refine(seen, inView(seen[top]), TOLERANCE, fits);
    const isLost = (one) => this.#failed.get(keyOf(one))?.again > performance.now();
    const needed = refined.flatMap(({ children }) => children.filter((one) => !isLost(one)));
    // Neighbours just out of view, but of the finest level: a turn would show coarser blocks instead.
    const beside = refined.flatMap(({ parent: { level, block } }) =>
      level > 1 ? childrenOf(level, block, file.levels[level - 1].blocks) : [],
    );
    this.#refined = new Set(refined.map(({ parent }) => keyOf(parent)));
    this.#want([this.#top, ...needed], beside);
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

  /** Why blocks are given up. */
  get errors() {
    const given = [...this.#failed.values()].filter(({ again }) => again === Infinity);
    return given.map(({ error }) => error);
  }

  /** What a connection has lost that will be asked for again, if anything. */
  get lost() {
    const now = performance.now();
    const isAwaited = ([key, { again }]) =>
      again < Infinity && (again > now || this.#wantedKeys.has(key));
    return [...this.#failed].find(isAwaited)?.[1].error;
  }

  /** Ask once more for what connections have lost. */
  retry() {
    for (const [key, { error }] of this.#failed) {
      if (error instanceof SourceError) this.#failed.delete(key);
    }
    this.#aim = '';
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
    for (const block of blocks) this.#failed.set(keyOf(block), { times: times + 1, again, error });
    // Others are needed now, and then these.
    const aimAgain = () => {
      this.#aim = '';
      this.tell.progress();
    };
    aimAgain();
    if (wait !== undefined) setTimeout(aimAgain, wait + 1);
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
    const { file, rows } = this;
    const found = [];
    const places = new Set();
    this.drawn = 0;
    const draw = (one) => {
      const resident = this.#resident.get(keyOf(one));
      const isDamaged = resident.place === undefined;
      if (this.#refined.has(keyOf(one))) {
        const children = childrenOf(one.level, one.block, file.levels[one.level - 1].blocks);
        const isIn = ({ level, block }) => this.#seen[level].inView[block];
        const there = children.filter((child) => this.#resident.has(keyOf(child)));
        if (isDamaged || children.every((child) => !isIn(child) || there.includes(child))) {
          there.forEach(draw);
          return;
        }
      }
      if (isDamaged) return;
      const { count, blockSize } = file.levels[one.level];
      const first = resident.place * rows * ROW;
      const size = Math.min(blockSize, count - one.block * blockSize);
      places.add(resident.place);
      found.push([first, first + size]);
      this.drawn += size;
    };
    if (this.#resident.has(keyOf(this.#top))) draw(this.#top);
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
