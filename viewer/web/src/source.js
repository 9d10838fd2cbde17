// Where the bytes of a file come from: memory, a stream, or a server.
import { CorruptError, SourceError } from './errors.js';

/**
 * A source of bytes, of one of the kinds that `decode` takes.
 *
 * @param {boolean} ranged whether parts of the file will be left out: then a server is asked for
 *   parts instead of for all
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
    if (ranged) return new RangeSource(source, signal);
    return ofResponse(await request(source, { signal }), source);
  }
  throw new TypeError('expected an ArrayBuffer, a view of one, a Blob, Response, stream or URL');
}

async function request(url, options) {
  try {
    return await fetch(url, options);
  } catch (error) {
    if (options.signal?.aborted) throw error;
    throw new SourceError(`${url}: ${error.message}`);
  }
}

/** Leave the body of a response unread. */
function release(response) {
  response.body?.cancel().catch(() => {});
}

/** What a response has, which is of the file from byte `begin` on. */
function ofResponse(response, url, begin = 0) {
  if (!response.ok) {
    release(response);
    throw new SourceError(`${url}: ${response.status} ${response.statusText}`);
  }
  if (!response.body) throw new SourceError(`${url}: no body`);
  const { headers, type } = response;
  // Of a server of another origin, browsers tell the length but not whether it is of coded bytes.
  const coded = type === 'cors' || headers.has('Content-Encoding');
  const length = headers.get('Content-Length') ?? '';
  const size = coded || !/^\d+$/.test(length) ? undefined : Number(length);
  return new StreamSource(response.body, size, begin);
}

/** Most bytes of neighbouring sections that are read at once: a request for each takes long. */
const AT_ONCE = 2 ** 20;

const cutOff = (end) => new CorruptError(`cut off before byte ${end}`, 'file');

/** What a stream gave, as bytes: a `Buffer` of Node is not sliced as other arrays are. */
function bytesOf(chunk) {
  if (!ArrayBuffer.isView(chunk)) throw new TypeError('the stream gives other than bytes');
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
    this.size = data.length; // of the file; undefined where it is not known
    this.atOnce = AT_ONCE;
  }

  async read(begin, end) {
    if (end > this.data.length) throw cutOff(end);
    return this.data.subarray(begin, end);
  }

  /** Whether there is nothing from a byte on. */
  async endsAt(end) {
    return this.data.length === end;
  }

  close() {}
}

/** Reads forward only. */
class StreamSource {
  constructor(stream, size, begin = 0) {
    this.size = size;
    this.atOnce = 0; // Sections are decoded as they come.
    this.reader = stream.getReader();
    this.chunk = new Uint8Array(0);
    this.at = begin; // of the chunk's first byte
  }

  /** The next chunk; false at the end. */
  async next() {
    this.at += this.chunk.length;
    let found;
    try {
      found = await this.reader.read();
    } catch (error) {
      if (error?.name === 'AbortError') throw error;
      throw new SourceError(`connection lost at byte ${this.at}: ${error?.message ?? error}`);
    }
    this.chunk = found.done ? new Uint8Array(0) : bytesOf(found.value);
    return !found.done;
  }

  async read(begin, end) {
    let bytes = new Uint8Array(0); // which grows, as there may be less than a damaged file says
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

  /** Not waited for: a stream that gives nothing more may not end at once either. */
  close() {
    this.reader.cancel().catch(() => {});
  }
}

/** Asks a server for ranges; if it sends all instead, reads that. */
class RangeSource {
  constructor(url, signal) {
    this.url = url;
    this.signal = signal;
    this.atOnce = AT_ONCE;
    this.whole = null;
  }

  async read(begin, end) {
    if (this.whole) return this.whole.read(begin, end);
    const headers = { Range: `bytes=${begin}-${end - 1}` };
    const response = await request(this.url, { headers, signal: this.signal });
    if (response.status === 416) {
      release(response);
      throw cutOff(end);
    }
    if (response.status !== 206) {
      this.whole = ofResponse(response, this.url);
      this.size = this.whole.size;
      return this.whole.read(begin, end);
    }
    const total = /\/(\d+)$/.exec(response.headers.get('Content-Range') ?? '');
    if (total) this.size = Number(total[1]);
    const part = ofResponse(response, this.url, begin);
    try {
      const bytes = await part.read(begin, end);
      if (await part.endsAt(end)) return bytes;
    } finally {
      part.close();
    }
    throw new SourceError(`${this.url}: more bytes than were asked for`);
  }

  async endsAt() {
    return true; // It was not asked for more.
  }

  close() {
    this.whole?.close();
  }
}
