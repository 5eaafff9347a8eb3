// The strip of views: those that are kept, in the order of the path through them, and the photos' own

import { dialog, leveling, turntable } from "./choices.js";
import { useEffect } from "./libraries/hooks.js";
import { useSignal } from "./libraries/signals.js";
import { act, hello, state } from "./connection.js";
import { Button, html, Slider } from "./widgets.js";

export function ViewTools({ viewport }) {
  const kept = state.value.views.filter((each) => each.position).length;
  const video = () => {
    turntable.value = { ...turntable.value, path: "views" };
    dialog.value = "keep";
  };
  return html`<${Button} icon="plus" text="Keep this view" label="Keep this view, which is the next one of the path" onClick=${() => act("keep_view", viewport().standing())} />
    <${Button} icon="level" text="Level" label="Turn the horizon" active=${leveling.value} onClick=${() => (leveling.value = true)} />
    <${Button} icon="play" text="Play" label="Fly along the views that are kept" disabled=${kept < 2} onClick=${() => act("preview_path", { seconds: turntable.value.seconds })} />
    <${Button} icon="download" text="Video" label="Make a video along the views that are kept" disabled=${kept < 2} onClick=${video} />`;
}

export function ViewStrip({ viewport }) {
  const { views } = state.value, kept = views.filter((each) => each.position);
  useEffect(() => act("show_views"), []);
  const fly = ({ position, target, photo }) => {
    const place = photo == null ? { position, target } : hello.value.photos[photo];
    viewport().fly(place.position, place.target);
  };
  return html`<ul class="strip">${views.map((each, row) => html`<li key=${`${each.photo ?? ""} ${each.name}`}>
      <button type="button" class="card" title=${`Fly to ${each.name}`} onClick=${() => fly(each)}>
        ${each.url ? html`<img src=${each.url} alt="" />` : html`<span class="blank"></span>`}<span class="name">${each.name}</span></button>
      ${each.position && html`<span class="corner-buttons">
        ${row > 0 && html`<${Button} icon="left" label=${`Move ${each.name} to the left`} onClick=${() => act("move_view", { number: row, to: row - 1 })} />`}
        <${Button} icon="close" label=${`Remove ${each.name}`} onClick=${() => act("forget_view", { number: row })} /></span>`}</li>`)}
    ${!kept.length && !views.length && html`<li class="hint">Keep views here: they are bookmarks, and a path for a video leads through them.</li>`}</ul>`;
}

// Turns what is up until the picture stands upright
export const Leveling = ({ viewport }) => leveling.value && html`<${Horizon} viewport=${viewport} />`;

function Horizon({ viewport }) {
  const angle = useSignal(0);
  const roll = (value) => viewport().roll((angle.value = value));
  const reset = () => {
    leveling.value = false;
    act("level", { up: null });
  };
  return html`<div class="leveling"><${Slider} label="Horizon, degrees" value=${angle.value} low=${-45} high=${45} step=${0.5} onInput=${roll} />
    <div class="row"><${Button} text="As photographed" label="What the photos say is up" disabled=${!state.value.up} onClick=${reset} />
      <span class="grow"></span><${Button} primary text="Done" label="Keep this horizon" onClick=${() => (leveling.value = false)} /></div></div>`;
}
