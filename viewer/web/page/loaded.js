// A scene of the page: it is decoded, put on the graphics card and kept in order.
import sorterText from 'text:./sorter.js';
import workerText from 'text:../src/worker.js';

import { SourceError, decode, open } from '../src/index.js';
import { AGAIN, Detail } from './detail.js';
import { axesOf } from './pose.js';
import { Splats } from './renderer.js';

/**
 * How old an order may be that a picture is drawn in while a newer one is made, and how long it waits
 * for that, milliseconds.
 */
const [RECENT, PATIENCE] = [100, 60];

/** Errors of a scene that are told. */
const MOST_TOLD = 4;

/** A worker from its bundled text: pages on disk may not load one from a file. */
function worker(text) {
  const url = URL.createObjectURL(new Blob([text], { type: 'text/javascript' }));
  try {
    return new Worker(url);
  } finally {
    URL.revokeObjectURL(url);
  }
}

/** What a page holds in itself: a file as base64. */
function inPage(id) {
  const element = document.getElementById(id);
  const text = element.textContent;
  element.remove();
  if (Uint8Array.fromBase64) return Uint8Array.fromBase64(text);
  return Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
}

export class Loaded {
  /**
   * @param {{name: string, url?: string, data?: string}} entry what the page says of the scene:
   *   where it is, or the element that holds it; `levels`, if it has levels of detail
   * @param {(scene: Loaded) => void} changed called when more can be drawn, or something is lost
   */
  constructor(entry, changed) {
    this.entry = entry;
    this.changed = changed;
    this.isLoaded = false; // of a scene with levels, as far as all views need it
    this.failures = []; // of the last try to load it
    this.trouble = null; // a failure after which it is tried again
    this.splats = null; // until the first block is there
    this.detail = null; // of a scene with levels
    this.share = 0; // of the file that has been read
    this.sorter = worker(sorterText);
    this.sorted = null; // the last that was sorted for
    this.sorter.onmessage = ({ data }) => this.#take(data);
    this.busy = false;
    this.since = 0; // when the sorter was asked
    this.madeFor = 0; // when it was asked for the order that there is
  }

  /**
   * Decode, and draw blocks as they come; of a scene with levels, until the coarsest is there.
   *
   * @param {WebGL2RenderingContext} gl
   * @param {AbortSignal} signal
   * @param {() => number} budget most Gaussians of a scene with levels
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
        'a page opened from disk cannot read other files: use a web server, or share one .html file',
      );
    }
    const source = entry.url ?? (this.data ??= inPage(entry.data));
    if (entry.levels) {
      try {
        await this.#open(source, gl, signal, budget);
        return;
      } catch (error) {
        // Of a damaged level, the scene itself may be sound.
        if (!error.level || error instanceof SourceError || signal.aborted) throw error;
        this.failures.push(error);
      }
    }
    await this.#decode(source, gl, signal);
  }

  /** Why it is not all there, beside what is asked for again. */
  get errors() {
    const found = [...this.failures, ...(this.detail?.errors ?? [])];
    const more = found.splice(MOST_TOLD).length;
    return more ? [...found, new Error(`and ${more} more`)] : found;
  }

  /** An error in words. */
  told({ message }) {
    const { name, url } = this.entry;
    return `${name}: ${message.replace(`${url}: `, '')}`; // that it is of this file is said once
  }

  /** What was lost and is asked for again, if anything. */
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
    this.share = 1; // what comes later is of the views
  }

  async #decode(source, gl, signal) {
    let splats;
    const scene = await decode(source, {
      signal,
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
    splats ??= this.#begin(gl, scene); // of an empty scene no block comes
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
    this.splats?.dispose(); // of a try before
    this.splats = null;
    return (this.splats = new Splats(gl, scene));
  }

  #addToSorter({ count: all, positions }, first, count) {
    const block = new Float32Array(3 * count);
    for (let axis = 0; axis < 3; axis++) {
      const plane = axis * all + first;
      for (let i = 0; i < count; i++) block[3 * i + axis] = positions[plane + i];
    }
    this.sorter.postMessage({ first, block }, [block.buffer]);
    this.sorted = null;
  }

  /** See to the blocks that a view needs, in the world's axes: `lens` is in pixels of the picture. */
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

  /** Whether what the last view needs is there. */
  get isComplete() {
    return !this.detail || this.detail.isComplete;
  }

  /** Whether it is in the order of a pose, and nothing more is on its way. */
  isInOrder(pose) {
    return !this.splats || (this.sorted === pose && !this.busy);
  }

  /** Whether to draw it now: in a moment it may be in the right order. */
  get isNearlyInOrder() {
    const now = performance.now();
    return !this.busy || now - this.since > PATIENCE || now - this.madeFor < RECENT;
  }

  /** Bring it into the order of a pose, an object that is another whenever the camera moves. */
  sort(pose) {
    if (!this.splats || this.sorted === pose) return;
    if (this.busy) return;
    const { eye, turn } = pose.within(this.axes);
    this.busy = true;
    this.since = performance.now();
    this.sorted = pose;
    this.sorter.postMessage({ eye, forward: turn[2], ranges: this.detail?.ranges() });
  }

  #take({ order, size }) {
    this.busy = false;
    if (this.detail && size !== this.room) return this.changed(this); // of a budget before
    this.madeFor = this.since;
    this.splats.sort(order);
    this.detail?.ordered();
    this.changed(this);
  }
}
