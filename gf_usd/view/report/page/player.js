// Which look and frame is shown, and the clock that moves it.

class Player {
  constructor(looks, viewer, listeners) {
    Object.assign(this, { looks, viewer, listeners, number: 0, frame: 0, speed: 1, playing: false });
  }

  get look() {
    return this.looks[this.number];
  }

  get count() {
    return this.look.seconds.length;
  }

  // Switch to another look; place in the motion, camera and playing stay as they are.
  async open(number) {
    const at = this.look.seconds[this.frame] ?? 0;
    await loadLook(this.looks[number], number);
    this.number = number;
    this.look.topSpeed ??= topSpeed(this.look);
    this.look.reach ??= strainReach(this.look);
    this.viewer?.open(this.look);
    for (const heard of this.listeners) heard.look?.(this.look, number);
    this.seek(this.frameAt(at));
  }

  seek(frame) {
    this.frame = Math.min(this.count - 1, Math.max(0, Math.round(frame)));
    this.viewer?.setFrame(this.frame);
    for (const heard of this.listeners) heard.frame?.(this.frame, this.look);
  }

  step(by) {
    this.pause();
    this.seek((this.frame + by + this.count) % this.count);
  }

  // The last frame that is not after a playback time [s].
  frameAt(seconds) {
    const times = this.look.seconds;
    let frame = 0;
    while (frame + 1 < times.length && times[frame + 1] <= seconds + 1e-6) frame++;
    return frame;
  }

  play() {
    if (this.playing) return;
    this.playing = true;
    let last = null;
    let clock = this.look.seconds[this.frame];
    let shown = this.frame;
    const tick = (now) => {
      if (!this.playing) return;
      const times = this.look.seconds;
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
