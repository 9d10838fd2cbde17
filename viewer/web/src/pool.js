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
    this.failure = null; // after which workers do not answer
    this.workers = [];
    try {
      while (this.workers.length < size) {
        this.workers.push(create());
        this.#start(this.workers[this.workers.length - 1], setup);
      }
    } catch (error) {
      this.close();
      throw new errors.WorkerError(`no worker could be created: ${error.message}`);
    }
  }

  #start(worker, setup) {
    worker.onmessage = ({ data }) => this.#answer(data);
    worker.onmessageerror = () => this.#fail(new errors.WorkerError('a message was lost'));
    worker.onerror = (event) =>
      this.#fail(new errors.WorkerError(event.message || 'worker.js could not be loaded'));
    worker.postMessage({ setup });
  }

  /** Decode a part of a block; the memory of its sections goes to the worker. */
  decode(job) {
    if (this.failure) return Promise.reject(this.failure);
    const id = this.sent++;
    const memory = Object.values(job.sections).map((content) => content.buffer);
    return new Promise((resolve, reject) => {
      this.waiting.set(id, { resolve, reject });
      this.workers[job.block % this.workers.length].postMessage({ id, ...job }, memory);
    });
  }

  #answer({ id, planes, error }) {
    if (error) {
      const Kind = errors[error.name] ?? errors.WorkerError;
      const found = Object.assign(new Kind(error.message), { where: error.where ?? '' });
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
    this.failure ??= error;
    for (const { reject } of this.waiting.values()) reject(error);
    this.waiting.clear();
  }

  close() {
    for (const worker of this.workers) worker.terminate();
  }
}
