// What PlayCanvas and Spark read from files: node browser_readers.mjs PACKAGES BROWSER PROGRAM FILE...
//
// PACKAGES is the node_modules folder that has them, BROWSER the path of Chromium. Each FILE gets a
// FILE.PROGRAM.json beside it: an array of numbers for each column of a PLY, but opacity from 0
// to 1; or {"error": ...}. A meta.json is read with the files that it names.

import { readFile, writeFile } from "node:fs/promises";
import { createRequire } from "node:module";
import { extname, join } from "node:path";

const [packages, browser, program, ...files] = process.argv.slice(2);
const { chromium } = createRequire(join(packages, "x"))("playwright-core");

const ORIGIN = "http://localhost";
const TYPES = { ".mjs": "text/javascript", ".js": "text/javascript" };
const IMPORTS = {
  playcanvas: "/packages/playcanvas/build/playcanvas.mjs",
  spark: "/packages/@sparkjsdev/spark/dist/spark.module.js",
  three: "/packages/three/build/three.module.js",
  "three/addons/": "/packages/three/examples/jsm/",
};
const PAGE =
  `<canvas></canvas><script type="importmap">${JSON.stringify({ imports: IMPORTS })}</script>`;

const context = await chromium.launch({
  executablePath: browser,
  args: ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"],
});
try {
  const page = await context.newPage();
  page.setDefaultTimeout(60_000);
  // Nothing leaves this machine: every request is answered here.
  await page.route("**/*", async (route) => {
    const path = decodeURIComponent(new URL(route.request().url()).pathname);
    if (path === "/") return route.fulfill({ contentType: "text/html", body: PAGE });
    const [, root, rest] = path.match(/^.(packages|files)(.*)/);
    try {
      const body = await readFile(root === "packages" ? join(packages, rest) : rest);
      return await route.fulfill({ contentType: TYPES[extname(path)] ?? "", body });
    } catch {
      return route.fulfill({ status: 404, body: "" });
    }
  });
  await page.goto(`${ORIGIN}/`);
  const read = { playcanvas: readByPlayCanvas, spark: readBySpark }[program];
  for (const file of files) {
    const columns = await page.evaluate(read, file).catch((error) => ({ error: String(error) }));
    await writeFile(`${file}.${program}.json`, JSON.stringify(columns));
  }
} finally {
  await context.close();
}

// The rest runs in the page.

async function readByPlayCanvas(path) {
  const pc = await import("playcanvas");
  const app = (globalThis.app ??= new pc.Application(document.querySelector("canvas")));
  const load = (type, data) =>
    new Promise((done, failed) => {
      const asset = new pc.Asset(path, type, { url: `/files${path}`, filename: path }, data);
      asset.ready(done);
      asset.on("error", failed);
      app.assets.add(asset);
      app.assets.load(asset);
    });
  const inGltf = path.endsWith(".glb") || path.endsWith(".gltf");
  const asset = inGltf
    ? (await load("container")).resource.gsplats[0]
    : await load("gsplat", { decompress: true });
  const { elements, activated } = asset.resource.gsplatData;
  const columns = {};
  for (const { name, storage } of elements[0].properties) columns[name] = Array.from(storage);
  // `activated`: opacities from 0 to 1, and no logarithms of scales.
  if (!activated) columns.opacity = columns.opacity.map((value) => 1 / (1 + Math.exp(-value)));
  for (const name of activated ? ["scale_0", "scale_1", "scale_2"] : []) {
    columns[name] = columns[name].map(Math.log);
  }
  return columns;
}

async function readBySpark(path) {
  const { ExtSplats, utils } = await import("spark");
  const fileBytes = new Uint8Array(await (await fetch(`/files${path}`)).arrayBuffer());
  const read = new ExtSplats({ fileBytes, fileName: path });
  await read.initialized;
  const splats = read.lodSplats ?? read;
  const columns = {};
  const push = (name, value) => (columns[name] ??= []).push(value);
  const axes = ["x", "y", "z"];
  // Four words for each Gaussian of a tree of levels of detail; children are counted in the third.
  const tree = splats.extra.lodTree;
  const isLeaf = (index) => !(tree && tree[4 * index + 2] & 0xffff);
  splats.forEachSplat((index, center, scales, quaternion, opacity, color) => {
    if (!isLeaf(index)) return;
    axes.forEach((axis, i) => {
      push(axis, center[axis]);
      push(`scale_${i}`, Math.log(scales[axis]));
      push(`rot_${i + 1}`, quaternion[axis]);
    });
    push("rot_0", quaternion.w);
    push("opacity", opacity);
    ["r", "g", "b"].forEach((channel, i) => push(`f_dc_${i}`, (color[channel] - 0.5) / 0.28209479));
  });
  // Four words of 32 bits for each Gaussian in each array, a colour in each word.
  const { sh1, sh2, sh3a, sh3b } = splats.extra;
  const count = [0, 3, 8, 15][splats.getNumSh()];
  for (let i = 0; i < count * splats.numSplats; i++) {
    const [row, k] = [Math.floor(i / count), i % count];
    if (!isLeaf(row)) continue;
    const { r, g, b } = utils.decodeExtRgb([sh1, sh2, sh3a, sh3b][k >> 2][4 * row + (k & 3)]);
    [r, g, b].forEach((value, channel) => push(`f_rest_${channel * count + k}`, value));
  }
  return columns;
}
