// Shaders: splats drawn like gs_codec's rasteriser (EWA projection of 3DGS), and the final picture
// of one or two scenes.
import { ROW } from './limits.js';

/**
 * Texels of a Gaussian: position and opacity; deviations, and R and G of SH-DC as halves; its
 * quaternion as pairs of fractions, and B.
 */
export const SHAPE = 3;

/** Texels of a Gaussian's SH-AC by SH degree: eight halves each, coefficient by coefficient. */
export const HARMONICS = [0, 2, 3, 6];

/** One triangle that covers the whole target. */
const wholeVertex = `#version 300 es
void main() {
  gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0.0, 1.0);
}`;

/** Shader text that fetches texels of SH-AC, and unpacks each into four pairs. */
const fetched = (first, end) =>
  Array.from({ length: end - first }, (_, k) => k + first)
    .map((k) => {
      const pairs = [0, 1, 2, 3].map((i) => `h${4 * k + i} = unpackHalf2x16(t${k}[${i}])`);
      return `uvec4 t${k} = texel(${k}); vec2 ${pairs.join(', ')};`;
    })
    .join('\n');

/** Shader text of a coefficient (one colour) from the fetched pairs. */
const coefficient = (k) =>
  `vec3(${[0, 1, 2].map((i) => `h${(3 * k + i) >> 1}.${'xy'[(3 * k + i) & 1]}`)})`;

/** Each pixel is a Gaussian: its position in the picture, and its appearance from there. */
const projectionFragment = `#version 300 es
precision highp float;
precision highp int;
precision highp usampler2D;

uniform usampler2D shapes;
uniform usampler2D harmonics;
uniform mat3 turn; // from the world to the camera: right, down, forward
uniform vec3 eye;
uniform vec2 focal;
uniform float nearest; // near plane
uniform vec2 centre; // of the picture, pixels from its upper left corner
uniform vec2 size;
uniform vec2 span; // of the picture that is seen: left and right end
uniform int degree; // that is drawn
uniform int texels; // of SH-AC, of a Gaussian
uniform bool antialiased;

// Of what is not seen, all is 0. Pixels: the centre; ends of two half-diameters of the ellipse of one
// deviation, (z, 0) and (x of light, w).
layout(location = 0) out uvec4 place;
layout(location = 1) out uvec4 light; // then opacity; colour, in halves

const float LOW_PASS = 0.3;

uvec4 shape(int k) {
  return texelFetch(shapes, ivec2(gl_FragCoord) * ivec2(${SHAPE}, 1) + ivec2(k, 0), 0);
}

uvec4 texel(int k) {
  return texelFetch(harmonics, ivec2(gl_FragCoord) * ivec2(texels, 1) + ivec2(k, 0), 0);
}

vec3 seen(vec3 base, vec3 d) {
  vec3 colour = 0.5 + 0.28209479177387814 * base;
  float x = d.x, y = d.y, z = d.z, xx = x * x, yy = y * y, zz = z * z;
  if (degree >= 1) {
    ${fetched(0, 2)}
    colour += -0.4886025119029199 * y * ${coefficient(0)}
      + 0.4886025119029199 * z * ${coefficient(1)}
      - 0.4886025119029199 * x * ${coefficient(2)};
    if (degree >= 2) {
      ${fetched(2, 3)}
      colour += 1.0925484305920792 * x * y * ${coefficient(3)}
        - 1.0925484305920792 * y * z * ${coefficient(4)}
        + 0.31539156525252005 * (2.0 * zz - xx - yy) * ${coefficient(5)}
        - 1.0925484305920792 * x * z * ${coefficient(6)}
        + 0.5462742152960396 * (xx - yy) * ${coefficient(7)};
      if (degree >= 3) {
        ${fetched(3, 6)}
        colour += -0.5900435899266435 * y * (3.0 * xx - yy) * ${coefficient(8)}
          + 2.890611442640554 * x * y * z * ${coefficient(9)}
          - 0.4570457994644658 * y * (4.0 * zz - xx - yy) * ${coefficient(10)}
          + 0.3731763325901154 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy) * ${coefficient(11)}
          - 0.4570457994644658 * x * (4.0 * zz - xx - yy) * ${coefficient(12)}
          + 1.445305721320277 * z * (xx - yy) * ${coefficient(13)}
          - 0.5900435899266435 * x * (xx - 3.0 * yy) * ${coefficient(14)};
      }
    }
  }
  return max(colour, 0.0);
}

mat3 rotation(vec4 q) { // w, x, y, z
  return mat3(
    1.0 - 2.0 * (q.z * q.z + q.w * q.w), 2.0 * (q.y * q.z + q.x * q.w), 2.0 * (q.y * q.w - q.x * q.z),
    2.0 * (q.y * q.z - q.x * q.w), 1.0 - 2.0 * (q.y * q.y + q.w * q.w), 2.0 * (q.z * q.w + q.x * q.y),
    2.0 * (q.y * q.w + q.x * q.z), 2.0 * (q.z * q.w - q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z));
}

void main() {
  place = light = uvec4(0);
  vec4 point = uintBitsToFloat(shape(0));
  vec3 away = point.xyz - eye;
  vec3 c = turn * away;
  if (!(c.z > nearest)) return;
  vec2 slope = c.xy / c.z;
  vec2 pixel = focal * slope + centre;
  // The Jacobian is that of a slope near the picture.
  vec2 margin = 0.15 * size / focal;
  vec2 near = clamp(slope, -centre / focal - margin, (size - centre) / focal + margin);
  uvec4 second = shape(1), third = shape(2);
  vec3 lengths = uintBitsToFloat(second.xyz);
  mat3 axes = turn * rotation(vec4(unpackSnorm2x16(third.x), unpackSnorm2x16(third.y)));
  vec2 scale = focal / c.z;
  vec2 a0 = scale * lengths.x * (axes[0].xy - near * axes[0].z);
  vec2 a1 = scale * lengths.y * (axes[1].xy - near * axes[1].z);
  vec2 a2 = scale * lengths.z * (axes[2].xy - near * axes[2].z);
  float xx = a0.x * a0.x + a1.x * a1.x + a2.x * a2.x;
  float xy = a0.x * a0.y + a1.x * a1.y + a2.x * a2.y;
  float yy = a0.y * a0.y + a1.y * a1.y + a2.y * a2.y;
  // By the Cauchy-Binet formula: xx yy - xy xy would cancel for needles.
  vec3 minors = vec3(a0.x * a1.y - a0.y * a1.x, a1.x * a2.y - a1.y * a2.x, a2.x * a0.y - a2.y * a0.x);
  float sharp = dot(minors, minors);
  float determinant = sharp + LOW_PASS * (xx + yy) + LOW_PASS * LOW_PASS;
  xx += LOW_PASS;
  yy += LOW_PASS;
  float alpha = point.w;
  if (antialiased) alpha *= sqrt(max(0.000025, sharp / determinant));
  if (!(alpha >= 1.0 / 255.0) || !(determinant > 0.0 && determinant < 1e37)) return;
  vec2 reach = sqrt(2.0 * log(alpha * 255.0) * vec2(xx, yy));
  vec2 low = vec2(span.x, 0.0) - reach, high = vec2(span.y, size.y) + reach;
  if (any(lessThan(pixel, low)) || any(greaterThan(pixel, high))) return;
  vec3 base = vec3(unpackHalf2x16(second.w), unpackHalf2x16(third.z).x);
  vec3 colour = seen(base, normalize(away));
  float down = sqrt(yy);
  place = floatBitsToUint(vec4(pixel, sqrt(determinant / yy), down));
  light.xy = floatBitsToUint(vec2(xy / down, alpha));
  light.zw = uvec2(packHalf2x16(colour.rg), packHalf2x16(vec2(colour.b, 0.0)));
}`;

/** A triangle around each visible Gaussian; only an ellipse inside it is drawn. */
const splatVertex = `#version 300 es
precision highp float;
precision highp int;
precision highp usampler2D;

uniform usampler2D order;
uniform usampler2D places;
uniform usampler2D lights;
uniform vec2 size;

out vec2 place; // where alpha is opacity exp(-|place|^2 / 2)
flat out vec4 light; // colour and opacity

ivec2 texel(uint k) {
  return ivec2(k % ${ROW}u, k / ${ROW}u);
}

void main() {
  gl_Position = vec4(0.0, 0.0, 2.0, 1.0); // not seen
  ivec2 at = texel(texelFetch(order, texel(uint(gl_VertexID / 3)), 0).r);
  uvec4 second = texelFetch(lights, at, 0);
  float alpha = uintBitsToFloat(second.y);
  if (alpha == 0.0) return;
  vec4 first = uintBitsToFloat(texelFetch(places, at, 0));
  // The circle in it has the radius 1.
  const vec2 CORNERS[3] = vec2[](vec2(-1.7320509, -1.0), vec2(1.7320509, -1.0), vec2(0.0, 2.0));
  place = sqrt(2.0 * log(alpha * 255.0)) * CORNERS[gl_VertexID % 3];
  light = vec4(unpackHalf2x16(second.z), unpackHalf2x16(second.w).x, alpha);
  vec2 away = vec2(place.x * first.z + place.y * uintBitsToFloat(second.x), place.y * first.w);
  vec2 corner = (first.xy + away) / size * 2.0 - 1.0;
  gl_Position = vec4(corner.x, -corner.y, 0.0, 1.0);
}`;

const splatFragment = `#version 300 es
precision highp float;
in vec2 place;
flat in vec4 light;
out vec4 colour;
void main() {
  float alpha = min(0.99, light.a * exp(-0.5 * dot(place, place)));
  if (alpha < 1.0 / 255.0) discard;
  colour = vec4(light.rgb * alpha, alpha);
}`;

const screenFragment = `#version 300 es
precision highp float;
uniform sampler2D first;
uniform sampler2D second;
uniform vec3 background;
uniform float split; // pixels left of it are of the first picture
uniform bool errors;
uniform vec2 corner; // of the picture in its target
out vec4 colour;
const vec3 VIRIDIS[9] = vec3[](
  vec3(68, 1, 84), vec3(71, 44, 122), vec3(59, 81, 139), vec3(44, 113, 142), vec3(33, 144, 141),
  vec3(39, 173, 129), vec3(92, 200, 99), vec3(170, 220, 50), vec3(253, 231, 37));
vec3 picture(vec4 drawn) {
  return clamp(drawn.rgb + (1.0 - drawn.a) * background, 0.0, 1.0);
}
void main() {
  ivec2 at = ivec2(gl_FragCoord.xy - corner);
  vec3 a = picture(texelFetch(first, at, 0));
  vec3 b = picture(texelFetch(second, at, 0));
  vec3 shown = gl_FragCoord.x - corner.x < split ? a : b;
  if (errors) {
    // From a quarter of a level of 255 to 64 levels, in eight doublings.
    float error = sqrt(dot(a - b, a - b) / 3.0);
    float step = clamp(log2(max(error * 255.0 * 4.0, 1.0)), 0.0, 8.0);
    int low = min(int(step), 7);
    shown = mix(VIRIDIS[low], VIRIDIS[low + 1], step - float(low)) / 255.0;
  }
  colour = vec4(shown, 1.0);
}`;

export const PROJECTION = [wholeVertex, projectionFragment];
export const SPLATS = [splatVertex, splatFragment];
export const SCREEN = [wholeVertex, screenFragment];
