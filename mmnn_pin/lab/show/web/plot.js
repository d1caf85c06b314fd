const LEAST = 1e-12; // smallest share of the largest value that a logarithmic axis goes down to

/** One panel: an SVG that is drawn anew when its size, its stretch of x, or the runs shown change. */
class Plot {
  constructor(group, spec, report) {
    Object.assign(this, { group, spec, report });
    this.box = document.createElement("figure");
    this.box.className = spec.plane ? "plot wide" : "plot";
    this.caption = this.box.appendChild(document.createElement("figcaption"));
    this.caption.textContent = this.named();
    this.svg = this.box.appendChild(element("svg", { tabindex: 0, role: "img", "aria-label": `plot of ${this.caption.textContent}` }));
    this.output = this.box.appendChild(document.createElement("output"));
    this.output.setAttribute("aria-live", "polite");
    this.output.hidden = true;
    this.full = extent(spec.curves.flatMap((c) => spec.plane ? [...c.x] : [c.x[0], c.x[c.x.length - 1]]));
    if (!spec.plane) this.listen();
  }

  /** What the panel shows: title, unit with the power of ten that its numbers leave out, and a limit that is not drawn. */
  named(power = "", limit = false) {
    const { title, unit, limit: most } = this.spec, units = [power, unit].filter(Boolean).join(" ");
    return `${title}${units ? ` [${units}]` : ""}${limit ? `, limit ±${told(most)}` : ""}`;
  }

  get shown() { return this.spec.curves.filter((c) => c.run === null || this.report.visible[c.run]); }

  /** Lowest and highest value to show, in this stretch of x; a diverged run sets no scale where another is calm. */
  range(from, to) {
    const values = [this.spec.scale === "log" ? NaN : 0], runs = this.report.runs;
    const some = this.shown.filter((c) => c.run === null || runs[c.run].calm !== null);
    for (const { run, x, y } of some.length ? some : this.shown) {
      const until = run === null ? Infinity : runs[run].calm ?? Infinity;
      for (let i = Math.max(0, placeOf(x, from) - 1); i < x.length && x[i] <= to; i++) if (x[i] <= until) values.push(y[i]);
    }
    let [low, high] = extent(this.spec.scale === "log" ? values.filter((v) => v > 0) : values);
    if (this.spec.scale === "log") return [Math.max(low, high * LEAST) / 1.5, high * 1.5];
    if (this.spec.limit !== undefined && Math.max(-low, high) > 0.5 * this.spec.limit) { low = Math.min(low, -this.spec.limit); high = Math.max(high, this.spec.limit); }
    const margin = 0.07 * (high - low) || 1;
    return [low - margin, high + margin];
  }

  /** Limits of the plane: of a fixed shape, with the same unit of length both ways. */
  plane(width, height) {
    const calm = this.shown.filter((c) => c.run === null || this.report.runs[c.run].calm !== null);
    const [x, y] = ["x", "y"].map((name) => extent((calm.length ? calm : this.shown).flatMap((c) => [...c[name]])));
    const scale = 1.12 * Math.max((x[1] - x[0]) / width, (y[1] - y[0]) / height, 0.05 / height);
    const around = ([a, b], size) => [(a + b - scale * size) / 2, (a + b + scale * size) / 2];
    return [around(x, width), around(y, height)];
  }

  /** Height of the plane: what the paths fill, within limits. */
  flatness(width) {
    const [x, y] = ["x", "y"].map((name) => extent(this.shown.flatMap((c) => [...c[name]]))), shape = (y[1] - y[0]) / (x[1] - x[0] || 1);
    return Math.round(Math.min(460, Math.max(170, 44 + shape * (width - 72))));
  }

  draw() {
    const { spec } = this, W = Math.max(260, Math.round(this.box.clientWidth || 360)), H = spec.plane ? this.flatness(W) : W < 500 && innerWidth < 600 ? 160 : 200;
    const left = 62, right = 10, top = 8, bottom = 36, width = W - left - right, height = H - top - bottom;
    let [from, to] = this.group.stretch || this.full, low, high;
    if (spec.plane) [[from, to], [low, high]] = this.plane(width, height);
    else [low, high] = this.range(from, to);
    const scale = scales[spec.scale || "linear"](low, high), bounds = [scale.to(low), scale.to(high)];
    const X = (x) => left + (width * (x - from)) / (to - from), Y = (y) => top + (height * (bounds[1] - scale.to(y))) / (bounds[1] - bounds[0]);
    Object.assign(this, { W, H, left, top, width, height, from, to, X, Y });
    this.svg.setAttribute("viewBox", `0 0 ${W} ${H}`);
    this.svg.replaceChildren();
    const add = (name, attributes, text) => { const made = this.svg.appendChild(element(name, attributes)); if (text !== undefined) made.textContent = text; return made; };
    const clip = `clip-${Plot.count = (Plot.count || 0) + 1}`;
    add("clipPath", { id: clip }).append(element("rect", { x: left, y: top, width, height }));
    const begins = this.group.judged?.[0];
    if (begins > from) add("rect", { class: "transient", x: left, y: top, width: X(Math.min(begins, to)) - left, height });
    for (const [v, text] of scale.ticks(low, high)) if (Y(v) >= top - 1 && Y(v) <= top + height + 1) {
      add("line", { class: v === 0 ? "zero" : "gridline", x1: left, x2: left + width, y1: Y(v), y2: Y(v) });
      add("text", { x: left - 6, y: Y(v) + 4, "text-anchor": "end" }, text);
    }
    for (const v of steps(from, to, Math.max(2, Math.min(10, width / 48)))) {
      add("line", { class: "gridline", x1: X(v), x2: X(v), y1: top, y2: top + height });
      add("text", { x: X(v), y: top + height + 15, "text-anchor": "middle" }, told(v, 5));
    }
    add("text", { x: left + width / 2, y: H - 4, "text-anchor": "middle" }, spec.across || "time [s]");
    const near = spec.limit !== undefined && Y(spec.limit) >= top;
    if (near) for (const v of [-spec.limit, spec.limit]) add("line", { class: "limit", x1: left, x2: left + width, y1: Y(v), y2: Y(v) });
    this.caption.textContent = this.named(scale.note, spec.limit !== undefined && !near);
    const drawn = add("g", { "clip-path": `url(#${clip})` });
    for (const curve of this.shown) {
      const look = curve.run === null ? { class: "curve truth" } : { class: "curve", stroke: `var(--run-${curve.run})`, "stroke-dasharray": this.report.runs[curve.run].dash };
      drawn.append(element("path", { ...look, d: this.path(curve) }));
      if (curve.arrows) for (let i = 0; i < curve.arrows.length; i += 3) drawn.append(this.arrow(curve, i));
    }
    add("rect", { class: "frame", x: left, y: top, width, height });
    this.chosen = add("rect", { class: "chosen", y: top, height, width: 0, x: left });
    this.line = add("line", { class: "cursor", y1: top, y2: top + height, x1: -9, x2: -9 });
    this.read();
  }

  /** The path of a curve: at most the least and the largest value of every pixel's width. */
  path({ x, y }) {
    const parts = [], plane = this.spec.plane, step = this.spec.step;
    const first = plane ? 0 : Math.max(0, placeOf(x, this.from) - 1), last = plane ? x.length - 1 : Math.min(x.length - 1, placeOf(x, this.to));
    const stride = plane ? 1 : Math.max(1, Math.floor((last - first) / (2 * this.width)) * 2);
    let open = false, before = 0;
    const to = (i) => {
      const px = this.X(x[i]), py = Math.max(-1e5, Math.min(1e5, this.Y(y[i])));
      if (!Number.isFinite(px) || !Number.isFinite(py)) { open = false; return; }
      if (open && step) parts.push(`L${px.toFixed(1)} ${before}`);
      before = py.toFixed(2);
      parts.push(`${open ? "L" : "M"}${px.toFixed(1)} ${before}`);
      open = true;
    };
    for (let i = first; i <= last; i += stride) {
      if (stride === 1) { to(i); continue; }
      let least = i, most = i;
      for (let k = i; k < Math.min(i + stride, last + 1); k++) { if (y[k] < y[least]) least = k; if (y[k] > y[most]) most = k; }
      to(Math.min(least, most));
      if (least !== most) to(Math.max(least, most));
    }
    return parts.join("");
  }

  arrow(curve, i) {
    const [x, y, phi] = curve.arrows.slice(i, i + 3), px = this.X(x), py = this.Y(y), size = curve.run === null ? 13 : 9;
    const at = (along, aside) => `${(px + along * Math.cos(phi) + aside * Math.sin(phi)).toFixed(1)} ${(py - along * Math.sin(phi) + aside * Math.cos(phi)).toFixed(1)}`;
    return element("path", { class: "arrow", stroke: curve.run === null ? "var(--truth)" : `var(--run-${curve.run})`, d: `M${at(-size, 0.6 * size)}L${at(0, 0)}L${at(-size, -0.6 * size)}` });
  }

  /** The line at the group's instant, and the values there. */
  read() {
    const at = this.group.cursor;
    const seen = !this.spec.plane && at !== null && at >= this.from && at <= this.to;
    for (const end of ["x1", "x2"]) this.line.setAttribute(end, seen ? this.X(at) : -9);
    this.output.hidden = !seen || this.group.active !== this;
    if (this.output.hidden) return;
    this.output.className = at > (this.from + this.to) / 2 ? "left" : "";
    this.output.replaceChildren(`t = ${told(at, 5)} s`);
    for (const { run, x, y } of this.shown) {
      if (at > x[x.length - 1] + 1e-9) continue;
      const item = this.output.appendChild(document.createElement("span")), mark = item.appendChild(document.createElement("i"));
      mark.style.background = run === null ? "var(--truth)" : `var(--run-${run})`;
      item.append(`${run === null ? this.spec.truth || "reference" : this.report.runs[run].name} ${told(y[nearest(x, at)])}`);
    }
  }

  listen() {
    const { svg, group } = this;
    const at = (event) => { const box = svg.getBoundingClientRect(), px = ((event.clientX - box.left) * this.W) / box.width; return Math.min(this.to, Math.max(this.from, this.from + ((px - this.left) * (this.to - this.from)) / this.width)); };
    let start = null;
    svg.addEventListener("pointerdown", (event) => { if (event.button) return; start = at(event); group.point(start, this); if (event.pointerType !== "touch") svg.setPointerCapture(event.pointerId); });
    svg.addEventListener("pointermove", (event) => {
      const now = at(event);
      group.point(now, this);
      if (start === null || event.pointerType === "touch") return;
      this.chosen.setAttribute("x", this.X(Math.min(start, now)));
      this.chosen.setAttribute("width", Math.abs(this.X(now) - this.X(start)));
    });
    svg.addEventListener("pointerup", (event) => {
      const now = at(event), from = start;
      start = null;
      this.chosen.setAttribute("width", 0);
      if (from !== null && event.pointerType !== "touch" && Math.abs(this.X(now) - this.X(from)) > 6) group.zoom(Math.min(from, now), Math.max(from, now));
    });
    svg.addEventListener("pointercancel", () => { start = null; this.chosen.setAttribute("width", 0); });
    svg.addEventListener("pointerleave", () => { if (start === null && document.activeElement !== svg) group.point(null); });
    svg.addEventListener("blur", () => group.point(null));
    svg.addEventListener("dblclick", () => group.zoom(null));
    svg.addEventListener("keydown", (event) => this.key(event));
  }

  key(event) {
    const { group } = this, span = this.to - this.from, at = group.cursor ?? (this.from + this.to) / 2;
    const move = { ArrowLeft: -1, ArrowRight: 1 }[event.key], factor = { "+": 0.5, "=": 0.5, "-": 2 }[event.key];
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (move) group.point(Math.min(this.to, Math.max(this.from, at + (move * span * (event.shiftKey ? 10 : 1)) / 100)), this);
    else if (factor) group.zoom(Math.max(this.full[0], at - (at - this.from) * factor), Math.min(this.full[1], at + (this.to - at) * factor));
    else if (event.key === "0" || event.key === "Escape") group.zoom(null);
    else return;
    event.preventDefault();
  }
}

/** Panels that share the line and the stretch of time. */
class Group {
  constructor(place, specs, report) {
    this.cursor = this.active = this.stretch = null;
    this.plots = specs.map((spec) => new Plot(this, spec, report));
    place.append(...this.plots.map((plot) => plot.box));
    this.judged = place.dataset.judged?.split(" ").map(Number);
    if (this.judged) this.fold(place, innerWidth < 600 ? 4 : 9);
  }

  /** Show so many plots, and a button for the others. */
  fold(place, most) {
    const others = this.plots.slice(most);
    if (others.length < 2) return;
    for (const plot of others) plot.box.hidden = true;
    const button = place.appendChild(document.createElement("button"));
    button.type = "button";
    button.textContent = `Show all ${this.plots.length} plots`;
    button.addEventListener("click", () => { for (const plot of others) plot.box.hidden = false; button.remove(); this.draw(); });
  }

  draw() { for (const plot of this.plots) plot.draw(); }
  point(time, active = null) { this.cursor = time; this.active = active; for (const plot of this.plots) plot.read(); }
  zoom(from, to) {
    if (from !== null && to - from < 1e-6) return;
    const time = this.plots.find((plot) => !plot.spec.plane).full;
    this.stretch = from === null || (from <= time[0] && to >= time[1]) ? null : [from, to];
    this.draw();
  }
}

/** The least and the largest finite number of some; 0 and 1 without any. */
function extent(values) {
  let low = Infinity, high = -Infinity;
  for (const v of values) if (Number.isFinite(v)) { if (v < low) low = v; if (v > high) high = v; }
  return low <= high ? [low, high] : [0, 1];
}

function element(name, attributes = {}) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  return made;
}
