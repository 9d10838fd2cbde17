// Decoding of blocks, in this thread or in a worker.
import { partDegrees } from './basis.js';
import { LatticeBlock } from './block.js';
import { commonOf } from './common.js';
import { MovingBlock } from './motion.js';
import { PaperBlock } from './paper.js';

/** Decodes parts of blocks, and keeps their state until the last part. */
export class Blocks {
  /**
   * @param {object} setup `{content, degree, degrees, hasBasis, isPaper}`: the section
   *   `lattice` or `channels`, the SH degree of the file, those that the parts of a block reach, and
   *   whether SH-AC is in a local basis
   */
  constructor(setup) {
    const { degree, degrees, hasBasis, isPaper } = setup;
    this.common = commonOf(setup);
    this.Block = isPaper ? PaperBlock : LatticeBlock;
    this.degree = degree;
    this.degrees = degrees;
    this.hasBasis = hasBasis;
    this.open = new Map();
    this.moving = new Map(); // blocks of a key frame
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
   * @param {object} job `{count, degree, sections}`; of a key frame also `moves` and `block`
   * @returns {Float32Array[]} planes of each part
   */
  whole({ count, degree, sections, moves, block }) {
    const found = new this.Block(this.common, count, this.degree, moves);
    const planes = partDegrees(degree, this.hasBasis).map((reached) =>
      reached === 0 ? found.base(sections) : this.#ac(found, reached, sections),
    );
    if (moves) this.moving.set(block, new MovingBlock(found, planes[0]));
    return planes;
  }
}

/**
 * Decodes blocks of several files, such as the levels of one, each with its own setup. Key frames
 * bring theirs with their jobs, and are released.
 */
export class Files {
  constructor(setups) {
    this.setups = setups;
    this.files = {};
  }

  /** Decode the block of a job: one part or, without `part`, all of it, or its next frame. */
  decode(job) {
    const blocks = (this.files[job.file] ??= new Blocks(job.setup ?? this.setups[job.file]));
    if (job.sections.motion) return blocks.moving.get(job.block).next(job.sections.motion);
    return job.part === undefined ? blocks.whole(job) : blocks.decode(job);
  }

  /** Forget a file. */
  release(file) {
    delete this.files[file];
  }
}
