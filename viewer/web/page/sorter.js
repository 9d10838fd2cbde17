// A worker that sorts Gaussians by depth, farthest first.

let positions = new Float32Array(0); // x, y, z of each Gaussian
let known = []; // ranges [first, end] that are decoded, or to be drawn

self.onmessage = ({ data }) => {
  if (data.count !== undefined) {
    const before = positions;
    positions = new Float32Array(3 * data.count);
    for (const [from, to] of data.moves ?? []) {
      positions.set(before.subarray(3 * from, 3 * (from + data.size)), 3 * to);
    }
    known = [];
  }
  if (data.block) {
    positions.set(data.block, 3 * data.first);
    if (!data.again) known.push([data.first, data.first + data.block.length / 3]);
  }
  if (data.eye) {
    known = data.ranges ?? known;
    const order = ordered(data.eye, data.forward);
    self.postMessage({ order, size: positions.length, shown: data.shown }, [order.buffer]);
  }
};

function ordered(eye, [x, y, z]) {
  const count = known.reduce((sum, [first, end]) => sum + end - first, 0);
  const depths = new Float32Array(count);
  const indices = new Uint32Array(count);
  const offset = -(x * eye[0] + y * eye[1] + z * eye[2]);
  let seen = 0;
  for (const [first, end] of known) {
    for (let i = first, at = 3 * first; i < end; i++, at += 3) {
      const depth = x * positions[at] + y * positions[at + 1] + z * positions[at + 2] + offset;
      if (!(depth > 0 && depth < Infinity)) continue;
      depths[seen] = depth;
      indices[seen++] = i;
    }
  }
  return byDepth(new Uint32Array(depths.buffer, 0, seen), indices);
}

/** Indices by depth, farthest first; `keys` are the bits of depths, in at least 65,536 steps. */
function byDepth(keys, indices) {
  if (keys.length === 0) return keys;
  // Bits of positive floats sort like the numbers, and are finer for nearer ones.
  let [least, most] = [2 ** 32, 0];
  for (const key of keys) {
    if (key < least) least = key;
    if (key > most) most = key;
  }
  const shift = Math.max(0, 15 - Math.clz32(most - least));
  const starts = new Uint32Array(((most - least) >>> shift) + 2);
  for (let k = 0; k < keys.length; k++) starts[(keys[k] = (most - keys[k]) >>> shift) + 1]++;
  for (let k = 1; k < starts.length; k++) starts[k] += starts[k - 1];
  const order = new Uint32Array(keys.length);
  for (let k = 0; k < keys.length; k++) order[starts[keys[k]]++] = indices[k];
  return order;
}
