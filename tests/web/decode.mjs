// Decodes files as test_web_decoder.py asks: a list of jobs as JSON on stdin, a line for each.
import { createHash } from 'node:crypto';
import { getEventListeners } from 'node:events';
import { readFileSync } from 'node:fs';
import { createServer } from 'node:http';
import { Worker } from 'node:worker_threads';

import { decode, open, openSequence } from '../../viewer/web/src/index.js';
import { frequencies } from '../../viewer/web/src/tables.js';

const ARRAYS = ['positions', 'fDc', 'fRest', 'opacity', 'logScale', 'rotation'];

/** Workers that were created and not terminated. */
let alive = 0;

/** The signal of a job that is not aborted. */
let signal;

/** A worker of Node that looks like one of a browser. */
function nodeWorker(script = './node_worker.mjs') {
  const worker = new Worker(new URL(script, import.meta.url));
  alive++;
  const wrapped = {
    postMessage: (...message) => worker.postMessage(...message),
    terminate: () => {
      alive--;
      return worker.terminate();
    },
  };
  worker.on('message', (data) => wrapped.onmessage({ data }));
  worker.on('error', (error) => wrapped.onerror(error));
  return wrapped;
}

/** Answers that end in silence, for which 20 seconds are not waited here. */
const SILENT = ['silent', 'halting'];
const { setTimeout: later } = globalThis;
let isHasty = false;
globalThis.setTimeout = (work, time) => later(work, isHasty && time === 20_000 ? 300 : time);

const bytes = (data) => new Uint8Array(data);

/** Chunks that are not at the beginning of their memory, as those of files in Node. */
const buffers = (data) => Buffer.concat([Buffer.alloc(1), data]).subarray(1);

/**
 * A stream of chunks of a size, which ends with an error after `broken` bytes, and of which nothing
 * more comes after `stalled` bytes.
 */
function streamed(data, { chunk, broken = Infinity, stalled = Infinity }, as = bytes) {
  let at = 0;
  return new ReadableStream({
    pull(controller) {
      if (at >= stalled) return new Promise(() => {});
      if (at >= broken) return controller.error(new Error('reset'));
      if (at >= data.length) return controller.close();
      return controller.enqueue(as(data.subarray(at, (at += chunk))));
    },
    cancel: () => (at >= stalled ? new Promise(() => {}) : undefined),
  });
}

/** What servers, good and bad ones, answer to a range from `begin` to `end`. */
const ANSWERS = {
  ranges: (data, begin, end) => [206, data.subarray(begin, end)],
  whole: (data) => [200, data],
  longer: (data, begin, end) => [206, data.subarray(begin, end + 1)],
  shorter: (data, begin, end) => [206, data.subarray(begin, end - 1)],
  others: (data, begin, end) => [206, data.subarray(begin + 4, end + 4)],
  none: () => [416, ''],
  failing: (data, begin, end) => (begin > 0 ? [503, ''] : [206, data.subarray(begin, end)]),
};

/** Serve a file; what was asked for goes to `asked`. */
async function served(data, answer, asked, work) {
  const server = createServer((request, response) => {
    // Node 20 can crash when a connection that was kept times out on a busy machine.
    response.setHeader('Connection', 'close');
    const range = /^bytes=(\d+)-(\d+)$/.exec(request.headers.range ?? '');
    asked.push(range ? [Number(range[1]), Number(range[2]) + 1] : null);
    if (request.url === '/moved.egs') {
      return response.writeHead(302, { Location: '/scene.egs' }).end();
    }
    if (request.url !== '/scene.egs') return response.writeHead(404).end();
    if (!range) return response.writeHead(200).end(data);
    const [begin, end] = [Number(range[1]), Number(range[2]) + 1];
    if (answer === 'silent') return undefined;
    if (answer === 'cut' || answer === 'halting') {
      response
        .writeHead(206, { 'Content-Length': end - begin })
        .write(data.subarray(begin, begin + 1));
      return answer === 'cut' && setTimeout(() => response.destroy(), 20);
    }
    const [status, body] = ANSWERS[answer](data, begin, end);
    const headers = { 'Content-Range': `bytes ${begin}-${end - 1}/${data.length}` };
    return response.writeHead(status, status === 206 ? headers : {}).end(body);
  });
  await new Promise((resolve) => server.listen(0, '127.0.0.1', resolve));
  try {
    return await work(`http://127.0.0.1:${server.address().port}`);
  } finally {
    server.close();
  }
}

/** A response as of a server of another origin, which does not say that the bytes were coded. */
function ofOtherOrigin(data) {
  const response = new Response(data, { headers: { 'Content-Length': '99' } });
  return Object.defineProperty(response, 'type', { value: 'cors' });
}

/** Ways to create workers. */
const CREATE = {
  node: () => nodeWorker(),
  missing: () => nodeWorker('./none.mjs'),
  refused: () => {
    if (alive > 0) throw new Error('not of this origin');
    return nodeWorker();
  },
};

/** SHA-256 of the floats of a scene. */
function digest(scene) {
  const hash = createHash('sha256');
  for (const name of ARRAYS) hash.update(new Uint8Array(scene[name].buffer));
  return hash.digest('hex');
}

/**
 * What comes of opening a file, selecting blocks for `views`, and decoding those of `chosen`, all at
 * once if `together`.
 */
async function opened(source, { views = [], chosen = [], together, closed, shDegree }, options) {
  const file = await open(source, options);
  try {
    const found = { levels: file.levels.map(({ count, blocks }) => [count, blocks]) };
    found.begun = file.fetched;
    found.selected = views.map(({ view, ...given }) => file.select(view, given));
    const decoded = [];
    const one = async ([level, blocks], k) => {
      const onBlock = (_, part) => options.onBlock(_, part);
      const controller = new AbortController();
      const given = { onBlock, signal: controller.signal, shDegree };
      const decoding = file.decode(level, blocks, given);
      if (closed === 'call') controller.abort(new Error('of the caller'));
      if (closed === 'file') setTimeout(() => file.close(), 20);
      decoded[k] = digest(await decoding);
    };
    if (together) await Promise.all(chosen.map(one));
    else for (const [k, each] of chosen.entries()) await one(each, k);
    return { ...found, decoded, fetched: file.fetched, size: file.size };
  } finally {
    file.close();
  }
}

async function runOpened(data, { open: job, ...given }, options, told) {
  const byServer = (answer) =>
    served(data, answer, told.asked, (host) => opened(`${host}/scene.egs`, job, options));
  const kinds = {
    bytes: () => opened(data, job, options),
    blob: () => opened(new Blob([data]), job, options),
    stream: () => opened(streamed(data, given), job, options),
    response: () => opened(new Response(data), job, options),
    url: () => byServer(given.answer ?? 'ranges'),
    unranged: () => byServer('whole'),
  };
  return { ...(await kinds[given.as ?? 'bytes']()), ...told, alive };
}

/** Digests of frames of a sequence, in the order of `frames` or, if that is true, all. */
async function framesOf(data, { frames, as }, options, told) {
  const work = async (source) => {
    const sequence = await openSequence(source, options);
    try {
      const { count, fps, names, keys, degree, size } = sequence;
      const hashes = [];
      const wanted = frames === true ? Array(count).keys() : frames;
      for (const number of wanted) hashes.push(digest(await sequence.frame(number)));
      return { count, fps, names, keys, degree, size, hashes, fetched: sequence.fetched };
    } finally {
      sequence.close();
    }
  };
  const isUrl = as === 'url';
  const found = isUrl
    ? await served(data, 'ranges', told.asked, (host) => work(`${host}/scene.egs`))
    : await work(data);
  return { ...found, asked: told.asked, alive };
}

async function run(job) {
  if (job.weights) {
    return { frequencies: [...frequencies(job.weights, job.precision, 'table')] };
  }
  const data = job.bytes !== undefined ? Buffer.from(job.bytes, 'base64') : readFileSync(job.path);
  isHasty = SILENT.includes(job.answer);
  const told = { blocks: [], asked: [], progress: [] };
  ({ signal } = new AbortController());
  const options = {
    signal,
    shDegree: job.shDegree,
    box: job.box,
    maxBytes: job.maxBytes,
    extra: job.extra,
    workers: job.workers ?? 0,
    createWorker: CREATE[job.createWorker ?? 'node'],
    onBlock: (scene, part) => told.blocks.push([part.block, part.degree, part.first, part.count]),
    onProgress: (bytes, of) => told.progress.push([bytes, of]),
  };
  if (job.damage) {
    told.damage = [];
    options.onDamage = (block, { where }) => told.damage.push([block, where]);
  }
  const kinds = {
    bytes: () => decode(data, options),
    buffer: () => decode(new Uint8Array(data).buffer, options),
    blob: () => decode(new Blob([data]), options),
    stream: () => decode(streamed(data, job), options),
    buffers: () => decode(streamed(data, job, buffers), options),
    text: () => decode(streamed(data, job, String), options),
    crossing: () => decode(ofOtherOrigin(data), options),
    response: () => decode(new Response(data), options),
    url: () =>
      served(data, job.answer ?? 'ranges', told.asked, (host) =>
        decode(`${host}/scene.egs`, options),
      ),
    unranged: () =>
      served(data, 'whole', told.asked, (host) => decode(new URL(`${host}/scene.egs`), options)),
    missing: () =>
      served(data, 'ranges', told.asked, (host) => decode(`${host}/none.egs`, options)),
    moved: () => served(data, 'ranges', told.asked, (host) => decode(`${host}/moved.egs`, options)),
    thrown: () => {
      options.onBlock = () => {
        throw new Error('of the caller');
      };
      return decode(data, options);
    },
    aborted: () => {
      const controller = new AbortController();
      options.signal = controller.signal;
      const abort = () => controller.abort(job.reason && new Error(job.reason));
      if (job.abort === 'before') abort();
      else if (job.abort === 'progress') options.onProgress = abort;
      else if (job.abort === 'stalled') setTimeout(abort, 100);
      else options.onBlock = abort;
      return decode(job.chunk ? streamed(data, job) : data, options);
    },
    number: () => decode(7, options),
  };
  try {
    if (job.frames) return await framesOf(data, job, options, told);
    if (job.open) return await runOpened(data, job, options, told);
    const scene = await kinds[job.as ?? 'bytes']();
    const properties = createHash('sha256');
    for (const name of scene.properties) {
      const plane = scene.property(name);
      properties.update(new Uint8Array(plane.buffer, plane.byteOffset, plane.byteLength));
    }
    const { count, degree, profile, coordinates, antialiased, comments } = scene;
    const facts = { count, degree, profile, coordinates, antialiased, comments };
    const digests = { hash: digest(scene), properties: properties.digest('hex') };
    return { ...facts, ...told, ...digests, alive };
  } catch (error) {
    return { error: error.name, message: error.message, where: error.where, ...told, alive };
  }
}

const chunks = [];
for await (const chunk of process.stdin) chunks.push(chunk);
for (const job of JSON.parse(Buffer.concat(chunks).toString())) {
  const found = await run(job);
  const listening = signal && getEventListeners(signal, 'abort').length; // after the end
  console.log(JSON.stringify({ ...found, listening }));
}
