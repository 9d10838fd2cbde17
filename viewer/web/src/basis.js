// Section "Local basis" of FORMAT.md.
import { RawBits } from './bytes.js';
import { check } from './errors.js';
import { counted } from './wording.js';

/** 1 in the units of a matrix. */
export const MATRIX_ONE = 64;

/** Factors of step sizes, in 1 / 4. */
const FACTORS = [4, 5, 6, 7, 8, 10, 12, 14, 16, 20, 24, 28, 32];

/** The first Gaussian of a run of a block; of the number of runs, the end of the block. */
export const runBegin = (run, runs, count) => Math.floor((run * count) / runs);

/**
 * What turns components into coefficients.
 *
 * @param {Uint8Array} content the section `basis` of a block
 * @param {number} size number of coefficients
 * @param {number} count number of Gaussians
 * @returns {Int32Array[]} of each run a matrix, row by row: a row a coefficient
 */
export function readBases(content, size, count) {
  const runs = content[0] ?? 0;
  check(runs >= 1 && runs <= count, 'basis', counted(runs, 'run'));
  const raw = new RawBits(content.subarray(1), 'basis');
  const bits = runs * size * (5 * size + 4);
  check(content.length === 1 + Math.ceil(bits / 8), 'basis', counted(content.length, 'byte'));
  const take = (length, width, most) =>
    Int32Array.from({ length }, () => {
      const value = raw.take(width);
      check(value <= most, 'basis', `${value} above ${most}`);
      return value;
    });
  const entries = take(runs * size * size, 5, 30);
  const numbers = take(runs * size, 4, FACTORS.length - 1);
  raw.finish();
  return Array.from({ length: runs }, (_, run) =>
    Int32Array.from({ length: size * size }, (_, at) => {
      const entry = entries[run * size * size + at] - 15;
      return entry * FACTORS[numbers[run * size + (at % size)]];
    }),
  );
}

/**
 * SH degrees that the parts of a block reach, up to the wanted one. In a local basis all SH-AC is
 * one part, as each coefficient needs all components.
 */
export function partDegrees(wanted, hasBasis) {
  return hasBasis ? [...new Set([0, wanted])] : [0, 1, 2, 3].slice(0, wanted + 1);
}
