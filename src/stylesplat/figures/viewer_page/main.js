// The page: what is in it comes from elements that Python has filled

import { Orbit } from "./camera.js";
import { drawer } from "./draw.js";
import { listen, slide } from "./hands.js";
import { inflated, unpack } from "./unpack.js";

const element = (name) => document.getElementById(name);
const text = (name) => element(name).textContent.trim();

function say(message) {
  element("message").textContent = message;
  document.body.classList.toggle("quiet", !message);
}

function legend(objects, camera, size, changed) {
  for (const { name, centre, sides, painted } of objects) {
    const button = document.createElement("button");
    button.textContent = name;
    button.className = painted ? "painted" : "";
    button.title = painted ? "painted; look at it" : "look at it";
    button.addEventListener("click", () => {
      camera.approach(centre, sides, size());
      changed();
    });
    element("legend").append(button);
  }
}

async function start() {
  const canvas = element("canvas");
  if (!window.DecompressionStream) throw new Error("This browser is too old for this page. Open it in one from 2023 or later.");
  const about = JSON.parse(text("about"));
  const packed = Uint8Array.from(atob(text("splats")), (letter) => letter.charCodeAt(0));
  const bytes = await inflated(packed);
  const sources = { vertex: text("vertex"), fragment: text("fragment") };
  const draw = drawer(canvas, unpack(bytes, about), about, sources);
  const camera = new Orbit(about.start);
  let cut = about.painted ? 0.5 : 0, waiting = false, own = null;

  const now = () => {
    waiting = false;
    draw(own ?? camera.view([canvas.width, canvas.height]), cut);
  };
  const changed = () => {
    own = null;
    if (!waiting) requestAnimationFrame(now);
    waiting = true;
  };
  const fit = () => {
    const scale = Math.min(window.devicePixelRatio || 1, 2);
    canvas.width = Math.max(1, Math.round(scale * canvas.clientWidth));
    canvas.height = Math.max(1, Math.round(scale * canvas.clientHeight));
    changed();
  };
  new ResizeObserver(fit).observe(canvas);
  canvas.addEventListener("webglcontextlost", () => say("The graphics driver has stopped. Load this page again."));
  listen(canvas, camera, changed);
  legend(about.objects, camera, () => [canvas.width, canvas.height], changed);
  if (about.painted) slide(element("cut"), element("knob"), canvas, cut, (share) => ((cut = share), changed()));
  document.body.classList.toggle("compared", about.painted > 0);
  fit();
  say("");
  if (window.parent === window) canvas.focus();
  // For other scripts: a view of their own, as viewmat (16 numbers, line by line), focal and centre
  window.viewer = {
    camera,
    draw(view, share = cut) {
      own = view;
      cut = share;
      now();
    },
  };
}

start().catch((error) => say(error.message));
