// Decoding of blocks, in this thread or in a worker.
import { LatticeBlock } from './block.js';
import { Lattice } from './lattice.js';
import { Channels, PaperBlock } from './paper.js';

/** Decodes parts of blocks, and keeps their state until the last part. */
export class Blocks {
  /**
   * @param {object} setup `{content, degree, wanted, isPaper}`: the section `lattice` or
   *   `channels`, the SH degrees of the file and to decode
   */
  constructor({ content, degree, wanted, isPaper }) {
    this.common = isPaper ? new Channels(content, degree) : new Lattice(content, degree);
    this.Block = isPaper ? PaperBlock : LatticeBlock;
    this.degree = degree;
    this.wanted = wanted;
    this.open = new Map();
  }

  /** Names of the sections of each block, with profiles paper-*. */
  get sections() {
    return this.common.sections;
  }

  /**
   * Decode a part of a block: 0 is everything but SH-AC, 1 to 3 are bands of SH-AC, in order.
   *
   * @param {object} job `{block, count, part, sections}`
   * @returns {Float32Array} planes, as from `LatticeBlock`
   */
  decode({ block, count, part, sections }) {
    if (part === 0) this.open.set(block, new this.Block(this.common, count, this.degree));
    const found = this.open.get(block);
    if (part === this.wanted) this.open.delete(block);
    return part === 0 ? found.base(sections) : found.band(part - 1, sections[`sh${part}`]);
  }
  /**
   * Decode a whole block, up to an SH degree.
   *
   * @param {object} job `{count, degree, sections}`
   * @returns {Float32Array[]} planes of each part
   */
  whole({ count, degree, sections }) {
    const found = new this.Block(this.common, count, this.degree);
    const parts = [found.base(sections)];
    for (let band = 0; band < degree; band++)
      parts.push(found.band(band, sections[`sh${band + 1}`]));
    return parts;
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
