// Pictures of 3D Tiles by CesiumJS: node cesium_view.mjs PACKAGES BROWSER TILESET VIEWS OUT
//
// PACKAGES is the node_modules folder that has it, BROWSER the path of Chromium. VIEWS is the JSON
// of a list of views: width, height, focal length in pixels; position, direction and up in ECEF;
// and, in the first, `coarse`, the error of tiles in pixels at which the first picture is taken.
// OUT gets first.png, the first picture of the first view, and a NUMBER.png for each view: at full
// detail or, without `coarse`, at the error that CesiumJS accepts by default. For each view,
// drawn.json lists the tiles that were drawn, in turn: an array for each change.

import { readFile, writeFile } from "node:fs/promises";
import { createRequire } from "node:module";
import { dirname, extname, join } from "node:path";

const [packages, browser, tileset, views, out] = process.argv.slice(2);
const { chromium } = createRequire(join(packages, "x"))("playwright-core");

const TYPES = { ".js": "text/javascript", ".json": "application/json", ".css": "text/css" };
const PAGE = `<style>#view * { width: 100%; height: 100% }</style><body style="margin:0"><div id="view" style="position:absolute"></div>
<script>globalThis.CESIUM_BASE_URL = "/packages/cesium/Build/Cesium/";</script>
<script src="/packages/cesium/Build/Cesium/Cesium.js"></script></body>`;

const context = await chromium.launch({
  executablePath: browser,
  args: ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"],
});
try {
  const page = await context.newPage();
  page.setDefaultTimeout(240_000);
  page.on("console", (message) => message.type() === "error" && console.error(message.text()));
  page.on("pageerror", (error) => console.error(error));
  // Nothing leaves this machine: every request is answered here.
  await page.route("**/*", async (route) => {
    const path = decodeURIComponent(new URL(route.request().url()).pathname);
    if (path === "/") return route.fulfill({ contentType: "text/html", body: PAGE });
    const [, root, rest] = path.match(/^.(packages|files)(.*)/) ?? [];
    try {
      const body = await readFile(join(root === "packages" ? packages : dirname(tileset), rest));
      return await route.fulfill({ contentType: TYPES[extname(path)] ?? "", body });
    } catch {
      return route.fulfill({ status: 404, body: "" });
    }
  });
  await page.goto("http://localhost/");
  await page.waitForFunction(() => globalThis.Cesium);
  const found = await page.evaluate(draw, JSON.parse(await readFile(views)));
  for (const [name, url] of Object.entries(found.pictures)) {
    await writeFile(join(out, `${name}.png`), Buffer.from(url.split(",")[1], "base64"));
  }
  await writeFile(join(out, "drawn.json"), JSON.stringify(found.drawn));
} finally {
  await context.close();
}

// This runs in the page.
async function draw(views) {
  const { Cartesian3, Cesium3DTileset, CesiumWidget, Color, PerspectiveFrustum } = Cesium;
  const place = document.querySelector("#view");
  const resize = ({ width, height }) =>
    Object.assign(place.style, { width: `${width}px`, height: `${height}px` });
  resize(views[0]);
  const widget = new CesiumWidget("view", {
    baseLayer: false, globe: false, skyBox: false, skyAtmosphere: false, useDefaultRenderLoop: false,
    contextOptions: { webgl: { preserveDrawingBuffer: true, alpha: false } },
  });
  const { scene } = widget;
  scene.backgroundColor = Color.BLACK;
  scene.fog.enabled = false;
  for (const name of ["moon", "sun"]) if (scene[name]) scene[name].show = false;
  const tileset = await Cesium3DTileset.fromUrl("/files/tileset.json");
  if (views[0].coarse) tileset.maximumScreenSpaceError = views[0].coarse;
  scene.primitives.add(tileset);
  const drawn = views.map(() => []);
  const pictures = {};
  const uris = () => tileset._selectedTiles.map((tile) => tile._contentResource.url).sort();
  for (const [number, view] of views.entries()) {
    resize(view);
    widget.resize();
    const vector = (name) => Cartesian3.fromArray(view[name]);
    scene.camera.setView({
      destination: vector("position"),
      orientation: { direction: vector("direction"), up: vector("up") },
    });
    const { width, height, focal } = view;
    const half = Math.atan(Math.max(width, height) / (2 * focal));
    scene.camera.frustum = new PerspectiveFrustum({
      fov: 2 * half, aspectRatio: width / height, near: view.near, far: view.far,
    });
    for (let turn = 0, quiet = 0; turn < 4000 && quiet < 30; turn++) {
      widget.render();
      const primitive = tileset.gaussianSplatPrimitive;
      // A moved camera sorts the splats again, which `isStable` leaves out; 0 is idle.
      const sorted = primitive?.isStable && primitive._sorterState === 0;
      const shown = sorted && primitive._numSplats > 0 && tileset.tilesLoaded;
      const changed = JSON.stringify(uris()) !== JSON.stringify(drawn[number].at(-1));
      if (changed) drawn[number].push(uris());
      if (shown && !pictures.first) {
        pictures.first = scene.canvas.toDataURL();
        if (view.coarse) tileset.maximumScreenSpaceError = 0;
      }
      quiet = shown && !changed ? quiet + 1 : 0;
      await new Promise((done) => setTimeout(done, 10));
    }
    pictures[number] = scene.canvas.toDataURL();
  }
  return { drawn, pictures };
}
