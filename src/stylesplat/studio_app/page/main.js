// The page of the studio: the picture in the middle, panels around it

import { render } from "./libraries/preact.js";
import { useEffect, useRef } from "./libraries/hooks.js";
import "./libraries/signals.js";
import { brush, hint, mode, tab, tool } from "./choices.js";
import { act, busy, connect, dismiss, hello, note, notes, online, progress, renewed, state, upload } from "./connection.js";
import { Dialogs } from "./dialogs.js";
import { Layers } from "./layers.js";
import { Objects, Toolbar } from "./panels.js";
import { paint, Strip } from "./styles.js";
import { isTyping, Viewport } from "./viewport.js";
import { Button, html } from "./widgets.js";
import { dialog } from "./choices.js";

const DRAGGED = 500; // milliseconds without an event, after which files are no longer dragged: browsers send one each 350 at least
let viewport = null;

function Picture() {
  const root = useRef(null);
  useEffect(() => {
    viewport = window.studio = new Viewport(root.current);
  }, []);
  const over = (event) => {
    event.preventDefault();
    if (event.dataTransfer.types.includes("style")) viewport.overlay.setPointed(objectBelow(event) ?? null);
  };
  const drop = (event) => {
    if (!event.dataTransfer.types.includes("style")) return;
    event.preventDefault();
    event.stopPropagation();
    const name = objectBelow(event);
    viewport.overlay.setPointed(null);
    if (name) paint(event.dataTransfer.getData("style"), [name]);
  };
  return html`<div class="view" ref=${root} onDragOver=${over} onDrop=${drop}></div>`;
}

function objectBelow(event) {
  return viewport.overlay.objectAt(...viewport.tools.place(event));
}

function Header() {
  const { title, readonly } = hello.value, now = state.value;
  if (readonly) return html`<header class="bar"><h1>${title}</h1><span class="grow"></span>${now.layers.length > 0 && html`<${Compare} />`}<${Views} /></header>`;
  const name = now.folder.split("/").at(-1);
  return html`<header class="bar">
    <h1 title=${now.folder}>${name}</h1>
    <span class="saved" role="status">${now.unsaved ? "Not saved" : "Saved"}</span>
    <${Button} icon="undo" label=${now.undo ? `Undo: ${now.undo} (Ctrl+Z)` : "Nothing to undo"} disabled=${!now.undo} onClick=${() => act("step", { rows: -1 })} />
    <${Button} icon="redo" label=${now.redo ? `Redo: ${now.redo} (Ctrl+Y)` : "Nothing to redo"} disabled=${!now.redo} onClick=${() => act("step", { rows: 1 })} />
    <span class="note">${now.note}</span>
    <${Compare} />
    <${Views} />
    <${Button} icon="download" text="Export" label="Export, pictures, turntable, commands" onClick=${() => (dialog.value = "keep")} />
    <${Button} primary text="Save" label="Save into the scene's folder (Ctrl+S)" disabled=${!now.unsaved} onClick=${() => act("save")} />
  </header>`;
}

function Compare() {
  const painted = state.value.layers.length > 0;
  return html`<div class="segments" role="group" aria-label="Compare">
    ${[["after", "After"], ["split", "Split"], ["before", "Before"]].map(([key, words]) =>
      html`<button type="button" aria-pressed=${(painted ? mode.value : "after") === key} disabled=${!painted && key !== "after"}
        title=${key === "before" ? "Before painting (hold B)" : words} onClick=${() => (mode.value = key)}>${words}</button>`)}</div>`;
}

const Views = () => html`<${Button} icon="home" label="Home: what is picked, or the first view (H)" onClick=${() => viewport.home()} />
  <${Button} icon="camera" label="Photos, background and keys" onClick=${() => (dialog.value = "view")} />`;

const HINTS = [
  "Drag to turn, with two fingers or the right button to move, and come closer by the wheel or a pinch.",
  "Click a thing to pick it. Shift adds, Ctrl removes; the tools on the left select parts.",
  "Click a style to paint what is picked. Each painting is a layer, and everything can be undone.",
];

// On the first visit, and never again
function Hints() {
  const words = HINTS[hint.value];
  return words && html`<section class="hints" aria-label="Hint"><p>${words}</p><div class="row"><span>${hint.value + 1} of ${HINTS.length}</span><span class="grow"></span>
    ${hint.value < HINTS.length - 1 && html`<${Button} text="Skip" label="No more hints" onClick=${() => (hint.value = HINTS.length)} />`}
    <${Button} text=${hint.value < HINTS.length - 1 ? "Next" : "Start"} label="The next hint" onClick=${() => (hint.value += 1)} /></div></section>`;
}

function Progress() {
  const { what, share, left, doing, export: exporting } = progress.value, now = state.value;
  if (!what && !now.stopped && !now.waiting.length && !busy.value.what) return null;
  const percent = Math.round(100 * share);
  const time = left == null ? "" : left < 90 ? `${Math.round(left)} s left` : `${Math.round(left / 60)} min left`;
  return html`<section class="progress" aria-label="Progress">
    ${busy.value.what && html`<div class="line busy" role="status"><span>${busy.value.what}…</span>
      ${busy.value.cancel && html`<${Button} icon="stop" text="Cancel" label="Cancel this" onClick=${() => act("interrupt")} />`}</div>`}
    ${what && html`<div class="line"><span>${what}${doing && !share ? `: ${doing}` : ""}</span><span>${time}</span>
      <${Button} icon="stop" text=${exporting ? "Cancel" : "Stop"} label=${exporting ? "Cancel the export" : "Stop and keep what is painted so far"}
        onClick=${() => act(exporting ? "cancel" : "stop")} /></div>
      <div class="meter" role="progressbar" aria-label=${what} aria-valuenow=${percent} aria-valuemin="0" aria-valuemax="100"><i style=${`width:${percent}%`}></i></div>`}
    ${now.waiting.map(([number, object, title]) => html`<div class="line waiting" key=${number}><span>Next: ${object} like ${title}</span>
      <${Button} icon="close" label=${`Do not paint ${object}`} onClick=${() => act("remove", { number })} /></div>`)}
    ${!what && now.stopped && html`<div class="line"><span>${now.stopped}</span>
      <${Button} icon="play" text="Continue" label="Go on with this painting" onClick=${() => act("resume")} /></div>`}
  </section>`;
}

const Notes = () => html`<div class="notes" role="status" aria-live="polite">
  ${!online.value && html`<p class="failure">${renewed.value ? "The studio was started anew. Open the address that it printed; this page then goes on, too." : "The studio does not answer. What you do now is not done; trying again."}</p>`}
  ${notes.value.map((each) => html`<p key=${each.number} class=${each.failure ? "failure" : ""}><span>${each.text}</span>
    <${Button} icon="close" label="Dismiss" onClick=${() => dismiss(each.number)} /></p>`)}</div>`;

const TABS = [["objects", "Objects"], ["styles", "Styles"], ["layers", "Layers"]];

function App() {
  const now = state.value;
  if (!hello.value || !now) return html`<p class="empty">Opening the scene…</p><${Notes} />`;
  if (hello.value.readonly) return html`<div class="app readonly"><${Header} /><main class="stage"><${Picture} /></main><${Notes} /><${Dialogs} viewport=${() => viewport} /></div>`;
  return html`<div class="app" data-tab=${tab.value}>
    <${Header} />
    <${Objects} viewport=${() => viewport} />
    <main class="stage"><${Picture} /><${Toolbar} /><${Hints} /><${Progress} /></main>
    <${Layers} />
    <nav class="tabs">${TABS.map(([key, words]) => html`<button type="button" aria-pressed=${tab.value === key} onClick=${() => (tab.value = key)}>${words}</button>`)}</nav>
    <${Strip} viewport=${() => viewport} />
    <${Notes} /><${Dialogs} viewport=${() => viewport} />
  </div>`;
}

window.addEventListener("keydown", (event) => {
  if (isTyping(event) || !state.value || document.querySelector("dialog")) return;
  const key = event.key.toLowerCase();
  const does = event.ctrlKey || event.metaKey
    ? { z: () => act("step", { rows: event.shiftKey ? 1 : -1 }), y: () => act("step", { rows: 1 }), s: () => act("save") }[key]
    : { h: () => viewport.home(), c: () => tool.value === "surface" && viewport.tools.sizeAgain(), "?": () => (dialog.value = "help"),
        "[": () => (brush.value = Math.max(0.005, brush.value - 0.005)), "]": () => (brush.value = Math.min(0.15, brush.value + 0.005)), delete: () => act("remove_picked"), escape: () => act("pick_names", { names: [] }) }[key];
  if (!does || (hello.value.readonly && !["h", "?"].includes(key))) return;
  event.preventDefault();
  does();
});
// A drag that is over, or that has left the window, is told in some browsers by the end of its events alone
let dragging = null;
window.addEventListener("dragover", (event) => {
  event.preventDefault();
  clearTimeout(dragging);
  document.body.classList.toggle("dropping", !hello.value?.readonly && event.dataTransfer.types.includes("Files"));
  dragging = setTimeout(() => document.body.classList.remove("dropping"), DRAGGED);
});
window.addEventListener("drop", async (event) => {
  event.preventDefault();
  document.body.classList.remove("dropping");
  const { items, files: plain, types } = event.dataTransfer;
  if (hello.value?.readonly || types.includes("style")) return;
  const entries = [...items].map((item) => item.webkitGetAsEntry?.()).filter(Boolean); // what comes from a page has none
  const files = entries.length ? (await Promise.all(entries.map(filesIn))).flat() : [...plain];
  if (!files.length) note("There is no picture in what was dropped.", true);
  upload(files);
});

// The files of an entry that was dropped; of a folder the pictures, by name
async function filesIn(entry) {
  if (entry.isFile) return [await new Promise((done, failed) => entry.file(done, failed))];
  const reader = entry.createReader(), inside = [];
  for (let more = null; more?.length !== 0; inside.push(...more)) {
    more = await new Promise((done, failed) => reader.readEntries(done, failed)); // 100 at most
  }
  inside.sort((a, b) => a.name.localeCompare(b.name, undefined, { numeric: true }));
  const files = (await Promise.all(inside.map(filesIn))).flat();
  return files.filter((file) => /\.(jpe?g|png|webp|avif|bmp|gif|tiff?)$/i.test(file.name));
}

connect(() => viewport?.again());
render(html`<${App} />`, document.getElementById("app"));
