// Something that runs from a start to an end while time passes, can be paused, and set to any moment.

export class Player {
  /** `end`: last moment; `seconds`: how long it takes; `show` is called with the moment that is shown. */
  constructor(end, seconds, show, stopped = () => {}) {
    Object.assign(this, { end, seconds, show, stopped, now: 0, running: null });
  }

  get isRunning() {
    return this.running !== null;
  }

  play() {
    if (this.isRunning) return;
    // shown at once: until the first frame, the end would be
    if (this.now >= this.end) this.show((this.now = 0));
    let last = performance.now();
    const step = (time) => {
      // the first frame's time may lie before the moment at which it was asked for
      this.now = Math.min(this.end, this.now + (Math.max(0, time - last) / 1000 / this.seconds) * this.end);
      last = Math.max(last, time);
      this.running = requestAnimationFrame(step);
      this.show(this.now);
      if (this.now >= this.end) this.pause();
    };
    this.running = requestAnimationFrame(step);
  }

  pause() {
    if (!this.isRunning) return;
    cancelAnimationFrame(this.running);
    this.running = null;
    this.stopped();
  }

  set(moment) {
    this.pause();
    this.now = moment;
    this.show(moment);
  }
}
