// How fine pictures are: drafts while the camera moves on slow devices, full pictures at rest.

/** Milliseconds without motion after which the camera is at rest. */
export const REST = 250;

/** Maximum milliseconds for a picture during motion; slower devices draw drafts. */
const BUDGET = 33;

/** Maximum divisor of a draft's sides. */
const COARSEST = 4;

/**
 * Number of slow full pictures in a row before drafts are drawn; one may be due to a busy moment.
 */
const LAST = 2;

export class Pace {
  #movedAt = -Infinity;
  #times = [];

  /** Record that the camera moves. */
  move() {
    this.#movedAt = performance.now();
  }

  /** Record the milliseconds of a full picture. */
  took(time) {
    this.#times = [...this.#times, time].slice(-LAST);
  }

  /** Whether the camera is at rest. */
  get isResting() {
    return performance.now() - this.#movedAt >= REST;
  }

  /** Divisor of the next picture's sides. */
  get shrink() {
    if (this.isResting || this.#times.length < LAST) return 1;
    const time = Math.min(...this.#times);
    return Math.min(Math.max(Math.ceil(Math.sqrt(time / BUDGET)), 1), COARSEST);
  }
}
