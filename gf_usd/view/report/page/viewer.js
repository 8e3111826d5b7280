// The moving mesh and Gaussians on a canvas.  It draws when something changed, and else rests.

class Viewer {
  constructor(canvas) {
    const gl = canvas.getContext("webgl2", { antialias: true, alpha: true });
    if (!gl) throw new Error("This browser offers no WebGL 2, which the 3D view needs.");
    Object.assign(this, { canvas, gl, orbit: new Orbit(), show: "mesh", mode: "color", size: 1 });
    this.mesh = program(gl, MESH_VERTEX, MESH_FRAGMENT);
    this.balls = program(gl, BALL_VERTEX, BALL_FRAGMENT);
    this.meshShadow = program(gl, MESH_VERTEX, SHADOW_FRAGMENT);
    this.ballShadow = program(gl, BALL_VERTEX, SHADOW_FRAGMENT);
    this.floor = program(gl, FLOOR_VERTEX, FLOOR_FRAGMENT);
    this.buffers = {};
    this.makeShadowMap();
    steer(this);
    new ResizeObserver(() => this.draw()).observe(canvas);
  }

  makeShadowMap() {
    const gl = this.gl;
    this.shadowSize = 512;
    this.shadowMap = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, this.shadowMap);
    gl.texStorage2D(gl.TEXTURE_2D, 6, gl.RGBA8, this.shadowSize, this.shadowSize);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR_MIPMAP_LINEAR);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
    this.shadowTarget = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.shadowTarget);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, this.shadowMap, 0);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  }

  // Show a variant; the camera stays where it is unless this is the first.
  open(variant) {
    const first = !this.variant;
    this.variant = variant;
    const [low, high] = [variant.low, variant.high];
    this.center = low.map((v, i) => 0.5 * (v + high[i]));
    this.shrink = 1 / (Math.hypot(...low.map((v, i) => high[i] - v)) || 1);
    this.box = [this.stand(low), this.stand(high)];
    const [a, b] = this.box;
    this.box = [a.map((v, i) => Math.min(v, b[i])), a.map((v, i) => Math.max(v, b[i]))];
    this.ground = variant.ground === null ? null
      : variant.ground * this.shrink - this.stand(this.center, false)[1];
    const { corners, source, shade, meshColors } = variant.arrays;
    const shared = shade.values.reduce((most, v) => Math.max(most, v), -1) + 1;
    this.places = new Float32Array(3 * source.values.length);
    this.normals = new Float32Array(3 * source.values.length);
    this.sums = new Float32Array(3 * shared);
    this.values = new Uint8Array(source.values.length);
    this.upload("triangles", corners.values, this.gl.ELEMENT_ARRAY_BUFFER);
    this.upload("meshColors", meshColors.values);
    if (variant.arrays.gaussianColors) this.upload("colors", variant.arrays.gaussianColors.values);
    this.upload("ball", ball(variant.arrays.positions?.row > 9000 ? 1 : 2));
    if (first) this.refit();
  }

  refit() {
    this.orbit.fit(...this.box, this.canvas.clientWidth / (this.canvas.clientHeight || 1));
  }

  // A place in meters in the page's frame: Y up, centered unless told, 1 across.
  stand(p, centered = true) {
    const q = p.map((v, i) => (v - (centered ? this.center[i] : 0)) * this.shrink);
    return this.variant.up === "Z" ? [q[0], q[2], -q[1]] : q;
  }

  upload(name, data, target = this.gl.ARRAY_BUFFER) {
    const gl = this.gl;
    this.buffers[name] ??= gl.createBuffer();
    gl.bindVertexArray(null);
    gl.bindBuffer(target, this.buffers[name]);
    gl.bufferData(target, data, gl.DYNAMIC_DRAW);
  }

  // Put a frame on the card.
  setFrame(frame) {
    this.frame = frame;
    const a = this.variant.arrays;
    if (a.points.row) this.poseMesh(a, frame);
    this.flowCorners = 0;
    if (a.flowStarts) this.poseFlow(a, frame);
    if (a.positions?.row) {
      this.upload("positions", a.positions.at(frame));
      this.upload("turns", a.turns.at(frame));
      this.upload("scales", a.scales.at(frame));
    }
    this.paint();
  }

  poseMesh(a, frame) {
    const { places, sums, normals } = this;
    const [source, shade] = [a.source.values, a.shade.values];
    this.placed(a.points, a.points.at(frame), source, places);
    this.shaded(places, a.corners.values, shade, sums, normals);
    this.upload("places", places);
    this.upload("normals", normals);
  }

  // A surface of what flows: vertices and triangles of this frame alone.
  poseFlow(a, frame) {
    const [v, t] = a.flowStarts.at(frame);
    const [vEnd, tEnd] = a.flowStarts.at(frame + 1);
    const all = Uint32Array.from({ length: vEnd - v }, (_, i) => i);
    const corners = a.flowCorners.values.subarray(3 * t, 3 * tEnd);
    const [places, normals, sums] = [0, 0, 0].map(() => new Float32Array(3 * all.length));
    this.placed(a.flowPoints, a.flowPoints.values.subarray(3 * v, 3 * vEnd), all, places);
    this.shaded(places, corners, all, sums, normals);
    this.upload("flowPlaces", places);
    this.upload("flowNormals", normals);
    this.upload("flowColors", a.flowColors.values.subarray(3 * v, 3 * vEnd));
    this.upload("flowValues", new Uint8Array(all.length));
    this.upload("flowTriangles", corners, this.gl.ELEMENT_ARRAY_BUFFER);
    this.flowCorners = corners.length;
  }

  // Places in the page's frame of the points that `source` names, from their codes.
  placed({ low, step }, codes, source, places) {
    const [x0, y0, z0] = this.stand(low);
    const [dx, dy, dz] = step.map((v) => v * this.shrink);
    const zup = this.variant.up === "Z";
    for (let i = 0; i < source.length; i++) {
      const k = 3 * source[i];
      places[3 * i] = x0 + dx * codes[k];
      places[3 * i + 1] = y0 + (zup ? dz * codes[k + 2] : dy * codes[k + 1]);
      places[3 * i + 2] = z0 + (zup ? -dy * codes[k + 1] : dz * codes[k + 2]);
    }
  }

  // Normals of vertices; those of one number in `shade` share theirs.
  shaded(places, t, shade, sums, normals) {
    sums.fill(0);
    for (let i = 0; i < t.length; i += 3) {
      const [p, q, r] = [3 * t[i], 3 * t[i + 1], 3 * t[i + 2]];
      const ax = places[q] - places[p], ay = places[q + 1] - places[p + 1];
      const az = places[q + 2] - places[p + 2];
      const bx = places[r] - places[p], by = places[r + 1] - places[p + 1];
      const bz = places[r + 2] - places[p + 2];
      const nx = ay * bz - az * by, ny = az * bx - ax * bz, nz = ax * by - ay * bx;
      for (let c = 0; c < 3; c++) {
        const s = 3 * shade[t[i + c]];
        sums[s] += nx; sums[s + 1] += ny; sums[s + 2] += nz;
      }
    }
    for (let i = 0; i < shade.length; i++) {
      const s = 3 * shade[i];
      const length = Math.hypot(sums[s], sums[s + 1], sums[s + 2]) || 1;
      for (let c = 0; c < 3; c++) normals[3 * i + c] = sums[s + c] / length;
    }
  }

  // The values that color what is shown.
  paint() {
    const { variant, mode, frame } = this;
    const mesh = scalars(variant, mode, "mesh", frame);
    if (mesh) {
      const source = variant.arrays.source.values;
      for (let i = 0; i < source.length; i++) this.values[i] = mesh[source[i]];
    }
    this.meshValued = mesh !== null;
    this.upload("meshValues", this.values);
    const balls = scalars(variant, mode, "gaussians", frame);
    this.ballsValued = balls !== null;
    if (variant.arrays.positions) {
      this.upload("values", balls ?? new Uint8Array(variant.arrays.positions.row / 3));
    }
    this.draw();
  }

  draw() {
    this.waiting ??= requestAnimationFrame(() => {
      this.waiting = null;
      if (this.variant && this.frame !== undefined) drawScene(this);
    });
  }
}
