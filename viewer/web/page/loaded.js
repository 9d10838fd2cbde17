// A scene of the page: it is decoded, put on the graphics card and kept in order.
import sorterText from 'text:./sorter.js';
import workerText from 'text:../src/worker.js';

import { decode } from '../src/index.js';
import { axesOf } from './pose.js';
import { Splats } from './renderer.js';

/**
 * How old an order may be that a picture is drawn in while a newer one is made, and how long it waits
 * for that, milliseconds.
 */
const [RECENT, PATIENCE] = [100, 60];

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
   *   where it is, or the element that holds it
   * @param {(scene: Loaded) => void} changed called when more can be drawn
   */
  constructor(entry, changed) {
    this.entry = entry;
    this.changed = changed;
    this.splats = null; // until the first block is there
    this.share = 0; // of the file that has been read
    this.sorter = worker(sorterText);
    this.sorted = null; // the last that was sorted for
    this.sorter.onmessage = ({ data }) => this.#take(data.order);
    this.busy = false;
    this.since = 0; // when the sorter was asked
    this.madeFor = 0; // when it was asked for the order that there is
  }

  /**
   * Decode, and draw blocks as they come.
   *
   * @throws {Error} of the decoder
   */
  async load(gl, signal) {
    if (this.entry.url && location.protocol === 'file:') {
      throw new Error(
        'pages on disk cannot read files beside them: serve it, or share one .html file',
      );
    }
    const source = this.entry.url ?? inPage(this.entry.data);
    const scene = await decode(source, {
      signal,
      createWorker: () => worker(workerText),
      onProgress: (bytes, of) => {
        this.share = bytes / of;
        this.changed(this);
      },
      onBlock: (found, { first, count, degree }) => {
        this.splats ??= this.#begin(gl, found);
        this.splats.load(first, count, degree);
        if (degree === 0) this.#addToSorter(found, first, count);
        this.changed(this);
      },
    });
    this.splats ??= this.#begin(gl, scene); // of an empty scene no block comes
    this.splats.complete();
    this.changed(this);
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
    return new Splats(gl, scene);
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
    this.sorter.postMessage({ eye, forward: turn[2] });
  }

  #take(order) {
    this.busy = false;
    this.madeFor = this.since;
    this.splats.sort(order);
    this.changed(this);
  }
}
