// Decodes files as long as stdin gives some, for fuzzing: u32 of the size, then the bytes of each.
//
//     node decode_each.mjs MAX_BYTES
//
// A line of JSON for each: what comes of the scene, what of its levels, and most MiB ever in use.
import { createHash } from 'node:crypto';
import { readFileSync } from 'node:fs';

import { decode, open } from '../../viewer/web/src/index.js';

const MOST = Number(process.argv[2]);
const ARRAYS = ['positions', 'fDc', 'fRest', 'opacity', 'logScale', 'rotation'];

/** SHA-256 of floats of a scene. */
function digest(scene) {
  const hash = createHash('sha256');
  for (const name of ARRAYS) hash.update(new Uint8Array(scene[name].buffer));
  return hash.digest('hex');
}

/** Most KiB in use: what getrusage tells begins with those of the process that forked this one. */
function mostResident() {
  return Number(/VmHWM:\s+(\d+)/.exec(readFileSync('/proc/self/status', 'latin1'))[1]);
}

/** What work gives, or the error. */
async function outcome(work) {
  try {
    return await work();
  } catch ({ name, message }) {
    return { error: name, message };
  }
}

async function whole(data) {
  const scene = await decode(data, { maxBytes: MOST, workers: 0 });
  const { count, degree, coordinates, antialiased } = scene;
  return { digest: digest(scene), facts: [count, degree, coordinates, antialiased] };
}

/** Digests of levels; `skipped` if there are none, or more than one may hold. */
async function levels(data) {
  const file = await open(data, { workers: 0 });
  try {
    const { length, 0: scene } = file.levels;
    if (length === 1 || 4 * scene.count * 59 > MOST) return { skipped: true };
    const digests = [];
    for (let level = 1; level < length; level++) {
      const blocks = [...Array(file.levels[level].blocks).keys()];
      digests.push(digest(await file.decode(level, blocks)));
    }
    return { digests };
  } finally {
    file.close();
  }
}

let waiting = Buffer.alloc(0);
for await (const chunk of process.stdin) {
  waiting = Buffer.concat([waiting, chunk]);
  for (let end; waiting.length >= 4 && waiting.length >= (end = 4 + waiting.readUInt32LE(0));) {
    const data = Uint8Array.from(waiting.subarray(4, end));
    waiting = waiting.subarray(end);
    const scene = await outcome(() => whole(data));
    const found = await outcome(() => levels(data));
    const peak = Math.ceil(mostResident() / 1024);
    process.stdout.write(`${JSON.stringify({ scene, levels: found, peak })}\n`);
  }
}
