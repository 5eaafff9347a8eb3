// Dialogs: files to take away, settings of paintings, a part of a picture, photos and keys

import { useRef } from "./libraries/hooks.js";
import { useSignal } from "./libraries/signals.js";
import { background, dialog, part, presets, regions, settings, showPhotos, turntable as turn, variant } from "./choices.js";
import { act, hello, note, state } from "./connection.js";
import { Button, Dialog, Entry, html, Select, Slider } from "./widgets.js";

export function Dialogs({ viewport }) {
  const close = () => (dialog.value = part.value = variant.value = null);
  const named = state.value.variants.find((each) => each.id === variant.value);
  if (named) return html`<${NamedVariant} each=${named} onClose=${close} />`;
  if (part.value) return html`<${Part} style=${part.value} onClose=${close} />`;
  if (dialog.value === "keep") return html`<${Keep} onClose=${close} />`;
  if (dialog.value === "settings") return html`<${Settings} onClose=${close} />`;
  if (dialog.value === "help") return html`<${Keys} onClose=${close} />`;
  if (dialog.value === "view") return html`<${View} viewport=${viewport()} onClose=${close} />`;
  return null;
}

function NamedVariant({ each, onClose }) {
  const done = (what, fields = {}) => {
    act(what, { id: each.id, ...fields });
    onClose();
  };
  return html`<${Dialog} title=${`${each.object}: ${each.title}`} onClose=${onClose}>
    <p class="hint">${each.settings}</p>
    <${Entry} label="Name" button="Rename" value=${each.title} onEnter=${(name) => done("name_variant", { name })} />
    <div class="row"><${Button} danger icon="trash" text="Delete for good" label="Delete this variant for good; what is painted with it stays" onClick=${() => done("delete_variant")} /></div>
  </${Dialog}>`;
}

function Settings({ onClose }) {
  const set = (control, value) => {
    const { [control.name]: _, ...rest } = settings.value;
    settings.value = value === control.value ? rest : { ...rest, [control.name]: value };
  };
  const forget = (name) => {
    const { [name]: _, ...rest } = presets.value;
    presets.value = rest;
  };
  return html`<${Dialog} title="Settings of the painting" onClose=${onClose}>
    ${hello.value.settings.map((each) => {
      const value = settings.value[each.name] ?? each.value;
      return each.choices.length
        ? html`<${Select} label=${each.label} value=${value} choices=${each.choices} onChange=${(chosen) => set(each, chosen)} />`
        : html`<${Slider} label=${each.label} value=${value} low=${each.low} high=${each.high} step=${each.step} onInput=${(chosen) => set(each, chosen)} />`;
    })}
    <p class="hint">They count for the next painting. Draft is quick, for trying things.</p>
    <section aria-label="Presets"><h3>Presets</h3>
      ${Object.keys(presets.value).map((name) => html`<div class="line" key=${name}><span>${name}</span>
        <${Button} text="Use" label=${`Use the settings ${name}`} onClick=${() => (settings.value = presets.value[name])} />
        <${Button} icon="trash" label=${`Delete the preset ${name}`} onClick=${() => forget(name)} /></div>`)}
      <${Entry} key=${Object.keys(presets.value).length} label="Keep these settings as" button="Keep" onEnter=${(name) => name.trim() && (presets.value = { ...presets.value, [name.trim()]: settings.value })} /></section>
    <div class="row"><${Button} text="Defaults" label="Use the defaults" onClick=${() => (settings.value = {})} />
      <span class="grow"></span><${Button} primary text="Done" label="Close" onClick=${onClose} /></div>
  </${Dialog}>`;
}

// The part of a style picture to use: a rectangle that is dragged on it
function Part({ style, onClose }) {
  const frame = useRef(null), drawn = useSignal(regions.value[style.title] ?? null), start = useRef(null);
  const at = (event) => {
    const box = frame.current.getBoundingClientRect();
    const shares = [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height];
    return shares.map((share, axis) => Math.round(Math.min(1, Math.max(0, share)) * style.size[axis]));
  };
  const press = (event) => {
    event.preventDefault();
    frame.current.setPointerCapture(event.pointerId);
    start.current = at(event);
  };
  const move = (event) => {
    if (!start.current) return;
    const [[a, b], [x, y]] = [start.current, at(event)];
    drawn.value = [Math.min(a, x), Math.min(b, y), Math.max(a, x), Math.max(b, y)];
  };
  const keys = (event) => {
    const axis = { ArrowLeft: 0, ArrowRight: 0, ArrowUp: 1, ArrowDown: 1 }[event.key];
    if (axis === undefined) return;
    event.preventDefault();
    const part = drawn.value ?? [0, 0, ...style.size], most = style.size[axis], low = part[axis], high = part[axis + 2];
    const step = Math.round(0.05 * most) * (/Left|Up/.test(event.key) ? -1 : 1);
    const by = Math.min(most - high, Math.max(step, event.shiftKey ? low + 2 - high : -low));
    drawn.value = part.map((value, row) => (row === axis + 2 || (row === axis && !event.shiftKey) ? value + by : value));
  };
  const use = (region) => {
    const { [style.title]: _, ...rest } = regions.value;
    regions.value = region ? { ...rest, [style.title]: region } : rest;
    onClose();
  };
  const share = (value, axis) => `${(100 * value) / style.size[axis]}%`;
  const [x0, y0, x1, y1] = drawn.value ?? [0, 0, ...style.size];
  return html`<${Dialog} title=${`Part of ${style.title}`} onClose=${onClose} wide>
    <p class="hint">Drag a rectangle over the part to paint with; or move it by the arrow keys, with Shift its lower right corner.</p>
    <div class="part" ref=${frame} tabindex="0" role="application" aria-label="The part" onKeyDown=${keys} onPointerDown=${press} onPointerMove=${move} onPointerUp=${() => (start.current = null)}>
      <img src=${style.url} alt=${style.title} draggable="false" />
      <i style=${`left:${share(x0, 0)};top:${share(y0, 1)};width:${share(x1 - x0, 0)};height:${share(y1 - y0, 1)}`}></i></div>
    <div class="row"><${Button} text="Whole picture" label="Use the whole picture" onClick=${() => use(null)} /><span class="grow"></span>
      <${Button} primary text="Use this part" label="Use this part" disabled=${x1 - x0 < 2 || y1 - y0 < 2} onClick=${() => use(drawn.value)} /></div>
  </${Dialog}>`;
}

function Keep({ onClose }) {
  const now = state.value, name = now.folder.split("/").at(-1);
  const format = useSignal(".ply"), width = useSignal(1920);
  const kept = now.views.filter((each) => each.position).length;
  const ways = kept > 1 ? [...PATHS, ["views", "along the views that are kept"]] : PATHS;
  const set = (key) => (event) => (turn.value = { ...turn.value, [key]: ["around", "path"].includes(key) ? event : Number(event.target.value) });
  const begin = (what, fields) => {
    act(what, fields);
    onClose();
  };
  const number = (label, value, low, high, onInput) => html`<label class="field"><span>${label}</span>
    <input type="number" value=${value} min=${low} max=${high} onInput=${onInput} /></label>`;
  return html`<${Dialog} title="Export" onClose=${onClose} wide>
    <section><h3>File for other programs</h3><div class="row"><${Select} label="Format" value=${format.value} choices=${hello.value.formats.map((each) => [each, FORMATS[each] ?? each])} onChange=${(each) => (format.value = each)} />
      <${Button} primary icon="download" text="Download" label="Download the scene" onClick=${() => begin("export", { ending: format.value })} /></div></section>
    <section><h3>Picture of this view</h3><div class="row">${number("Width in pixels", width.value, 64, 8192, (event) => (width.value = Number(event.target.value)))}
      <${Button} icon="download" text="PNG" label="Download this view as PNG" onClick=${() => begin("picture", { width: Math.round(width.value) })} /></div></section>
    <section><h3>Video</h3><div class="row">${number("Seconds", turn.value.seconds, 1, 60, set("seconds"))}${number("Frames a second", turn.value.fps, 1, 60, set("fps"))}${number("Width in pixels", turn.value.width, 64, 3840, set("width"))}</div>
      <div class="row"><${Select} label="Path" value=${turn.value.path} choices=${ways} onChange=${set("path")} />
      ${turn.value.path !== "views" && html`<${Select} label="Around" value=${turn.value.around} choices=${[["", "the scene"], ...now.objects.map((each) => each.name)]} onChange=${set("around")} />`}
      <${Button} icon="download" text="MP4" label="Make a video" disabled=${now.painting} onClick=${() => begin("turntable", turn.value)} /></div></section>
    <section><h3>Another folder</h3><${Entry} label="Name of a new folder beside this one" button="Save as" value=${`${name}-painted`} onEnter=${(words) => begin("save_as", { name: words })} /></section>
    <section><h3>The same on the command line</h3>${now.command
      ? html`<pre tabindex="0">${now.command}</pre><p class="hint">It paints what was saved once more${now.unsaved ? "; save to have what has changed since" : ""}.</p>
        <div class="row"><${Button} icon="copy" text="Copy" label="Copy the command" onClick=${() => copy(now.command)} /></div>`
      : html`<p class="hint">Save the painted scene first.</p>`}</section>
  </${Dialog}>`;
}

const PATHS = [["photos", "as the photos were taken"], ["circle", "this view in a circle"], ["swing", "this view to and fro"]];
const FORMATS = {
  ".ply": "PLY, every bit", ".compressed.ply": "Compressed PLY", ".spz": "SPZ", ".splat": "SPLAT, one colour each",
  ".sog": "SOG, smallest", ".glb": "glTF (GLB)", ".html": "Web page with before and after",
};

async function copy(text) {
  try {
    await navigator.clipboard.writeText(text);
    note("Copied.");
  } catch {
    note("The browser does not allow copying. Select the text instead.", true);
  }
}

const LOOK_KEYS = [
  ["Drag", "turn"], ["Right drag", "move"], ["Wheel", "come closer"], ["Double click", "go to an object"],
  ["W A S D Q E", "fly"], ["Arrows", "turn"], ["H", "home"], ["B", "hold: before painting"], ["?", "these keys"],
];
const EDIT_KEYS = [
  ["Click", "pick an object"], ["Shift, Ctrl", "add, remove"], ["Ctrl+Shift", "keep what both have"], ["Alt drag", "turn, with any tool"],
  ["[ ]", "a smaller, a larger brush"], ["C", "another size of a click on the surface"], ["Enter", "pick what is in the middle"], ["Esc", "pick nothing"], ["Delete", "remove what is picked"],
  ["Ctrl+Z, Ctrl+Y", "undo, redo"], ["Ctrl+S", "save"],
];

function Keys({ onClose }) {
  const keys = hello.value.readonly ? LOOK_KEYS : [...LOOK_KEYS, ...EDIT_KEYS];
  return html`<${Dialog} title="Mouse and keys" onClose=${onClose}>
    <dl>${keys.map(([key, words]) => html`<dt>${key}</dt><dd>${words}</dd>`)}</dl>
    <p class="hint">With fingers: one turns, two move and come closer.</p>
  </${Dialog}>`;
}

function View({ viewport, onClose }) {
  const { photos, readonly, gaussians } = hello.value;
  const row = useSignal(0);
  const fly = (value) => {
    row.value = value;
    viewport.fly(photos[value].position, photos[value].target);
  };
  const color = (event) => {
    background.value = [1, 3, 5].map((start) => parseInt(event.target.value.slice(start, start + 2), 16) / 255);
    act("background", { color: background.value });
  };
  const code = `#${background.value.map((each) => Math.round(255 * each).toString(16).padStart(2, "0")).join("")}`;
  return html`<${Dialog} title="View" onClose=${onClose}>
    ${photos.length > 1 && html`<${Slider} label="Fly to photo" value=${row.value} high=${photos.length - 1} step="1" show=${(value) => photos[value].name} onInput=${fly} />
      <label class="check"><input type="checkbox" checked=${showPhotos.value} onChange=${(event) => (showPhotos.value = event.target.checked)} /><span>Show the cameras of photos; click one to fly there</span></label>`}
    ${!readonly && html`<label class="check"><input type="color" value=${code} onInput=${color} /><span>Background</span></label>`}
    <div class="row"><${Button} icon="help" text="Mouse and keys" label="What mouse and keys do (?)" onClick=${() => (dialog.value = "help")} /></div>
    <p class="hint">${gaussians.toLocaleString()} Gaussians</p>
  </${Dialog}>`;
}
