// Decoding in this thread, or in workers.
import * as errors from './errors.js';
import { Here } from './here.js';

/** Decodes in workers; a block always goes to the same one. */
export class WorkerPool {
  /**
   * @param {object[]} setups setups of files, as in `Blocks`
   * @param {number} size
   * @param {() => Worker} create
   */
  constructor(setups, size, create) {
    this.waiting = new Map();
    this.sent = 0;
    this.failure = null; // after which workers do not answer
    this.workers = [];
    try {
      while (this.workers.length < size) {
        this.workers.push(create());
        this.#start(this.workers[this.workers.length - 1], setups);
      }
    } catch (error) {
      this.close();
      throw new errors.WorkerError(`no worker could be created: ${error.message}`);
    }
  }

  #start(worker, setups) {
    worker.onmessage = ({ data }) => this.#answer(data);
    worker.onmessageerror = () => this.#fail(new errors.WorkerError('a message was lost'));
    worker.onerror = (event) =>
      this.#fail(new errors.WorkerError(event.message || 'worker.js could not be loaded'));
    worker.postMessage({ setups });
  }

  /** Run a job as in `Files`; the memory of its sections moves to the worker. */
  decode(job) {
    if (this.failure) return Promise.reject(this.failure);
    const id = this.sent++;
    const memory = Object.values(job.sections).map((content) => content.buffer);
    return new Promise((resolve, reject) => {
      this.waiting.set(id, { resolve, reject });
      this.workers[job.block % this.workers.length].postMessage({ id, ...job }, memory);
    });
  }

  /** Forget a file. */
  release(file) {
    for (const worker of this.workers) worker.postMessage({ release: file });
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
    this.#fail(new errors.EgsError('closed'));
    for (const worker of this.workers) worker.terminate();
  }
}

const defaultWorkers = () =>
  typeof Worker === 'function' ? Math.min(globalThis.navigator?.hardwareConcurrency ?? 1, 4) : 0;

const defaultWorker = () => new Worker(new URL('./worker.js', import.meta.url), { type: 'module' });

/** Create a decoder for at most `jobs` jobs, according to the options of `decode`. */
export function createPool(setups, jobs, { workers = defaultWorkers(), createWorker }) {
  const size = Math.min(workers, jobs);
  return size > 0 ? new WorkerPool(setups, size, createWorker ?? defaultWorker) : new Here(setups);
}
