// Decoding of blocks, in this thread or in a worker.
import { partDegrees } from './basis.js';
import { LatticeBlock } from './block.js';
import { Lattice } from './lattice.js';
import { Channels, PaperBlock } from './paper.js';

/** Decodes parts of blocks, and keeps their state until the last part. */
export class Blocks {
  /**
   * @param {object} setup `{content, degree, degrees, hasBasis, isPaper}`: the section
   *   `lattice` or `channels`, the SH degree of the file, those that the parts of a block reach, and
   *   whether SH-AC is in a local basis
   */
  constructor({ content, degree, degrees, hasBasis, isPaper }) {
    this.common = isPaper ? new Channels(content, degree) : new Lattice(content, degree);
    this.Block = isPaper ? PaperBlock : LatticeBlock;
    this.degree = degree;
    this.degrees = degrees;
    this.hasBasis = hasBasis;
    if (hasBasis) this.common.checkBasis();
    this.open = new Map();
  }

  /** Names of the sections of each block, with profiles paper-*. */
  get sections() {
    return this.common.sections;
  }

  /**
   * Decode a part of a block: 0 is everything but SH-AC; the others are bands of SH-AC, in order, or
   * all bands together.
   *
   * @param {object} job `{block, count, part, sections}`
   * @returns {Float32Array} planes, as from `LatticeBlock`
   */
  decode({ block, count, part, sections }) {
    if (part === 0) this.open.set(block, new this.Block(this.common, count, this.degree));
    const found = this.open.get(block);
    if (part === this.degrees.length - 1) this.open.delete(block);
    if (part === 0) return found.base(sections);
    return this.#ac(found, this.degrees[part], sections);
  }

  /** SH-AC of a degree or, in a local basis, up to it. */
  #ac(found, degree, sections) {
    return this.hasBasis
      ? found.bands(degree, sections)
      : found.band(degree - 1, sections[`sh${degree}`]);
  }

  /**
   * Decode a whole block, up to an SH degree.
   *
   * @param {object} job `{count, degree, sections}`
   * @returns {Float32Array[]} planes of each part
   */
  whole({ count, degree, sections }) {
    const found = new this.Block(this.common, count, this.degree);
    return partDegrees(degree, this.hasBasis).map((reached) =>
      reached === 0 ? found.base(sections) : this.#ac(found, reached, sections),
    );
  }
}

/** Decodes blocks of several files, such as the levels of one, each with its own setup. */
export class Files {
  constructor(setups) {
    this.setups = setups;
    this.files = [];
  }

  /** Decode the block of a job: one part or, without `part`, all of it. */
  decode(job) {
    const blocks = (this.files[job.file] ??= new Blocks(this.setups[job.file]));
    return job.part === undefined ? blocks.whole(job) : blocks.decode(job);
  }
}
