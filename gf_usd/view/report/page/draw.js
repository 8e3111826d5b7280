// One picture of what the viewer holds: shadow from above, then mesh and balls, then the floor.

function drawScene(view) {
  const { gl, canvas, orbit } = view;
  const dpr = Math.min(2, window.devicePixelRatio || 1);
  const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((n) =>
    Math.max(1, Math.round(n * dpr)));
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  const camera = orbit.matrix(width / height);
  const hasFloor = view.ground !== null;
  if (hasFloor) drawShadow(view);
  gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  gl.viewport(0, 0, width, height);
  gl.clearColor(0, 0, 0, 0);
  gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
  gl.enable(gl.DEPTH_TEST);
  gl.disable(gl.BLEND);
  drawBodies(view, view.mesh, view.balls, camera);
  if (hasFloor) drawFloor(view, camera);
}

function drawBodies(view, mesh, balls, camera) {
  const { gl } = view;
  const a = view.variant.arrays;
  const there = { mesh: hasSurface(a), gaussians: a.positions?.row > 0 };
  const wanted = (kind) => there[kind] && (view.show === kind || view.show === "both");
  const both = wanted("mesh") && wanted("gaussians") && mesh === view.mesh;
  if (wanted("gaussians") || (there.gaussians && !there.mesh)) drawBalls(view, balls, camera);
  if (!wanted("mesh") && there.gaussians) return;
  if (!both) {
    if (there.mesh) drawSurfaces(view, mesh, camera, 1);
    return;
  }
  // the nearest layer of the mesh, as a veil over the balls
  gl.colorMask(false, false, false, false);
  drawSurfaces(view, mesh, camera, 1);
  gl.colorMask(true, true, true, true);
  gl.enable(gl.BLEND);
  gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
  gl.depthFunc(gl.LEQUAL);
  drawSurfaces(view, mesh, camera, 0.3);
  gl.depthFunc(gl.LESS);
  gl.disable(gl.BLEND);
}

function feed(view, program, name, buffer, size, type, { whole = true, each = 0 } = {}) {
  const { gl } = view;
  const at = program.inputs[name];
  if (at === undefined) return;
  gl.bindBuffer(gl.ARRAY_BUFFER, view.buffers[buffer]);
  gl.enableVertexAttribArray(at);
  gl.vertexAttribPointer(at, size, type, !whole, 0, 0);
  gl.vertexAttribDivisor(at, each);
}

function common(view, { at }, camera, valued) {
  const { gl, orbit, mode, variant } = view;
  gl.uniformMatrix4fv(at.camera, false, camera);
  if (at.eye) gl.uniform3fv(at.eye, orbit.eye);
  if (at.floor_) gl.uniform1f(at.floor_, view.ground ?? 0);
  if (!at.stops) return;
  const map = mode === "strain" ? MAPS.diverging : MAPS.sequential;
  gl.uniform3fv(at.stops, map.flat().map((v) => v / 255));
  gl.uniform1i(at.mode, mode !== "color" && valued ? 1 : 0);
  // strain codes reach two octaves either way about 128
  gl.uniform1f(at.gain, mode === "strain" ? 2 / strainReach(variant, view.show) : 1);
  gl.uniform1f(at.middle, mode === "strain" ? 128 / 255 : 0);
}

function useProgram(view, program) {
  const { gl } = view;
  program.array ??= gl.createVertexArray();
  gl.bindVertexArray(program.array);
  gl.useProgram(program.made);
}

const MESH = { place: "places", normal: "normals", color: "meshColors", value: "meshValues",
  triangles: "triangles" };
const FLOW = { place: "flowPlaces", normal: "flowNormals", color: "flowColors", value: "flowValues",
  triangles: "flowTriangles" };

function drawSurfaces(view, program, camera, alpha) {
  const { points, corners } = view.variant.arrays;
  if (points.row) drawMesh(view, program, camera, alpha, MESH, corners.values.length, view.meshValued);
  if (view.flowCorners) drawMesh(view, program, camera, alpha, FLOW, view.flowCorners, false);
}

function drawMesh(view, program, camera, alpha, names, count, valued) {
  const { gl } = view;
  useProgram(view, program);
  gl.uniform1f(program.at.alpha ?? null, alpha);
  common(view, program, camera, valued);
  feed(view, program, "place", names.place, 3, gl.FLOAT);
  feed(view, program, "normal", names.normal, 3, gl.FLOAT);
  feed(view, program, "color", names.color, 3, gl.UNSIGNED_BYTE, { whole: false });
  feed(view, program, "value", names.value, 1, gl.UNSIGNED_BYTE, { whole: false });
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, view.buffers[names.triangles]);
  gl.drawElements(gl.TRIANGLES, count, gl.UNSIGNED_INT, 0);
}

function drawBalls(view, program, camera) {
  const { gl, variant } = view;
  const { positions, scales } = variant.arrays;
  useProgram(view, program);
  common(view, program, camera, view.ballsValued);
  const { at } = program;
  gl.uniform3fv(at.low, positions.low);
  gl.uniform3fv(at.step_, positions.step);
  gl.uniform2f(at.scale, scales.low, scales.step);
  gl.uniform1f(at.grow, view.size * variant.grow);
  gl.uniform1f(at.shrink, view.shrink);
  gl.uniform3fv(at.center, view.center);
  gl.uniform1i(at.zup, variant.up === "Z" ? 1 : 0);
  feed(view, program, "corner", "ball", 3, gl.FLOAT);
  feed(view, program, "place", "positions", 3, gl.UNSIGNED_SHORT, { each: 1 });
  feed(view, program, "turn", "turns", 4, gl.BYTE, { each: 1 });
  feed(view, program, "size", "scales", 3, gl.UNSIGNED_BYTE, { each: 1 });
  feed(view, program, "color", "colors", 3, gl.UNSIGNED_BYTE, { whole: false, each: 1 });
  feed(view, program, "value", "values", 1, gl.UNSIGNED_BYTE, { whole: false, each: 1 });
  gl.bindBuffer(gl.ARRAY_BUFFER, view.buffers.ball);
  const corners = gl.getBufferParameter(gl.ARRAY_BUFFER, gl.BUFFER_SIZE) / 12;
  gl.drawArraysInstanced(gl.TRIANGLES, 0, corners, positions.row / 3);
}

// Where the floor and its shadow lie: under the motion, and a good way around it.
function floorPlan(view) {
  const [low, high] = view.box;
  const about = [0.5 * (low[0] + high[0]), 0.5 * (low[2] + high[2])];
  const wide = Math.max(high[0] - low[0], high[2] - low[2]);
  return { about, shadowReach: 0.8 * wide + 0.1, reach: 2.2 };
}

function drawShadow(view) {
  const { gl } = view;
  const { about, shadowReach } = floorPlan(view);
  const [low, high] = view.box;
  gl.bindFramebuffer(gl.FRAMEBUFFER, view.shadowTarget);
  gl.viewport(0, 0, view.shadowSize, view.shadowSize);
  gl.clearColor(0, 0, 0, 1);
  gl.clear(gl.COLOR_BUFFER_BIT);
  gl.disable(gl.DEPTH_TEST);
  gl.enable(gl.BLEND);
  gl.blendEquation(gl.MAX);
  const camera = fromAbove(...about, shadowReach, Math.min(low[1], view.ground) - 1, high[1] + 1);
  drawBodies(view, view.meshShadow, view.ballShadow, camera);
  gl.blendEquation(gl.FUNC_ADD);
  gl.bindTexture(gl.TEXTURE_2D, view.shadowMap);
  gl.generateMipmap(gl.TEXTURE_2D);
}

function drawFloor(view, camera) {
  const { gl, floor } = view;
  const { about, reach, shadowReach } = floorPlan(view);
  if (!view.buffers.square) {
    view.upload("square", new Float32Array([-1, -1, 1, -1, -1, 1, 1, 1]));
  }
  useProgram(view, floor);
  common(view, floor, camera, false);
  const dark = matchMedia("(prefers-color-scheme: dark)").matches;
  const { at } = floor;
  const origin = view.stand([0, 0, 0]);
  gl.uniform1f(at.reach, reach);
  gl.uniform1f(at.shadowReach, shadowReach);
  gl.uniform1f(at.cell, view.variant.cell * view.shrink);
  gl.uniform2fv(at.about, about);
  gl.uniform2f(at.origin, origin[0], origin[2]);
  gl.uniform3fv(at.ink, dark ? [1, 1, 1] : [0.15, 0.2, 0.28]);
  gl.uniform1f(at.faint, dark ? 0.2 : 0.26);
  feed(view, floor, "corner", "square", 2, gl.FLOAT);
  gl.bindTexture(gl.TEXTURE_2D, view.shadowMap);
  gl.enable(gl.BLEND);
  gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
  gl.depthMask(false);
  gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
  gl.depthMask(true);
}
