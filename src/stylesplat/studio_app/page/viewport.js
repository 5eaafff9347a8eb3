// The picture: exact pictures of the server at rest and, where no graphics card draws, in motion

import { effect } from "./libraries/signals.js";
import { cross, dot, Orbit, plus, scaled, unit } from "/viewer/camera.js";
import { drawer } from "/viewer/draw.js";
import { listen, slide } from "/viewer/hands.js";
import { inflated, unpack } from "/viewer/unpack.js";
import { active, background, cut, kept, leveling, mode, settings, showPhotos, tool } from "./choices.js";
import { act, hello, on, state } from "./connection.js";
import { Overlay } from "./overlay.js";
import { Tools } from "./tools.js";

const LEVELED = 400; // milliseconds after which the horizon is kept
const REST = 60; // milliseconds without motion, or none at all after a drag
const FLIGHT = 450; // milliseconds
const SHOWN_FOR = 400; // milliseconds that a pattern shows at least, until a draft takes its place
const SLOW = 400; // milliseconds after which the next picture is asked for without an answer
const SOFTWARE = /swiftshader|llvmpipe|software|basic render/i;
const PARTS = `<canvas class="drawn" hidden></canvas><canvas class="exact"></canvas><canvas class="exact before"></canvas>
<canvas class="overlay" tabindex="0" role="img" aria-label="The scene. Drag or use the arrow keys to turn it; click an object to pick it, or press Enter for the one in the middle."></canvas>
<div class="cut" hidden><span>before</span><span>after</span><div class="knob" role="slider" tabindex="0" aria-label="Border between before and after" aria-valuemin="0" aria-valuemax="100"><i></i></div></div>
<div class="pointed" hidden></div>`;

export class Viewport {
  constructor(root) {
    root.innerHTML = PARTS;
    this.root = root;
    const find = (name) => root.querySelector(name);
    [this.drawn, this.after, this.before] = root.querySelectorAll("canvas");
    this.canvas = find(".overlay");
    this.camera = new Orbit(this.start);
    this.place = kept(`place in ${hello.value.title} ${state.value.folder}`, null);
    Object.assign(this.camera, this.place.value ?? {});
    this.number = 0; // of the camera's place
    this.decoding = 0; // pictures
    this.bands = {}; // of a sharp picture that is not complete
    this.shown = { after: -1, before: -1 };
    this.moving = this.waiting = this.holding = false;
    this.draws = hasGraphicsCard();
    this.overlay = new Overlay(this);
    this.tools = new Tools(this, find(".pointed"));
    on("picture", (header, bytes) => this.picture(header, bytes));
    on("map", (header, bytes) => this.overlay.setMap(header, bytes));
    on("picked", (header, bytes) => this.overlay.setPicked(header, bytes));
    on("splats", (header, bytes) => this.splats(header, bytes));
    listen(this.canvas, this.camera, () => this.moved(), (event) => this.tools.press(event));
    slide(find(".cut"), find(".knob"), this.canvas, cut.peek(), (share) => {
      cut.value = share;
      this.arrange();
    });
    for (const name of ["pointerup", "pointercancel"]) this.canvas.addEventListener(name, () => this.moving && this.rest());
    new ResizeObserver(() => this.moved()).observe(root);
    effect(() => this.compare(mode.value, Boolean(state.value?.layers.length)));
    effect(() => {
      const variant = state.value?.variants.find((each) => each.id === state.value.compared);
      find(".cut span").textContent = variant ? `${variant.object}: ${variant.title}` : "before";
    });
    effect(() => {
      const up = String(state.value.up ?? hello.value.start.up), { position, target } = this.standing();
      if (!this.leveled && this.known && up !== this.known) this.upright(position, target); // set by another page, or back
      this.known = up;
    });
    effect(() => {
      if (!leveling.value) this.rolling = this.leveled = null;
    });
    effect(() => state.value?.painting || this.overlay.setPattern(null));
    effect(() => state.value && this.overlay.tintAgain());
    effect(() => settings.value && this.overlay.draw());
    effect(() => tool.value && state.value && active.value !== undefined && this.overlay.draw());
    effect(() => [showPhotos.value] && this.overlay.draw());
    window.addEventListener("keydown", (event) => event.key.toLowerCase() === "b" && !isTyping(event) && this.hold(true));
    window.addEventListener("keyup", (event) => event.key.toLowerCase() === "b" && this.hold(false));
    window.addEventListener("blur", () => this.hold(false)); // the key is released where nobody tells
  }

  // The first view, with what is up by now
  get start() {
    return { ...hello.value.start, up: this.leveled ?? state.value.up ?? hello.value.start.up };
  }

  // Where the camera is, and what it looks at
  standing() {
    const { viewmat } = this.view, eye = [0, 1, 2].map((axis) => -[0, 1, 2].reduce((sum, row) => sum + viewmat[4 * row + axis] * viewmat[4 * row + 3], 0));
    return { position: eye, target: this.camera.target };
  }

  // Turn what is up by an angle around the view, from where it was when that began
  roll(angle) {
    clearTimeout(this.rolled);
    this.rolling ??= { ...this.standing(), up: this.camera.up };
    const { position, target, up } = this.rolling, ahead = unit(plus(target, position, -1));
    const turn = (angle * Math.PI) / 180, along = dot(ahead, up) * (1 - Math.cos(turn));
    this.leveled = plus(plus(scaled(up, Math.cos(turn)), cross(ahead, up), Math.sin(turn)), ahead, along);
    this.upright(position, target);
    this.rolled = setTimeout(() => act("level", { up: this.leveled }), LEVELED);
  }

  upright(position, target) {
    const goal = new Orbit(this.start);
    goal.stand(position, target);
    Object.assign(this.camera, goal);
    this.moved();
  }

  flyAlong({ seconds, places }) {
    const began = performance.now(), flight = (this.flight = {});
    const step = () => {
      if (this.flight !== flight) return;
      const share = Math.min(1, (performance.now() - began) / (1000 * seconds)), at = share * (places.length - 1);
      const [one, other] = [Math.floor(at), Math.ceil(at)].map((row) => places[row]);
      const [position, target] = [0, 1].map((end) => plus(scaled(one[end], 1 - (at % 1)), other[end], at % 1));
      this.camera.stand(position, target);
      this.moved();
      if (share < 1) requestAnimationFrame(step);
    };
    step();
  }

  get size() {
    return [this.root.clientWidth, this.root.clientHeight];
  }

  get view() {
    return this.camera.view(this.size);
  }

  // Whether the browser draws while the camera moves: it has the Gaussians, as they are now
  get drawsItself() {
    return Boolean(this.draws && this.draw && this.current);
  }

  // Where a place of the world is in the picture, in pixels of the page, and how deep
  project(place) {
    const { viewmat, focal, centre } = this.view;
    const [x, y, z] = [0, 1, 2].map(
      (row) => place.reduce((sum, value, axis) => sum + value * viewmat[4 * row + axis], viewmat[4 * row + 3])
    );
    return [(focal[0] * x) / z + centre[0], (focal[1] * y) / z + centre[1], z];
  }

  moved() {
    this.overlay.setPattern(null);
    this.number += 1;
    this.moving = true;
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.rest(), REST);
    this.overlay.draw();
    if (this.drawsItself) {
      this.root.classList.add("moving");
      if (!this.frame) this.frame = requestAnimationFrame(() => this.redraw());
    } else this.ask(true);
  }

  rest() {
    clearTimeout(this.timer);
    this.moving = false;
    const { target, distance, turned, raised } = this.camera;
    this.place.value = { target, distance, turned, raised };
    this.ask(false);
    this.overlay.draw();
  }

  // One picture of a moving camera at a time: the next is asked for when one has come, and while it is decoded
  ask(moving) {
    if (moving && this.waiting) return;
    const [width, height] = this.size;
    if (!width || !height) return;
    this.waiting = moving;
    clearTimeout(this.late);
    if (moving) this.late = setTimeout(() => this.went(), SLOW);
    const scale = Math.min(2, window.devicePixelRatio || 1);
    const { viewmat, focal } = this.view;
    const size = [Math.round(scale * width), Math.round(scale * height)];
    const before = Boolean(state.value?.layers.length) && (mode.value !== "after" || this.holding);
    act("look", { number: this.number, viewmat, focal: scale * focal[0], size, moving, before, draws: this.draws });
  }

  went() {
    this.waiting = false;
    if (this.moving && !this.drawsItself) this.ask(true);
  }

  picture(header, bytes) {
    const { which, moving, drawn } = header;
    this.current = drawn;
    if (!drawn) this.root.classList.remove("moving");
    const next = moving && which === "after", early = next && !this.decoding;
    if (early) this.went();
    this.decoding += 1;
    const decoded = createImageBitmap(new Blob([bytes], { type: "image/jpeg" }));
    // In the order in which they came
    this.turn = Promise.allSettled([decoded, this.turn]).then(([{ value }]) => {
      this.decoding -= 1;
      if (next && !early) this.went();
      if (value) this.show(header, value);
    });
  }

  // Show a picture. Bands, of a picture of a `size` each from a row `top` on, are shown together: a browser that composes
  // the page after each of them takes the processor from the server
  show({ which, look, moving, top, size, last = true }, image) {
    if (look < this.shown[which] || (moving && !this.moving) || (size && look !== this.number)) return;
    if (top === undefined || this.bands[which]?.look !== look) this.bands[which] = { look, images: [] };
    const canvas = this[which], { images } = this.bands[which], [width, height] = size ?? [image.width, image.height];
    images.push([image, 0, top ?? 0]);
    if (!last) return;
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
    for (const [part, ...place] of images) {
      canvas.getContext("2d").drawImage(part, ...place);
      part.close();
    }
    delete this.bands[which];
    this.shown[which] = look;
    if (performance.now() - this.overlay.patterned > SHOWN_FOR) this.overlay.setPattern(null);
    if (!moving && look === this.number) this.root.classList.remove("moving");
    this.root.dataset[which] = `${look}${moving ? " moving" : ""}`;
    this.arrange();
  }

  async splats(about, bytes) {
    const shaders = await Promise.all(["vert", "frag"].map(async (end) => (await fetch(`/viewer/splats.${end}`)).text()));
    const unpacked = unpack(await inflated(bytes), about);
    try {
      this.draw?.remove();
      const sources = { vertex: shaders[0].trim(), fragment: shaders[1].trim() };
      this.draw = drawer(this.drawn, unpacked, about, sources, background.value);
      this.current = true;
    } catch (error) {
      console.warn(error.message); // the server's pictures do
      this.draws = false;
    }
    this.redraw();
  }

  redraw() {
    this.frame = null;
    if (!this.draw) return;
    const scale = Math.min(2, window.devicePixelRatio || 1);
    [this.drawn.width, this.drawn.height] = this.size.map((side) => Math.max(1, Math.round(scale * side)));
    const view = this.camera.view([this.drawn.width, this.drawn.height]);
    const share = { after: 0, before: 1, split: cut.value }[this.holding ? "before" : mode.value];
    this.draw(view, share);
  }

  compare(wanted, painted) {
    const now = painted ? wanted : "after";
    this.root.querySelector(".cut").hidden = now !== "split";
    if (now !== "after" || this.compared !== now) this.ask(false);
    this.compared = now;
    this.arrange();
  }

  hold(holding) {
    if (holding === this.holding || !state.value?.layers.length) return;
    this.holding = holding;
    if (holding) this.ask(false);
    this.arrange();
  }

  // Which part of the picture before painting lies above the one after
  arrange() {
    const share = this.holding || this.compared === "before" ? 1 : this.compared === "split" ? cut.value : 0;
    const stale = this.shown.before !== this.shown.after;
    this.before.style.clipPath = `inset(0 ${100 - 100 * share}% 0 0)`;
    this.before.style.visibility = share && !(stale && this.holding && this.shown.before < 0) ? "visible" : "hidden";
  }

  // Fly so that the camera stands at a position and looks at a target
  fly(position, target) {
    const goal = new Orbit(this.start);
    goal.stand(position, target);
    this.animate(goal);
  }

  // Look at an object from where the camera is, as near as all of it is seen
  approach({ centre, sides }) {
    const goal = Object.assign(new Orbit(this.start), this.camera);
    goal.approach(centre, sides, this.size);
    this.animate(goal);
  }

  home() {
    const { objects, selection } = state.value, picked = objects.filter((each) => each.picked);
    if (selection) this.approach(selection);
    else if (picked.length === 1 && picked[0].centre) this.approach(picked[0]);
    else this.animate(new Orbit(this.start));
  }

  animate(goal) {
    const { camera } = this;
    const from = { ...camera }, began = performance.now();
    const turn = ((goal.turned - from.turned + Math.PI) % (2 * Math.PI) + 2 * Math.PI) % (2 * Math.PI) - Math.PI;
    const flight = (this.flight = {});
    const step = () => {
      if (this.flight !== flight) return;
      const share = Math.min(1, (performance.now() - began) / FLIGHT);
      const eased = share * share * (3 - 2 * share);
      const mix = (a, b) => a + eased * (b - a);
      camera.target = from.target.map((value, axis) => mix(value, goal.target[axis]));
      camera.distance = mix(from.distance, goal.distance);
      camera.turned = from.turned + eased * turn;
      camera.raised = mix(from.raised, goal.raised);
      this.moved();
      if (share < 1) requestAnimationFrame(step);
    };
    step();
  }

  // After the connection came back
  again() {
    this.shown = { after: -1, before: -1 };
    this.moved();
  }
}

export function isTyping({ target }) {
  return target.matches?.("input:not([type=range]), textarea, select");
}

function hasGraphicsCard() {
  const gl = document.createElement("canvas").getContext("webgl2");
  const names = gl?.getExtension("WEBGL_debug_renderer_info");
  const name = gl ? String(gl.getParameter(names ? names.UNMASKED_RENDERER_WEBGL : gl.RENDERER)) : "";
  gl?.getExtension("WEBGL_lose_context")?.loseContext();
  return Boolean(gl) && !SOFTWARE.test(name);
}
