// Decodes files as test_web_decoder.py asks: a list of jobs as JSON on stdin, a line for each.
import { createHash } from 'node:crypto';
import { readFileSync } from 'node:fs';
import { createServer } from 'node:http';
import { Worker } from 'node:worker_threads';

import { decode } from '../../viewer/web/src/index.js';

const ARRAYS = ['positions', 'fDc', 'fRest', 'opacity', 'logScale', 'rotation'];

/** A worker of Node that looks like one of a browser. */
function nodeWorker() {
  const worker = new Worker(new URL('./node_worker.mjs', import.meta.url));
  const wrapped = {
    postMessage: (message) => worker.postMessage(message),
    terminate: () => worker.terminate(),
  };
  worker.on('message', (data) => wrapped.onmessage({ data }));
  worker.on('error', (error) => wrapped.onerror(error));
  return wrapped;
}

/** A stream of chunks of a size, which ends with an error after `broken` bytes. */
function streamed(data, size, broken = Infinity) {
  let at = 0;
  return new ReadableStream({
    pull(controller) {
      if (at >= broken) controller.error(new Error('reset'));
      else if (at >= data.length) controller.close();
      else controller.enqueue(new Uint8Array(data.subarray(at, (at += size))));
    },
  });
}

/** Serve a file; what was asked for goes to `asked`. */
async function served(data, ranges, asked, work) {
  const server = createServer((request, response) => {
    const range = /^bytes=(\d+)-(\d+)$/.exec(request.headers.range ?? '');
    asked.push(range ? [Number(range[1]), Number(range[2]) + 1] : null);
    if (request.url !== '/scene.egs') return response.writeHead(404).end();
    if (!range || !ranges) return response.writeHead(200).end(data);
    return response
      .writeHead(206, { 'Content-Range': `bytes ${range[1]}-${range[2]}/${data.length}` })
      .end(data.subarray(Number(range[1]), Number(range[2]) + 1));
  });
  await new Promise((resolve) => server.listen(0, '127.0.0.1', resolve));
  try {
    return await work(`http://127.0.0.1:${server.address().port}`);
  } finally {
    server.close();
  }
}

async function run(job) {
  const data = job.bytes !== undefined ? Buffer.from(job.bytes, 'base64') : readFileSync(job.path);
  const told = { blocks: [], asked: [], progress: [] };
  const options = {
    shDegree: job.shDegree,
    box: job.box,
    maxBytes: job.maxBytes,
    workers: job.workers ?? 0,
    createWorker: nodeWorker,
    onBlock: (scene, part) => told.blocks.push([part.block, part.degree, part.first, part.count]),
    onProgress: (bytes, of) => told.progress.push([bytes, of]),
  };
  const kinds = {
    bytes: () => decode(data, options),
    buffer: () => decode(new Uint8Array(data).buffer, options),
    blob: () => decode(new Blob([data]), options),
    stream: () => decode(streamed(data, job.chunk, job.broken), options),
    response: () => decode(new Response(data), options),
    url: () => served(data, true, told.asked, (host) => decode(`${host}/scene.egs`, options)),
    unranged: () =>
      served(data, false, told.asked, (host) => decode(new URL(`${host}/scene.egs`), options)),
    missing: () => served(data, true, told.asked, (host) => decode(`${host}/none.egs`, options)),
    aborted: () => {
      const controller = new AbortController();
      options.signal = controller.signal;
      options.onBlock = () => controller.abort();
      return decode(data, options);
    },
    number: () => decode(7, options),
  };
  try {
    const scene = await kinds[job.as ?? 'bytes']();
    const hash = createHash('sha256');
    for (const name of ARRAYS) hash.update(new Uint8Array(scene[name].buffer));
    const properties = createHash('sha256');
    for (const name of scene.properties) {
      const plane = scene.property(name);
      properties.update(new Uint8Array(plane.buffer, plane.byteOffset, plane.byteLength));
    }
    const { count, degree, profile, coordinates, antialiased, comments } = scene;
    const facts = { count, degree, profile, coordinates, antialiased, comments };
    return { ...facts, ...told, hash: hash.digest('hex'), properties: properties.digest('hex') };
  } catch (error) {
    return { error: error.name, message: error.message, ...told };
  }
}

const chunks = [];
for await (const chunk of process.stdin) chunks.push(chunk);
for (const job of JSON.parse(Buffer.concat(chunks).toString())) {
  console.log(JSON.stringify(await run(job)));
}
