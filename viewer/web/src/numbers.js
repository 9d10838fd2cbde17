// Conversions of numbers in the format.

const LARGEST = (2 - 2 ** -23) * 2 ** 127;

export const clamp = (value, low, high) => Math.min(Math.max(value, low), high);

/** A number clamped to the finite range of binary32. */
export const inRange = (value) => clamp(value, -LARGEST, LARGEST);

/** Bit length of a number; a number from 0 to below 2^32 is rounded down. */
export const bitLength = (n) => 32 - Math.clz32(n);
