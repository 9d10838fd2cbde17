// The camera's pose: `eye`, and `turn`, whose rows point right, down and forward in the world.

export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const plus = (a, b, times = 1) => a.map((value, k) => value + times * b[k]);
const times = (a, factor) => a.map((value) => value * factor);
const cross = (a, b) => [
  a[1] * b[2] - a[2] * b[1],
  a[2] * b[0] - a[0] * b[2],
  a[0] * b[1] - a[1] * b[0],
];
const unit = (a) => times(a, 1 / Math.hypot(...a));

/** A vector rotated about a unit axis. */
function turned(vector, axis, angle) {
  const [cos, sin] = [Math.cos(angle), Math.sin(angle)];
  const along = times(axis, dot(axis, vector) * (1 - cos));
  return plus(plus(along, vector, cos), cross(axis, vector), sin);
}

/** Minimum angle to straight up or down, as a sine. */
const STEEP = 0.02;

/** Sine of the angle to straight up or down below which a picture has no upper side. */
const LEVEL = 1e-6;

export class Pose {
  /**
   * @param {number[]} eye
   * @param {number[][]} turn
   * @param {number} distance to the point straight ahead that it orbits
   */
  constructor(eye, turn, distance) {
    this.eye = eye;
    this.turn = turn;
    this.distance = distance;
  }

  /** The pose of a camera from cameras.json; it orbits a point at the depth of `middle`. */
  static of({ position, rotation }, middle) {
    const turn = [0, 1, 2].map((axis) => rotation.map((row) => row[axis]));
    const away = plus(middle, position, -1);
    return new Pose(position, turn, Math.max(dot(away, turn[2]), 0.2 * Math.hypot(...away), 1e-3));
  }

  /** A pose from an eye, a target, and the direction that is up in the picture; else undefined. */
  static facing(eye, target, top) {
    const away = plus(target, eye, -1);
    const distance = Math.hypot(...away);
    const forward = unit(away);
    const right = cross(forward, top);
    if (!(distance > 0 && Math.hypot(...right) > LEVEL * Math.hypot(...top))) return undefined;
    const level = unit(right);
    return new Pose(eye, [level, cross(forward, level), forward], distance);
  }

  /** The pose of nine numbers: eye, target, and the direction that is up; else undefined. */
  static stated(numbers) {
    return Pose.facing(numbers.slice(0, 3), numbers.slice(3, 6), numbers.slice(6));
  }

  /** The pose at a share of the way to another: about the points that they orbit. */
  towards(other, share) {
    if (share >= 1) return other;
    const pairs = this.turn.map((row, k) => [row, other.turn[k]]);
    const axis = pairs.reduce((sum, pair) => plus(sum, cross(...pair)), [0, 0, 0]);
    const sine = Math.hypot(...axis) / 2;
    const angle = Math.atan2(sine, (pairs.reduce((sum, pair) => sum + dot(...pair), 0) - 1) / 2);
    const about = sine > LEVEL ? unit(axis) : this.turn[1];
    const turn = this.turn.map((row) => turned(row, about, share * angle));
    const distance = this.distance * (other.distance / this.distance) ** share;
    const target = plus(times(this.target, 1 - share), other.target, share);
    return new Pose(plus(target, turn[2], -distance), turn, distance);
  }

  copy() {
    return new Pose(this.eye, this.turn, this.distance);
  }

  get target() {
    return plus(this.eye, this.turn[2], this.distance);
  }

  /** The direction that is up in the picture. */
  get top() {
    return times(this.turn[1], -1);
  }

  /** Orbit the target by angles: sideways about `up`, and upwards. */
  orbit(aside, upwards, up) {
    const { target } = this;
    this.#turn(aside, upwards, up);
    this.eye = plus(target, this.turn[2], -this.distance);
  }

  #turn(aside, upwards, up) {
    const sideways = this.turn.map((row) => turned(row, up, aside));
    const tilted = sideways.map((row) => turned(row, sideways[0], upwards));
    const steep = (rows) => Math.hypot(...cross(rows[2], up));
    const kept = steep(tilted) > STEEP || steep(tilted) > steep(sideways) ? tilted : sideways;
    // Avoids accumulating rounding errors.
    const forward = unit(kept[2]);
    const right = unit(cross(kept[1], forward));
    this.turn = [right, cross(forward, right), forward];
  }

  /** Move along the camera's own axes, scene units. */
  move(right, down, forward) {
    const [x, y, z] = this.turn;
    this.eye = plus(plus(plus(this.eye, x, right), y, down), z, forward);
  }

  /** Move towards the target, or away from it. */
  zoom(factor) {
    const { target } = this;
    this.distance *= factor;
    this.eye = plus(target, this.turn[2], -this.distance);
  }

  /** Roll until `up` points up in the picture; no effect when looking straight up or down. */
  roll(up) {
    const [, , forward] = this.turn;
    const level = cross(forward, up);
    if (Math.hypot(...level) < LEVEL) return;
    const right = unit(level);
    this.turn = [right, cross(forward, right), forward];
  }

  /** The same pose in other axes: rows of `axes` are the world's axes, in those. */
  within(axes) {
    const given = (vector) =>
      [0, 1, 2].map((k) =>
        dot(
          axes.map((row) => row[k]),
          vector,
        ),
      );
    return { eye: given(this.eye), turn: this.turn.map(given) };
  }
}

/** The axes right, down, forward of the world in those of a file: three letters of RLUDBF. */
export function axesOf(coordinates) {
  return ['RL', 'DU', 'FB'].map((pair) =>
    [...(coordinates ?? 'RDF')].map((letter) => [1, -1, 0][(pair.indexOf(letter) + 3) % 3]),
  );
}
