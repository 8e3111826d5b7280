// Which variant and frame is shown, and the clock that moves it.

class Player {
  constructor(variants, viewer, listeners) {
    Object.assign(this, { variants, viewer, listeners, number: 0, frame: 0, speed: 1, playing: false });
  }

  get variant() {
    return this.variants[this.number];
  }

  get count() {
    return this.variant.seconds.length;
  }

  // Switch to another variant; place in the motion, camera and playing stay as they are.
  async open(number) {
    const at = this.variant.seconds[this.frame] ?? 0;
    await loadVariant(this.variants[number], number);
    this.number = number;
    this.variant.topSpeed ??= topSpeed(this.variant);
    this.viewer?.open(this.variant);
    for (const heard of this.listeners) heard.variant?.(this.variant, number);
    this.seek(this.frameAt(at));
  }

  seek(frame) {
    this.frame = Math.min(this.count - 1, Math.max(0, Math.round(frame)));
    this.viewer?.setFrame(this.frame);
    for (const heard of this.listeners) heard.frame?.(this.frame, this.variant);
  }

  step(by) {
    this.pause();
    this.seek((this.frame + by + this.count) % this.count);
  }

  // The last frame that is not after a playback time [s].
  frameAt(seconds) {
    const times = this.variant.seconds;
    let frame = 0;
    while (frame + 1 < times.length && times[frame + 1] <= seconds + 1e-6) frame++;
    return frame;
  }

  play() {
    if (this.playing) return;
    this.playing = true;
    let last = null;
    let clock = this.variant.seconds[this.frame];
    let shown = this.frame;
    const tick = (now) => {
      if (!this.playing) return;
      const times = this.variant.seconds;
      // the last frame is held as long as the one before it, and then it starts again
      const length = times.at(-1) + (times.at(-1) - (times.at(-2) ?? 0) || 0.04);
      if (shown !== this.frame) clock = times[this.frame];
      clock += last === null ? 0 : (this.speed * Math.min(now - last, 250)) / 1000;
      if (clock >= length) clock %= length;
      last = now;
      const frame = this.frameAt(clock);
      if (frame !== this.frame) this.seek(frame);
      shown = this.frame;
      requestAnimationFrame(tick);
    };
    requestAnimationFrame(tick);
    this.tell();
  }

  pause() {
    this.playing = false;
    this.tell();
  }

  toggle() {
    if (this.playing) this.pause();
    else this.play();
  }

  tell() {
    for (const heard of this.listeners) heard.playing?.(this.playing);
  }
}
