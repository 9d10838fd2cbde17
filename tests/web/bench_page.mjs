// What a page of a scene fetches: node bench_page.mjs FOLDER [BITS_PER_SECOND]
//
// FOLDER is what `gs-codec share` wrote. Serves it with ranges, opens it in Chromium (CHROMIUM names
// it), goes to every second view, and prints seconds and the bytes of scenes that were sent.
import { open, readFile } from 'node:fs/promises';
import { createServer } from 'node:http';
import { resolve } from 'node:path';

import { chromium } from 'playwright-core';

const [folder, rate] = process.argv.slice(2);
if (!folder) throw new Error('usage: node bench_page.mjs FOLDER [BITS_PER_SECOND]');

let sent = 0;
let total = 0;
const server = createServer(async ({ url, headers }, response) => {
  const path = resolve(folder, url === '/' ? 'index.html' : `.${decodeURIComponent(url)}`);
  if (url === '/') {
    return response.setHeader('Content-Type', 'text/html').end(await readFile(path));
  }
  const file = await open(path);
  try {
    const { size } = await file.stat();
    total = size;
    const [, begin, last] = /^bytes=(\d+)-(\d+)$/.exec(headers.range ?? '') ?? [0, 0, size - 1];
    const data = Buffer.alloc(Math.min(+last + 1, size) - begin);
    await file.read(data, 0, data.length, +begin);
    sent += data.length;
    const range = `bytes ${begin}-${+begin + data.length - 1}/${size}`;
    return response.writeHead(headers.range ? 206 : 200, { 'Content-Range': range }).end(data);
  } finally {
    await file.close();
  }
});
await new Promise((done) => server.listen(0, '127.0.0.1', done));
const browser = await chromium.launch({
  executablePath: process.env.CHROMIUM ?? '/usr/bin/chromium',
  args: ['--no-sandbox', '--use-angle=swiftshader', '--enable-unsafe-swiftshader'],
});
try {
  const page = await browser.newPage({ viewport: { width: 600, height: 400 } });
  page.setDefaultTimeout(600_000);
  if (rate) {
    const client = await page.context().newCDPSession(page);
    const limits = { offline: false, latency: 40, uploadThroughput: -1 };
    const network = { ...limits, downloadThroughput: rate / 8 };
    await client.send('Network.emulateNetworkConditions', network);
  }
  const begun = performance.now();
  const told = () => page.evaluate(() => document.querySelector('.detail')?.textContent ?? '');
  const tell = async (name, about) => {
    const seconds = ((performance.now() - begun) / 1000).toFixed(2);
    const share = `${(sent / 1e6).toFixed(2)} MB, ${((100 * sent) / total).toFixed(1)} % sent`;
    console.log(`${name}: ${seconds} s, ${share}; ${about ?? (await told())}`);
  };
  await page.goto(`http://127.0.0.1:${server.address().port}/`);
  const first = await page.waitForFunction(() => {
    const canvas = document.getElementById('view');
    const gl = canvas.getContext('webgl2');
    const pixels = new Uint8Array(4 * canvas.width * canvas.height);
    gl.readPixels(0, 0, canvas.width, canvas.height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
    const isDrawn = pixels.some((value, k) => k % 4 < 3 && value > 0);
    return isDrawn && (document.querySelector('.detail').textContent || 'no levels');
  });
  await tell('first picture', await first.jsonValue());
  const isReady = () => document.body.dataset.state === 'ready';
  await page.waitForFunction(isReady);
  await tell('sharp');
  for (let view = 2; view <= 6; view += 2) {
    await page.selectOption('#views', `${view}`);
    await page.waitForFunction(isReady);
    await tell(`view ${view}, sharp`);
  }
} finally {
  await browser.close();
  server.close();
}
