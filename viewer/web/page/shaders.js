// Shaders: splats as gs_codec's rasteriser draws them (EWA projection of 3DGS), and what the screen
// shows of one or two pictures of them.

/** Gaussians in a row of a texture. */
export const ROW = 1024;

/** Texels of a Gaussian: position and opacity; quaternion; axes; SH-DC. */
export const SHAPE = 4;

/** Texels of a Gaussian's SH-AC by SH degree: eight halves each, coefficient by coefficient. */
export const HARMONICS = [0, 2, 3, 6];

const splatVertex = `#version 300 es
precision highp float;
precision highp int;
precision highp usampler2D;

uniform highp sampler2D shapes;
uniform highp usampler2D harmonics;
uniform mat3 turn; // from the world to the camera: right, down, forward
uniform vec3 eye;
uniform vec2 focal;
uniform vec2 centre; // of the picture, pixels from its upper left corner
uniform vec2 size;
uniform int degree; // that is drawn
uniform int texels; // of SH-AC, of a Gaussian
uniform bool antialiased;

in uint gaussian;

out vec2 place; // where alpha is opacity exp(-|place|^2 / 2)
flat out vec4 light; // colour and opacity

const float NEAR = 0.2;
const float LOW_PASS = 0.3;

int texel;
uvec4 packed;
int taken;

vec3 coefficient() {
  vec3 value;
  for (int k = 0; k < 3; k++) {
    if (taken == 8) {
      packed = texelFetch(harmonics, ivec2(int(gaussian % ${ROW}u) * texels + texel, int(gaussian / ${ROW}u)), 0);
      texel++;
      taken = 0;
    }
    vec2 pair = unpackHalf2x16(packed[taken >> 1]);
    value[k] = pair[taken & 1];
    taken++;
  }
  return value;
}

vec3 seen(vec3 base, vec3 d) {
  vec3 colour = 0.5 + 0.28209479177387814 * base;
  texel = 0;
  taken = 8;
  float x = d.x, y = d.y, z = d.z;
  if (degree >= 1) {
    colour -= 0.4886025119029199 * y * coefficient();
    colour += 0.4886025119029199 * z * coefficient();
    colour -= 0.4886025119029199 * x * coefficient();
  }
  float xx = x * x, yy = y * y, zz = z * z;
  if (degree >= 2) {
    colour += 1.0925484305920792 * x * y * coefficient();
    colour -= 1.0925484305920792 * y * z * coefficient();
    colour += 0.31539156525252005 * (2.0 * zz - xx - yy) * coefficient();
    colour -= 1.0925484305920792 * x * z * coefficient();
    colour += 0.5462742152960396 * (xx - yy) * coefficient();
  }
  if (degree >= 3) {
    colour -= 0.5900435899266435 * y * (3.0 * xx - yy) * coefficient();
    colour += 2.890611442640554 * x * y * z * coefficient();
    colour -= 0.4570457994644658 * y * (4.0 * zz - xx - yy) * coefficient();
    colour += 0.3731763325901154 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy) * coefficient();
    colour -= 0.4570457994644658 * x * (4.0 * zz - xx - yy) * coefficient();
    colour += 1.445305721320277 * z * (xx - yy) * coefficient();
    colour -= 0.5900435899266435 * x * (xx - 3.0 * yy) * coefficient();
  }
  return max(colour, 0.0);
}

void main() {
  gl_Position = vec4(0.0, 0.0, 2.0, 1.0); // not seen
  ivec2 at = ivec2(int(gaussian % ${ROW}u) * ${SHAPE}, int(gaussian / ${ROW}u));
  vec4 point = texelFetch(shapes, at, 0);
  vec3 away = point.xyz - eye;
  vec3 c = turn * away;
  if (!(c.z > NEAR)) return;
  vec2 slope = c.xy / c.z;
  vec2 pixel = focal * slope + centre;
  // The Jacobian is that of a slope near the picture.
  vec2 margin = 0.15 * size / focal;
  vec2 near = clamp(slope, -centre / focal - margin, (size - centre) / focal + margin);
  vec4 q = texelFetch(shapes, at + ivec2(1, 0), 0);
  vec3 lengths = texelFetch(shapes, at + ivec2(2, 0), 0).xyz;
  mat3 axes = turn * mat3(
    1.0 - 2.0 * (q.z * q.z + q.w * q.w), 2.0 * (q.y * q.z + q.x * q.w), 2.0 * (q.y * q.w - q.x * q.z),
    2.0 * (q.y * q.z - q.x * q.w), 1.0 - 2.0 * (q.y * q.y + q.w * q.w), 2.0 * (q.z * q.w + q.x * q.y),
    2.0 * (q.y * q.w + q.x * q.z), 2.0 * (q.z * q.w - q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z));
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
  float reach = sqrt(2.0 * log(alpha * 255.0));
  place = reach * vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0 - reach;
  float high = place.y * sqrt(yy);
  float wide = (place.x + xy / sqrt(yy * determinant) * high) * sqrt(determinant / yy);
  vec2 corner = (pixel + vec2(wide, high)) / size * 2.0 - 1.0;
  vec3 base = texelFetch(shapes, at + ivec2(3, 0), 0).xyz;
  light = vec4(seen(base, normalize(away)), alpha);
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

const screenVertex = `#version 300 es
void main() {
  gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0.0, 1.0);
}`;

const screenFragment = `#version 300 es
precision highp float;
uniform sampler2D first;
uniform sampler2D second;
uniform vec3 background;
uniform float split; // pixels left of it are of the first picture
uniform bool errors;
out vec4 colour;
const vec3 VIRIDIS[9] = vec3[](
  vec3(68, 1, 84), vec3(71, 44, 122), vec3(59, 81, 139), vec3(44, 113, 142), vec3(33, 144, 141),
  vec3(39, 173, 129), vec3(92, 200, 99), vec3(170, 220, 50), vec3(253, 231, 37));
vec3 picture(vec4 drawn) {
  return clamp(drawn.rgb + (1.0 - drawn.a) * background, 0.0, 1.0);
}
void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  vec3 a = picture(texelFetch(first, at, 0));
  vec3 b = picture(texelFetch(second, at, 0));
  vec3 shown = gl_FragCoord.x < split ? a : b;
  if (errors) {
    // From a quarter of a level of 255 to 64 levels, in eight doublings.
    float error = sqrt(dot(a - b, a - b) / 3.0);
    float step = clamp(log2(max(error * 255.0 * 4.0, 1.0)), 0.0, 8.0);
    int low = min(int(step), 7);
    shown = mix(VIRIDIS[low], VIRIDIS[low + 1], step - float(low)) / 255.0;
  }
  colour = vec4(shown, 1.0);
}`;

export const SPLATS = [splatVertex, splatFragment];
export const SCREEN = [screenVertex, screenFragment];
