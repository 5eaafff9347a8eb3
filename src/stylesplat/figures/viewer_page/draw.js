// Gaussians on a canvas, by WebGL 2

import { sorter } from "./sort.js";
import { WORDS } from "./unpack.js";

const WIDE = 1024; // Gaussians in a line of a texture, and those that are drawn as one instance

const REMEDY = "Turn on hardware acceleration in the browser's settings, or open this page in another.";

export function drawer(canvas, splats, about, sources, background = [22 / 255, 22 / 255, 24 / 255]) {
  const gl = canvas.getContext("webgl2", { alpha: false, antialias: false });
  if (!gl) throw new Error(`WebGL 2 is missing or turned off. ${REMEDY}`);
  const program = linked(gl, sources.vertex, sources.fragment);
  const at = (name) => gl.getUniformLocation(program, name);
  const places = Object.fromEntries(
    ["axes", "eye", "focal", "centre", "size", "cut", "count"].map((name) => [name, at(name)])
  );
  gl.useProgram(program);
  const textures = [
    splatTexture(gl, splats, gl.TEXTURE0),
    paletteTexture(gl, splats.palettes, about.bands, gl.TEXTURE1),
  ];
  gl.uniform1i(at("splats"), 0);
  gl.uniform1i(at("palettes"), 1);
  gl.uniform1i(at("bands"), about.bands);
  gl.uniform2fv(at("strongest"), about.strongest);
  gl.uniform2fv(at("colors"), about.colors);
  gl.uniform1i(at("antialiased"), about.antialiased);
  gl.uniform1i(at("order"), 2);
  corners(gl);
  gl.enable(gl.BLEND);
  gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA); // the farthest first, colours times coverage
  const sorted = sorter(splats.centres, WIDE);
  const lines = Math.ceil(splats.count / WIDE);
  textures.push(orderTexture(gl, lines, gl.TEXTURE2));

  // A world-to-camera matrix of 16 numbers, line by line, and lengths in pixels; `cut` is a share
  const draw = ({ viewmat, focal, centre }, cut) => {
    const { width, height } = canvas;
    const axes = [0, 1, 2].map((line) => viewmat.slice(4 * line, 4 * line + 3));
    const eye = [0, 1, 2].map((axis) =>
      axes.reduce((sum, line, n) => sum - line[axis] * viewmat[4 * n + 3], 0)
    );
    const { order, rows } = sorted(viewmat);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, WIDE, lines, gl.RED_INTEGER, gl.UNSIGNED_INT, order);
    gl.viewport(0, 0, width, height);
    gl.clearColor(...background, 1);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.uniformMatrix3fv(places.axes, true, axes.flat());
    gl.uniform3fv(places.eye, eye);
    gl.uniform2fv(places.focal, focal);
    gl.uniform2fv(places.centre, centre);
    gl.uniform2f(places.size, width, height);
    gl.uniform1f(places.cut, cut * width);
    gl.uniform1ui(places.count, rows);
    gl.drawElementsInstanced(gl.TRIANGLES, 6 * WIDE, gl.UNSIGNED_SHORT, 0, Math.ceil(rows / WIDE));
  };
  draw.remove = () => {
    textures.forEach((each) => gl.deleteTexture(each));
    gl.deleteProgram(program);
  };
  return draw;
}

function splatTexture(gl, { count, words }, unit) {
  const lines = Math.ceil(count / WIDE);
  if (lines > gl.getParameter(gl.MAX_TEXTURE_SIZE)) {
    throw new Error(`${count} Gaussians are more than this graphics card can hold. Export fewer.`);
  }
  const padded = new Uint32Array(WORDS * WIDE * lines);
  padded.set(words);
  const found = texture(gl, unit);
  const form = [gl.RGBA_INTEGER, gl.UNSIGNED_INT, padded];
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32UI, (WORDS / 4) * WIDE, lines, 0, ...form);
  return found;
}

// A line of 256 for each band, first what is there and then what is added
function paletteTexture(gl, palettes, bands, unit) {
  const found = texture(gl, unit);
  gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
  const lines = Math.max(1, 2 * bands);
  const texels = new Uint8Array(3 * 256 * lines);
  palettes.forEach((palette, n) => texels.set(palette, n * palette.length));
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB8, 256, lines, 0, gl.RGB, gl.UNSIGNED_BYTE, texels);
  return found;
}

// Which Gaussian comes when; it stays bound, to be filled for each picture
function orderTexture(gl, lines, unit) {
  const found = texture(gl, unit);
  gl.texStorage2D(gl.TEXTURE_2D, 1, gl.R32UI, WIDE, lines);
  return found;
}

// Two triangles a Gaussian: instances of a Gaussian each take several times as long
function corners(gl) {
  const indices = new Uint16Array(6 * WIDE);
  for (let quad = 0; quad < WIDE; quad++) {
    indices.set([0, 1, 2, 2, 1, 3].map((corner) => 4 * quad + corner), 6 * quad);
  }
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, indices, gl.STATIC_DRAW);
}

function texture(gl, unit) {
  const found = gl.createTexture();
  gl.activeTexture(unit);
  gl.bindTexture(gl.TEXTURE_2D, found);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
  return found;
}

function linked(gl, vertex, fragment) {
  const program = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) {
      throw new Error(`The graphics driver refuses a program: ${gl.getShaderInfoLog(shader)}`);
    }
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) {
    throw new Error(`The graphics driver refuses a program: ${gl.getProgramInfoLog(program)}`);
  }
  return program;
}
