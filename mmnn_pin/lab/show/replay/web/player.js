const HOLD = 1.0; // seconds at the end before it starts again

/** The clock, and the controls that turn it. */
class Player {
  constructor(duration, show) {
    this.duration = duration;
    this.show = show;
    this.time = 0;
    this.playing = false;
    this.held = 0;
    this.find = (id) => document.getElementById(id);
    const scrub = this.find("scrub");
    scrub.max = duration;
    scrub.step = duration / 1000 || 1;
    scrub.addEventListener("input", () => { this.pause(); this.seek(Number(scrub.value), false); });
    this.find("play").addEventListener("click", () => this.toggle());
    document.addEventListener("keydown", (event) => {
      if (event.code !== "Space" || event.target.matches("button, input[type=checkbox], select, summary")) return;
      event.preventDefault();
      this.toggle();
    });
    requestAnimationFrame((now) => this.tick(now));
  }

  tick(now) {
    const passed = Math.min((now - (this.last ?? now)) / 1000, 0.1);
    this.last = now;
    if (this.playing) this.advance(passed);
    requestAnimationFrame((next) => this.tick(next));
  }

  advance(passed) {
    if (this.time < this.duration) return this.seek(this.time + passed * Number(this.find("speed").value));
    this.held += passed;
    if (this.held > HOLD) this.seek(0);
  }

  seek(time, moveBar = true) {
    this.time = Math.min(Math.max(time, 0), this.duration);
    this.held = 0;
    if (moveBar) this.find("scrub").value = this.time;
    this.find("time").textContent = `${this.time.toFixed(2)} / ${this.duration.toFixed(2)} s`;
    this.find("scrub").setAttribute("aria-valuetext", `${this.time.toFixed(2)} seconds`);
    this.show(this.time);
  }

  toggle() {
    if (this.playing) this.pause(); else this.play();
  }

  play() {
    this.playing = true;
    this.label("Pause");
  }

  pause() {
    this.playing = false;
    this.label("Play");
  }

  label(word) {
    this.find("play").setAttribute("aria-label", word);
    this.find("play").classList.toggle("playing", this.playing);
  }
}
