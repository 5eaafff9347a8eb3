// The panels: tools, objects

import { brush, guideReach, how, radius, reach, settings, shows, size, SIZES, soft, tolerance, tool } from "./choices.js";
import { useSignal } from "./libraries/signals.js";
import { act, hello, state } from "./connection.js";
import { activeLayer } from "./layers.js";
import { setStrokes } from "./styles.js";
import { Button, Entry, html, percent, Select, Slider } from "./widgets.js";

const TOOLS = [
  ["object", "Pick objects: click. Shift adds, Ctrl removes; both with a drag, too"],
  ["surface", "Pick what ends around a click: a part, an object or a group; C or another click there changes which. Shift adds, Ctrl removes"],
  ["wand", "Pick what looks alike around a click. Shift adds, Ctrl removes"],
  ["color", "Select a colour, as it is seen from here. Shift adds, Ctrl removes"],
  ["ball", "Pick a ball around a place"],
  ["brush", "Brush over what is meant. Ctrl removes; hold Alt to turn"],
  ["lasso", "Draw a line around what is meant. Shift adds, Ctrl removes; hold Alt to turn"],
  ["rectangle", "Draw a rectangle around what is meant. Shift adds, Ctrl removes; hold Alt to turn"],
  ["box", "Pick what lies inside a box"],
  ["mask", "Brush the layer that is chosen out and in. Shift brushes in, Ctrl out; hold Alt to turn"],
  ["mend", "Mend: brush over a fault, and what is around it is continued. Hold Alt to turn"],
  ["guide", "Draw lines on the paint that its strokes follow. Hold Alt to turn"],
  ["strokes", "Size and direction of the strokes of the picked object"],
];

const STEP = 0.05; // of its extent, by which an object grows or shrinks

export const picked = () => state.value.objects.filter((each) => each.picked);

const brushSize = () => html`<${Slider} label="Brush size" value=${brush.value} low=${0.005} high=${0.15} step=${0.005}
  show=${percent} onInput=${(value) => (brush.value = value)} />`;
const softBrush = () => html`${brushSize()}<${Slider} label="Soft edge" value=${soft.value} show=${percent} onInput=${(value) => (soft.value = value)} />`;

export function Toolbar() {
  const chosen = tool.value, { extent } = hello.value;
  return html`<div class="toolbar" role="toolbar" aria-label="Picking tools">
    <div class="tools">${TOOLS.map(([key, label]) => html`<${Button} icon=${key} label=${label} active=${chosen === key} onClick=${() => (tool.value = key)} />`)}</div>
    ${!["mask", "mend", "guide", "strokes", "box"].includes(chosen) && html`<div class="segments touch" role="group" aria-label="What a pick does">${[["new", "New"], ["add", "Add"], ["away", "Remove"], ["within", "Keep"]].map(([key, words]) =>
      html`<button type="button" title=${key === "within" ? "Keep what both have" : words} aria-pressed=${how.value === key} onClick=${() => (how.value = key)}>${words}</button>`)}</div>`}
    ${chosen === "surface" && html`<div class="options segments" role="group" aria-label="Size">
      ${SIZES.map((each) => html`<button type="button" aria-pressed=${size.value === each} onClick=${() => window.studio.tools.sizeAgain(each)}>${each}</button>`)}</div>`}
    ${chosen === "wand" && html`<div class="options"><${Slider} label="Reach" value=${reach.value} low=${extent / 100} high=${extent} step=${extent / 200}
      show=${(value) => value.toPrecision(2)} onInput=${(value) => { reach.value = value; window.studio.tools.reachAgain(); }} />
      </div>`}
    ${chosen === "color" && html`<div class="options"><${Slider} label="Tolerance" value=${tolerance.value} low=${0.02} high=${0.6} step=${0.01}
      show=${percent} onInput=${(value) => { tolerance.value = value; window.studio.tools.reachAgain(); }} /></div>`}
    ${chosen === "mend" && html`<div class="options"><p>Brush over a fault.</p>${softBrush()}</div>`}
    ${chosen === "ball" && html`<div class="options"><${Slider} label="Radius" value=${radius.value} low=${extent / 200} high=${extent / 2} step=${extent / 400}
      show=${(value) => value.toPrecision(2)} onInput=${(value) => (radius.value = value)} /></div>`}
    ${chosen === "brush" && html`<div class="options">${brushSize()}</div>`}
    ${chosen === "mask" && html`<div class="options"><p>${activeLayer() ? `Brush over ${activeLayer().object}.` : "Choose a layer on the right."}</p>
      <div class="segments" role="group" aria-label="What the brush does">${[[false, "Out"], [true, "In"]].map(([key, words]) =>
        html`<button type="button" aria-pressed=${shows.value === key} onClick=${() => (shows.value = key)}>${words}</button>`)}</div>
      ${softBrush()}</div>`}
    ${chosen === "guide" && html`<${GuideOptions} />`}
    ${chosen === "strokes" && html`<div class="options"><p>${strokesHint()}</p>
      ${hello.value.settings.filter(({ name }) => ["scale", "rotate"].includes(name)).map((each) => html`<${Slider} label=${each.label} value=${settings.value[each.name] ?? each.value}
        low=${each.low} high=${each.high} step=${each.step} onInput=${(value) => setStrokes({ [each.name]: value })} />`)}</div>`}
    ${chosen === "box" && html`<div class="options"><p>Drag the dots.</p>${[["new", "Pick"], ["add", "Add"], ["away", "Remove"], ["within", "Keep"]].map(([how, words]) =>
      html`<button type="button" onClick=${() => pickBox(how)}>${words}</button>`)}</div>`}
  </div>`;
}

function GuideOptions() {
  const layer = activeLayer(), count = layer?.guides.length ?? 0;
  const paint = layer?.kind === "paint", fixed = !paint || layer.locked;
  return html`<div class="options"><p>${paint ? `Draw lines on ${layer.object}. A draft follows; Finish paints it in full.` : "Choose a layer of paint on the right, or paint an object."}</p>
    <${Slider} label="Reach" value=${guideReach.value} low=${0.02} high=${0.5} step=${0.01} show=${percent} onInput=${(value) => (guideReach.value = value)} />
    <${Button} text=${count ? `Remove ${count === 1 ? "the line" : `${count} lines`}` : "No lines"} label="Let the strokes run as they like" disabled=${fixed || !count}
      onClick=${() => act("repaint_layer", { name: layer.name, settings: { guides: [], quality: "draft" } })} /></div>`;
}

function strokesHint() {
  const [one, ...others] = picked();
  if (!one || others.length) return "Pick one object.";
  return one.painted ? "Drag the knob. A draft follows when it rests." : "Drag the knob, then click a style.";
}

function pickBox(how) {
  const [low, high] = window.studio.overlay.box;
  act("pick_box", { low, high, how });
}

export function Objects({ viewport }) {
  const now = state.value, chosen = picked();
  const choose = (event, each) => {
    const how = event.ctrlKey || event.metaKey ? "away" : event.shiftKey ? "add" : "new";
    viewport().tools.pick([each.name], how);
  };
  return html`<aside class="panel objects" aria-label="Objects">
    <h2>Objects</h2>
    ${!now.objects.length && html`<p class="hint">This scene has no labels. Click a thing in the picture. Another click there, or C, takes a group, a part, and the object again. Shift adds, Ctrl removes. Then paint it, or give it a name.</p>`}
    <ul class="cards">${now.objects.map((each) => html`<li key=${each.name} class=${each.hidden ? "off" : ""}>
      <button type="button" class="card" aria-pressed=${each.picked} title=${`${each.name}: ${each.count?.toLocaleString() ?? "counting"} Gaussians`}
        onClick=${(event) => choose(event, each)} onDblClick=${() => each.centre && viewport().approach(each)}
        onMouseEnter=${() => viewport()?.overlay.setPointed(each.name)} onMouseLeave=${() => viewport()?.overlay.setPointed(null)}>
        ${each.thumbnail ? html`<img src=${each.thumbnail} alt="" />` : html`<span class="blank"></span>`}
        <span class="name">${each.name}</span></button>
      <${Button} icon=${each.hidden ? "hidden" : "eye"} label=${`${each.hidden ? "Show" : "Hide"} ${each.name}`}
        onClick=${() => act("hide_objects", { names: [each.name], hide: !each.hidden })} /></li>`)}</ul>
    <${Pick} />
    ${(now.objects.length > 0 || now.selection) && html`<section aria-label="Colours"><${Recolor} /></section>`}
    <${CleanUp} />
    <${Entry} label="Find by words" button="Find" onEnter=${(text) => act("pick_words", { text })} />
  </aside>`;
}

const EXTREMES = [["size", "The largest"], ["opacity", "The faintest"], ["distance", "Farthest from others"]];

// Selects Gaussians that are often faults
function CleanUp() {
  const shares = useSignal({});
  const choose = (what, value) => {
    shares.value = { [what]: value };
    act("pick_extreme", { by: what, share: value / 100 });
  };
  return html`<details><summary>Clean up</summary>
    ${EXTREMES.map(([what, label]) => html`<${Slider} label=${label} value=${(state.value.selection && shares.value[what]) || 0} high=${10} step=${0.1} show=${(value) => `${value} %`} onInput=${(value) => choose(what, value)} />`)}
    <p class="hint">This selects; Remove hides what is selected.</p></details>`;
}

// What is selected or picked, and what can be made of it
function Pick() {
  const { selection } = state.value, chosen = picked();
  const names = chosen.map((each) => each.name).join(", ");
  const count = selection?.count ?? chosen.reduce((sum, each) => sum + each.count, 0);
  const change = (what, share, text, label) => html`<${Button} text=${text} label=${label} onClick=${() => act(what, share ? { share } : {})} />`;
  if (!selection && !chosen.length) return html`<section aria-label="The pick"><h3>Nothing is picked</h3></section>`;
  return html`<section aria-label="The pick"><h3>${selection ? "Selection" : names}</h3>
    <p class="hint">${count.toLocaleString()} Gaussians${selection?.soft ? ", with a soft border" : ""}</p>
    <div class="row">
      ${change("resize_picked", STEP, "Grow", "Select more: grow by 5 % of the extent")}
      ${change("resize_picked", -STEP, "Shrink", "Select less: shrink by 5 % of the extent")}
      ${change("feather_picked", STEP, "Feather", "Let the border fade over 5 % of the extent")}
      ${change("invert_picked", 0, "Invert", "Select everything else")}
      ${chosen.length > 1 && html`<${Button} text="Unite" label="Select all of these together" onClick=${() => act("unite_picked")} />
        <${Button} text="Subtract" label="Select the first without the others" onClick=${() => act("subtract_picked")} />`}
      ${chosen.some((each) => each.named) && html`<${Button} text="Delete name" label="Delete the name; the Gaussians stay" onClick=${() => act("forget_picked")} />`}
      <${Button} danger icon="trash" text="Remove" label="Hide these Gaussians, by a layer (Delete)" disabled=${state.value.painting} onClick=${() => act("remove_picked")} />
      ${selection && html`<${Button} text="Deselect" label="Select nothing (Esc)" onClick=${() => act("pick_names", { names: [] })} />`}
    </div>
    ${selection && html`<${Entry} key=${selection.origin} label="Make it an object" button="Name it" value=${selection.origin} onEnter=${(name) => act("name_selection", { name })} />`}
    ${chosen.length === 1 && html`<${Entry} key=${names} label="Name" button="Rename" value=${chosen[0].named ? names : ""} onEnter=${(name) => act("rename_picked", { name })} />`}
  </section>`;
}

// Other colours for what is picked, or for what belongs to no object, at once
function Recolor() {
  const now = state.value, chosen = picked().map((each) => each.name);
  const names = now.selection ? [] : chosen.length ? chosen : ["background"];
  const layer = now.layers.find((each) => each.recolor && each.object === names[0]), values = layer?.recolor ?? {};
  const fixed = now.painting || layer?.locked;
  const set = (setting, value) => act("recolor", { names, setting, value });
  const swaps = values.swap ?? [];
  return html`<details><summary>Recolour ${now.selection ? "the selection" : chosen.length ? chosen.join(", ") : "the background"}</summary>
    ${hello.value.recolorings.map((each) => html`<${Slider} label=${each.label} value=${values[each.name] ?? each.value} low=${each.low} high=${each.high} step=${each.step}
      disabled=${fixed} onInput=${(value) => set(each.name, value)} />`)}
    <div class="row"><label class="check"><input type="color" value=${values.tint ?? "#c08040"} disabled=${fixed} onInput=${(event) => set("tint", event.target.value)} /><span>Tint</span></label>
      ${values.tint && html`<${Button} text="No tint" label="Remove the tint" onClick=${() => set("tint", null)} />`}</div>
    ${swaps.map((each, number) => { const [from, to] = each.split("="); return html`<div class="row"><label class="check"><input type="color" value=${to} disabled=${fixed}
        onInput=${(event) => set("swap", swaps.with(number, `${from}=${event.target.value}`))} /><span>instead of ${from}</span></label>
      <${Button} text="Remove" label=${`Do not exchange ${from}`} disabled=${fixed} onClick=${() => set("swap", swaps.toSpliced(number, 1))} /></div>`; })}
    <div class="row"><label class="check"><input type="color" disabled=${fixed} onChange=${({ target }) => set("swap", [...swaps, `${target.value}=${target.value}`])} /><span>Exchange a colour of it</span></label></div>
    <${Select} label="Match the colours of" value=${values.match ?? ""} choices=${[["", "no picture"], ...now.styles.map((each) => each.title)]}
      onChange=${(title) => set("match", title || null)} />
    <div class="row"><${Button} text="Own colours" label="Remove the recolouring" disabled=${!layer || fixed} onClick=${() => act("remove_paint", { name: layer.name })} /></div>
  </details>`;
}
