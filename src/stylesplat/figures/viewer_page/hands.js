// What mouse, fingers and keys do to the camera; `changed` is called after that

import { plus, scaled } from "./camera.js";

const STEP = 0.04; // of the distance, by a key

// A gesture that is `taken` does something else, until a second finger comes
export function listen(canvas, camera, changed, taken = () => false) {
  const fingers = new Map();
  let takenBy = null;
  const size = () => [canvas.clientWidth, canvas.clientHeight];
  const middle = () => {
    const all = [...fingers.values()];
    const mean = [0, 1].map((axis) => all.reduce((sum, at) => sum + at[axis], 0) / all.length);
    return [mean, all.length > 1 ? Math.hypot(...plus(all[0], all[1], -1)) : 0];
  };
  canvas.addEventListener("pointerdown", (event) => {
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
    takenBy = taken(event) ? event.pointerId : null;
    if (takenBy !== null) return;
    canvas.setPointerCapture(event.pointerId);
    canvas.focus({ focusVisible: false });
  });
  canvas.addEventListener("pointermove", (event) => {
    if (!fingers.has(event.pointerId)) return;
    if (event.pointerId === takenBy) {
      fingers.set(event.pointerId, [event.clientX, event.clientY]);
      return;
    }
    const [from, apart] = middle();
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
    const [to, apartNow] = middle();
    const [x, y] = scaled(plus(to, from, -1), 1 / canvas.clientHeight);
    if (fingers.size > 1 || event.buttons & 6 || event.shiftKey) camera.shift(-x, -y, size());
    else camera.turn(-x * Math.PI, y * Math.PI);
    if (apart && apartNow) camera.zoom(apart / apartNow);
    changed();
  });
  for (const name of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(name, (event) => fingers.delete(event.pointerId));
  }
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("wheel", (event) => {
    const ours = document.hasFocus() && document.activeElement === canvas;
    if (window.parent !== window && !ours && !event.ctrlKey) return; // it scrolls the page around
    event.preventDefault();
    const lines = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? 33 : 1;
    camera.zoom(Math.exp(0.0012 * lines * event.deltaY));
    changed();
  }, { passive: false });
  window.addEventListener("keydown", (event) => {
    const field = event.target.closest?.("dialog, input, textarea, select, [role=slider]");
    const slides = field?.matches("[type=range], [role=slider]") && !field.closest("dialog"); // it takes arrows, and no letters
    if (field && !(slides && event.key.length === 1)) return;
    const does = {
      arrowleft: () => camera.turn(0.1, 0),
      arrowright: () => camera.turn(-0.1, 0),
      arrowup: () => camera.turn(0, 0.1),
      arrowdown: () => camera.turn(0, -0.1),
      "+": () => camera.zoom(0.9),
      "-": () => camera.zoom(1 / 0.9),
      a: () => camera.fly(-STEP, 0, 0),
      d: () => camera.fly(STEP, 0, 0),
      e: () => camera.fly(0, -STEP, 0),
      q: () => camera.fly(0, STEP, 0),
      w: () => camera.fly(0, 0, STEP),
      s: () => camera.fly(0, 0, -STEP),
      home: () => camera.reset(),
      r: () => camera.reset(),
    }[event.key.toLowerCase()];
    if (!does || event.ctrlKey || event.metaKey) return;
    event.preventDefault();
    does();
    changed();
  });
}

// A line whose knob is dragged from left to right, or moved by arrow keys: a share of the width
export function slide(line, knob, canvas, share, changed) {
  const move = (value) => {
    share = Math.max(0, Math.min(1, value));
    line.style.left = `${100 * share}%`;
    line.style.setProperty("--share", share);
    knob.setAttribute("aria-valuenow", Math.round(100 * share));
    changed(share);
  };
  knob.addEventListener("pointerdown", (event) => knob.setPointerCapture(event.pointerId));
  knob.addEventListener("pointermove", (event) => {
    if (!knob.hasPointerCapture(event.pointerId)) return;
    const box = canvas.getBoundingClientRect();
    move((event.clientX - box.left) / box.width);
  });
  knob.addEventListener("keydown", (event) => {
    const steps = { ArrowLeft: -0.02, ArrowRight: 0.02, Home: -1, End: 1 };
    if (event.key in steps) move(share + steps[event.key]);
  });
  move(share);
}
