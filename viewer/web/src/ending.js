// How work ends before it is done: by an error, by a signal, or when it is closed.

export class Ending {
  #controller = new AbortController();
  #ended;
  #links;

  /** @param {(AbortSignal | undefined)[]} signals which end it, too */
  constructor(...signals) {
    this.#ended = new Promise((_, reject) => {
      this.signal.addEventListener('abort', () => reject(this.signal.reason));
    });
    this.#ended.catch(() => {}); // it may be that nobody waits for it
    const given = signals.filter(Boolean);
    this.#links = given.map((signal) => ({ signal, abort: () => this.end(signal.reason) }));
    for (const { signal, abort } of this.#links) {
      signal.addEventListener('abort', abort);
      if (signal.aborted) abort();
    }
  }

  /** Aborted at the end, for the reason that came first. */
  get signal() {
    return this.#controller.signal;
  }

  /** End for a reason, whatever is waited for. */
  end(reason) {
    this.#controller.abort(reason);
  }

  /** What comes of work, unless the end comes first; an error of it is one. */
  async before(work) {
    try {
      return await Promise.race([work, this.#ended]);
    } catch (error) {
      this.end(error);
      throw this.signal.reason;
    }
  }

  /** Listen to the signals no longer. */
  release() {
    for (const { signal, abort } of this.#links) signal.removeEventListener('abort', abort);
  }
}
