// What viser's page does not tell: a key that is held, where the pointer rests, drags on a picture.
// It is told by way of a text field of the page, which viser sends to the server.
// And viser draws splats that are hidden, far away: without a GPU that takes seconds each time.
(() => {
  if (window.stylesplatWire) return;
  window.stylesplatWire = true;
  const REST = 80; // milliseconds
  const LEAST = 0.02; // of a picture's side: less is a click
  const said = { number: 0, before: false, at: null, part: null, large: 0 };
  const setter = Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, "value").set;
  let timer = 0;
  let drag = null;

  function tell() {
    const field = document.querySelector('input[value^="$MARK"]');
    if (!field) return;
    said.number += 1;
    setter.call(field, "$MARK" + JSON.stringify(said));
    field.dispatchEvent(new Event("input", { bubbles: true }));
  }

  function hold(before) {
    if (said.before === before) return;
    said.before = before;
    tell();
  }

  function point(at) {
    if (at === null && said.at === null) return;
    said.at = at;
    tell();
  }

  const share = (event, box) => [
    Math.min(Math.max((event.clientX - box.x) / box.width, 0), 1),
    Math.min(Math.max((event.clientY - box.y) / box.height, 0), 1),
  ];
  const types = (event) => event.target.closest && event.target.closest("input, textarea");
  const plain = (event) => !(event.ctrlKey || event.metaKey || event.altKey || event.shiftKey);

  window.addEventListener("keydown", (event) => {
    if (event.code === "KeyB" && !event.repeat && plain(event) && !types(event)) hold(true);
  });
  window.addEventListener("keyup", (event) => event.code === "KeyB" && hold(false));
  window.addEventListener("blur", () => hold(false));

  window.addEventListener("pointermove", (event) => {
    if (drag) return stretch(event);
    clearTimeout(timer);
    if (event.buttons || event.target.tagName !== "CANVAS") return point(null);
    const at = share(event, event.target.getBoundingClientRect());
    timer = setTimeout(() => point(at), REST);
  }, true);
  document.documentElement.addEventListener("pointerleave", () => {
    clearTimeout(timer);
    point(null);
  });

  function picture(event) {
    const image = event.target;
    const title = image.tagName === "IMG" && image.parentElement.previousElementSibling;
    return title && title.textContent === "$TITLE" ? image : null;
  }

  function stretch(event) {
    const [x, y] = share(event, drag.image.getBoundingClientRect());
    drag.part = [Math.min(x, drag.x), Math.min(y, drag.y), Math.max(x, drag.x), Math.max(y, drag.y)];
    const [left, top, right, bottom] = drag.part.map((each) => 100 * each);
    drag.frame.style.cssText =
      `position: absolute; left: ${left}%; top: ${top}%; width: ${right - left}%;` +
      `height: ${bottom - top}%; outline: 2px solid #ffa014; pointer-events: none`;
  }

  const gl = WebGL2RenderingContext.prototype;
  const { texSubImage2D, drawElementsInstanced } = gl;
  let hidden = false;
  gl.texSubImage2D = function (...given) {
    const rows = given[8]; // of a transform, if it is that of the splats
    if (rows instanceof Float32Array && rows.length === 12)
      hidden = [rows[3], rows[7], rows[11]].every((each) => each === $FAR);
    return texSubImage2D.apply(this, given);
  };
  gl.drawElementsInstanced = function (...given) {
    if (!hidden || given[4] < $MANY) drawElementsInstanced.apply(this, given);
  };

  window.addEventListener("change", (event) => {
    const file = event.target.files && event.target.files[0];
    if (!file || file.size <= $MOST) return;
    event.stopImmediatePropagation(); // viser would send it
    said.large = file.size;
    tell();
    said.large = 0;
  }, true);

  window.addEventListener("dragstart", (event) => picture(event) && event.preventDefault());
  window.addEventListener("pointerdown", (event) => {
    const image = picture(event);
    if (!image || event.button) return;
    event.preventDefault();
    const [x, y] = share(event, image.getBoundingClientRect());
    const frame = image.parentElement.appendChild(document.createElement("div"));
    drag = { image, frame, x, y, part: [x, y, x, y] };
  }, true);
  window.addEventListener("pointerup", () => {
    if (!drag) return;
    const [left, top, right, bottom] = drag.part;
    drag.frame.remove();
    said.part = right - left < LEAST || bottom - top < LEAST ? [0, 0, 1, 1] : drag.part;
    drag = null;
    tell();
    said.part = null;
  }, true);
})();
