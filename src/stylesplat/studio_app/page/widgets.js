// Buttons, sliders, dialogs and icons

import { h } from "./libraries/preact.js";
import { useEffect, useRef } from "./libraries/hooks.js";
import htm from "./libraries/htm.js";

export const html = htm.bind(h);

const PATHS = {
  undo: "M9 6 4 11l5 5M4 11h10a5 5 0 0 1 0 10h-3",
  redo: "m15 6 5 5-5 5M20 11H10a5 5 0 0 0 0 10h3",
  eye: "M2 12s4-7 10-7 10 7 10 7-4 7-10 7S2 12 2 12zm7 0a3 3 0 1 0 6 0 3 3 0 0 0-6 0",
  hidden: "M3 3l18 18M10 5.2A9 9 0 0 1 12 5c6 0 10 7 10 7a18 18 0 0 1-3 3.7M6 7.300A17 17 0 0 0 2 12s4 7 10 7a9 9 0 0 0 4-1",
  lock: "M6 11h12v9H6zM8.500 11V8a3.500 3.500 0 0 1 7 0v3",
  unlock: "M6 11h12v9H6zM8.500 11V7a3.500 3.500 0 0 1 6.800-1.200",
  left: "m14 6-6 6 6 6",
  level: "M3 12h18M7 12a5 5 0 0 1 10 0",
  color: "M14 4l6 6-2 2-6-6zM12.500 7.500 5 15l-1 5 5-1 7.500-7.500",
  mend: "M5 12l7-7 7 7-7 7zM9.500 12h5M12 9.500v5",
  star: "M12 4l2.500 5.200 5.500.8-4 4 1 5.700-5-2.700-5 2.700 1-5.700-4-4 5.500-.8z",
  more: "M5 12h.01M12 12h.01M19 12h.01",
  grip: "M5 8h14M5 12h14M5 16h14",
  mask: "M4 5h16v14H4zM12 8a4 4 0 1 0 0 8 4 4 0 0 0 0-8",
  trash: "M5 7h14M10 7V4h4v3M7 7l1 13h8l1-13M10 11v5M14 11v5",
  close: "M6 6l12 12M18 6 6 18",
  plus: "M12 5v14M5 12h14",
  crop: "M7 2v15h15M2 7h15v15",
  object: "M5 3l14 8-6.500 1.800L9 19z",
  surface: "M4 8V4h4M16 4h4v4M20 16v4h-4M8 20H4v-4M12 9a3 3 0 1 0 0 6 3 3 0 0 0 0-6",
  wand: "M4 20 14 10M17 3v4M15 5h4M20 10v3M18.500 11.500h3M9.500 3.500v3M8 5h3",
  ball: "M12 3a9 9 0 1 0 0 18 9 9 0 0 0 0-18M3 12c4 3 14 3 18 0",
  brush: "M20 4 11 13M9.500 12.500c-3 0-4 2-4 4.500 0 1.500-1 2.500-2.500 3 5 1.500 9-.5 9-4.500",
  lasso: "M12 4c5 0 9 2.500 9 6s-4 6-9 6-9-2.500-9-6 4-6 9-6M8 15.500c2 1.500 1 5.500-3 5.500",
  rectangle: "M4 6h16v12H4z",
  box: "M12 3l8 4.500v9L12 21l-8-4.500v-9zM12 12l8-4.500M12 12v9M12 12 4 7.500",
  guide: "M3 17c4-8 7 2 10-4s4-8 8-8M17 3l4 2-2.500 3.500M4 21c4-3 6 0 9-2",
  strokes: "M12 4a8 8 0 1 0 8 8M12 12l7-7M14.500 4.500H19.500V9.500",
  home: "M4 11l8-7 8 7M6 10v10h12V10",
  camera: "M4 8h4l2-3h4l2 3h4v11H4zM12 10a3.500 3.500 0 1 0 0 7 3.500 3.500 0 0 0 0-7",
  compare: "M12 3v18M3 6h9v12H3M12 6h9v12h-9",
  sliders: "M4 7h9M17 7h3M4 17h3M11 17h9M15 5v4M9 15v4",
  download: "M12 4v11M7 11l5 5 5-5M5 20h14",
  try: "M4 4h7v7H4zM13 4h7v7h-7zM4 13h7v7H4zM16.500 13.500v6M13.500 16.500h6",
  stop: "M6 6h12v12H6z",
  play: "M7 5l12 7-12 7z",
  alone: "M12 8a4 4 0 1 0 0 8 4 4 0 0 0 0-8M12 2v3M12 19v3M2 12h3M19 12h3",
  copy: "M8 8h12v12H8zM4 16V4h12",
  help: "M9 9a3 3 0 1 1 4 2.800c-.8.4-1 1-1 2.200M12 17.500v.5M12 2a10 10 0 1 0 0 20 10 10 0 0 0 0-20",
};

export const Icon = ({ name }) =>
  html`<svg class="icon" viewBox="0 0 24 24" aria-hidden="true"><path d=${PATHS[name]} /></svg>`;

// A button with a picture and perhaps words; `label` says what it does
export function Button({ icon, label, text, active, primary, danger, ...rest }) {
  const kind = [primary && "primary", danger && "danger", !text && "square"];
  return html`<button type="button" class=${kind.filter(Boolean).join(" ")} title=${label} aria-label=${text ? undefined : label}
    aria-pressed=${active} ...${rest}>${icon && html`<${Icon} name=${icon} />`}${text && html`<span>${text}</span>`}</button>`;
}

export function Slider({ label, value, low = 0, high = 1, step = 0.05, show, onInput, disabled }) {
  const words = show ? show(value) : String(Math.round(100 * value) / 100);
  return html`<label class="slider"><span>${label}</span><output>${words}</output>
    <input type="range" min=${low} max=${high} step=${step} value=${value} disabled=${disabled}
      aria-label=${label} aria-valuetext=${words}
      onInput=${(event) => onInput(Number(event.target.value))} /></label>`;
}

export const percent = (value) => `${Math.round(100 * value)} %`;

export function Select({ label, value, choices, onChange, disabled }) {
  return html`<label class="field"><span>${label}</span><select value=${value} disabled=${disabled} onChange=${(event) => onChange(event.target.value)}>
    ${choices.map((each) => {
      const [key, words] = Array.isArray(each) ? each : [each, each];
      return html`<option value=${key} selected=${key === value}>${words}</option>`;
    })}</select></label>`;
}

// A field whose words are sent by Enter or the button
export function Entry({ label, button, value = "", onEnter }) {
  const field = useRef(null);
  useEffect(() => {
    field.current.value = value; // once: what is typed outlives news of the server
  }, [value]);
  const enter = (event) => {
    event.preventDefault();
    onEnter(field.current.value);
  };
  return html`<form class="entry" onSubmit=${enter}><label class="field"><span>${label}</span>
    <input ref=${field} type="text" maxlength="100" /></label>
    <button type="submit">${button}</button></form>`;
}

export function Dialog({ title, onClose, children, wide }) {
  const element = useRef(null);
  useEffect(() => {
    element.current.showModal();
  }, []);
  const outside = (event) => event.target === element.current && onClose();
  return html`<dialog ref=${element} class=${wide ? "wide" : ""} aria-label=${title} onClose=${onClose} onClick=${outside}>
    <header><h2>${title}</h2><${Button} icon="close" label="Close" onClick=${onClose} /></header>
    <div class="content">${children}</div></dialog>`;
}
