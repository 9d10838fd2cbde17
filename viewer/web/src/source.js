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
  if (source instanceof Response) return ofResponse(source);
  if (source instanceof ReadableStream) return new StreamSource(source);
  if (source instanceof Blob) return new StreamSource(source.stream(), source.size);
  if (typeof source === 'string' || source instanceof URL) {
    if (ranged) return new RangeSource(source, signal);
    return ofResponse(await request(source, { signal }));
  }
  throw new TypeError('expected an ArrayBuffer, a view of one, a Blob, Response, stream or URL');
}

async function request(url, options) {
  let response;
  try {
    response = await fetch(url, options);
  } catch (error) {
    if (options.signal?.aborted) throw error;
    throw new SourceError(`${url}: ${error.message}`);
  }
  if (!response.ok) throw new SourceError(`${url}: ${response.status} ${response.statusText}`);
  return response;
}

function ofResponse(response) {
  if (!response.ok) throw new SourceError(`${response.url}: ${response.status}`);
  if (!response.body) throw new SourceError(`${response.url}: no body`);
  const { headers } = response;
  const size = headers.has('Content-Encoding') ? null : headers.get('Content-Length');
  return new StreamSource(response.body, size === null ? undefined : Number(size));
}

const cutOff = (end) => new CorruptError(`cut off before byte ${end}`, 'file');

class MemorySource {
  constructor(data) {
    this.data = data;
    this.size = data.length; // of the file; undefined where it is not known
  }

  async read(begin, end) {
    if (end > this.data.length) throw cutOff(end);
    return this.data.subarray(begin, end);
  }

  /** Whether there is nothing from a byte on. */
  async endsAt(end) {
    return this.data.length === end;
  }

  async close() {}
}

/** Reads forward only. */
class StreamSource {
  constructor(stream, size) {
    this.size = size;
    this.reader = stream.getReader();
    this.chunk = new Uint8Array(0);
    this.at = 0; // of the chunk's first byte
  }

  /** The next chunk; false at the end. */
  async next() {
    this.at += this.chunk.length;
    let found;
    try {
      found = await this.reader.read();
    } catch (error) {
      if (error.name === 'AbortError') throw error;
      throw new SourceError(`connection lost at byte ${this.at}: ${error.message}`);
    }
    this.chunk = found.done ? new Uint8Array(0) : found.value;
    return !found.done;
  }

  async read(begin, end) {
    const parts = []; // joined at the end, as there may be less than a damaged file says
    for (let at = begin; at < end;) {
      if (at >= this.at && at < this.at + this.chunk.length) {
        parts.push(this.chunk.subarray(at - this.at, end - this.at));
        at += parts[parts.length - 1].length;
      } else if (!(await this.next())) {
        throw cutOff(end);
      }
    }
    if (parts.length === 1) return parts[0];
    const bytes = new Uint8Array(end - begin);
    let at = 0;
    for (const part of parts) {
      bytes.set(part, at);
      at += part.length;
    }
    return bytes;
  }

  async endsAt(end) {
    while (this.at + this.chunk.length <= end) if (!(await this.next())) return true;
    return false;
  }

  async close() {
    await this.reader.cancel().catch(() => {});
  }
}

/** Asks a server for ranges; if it sends all instead, keeps that. */
class RangeSource {
  constructor(url, signal) {
    this.url = url;
    this.signal = signal;
    this.whole = null;
  }

  async read(begin, end) {
    if (this.whole) return this.whole.read(begin, end);
    const headers = { Range: `bytes=${begin}-${end - 1}` };
    const response = await request(this.url, { headers, signal: this.signal });
    const bytes = new Uint8Array(await response.arrayBuffer());
    if (response.status !== 206) {
      this.whole = new MemorySource(bytes);
      this.size = bytes.length;
      return this.whole.read(begin, end);
    }
    if (bytes.length !== end - begin) throw cutOff(end);
    const total = /\/(\d+)$/.exec(response.headers.get('Content-Range') ?? '');
    if (total) this.size = Number(total[1]);
    return bytes;
  }

  async endsAt() {
    return true; // It was not asked for more.
  }

  async close() {}
}
