// The strip at the bottom: the shelf of style pictures, and painting with them; or views

import { above, active, dialog, part, presets, regions, settings, strip } from "./choices.js";
import { useEffect, useRef } from "./libraries/hooks.js";
import { effect, useSignal } from "./libraries/signals.js";
import { act, hello, newest, note, state, upload } from "./connection.js";
import { activeLayer } from "./layers.js";
import { picked } from "./panels.js";
import { Leveling, ViewStrip, ViewTools } from "./views.js";
import { Button, html, Icon } from "./widgets.js";

const RESTING = 300; // milliseconds without motion of the handle, after which a draft begins
const IS_PATH = /^\s*["']?(file:|~?\/|[a-z]:[\\/])/i; // in quotes as some file managers copy it

let resting = null;
let begun = null; // what gets a new layer, until that is painted: another style takes the place of the first
effect(() => state.value?.painting || (begun = null));

// Other strokes: if the picked object has a style, that shows on it at once, and a draft follows
export function setStrokes(values) {
  settings.value = { ...settings.value, ...values };
  const { layers, styles } = state.value, [one, ...others] = picked();
  const own = layers.filter((each) => each.object === one?.name && each.kind === "paint" && !each.locked);
  const layer = own.find((each) => each.name === activeLayer()?.name) ?? own.at(-1);
  const style = styles.find((each) => each.title === layer?.title);
  if (!layer || others.length) return;
  if (style) window.studio.overlay.setPattern(one.name, style.url);
  clearTimeout(resting);
  const { scale, rotate } = settings.value, draft = { name: layer.name, settings: { scale, rotate, quality: "draft" } };
  resting = setTimeout(() => act("repaint_layer", draft), RESTING);
}

// Paint objects, by default what is picked, like the style picture of a title
export function paint(style, names = null) {
  if (!names && !picked().length && !state.value.selection) {
    note("Pick an object first, or drag the picture onto one.", true);
    return;
  }
  const region = regions.value[style], layer = activeLayer();
  const place = String([active.value, ...(names ?? picked().map((each) => each.name))]), isNew = above.value || begun === place;
  if (isNew) begun = place;
  // Into the layer that is chosen, where that is paint of what is picked
  if (!names && !isNew && layer?.kind === "paint" && String(picked().map((each) => each.name)) === layer.object) names = [layer.name];
  above.value = false;
  act("paint", { style, names, above: isNew, settings: { ...settings.value, ...(region ? { region } : {}) } });
}

const STRIPS = [["styles", "Styles"], ["views", "Views"]];

const Strips = () => html`<div class="segments" role="group" aria-label="What is shown below">${STRIPS.map(([key, words]) =>
  html`<button type="button" aria-pressed=${strip.value === key} onClick=${() => (strip.value = key)}>${words}</button>`)}</div>`;

// At the bottom: style pictures, or views
export function Strip({ viewport }) {
  if (strip.value === "styles") return html`<${Styles} />`;
  return html`<section class="panel styles" aria-label="Views"><${Leveling} viewport=${viewport} />
    <div class="head"><${Strips} /><span class="grow"></span><${ViewTools} viewport=${viewport} /></div>
    <${ViewStrip} viewport=${viewport} /></section>`;
}

function Styles() {
  const now = state.value, chosen = picked();
  const tried = Object.keys(now.previews).length > 0;
  const unusual = Object.keys(settings.value).length;
  const list = useRef(null), words = useSignal("");
  const shown = now.styles.filter((each) => each.title.toLowerCase().includes(words.value.trim().toLowerCase()));
  const row = shown.findIndex((each) => each.title === newest.value);
  useEffect(() => list.current.children[row]?.scrollIntoView({ block: "nearest", inline: "nearest" }), [row]);
  const isPath = IS_PATH.test(words.value);
  const enter = (event) => {
    if (event.key === "Enter" && isPath && act("add_style", { path: words.value })) event.target.value = words.value = "";
  };
  return html`<section class="panel styles" aria-label="Styles">
    <div class="head"><${Strips} />
      <p class="hint">${chosen.length || now.selection ? `Click a picture to paint ${chosen.map((each) => each.name).join(", ") || "the selection"}${above.value ? " on a new layer" : ""}` : "Pick an object, then click a picture; or drag one onto an object"}</p>
      <input type="search" class="search" aria-label="Search styles, or the path of a picture to add" placeholder="Search, or a path" maxlength="4096"
        onInput=${(event) => (words.value = event.target.value)} onKeyDown=${enter} />
      <${Button} icon="try" text="Try all" label="Show all styles on what is picked: the colours first, then drafts, which stay as variants" disabled=${!(chosen.length || now.selection) || !now.styles.length || now.painting} active=${tried} onClick=${() => act("try_all", { settings: settings.value, regions: regions.value })} />
      <${Button} icon="sliders" text=${unusual ? `Settings (${unusual})` : "Settings"} label="Settings of the painting, and presets" onClick=${() => (dialog.value = "settings")} />
      <label class="button"><${Icon} name="plus" /><span>Add pictures</span><input type="file" accept="image/*" multiple onChange=${add} /></label></div>
    <ul class="strip" ref=${list}>${shown.map((each) => html`<${StyleCard} key=${each.title} style=${each} preview=${now.previews[each.title]} />`)}
      ${!shown.length && html`<li class="hint">${isPath ? "Enter adds the picture of this path." : words.value ? "No picture is called so." : "Drop or paste pictures or a folder here, or add them."}</li>`}</ul>
  </section>`;
}

function StyleCard({ style, preview }) {
  const { title } = style, region = regions.value[title];
  return html`<li>
    <button type="button" class="card" draggable="true" title=${`Paint like ${title}`} onClick=${() => paint(title)}
      onDragStart=${(event) => event.dataTransfer.setData("style", title)}>
      ${preview ? html`<img src=${preview} alt="" draggable="false" /><img class="corner" src=${style.url} alt="" />` : html`<${Sample} style=${style} region=${region} />`}
      <span class="swatches" aria-hidden="true">${style.colors.map((color) => html`<i style=${`background:${color}`}></i>`)}</span>
      <span class="name">${title}</span></button>
    <span class="corner-buttons">${style.own && html`<${Button} icon="trash" label=${`Remove ${title} from the shelf`} onClick=${() => act("forget_style", { title })} />`}
      <${Button} icon="crop" label=${`Choose a part of ${title}`} active=${Boolean(region)} onClick=${() => (part.value = style)} /></span></li>`;
}

// A style picture as it is used: the part that was chosen, turned as the settings say
function Sample({ style, region }) {
  const [width, height] = style.size, [x0, y0, x1, y1] = region ?? [0, 0, width, height];
  const turn = settings.value.rotate ?? 0, angle = (turn * Math.PI) / 180;
  // The whole square stays filled while the picture is turned
  const zoom = (Math.abs(Math.cos(angle)) + Math.abs(Math.sin(angle))) / Math.min(x1 - x0, y1 - y0);
  const place = [[x0 + x1, width], [y0 + y1, height]].map(([sum]) => 50 - 50 * zoom * sum);
  const look = `width:${100 * zoom * width}%;left:${place[0]}%;top:${place[1]}%;transform-origin:${(50 * (x0 + x1)) / width}% ${(50 * (y0 + y1)) / height}%;transform:rotate(${-turn}deg)`;
  return html`<span class="sample"><img src=${style.url} alt="" draggable="false" style=${look} /></span>`;
}

function add(event) {
  const files = [...event.target.files];
  event.target.value = "";
  upload(files);
}

// Pictures of the clipboard, or the path of one
window.addEventListener("paste", (event) => {
  const files = [...event.clipboardData.files], text = event.clipboardData.getData("text/plain");
  const isText = text && event.target.matches?.("input, textarea, select"); // a field takes words, and no picture
  if (!state.value || hello.value.readonly || isText) return;
  if (files.length) upload(files);
  else if (IS_PATH.test(text)) act("add_style", { path: text });
  else note("There is no picture in the clipboard.", true);
});
