// A camera that turns around a place, upright

const STEEPEST = 1.54; // radians above or below: a little less than from right above
const NEAREST = 0.02; // of the distance at the start, and
const FARTHEST = 20;
const FILLED = 0.8; // of the picture, by what is approached

export const plus = (a, b, times = 1) => a.map((value, axis) => value + times * b[axis]);
export const dot = (a, b) => a.reduce((sum, value, axis) => sum + value * b[axis], 0);
export const scaled = (a, times) => a.map((value) => times * value);
export const unit = (a) => scaled(a, 1 / Math.hypot(...a));
export const cross = ([a, b, c], [x, y, z]) => [b * z - c * y, c * x - a * z, a * y - b * x];

export class Orbit {
  constructor(start) {
    this.start = start;
    this.up = unit(start.up);
    const least = this.up.map(Math.abs).indexOf(Math.min(...this.up.map(Math.abs)));
    this.side = unit(cross(this.up, [0, 1, 2].map((axis) => Number(axis === least))));
    this.ahead = cross(this.up, this.side);
    this.reset();
  }

  reset() {
    this.stand(this.start.position, this.start.target);
  }

  stand(position, target) {
    const away = plus(position, target, -1);
    this.target = target;
    this.distance = Math.hypot(...away);
    this.turned = Math.atan2(dot(away, this.ahead), dot(away, this.side));
    this.raised = Math.asin(dot(away, this.up) / this.distance);
    this.turn(0, 0);
  }

  // From where it is, but so near that a box, by its middle and its sides, fills most of a picture
  approach(centre, sides, size) {
    const { viewmat, focal } = this.view(size);
    const corners = [0, 1, 2, 3, 4, 5, 6, 7].map((bits) => sides.map((side, axis) => ((bits >> axis) & 1 ? 0.5 : -0.5) * side));
    const needed = corners.flatMap((corner) => {
      const [x, y, z] = [0, 1, 2].map((row) => dot(corner, viewmat.slice(4 * row, 4 * row + 3)));
      return [[x, size[0]], [y, size[1]]].map(([off, pixels]) => (2 * Math.abs(off) * focal[0]) / (FILLED * pixels) - z);
    });
    this.target = centre;
    this.distance = Math.max(...needed);
  }

  turn(aside, above) {
    this.turned += aside;
    this.raised = Math.max(-STEEPEST, Math.min(STEEPEST, this.raised + above));
  }

  zoom(times) {
    const whole = Math.hypot(...plus(this.start.position, this.start.target, -1));
    const wanted = Math.max(NEAREST * whole, this.distance * times);
    this.distance = Math.min(FARTHEST * whole, wanted);
  }

  // Along its own axes, by shares of the distance to what it turns around
  fly(right, down, forward) {
    const { viewmat } = this.view([1, 1]);
    [right, down, forward].forEach((share, axis) => {
      this.target = plus(this.target, viewmat.slice(4 * axis, 4 * axis + 3), share * this.distance);
    });
  }

  // By shares of the picture's height, to the right and down
  shift(right, down, size) {
    const { viewmat, focal } = this.view(size);
    const pixel = (this.distance * size[1]) / focal[0];
    this.target = plus(this.target, viewmat.slice(0, 3), right * pixel);
    this.target = plus(this.target, viewmat.slice(4, 7), down * pixel);
  }

  // What the start showed is in every picture, whatever its shape
  view([width, height]) {
    const level = plus(scaled(this.side, Math.cos(this.turned)), this.ahead, Math.sin(this.turned));
    const away = plus(scaled(level, Math.cos(this.raised)), this.up, Math.sin(this.raised));
    const eye = plus(this.target, away, this.distance);
    const forward = scaled(away, -1), right = unit(cross(forward, this.up));
    const rows = [right, cross(forward, right), forward];
    const focal = Math.min(width / this.start.slopes[0], height / this.start.slopes[1]);
    return {
      viewmat: [...rows.flatMap((row) => [...row, -dot(row, eye)]), 0, 0, 0, 1],
      focal: [focal, focal],
      centre: [width / 2, height / 2],
    };
  }
}
