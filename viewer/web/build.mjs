// Builds the page: page.html or a named file, all in one file, into which `gs-codec share` puts
// scenes; and inspect.js beside it, which `gs-viewer --web` adds to the page.
import { createHash } from 'node:crypto';
import { readFile, writeFile } from 'node:fs/promises';
import { dirname, resolve } from 'node:path';
import { fileURLToPath } from 'node:url';

import { build } from 'esbuild';

const here = dirname(fileURLToPath(import.meta.url));

/** `text:FILE` is a bundled script as text, from which the page makes workers. */
const texts = {
  name: 'text',
  setup(builder) {
    builder.onResolve({ filter: /^text:/ }, ({ path, resolveDir }) => ({
      path: resolve(resolveDir, path.slice('text:'.length)),
      namespace: 'text',
    }));
    builder.onLoad({ filter: /.*/, namespace: 'text' }, async ({ path }) => ({
      contents: await bundled(path, 'iife'),
      loader: 'text',
    }));
  },
};

/** Pages always decode in workers. */
const workersOnly = {
  name: 'workers',
  setup(builder) {
    const contents = 'export class Here { close() {} release() {} }'; // of a scene without Gaussians
    builder.onLoad({ filter: /\/src\/here\.js$/ }, () => ({ contents }));
  },
};

async function bundled(path, format) {
  const { outputFiles } = await build({
    entryPoints: [path],
    bundle: true,
    minify: true,
    format,
    target: 'es2022',
    write: false,
    legalComments: 'none',
    charset: 'utf8',
    plugins: [texts, workersOnly],
  });
  return outputFiles[0].text.trim();
}

const page = (name) => resolve(here, 'page', name);
const hash = (text) => `'sha256-${createHash('sha256').update(text).digest('base64')}'`;

const script = await bundled(page('main.js'), 'esm');
const style = await bundled(page('page.css'));
// The page loads nothing from outside its own folder, and runs only the built scripts.
const policy = [
  "default-src 'none'",
  `script-src ${hash(script)}`,
  `style-src ${hash(style)}`,
  "style-src-attr 'none'",
  'img-src data:',
  "connect-src 'self'",
  'worker-src blob:',
  "base-uri 'none'",
  "form-action 'none'",
].join('; ');
const parts = {
  policy: `<meta http-equiv="Content-Security-Policy" content="${policy}">`,
  style: `<style>${style}</style>`,
  script: `<script type="module">${script}</script>`,
};
let text = await readFile(page('page.html'), 'utf8');
for (const [name, part] of Object.entries(parts)) text = text.replace(`<!--${name}-->`, () => part);
const out = process.argv[2] ?? resolve(here, 'page.html');
await writeFile(out, text);
await writeFile(resolve(dirname(out), 'inspect.js'), await bundled(page('inspect.js'), 'esm'));
