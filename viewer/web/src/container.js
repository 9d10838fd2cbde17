// Sections "File", "Section table entry" and "Index" of FORMAT.md.
import { Reader, crc32c } from './bytes.js';
import { TooLargeError, UnsupportedError, check } from './errors.js';
import { counted } from './wording.js';

const MAGIC = [0x89, 0x45, 0x47, 0x53, 0x0d, 0x0a, 0x1a, 0x0a];
const PROFILES = ['paper-l', 'paper-m', 'paper-s', 'l', 'm', 's', 'lossless'];
const COEFFICIENTS = [0, 3, 8, 15];

/** Names of sections by id. */
const NAMES = (
  ' channels geometry sh-dc states opacity scaling rotation sh1 sh2 sh3 comments extra lattice ' +
  'classes low-bits index gpcc tool coder level errors far basis timeline key-frame motion'
).split(' ');

/** Sections at the beginning of a file, in this order. */
export const FIRST = ['index', 'errors', 'channels', 'lattice', 'tool', 'coder', 'timeline'];

const OF_SCENE = [...FIRST, 'comments', 'extra'];

/** Sections of frames of a sequence, and the maximum number of frames. */
const OF_FRAMES = ['key-frame', 'motion'];
const MOST_FRAMES = 2 ** 24;

/** Names of the bits of `features`. */
const FEATURES = ['G-PCC', 'torchac', 'far Gaussians', 'local SH basis', 'sequence'];

/** Features; files with one from `FAR` on are version 2. */
const FAR = 4;
const LOCAL_BASIS = 8;
const SEQUENCE = 16;
const KNOWN = 31;

/** Fan-out: one block, or Gaussian, replaces this many of the next finer level. */
export const FANOUT = 4;

/** Bytes needed to determine the size of the header. */
export const PREFIX = 16;

/** Size of the header, from the first `PREFIX` bytes of a file. */
export function headerSize(prefix) {
  const reader = new Reader(prefix, 'header');
  const magic = reader.take(8);
  check(
    MAGIC.every((byte, k) => magic[k] === byte),
    'header',
    'not an .egs file',
  );
  const version = reader.u16();
  if (version !== 1 && version !== 2) {
    throw new UnsupportedError(`version ${version} of the format`, 'header');
  }
  reader.u16();
  const size = reader.u32();
  check(size >= 48 && (size - 48) % 20 === 0, 'header', counted(size, 'byte'));
  return size;
}

/**
 * The header of a file.
 *
 * Attributes in addition to those of the format: `profile` is a name, `coordinates` three letters
 * or null, `coefficients` the number of SH-AC per colour, `blocks` the number of blocks, `hasFar`
 * whether some have far Gaussians, `hasBasis` whether some have SH-AC in a local basis,
 * `isSequence` whether it has frames instead of blocks,
 * `levelCounts` the numbers of Gaussians of level 1, 2, ... if the file has levels, `sections` a
 * list of `{name, block, at, size, checksum}` in the order of the file, `end` the size of the file,
 * `bytes` that of each stream, by name.
 */
export class Header {
  constructor(data) {
    const size = headerSize(data);
    check(data.length >= size, 'header', 'truncated');
    const reader = new Reader(data.subarray(0, size), 'header');
    reader.take(8);
    const version = reader.u16();
    this.minor = reader.u16();
    reader.take(4);
    this.count = reader.u64();
    this.features = reader.u32();
    const flags = (this.flags = reader.u16());
    this.coordinates = coordinatesOf(reader.u8());
    const profile = reader.u8();
    this.degree = reader.u8();
    const reserved = reader.take(3);
    this.blockSize = reader.u32();
    const sections = reader.u32();
    check(size === 48 + 20 * sections, 'header', `${counted(size, 'byte')} for ${counted(sections, 'section')}`);
    // The maximum size of a Set.
    if (sections >= 2 ** 24) throw new TooLargeError(counted(sections, 'section'));
    const table = new Reader(reader.take(20 * sections), 'section table');
    const checksum = crc32c(data.subarray(0, reader.at));
    check(reader.u32() === checksum, 'header', 'wrong checksum');
    if (this.features > KNOWN) {
      throw new UnsupportedError(`features ${namesOf(this.features & ~KNOWN)}`, 'header');
    }
    this.hasFar = (this.features & FAR) !== 0;
    this.hasBasis = (this.features & LOCAL_BASIS) !== 0;
    this.isSequence = (this.features & SEQUENCE) !== 0;
    const isRight = version === (this.features >= FAR ? 2 : 1);
    check(isRight, 'header', `version ${version} with features ${this.features}`);
    check(flags < 8, 'header', `flags ${flags}`);
    this.antialiased = (flags & 4) !== 0;
    check(profile < PROFILES.length, 'header', `profile ${profile}`);
    this.profile = PROFILES[profile];
    check(!(flags & 2) || this.profile === 'lossless', 'header', 'order of the input');
    const isPaper = profile <= 2;
    const isLattice = !isPaper && profile <= 5;
    const fitting = (isPaper ? FAR - 1 : 0) | (isLattice ? FAR | LOCAL_BASIS | SEQUENCE : 0);
    check((this.features & ~fitting) === 0, 'header', `features with profile ${profile}`);
    check(this.degree <= 3, 'header', `SH degree ${this.degree}`);
    check(!this.hasBasis || this.degree > 0, 'header', 'a local basis of SH degree 0');
    check(
      reserved.every((byte) => byte === 0),
      'header',
      'reserved bytes are not 0',
    );
    const fits = this.blockSize >= 1 && this.blockSize <= 65536;
    check(fits, 'header', `block size ${this.blockSize}`);
    this.coefficients = COEFFICIENTS[this.degree];
    this.blocks = Math.ceil(this.count / this.blockSize);
    this.levelCounts = [];
    for (let { count } = this; count > this.blockSize;) {
      this.levelCounts.push((count = Math.ceil(count / FANOUT)));
    }
    this.end = size;
    this.bytes = { header: size };
    this.sections = Array.from({ length: sections }, () => this.#entry(table));
    this.#checkTable();
  }

  #entry(table) {
    const id = table.u16();
    const flags = table.u16();
    const block = table.u32();
    const size = table.u64();
    const checksum = table.u32();
    const name = NAMES[id] ?? '';
    const where = `section ${name || id} of block ${block}`;
    check(flags < 2, where, `flags ${flags}`);
    if (!name && flags !== 1) throw new UnsupportedError('unknown, and not optional', where);
    const at = this.end;
    this.end += paddedSize({ size });
    this.bytes[name] = (this.bytes[name] ?? 0) + this.end - at;
    check(Number.isSafeInteger(this.end), where, 'size');
    const levels = this.levelCounts.length;
    const isThere =
      name === 'level'
        ? block >= 1 && block <= levels
        : block < (OF_FRAMES.includes(name) ? MOST_FRAMES : OF_SCENE.includes(name) ? 1 : this.blocks);
    check(!name || isThere, where, 'there is no such block');
    return { id, name, block, at, size, checksum };
  }

  #checkTable() {
    const seen = new Set(this.sections.map(({ id, block }) => `${id} ${block}`));
    check(seen.size === this.sections.length, 'section table', 'a section occurs twice');
    const names = this.sections.map((entry) => entry.name);
    const first = FIRST.filter((name) => names.includes(name));
    check(
      first.every((name, k) => names[k] === name),
      'section table',
      'out of order',
    );
  }

  /** Number of Gaussians of a block. */
  blockCount(block) {
    return Math.min(this.blockSize, this.count - block * this.blockSize);
  }

  /**
   * Reject a file of another size.
   *
   * @param {number | undefined} size undefined if unknown
   */
  checkSize(size) {
    if (size === undefined) return;
    check(size >= this.end, 'file', `cut off before byte ${this.end}`);
    check(size === this.end, 'file', 'bytes after the last section');
  }

  /**
   * Check that exactly these sections are present, besides comments, extra and levels.
   *
   * @param {string[]} ofScene
   * @param {string[]} ofBlocks
   * @param {boolean} isLevel whether the file is a level, which has errors and no optional sections
   */
  checkPresence(ofScene, ofBlocks, isLevel) {
    const scene = [...ofScene];
    if (this.count > 0) scene.push('index');
    if (isLevel) scene.push('errors');
    // Some blocks may be without far Gaussians, or a basis.
    const free = ['', 'far', 'basis', ...(isLevel ? [] : ['comments', 'extra'])];
    const has = (wanted) => this.sections.some(({ name }) => name === wanted);
    check(has('far') === this.hasFar, 'header', 'far Gaussians, or their sections, are missing');
    check(has('basis') === this.hasBasis, 'header', 'bases, or their sections, are missing');
    const counts = new Map();
    for (const { name } of this.sections) {
      if (!free.includes(name)) counts.set(name, (counts.get(name) ?? 0) + 1);
    }
    const expected = new Map(scene.map((name) => [name, 1]));
    if (this.blocks > 0) for (const name of ofBlocks) expected.set(name, this.blocks);
    // All levels, or none.
    const mayHaveLevels = !isLevel && 'lms'.includes(this.profile);
    if (mayHaveLevels && counts.has('level')) expected.set('level', this.levelCounts.length);
    for (const name of new Set([...counts.keys(), ...expected.keys()])) {
      const [found, wanted] = [counts.get(name) ?? 0, expected.get(name) ?? 0];
      check(found === wanted, `section ${name}`, `${found} of them, expected ${wanted}`);
    }
  }
}

/** Names of the bits of features, or their numbers. */
function namesOf(features) {
  const bits = Array.from({ length: 32 }, (_, bit) => bit).filter((bit) => (features >>> bit) & 1);
  return bits.map((bit) => FEATURES[bit] ?? bit).join(' and ');
}

function coordinatesOf(number) {
  if (number === 0) return null;
  const axes = [Math.floor((number - 1) / 36), Math.floor((number - 1) / 6) % 6, (number - 1) % 6];
  const spans = new Set(axes.map((axis) => axis >> 1));
  check(axes[0] < 2 && spans.size === 3, 'header', `coordinates ${number}`);
  return axes.map((axis) => 'RLUDBF'[axis]).join('');
}

/** Size of a section including padding. */
export const paddedSize = (entry) => 4 * Math.ceil(entry.size / 4);

/** Bytes of a section, which the padding follows, after checks. */
export function checked(entry, bytes) {
  const where = `section ${entry.name} of block ${entry.block}`;
  const content = bytes.subarray(0, entry.size);
  check(content.length === entry.size, where, 'truncated');
  check(crc32c(content) === entry.checksum, where, 'wrong checksum');
  const padding = bytes.subarray(entry.size, paddedSize(entry));
  check(
    padding.every((byte) => byte === 0),
    where,
    'padding is not 0',
  );
  return content;
}

/**
 * Boxes of the blocks.
 *
 * @returns {{centres: number[][], reach: number[][]}[]} lowest and highest x, y, z of each block
 */
export function readIndex(content, blocks) {
  check(content.length === 48 * blocks, 'index', `${counted(content.length, 'byte')} for ${counted(blocks, 'block')}`);
  const reader = new Reader(content, 'index');
  const point = () => [reader.f32(), reader.f32(), reader.f32()];
  return Array.from({ length: blocks }, (_, block) => {
    const [low, high, lowest, highest] = [point(), point(), point(), point()];
    const finite = [...low, ...high, ...lowest, ...highest].every(Number.isFinite);
    const nested = low.every(
      (_, k) => lowest[k] <= low[k] && low[k] <= high[k] && high[k] <= highest[k],
    );
    check(finite && nested, 'index', `boxes of block ${block}`);
    return { centres: [low, high], reach: [lowest, highest] };
  });
}

/** Errors of the blocks of a level, scene units. */
export function readErrors(content, blocks) {
  check(content.length === 4 * blocks, 'errors', `${counted(content.length, 'byte')} for ${counted(blocks, 'block')}`);
  const reader = new Reader(content, 'errors');
  return Float64Array.from({ length: blocks }, (_, block) => {
    const error = reader.f32();
    check(Number.isFinite(error) && error >= 0, 'errors', `${error} of block ${block}`);
    return error;
  });
}

/** Check that no block has a lower error than the finer blocks it replaces. */
export function checkErrors(finer, coarser) {
  finer.forEach((error, block) => {
    const above = Math.floor(block / FANOUT);
    check(error <= coarser[above], 'errors', `block ${above} has a smaller error than a block that it replaces`);
  });
}

/** Check that a header belongs to a level of a file. */
export function checkLevel(header, level, file) {
  const same = ['coordinates', 'profile', 'degree', 'blockSize'];
  // A level may lack features.
  const isSame =
    same.every((name) => header[name] === file[name]) && (header.features & ~file.features) === 0;
  const isLevel = isSame && header.count === file.levelCounts[level - 1];
  check(
    isLevel && header.flags === (file.flags & ~1),
    'header',
    'not that of a level of this file',
  );
}

/** Check that a header belongs to key frame `frame` of a sequence. */
export function checkKeyFrame(header, frame, file) {
  const same = ['coordinates', 'profile', 'degree', 'flags'];
  if (frame === 0) same.push('count', 'blockSize');
  const isSame =
    same.every((name) => header[name] === file[name]) && (header.features & ~file.features) === 0;
  check(isSame && !header.isSequence, 'header', 'does not match the sequence');
  const others = header.sections.filter(({ name }) => name === 'level' || name === 'extra');
  check(others.length === 0, 'header', 'levels or extra properties in a sequence');
}

/** Check that the box of a block encloses exactly its centres, planes x, y, z of `count` values. */
export function checkBox([low, high], planes, count, block) {
  for (let axis = 0; axis < 3; axis++) {
    let [least, most] = [Infinity, -Infinity];
    for (let k = axis * count; k < (axis + 1) * count; k++) {
      if (planes[k] < least && planes[k] > -Infinity) least = planes[k];
      if (planes[k] > most && planes[k] < Infinity) most = planes[k];
    }
    if (least > most) [least, most] = [0, 0];
    // A zero is 0, not -0.
    const same = Object.is(low[axis], least + 0) && Object.is(high[axis], most + 0);
    check(same, 'index', `box of the centres of block ${block}`);
  }
}

/** Lines of the section `comments`. */
export function readComments(content) {
  check(content.length <= 2 ** 20, 'comments', 'above 2^20 bytes');
  const printable = content.every(
    (byte) => (byte >= 32 && byte <= 126) || byte === 9 || byte === 10,
  );
  check(printable, 'comments', 'other than printable ASCII and tabs');
  const lines = new TextDecoder().decode(content.slice()).split('\n'); // in case memory is shared
  for (const line of lines) check(!ofHeader(line), 'comments', `belongs in the header: ${line}`);
  return lines;
}

/** Whether a line states the coordinate system or antialiasing. */
function ofHeader(line) {
  // Spaces at the end are part of the patterns; searching for them would take quadratic time.
  const text = line.toUpperCase();
  const system = /^[ \t]*COORDINATESYSTEM:[ \t]*([RLUDBF]{3})[ \t]*$/.exec(text);
  if (system) {
    const axes = [...system[1]].map((letter) => 'RLUDBF'.indexOf(letter));
    return axes[0] < 2 && new Set(axes.map((axis) => axis >> 1)).size === 3;
  }
  return /^[ \t]*(SPLATRENDERMODE:[ \t]*|ANTIALIASED[ \t]+)[A-Z0-9_]+[ \t]*$/.test(text);
}

/** Reject files that this decoder does not support. */
export function checkSupport(header) {
  if (header.isSequence) throw new UnsupportedError('a sequence: open it with openSequence');
  if (header.profile === 'lossless') {
    throw new UnsupportedError(
      'profile lossless: this decoder has no pcodec; encode it with l, m or s',
    );
  }
  if (header.features % FAR > 0) {
    throw new UnsupportedError(
      `coded with ${namesOf(header.features % FAR)}, which this decoder does not support`,
    );
  }
}
