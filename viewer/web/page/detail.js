// Levels of detail of a scene: blocks to fetch, to keep on the graphics card, and to draw.
// A block is kept only as long as the coarser block that replaces it. So if finer blocks in view
// are missing, there is always a coarser one to draw.
import { CorruptError, SourceError } from '../src/index.js';
import { childrenOf, inView, look, refine } from '../src/selection.js';
import { ROW } from './limits.js';
import { Splats } from './renderer.js';

/** Maximum error in pixels of a block drawn in place of finer ones. */
const TOLERANCE = 1;

/** Number of concurrent requests, each for the blocks that one coarser block replaces. */
const REQUESTS = 4;

/** Maximum number of decoded blocks waiting for a slot. */
const MOST_WAITING = 16;

/** Milliseconds until blocks lost by a connection are requested again, for successive attempts. */
export const AGAIN = [1000, 3000];

/** Upper bound of the number of levels of a file. */
const LEVELS = 64;

const keyOf = ({ level, block }) => block * LEVELS + level;
const parentOf = ({ level, block }) => ({ level: level + 1, block: block >> 2 });

export class Detail {
  #resident = new Map(); // blocks with a slot, by key: {level, block, place, used}
  #waiting = new Map(); // decoded blocks without a slot, by key: {level, block, scene, first}
  #requests = new Set(); // {blocks, controller}
  #failed = new Map(); // blocks that failed, by key: {times, again, error}; retried at time `again`
  #free; // slots
  #leaving = []; // slots to free once no order uses them
  #wanted = []; // blocks in fetching order; the first `needed` are for this view
  #wantedKeys = new Map(); // and their positions in it
  #refined = new Set(); // keys of blocks to be replaced by finer ones
  #seen = null;
  #shown = new Set(); // slots in the order being drawn
  #asked = new Set(); // slots in the order being made
  #aim = '';
  #moment = 0;
  #top; // decoded, because it is always needed; without `scene` if damaged

  /**
   * @param {EgsFile} file with levels
   * @param {WebGL2RenderingContext} gl
   * @param {object} tell `changed()` if the blocks to draw change, `progress()`, `put(first,
   *   positions)` with x, y, z of new Gaussians, `sized(count, moves, size)` if the capacity
   *   becomes `count`; each of `moves` moved `size` Gaussians
   */
  constructor(file, gl, tell) {
    Object.assign(this, { file, gl, tell });
    this.needed = 0;
    this.drawn = 0; // Gaussians
    this.isStopped = false;
    this.isPictured = false; // whether its first picture has been drawn
    this.rows = Math.ceil(file.levels[0].blockSize / ROW); // texture rows of a slot
    this.top = file.levels.length - 1;
  }

  /** Fetch everything that is needed for the first picture. */
  async begin(budget) {
    try {
      const { scene, parts } = await this.#decode(this.top, [0]);
      this.#top = { ...parts[0], scene };
    } catch (error) {
      if (!(error instanceof CorruptError) || this.top === 0) throw error;
      this.#top = { level: this.top, block: 0 };
      this.#failed.set(keyOf(this.#top), { times: 1, again: Infinity, error });
      this.isPictured = true; // as far as possible
    }
    this.resize(budget);
  }

  async #decode(level, blocks, signal) {
    const parts = [];
    const onBlock = (_, part) => parts.push(part);
    return { scene: await this.file.decode(level, blocks, { onBlock, signal }), parts };
  }

  /**
   * Hold at most `budget` Gaussians, but at least the coarsest level; blocks with a slot keep one.
   */
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

  /** Assign new slots, most recently used blocks first; returns the moves. */
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

  /** Fetch and select what a view needs; see `EgsFile.select`. */
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
    // Failed blocks are drawn as the coarser block that replaces them.
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
    // Prefetch the finest neighbours just out of view; otherwise a turn would show coarser blocks.
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
    this.tell.changed(); // because the blocks to draw change
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

  /** Discard decoded blocks that are no longer wanted. */
  #drop() {
    for (const key of this.#waiting.keys()) {
      if (!this.#wantedKeys.has(key)) this.#waiting.delete(key);
    }
  }

  /** Blocks of this view that are missing, including those to be requested again. */
  get missing() {
    const now = performance.now();
    const again = [...this.#failed.values()].filter(
      (one) => one.again > now && one.again < Infinity,
    );
    const isThere = (block) => this.#resident.has(keyOf(block));
    const wanted = this.#wanted.slice(0, this.needed);
    return wanted.reduce((sum, block) => sum + !isThere(block), again.length);
  }

  /** Errors of blocks that are given up. */
  get errors() {
    const given = [...this.#failed.values()].filter(({ again }) => again === Infinity);
    return given.map(({ error }) => error);
  }

  /** The error of blocks lost by a connection and to be requested again, if any. */
  get lost() {
    const now = performance.now();
    const isAwaited = ([key, { again }]) =>
      again < Infinity && (again > now || this.#wantedKeys.has(key));
    return [...this.#failed].find(isAwaited)?.[1].error;
  }

  /** Retry blocks lost by connections. */
  retry() {
    for (const [key, { error }] of this.#failed) {
      if (error instanceof SourceError) this.#failed.delete(key);
    }
    this.#aim = '';
  }

  /** Whether the view is complete, or nothing more will arrive. */
  get isComplete() {
    return this.isStopped || (this.splats !== undefined && this.missing === 0);
  }

  /** Request missing blocks: coarsest first, then largest error first. */
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

  /** Record that blocks failed. */
  #lose(blocks, error) {
    const times = this.#failed.get(keyOf(blocks[0]))?.times ?? 0;
    const wait = error instanceof SourceError ? AGAIN[times] : undefined;
    const again = performance.now() + (wait ?? Infinity);
    for (const block of blocks) this.#failed.set(keyOf(block), { times: times + 1, again, error });
    // Other blocks may be needed first now; then these.
    const aimAgain = () => {
      this.#aim = '';
      this.tell.progress();
    };
    aimAgain();
    if (wait !== undefined) setTimeout(aimAgain, wait + 1);
  }

  /** Stop fetching. */
  stop() {
    this.isStopped = true;
    for (const { controller } of this.#requests) controller.abort();
    this.tell.progress();
  }

  /** Give decoded blocks slots, in fetching order. */
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

  /** Free the slot of an unwanted block; undefined if there is none, or not yet. */
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

  /** Ranges `[first, end]` of the Gaussians to draw, for a new order. */
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

  /** Record that a picture has been drawn; the first has priority over further fetching. */
  pictured() {
    if (this.isPictured || this.#shown.size === 0) return;
    this.isPictured = true;
    this.#fetch();
  }

  /** Record that the order of the last `ranges` is ready. */
  ordered() {
    this.#shown = this.#asked;
    const isIn = (place) => this.#shown.has(place);
    this.#free.push(...this.#leaving.filter((place) => !isIn(place)));
    this.#leaving = this.#leaving.filter(isIn);
    this.#place();
    this.#fetch();
  }
}
