// The Gaussians as they were packed: see figures/web_page.py. Every column is for all of them, sorted
// by place; positions have two bytes, high ones first.

export const WORDS = 12; // of a Gaussian: centre 3, covariance 6, colour and opacity after and before, bands

export async function inflated(packed) {
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

// What the graphics card reads: 12 words a Gaussian, and the centres once more for sorting
export function unpack(bytes, about) {
  let start = 0;
  const take = (count) => bytes.subarray(start, (start += count));
  const times = (number, count) => Array.from({ length: number }, () => take(count));
  const count = about.count;
  const means = times(6, count);
  const scales = times(3, count);
  const largest = take(count);
  const turns = times(3, count);
  const opacities = take(count);
  const colors = times(3, count);
  const painted = take(count);
  const before = times(4, about.painted); // the last are opacities
  const palettes = times(2, 256 * 3 * about.bands);
  const bands = about.bands ? times(2, count) : [];
  const bandsBefore = about.bands ? times(2, about.painted) : [];

  const floats = new Float32Array(WORDS * count);
  const words = new Uint32Array(floats.buffer);
  const centres = new Float32Array(3 * count);
  const word = (columns, row) => columns.reduce((sum, column, n) => sum | (column[row] << (8 * n)), 0);
  let paintedRow = 0; // how many painted ones there were
  for (let row = 0; row < count; row++) {
    const first = WORDS * row;
    for (let axis = 0; axis < 3; axis++) {
      const step = 256 * means[2 * axis][row] + means[2 * axis + 1][row];
      const place = between(step / 65535, about.means[axis]);
      floats[first + axis] = about.middle[axis] + about.reach * Math.sinh(place);
      centres[3 * row + axis] = floats[first + axis];
    }
    const deviations = scales.map((column) => Math.exp(between(column[row] / 255, about.scales)));
    floats.set(covariance(turn(largest[row], turns.map((column) => column[row])), deviations), first + 3);
    words[first + 9] = words[first + 10] = word(colors, row) | (opacities[row] << 24);
    words[first + 11] = word(bands, row) * (1 + (1 << 16));
    if (!painted[row]) continue;
    words[first + 10] = word(before, paintedRow);
    words[first + 11] = word(bands, row) | (word(bandsBefore, paintedRow) << 16);
    paintedRow++;
  }
  return { count, words, centres, palettes };
}

function between(share, [low, high]) {
  return low + (high - low) * share;
}

// A rotation of which the largest number is left out: the squares of all four add up to 1
function turn(largest, bytes) {
  const others = bytes.map((byte) => (2 * byte / 255 - 1) * Math.SQRT1_2);
  const rest = others.reduce((sum, value) => sum + value * value, 0);
  others.splice(largest, 0, Math.sqrt(Math.max(0, 1 - rest)));
  return others; // w, x, y, z
}

function covariance([w, x, y, z], deviations) {
  const axes = [
    [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
    [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
    [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
  ].map((line) => line.map((value, axis) => value * deviations[axis]));
  const entry = (one, other) => axes[one].reduce((sum, v, axis) => sum + v * axes[other][axis], 0);
  return [entry(0, 0), entry(0, 1), entry(0, 2), entry(1, 1), entry(1, 2), entry(2, 2)];
}
