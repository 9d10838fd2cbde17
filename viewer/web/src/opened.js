// A file whose header and first sections have been read, which describe its blocks.
import { partDegrees } from './basis.js';
import { commonOf } from './common.js';
import {
  FIRST,
  Header,
  PREFIX,
  checked,
  headerSize,
  paddedSize,
  readErrors,
  readIndex,
} from './container.js';
import { check } from './errors.js';

/** Sections needed for the first part of a block of profile l, m or s. */
const BASE = 'geometry sh-dc states opacity scaling rotation classes low-bits'.split(' ');

const BANDS = ['sh1', 'sh2', 'sh3'];

/** Read the header of a file from a source. */
export async function readHeader(input) {
  const prefix = await input.read(0, PREFIX);
  const rest = await input.read(PREFIX, headerSize(prefix));
  const data = new Uint8Array(PREFIX + rest.length);
  data.set(prefix);
  data.set(rest, PREFIX);
  return new Header(data);
}

/**
 * Group sections, in file order, into runs to read together: adjacent ones, up to `atOnce` bytes.
 *
 * @returns {{begin: number, end: number, entries: object[]}[]}
 */
export function runsOf(sections, atOnce) {
  const runs = [];
  for (const entry of sections) {
    const last = runs[runs.length - 1];
    if (last?.end === entry.at && last.end - last.begin < atOnce) last.entries.push(entry);
    else runs.push({ begin: entry.at, entries: [entry] });
    runs[runs.length - 1].end = entry.at + paddedSize(entry);
  }
  return runs;
}

/**
 * Pass the sections of a run to `take`, after checks. `lose` gets the error of a section; unless it
 * throws, the others still follow.
 */
export function takeRun({ begin, entries }, data, take, lose = raise) {
  for (const entry of entries) {
    let content;
    try {
      content = checked(entry, data.subarray(entry.at - begin));
    } catch (error) {
      lose(entry, error);
      continue;
    }
    take(entry, content);
  }
}

function raise(_, error) {
  throw error;
}

/**
 * The content of the first sections.
 *
 * Attributes: `header`; `boxes` of the blocks; `errors`, for a level.
 */
export class Opened {
  /**
   * @param {Header} header
   * @param {boolean} isLevel whether it belongs to a level
   */
  constructor(header, isLevel = false) {
    this.header = header;
    this.isLevel = isLevel;
    this.isPaper = header.profile.startsWith('paper');
    this.commonName = this.isPaper ? 'channels' : 'lattice';
    const { sections } = header;
    const leading = sections.findIndex(({ name }) => !FIRST.includes(name));
    const split = leading < 0 ? sections.length : leading;
    /** Entries of the first sections, and of the others. */
    [this.first, this.rest] = [sections.slice(0, split), sections.slice(split)];
    this.boxes = [];
  }

  /** Take one of the first sections. */
  take({ name }, content) {
    const { blocks } = this.header;
    if (name === 'index') this.boxes = readIndex(content, blocks);
    if (name === 'errors') this.errors = readErrors(content, blocks);
    // A copy, because workers receive the whole buffer, which may be the entire file.
    if (name === this.commonName) this.common = content.slice();
  }

  /**
   * Determine, after the first sections, the sections of blocks; `wanted` is the SH degree to
   * decode.
   */
  begin(wanted) {
    const { header, commonName, isPaper } = this;
    const bands = BANDS.slice(0, header.degree);
    check(this.common !== undefined, `section ${commonName}`, 'missing');
    const { degree, hasBasis } = header;
    /** SH degrees that the parts of a block reach. */
    this.degrees = partDegrees(wanted, hasBasis);
    /** The setup of `Blocks`. */
    this.setup = { content: this.common, degree, degrees: this.degrees, hasBasis, isPaper };
    const common = commonOf(this.setup); // also checks it
    const names = isPaper ? common.sections : [...BASE, ...bands];
    header.checkPresence([commonName], names, this.isLevel);
    if (header.hasFar) common.checkFar();
    /** Blocks with sections that others may lack. */
    this.having = {};
    for (const name of ['far', 'basis']) {
      const found = header.sections.filter((entry) => entry.name === name);
      this.having[name] = new Set(found.map(({ block }) => block));
    }
    /** Names of the sections for parts of blocks, up to the wanted degree; see `namesOf`. */
    this.parts = [names.filter((each) => !BANDS.includes(each))];
    if (header.hasFar) this.parts[0].push('far');
    for (const reached of this.degrees.slice(1)) {
      const own = hasBasis ? ['basis', ...bands] : names.filter((each) => each === BANDS[reached - 1]);
      this.parts.push(own);
    }
  }

  /** Names of the sections for a part of a block. */
  namesOf(block, part) {
    return this.parts[part].filter((name) => this.having[name]?.has(block) ?? true);
  }
}
