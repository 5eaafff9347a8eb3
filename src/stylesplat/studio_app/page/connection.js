// What the page knows: everything comes over one WebSocket, see messages.py

import { batch, signal } from "./libraries/signals.js";

export const hello = signal(null);
export const state = signal(null);
export const progress = signal({ what: "" });
export const notes = signal([]);
export const online = signal(true);
export const renewed = signal(false); // whether the studio was started anew: until its address is opened in this browser
export const busy = signal({ what: "" }); // what takes long just now
export const newest = signal(null); // the title of the style picture that was added last

const SECONDS = 6; // that a note stays; a failure stays three times as long
const SILENT = 5000; // milliseconds without an answer, after which the server is said not to answer
const PATIENCE = 15000; // milliseconds between two tries to connect, at most
const NAMED = 3; // files that one note names
const handlers = {}; // of binary messages, by kind
let socket = null, number = 0, silence = null, tries = 0;

export function on(kind, handler) {
  handlers[kind] = handler;
}

// Ask for an action; returns whether it was sent. What changes something is not sent to a server that is silent:
// it would be done much later
export function act(what, fields = {}) {
  const changes = what !== "look" && what !== "ping";
  const isSent = socket?.readyState === WebSocket.OPEN && (online.value || !changes);
  if (isSent) socket.send(JSON.stringify({ do: what, ...fields }));
  else if (changes) {
    note("The studio cannot be reached, so nothing was done. Try again when it answers.", true);
    if (state.value) state.value = { ...state.value }; // controls show again what is so
  }
  return isSent;
}

export function note(text, failure = false) {
  const entry = { number: ++number, text, failure };
  notes.value = [...notes.value.filter((each) => each.text !== text).slice(-3), entry];
  setTimeout(() => dismiss(entry.number), 1000 * SECONDS * (failure ? 3 : 1));
}

export function dismiss(which) {
  notes.value = notes.value.filter((each) => each.number !== which);
}

const texts = {
  hello: (message) => (hello.value = message),
  state: (message) => (state.value = message),
  progress: (message) => (progress.value = message),
  busy: (message) => (busy.value = message),
  pong() {},
  flight: (message) => window.studio.flyAlong(message),
  note: (message) => note(message.text, message.failure),
  download({ url, name }) {
    const link = Object.assign(document.createElement("a"), { href: url, download: name });
    document.body.append(link);
    link.click();
    link.remove();
  },
};

function receive({ data }) {
  online.value = true;
  expect();
  if (typeof data === "string") {
    const message = JSON.parse(data);
    batch(() => texts[message.kind]?.(message));
    return;
  }
  const length = new DataView(data).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
  handlers[header.kind]?.(header, new Uint8Array(data, 4 + length));
}

// Wait for the next message, which comes soon after a ping; timers of a tab that nobody sees say nothing
function expect() {
  clearTimeout(silence);
  silence = setTimeout(() => document.hidden || (online.value = false), SILENT);
}

export function connect(opened) {
  socket = new WebSocket(`${location.protocol.replace("http", "ws")}//${location.host}/socket`);
  socket.binaryType = "arraybuffer";
  socket.onmessage = receive;
  socket.onopen = () => {
    if (renewed.value) location.reload(); // it may be another scene
    online.value = true;
    tries = 0;
    expect();
    opened();
  };
  socket.onclose = async () => {
    online.value = false;
    busy.value = { what: "" };
    renewed.value = await isRefused();
    setTimeout(() => connect(opened), Math.min(renewed.value ? SILENT : PATIENCE, 1000 * 2 ** tries++));
  };
}

// Whether there is a server that this page's token is not for
async function isRefused() {
  try {
    return (await fetch("/", { cache: "no-store" })).status === 403;
  } catch {
    return false;
  }
}

setInterval(() => act("ping"), SILENT / 4);
document.addEventListener("visibilitychange", () => {
  act("ping");
  expect();
});

// Add style pictures, one after the other, and tell at the end what became of them
export async function upload(files) {
  const added = [], refused = [];
  for (const file of files) {
    const { title, error } = await send(file);
    if (error) refused.push([file.name, error]);
    else added.push((newest.value = title));
  }
  if (added.length) note(added.length > 1 ? `Added ${added.length} pictures.` : `Added ${added[0]}.`);
  if (refused.length === 1) note(refused[0][1], true);
  if (refused.length < 2) return;
  const names = refused.slice(0, NAMED).map(([name]) => name), others = refused.length - names.length;
  note(`${refused.length} files were not added: ${names.join(", ")}${others ? ` and ${others} more` : ""}. ${refused.at(-1)[1]}`, true);
}

async function send(file) {
  const most = hello.value.max_bytes, size = Math.round(file.size / 2 ** 20);
  if (file.size > most) return { error: `${file.name} has ${size} MB. Send ${most / 2 ** 20} MB at most.` };
  try {
    const answer = await fetch(`/style?name=${encodeURIComponent(file.name)}`, { method: "POST", body: file });
    const text = await answer.text();
    return answer.ok ? { title: text } : { error: text };
  } catch {
    return { error: `${file.name} could not be sent.` };
  }
}
