// Ends work early: after an error, by a signal, or when closed.

export class Ending {
  #controller = new AbortController();
  #ended;
  #links;

  /** @param {(AbortSignal | undefined)[]} signals that also end it */
  constructor(...signals) {
    this.#ended = new Promise((_, reject) => {
      this.signal.addEventListener('abort', () => reject(this.signal.reason));
    });
    this.#ended.catch(() => {}); // possibly nobody awaits it
    const given = signals.filter(Boolean);
    this.#links = given.map((signal) => ({ signal, abort: () => this.end(signal.reason) }));
    for (const { signal, abort } of this.#links) {
      signal.addEventListener('abort', abort);
      if (signal.aborted) abort();
    }
  }

  /** Aborted at the end, with the first reason. */
  get signal() {
    return this.#controller.signal;
  }

  /** End with a reason, whatever is pending. */
  end(reason) {
    this.#controller.abort(reason);
  }

  /** The result of work, unless the end comes first; an error of the work is an end. */
  async before(work) {
    try {
      return await Promise.race([work, this.#ended]);
    } catch (error) {
      this.end(error);
      throw this.signal.reason;
    }
  }

  /** Stop listening to the signals. */
  release() {
    for (const { signal, abort } of this.#links) signal.removeEventListener('abort', abort);
  }
}
