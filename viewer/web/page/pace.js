// How fine pictures are: drafts while the camera moves on slow devices, in full when it rests.

/** Milliseconds without a move after which the camera rests. */
export const REST = 250;

/** Milliseconds that a picture may take during a move: from slower devices, drafts are taken. */
const BUDGET = 50;

/** By how much a draft's sides are divided at most. */
const COARSEST = 4;

/** So many full pictures in a row are slow before drafts are drawn: a busy moment is no reason. */
const LAST = 2;

export class Pace {
  #movedAt = -Infinity;
  #times = [];

  /** The camera moves. */
  move() {
    this.#movedAt = performance.now();
  }

  /** A full picture took so many milliseconds. */
  took(time) {
    this.#times = [...this.#times, time].slice(-LAST);
  }

  /** Whether the camera has not moved for a while. */
  get isResting() {
    return performance.now() - this.#movedAt >= REST;
  }

  /** By what to divide the sides of the next picture. */
  get shrink() {
    if (this.isResting || this.#times.length < LAST) return 1;
    const time = Math.min(...this.#times);
    return Math.min(Math.max(Math.ceil(Math.sqrt(time / BUDGET)), 1), COARSEST);
  }
}
