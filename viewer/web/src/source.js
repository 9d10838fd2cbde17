// Sources of the bytes of a file: memory, a stream, or a server.
import { Ending } from './ending.js';
import { CorruptError, SourceError } from './errors.js';

/**
 * Open a source of bytes, of any kind accepted by `decode`.
 *
 * @param {boolean} ranged whether parts of the file will be skipped; then a server is asked for
 *   ranges
 * @param {AbortSignal} [signal]
 */
export async function openSource(source, ranged, signal) {
  if (source instanceof ArrayBuffer) return new MemorySource(new Uint8Array(source));
  if (ArrayBuffer.isView(source)) {
    return new MemorySource(new Uint8Array(source.buffer, source.byteOffset, source.byteLength));
  }
  if (source instanceof Response) return ofResponse(source, source.url || 'response');
  if (source instanceof ReadableStream) return new StreamSource(source);
  if (source instanceof Blob) return new StreamSource(source.stream(), source.size);
  if (typeof source === 'string' || source instanceof URL) {
    if (ranged) return new RangeSource(source, (response) => answered(response, source), signal);
    const ending = new Ending(signal);
    try {
      return answered(await request(source, ending), source); // which is closed when decoding ends
    } finally {
      ending.release();
    }
  }
  throw new TypeError('expected an ArrayBuffer, a view of one, a Blob, Response, stream or URL');
}

/**
 * Open a source with random access, also for concurrent reads.
 *
 * All bytes of a stream, or of a server without ranges, are kept.
 */
export async function openParts(source, signal) {
  if (source instanceof Blob) return new BlobSource(source);
  if (typeof source === 'string' || source instanceof URL) {
    const kept = (response) => new KeptSource(answered(response, source));
    return new RangeSource(source, kept, signal);
  }
  const opened = await openSource(source, false, signal);
  return opened instanceof StreamSource ? new KeptSource(opened) : opened;
}

/** Maximum time without data from a server, in milliseconds. */
const SILENCE = 20_000;

/** Bytes received from servers, by host, because browsers queue requests to the same host. */
const heard = new Map();

const hostOf = (url) => new URL(url, globalThis.location?.href).host;

/** Wait for data from a server, as long as it sends anything. */
async function heardFrom(host, coming) {
  let timer;
  const silence = new Promise((_, reject) => {
    const listen = () => {
      const before = heard.get(host);
      const look = () => (heard.get(host) === before ? reject(new Error(text)) : listen());
      timer = setTimeout(look, SILENCE);
    };
    const text = `no data for ${SILENCE / 1000} seconds`;
    listen();
  });
  try {
    const found = await Promise.race([coming, silence]);
    heard.set(host, (heard.get(host) ?? 0) + 1);
    return found;
  } finally {
    clearTimeout(timer);
  }
}

async function request(url, ending, headers = {}) {
  const { signal } = ending;
  try {
    return await heardFrom(hostOf(url), fetch(url, { headers, signal }));
  } catch (error) {
    if (signal.aborted) throw error;
    ending.end(error);
    throw new SourceError(`${url}: ${error.message}`);
  }
}

/** Discard the body of a response. */
function release(response) {
  response.body?.cancel().catch(() => {});
}

/** The body of a response, which starts at byte `begin` of the file. */
const answered = (response, url, begin) => ofResponse(response, url, begin, hostOf(url));

/** The body of a response; `host` identifies a server, for which there is a timeout. */
function ofResponse(response, url, begin = 0, host = undefined) {
  if (!response.ok) {
    release(response);
    throw new SourceError(`${url}: ${response.status} ${response.statusText}`);
  }
  if (!response.body) throw new SourceError(`${url}: no body`);
  const { headers, type } = response;
  // For another origin, browsers give the length, but not whether it is of encoded bytes.
  const coded = type === 'cors' || headers.has('Content-Encoding');
  const length = headers.get('Content-Length') ?? '';
  const size = coded || !/^\d+$/.test(length) ? undefined : Number(length);
  return new StreamSource(response.body, size, begin, host);
}

/** Maximum bytes of adjacent sections read at once, because each request takes long. */
const AT_ONCE = 2 ** 20;

const cutOff = (end) => new CorruptError(`cut off before byte ${end}`, 'file');

/** A chunk of a stream as bytes: slicing a Node `Buffer` differs from other arrays. */
function bytesOf(chunk) {
  if (!ArrayBuffer.isView(chunk)) throw new TypeError('expected a stream of bytes');
  return new Uint8Array(chunk.buffer, chunk.byteOffset, chunk.byteLength);
}

function grown(bytes, size) {
  const result = new Uint8Array(size);
  result.set(bytes);
  return result;
}

class MemorySource {
  constructor(data) {
    this.data = data;
    this.size = data.length; // of the file; undefined if unknown
    this.atOnce = AT_ONCE;
  }

  async read(begin, end) {
    if (end > this.data.length) throw cutOff(end);
    return this.data.subarray(begin, end);
  }

  /** Whether the file ends at a byte. */
  async endsAt(end) {
    return this.data.length === end;
  }

  close() {}
}

class BlobSource {
  constructor(blob) {
    this.blob = blob;
    this.size = blob.size;
    this.atOnce = AT_ONCE;
  }

  async read(begin, end) {
    if (end > this.size) throw cutOff(end);
    return new Uint8Array(await this.blob.slice(begin, end).arrayBuffer());
  }

  close() {}
}

/** Keeps everything that a stream has delivered. */
class KeptSource {
  constructor(stream) {
    this.stream = stream;
    this.size = stream.size;
    this.atOnce = AT_ONCE;
    this.bytes = new Uint8Array(0);
    this.length = 0; // of the bytes received so far
    this.coming = null;
  }

  async read(begin, end) {
    while (this.length < end) {
      this.coming ??= this.#next();
      if (!(await this.coming)) throw cutOff(end);
    }
    return this.bytes.subarray(begin, end);
  }

  async #next() {
    const isMore = await this.stream.next();
    const { chunk } = this.stream;
    const length = this.length + chunk.length;
    if (length > this.bytes.length) this.bytes = grown(this.bytes, Math.max(2 * length, 2 ** 16));
    this.bytes.set(chunk, this.length);
    this.length = length;
    if (isMore) this.coming = null; // kept after the end, or after an error
    return isMore;
  }

  close() {
    this.stream.close();
  }
}

/** Reads forward only. */
class StreamSource {
  constructor(stream, size, begin = 0, host = undefined) {
    this.size = size;
    this.host = host;
    this.atOnce = 0; // Decode sections as they arrive.
    this.reader = stream.getReader();
    this.chunk = new Uint8Array(0);
    this.at = begin; // position of the chunk's first byte
  }

  /** The next chunk; false at the end. */
  async next() {
    this.at += this.chunk.length;
    let found;
    try {
      const coming = this.reader.read();
      found = await (this.host === undefined ? coming : heardFrom(this.host, coming));
    } catch (error) {
      if (error?.name === 'AbortError') throw error;
      throw new SourceError(`connection lost at byte ${this.at}: ${error?.message ?? error}`);
    }
    this.chunk = found.done ? new Uint8Array(0) : bytesOf(found.value);
    return !found.done;
  }

  async read(begin, end) {
    let bytes = new Uint8Array(0); // grows: damaged files may claim too much
    for (let at = begin; at < end;) {
      if (at >= this.at && at < this.at + this.chunk.length) {
        const part = this.chunk.subarray(at - this.at, end - this.at);
        if (part.length === end - begin) return part;
        const size = at - begin + part.length;
        if (size > bytes.length) bytes = grown(bytes, Math.min(2 * size, end - begin));
        bytes.set(part, at - begin);
        at += part.length;
      } else if (!(await this.next())) {
        throw cutOff(end);
      }
    }
    return bytes;
  }

  async endsAt(end) {
    while (this.at + this.chunk.length <= end) if (!(await this.next())) return true;
    return false;
  }

  /** Not awaited: a stream that delivers no more may not close either. */
  close() {
    this.reader.cancel().catch(() => {});
  }
}

/**
 * Requests ranges from a server; if it sends the whole file, reads that with a source from `ofAll`.
 */
class RangeSource {
  constructor(url, ofAll, signal) {
    this.url = url;
    this.ofAll = ofAll;
    this.signal = signal;
    this.atOnce = AT_ONCE;
    this.whole = null;
  }

  async read(begin, end, signal = this.signal) {
    if (this.whole) return this.#ofWhole(begin, end);
    if (begin === end) return new Uint8Array(0); // there are no ranges without bytes
    const ending = new Ending(signal);
    try {
      return await this.#request(begin, end, signal, ending);
    } finally {
      ending.release();
    }
  }

  async #request(begin, end, signal, ending) {
    const response = await request(this.url, ending, { Range: `bytes=${begin}-${end - 1}` });
    if (response.status === 416) {
      release(response);
      throw cutOff(end);
    }
    if (response.status !== 206) {
      if (this.whole) {
        release(response);
      } else if (signal !== this.signal && response.ok) {
        release(response); // otherwise it would be cancelled with its caller
        return this.read(begin, end);
      } else {
        this.whole = this.ofAll(response);
      }
      this.size = this.whole.size;
      return this.#ofWhole(begin, end);
    }
    const total = /\/(\d+)$/.exec(response.headers.get('Content-Range') ?? '');
    if (total) this.size = Number(total[1]);
    const part = answered(response, this.url, begin);
    try {
      const bytes = await part.read(begin, end);
      if (await part.endsAt(end)) return bytes;
    } finally {
      part.close();
    }
    throw new SourceError(`${this.url}: more bytes than were asked for`);
  }

  /** Read from the whole file that the server sends; request it again after a lost connection. */
  async #ofWhole(begin, end) {
    const { whole } = this;
    try {
      return await whole.read(begin, end);
    } catch (error) {
      if (error instanceof SourceError && this.whole === whole) {
        whole.close();
        this.whole = null;
      }
      throw error;
    }
  }

  async endsAt() {
    return true; // the server was not asked again
  }

  close() {
    this.whole?.close();
  }
}
