// What lies over the picture: the glow and outline of objects, cameras, a box, lines that are drawn

import { plus, scaled } from "/viewer/camera.js";
import { inflated } from "/viewer/unpack.js";
import { settings, showPhotos, tool } from "./choices.js";
import { hello, state } from "./connection.js";
import { activeLayer } from "./layers.js";

const PICKED = [255, 168, 48], POINTED = [110, 180, 255];
const SELECTED = [90, 200, 255], SELECTED_TINT = 90;
const TINT = 64, EDGE = 240; // of 255, inside an object and along its outline
export const KNOB_NEAR = 20, KNOB_STEP = 22; // pixels: the circle at stroke size 0, and more for each 1
const MOST_PHOTOS = 60;
// Pairs of corners of a box that differ in one axis, where bits of a corner are its axes
const EDGES = [0, 1, 2, 3, 4, 5, 6, 7].flatMap((a) => [1, 2, 4].filter((bit) => !(a & bit)).map((bit) => [a, a | bit]));

export class Overlay {
  constructor(viewport) {
    this.viewport = viewport;
    this.map = this.picked = this.pointed = null;
    this.glow = document.createElement("canvas");
    this.light = document.createElement("canvas");
    this.shape = document.createElement("canvas"); // the object whose strokes are changed
    this.pattern = null; // the picture of these strokes
    this.box = null; // its lower and upper corners
    this.line = []; // that is being drawn, in pixels
    this.ball = null; // its middle and radius in pixels
  }

  async setMap({ look, size, names }, bytes) {
    const content = await inflated(bytes);
    const count = size[0] * size[1];
    this.map = { look, size, names, ids: content.subarray(0, count), depths: new DataView(content.buffer, content.byteOffset + count) };
    this.viewport.root.dataset.map = look;
    this.setPointed(this.pointed, true);
    this.draw();
    const { tools } = this.viewport;
    if (tools.early && tools.early.look === look) tools.pickIn(...tools.early.place);
  }

  async setPicked({ look, size, names, selected }, bytes) {
    const shares = bytes.length ? await inflated(bytes) : null;
    this.setGlow({ look, size, names, shares: selected && shares, inside: shares && ((row) => shares[row] > (selected ? 127 : 100)) });
    this.viewport.root.dataset.picked = `${look} ${names.join(",")}`;
  }

  // Of objects that are picked at this moment, before the server has told
  guessPicked(names) {
    if (!this.isCurrent(this.map)) return;
    const { look, size, ids } = this.map;
    const numbers = new Set(names.map((name) => this.map.names.indexOf(name) + 1).filter(Boolean));
    this.setGlow({ look, size, names, inside: (row) => numbers.has(ids[row]) });
  }

  setGlow(picked) {
    this.picked = { ...picked, tint: glowing(picked.names) };
    if (picked.shares) faded(this.glow, picked.size, picked.shares, picked.inside);
    else if (picked.inside) outlined(this.glow, picked.size, picked.inside, PICKED, this.picked.tint);
    else this.glow.width = 0;
    this.draw();
  }

  // The tint goes when a painting begins, and all of it when nothing is picked any more
  tintAgain() {
    const { objects, selection } = state.value;
    if (this.picked?.inside && !selection && !objects.some((each) => each.picked)) this.setGlow({ ...this.picked, names: [], inside: null, shares: null });
    if (this.picked && this.picked.tint !== glowing(this.picked.names)) this.setGlow(this.picked);
  }

  setPointed(name, again = false) {
    if (name === this.pointed && !again) return;
    this.pointed = name;
    const number = this.map ? this.map.names.indexOf(name) + 1 : 0;
    if (number) outlined(this.light, this.map.size, (row) => this.map.ids[row] === number, POINTED);
    else this.light.width = 0;
    this.draw();
  }

  // A style picture on an object, in the size and direction of its strokes, until they are painted
  setPattern(name, url) {
    const number = name && this.isCurrent(this.map) ? this.map.names.indexOf(name) + 1 : 0;
    if (number && this.pattern?.url !== url) {
      const image = Object.assign(new Image(), { src: url, onload: () => this.draw() });
      const { ids, size: [width] } = this.map, rows = [...ids.keys()].filter((row) => ids[row] === number);
      const spread = (values) => values.reduce((most, each) => Math.max(most, each)) - values.reduce((least, each) => Math.min(least, each)) + 1;
      const length = Math.max(spread(rows.map((row) => row % width)), spread(rows.map((row) => Math.floor(row / width)))) / width;
      outlined(this.shape, this.map.size, (row) => ids[row] === number, [0, 0, 0], 255);
      this.pattern = { image, url, length };
    } else if (!number) this.pattern = null;
    this.patterned = performance.now();
    this.draw();
  }

  drawPattern(context) {
    const { image, length } = this.pattern, [width, height] = this.viewport.size, knob = this.knob();
    if (!image.complete || !knob) return;
    const layer = new OffscreenCanvas(width, height), above = layer.getContext("2d");
    const fill = above.createPattern(image, "repeat");
    const size = (strokes().scale * length * width) / Math.max(image.width, image.height);
    fill.setTransform(new DOMMatrix().translate(...knob.middle).rotate(-strokes().rotate).scale(size).translate(-image.width / 2, -image.height / 2));
    above.fillStyle = fill;
    above.fillRect(0, 0, width, height);
    above.globalCompositeOperation = "destination-in";
    above.drawImage(this.shape, 0, 0, width, height);
    context.drawImage(layer, 0, 0);
  }

  isCurrent(each) {
    return Boolean(each) && each.look === this.viewport.number;
  }

  // The object at a place in pixels of the page; undefined if it is not known yet
  objectAt(x, y) {
    return this.objectIn([x, y], [x, y]);
  }

  // The object that shows most in a rectangle
  objectIn(one, other) {
    if (!this.isCurrent(this.map)) return undefined;
    const { ids, names, size: [width] } = this.map, counts = new Map();
    const corner = (pick) => this.row(...[0, 1].map((axis) => pick(one[axis], other[axis])));
    const first = corner(Math.min), last = corner(Math.max), wide = (last % width) - (first % width);
    for (let row = first; row <= last; row += width) {
      for (const number of ids.subarray(row, row + wide + 1)) counts.set(number, (counts.get(number) ?? 0) + 1);
    }
    counts.delete(0);
    const [[most] = []] = [...counts].sort((a, b) => b[1] - a[1]);
    return most ? names[most - 1] : null;
  }

  // How far away the surface is; 0 where there is none
  depthAt(x, y) {
    return this.isCurrent(this.map) ? half(this.map.depths.getUint16(2 * this.row(x, y), true)) : 0;
  }

  row(x, y) {
    const [width, height] = this.map.size, [wide, high] = this.viewport.size;
    const column = Math.min(width - 1, Math.max(0, Math.floor((x / wide) * width)));
    return Math.min(height - 1, Math.max(0, Math.floor((y / high) * height))) * width + column;
  }

  draw() {
    if (!this.frame) this.frame = requestAnimationFrame(() => this.now());
  }

  now() {
    this.frame = null;
    const { canvas, size: [width, height] } = this.viewport, knob = this.knob();
    const scale = Math.min(2, window.devicePixelRatio || 1);
    const size = [width, height].map((side) => Math.round(scale * side));
    const lit = this.pointed !== null && this.isCurrent(this.map) && this.light.width > 0;
    const parts = [
      [this.pattern, (context) => this.drawPattern(context)],
      [this.isCurrent(this.picked) && this.glow.width, (context) => context.drawImage(this.glow, 0, 0, width, height)],
      [lit, (context) => context.drawImage(this.light, 0, 0, width, height)],
      [showPhotos.value, (context) => this.photos(context)],
      [tool.value === "guide", (context) => this.drawGuides(context)],
      [this.box, (context) => this.drawBox(context)],
      [knob, (context) => drawKnob(context, knob)],
      [canvas.matches(":focus-visible"), (context) => drawCross(context, [width / 2, height / 2])],
      [this.ball, (context) => drawBall(context, this.ball)],
      [this.line.length, (context) => this.drawLine(context)],
    ].filter(([shows]) => shows);
    if (!parts.length && !this.covered && String(size) === String([canvas.width, canvas.height])) return; // a browser composes what changed alone
    this.covered = parts.length > 0;
    [canvas.width, canvas.height] = size;
    const context = canvas.getContext("2d");
    context.scale(scale, scale);
    for (const [, draw] of parts) draw(context);
  }

  drawLine(context) {
    context.lineWidth = this.width ?? 1.5;
    context.lineCap = context.lineJoin = "round";
    context.strokeStyle = this.width ? "#ffa83088" : "#ffc566";
    context.stroke(path(this.line));
  }

  photos(context) {
    const { photos } = hello.value, step = Math.ceil(photos.length / MOST_PHOTOS);
    context.lineWidth = 1.2;
    context.strokeStyle = "#ffc566";
    this.frusta = [];
    for (let row = 0; row < photos.length; row += step) {
      const photo = photos[row], size = 0.035 * hello.value.extent;
      const middle = plus(photo.position, plus(photo.target, photo.position, -1), size / Math.hypot(...plus(photo.target, photo.position, -1)));
      const corners = [[-1, -1], [1, -1], [1, 1], [-1, 1]].map(([x, y]) =>
        plus(plus(middle, scaled(photo.right, (x * size * photo.slopes[0]) / 2)), scaled(photo.down, (y * size * photo.slopes[1]) / 2))
      );
      const [eye, ...ends] = [photo.position, ...corners].map((place) => this.viewport.project(place));
      if ([eye, ...ends].some((place) => place[2] <= 0.01)) continue;
      context.stroke(path([...ends, ends[0]]));
      for (const end of ends) context.stroke(path([eye, end]));
      this.frusta.push({ photo, at: eye });
    }
  }

  // The lines that the strokes of the layer that is chosen follow
  drawGuides(context) {
    const lines = (activeLayer()?.guides ?? []).map((line) => line.map((place) => this.viewport.project(place)));
    for (const line of lines.filter((each) => each.every((place) => place[2] > 0.01))) {
      for (const [style, thickness] of [["#000a", 4], ["#ffc566", 2]]) {
        Object.assign(context, { strokeStyle: style, lineWidth: thickness, lineCap: "round", lineJoin: "round" });
        context.stroke(path(line));
      }
    }
  }

  photoAt(x, y) {
    if (!showPhotos.value) return null;
    const near = this.frusta?.filter(({ at }) => Math.hypot(at[0] - x, at[1] - y) < 14) ?? [];
    return near.sort((a, b) => a.at[2] - b.at[2])[0]?.photo ?? null;
  }

  drawBox(context) {
    const corners = boxCorners(this.box).map((place) => this.viewport.project(place));
    if (corners.some((place) => place[2] <= 0.01)) return;
    context.lineWidth = 1.5;
    context.strokeStyle = "#ffc566";
    for (const [a, b] of EDGES) context.stroke(path([corners[a], corners[b]]));
    context.fillStyle = "#ffa830";
    for (const { at } of this.handles()) {
      context.beginPath();
      circle(context, at, 7);
      context.fill();
    }
  }

  // The circle that stands for the strokes of the picked object, and its knob
  knob() {
    const [one, ...others] = tool.value === "strokes" ? state.value.objects.filter((each) => each.picked) : [];
    if (!one?.centre || others.length) return null;
    const [x, y, depth] = this.viewport.project(one.centre);
    if (depth <= 0.01) return null;
    const { scale, rotate } = strokes(), radius = KNOB_NEAR + KNOB_STEP * scale, angle = (rotate * Math.PI) / 180;
    return { name: one.name, middle: [x, y], radius, at: [x + radius * Math.cos(angle), y - radius * Math.sin(angle)] };
  }

  // The middles of a box's faces, which are dragged
  handles() {
    const middle = scaled(plus(...this.box), 0.5);
    return [0, 1].flatMap((end) =>
      [0, 1, 2].map((axis) => {
        const place = middle.map((value, n) => (n === axis ? this.box[end][axis] : value));
        return { end, axis, place, at: this.viewport.project(place) };
      })
    );
  }
}

// The size and direction of strokes
function strokes() {
  return { ...Object.fromEntries(hello.value.settings.map(({ name, value }) => [name, value])), ...settings.value };
}

function drawKnob(context, { middle, radius, at }) {
  context.lineWidth = 2.5;
  context.strokeStyle = "#fff";
  circle(context, middle, radius);
  context.stroke();
  context.stroke(path([middle, at]));
  context.fillStyle = "#ffa830";
  circle(context, at, 9);
  context.fill();
}

// Where Enter picks
function drawCross(context, [x, y]) {
  const cross = [[[x - 9, y], [x + 9, y]], [[x, y - 9], [x, y + 9]]];
  for (const [style, thickness] of [["#000", 4], ["#fff", 2]]) {
    Object.assign(context, { strokeStyle: style, lineWidth: thickness });
    for (const line of cross) context.stroke(path(line));
  }
}

function drawBall(context, ball) {
  context.lineWidth = 2;
  context.strokeStyle = "#fff";
  context.fillStyle = "#6eb4ff33";
  circle(context, ...ball);
  context.fill();
  context.stroke();
}

function boxCorners([low, high]) {
  return [0, 1, 2, 3, 4, 5, 6, 7].map((bits) => [0, 1, 2].map((axis) => ((bits >> axis) & 1 ? high[axis] : low[axis])));
}

function path(points) {
  const found = new Path2D();
  points.forEach(([x, y], n) => (n ? found.lineTo(x, y) : found.moveTo(x, y)));
  if (points.length === 1) found.lineTo(points[0][0] + 0.01, points[0][1]);
  return found;
}

function circle(context, [x, y], radius) {
  context.beginPath();
  context.arc(x, y, radius, 0, 2 * Math.PI);
}

// The outline alone is seen around paint, whose colours a tint would change
function glowing(names) {
  const { objects, painting } = state.value;
  return painting || objects.some((each) => each.painted && names.includes(each.name)) ? 0 : TINT;
}

// A canvas of the map's size, each pixel in the colour that a function gives it, if it gives one
function colored(canvas, [width, height], colorOf) {
  canvas.width = width;
  canvas.height = height;
  const context = canvas.getContext("2d");
  const image = context.createImageData(width, height);
  for (let row = 0, y = 0; y < height; y++) {
    for (let x = 0; x < width; x++, row++) {
      const color = colorOf(row, x, y);
      if (color) image.data.set(color, 4 * row);
    }
  }
  context.putImageData(image, 0, 0);
}

// A tint with an outline
function outlined(canvas, [width, height], inside, color, tint = TINT) {
  colored(canvas, [width, height], (row, x, y) => {
    if (!inside(row)) return null;
    const whole = x > 0 && y > 0 && x < width - 1 && y < height - 1 &&
      inside(row - 1) && inside(row + 1) && inside(row - width) && inside(row + width);
    return [...color, whole ? tint : EDGE];
  });
}

// A selection: a tint as strong as its share, and a dashed line where that is a half
function faded(canvas, [width, height], shares, inside) {
  colored(canvas, [width, height], (row, x, y) => {
    const edge = inside(row) && !(inside(row - 1) && inside(row + 1) && inside(row - width) && inside(row + width));
    const dash = (x + y) & 4 ? 255 : 0;
    return edge ? [dash, dash, dash, 255] : [...SELECTED, (SELECTED_TINT * shares[row]) / 255];
  });
}

function half(bits) {
  const exponent = (bits >> 10) & 31, fraction = bits & 1023;
  return exponent ? 2 ** (exponent - 15) * (1 + fraction / 1024) : 2 ** -14 * (fraction / 1024);
}
