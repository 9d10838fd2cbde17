// Decoding in this thread.
import { Files } from './blocks.js';
import { EgsError } from './errors.js';

/** Decodes in this thread, and yields to other tasks between parts. */
export class Here {
  constructor(setups) {
    this.files = new Files(setups);
  }

  async decode(job) {
    await new Promise((resolve) => setTimeout(resolve));
    if (!this.files) throw new EgsError('closed');
    return this.files.decode(job);
  }

  /** Forget a file. */
  release(file) {
    this.files?.release(file);
  }

  /** Stop decoding. */
  close() {
    this.files = null;
  }
}
