// What runs on the graphics card.  Places are in the page's own frame: Y up, about 1 large.

const LIGHT = `
uniform vec3 eye;
uniform vec3 stops[7];
uniform int mode;            // 0: own color; 1: by the value
uniform float gain;          // of the value about its middle
uniform float middle;
vec3 linear(vec3 c) { return pow(c, vec3(2.2)); }
vec3 mapped(float value) {
  float t = clamp((value - middle) * gain + middle, 0.0, 1.0) * 6.0;
  int i = int(min(t, 5.0));
  return linear(mix(stops[i], stops[i + 1], t - float(i)));
}
vec3 shade(vec3 albedo, vec3 n, vec3 p) {
  vec3 v = normalize(eye - p);
  if (dot(n, v) < 0.0) n = -n;
  vec3 key = normalize(vec3(0.45, 0.85, 0.55));
  float wrap = max(0.0, (dot(n, key) + 0.25) / 1.25);
  float sky = 0.5 + 0.5 * n.y;
  vec3 light = vec3(0.95, 0.92, 0.88) * wrap * 0.85
    + mix(vec3(0.20, 0.18, 0.17), vec3(0.42, 0.46, 0.52), sky) * 0.75;
  float rim = pow(1.0 - max(0.0, dot(n, v)), 4.0);
  float spark = pow(max(0.0, dot(n, normalize(key + v))), 48.0);
  vec3 color = albedo * light + vec3(0.10) * rim + vec3(0.10) * spark;
  return pow(color / (color * 0.18 + 0.92), vec3(1.0 / 2.2));
}
`;

const MESH_VERTEX = `#version 300 es
in vec3 place; in vec3 normal; in vec3 color; in float value;
uniform mat4 camera;
out vec3 p; out vec3 n; out vec3 c; out float s;
void main() {
  p = place; n = normal; c = color; s = value;
  gl_Position = camera * vec4(place, 1.0);
}`;

const MESH_FRAGMENT = `#version 300 es
precision highp float;
${LIGHT}
uniform float alpha;
in vec3 p; in vec3 n; in vec3 c; in float s;
out vec4 pixel;
void main() {
  vec3 albedo = mode == 0 ? linear(c) : mapped(s);
  pixel = vec4(shade(albedo, normalize(n), p) * alpha, alpha);
}`;

// One ball for each Gaussian: x = center + R (scales * s); its normal is R (s / scales).
const BALL_VERTEX = `#version 300 es
in vec3 corner; in vec3 place; in vec4 turn; in vec3 size; in vec3 color; in float value;
uniform mat4 camera;
uniform vec3 low, step_;     // of the places
uniform vec2 scale;          // logarithm of the scales: low and step
uniform float grow, shrink;  // of the balls; page lengths per meter
uniform vec3 center;
uniform bool zup;
out vec3 p; out vec3 n; out vec3 c; out float s;
vec3 rotate(vec4 q, vec3 v) { return v + 2.0 * cross(q.xyz, cross(q.xyz, v) + q.w * v); }
vec3 stand(vec3 v) { return zup ? vec3(v.x, v.z, -v.y) : v; }
void main() {
  vec4 q = normalize(turn);
  vec3 axes = exp(scale.x + scale.y * size) * grow;
  p = stand((low + step_ * place - center + rotate(q, axes * corner)) * shrink);
  n = stand(rotate(q, corner / axes));
  c = color; s = value;
  gl_Position = camera * vec4(p, 1.0);
}`;

const BALL_FRAGMENT = `#version 300 es
precision highp float;
${LIGHT}
in vec3 p; in vec3 n; in vec3 c; in float s;
out vec4 pixel;
void main() {
  vec3 albedo = mode == 0 ? c * c : mapped(s);
  pixel = vec4(shade(albedo, normalize(n), p), 1.0);
}`;

// The shadow seen from above: dark where something is near the floor.
const SHADOW_FRAGMENT = `#version 300 es
precision highp float;
uniform float floor_;
in vec3 p; in vec3 n; in vec3 c; in float s;
out vec4 pixel;
void main() { pixel = vec4(exp(-3.5 * max(0.0, p.y - floor_)), 0.0, 0.0, 1.0); }`;

const FLOOR_VERTEX = `#version 300 es
in vec2 corner;
uniform mat4 camera;
uniform float floor_, reach;
uniform vec2 about;
out vec2 at;
void main() {
  at = about + corner * reach;
  gl_Position = camera * vec4(at.x, floor_, at.y, 1.0);
}`;

const FLOOR_FRAGMENT = `#version 300 es
precision highp float;
uniform float reach, cell, shadowReach;
uniform vec2 about, origin;
uniform vec3 ink;
uniform float faint;
uniform sampler2D shadow;
in vec2 at;
out vec4 pixel;
float lines(float size) {
  vec2 q = (at - origin) / size;
  vec2 w = fwidth(q);
  vec2 d = abs(fract(q - 0.5) - 0.5) / max(w, vec2(1e-6));
  float line = 1.0 - min(min(d.x, d.y), 1.0);
  return line * clamp(1.0 - max(w.x, w.y) * 2.5, 0.0, 1.0);
}
void main() {
  float far = length(at - about) / reach;
  float fade = 1.0 - smoothstep(0.35, 1.0, far);
  vec2 uv = (at - about) / shadowReach * 0.5 + 0.5;
  float dark = 0.0;
  for (int i = 0; i < 16; i++) {
    float a = 2.39996 * float(i);
    float r = 0.032 * sqrt((float(i) + 0.5) / 16.0);
    dark += textureLod(shadow, uv + r * vec2(cos(a), sin(a)), 2.0).r / 16.0;
  }
  float grid = (0.5 * lines(cell) + 0.5 * lines(cell * 5.0)) * fade * faint;
  float cover = 0.5 * dark * dark + 0.1 * dark;
  pixel = vec4(ink * grid * (1.0 - cover), grid * (1.0 - cover) + cover);
}`;
