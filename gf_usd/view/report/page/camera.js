// A camera that orbits a target, in a frame with Y up, and its matrices (column-major).

class Orbit {
  constructor() {
    this.fov = (30 * Math.PI) / 180;
    this.home = { target: [0, 0, 0], distance: 3, azimuth: 0.56, elevation: 0.2 };
    this.reset();
  }

  reset() {
    Object.assign(this, { ...this.home, target: [...this.home.target] });
  }

  // Stand so that a box is in the picture, as wide as high as the aspect says.
  fit(low, high, aspect) {
    this.home.target = low.map((v, i) => 0.5 * (v + high[i]));
    const out = this.out(this.home);
    const right = unit(cross([0, 1, 0], out));
    const up = cross(out, right);
    const slope = 0.86 * Math.tan(this.fov / 2);
    let distance = 0;
    for (let bits = 0; bits < 8; bits++) {
      const p = [0, 1, 2].map((i) => (bits & (1 << i) ? high[i] : low[i]) - this.home.target[i]);
      const reach = Math.max(Math.abs(dot(p, right)) / aspect, Math.abs(dot(p, up)));
      distance = Math.max(distance, reach / slope + dot(p, out));
    }
    this.home.distance = distance || 1;
    this.reset();
  }

  out(of = this) {
    const c = Math.cos(of.elevation);
    return [c * Math.sin(of.azimuth), Math.sin(of.elevation), c * Math.cos(of.azimuth)];
  }

  get eye() {
    return this.target.map((v, i) => v + this.distance * this.out()[i]);
  }

  turn(dx, dy) {
    this.azimuth -= dx;
    this.elevation = Math.min(1.5, Math.max(-0.4, this.elevation + dy));
  }

  // Move the target by parts of the picture's height.
  pan(dx, dy) {
    const out = this.out();
    const right = unit(cross([0, 1, 0], out));
    const up = cross(out, right);
    const size = 2 * this.distance * Math.tan(this.fov / 2);
    this.target = this.target.map((v, i) => v - size * (dx * right[i] - dy * up[i]));
  }

  zoom(factor) {
    const far = 20 * this.home.distance;
    this.distance = Math.min(far, Math.max(0.02 * this.home.distance, this.distance * factor));
  }

  matrix(aspect) {
    const out = this.out();
    const right = unit(cross([0, 1, 0], out));
    const up = cross(out, right);
    const eye = this.eye;
    const view = [
      right[0], up[0], out[0], 0, right[1], up[1], out[1], 0, right[2], up[2], out[2], 0,
      -dot(right, eye), -dot(up, eye), -dot(out, eye), 1,
    ];
    const near = 0.02 * this.distance;
    const far = this.distance + 30;
    const f = 1 / Math.tan(this.fov / 2);
    const lens = [f / aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, (far + near) / (near - far), -1,
      0, 0, (2 * far * near) / (near - far), 0];
    return multiply(lens, view);
  }
}

function dot(a, b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

function cross(a, b) {
  return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
}

function unit(a) {
  const length = Math.hypot(...a) || 1;
  return a.map((v) => v / length);
}

function multiply(a, b) {
  const out = new Array(16).fill(0);
  for (let c = 0; c < 4; c++) {
    for (let r = 0; r < 4; r++) {
      for (let k = 0; k < 4; k++) out[4 * c + r] += a[4 * k + r] * b[4 * c + k];
    }
  }
  return out;
}

// Seen from above, over a square of half width `reach` about (x, z), heights `low` to `high`.
function fromAbove(x, z, reach, low, high) {
  const depth = high - low || 1;
  return [1 / reach, 0, 0, 0, 0, 0, -2 / depth, 0, 0, 1 / reach, 0, 0,
    -x / reach, -z / reach, (high + low) / depth, 1];
}

// A ball of triangles: an octahedron whose faces are cut in four, `times` over.
function ball(times) {
  let faces = [];
  for (let bits = 0; bits < 8; bits++) {
    const [x, y, z] = [bits & 1 ? 1 : -1, bits & 2 ? 1 : -1, bits & 4 ? 1 : -1];
    const face = [[x, 0, 0], [0, y, 0], [0, 0, z]];
    faces.push(x * y * z > 0 ? face : face.reverse());
  }
  for (let n = 0; n < times; n++) {
    faces = faces.flatMap(([a, b, c]) => {
      const [ab, bc, ca] = [[a, b], [b, c], [c, a]].map(([p, q]) =>
        unit(p.map((v, i) => v + q[i])));
      return [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]];
    });
  }
  return new Float32Array(faces.flat(2));
}
