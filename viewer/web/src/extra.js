// Section "extra" of FORMAT.md: checked, then ignored.
import { Reader } from './bytes.js';
import { TooLargeError, check } from './errors.js';
import { counted } from './wording.js';

const WHERE = 'extra';

/** Bytes of a value, by type. */
const SIZES = [1, 1, 2, 2, 4, 4, 4, 8];

const NAME = /^[!-~]{1,255}$/;
const LAYOUT = /^([xyz]|f_dc_[012]|f_rest_[0-9]+|opacity|scale_[012]|rot_[0123])$/;

/**
 * Check the properties of `count` Gaussians like Python's decoder, which keeps them.
 *
 * @param {Uint8Array} content
 * @param {number} most their maximum size in bytes
 */
export async function checkExtra(content, count, most) {
  const properties = propertiesOf(content);
  const sizes = properties.map(({ kind }) => count * SIZES[kind]);
  const total = sizes.reduce((sum, size) => sum + size, 0);
  if (total > most) throw new TooLargeError(`${counted(total, 'byte')} of properties, at most ${most}`, WHERE);
  for (const [k, { packed }] of properties.entries()) await checkValues(packed, sizes[k]);
}

function propertiesOf(content) {
  const reader = new Reader(content, WHERE);
  const number = reader.u16();
  check(number > 0, WHERE, 'no properties');
  const names = new Set();
  const properties = [];
  for (let k = 0; k < number; k++) {
    const name = String.fromCharCode(...reader.take(reader.u8()));
    const isRight = NAME.test(name) && !LAYOUT.test(name) && !names.has(name);
    check(isRight, WHERE, `the name of property ${k} is not valid, or occurs twice`);
    names.add(name);
    const kind = reader.u8();
    check(kind < SIZES.length, WHERE, `type ${kind}`);
    properties.push({ kind, packed: reader.take(reader.u64()) });
  }
  reader.finish();
  return properties;
}

/**
 * Check that a zlib stream has `size` bytes and ends with `packed`, if an inflater is available.
 */
async function checkValues(packed, size) {
  if (typeof DecompressionStream === 'undefined') return;
  check((await inflatedSize(packed, size)) === size, WHERE, `a property is not ${counted(size, 'byte')}`);
  // Some inflaters ignore bytes after the end.
  const shorter = await inflatedSize(packed.subarray(0, -1), size);
  check(shorter === undefined, WHERE, 'bytes after a property');
}

/** Size of an inflated zlib stream, up to a few more than `most`; undefined if it is damaged. */
async function inflatedSize(packed, most) {
  const inflater = new DecompressionStream('deflate');
  const reader = new Blob([packed]).stream().pipeThrough(inflater).getReader();
  let size = 0;
  try {
    for (let step; size <= most && !(step = await reader.read()).done;) size += step.value.length;
    return size;
  } catch {
    return undefined;
  } finally {
    reader.cancel().catch(() => {});
  }
}
