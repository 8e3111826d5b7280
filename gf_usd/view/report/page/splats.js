// Gaussians as splats: projected, sorted from far to near and blended, after Kerbl et al. 2023.

const PER_SPLAT = 4; // texels: place and opacity, covariance (two), rotation since the first frame
const ROW = 512; // splats in a row of a texture
const LIGHT = 15; // texels of coefficients above degree 0

const SPLAT_VERTEX = `#version 300 es
precision highp float;
precision highp int;
layout(location = 0) in uint splat;
uniform sampler2D moving, colors, light;
uniform mat3 toView;    // rows: right, up, and back towards the eye
uniform vec3 eye;
uniform vec2 focal, screen;  // pixels
uniform float near, grow, lightStep;
uniform int terms, zup;
out vec2 at;
out vec4 color;

vec4 texel(sampler2D from, int each, int k) {
  int i = int(splat);
  return texelFetch(from, ivec2((i % ${ROW}) * each + k, i / ${ROW}), 0);
}

vec3 coefficient(int k) {
  return lightStep * 127.0 * texel(light, ${LIGHT}, k).rgb;
}

// sum over the degrees 1 to 3 at a direction in the axes of the first frame
vec3 radiance(vec3 d) {
  float x = d.x, y = d.y, z = d.z;
  vec3 sum = 0.48860251 * (-y * coefficient(0) + z * coefficient(1) - x * coefficient(2));
  if (terms > 3) {
    sum += 1.09254843 * (x * y * coefficient(3) - y * z * coefficient(4) - x * z * coefficient(6))
      + 0.31539157 * (3.0 * z * z - 1.0) * coefficient(5)
      + 0.54627422 * (x * x - y * y) * coefficient(7);
  }
  if (terms > 8) {
    sum += 0.59004359 * (-y * (3.0 * x * x - y * y) * coefficient(8)
        - x * (x * x - 3.0 * y * y) * coefficient(14))
      + 2.89061144 * x * y * z * coefficient(9)
      - 0.45704580 * (5.0 * z * z - 1.0) * (y * coefficient(10) + x * coefficient(12))
      + 0.37317633 * z * (5.0 * z * z - 3.0) * coefficient(11)
      + 1.44530572 * z * (x * x - y * y) * coefficient(13);
  }
  return sum;
}

void main() {
  vec4 place = texel(moving, ${PER_SPLAT}, 0);
  vec4 c0 = texel(moving, ${PER_SPLAT}, 1), c1 = texel(moving, ${PER_SPLAT}, 2);
  vec3 t = toView * (place.xyz - eye);
  float depth = -t.z;
  gl_Position = vec4(2.0, 2.0, 2.0, 1.0);  // outside: nothing is drawn
  if (depth < near) return;
  mat3 S = mat3(c0.x, c0.y, c0.z, c0.y, c0.w, c1.x, c0.z, c1.x, c1.y);
  vec2 slope = clamp(t.xy / depth, -0.65 * screen / focal, 0.65 * screen / focal);
  mat3 J = mat3(focal.x / depth, 0.0, 0.0, 0.0, focal.y / depth, 0.0,
    focal.x * slope.x / depth, focal.y * slope.y / depth, 0.0);
  mat3 T = J * toView;
  mat3 P = T * S * transpose(T);
  // a splat covers a pixel at least, as in the original renderer
  float a = grow * grow * P[0][0] + 0.3, b = grow * grow * P[0][1], c = grow * grow * P[1][1] + 0.3;
  float middle = 0.5 * (a + c), reach = length(vec2(0.5 * (a - c), b));
  float large = middle + reach, small = max(middle - reach, 0.1);
  vec2 along = reach < 1e-9 ? vec2(1.0, 0.0) : normalize(abs(b) > 1e-9 ? vec2(b, large - a)
    : (a > c ? vec2(1.0, 0.0) : vec2(0.0, 1.0)));
  at = 3.0 * vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0 - 3.0;
  vec2 off = at.x * sqrt(large) * along + at.y * sqrt(small) * vec2(-along.y, along.x);
  vec2 center = focal * t.xy / depth;
  gl_Position = vec4(2.0 * (center + off) / screen, 0.0, 1.0);
  vec4 base = texel(colors, 1, 0);
  vec3 seen = base.rgb;
  if (terms > 0) {
    vec3 d = normalize(place.xyz - eye);
    if (zup == 1) d = vec3(d.x, -d.z, d.y);
    vec4 q = texel(moving, ${PER_SPLAT}, 3);
    // by the inverse rotation: the light turns with the body
    d += 2.0 * cross(cross(d, q.xyz) + q.w * d, q.xyz);
    seen += radiance(d);
  }
  color = vec4(max(seen, 0.0), place.w);
}`;

const SPLAT_FRAGMENT = `#version 300 es
precision highp float;
in vec2 at;
in vec4 color;
out vec4 pixel;
void main() {
  float alpha = color.a * exp(-0.5 * dot(at, at));
  if (dot(at, at) > 9.0 || alpha < 1.0 / 255.0) discard;
  pixel = vec4(color.rgb * alpha, alpha);
}`;

class SplatViewer {
  constructor(canvas) {
    const gl = canvas.getContext("webgl2", { antialias: false, alpha: true });
    if (!gl) throw new Error("This browser offers no WebGL 2, which the 3D view needs.");
    Object.assign(this, { canvas, gl, orbit: new Orbit(), size: 1, textures: {} });
    this.splats = program(gl, SPLAT_VERTEX, SPLAT_FRAGMENT);
    this.order = gl.createBuffer();
    steer(this);
    new ResizeObserver(() => this.draw()).observe(canvas);
  }

  // Show a variant; the camera stays where it is unless this is the first.
  open(variant) {
    const first = !this.variant;
    this.variant = variant;
    const { low, high, arrays } = variant;
    this.center = low.map((v, i) => 0.5 * (v + high[i]));
    this.shrink = 1 / (Math.hypot(...low.map((v, i) => high[i] - v)) || 1);
    const [a, b] = [this.stand(low), this.stand(high)];
    this.box = [a.map((v, i) => Math.min(v, b[i])), a.map((v, i) => Math.max(v, b[i]))];
    this.count = arrays.colors.shape[0];
    this.rows = Math.max(1, Math.ceil(this.count / ROW));
    this.moving = new Float32Array(4 * PER_SPLAT * ROW * this.rows);
    this.depths = new Float32Array(this.count);
    this.sorted = new Uint32Array(this.count);
    this.scaleOf = Float32Array.from({ length: 256 }, (_, code) =>
      this.shrink * Math.exp(arrays.scales.low + arrays.scales.step * code));
    const gl = this.gl;
    const colors = new Uint8Array(4 * ROW * this.rows);
    colors.set(arrays.colors.values);
    this.texture("colors", gl.RGBA8, ROW, gl.RGBA, gl.UNSIGNED_BYTE, colors);
    this.terms = arrays.light ? arrays.light.shape[1] : 0;
    const light = new Int8Array(this.terms ? 4 * LIGHT * ROW * this.rows : 4 * this.rows);
    for (let i = 0; this.terms && i < this.count; i++) {
      for (let k = 0; k < this.terms; k++) {
        for (let c = 0; c < 3; c++) {
          light[4 * (LIGHT * i + k) + c] = arrays.light.values[3 * (this.terms * i + k) + c];
        }
      }
    }
    const width = this.terms ? LIGHT * ROW : 1;
    this.texture("light", gl.RGBA8_SNORM, width, gl.RGBA, gl.BYTE, light);
    if (first) this.refit();
  }

  texture(name, inside, width, format, type, data) {
    const gl = this.gl;
    this.textures[name] ??= gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, this.textures[name]);
    for (const side of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) {
      gl.texParameteri(gl.TEXTURE_2D, side, gl.NEAREST);
    }
    gl.texImage2D(gl.TEXTURE_2D, 0, inside, width, this.rows, 0, format, type, data);
  }

  refit() {
    this.orbit.fit(...this.box, this.canvas.clientWidth / (this.canvas.clientHeight || 1));
  }

  // A place in meters in the page's frame: Y up, centered, 1 across.
  stand(p) {
    const q = p.map((v, i) => (v - this.center[i]) * this.shrink);
    return this.variant.up === "Z" ? [q[0], q[2], -q[1]] : q;
  }

  // Put a frame on the card: places, covariances R S S' R', and rotations since the first frame.
  setFrame(frame) {
    this.frame = frame;
    const { positions, turns, scales, colors } = this.variant.arrays;
    const [codes, quaternions, sizes] = [positions.at(frame), turns.at(frame), scales.at(frame)];
    const rest = turns.at(0);
    const [low, step] = [positions.low, positions.step];
    const zup = this.variant.up === "Z";
    const out = this.moving;
    for (let i = 0; i < this.count; i++) {
      const [p, t, o] = [3 * i, 4 * i, 4 * PER_SPLAT * i];
      const x = (low[0] + step[0] * codes[p] - this.center[0]) * this.shrink;
      const y = (low[1] + step[1] * codes[p + 1] - this.center[1]) * this.shrink;
      const z = (low[2] + step[2] * codes[p + 2] - this.center[2]) * this.shrink;
      out[o] = x;
      out[o + 1] = zup ? z : y;
      out[o + 2] = zup ? -y : z;
      out[o + 3] = colors.values[t + 3] / 255;
      let [qx, qy, qz, qw] = [quaternions[t], quaternions[t + 1], quaternions[t + 2], quaternions[t + 3]];
      const size = Math.hypot(qx, qy, qz, qw) || 1;
      qx /= size; qy /= size; qz /= size; qw /= size;
      const [sx, sy, sz] = [sizes[p], sizes[p + 1], sizes[p + 2]].map((code) => this.scaleOf[code]);
      // rows of A = R S
      const a0 = sx * (1 - 2 * (qy * qy + qz * qz)), a1 = sy * 2 * (qx * qy - qw * qz);
      const a2 = sz * 2 * (qx * qz + qw * qy);
      let b0 = sx * 2 * (qx * qy + qw * qz), b1 = sy * (1 - 2 * (qx * qx + qz * qz));
      let b2 = sz * 2 * (qy * qz - qw * qx);
      let c0 = sx * 2 * (qx * qz - qw * qy), c1 = sy * 2 * (qy * qz + qw * qx);
      let c2 = sz * (1 - 2 * (qx * qx + qy * qy));
      if (zup) [b0, b1, b2, c0, c1, c2] = [c0, c1, c2, -b0, -b1, -b2];
      out[o + 4] = a0 * a0 + a1 * a1 + a2 * a2;
      out[o + 5] = a0 * b0 + a1 * b1 + a2 * b2;
      out[o + 6] = a0 * c0 + a1 * c1 + a2 * c2;
      out[o + 7] = b0 * b0 + b1 * b1 + b2 * b2;
      out[o + 8] = b0 * c0 + b1 * c1 + b2 * c2;
      out[o + 9] = c0 * c0 + c1 * c1 + c2 * c2;
      if (!this.terms) continue;
      // q conj(q at rest)
      const n = Math.hypot(rest[t], rest[t + 1], rest[t + 2], rest[t + 3]) || 1;
      const rx = -rest[t] / n, ry = -rest[t + 1] / n, rz = -rest[t + 2] / n, rw = rest[t + 3] / n;
      out[o + 12] = qw * rx + qx * rw + qy * rz - qz * ry;
      out[o + 13] = qw * ry - qx * rz + qy * rw + qz * rx;
      out[o + 14] = qw * rz + qx * ry - qy * rx + qz * rw;
      out[o + 15] = qw * rw - qx * rx - qy * ry - qz * rz;
    }
    const gl = this.gl;
    this.texture("moving", gl.RGBA32F, PER_SPLAT * ROW, gl.RGBA, gl.FLOAT, this.moving);
    this.draw();
  }

  // Splats from the farthest to the nearest, by counting their distances in 65536 steps.
  sort() {
    const [ex, ey, ez] = this.orbit.eye;
    const { depths, sorted, moving, count } = this;
    let [near, far] = [Infinity, 0];
    for (let i = 0; i < count; i++) {
      const o = 4 * PER_SPLAT * i;
      const d = Math.hypot(moving[o] - ex, moving[o + 1] - ey, moving[o + 2] - ez);
      depths[i] = d;
      near = Math.min(near, d);
      far = Math.max(far, d);
    }
    const scale = 65535 / (far - near || 1);
    const starts = new Uint32Array(65537);
    for (let i = 0; i < count; i++) starts[((far - depths[i]) * scale | 0) + 1]++;
    for (let k = 1; k < starts.length; k++) starts[k] += starts[k - 1];
    for (let i = 0; i < count; i++) sorted[starts[(far - depths[i]) * scale | 0]++] = i;
  }

  draw() {
    this.waiting ??= requestAnimationFrame(() => {
      this.waiting = null;
      if (this.variant && this.frame !== undefined) this.drawNow();
    });
  }

  drawNow() {
    const { gl, canvas, orbit, variant } = this;
    const dpr = Math.min(2, window.devicePixelRatio || 1);
    const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((n) =>
      Math.max(1, Math.round(n * dpr)));
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    this.sort();
    gl.viewport(0, 0, width, height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.disable(gl.DEPTH_TEST);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    const { made, at } = this.splats;
    gl.useProgram(made);
    ["moving", "colors", "light"].forEach((name, unit) => {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(gl.TEXTURE_2D, this.textures[name]);
      gl.uniform1i(at[name], unit);
    });
    gl.activeTexture(gl.TEXTURE0);
    const out = orbit.out();
    const right = unit(cross([0, 1, 0], out));
    const up = cross(out, right);
    gl.uniformMatrix3fv(at.toView, false, [0, 1, 2].flatMap((i) => [right[i], up[i], out[i]]));
    gl.uniform3fv(at.eye, orbit.eye);
    const focal = (0.5 * height) / Math.tan(orbit.fov / 2);
    gl.uniform2f(at.focal, focal, focal);
    gl.uniform2f(at.screen, width, height);
    gl.uniform1f(at.near, 0.02 * orbit.distance);
    gl.uniform1f(at.grow, variant.grow * this.size);
    gl.uniform1f(at.lightStep, variant.arrays.light?.step ?? 0);
    gl.uniform1i(at.terms, this.terms);
    gl.uniform1i(at.zup, variant.up === "Z" ? 1 : 0);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.order);
    gl.bufferData(gl.ARRAY_BUFFER, this.sorted, gl.DYNAMIC_DRAW);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribIPointer(0, 1, gl.UNSIGNED_INT, 0, 0);
    gl.vertexAttribDivisor(0, 1);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, this.count);
  }
}

async function start() {
  const page = JSON.parse(document.getElementById("page").textContent);
  const $ = (id) => document.getElementById(id);
  let viewer = null;
  try {
    viewer = new SplatViewer($("canvas"));
  } catch (error) {
    $("canvas").hidden = true;
    $("trouble").hidden = false;
    $("trouble").textContent = error.message;
  }
  const controls = new Transport($);
  const player = new Player(page.variants, viewer, [controls]);
  await player.open(0);
  controls.connect(player, viewer);
  const calm = matchMedia("(prefers-reduced-motion: reduce)").matches;
  if (viewer && !calm && !location.hash.includes("paused")) player.play();
  return player;
}

window.report = { ready: start() };
