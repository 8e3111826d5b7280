// What every viewer needs: a compiled program with its inputs, and a camera in the hand.

function program(gl, vertex, fragment) {
  const made = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(made));
  const at = {};
  for (let i = 0; i < gl.getProgramParameter(made, gl.ACTIVE_UNIFORMS); i++) {
    const name = gl.getActiveUniform(made, i).name.replace("[0]", "");
    at[name] = gl.getUniformLocation(made, name);
  }
  const inputs = {};
  for (let i = 0; i < gl.getProgramParameter(made, gl.ACTIVE_ATTRIBUTES); i++) {
    const { name } = gl.getActiveAttrib(made, i);
    inputs[name] = gl.getAttribLocation(made, name);
  }
  return { made, at, inputs };
}

// Have the pointer turn, move and zoom the camera of a viewer.
function steer(view) {
  const { canvas, orbit } = view;
  canvas.addEventListener("pointerdown", (e) => {
    canvas.setPointerCapture(e.pointerId);
    view.hand = { x: e.clientX, y: e.clientY, pan: e.button !== 0 || e.shiftKey };
  });
  canvas.addEventListener("pointermove", (e) => {
    if (!view.hand) return;
    const [dx, dy] = [e.clientX - view.hand.x, e.clientY - view.hand.y];
    if (view.hand.pan) orbit.pan(dx / canvas.clientHeight, dy / canvas.clientHeight);
    else orbit.turn(dx * 0.008, dy * 0.008);
    Object.assign(view.hand, { x: e.clientX, y: e.clientY });
    view.draw();
  });
  for (const end of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(end, () => { view.hand = null; });
  }
  canvas.addEventListener("wheel", (e) => {
    e.preventDefault();
    orbit.zoom(Math.exp(Math.sign(e.deltaY) * Math.min(0.25, Math.abs(e.deltaY) * 0.0015)));
    view.draw();
  }, { passive: false });
  canvas.addEventListener("contextmenu", (e) => e.preventDefault());
  canvas.addEventListener("dblclick", () => { view.refit(); view.draw(); });
}
