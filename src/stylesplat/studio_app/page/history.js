// Snapshots, and the history of all steps

import { useEffect, useRef } from "./libraries/hooks.js";
import { act, state } from "./connection.js";
import { Button, Entry, html } from "./widgets.js";

export function Snapshots() {
  const now = state.value;
  return html`<section aria-label="Snapshots"><h3>Snapshots</h3>
    <ul class="steps">${now.snapshots.map((each) => html`<li class="line" key=${each.number}>
      <${StepButton} step=${each} title=${`Restore ${each.note}`} onClick=${() => act("restore", { number: each.number })} />
      <${Button} icon="trash" label=${`Delete the snapshot ${each.note}`} onClick=${() => act("forget_snapshot", { number: each.number })} /></li>`)}</ul>
    <${Entry} key=${now.snapshots.length} label="Keep the whole scene as" button="Keep" value=${`Snapshot ${now.snapshots.length + 1}`} onEnter=${(name) => act("snapshot", { name })} /></section>`;
}

// All steps, the last one first: a click goes back to one, or forth
export function History() {
  const { history, now } = state.value, list = useRef(null), present = useRef(null);
  const later = history.findIndex((each) => each.number === now);
  useEffect(() => {
    // the list alone, not the panel around it
    const { offsetTop: top, offsetHeight: height } = present.current, { scrollTop: from, clientHeight: shown } = list.current;
    list.current.scrollTop = Math.min(Math.max(from, top + height - shown), top);
  }, [now]);
  return html`<section aria-label="History"><h3>History</h3>
    <ul class="steps history" ref=${list}>${[...history.entries()].reverse().map(([row, each]) => html`<li key=${each.number} class=${row > later ? "undone" : ""} ref=${each.number === now ? present : null}>
      <${StepButton} step=${each} current=${each.number === now} title=${`Go to: ${each.note}`} onClick=${() => each.number !== now && act("go_to", { number: each.number })} /></li>`)}</ul>
    <p class="hint">It stays with the scene: the last 200 steps, in 2 GB at most.</p></section>`;
}

const StepButton = ({ step, title, current, onClick }) => html`<button type="button" class="card flat step" title=${title} aria-current=${current ? "step" : undefined} onClick=${onClick}>
  ${step.picture ? html`<img src=${step.picture} alt="" />` : html`<span class="blank"></span>`}<span>${step.note}</span></button>`;
