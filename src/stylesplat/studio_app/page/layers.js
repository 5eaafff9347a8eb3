// The panel of layers, the highest first, with variants, snapshots and the history below

import { above, active, mode, tool, variant } from "./choices.js";
import { useRef } from "./libraries/hooks.js";
import { useSignal } from "./libraries/signals.js";
import { act, hello, note, state } from "./connection.js";
import { History, Snapshots } from "./history.js";
import { Button, html, Icon, percent, Select, Slider } from "./widgets.js";

const BLENDS = [["normal", "normal"], ["luminosity", "luminosity"], ["colour", "colour"]];
const RESTING = 400; // milliseconds without motion of a slider, after which a layer is painted again

// The layer that was chosen, unless something else was picked since; else the highest of what is picked
export function activeLayer() {
  const { layers, objects } = state.value, picked = objects.filter((each) => each.picked).map((each) => each.name);
  const own = layers.find((each) => each.name === active.value);
  if (own && (!picked.length || picked.includes(own.object))) return own;
  return picked.length === 1 ? layers.filter((each) => each.object === picked[0]).at(-1) : undefined;
}

export function Layers() {
  const now = state.value, chosen = now.objects.filter((each) => each.picked).map((each) => each.name);
  const layers = [...now.layers].reverse(), list = useRef(null), moving = useSignal(null);
  const variants = now.variants.map((each) => ({ ...each, current: now.current.includes(each.id) }))
    .filter((each) => !chosen.length || chosen.includes(each.object)).reverse().sort((a, b) => b.starred - a.starred);
  const move = (name, row) => act("move_layer", { name, to: layers.length - 1 - row });
  // A drag by the handle, while which no controls are between the layers: the place is that of the row whose middle
  // the pointer has passed
  const grip = (name, row) => ({
    onPointerDown: (event) => {
      event.preventDefault();
      event.currentTarget.setPointerCapture(event.pointerId);
      moving.value = { name, from: row, to: row };
    },
    onPointerMove: (event) => {
      if (moving.value?.name !== name) return;
      const middles = [...list.current.children].map((each) => each.getBoundingClientRect()).map((box) => box.y + box.height / 2);
      const to = middles.filter((y, at) => at !== row && y < event.clientY).length;
      if (to !== moving.value.to || !moving.value.folded) moving.value = { ...moving.value, to, folded: true };
    },
    onPointerUp: () => {
      if (moving.value && moving.value.to !== row) move(name, moving.value.to);
      moving.value = null;
    },
    onPointerCancel: () => (moving.value = null),
    onKeyDown: (event) => {
      const by = { ArrowUp: -1, ArrowDown: 1 }[event.key];
      if (!by) return;
      event.preventDefault();
      move(name, row + by);
    },
  });
  const { from, to } = moving.value ?? {};
  const place = (row) => (moving.value && row === to && to !== from ? (to < from ? "before" : "after") : "");
  return html`<aside class="panel layers" aria-label="Layers">
    <div class="head"><h2>Layers</h2><span class="grow"></span>
      <${Button} icon="plus" text="New layer" label="The next style goes on a new layer, above what is there" active=${above.value} onClick=${() => (above.value = !above.value)} /></div>
    ${!layers.length && html`<p class="hint">Nothing is painted. Pick an object, then click a style.</p>`}
    <ul ref=${list}>${layers.map((layer, row) => html`<${Layer} key=${layer.name} layer=${layer} lowest=${row === layers.length - 1} grip=${grip(layer.name, row)}
      folded=${moving.value?.folded} dragged=${row === from} place=${place(row)} />`)}</ul>
    ${variants.length > 0 && html`<section aria-label="Variants"><h3>Variants${chosen.length ? ` of ${chosen.join(", ")}` : ""}</h3>
      <ul class="cards wide">${variants.map((each) => html`<li key=${each.id}>
        <button type="button" class="card" aria-pressed=${each.current} title=${`${each.object}: ${each.title}. ${each.settings}`} onClick=${() => act("use_variant", { id: each.id })}>
          <img src=${each.thumbnail} alt="" /><span class="name">${chosen.length === 1 ? "" : `${each.object}: `}${each.title}</span>
          <span class="name quiet">${each.settings}</span></button>
        <span class="corner-buttons"><${Button} icon="star" label=${`${each.starred ? "Unstar" : "Star"} ${each.object}: ${each.title}`} active=${each.starred} onClick=${() => act("star_variant", { id: each.id, starred: !each.starred })} />
        <${Button} icon="more" label=${`Name or delete ${each.object}: ${each.title}`} onClick=${() => (variant.value = each.id)} />
        <${Button} icon="compare" label=${`Compare with ${each.object}: ${each.title}`} active=${now.compared === each.id} onClick=${() => compare(each.id)} /></span></li>`)}</ul></section>`}
    <${Snapshots} /><${History} />
  </aside>`;
}

function compare(id) {
  const other = state.value.compared === id ? null : id;
  act("compare_with", { id: other });
  mode.value = other === null ? "after" : "split";
}

function Layer({ layer, lowest, grip, folded, dragged, place }) {
  const { name, object, recolor } = layer, now = state.value, label = name.split("/")[1];
  const found = now.objects.find((each) => each.name === object), chosen = activeLayer()?.name === name;
  const fixed = layer.locked || now.painting;
  const what = layer.kind === "edit" ? layer.title : recolor ? `the colours of ${object}` : `the paint of ${object}${label ? ` (${label})` : ""}`;
  const choose = () => {
    active.value = name;
    if (now.selection) return; // it stays, for a mask
    if (found ? !found.picked : now.objects.some((each) => each.picked)) act("pick_names", { names: found ? [object] : [] });
  };
  return html`<li class=${`layer ${layer.visible ? "" : "off"} ${dragged ? "dragged" : ""} ${place}`}>
    <div class="line"><button type="button" class="square grip" aria-label=${`Move ${what}: drag, or the arrow keys`} title="Drag to reorder" ...${grip}><${Icon} name="grip" /></button>
      <button type="button" class="card flat" aria-pressed=${chosen} aria-expanded=${chosen && !folded} title=${layer.settings} onClick=${choose}>
        ${found?.thumbnail ? html`<img src=${found.thumbnail} alt="" />` : html`<span class="blank"></span>`}
        <span><b>${object}${layer.kind === "paint" && label ? ` ${label}` : ""}</b>${layer.title !== object && html`<br />${layer.title}`}${layer.masked ? ", masked" : ""}</span></button>
      <${Button} icon=${layer.visible ? "eye" : "hidden"} label=${`${layer.visible ? "Hide" : "Show"} ${what}`} onClick=${() => act("set_visible", { name, visible: !layer.visible })} /></div>
    <${Slider} label="Strength" value=${layer.strength} high=${1.5} show=${percent} disabled=${fixed} onInput=${(strength) => act("adjust_layer", { name, strength })} />
    ${chosen && !folded && html`<${Controls} layer=${layer} what=${what} fixed=${fixed} lowest=${lowest} />`}</li>`;
}

// What else can be changed of the layer that is chosen
function Controls({ layer, what, fixed, lowest }) {
  const { name, values } = layer;
  const set = (settings) => act("repaint_layer", { name, settings });
  const offered = hello.value.settings, size = offered.find((each) => each.name === "scale"), colors = offered.find((each) => each.name === "color");
  return html`${layer.kind === "paint" && html`<${Slider} label="Form" value=${layer.form} high=${1.5} show=${percent} disabled=${fixed} onInput=${(form) => act("adjust_layer", { name, form })} />
      <${Resting} key=${values.scale} control=${size} value=${values.scale} disabled=${layer.locked} onRest=${(scale) => set({ scale, quality: "draft" })} />
      <div class="row"><${Select} label="Colours" value=${values.color} choices=${colors.choices} disabled=${layer.locked} onChange=${(color) => set({ color, quality: "draft" })} />
        ${values.quality === "draft" && html`<${Button} text="Finish" label="Paint it at full quality" disabled=${fixed} onClick=${() => set({ quality: "normal" })} />`}</div>`}
    ${!layer.title.startsWith("removed") && html`<${Select} label=${lowest ? "Blend with the scene" : "Blend with what is below"} value=${layer.blend} choices=${BLENDS} disabled=${fixed} onChange=${(blend) => act("set_blend", { name, blend })} />`}
    <div class="row"><${Button} icon="mask" text="Mask" label="Brush the layer out, and in again" active=${tool.value === "mask"} disabled=${fixed} onClick=${() => brushMask()} />
      <${Button} text="To selection" label="Show the layer within the selection alone" disabled=${fixed || !state.value.selection} onClick=${() => act("mask_by_selection", { name })} />
      ${layer.masked && html`<${Button} text="No mask" label="Remove the mask" disabled=${fixed} onClick=${() => act("remove_mask", { name })} />`}</div>
    <div class="row">
      <${Button} icon=${layer.locked ? "lock" : "unlock"} label=${`${layer.locked ? "Unlock" : "Lock"} ${what}`} active=${layer.locked} onClick=${() => act("set_locked", { name, locked: !layer.locked })} />
      <${Button} icon="alone" label=${layer.solo ? "Show the other layers again" : `Show ${what} alone`} active=${layer.solo} onClick=${() => act("solo_layer", { name })} />
      <span class="grow"></span>
      <${Button} icon="trash" danger label=${`Remove ${what}`} disabled=${fixed} onClick=${() => act("remove_paint", { name })} /></div>
    ${layer.kind !== "edit" && state.value.layers.length > 1 && html`<div class="row"><${Select} label="Settings like" value="" disabled=${fixed}
      choices=${[["", "choose a layer"], ...state.value.layers.filter((each) => each.name !== name).map((each) => [each.name, `${each.object}: ${each.title}`])]}
      onChange=${(other) => other && act("copy_settings", { name, source: other })} /></div>`}`;
}

function brushMask() {
  tool.value = tool.value === "mask" ? "object" : "mask";
  if (tool.value === "mask") note("Brush over the picture to take the layer away there.");
}

// A slider whose value counts once it rests
function Resting({ control, value, disabled, onRest }) {
  const shown = useSignal(value), timer = useRef(null);
  const change = (next) => {
    shown.value = next;
    clearTimeout(timer.current);
    timer.current = setTimeout(() => onRest(next), RESTING);
  };
  return html`<${Slider} label=${control.label} value=${shown.value} low=${control.low} high=${control.high} step=${control.step} disabled=${disabled} onInput=${change} />`;
}
