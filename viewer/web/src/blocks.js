// What decodes blocks: here, or in a worker.
import { LatticeBlock } from './block.js';
import { Lattice } from './lattice.js';
import { Channels, PaperBlock } from './paper.js';

/** Decodes parts of blocks, which it keeps until their last part. */
export class Blocks {
  /**
   * @param {object} setup `{content, degree, wanted, isPaper}`: the section `lattice` or
   *   `channels`, the SH degrees of the file and of what is decoded
   */
  constructor({ content, degree, wanted, isPaper }) {
    this.common = isPaper ? new Channels(content, degree) : new Lattice(content, degree);
    this.Block = isPaper ? PaperBlock : LatticeBlock;
    this.degree = degree;
    this.wanted = wanted;
    this.open = new Map();
  }

  /** Names of the sections that each block has, of the profiles paper-*. */
  get sections() {
    return this.common.sections;
  }

  /**
   * Decode a part of a block: 0 is all but SH-AC, 1 to 3 are bands of SH-AC, in this order.
   *
   * @param {object} job `{block, count, part, sections}`
   * @returns {Float32Array} planes, as `LatticeBlock` gives them
   */
  decode({ block, count, part, sections }) {
    if (part === 0) this.open.set(block, new this.Block(this.common, count, this.degree));
    const found = this.open.get(block);
    if (part === this.wanted) this.open.delete(block);
    return part === 0 ? found.base(sections) : found.band(part - 1, sections[`sh${part}`]);
  }
}
