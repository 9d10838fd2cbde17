// A scene of the page: decoded, uploaded to the graphics card, and sorted.
import sorterText from 'text:./sorter.js';
import workerText from 'text:../src/worker.js';

import { SourceError, TooLargeError, decode, open, openSequence } from '../src/index.js';
import { AGAIN, Detail } from './detail.js';
import { ROW } from './limits.js';
import { Player } from './player.js';
import { axesOf } from './pose.js';
import { Splats } from './renderer.js';
import { say } from './strings.js';

/**
 * Maximum age of an order that may be drawn while a newer one is made, and maximum wait for that,
 * milliseconds.
 */
const [RECENT, PATIENCE] = [100, 60];

/** Gaussians of a key frame that are uploaded at once. */
const SLICE = 16 * ROW;

/** Maximum number of errors shown for a scene. */
const MOST_TOLD = 4;

/** A worker from its bundled text, because pages on disk may not load one from a file. */
function worker(text) {
  const url = URL.createObjectURL(new Blob([text], { type: 'text/javascript' }));
  try {
    return new Worker(url);
  } finally {
    URL.revokeObjectURL(url);
  }
}

/** A file embedded in the page as base64. */
function inPage(id) {
  const element = document.getElementById(id);
  const text = element.textContent;
  element.remove();
  if (Uint8Array.fromBase64) return Uint8Array.fromBase64(text);
  return Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
}

/** Pass runs of changed rows of a kind to `put`, as Gaussians, and forget them. */
function passRows({ changed, scene }, kind, put) {
  const rows = changed?.[kind] ?? [];
  for (let from = rows.indexOf(1), end; from >= 0; from = rows.indexOf(1, end)) {
    end = rows.indexOf(0, from);
    put(from * ROW, Math.min((end - from) * ROW, scene.count - from * ROW));
  }
  rows.fill(0);
}

export class Loaded {
  /**
   * @param {{name: string, url?: string, data?: string}} entry description of the scene: its URL,
   *   or the element that contains it; `levels`, if it has levels of detail; `frames`, their number,
   *   if it is a sequence
   * @param {(scene: Loaded) => void} changed called when more can be drawn, or something is lost
   * @param {number} [maxBytes] maximum bytes of its decoded floats, if it has no levels
   */
  constructor(entry, changed, maxBytes) {
    Object.assign(this, { entry, changed, maxBytes });
    this.isLoaded = false; // with levels: whether everything that all views need is loaded
    this.failures = []; // of the last attempt to load it
    this.trouble = null; // an error after which loading is retried
    this.splats = null; // null until the first block arrives
    this.detail = null; // of a scene with levels
    this.player = null; // of a sequence
    this.start = null; // the frame that it shows at first, else it plays
    this.incoming = null; // a key frame that is not sorted yet
    this.keys = this.key = 0; // number of the last key frame, and of the one that is drawn
    this.share = 0; // of the file, read so far
    this.sorter = worker(sorterText);
    this.sorted = null; // the last pose sorted for
    this.sorter.onmessage = ({ data }) => this.#take(data);
    this.sorter.onerror = ({ message }) => {
      this.busy = false;
      const isKnown = this.failures.some((one) => one.message === message);
      if (!isKnown) this.failures.push(new Error(message)); // probably of memory
      this.changed(this);
    };
    this.busy = false;
    this.since = 0; // time of the last request to the sorter
    this.madeFor = 0; // time of the request for the current order
  }

  /**
   * Decode the scene, and draw blocks as they arrive; with levels, until the coarsest level is
   * complete.
   *
   * @param {WebGL2RenderingContext} gl
   * @param {AbortSignal} signal
   * @param {() => number} budget maximum Gaussians of a scene with levels
   */
  async load(gl, signal, budget) {
    for (const wait of [...AGAIN, undefined]) {
      try {
        await this.#load(gl, signal, budget);
        this.isLoaded = true;
      } catch (error) {
        if (signal.aborted) break;
        if (error instanceof SourceError && wait !== undefined) {
          this.trouble = error;
          this.changed(this);
          await new Promise((resolve) => setTimeout(resolve, wait));
          if (!signal.aborted) continue;
        } else {
          this.failures.push(error);
        }
      }
      break;
    }
    this.trouble = null;
    this.changed(this);
  }

  async #load(gl, signal, budget) {
    const { entry } = this;
    this.failures = [];
    if (entry.url && location.protocol === 'file:') {
      throw new Error(
        say(
          'a page opened from disk cannot read other files: use a web server, or share one .html file',
        ),
      );
    }
    const source = entry.url ?? (this.data ??= inPage(entry.data));
    if (entry.frames) return this.#play(source, gl, signal);
    if (entry.levels) {
      try {
        await this.#open(source, gl, signal, budget);
        return;
      } catch (error) {
        // If a level is damaged, the scene itself may be intact.
        if (!error.level || error instanceof SourceError || signal.aborted) throw error;
        this.failures.push(error);
      }
    }
    for (let degree = 3; ; degree--) {
      try {
        return await this.#decode(source, gl, signal, degree);
      } catch (error) {
        if (!(error instanceof TooLargeError) || degree === 0) throw error;
        this.isReduced = true;
      }
    }
  }

  /** Errors that make the scene incomplete, except those that are retried. */
  get errors() {
    const found = [...this.failures, ...(this.detail?.errors ?? [])];
    const more = found.splice(MOST_TOLD).length;
    return more ? [...found, new Error(say('and {} more', more))] : found;
  }

  /** The message of an error. */
  told({ message }) {
    const { name, url } = this.entry;
    return `${name}: ${message.replace(`${url}: `, '')}`; // the file is named only once
  }

  /** The error of lost blocks that are requested again, if any. */
  get lost() {
    return this.trouble ?? this.detail?.lost;
  }

  async #open(source, gl, signal, budget) {
    const file = await open(source, { signal, createWorker: () => worker(workerText) });
    const [{ count }] = file.levels;
    const { degree, profile, bytes } = file;
    this.axes = axesOf(file.coordinates);
    const detail = new Detail(file, gl, {
      changed: () => {
        this.sorted = null;
        this.changed(this);
      },
      progress: () => this.changed(this),
      put: (first, block) => this.sorter.postMessage({ first, block }, [block.buffer]),
      sized: (room, moves, size) => {
        this.splats = detail.splats;
        this.room = 3 * room;
        this.sorter.postMessage({ count: room, moves, size });
      },
    });
    try {
      await detail.begin(budget());
    } catch (error) {
      file.close();
      throw error;
    }
    this.detail = detail;
    signal.addEventListener('abort', () => detail.stop());
    this.scene = { count, degree, profile, bytes };
    this.share = 1; // later progress depends on views
  }

  /** Play a sequence; until its first frame is there. */
  async #play(source, gl, signal) {
    const sequence = await openSequence(source, {
      signal,
      maxBytes: this.maxBytes,
      createWorker: () => worker(workerText),
    });
    this.axes = axesOf(sequence.coordinates);
    await new Promise((resolve, reject) => {
      const player = new Player(sequence, {
        prepare: (scene) => this.#upload(gl, scene),
        begin: (scene, splats) => this.#begins(scene, splats),
        move: (scene, changes) => this.#move(scene, changes),
        drop: (splats) => splats?.dispose(),
        stopped: (error) => {
          if (!signal.aborted) this.failures.push(error);
          this.changed(this);
          reject(error); // has no effect later
        },
        changed: () => {
          if (this.share < 1 && player.shown !== null) {
            const { degree, profile, bytes } = sequence;
            this.scene = { count: this.incoming.scene.count, degree, profile, bytes };
            this.share = 1;
            resolve();
          }
          this.changed(this);
        },
      });
      this.player = player;
      player.seek(this.start ?? 0);
      if (this.start === null && !matchMedia('(prefers-reduced-motion)').matches) player.play(true);
    }).catch(() => {
      this.failures.length || signal.throwIfAborted();
    });
  }

  /** Upload a key frame, a part at a time, because another may be shown. */
  async #upload(gl, scene) {
    const splats = new Splats(gl, scene);
    // Rows that are not uploaded: of shapes, of SH-AC; and of positions that are not sent to the sorter.
    splats.changed = [0, 1, 2].map(() => new Uint8Array(splats.rows + 1));
    for (let first = 0; first < scene.count; first += SLICE) {
      const count = Math.min(SLICE, scene.count - first);
      for (const degree of new Set([0, scene.degree])) splats.load(scene, first, first, count, degree);
      await new Promise((resolve) => setTimeout(resolve));
    }
    return splats;
  }

  /** Show a key frame as soon as it is sorted. */
  #begins(scene, splats) {
    this.incoming?.dispose();
    this.incoming = splats;
    this.keys++;
    this.sorter.postMessage({ count: scene.count });
    this.#addToSorter(scene, 0, scene.count);
  }

  /** Change the last key frame, and mark the rows that change. */
  #move(scene, { blocks }) {
    scene.move({ blocks });
    const { changed } = this.incoming ?? this.splats;
    for (const { first, parts } of blocks) {
      for (let part = 0; part < 5; part++) {
        const rows = part === 4 ? [changed[1]] : part === 2 ? [changed[0], changed[2]] : [changed[0]];
        for (const i of parts[2 * part]) for (const own of rows) own[Math.floor((first + i) / ROW)] = 1;
      }
    }
    this.sorted = null;
  }

  /** Upload the rows that have changed, because a picture follows. */
  flush() {
    const { splats } = this;
    if (!splats?.changed) return;
    const put = (degree) => (first, count) => splats.load(splats.scene, first, first, count, degree);
    passRows(splats, 0, put(0));
    passRows(splats, 1, put(splats.scene.degree));
  }

  async #decode(source, gl, signal, shDegree) {
    let splats;
    const scene = await decode(source, {
      signal,
      shDegree,
      maxBytes: this.maxBytes,
      extra: false, // not shown
      createWorker: () => worker(workerText),
      onDamage: (_, error) => this.failures.push(error),
      onProgress: (bytes, of) => {
        this.share = bytes / of;
        this.changed(this);
      },
      onBlock: (found, { first, count, degree }) => {
        splats ??= this.#begin(gl, found);
        splats.load(found, first, first, count, degree);
        if (degree === 0) this.#addToSorter(found, first, count);
        this.changed(this);
      },
    });
    splats ??= this.#begin(gl, scene); // an empty scene has no blocks
    splats.complete();
  }

  #begin(gl, scene) {
    this.axes = axesOf(scene.coordinates);
    this.sorter.postMessage({ count: scene.count });
    this.scene = {
      count: scene.count,
      degree: scene.degree,
      profile: scene.profile,
      bytes: scene.bytes,
    };
    this.splats?.dispose(); // of an earlier attempt
    this.splats = null;
    return (this.splats = new Splats(gl, scene));
  }

  #addToSorter({ count: all, positions }, first, count, again) {
    const block = new Float32Array(3 * count);
    for (let axis = 0; axis < 3; axis++) {
      const plane = axis * all + first;
      for (let i = 0; i < count; i++) block[3 * i + axis] = positions[plane + i];
    }
    this.sorter.postMessage({ first, block, again }, [block.buffer]);
    this.sorted = null;
  }

  /** Fetch the blocks that a view needs; the pose is in world axes, the lens in picture pixels. */
  aim(pose, { focal, centre, size }) {
    if (!this.detail) return;
    const { eye, turn } = pose.within(this.axes);
    this.detail.aim({
      width: size[0],
      height: size[1],
      fx: focal[0],
      fy: focal[1],
      cx: centre[0],
      cy: centre[1],
      rotation: turn,
      position: eye,
    });
  }

  /** Whether everything that the last view needs is loaded. */
  get isComplete() {
    return !this.detail || this.detail.isComplete;
  }

  /** Whether it is sorted for a pose, and no sorting is in progress. */
  isInOrder(pose) {
    return !(this.splats ?? this.incoming) || (this.sorted === pose && !this.busy);
  }

  /** Whether to draw now: otherwise it may soon be sorted correctly. */
  get isNearlyInOrder() {
    const now = performance.now();
    return !this.busy || now - this.since > PATIENCE || now - this.madeFor < RECENT;
  }

  /** Sort for a pose; a new object whenever the camera moves. */
  sort(pose) {
    if (!(this.splats ?? this.incoming) || this.sorted === pose) return;
    // On the way to another frame, the last one stays.
    if (this.busy || (this.incoming && this.player.isJumping)) return;
    const { eye, turn } = pose.within(this.axes);
    this.busy = true;
    this.since = performance.now();
    const ranges = this.detail?.ranges();
    const splats = this.incoming ?? this.splats;
    passRows(splats, 2, (first, count) => this.#addToSorter(splats.scene, first, count, true));
    this.sorted = pose;
    this.sorter.postMessage({ eye, forward: turn[2], ranges, shown: this.keys });
  }

  #take({ order, size, shown }) {
    this.busy = false;
    if (this.detail && size !== this.room) return this.changed(this); // of an earlier budget
    if (shown === this.keys && this.incoming) {
      this.splats?.dispose();
      [this.splats, this.incoming, this.key] = [this.incoming, null, shown];
    } else if (shown !== this.key) {
      return this.changed(this); // of a key frame that was never shown
    }
    this.madeFor = this.since;
    this.splats.sort(order);
    this.detail?.ordered();
    this.changed(this);
  }
}
