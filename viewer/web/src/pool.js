// Who decodes blocks: this thread, or workers beside it.
import { Blocks } from './blocks.js';
import * as errors from './errors.js';

/** Decodes on this thread, and lets others have it between two parts. */
export class Here {
  constructor(setup) {
    this.blocks = new Blocks(setup);
  }

  get sections() {
    return this.blocks.sections;
  }

  async decode(job) {
    await new Promise((resolve) => setTimeout(resolve));
    if (!this.blocks) throw new errors.EgsError('closed');
    return this.blocks.decode(job);
  }

  /** Decode nothing more. */
  close() {
    this.blocks = null;
  }
}

/** Decodes in workers, each block always in the same. */
export class WorkerPool {
  /**
   * @param {object} setup as for `Blocks`
   * @param {number} size
   * @param {() => Worker} create
   */
  constructor(setup, size, create) {
    this.waiting = new Map();
    this.sent = 0;
    this.workers = Array.from({ length: size }, () => {
      const worker = create();
      worker.onmessage = ({ data }) => this.#answer(data);
      worker.onerror = (event) =>
        this.#fail(new errors.EgsError(`worker: ${event.message ?? 'failed'}`));
      worker.postMessage({ setup });
      return worker;
    });
  }

  decode(job) {
    const id = this.sent++;
    return new Promise((resolve, reject) => {
      this.waiting.set(id, { resolve, reject });
      this.workers[job.block % this.workers.length].postMessage({ id, ...job });
    });
  }

  #answer({ id, planes, error }) {
    if (error) {
      const Kind = errors[error.name] ?? Error;
      const found = Object.assign(new Kind(error.message));
      if (id === undefined) this.#fail(found);
      else this.#take(id)?.reject(found);
    } else {
      this.#take(id)?.resolve(planes);
    }
  }

  #take(id) {
    const found = this.waiting.get(id);
    this.waiting.delete(id);
    return found;
  }

  #fail(error) {
    for (const { reject } of this.waiting.values()) reject(error);
    this.waiting.clear();
  }

  close() {
    for (const worker of this.workers) worker.terminate();
  }
}
