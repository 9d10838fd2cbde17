// 16-bit numbers for the graphics card.
const float = new Float32Array(1);
const bits = new Uint32Array(float.buffer);

/** Bits of the half float nearest to a number; large numbers are clamped. */
export function half(value) {
  float[0] = value;
  const sign = (bits[0] >>> 16) & 0x8000;
  const magnitude = bits[0] & 0x7fffffff;
  if (magnitude >= 0x477ff000) return sign | 0x7bff;
  if (magnitude < 0x38800000) return sign | Math.round(Math.abs(value) * 2 ** 24); // subnormal
  return sign | ((magnitude - 0x38000000 + 0xfff + ((magnitude >>> 13) & 1)) >>> 13);
}

/** A number from -1 to 1, encoded for `unpackSnorm2x16` in shaders. */
export const fraction = (value) => Math.round(value * 32767) & 0xffff;

/** Pack two 16-bit numbers into one, the first in the lower half. */
export const pair = (low, high) => (low | (high << 16)) >>> 0;
