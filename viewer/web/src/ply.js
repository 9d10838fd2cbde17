// Convert scenes to PLY, for programs that read no other format.

/** The bytes of a binary PLY file in the layout of the INRIA trainer. */
export function toPly(scene) {
  const names = scene.properties;
  const comments = [...scene.comments];
  if (scene.antialiased) comments.push('SplatRenderMode: mip');
  if (scene.coordinates) comments.push(`CoordinateSystem: ${scene.coordinates}`);
  const header = [
    'ply',
    'format binary_little_endian 1.0',
    ...comments.map((line) => `comment ${line}`),
    `element vertex ${scene.count}`,
    ...names.map((name) => `property float ${name}`),
    'end_header\n',
  ];
  const text = new TextEncoder().encode(header.join('\n'));
  const data = new Uint8Array(text.length + 4 * names.length * scene.count);
  data.set(text);
  const view = new DataView(data.buffer);
  names.forEach((name, k) => {
    const plane = scene.property(name);
    let at = text.length + 4 * k;
    for (let i = 0; i < plane.length; i++, at += 4 * names.length) {
      view.setFloat32(at, plane[i], true);
    }
  });
  return data;
}
