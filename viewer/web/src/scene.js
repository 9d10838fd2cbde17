// A decoded scene.
import { TooLargeError } from './errors.js';
import { counted } from './wording.js';

/** Planes of the arrays of a scene, in the order of a block's first part. */
const ARRAYS = [
  ['positions', 3],
  ['fDc', 3],
  ['opacity', 1],
  ['logScale', 3],
  ['rotation', 4],
];

/** Arrays of each part that frames of a sequence change. */
const PARTS = [['opacity', 'logScale'], ['rotation'], ['positions'], ['fDc'], ['fRest']];

/** Bytes of the floats of `count` Gaussians, up to an SH degree. */
export const floatBytes = (count, degree) => 4 * count * (14 + 3 * ((degree + 1) ** 2 - 1));

/** Reject `count` Gaussians, up to an SH degree, if their floats take more than `maxBytes`. */
export function checkFloats(count, degree, maxBytes) {
  const floats = floatBytes(count, degree);
  if (floats > maxBytes) throw new TooLargeError(`${counted(floats, 'byte')} of floats, at most ${maxBytes}`);
}

/**
 * Gaussians as in the INRIA trainer's PLY, but planar: the values of a property are consecutive.
 *
 * `positions`: x, y, z; `fDc`: R, G, B; `fRest`: all SH-AC of R, then of G, then of B; `opacity`:
 * logits; `logScale`: natural logarithms; `rotation`: w, x, y, z, of length 1 (paper-*: any
 * length). `coordinates` gives the directions of x, y, z (three letters of RLUDBF), or is null.
 * `bytes` is the size of each stream of the file, by name.
 */
export class Scene {
  constructor(header, count, degree) {
    this.count = count;
    this.degree = degree;
    this.coefficients = (degree + 1) ** 2 - 1;
    for (const name of ['profile', 'coordinates', 'antialiased', 'bytes'])
      this[name] = header[name];
    this.comments = [];
    for (const [name, planes] of ARRAYS) this[name] = allocated(planes * count);
    this.fRest = allocated(3 * this.coefficients * count);
  }

  /** Names of the properties, as in a PLY file. */
  get properties() {
    const numbered = (name, count) => Array.from({ length: count }, (_, k) => `${name}_${k}`);
    return [
      'x',
      'y',
      'z',
      ...numbered('f_dc', 3),
      ...numbered('f_rest', 3 * this.coefficients),
      'opacity',
      ...numbered('scale', 3),
      ...numbered('rot', 4),
    ];
  }

  /** The plane of a property, sharing memory with the scene. */
  property(name) {
    const [, kind, number] = /^(.*?)(?:_(\d+))?$/.exec(name);
    const arrays = {
      f_dc: this.fDc,
      f_rest: this.fRest,
      scale: this.logScale,
      rot: this.rotation,
      opacity: this.opacity,
      x: this.positions,
      y: this.positions,
      z: this.positions,
    };
    if (!this.properties.includes(name)) throw new RangeError(`no property ${name}`);
    const plane = 'xyz'.includes(kind) ? 'xyz'.indexOf(kind) : Number(number ?? 0);
    return arrays[kind].subarray(plane * this.count, (plane + 1) * this.count);
  }

  /**
   * Copy a part of a block into the scene, starting at Gaussian `first`: everything but SH-AC if
   * `degree` is 0, otherwise SH of the degrees above `below`, up to `degree`.
   */
  put(below, degree, planes, first, count) {
    const copy = (array, plane, from) => {
      const values = planes.subarray(from * count, (from + 1) * count);
      array.set(values, plane * this.count + first);
    };
    let from = 0;
    if (degree === 0) {
      for (const [name, size] of ARRAYS) {
        for (let plane = 0; plane < size; plane++) copy(this[name], plane, from++);
      }
      return;
    }
    const [begin, end] = [(below + 1) ** 2 - 1, (degree + 1) ** 2 - 1];
    for (let colour = 0; colour < 3; colour++) {
      for (let i = begin; i < end; i++) copy(this.fRest, colour * this.coefficients + i, from++);
    }
  }

  /** Apply the changes of the next frame of a sequence. */
  move({ blocks }) {
    for (const { first, parts } of blocks) {
      PARTS.forEach((names, part) => {
        const [members, values] = [parts[2 * part], parts[2 * part + 1]];
        let at = 0;
        for (const array of names.map((name) => this[name])) {
          for (let from = first; from < array.length; from += this.count) {
            for (let k = 0; k < members.length; k++) array[from + members[k]] = values[at++];
          }
        }
      });
    }
  }
}

function allocated(size) {
  try {
    return new Float32Array(size);
  } catch {
    throw new TooLargeError(`not enough memory for ${counted(4 * size, 'byte')}`);
  }
}
