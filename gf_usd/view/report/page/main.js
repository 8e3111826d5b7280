// Ties the page together: what is clicked, dragged and pressed.

async function start() {
  const page = JSON.parse(document.getElementById("page").textContent);
  const $ = (id) => document.getElementById(id);
  let viewer = null;
  try {
    viewer = new Viewer($("canvas"));
  } catch (error) {
    $("canvas").hidden = true;
    $("trouble").hidden = false;
    $("trouble").textContent = `${error.message} The curves and tables below are all there.`;
  }
  const controls = new Controls(viewer, $);
  const plots = new Plots($("plots"), (seconds) => controls.seekSeconds(seconds));
  const player = new Player(page.variants, viewer, [controls, plots]);
  controls.player = player;
  await player.open(0);
  controls.connect(player, viewer);
  const calm = matchMedia("(prefers-reduced-motion: reduce)").matches;
  if (viewer && !calm && !location.hash.includes("paused")) player.play();
  return player;
}

class Controls extends Transport {
  constructor(viewer, $) {
    super($);
    this.viewer = viewer;
  }

  seekSeconds(seconds) {
    this.player.pause();
    this.player.seek(this.player.frameAt(seconds + 0.5 * this.gap()));
  }

  gap() {
    const times = this.player.variant.seconds;
    return times.length > 1 ? times[1] - times[0] : 0;
  }

  // ---- what the player tells ----

  variant(variant, number) {
    super.variant(variant, number);
    const { $ } = this;
    const has = { mesh: hasSurface(variant.arrays), gaussians: variant.arrays.positions?.row > 0 };
    $("kinds").hidden = !(has.mesh && has.gaussians);
    for (const option of $("mode").options) {
      option.hidden = option.value in MEASURED && !variant.arrays[option.value];
      // what this variant has not cannot go on to be shown
      if (option.hidden && option.selected) this.setMode(($("mode").value = "color"));
    }
    this.legend();
  }

  frame(frame, variant) {
    super.frame(frame, variant);
    for (const picture of document.querySelectorAll("[data-variant]:not([hidden]) [data-frame]")) {
      picture.toggleAttribute("data-now", picture.dataset.frame === String(frame));
    }
  }

  // ---- what the person does ----

  connect(player, viewer) {
    super.connect(player, viewer);
    const { $ } = this;
    $("mode").addEventListener("change", () => this.setMode($("mode").value));
    for (const kind of document.querySelectorAll("[data-show]")) {
      kind.addEventListener("click", () => this.setShow(kind.dataset.show));
    }
    for (const picture of document.querySelectorAll("[data-frame]")) {
      picture.addEventListener("click", () => {
        player.pause();
        player.seek(Number(picture.dataset.frame));
      });
    }
    this.setShow(this.viewer?.show ?? "mesh");
  }

  setShow(show) {
    if (this.viewer) this.viewer.show = show;
    for (const kind of document.querySelectorAll("[data-show]")) {
      kind.setAttribute("aria-pressed", kind.dataset.show === show);
    }
    this.$("sizes").hidden = show === "mesh";
    // half as large they can be seen through the mesh
    this.setSize(show === "both" ? 0.5 : 1);
    this.legend();
    this.viewer?.draw();
  }

  setMode(mode) {
    if (!this.viewer) return;
    this.viewer.mode = mode;
    this.viewer.paint();
    this.legend();
  }

  legend() {
    const { $, viewer, player } = this;
    const mode = viewer?.mode ?? "color";
    $("legend").hidden = mode === "color";
    if (mode === "color") return;
    const stops = MAPS[mode === "strain" ? "diverging" : "sequential"];
    const inks = stops.map((c) => `rgb(${c.join(",")})`).join(",");
    $("legend-bar").style.background = `linear-gradient(90deg,${inks})`;
    const { low, middle, high, title } = this.scale(mode, player.variant);
    $("legend-title").textContent = title;
    $("legend-low").textContent = low;
    $("legend-middle").textContent = middle;
    $("legend-high").textContent = high;
  }

  scale(mode, variant) {
    const show = (v) => Number(v.toPrecision(2)).toString();
    if (mode === "strain") {
      const top = 2 ** strainReach(variant, this.viewer.show);
      const what = { mesh: "stretch of the surface", gaussians: "volume ratio |J|" };
      const title = what[this.viewer.show] ?? "stretch of the surface, volume ratio of Gaussians";
      return { low: `≤ ${show(1 / top)}`, middle: "1", high: `≥ ${show(top)}`, title };
    }
    if (mode === "speed") {
      return { low: "0", middle: "", high: `${show(variant.topSpeed)} m/s`, title: "speed" };
    }
    const [title, unit] = MEASURED[mode];
    return { low: "0", middle: "", high: `≥ ${show(variant.arrays[mode].top)}${unit}`, title };
  }
}

window.report = { ready: start() };
