// Numbers as the format has them.

const LARGEST = (2 - 2 ** -23) * 2 ** 127;

export const clamp = (value, low, high) => Math.min(Math.max(value, low), high);

/** A number in the finite range of binary32. */
export const inRange = (value) => clamp(value, -LARGEST, LARGEST);

/** Bits that a number takes; of a number from 0 to below 2^32, rounded down. */
export const bitLength = (n) => 32 - Math.clz32(n);
