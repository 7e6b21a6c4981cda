// Unpack an appearance: the header's length, the header as JSON, arrays of floats.

export function unpack(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const appearance = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  let at = 4 + length;
  for (const [name, shape] of appearance.arrays) {
    const count = shape.reduce((a, b) => a * b, 1);
    appearance[name] = new Float32Array(buffer, at, count);
    at += 4 * count;
  }
  return appearance;
}
