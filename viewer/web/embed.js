// Shows a page of `gs-codec share` as a part of another page, and controls it.

const VERSION = 1;

/** Milliseconds within which a loaded page answers. */
const PATIENCE = 10_000;

/**
 * Show a page in an element.
 *
 * @param {HTMLElement} element
 * @param {object} [options] see embed.d.ts
 */
export function createViewer(element, options) {
  return new EmbeddedViewer(element, options);
}

class EmbeddedViewer {
  #calls = new Map();
  #count = 0;
  #origin;
  #options;

  constructor(element, { page = new URL('index.html', import.meta.url), ...options } = {}) {
    const { state = {}, title = '3D scene' } = options;
    const url = new URL(page, document.baseURI);
    const given = Object.entries(state).filter(([, value]) => value !== undefined);
    url.hash = new URLSearchParams(given).toString().replaceAll('%2C', ',');
    this.#origin = url.origin === 'null' ? '*' : url.origin; // files have no origin
    this.#options = options;
    this.element = document.createElement('iframe');
    const style = { width: '100%', height: '100%', border: '0', display: 'block' };
    Object.assign(this.element.style, style);
    Object.assign(this.element, { title, allow: 'fullscreen; clipboard-write; xr-spatial-tracking' });
    const loaded = new Promise((resolve, reject) => {
      this.element.addEventListener('load', resolve);
      this.#calls.set(0, { resolve, reject }); // until it is closed
    });
    this.ready = loaded.then(() => this.#begin(url));
    this.ready.catch(() => {}); // whoever awaits it sees the error
    addEventListener('message', this.#take);
    this.element.src = url.href;
    element.append(this.element);
  }

  async #begin(url) {
    const silence = new Promise((_, reject) => {
      const error = new Error(`${url.href}: no answer; it is not a page of gs-codec share`);
      setTimeout(reject, PATIENCE, error);
    });
    await Promise.race([this.#ask('hello'), silence]);
    this.state = await this.#ask('state');
    return this.#ask('facts');
  }

  #ask(call, value) {
    if (!this.element.isConnected) return Promise.reject(new Error('the viewer is closed'));
    return new Promise((resolve, reject) => {
      const id = ++this.#count;
      this.#calls.set(id, { resolve, reject });
      this.element.contentWindow.postMessage({ gsCodec: VERSION, id, call, value }, this.#origin);
    });
  }

  #take = ({ source, origin, data }) => {
    if (source !== this.element.contentWindow || data?.gsCodec !== VERSION) return;
    if (this.#origin !== '*' && origin !== this.#origin) return;
    const { id, error, result, event, detail } = data;
    if (event === 'change') {
      this.state = detail;
      this.#options.onChange?.(detail);
    } else if (event === 'message') {
      this.#options.onMessage?.(detail.text, detail.isError);
    } else {
      const call = this.#calls.get(id);
      this.#calls.delete(id);
      if (error === undefined) call?.resolve(result);
      else call?.reject(new Error(error));
    }
  };

  async set(state) {
    await this.ready;
    this.state = await this.#ask('set', state);
    return this.state;
  }

  async picture() {
    await this.ready;
    return this.#ask('picture');
  }

  close() {
    removeEventListener('message', this.#take);
    this.element.remove();
    for (const { reject } of this.#calls.values()) reject(new Error('the viewer is closed'));
    this.#calls.clear();
  }
}
