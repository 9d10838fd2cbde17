// Bytes and bits, never read past the end; checksums.
import { check } from './errors.js';
import { counted } from './wording.js';

/** Reads little-endian numbers. */
export class Reader {
  /**
   * @param {Uint8Array} data
   * @param {string} where description of the bytes, for messages
   */
  constructor(data, where) {
    this.data = data;
    this.where = where;
    this.at = 0;
    this.view = new DataView(data.buffer, data.byteOffset, data.byteLength);
  }

  /** The next `size` bytes, without a copy. */
  take(size) {
    check(size <= this.data.length - this.at, this.where, `truncated at byte ${this.at}`);
    this.at += size;
    return this.data.subarray(this.at - size, this.at);
  }

  u8() {
    return this.take(1)[0];
  }

  u16() {
    this.take(2);
    return this.view.getUint16(this.at - 2, true);
  }

  u32() {
    this.take(4);
    return this.view.getUint32(this.at - 4, true);
  }

  i32() {
    this.take(4);
    return this.view.getInt32(this.at - 4, true);
  }

  /** A u64, which is below 2^53 in valid files. */
  u64() {
    const low = this.u32();
    const high = this.u32();
    check(high < 2 ** 21, this.where, 'a number of 2^53 or more');
    return high * 2 ** 32 + low;
  }

  f32() {
    this.take(4);
    return this.view.getFloat32(this.at - 4, true);
  }

  /** All remaining bytes. */
  rest() {
    return this.take(this.data.length - this.at);
  }

  finish() {
    const left = this.data.length - this.at;
    check(left === 0, this.where, `${counted(left, 'byte')} after the end`);
  }
}

/** Reads raw bits, most significant bit of a byte first. */
export class RawBits {
  constructor(data, where) {
    this.data = data;
    this.where = where;
    this.at = 0; // in bits
  }

  /** The next 0 to 30 bits as a number. */
  take(count) {
    let value = 0;
    let left = count;
    while (left > 0) {
      const free = 8 - (this.at & 7);
      const size = Math.min(free, left);
      // Bytes past the end read as 0; `finish` detects reading too many.
      const byte = this.data[this.at >> 3] & (0xff >> (8 - free));
      value = (value << size) | (byte >> (free - size));
      this.at += size;
      left -= size;
    }
    return value;
  }

  finish() {
    const { at, data, where } = this;
    check(data.length === (at + 7) >> 3, where, `${counted(data.length, 'raw byte')} for ${counted(at, 'bit')}`);
    const padding = (at & 7) === 0 ? 0 : data[at >> 3] & (0xff >> (at & 7));
    check(padding === 0, where, 'padding is not 0');
  }
}

/** Tables of CRC-32C for eight bytes at once. */
const CRC = Array.from({ length: 8 }, () => new Int32Array(256));
for (let value = 0; value < 256; value++) {
  let crc = value;
  for (let bit = 0; bit < 8; bit++) crc = (crc >>> 1) ^ (crc & 1 ? 0x82f63b78 : 0);
  CRC[0][value] = crc;
}
for (let value = 0; value < 256; value++) {
  for (let k = 1; k < 8; k++) {
    const before = CRC[k - 1][value];
    CRC[k][value] = (before >>> 8) ^ CRC[0][before & 255];
  }
}

/** CRC-32C of bytes, as an unsigned number. */
export function crc32c(data) {
  const [a, b, c, d, e, f, g, h] = CRC;
  const whole = data.length - (data.length % 8);
  let crc = -1;
  let at = 0;
  for (; at < whole; at += 8) {
    crc ^= data[at] | (data[at + 1] << 8) | (data[at + 2] << 16) | (data[at + 3] << 24);
    crc =
      h[crc & 255] ^
      g[(crc >>> 8) & 255] ^
      f[(crc >>> 16) & 255] ^
      e[crc >>> 24] ^
      d[data[at + 4]] ^
      c[data[at + 5]] ^
      b[data[at + 6]] ^
      a[data[at + 7]];
  }
  for (; at < data.length; at++) crc = (crc >>> 8) ^ a[(crc ^ data[at]) & 255];
  return ~crc >>> 0;
}
