// How long a browser takes for a file: node bench.mjs FILE.egs [WORKERS [ROUNDS]]
//
// Decodes it in Chromium (CHROMIUM names it), and prints medians: milliseconds to typed arrays, and
// the share of the file that was read when the first Gaussians could be drawn.
import { readFile } from 'node:fs/promises';
import { createServer } from 'node:http';
import { dirname, resolve } from 'node:path';
import { fileURLToPath } from 'node:url';

import { chromium } from 'playwright-core';

const web = resolve(dirname(fileURLToPath(import.meta.url)), '../../viewer/web');
const [file, workers = '4', rounds = '7'] = process.argv.slice(2);
if (!file) throw new Error('usage: node bench.mjs FILE.egs [WORKERS [ROUNDS]]');

/** Run in the page. */
async function measure([workers, rounds]) {
  const { decode } = await import('./src/index.js');
  const data = await (await fetch('./scene.egs')).arrayBuffer();
  const times = [];
  for (let k = 0; k <= rounds; k++) {
    const begin = performance.now();
    await decode(data, { workers });
    times.push(performance.now() - begin);
  }
  // Slowly, so that what is read is decoded before more is.
  let read = 0;
  let first;
  const slow = new ReadableStream({
    async pull(controller) {
      await new Promise((done) => setTimeout(done, first === undefined ? 50 : 0));
      controller.enqueue(new Uint8Array(data.slice(read, read + 65_536)));
      read = Math.min(read + 65_536, data.byteLength);
      if (read === data.byteLength) controller.close();
    },
  });
  const onBlock = () => (first ??= read / data.byteLength);
  const scene = await decode(slow, { workers, onBlock });
  const sorted = times.slice(1).sort((a, b) => a - b); // the first compiles
  return { count: scene.count, median: sorted[sorted.length >> 1], best: sorted[0], first };
}

const types = { '.js': 'text/javascript', '.egs': 'application/octet-stream' };
const server = createServer(async ({ url }, response) => {
  if (url === '/') return response.setHeader('Content-Type', 'text/html').end('<!doctype html>');
  const path = url === '/scene.egs' ? resolve(file) : resolve(web, `.${url}`);
  try {
    response.setHeader('Content-Type', types[path.slice(path.lastIndexOf('.'))] ?? 'text/plain');
    return response.end(await readFile(path));
  } catch {
    return response.writeHead(404).end();
  }
});
await new Promise((done) => server.listen(0, '127.0.0.1', done));
const browser = await chromium.launch({
  executablePath: process.env.CHROMIUM ?? '/usr/bin/chromium',
  args: ['--no-sandbox'],
});
try {
  const page = await browser.newPage();
  await page.goto(`http://127.0.0.1:${server.address().port}/`);
  const { count, median, best, first } = await page.evaluate(measure, [+workers, +rounds]);
  const share = `${(100 * first).toFixed(1)} % of the bytes`;
  console.log(
    `${count} Gaussians, ${workers} workers: ${Math.round(median)} ms (best ${Math.round(best)}); first Gaussians after ${share}`,
  );
} finally {
  await browser.close();
  server.close();
}
