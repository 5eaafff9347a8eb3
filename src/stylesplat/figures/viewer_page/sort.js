// Which Gaussians are before the camera, the farthest first

export const NEAR = 0.01; // nothing nearer is drawn
const DIGIT = 12; // bits that are sorted by at once; two digits tell depths apart to a millionth

// The rows come in an array whose length is a multiple of `wide`
export function sorter(centres, wide) {
  const count = centres.length / 3;
  const depths = new Float32Array(count);
  const bits = new Uint32Array(depths.buffer); // of positive numbers have the same order
  const seen = new Uint32Array(count);
  const half = new Uint32Array(count);
  const order = new Uint32Array(wide * Math.ceil(count / wide));

  return (viewmat) => {
    const [x, y, z, shift] = viewmat.slice(8, 12); // the row that gives depth
    let rows = 0;
    for (let row = 0; row < count; row++) {
      const depth = x * centres[3 * row] + y * centres[3 * row + 1] + z * centres[3 * row + 2] + shift;
      depths[row] = depth;
      if (depth > NEAR) seen[rows++] = row;
    }
    byDigit(bits, seen, half, rows, 31 - 2 * DIGIT);
    byDigit(bits, half, order, rows, 31 - DIGIT);
    return { order, rows };
  };
}

// The rows in `from`, those with larger digits first, and else as they were
function byDigit(keys, from, to, count, shift) {
  const mask = (1 << DIGIT) - 1;
  const places = new Uint32Array(1 << DIGIT);
  for (let n = 0; n < count; n++) places[(keys[from[n]] >>> shift) & mask]++;
  for (let digit = mask, sum = 0; digit >= 0; digit--) {
    sum += places[digit];
    places[digit] = sum - places[digit];
  }
  for (let n = 0; n < count; n++) to[places[(keys[from[n]] >>> shift) & mask]++] = from[n];
}
