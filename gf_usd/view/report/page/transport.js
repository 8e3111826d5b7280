// The controls of time that every page has: slider, buttons, keys and the tabs of variants.

class Transport {
  constructor($) {
    Object.assign(this, { $ });
  }

  // ---- what the player tells ----

  variant(variant, number) {
    this.$("slider").max = variant.seconds.length - 1;
    for (const part of document.querySelectorAll("[data-variant]")) {
      part.hidden = part.dataset.variant !== String(number);
    }
    for (const tab of document.querySelectorAll("[data-open]")) {
      tab.setAttribute("aria-selected", tab.dataset.open === String(number));
    }
  }

  frame(frame, variant) {
    const { $ } = this;
    $("slider").value = frame;
    $("counter").textContent = `${frame + 1} / ${variant.seconds.length}`;
    $("clock").textContent = `time code ${variant.codes[frame]} · ${variant.seconds[frame].toFixed(2)} s`;
  }

  playing(playing) {
    const button = this.$("play");
    button.dataset.playing = playing;
    button.setAttribute("aria-label", playing ? "pause" : "play");
  }

  // ---- what the person does ----

  connect(player, viewer) {
    const { $ } = this;
    Object.assign(this, { player, viewer });
    $("play").addEventListener("click", () => player.toggle());
    $("back").addEventListener("click", () => player.step(-1));
    $("next").addEventListener("click", () => player.step(1));
    $("slider").addEventListener("input", () => {
      player.pause();
      player.seek(Number($("slider").value));
    });
    $("speed").addEventListener("change", () => { player.speed = Number($("speed").value); });
    player.speed = Number($("speed").value);
    $("reset").addEventListener("click", () => { viewer?.refit(); viewer?.draw(); });
    $("size").addEventListener("input", () => this.setSize(Number($("size").value)));
    for (const tab of document.querySelectorAll("[data-open]")) {
      tab.addEventListener("click", () => player.open(Number(tab.dataset.open)));
    }
    document.addEventListener("keydown", (e) => this.key(e));
  }

  key(e) {
    if (e.ctrlKey || e.metaKey || e.altKey || e.target.tagName === "SELECT") return;
    const { player } = this;
    const act = {
      " ": () => player.toggle(),
      ArrowLeft: () => player.step(-1),
      ArrowRight: () => player.step(1),
      Home: () => player.step(-player.frame),
      End: () => player.step(player.count - 1 - player.frame),
    }[e.key];
    if (!act) return;
    e.preventDefault();
    // a button that has the focus would be pressed by the space as well
    document.activeElement?.blur();
    act();
  }

  setSize(size) {
    this.$("size").value = size;
    if (!this.viewer) return;
    this.viewer.size = size;
    this.viewer.draw();
  }
}
