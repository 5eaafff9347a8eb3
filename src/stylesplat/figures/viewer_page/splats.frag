#version 300 es
precision highp float;

uniform float cut; // pixels from the left, where before ends and after begins
in vec2 offset;
flat in vec4 after, before;
out vec4 color;

void main() {
  vec4 look = gl_FragCoord.x < cut ? before : after;
  float alpha = min(look.a * exp(-0.5 * dot(offset, offset)), 0.999);
  if (alpha < 1.0 / 255.0) discard;
  color = alpha * vec4(look.rgb, 1);
}
