#version 300 es
precision highp float;
precision highp int;
precision highp usampler2D;

uniform usampler2D splats; // three texels each
uniform usampler2D order; // the farthest first
uniform uint count; // of those that are before the camera
uniform sampler2D palettes; // two lines for each band: what is there, and what is added
uniform int bands;
uniform vec2 strongest; // what the largest byte means, in each of both
uniform vec2 colors; // what the smallest and the largest byte of a colour mean
uniform mat3 axes; // from the world to the camera
uniform vec3 eye;
uniform vec2 focal, centre, size; // pixels
uniform bool antialiased; // whether a Gaussian fades by how much the low pass enlarges it

out vec2 offset; // in standard deviations
flat out vec4 after, before;

const float LOW_PASS = 0.3; // square pixels
const float MARGIN = 0.15; // of the size: how far outside, perspective is still exact

float basis[15];

void set_basis(vec3 d) {
  float x = d.x, y = d.y, z = d.z, xx = x * x, yy = y * y, zz = z * z;
  basis = float[15](
    -0.4886025 * y, 0.4886025 * z, -0.4886025 * x,
    1.0925484 * x * y, -1.0925484 * y * z, 0.3153916 * (3.0 * zz - 1.0), -1.0925484 * x * z,
    0.5462742 * (xx - yy),
    -0.5900436 * y * (3.0 * xx - yy), 2.8906114 * x * y * z, -0.4570458 * y * (5.0 * zz - 1.0),
    0.3731763 * z * (5.0 * zz - 3.0), -0.4570458 * x * (5.0 * zz - 1.0),
    1.4453057 * z * (xx - yy), -0.5900436 * x * (xx - 3.0 * yy)
  );
}

vec3 color(uint mean, uint index) {
  vec3 share = vec3(mean & 255u, (mean >> 8) & 255u, (mean >> 16) & 255u) / 255.0;
  vec3 sum = mix(colors.xxx, colors.yyy, share);
  int first = int(index & 255u), second = int((index >> 8) & 255u);
  for (int band = 0; band < bands; band++) {
    vec3 there = texelFetch(palettes, ivec2(first, band), 0).rgb * 255.0 - 128.0;
    vec3 added = texelFetch(palettes, ivec2(second, bands + band), 0).rgb * 255.0 - 128.0;
    sum += basis[band] * (strongest.x * there + strongest.y * added) / 127.0;
  }
  return max(sum, 0.0);
}

// How far the picture of a place moves with it; constant far outside, where it would explode
mat3x2 jacobian(vec3 place) {
  vec2 low = -(centre + MARGIN * size) / focal, high = (size - centre + MARGIN * size) / focal;
  vec2 slope = clamp(place.xy / place.z, low, high);
  return mat3x2(focal.x / place.z, 0, 0, focal.y / place.z, -focal * slope / place.z);
}

void main() {
  gl_Position = vec4(0, 0, 2, 1); // not in the picture
  uint place_in_order = uint(gl_InstanceID) * 1024u + uint(gl_VertexID >> 2);
  if (place_in_order >= count) return;
  uint row = texelFetch(order, ivec2(gl_VertexID >> 2, gl_InstanceID), 0).r;
  ivec2 texel = ivec2(3 * int(row & 1023u), int(row >> 10));
  uvec4 one = texelFetch(splats, texel, 0);
  uvec4 two = texelFetch(splats, texel + ivec2(1, 0), 0);
  uvec4 three = texelFetch(splats, texel + ivec2(2, 0), 0);
  vec3 ray = uintBitsToFloat(one.xyz) - eye;
  vec3 place = axes * ray;
  vec4 xx_yy = uintBitsToFloat(uvec4(one.w, two.xyz));
  float yz = uintBitsToFloat(two.w), zz = uintBitsToFloat(three.x);
  mat3 spread = mat3(xx_yy.xyz, xx_yy.y, xx_yy.w, yz, xx_yy.z, yz, zz);

  mat3x2 flat_axes = jacobian(place) * axes;
  mat2 spread2d = flat_axes * spread * transpose(flat_axes);
  float a = spread2d[0][0] + LOW_PASS, b = spread2d[0][1], c = spread2d[1][1] + LOW_PASS;
  float area = max(spread2d[0][0] * spread2d[1][1] - b * b, 0.0); // squared
  float factor = antialiased ? sqrt(area / (area + LOW_PASS * (a + c - LOW_PASS))) : 1.0;
  float root = length(vec2(0.5 * (a - c), b)), longest = 0.5 * (a + c) + root;
  float shortest = max((a * c - b * b) / longest, 1e-6);
  vec2 along = a >= c ? vec2(longest - c, b) : vec2(b, longest - a);
  along = root > 0.0 ? normalize(along) : vec2(1, 0);

  float opacity = factor * float(three.y >> 24) / 255.0;
  float earlier = factor * float(three.z >> 24) / 255.0;
  float reach = sqrt(2.0 * log(max(255.0 * max(opacity, earlier), 1.0)));
  offset = reach * (2.0 * vec2(gl_VertexID & 1, (gl_VertexID >> 1) & 1) - 1.0);
  vec2 shift = offset.x * sqrt(longest) * along + offset.y * sqrt(shortest) * vec2(-along.y, along.x);
  vec2 pixel = focal * place.xy / place.z + centre + shift;
  gl_Position = vec4((2.0 * pixel / size - 1.0) * vec2(1, -1), 0, 1);

  set_basis(normalize(ray));
  after = vec4(color(three.y, three.w & 65535u), opacity);
  before = vec4(color(three.z, three.w >> 16), earlier);
}
