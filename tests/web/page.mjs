// Opens pages in Chromium as test_web_page.py asks: JSON on stdin, a line of JSON for each page.
//
//     node page.mjs CHROMIUM < jobs.json
//
// A job has a `url`, a `size`, and `steps`, each of which is [name, ...arguments]; see STEPS.
import { readFileSync } from 'node:fs';

import { chromium } from 'playwright-core';

/** Maximum milliseconds of a step. */
const PATIENCE = 180_000;

/** The first true value of a script of the page, whether or not the page draws frames. */
async function firstOf(page, script) {
  const orLoading = (error) => {
    if (!error.message.includes('navigation')) throw error;
  };
  const end = performance.now() + PATIENCE;
  for (;;) {
    const value = await page.evaluate(script).catch(orLoading);
    if (value) return value;
    if (performance.now() > end) throw new Error(`never true: ${script}`);
    await page.waitForTimeout(20);
  }
}

const STEPS = {
  /** Until everything is loaded and drawn. */
  drawn: (page) => STEPS.until(page, "['ready', 'error'].includes(document.body?.dataset.state)"),
  /** A picture of the page without what lies above the scene; its file is a value. */
  async shot(page, path) {
    await STEPS.drawn(page);
    const cover = (visibility) =>
      page.evaluate((value) => {
        for (const cover of document.querySelectorAll('#panel, #told, #bar, #wipe, #stick')) {
          cover.style.visibility = value;
        }
      }, visibility);
    await cover('hidden');
    await page.screenshot({ path });
    await cover('');
  },
  key: (page, name) => page.keyboard.press(name),
  /** Keys, as `Shift+w`, that are held for some time. */
  async hold(page, names, milliseconds) {
    const keys = names.split('+');
    for (const key of keys) await page.keyboard.down(key);
    await page.waitForTimeout(milliseconds);
    for (const key of keys) await page.keyboard.up(key);
  },
  /** A click on the scene. */
  press: (page) => page.mouse.click(150, 100),
  click: (page, selector) => page.click(selector),
  choose: (page, selector, value) => page.selectOption(selector, value),
  focus: (page, selector) => page.focus(selector),
  wheel: async (page, amount) => {
    await page.mouse.move(150, 100);
    await page.mouse.wheel(0, amount);
    await page.waitForTimeout(100);
  },
  /** A drag through points, by so many events each. */
  async drag(page, points, events, button = 'left') {
    await page.mouse.move(...points[0]);
    await page.mouse.down({ button });
    for (const point of points.slice(1)) await page.mouse.move(...point, { steps: events });
    await page.mouse.up({ button });
  },
  /** A drag of a slider through shares of its length. */
  async slide(page, selector, shares) {
    const { x, y, width, height } = await page.locator(selector).boundingBox();
    const points = shares.map((share) => [x + 8 + share * (width - 16), y + height / 2]);
    await STEPS.drag(page, points, 4);
  },
  /** Fingers, each a list of points, all as many. */
  async touch(page, fingers) {
    const client = await page.context().newCDPSession(page);
    const send = (type, touchPoints) =>
      client.send('Input.dispatchTouchEvent', { type, touchPoints });
    const at = (k) => fingers.map((points, id) => ({ x: points[k][0], y: points[k][1], id }));
    await send('touchStart', at(0));
    for (let k = 1; k < fingers[0].length; k++) await send('touchMove', at(k));
    await send('touchEnd', []);
  },
  /** Until a script of the page is true. */
  async until(page, script) {
    await firstOf(page, script);
  },
  /** What axe-core objects to, and where. */
  async axe(page) {
    const script = new URL('node_modules/axe-core/axe.min.js', import.meta.url);
    await page.evaluate(readFileSync(script, 'utf8'));
    return page.evaluate(async () => {
      const rules = { 'target-size': { enabled: true } };
      const { violations } = await globalThis.axe.run({ rules });
      return violations.flatMap(({ id, nodes }) => nodes.map(({ target }) => `${id}: ${target}`));
    });
  },
  /** The value of a script. */
  value: (page, script) => page.evaluate(script),
  /** The file that a click has one save. */
  async saved(page, selector, path) {
    const [download] = await Promise.all([page.waitForEvent('download'), page.click(selector)]);
    await download.saveAs(path);
    return download.suggestedFilename();
  },
};

const browser = await chromium.launch({
  executablePath: process.argv[2],
  args: ['--no-sandbox', '--use-angle=swiftshader', '--enable-unsafe-swiftshader'],
});
for (const { url, size, steps, before, panel, mobile, locale } of JSON.parse(readFileSync(0, 'utf8'))) {
  const [width, height] = size;
  const screen = { viewport: { width, height }, hasTouch: true, isMobile: mobile };
  const context = await browser.newContext({ ...screen, locale });
  const page = await context.newPage();
  page.setDefaultTimeout(PATIENCE);
  const told = { values: [], requests: [], errors: [] };
  page.on('request', (request) => told.requests.push(request.url()));
  page.on('pageerror', (error) => told.errors.push(error.message));
  page.on('console', (message) => {
    if (message.type() === 'error') told.errors.push(message.text());
  });
  if (before) await page.addInitScript(before);
  try {
    await page.goto(url);
    if (panel) await page.click('summary');
    for (const [name, ...given] of steps)
      told.values.push((await STEPS[name](page, ...given)) ?? null);
    // What comes late, as the last order or a request that was ended, is drawn once more.
    const isDrawn = "(({ state }) => state !== 'drawing' && { state })(document.body.dataset)";
    told.state = (await firstOf(page, isDrawn)).state;
    told.status = await page.textContent('#status');
  } catch (error) {
    const state = await page.getAttribute('body', 'data-state', { timeout: 5000 }).catch(String);
    told.failure = `${error.message} The page's state: ${state}`;
  }
  process.stdout.write(`${JSON.stringify(told)}\n`);
  await context.close();
}
await browser.close();
