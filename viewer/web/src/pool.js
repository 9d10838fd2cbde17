// Who decodes blocks: this thread, or workers beside it.
import { Files } from './blocks.js';
import * as errors from './errors.js';

/** Decodes on this thread, and lets others have it between two parts. */
export class Here {
  constructor(setups) {
    this.files = new Files(setups);
  }

  async decode(job) {
    await new Promise((resolve) => setTimeout(resolve));
    if (!this.files) throw new errors.EgsError('closed');
    return this.files.decode(job);
  }

  /** Decode nothing more. */
  close() {
    this.files = null;
  }
}

/** Decodes in workers, each block always in the same. */
export class WorkerPool {
  /**
   * @param {object[]} setups of files, each as for `Blocks`
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

  /** Do a job as for `Files`; the memory of its sections goes to the worker. */
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
    this.#fail(new errors.EgsError('closed'));
    for (const worker of this.workers) worker.terminate();
  }
}

const defaultWorkers = () =>
  typeof Worker === 'function' ? Math.min(globalThis.navigator?.hardwareConcurrency ?? 1, 4) : 0;

const defaultWorker = () => new Worker(new URL('./worker.js', import.meta.url), { type: 'module' });

/** What does so many jobs at most, as the options of `decode` say. */
export function createPool(setups, jobs, { workers = defaultWorkers(), createWorker }) {
  const size = Math.min(workers, jobs);
  return size > 0 ? new WorkerPool(setups, size, createWorker ?? defaultWorker) : new Here(setups);
}
