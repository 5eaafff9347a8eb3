// What the pointer does to objects: clicks, rectangles, lassos, brushes, balls and a box

import { effect } from "./libraries/signals.js";
import { brush, guideReach, how, radius, reach, shows, size, SIZES, soft, tolerance, tool } from "./choices.js";
import { act, hello, note, state } from "./connection.js";
import { KNOB_NEAR, KNOB_STEP } from "./overlay.js";
import { activeLayer } from "./layers.js";
import { setStrokes } from "./styles.js";

const STILL = 5; // pixels: less is a click
const DRAWING = ["brush", "mask", "mend", "guide", "lasso", "rectangle"];
const BRUSHES = ["brush", "mask", "mend"];
const REST = 150; // milliseconds without motion of a slider
const GRIP = 16; // pixels around a handle

function howOf({ ctrlKey, metaKey, shiftKey }) {
  if (ctrlKey || metaKey) return shiftKey ? "within" : "away";
  return shiftKey ? "add" : how.value;
}

export class Tools {
  constructor(viewport, label) {
    this.viewport = viewport;
    this.overlay = viewport.overlay;
    this.label = label;
    this.start = null;
    const { canvas } = viewport;
    radius.value ||= hello.value.extent / 12;
    reach.value ||= hello.value.extent / 4;
    if (!state.value.objects.length) tool.value = "surface"; // there is nothing else to click
    canvas.addEventListener("pointermove", (event) => this.move(event));
    canvas.addEventListener("pointerup", (event) => this.release(event));
    canvas.addEventListener("pointercancel", () => this.reset());
    canvas.addEventListener("pointerleave", () => this.point(null));
    canvas.addEventListener("dblclick", (event) => this.focus(event));
    canvas.addEventListener("keydown", (event) => event.key === "Enter" && this.pickMiddle(event));
    for (const name of ["focus", "blur"]) canvas.addEventListener(name, () => this.overlay.draw());
    effect(() => {
      if (tool.value !== "box") this.overlay.box = null;
      else if (!this.dragged && state.value) this.overlay.box = state.value.box.map((each) => [...each]);
      this.point(null);
    });
  }

  place(event) {
    const box = this.viewport.canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  }

  share([x, y]) {
    const [width, height] = this.viewport.size;
    return [Math.min(1, Math.max(0, x / width)), Math.min(1, Math.max(0, y / height))];
  }

  // Whether a gesture belongs to a tool and not to the camera
  press(event) {
    this.viewport.flight = null;
    if (!event.isPrimary) {
      this.reset(); // two fingers move the camera
      return false;
    }
    if (event.button !== 0 || hello.value.readonly) return false;
    const at = this.place(event);
    this.start = { at, how: howOf(event), handle: this.handleAt(at), still: true };
    const draws = DRAWING.includes(tool.value) && !event.altKey;
    const frames = tool.value === "object" && this.start.how !== "new";
    this.start.draws = draws || frames;
    if (!this.start.draws && !this.start.handle) return false;
    this.viewport.canvas.setPointerCapture(event.pointerId);
    this.viewport.canvas.focus({ focusVisible: false });
    this.overlay.width = BRUSHES.includes(tool.value) && draws ? 2 * brush.value * this.viewport.size[1] : null;
    this.overlay.line = this.start.draws ? [at] : [];
    this.overlay.draw();
    return true;
  }

  move(event) {
    const at = this.place(event), { start, overlay } = this;
    if (!start) {
      if (!event.buttons) this.point(at);
      return;
    }
    start.still &&= Math.hypot(at[0] - start.at[0], at[1] - start.at[1]) < STILL; // a drag that comes back is no click
    if (start.handle?.name) this.turnStrokes(start.handle, at);
    else if (start.handle) this.drag(start.handle, at);
    else if (start.draws && this.start.draws) {
      const boxed = tool.value === "rectangle" || tool.value === "object";
      const [a, b] = [start.at, at];
      overlay.line = boxed ? [a, [b[0], a[1]], b, [a[0], b[1]], a] : [...overlay.line, at];
      this.end = at;
      overlay.draw();
    }
    if (this.label) this.label.hidden = true;
  }

  release(event) {
    const { start, overlay } = this;
    if (!start) return;
    const at = this.place(event), { still } = start, { line } = overlay;
    this.reset();
    if (start.handle) return;
    if (start.draws && !(still && !BRUSHES.includes(tool.value))) this.finish(start, line, at);
    else if (still) this.click(start, at);
  }

  reset() {
    this.start = this.dragged = null;
    this.overlay.line = [];
    this.overlay.draw();
  }

  finish({ at: begin, how }, line, at) {
    if (tool.value === "object") {
      this.pickIn(begin, at, how);
      return;
    }
    const ends = tool.value === "rectangle" ? [begin, at] : thinned(line);
    const points = ends.map((each) => this.share(each));
    if (tool.value === "mend") {
      act("mend_drawn", { points, radius: brush.value, soft: soft.value });
      return;
    }
    if (tool.value === "guide") {
      const layer = activeLayer();
      if (layer?.kind !== "paint") note("Paint an object first, then draw the lines that its strokes follow.", true);
      else act("guide_drawn", { name: layer.name, points, reach: guideReach.value });
      return;
    }
    if (tool.value === "mask") {
      const layer = activeLayer();
      if (!layer) note("Choose a layer on the right: its mask is what the brush paints.", true);
      else act("mask_drawn", { name: layer.name, points, shows: { add: true, away: false }[how] ?? shows.value, radius: brush.value, soft: soft.value });
      return;
    }
    const wanted = tool.value === "brush" && how === "new" && (state.value.selection || state.value.objects.some((each) => each.picked)) ? "add" : how;
    act("pick_drawn", { shape: tool.value, points, how: wanted, radius: brush.value });
  }

  click({ how }, at) {
    const photo = this.overlay.photoAt(...at);
    if (photo) {
      this.viewport.fly(photo.position, photo.target);
      return;
    }
    if (tool.value === "surface" && how === "new" && this.isAgain(at)) {
      this.sizeAgain();
      return;
    }
    if (["surface", "wand", "color"].includes(tool.value)) {
      this.spot = { at, place: this.share(at), look: this.viewport.number, how };
      this.pickSpot();
    }
    if (tool.value === "ball") act("pick_at", { place: this.share(at), how, radius: radius.value });
    if (tool.value === "object") this.pickIn(at, at, how);
  }

  // A click without a pointer
  pickMiddle(event) {
    if (!hello.value.readonly) this.click({ how: howOf(event) }, this.viewport.size.map((side) => side / 2));
  }

  // The object that shows most in a rectangle; if that is not known yet, as soon as it is
  pickIn(one, other, how) {
    const name = this.overlay.objectIn(one, other);
    this.early = name === undefined ? { look: this.viewport.number, place: [one, other, how] } : null;
    if (name || (name === null && how === "new")) this.pick(name === null ? [] : [name], how);
  }

  pickSpot() {
    const { place, how } = this.spot;
    const wanted = { wand: { reach: reach.value }, color: { tolerance: tolerance.value } }[tool.value];
    act("pick_at", { place, how, ...(wanted ?? { size: size.value }) });
  }

  isAgain([x, y]) {
    return this.isSpotPicked() && Math.hypot(this.spot.at[0] - x, this.spot.at[1] - y) < STILL;
  }

  isSpotPicked() {
    const { again, painting } = state.value;
    return !painting && again && this.spot?.look === this.viewport.number;
  }

  // The last click with another reach or size: the server puts it in the place of the one before
  reachAgain() {
    clearTimeout(this.later);
    this.later = setTimeout(() => this.isSpotPicked() && this.pickSpot(), REST);
  }

  sizeAgain(wanted = SIZES[(SIZES.indexOf(size.value) + 1) % SIZES.length]) {
    size.value = wanted;
    if (this.isSpotPicked()) this.pickSpot();
  }

  pick(names, how) {
    const { objects, selection } = state.value;
    const before = objects.filter((each) => each.picked).map((each) => each.name);
    const after = { new: names, add: [...before, ...names], away: before.filter((each) => !names.includes(each)) }[how];
    if (how === "new" && !selection && String(before) === String(names)) return;
    if (!act("pick_names", { names, how }) || !after || (how !== "new" && selection)) return;
    // At once, before the server has told: a style that is clicked next is for these
    state.value = { ...state.value, selection: null, objects: objects.map((each) => ({ ...each, picked: after.includes(each.name) })) };
    this.overlay.guessPicked(after);
  }

  focus(event) {
    const name = this.overlay.objectAt(...this.place(event));
    const found = state.value?.objects.find((each) => each.name === name);
    if (found?.centre && tool.value === "object") this.viewport.approach(found);
  }

  // Light what a click would take, and name it
  point(at) {
    const { overlay, label } = this;
    const photo = at && overlay.photoAt(...at);
    const name = at && !photo && tool.value === "object" && !hello.value.readonly ? overlay.objectAt(...at) : null;
    overlay.setPointed(name ?? null);
    const depth = at && tool.value === "ball" ? overlay.depthAt(...at) : 0;
    overlay.ball = depth ? [at, (radius.value * this.viewport.view.focal[0]) / depth] : null;
    if (BRUSHES.includes(tool.value) && at) overlay.ball = [at, brush.value * this.viewport.size[1]];
    overlay.draw();
    const words = photo ? photo.name : name;
    label.hidden = !words;
    this.viewport.canvas.style.cursor = words || (at && this.handleAt(at)) ? "pointer" : DRAWING.includes(tool.value) ? "crosshair" : "";
    if (!words) return;
    label.textContent = words;
    const [width] = this.viewport.size;
    label.style.left = `${Math.min(at[0] + 14, width - label.offsetWidth - 6)}px`;
    label.style.top = `${at[1] + 16}px`;
  }

  handleAt([x, y]) {
    const knob = this.overlay.knob();
    if (knob) return Math.hypot(knob.at[0] - x, knob.at[1] - y) < GRIP ? knob : null;
    if (!this.overlay.box) return null;
    return this.overlay.handles().find(({ at }) => Math.hypot(at[0] - x, at[1] - y) < GRIP) ?? null;
  }

  turnStrokes({ middle }, at) {
    const [x, y] = [at[0] - middle[0], middle[1] - at[1]];
    const [scale, rotate] = ["scale", "rotate"].map((name) => hello.value.settings.find((each) => each.name === name));
    const size = Math.min(scale.high, Math.max(scale.low, (Math.hypot(x, y) - KNOB_NEAR) / KNOB_STEP));
    const angle = Math.round(((Math.atan2(y, x) * 180) / Math.PI + 360) / rotate.step) * rotate.step;
    setStrokes({ scale: Math.round(10 * size) / 10, rotate: angle % 360 });
  }

  // Move a face of the box along its axis, as far as the pointer moves along the axis in the picture
  drag(handle, at) {
    this.dragged = handle;
    const { box } = this.overlay, extent = hello.value.extent;
    const here = this.viewport.project(handle.place);
    const step = handle.place.map((value, axis) => value + (axis === handle.axis ? extent / 100 : 0));
    const there = this.viewport.project(step);
    const along = [there[0] - here[0], there[1] - here[1]], length = along[0] ** 2 + along[1] ** 2;
    if (length < 1e-6) return;
    const pixels = (at[0] - here[0]) * along[0] + (at[1] - here[1]) * along[1];
    const value = handle.place[handle.axis] + ((pixels / length) * extent) / 100;
    const other = box[1 - handle.end][handle.axis];
    box[handle.end][handle.axis] = handle.end ? Math.max(value, other) : Math.min(value, other);
    this.overlay.draw();
  }
}

function thinned(line, most = 1500) {
  const step = Math.ceil(line.length / most);
  return line.filter((_, n) => n % step === 0);
}
