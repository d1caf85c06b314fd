/** An element with a class and a text; texts are never read as HTML. */
function element(tag, className, text) {
  const made = document.createElement(tag);
  if (className) made.className = className;
  if (text !== undefined) made.textContent = text;
  return made;
}

/** A check box with a text; `act` gets whether it is checked. */
function addSwitch(parent, text, checked, act) {
  const label = element("label"), box = element("input");
  Object.assign(box, { type: "checkbox", checked });
  box.addEventListener("change", () => act(box.checked));
  label.append(box, text);
  parent.append(label);
  return label;
}

/**
 * How much room the runs take [m]: `reach` around the place of a base, `height` from the `low`est point, `level` of the
 * floor; what the camera should show, `extent` on the floor (of the bases' places, or of arms where no base moves) and a
 * `margin` around it; the `thickness` of lines.
 */
function roomOf(THREE, runs, extent) {
  const box = new THREE.Box3(), own = new THREE.Box3(), mobile = runs.some((run) => run.robot.mobile);
  let level = 0;
  for (const run of runs) {
    run.set(run.run.time[0]);
    run.view.group.updateMatrixWorld(true);
    const [x, y] = run.robot.mobile ? run.now : [0, 0];
    box.union(own.setFromObject(run.view.group).translate(new THREE.Vector3(-x, -y, 0)));
    if (!mobile) level = Math.min(level, own.setFromObject(run.view.bodies[0]).min.z);
    if (!mobile) for (const tip of run.tips()) box.union(own.setFromArray(tip));
  }
  const low = Math.min(level, box.min.z), height = Math.max(box.max.z - low, 0.05);
  const reach = Math.max(-box.min.x, box.max.x, -box.min.y, box.max.y, 0.05), [x0, y0, x1, y1] = extent;
  const thickness = Math.min((Math.hypot(x1 - x0, y1 - y0) / 2 + Math.max(height, reach)) / 2, 4);
  if (!mobile) extent = [box.min.x, box.min.y, box.max.x, box.max.y];
  return { extent, reach, margin: (mobile ? 0.9 : 0.1) * reach, low, level, height, thickness };
}

function makeRuns(THREE, data) {
  const geometries = data.geometries.map((shape) => makeGeometry(THREE, shape));
  const runs = data.runs.map((run, order) =>
    new RunView(THREE, run, data.robots[run.robot], geometries, { several: data.runs.length > 1, order }));
  runs.forEach((run, i) => { run.twins = runs.slice(0, i).filter((other) => sameReference(other.run, run.run)); });
  return runs;
}

/** Whether two runs were asked for the same motion of the base. */
function sameReference(a, b) {
  if (a.robot !== b.robot || !a.reference || !b.reference) return false;
  const last = Math.min(a.frames, b.frames) - 1;
  const at = (run, frame) => run.reference.subarray(frame * run.width, frame * run.width + 3);
  const equal = (frame) => at(a, frame).every((x, i) => Math.abs(x - at(b, frame)[i]) < 1e-3);
  return [0, last >> 2, last >> 1, last].every(equal);
}

function addLegend(runs, first, switches) {
  const legend = document.getElementById("legend");
  for (const run of runs) {
    const item = element("li"), line = element("span", "line");
    line.style.background = run.color;
    if (runs.length > 1) {
      run.group.visible = runs.length <= FEW || run === first;
      const label = addSwitch(item, "", run.group.visible, (on) => { run.group.visible = on; switches.place(); });
      label.append(line, run.run.label);
    } else item.append(line, run.run.label);
    legend.append(item);
  }
  if (runs.some((run) => run.ghost)) {
    const item = element("li");
    const line = element("span", "line wanted");
    line.style.borderColor = referenceColor();
    item.append(line, "reference");
    legend.append(item);
  }
}

const FEW = 3; // runs that are put side by side from the start; of more one alone is shown, `data.first`

const LAYERS = { reference: ["reference"], paths: ["paths", "wanted"], "tip trace": ["traces"], "hand frame": ["frames"] };

/** What is switched on; `update` shows it, by `redraw` in the end. */
class Switches {
  constructor(stage, runs) {
    Object.assign(this, { runs, apart: false, framed: 0, follow: false, hidden: new Set(), redraw: () => {} });
    const place = document.getElementById("switches"), { extent: [x0, y0, x1, y1], reach } = stage.room;
    const change = (act) => (on) => { act(on); this.update(); };
    for (const [text, names] of Object.entries(LAYERS)) {
      if (!runs.some((run) => names.some((name) => run.layers[name].length))) continue;
      addSwitch(place, text, true, change((on) => { for (const name of names) this.hidden[on ? "delete" : "add"](name); }));
    }
    if (runs.some((run) => run.robot.mobile)) addSwitch(place, "follow", false, change((on) => { this.follow = on; }));
    this.spread = y1 - y0 + 2.2 * reach;
    this.frame = () => stage.frame([x0, y0 - this.width, x1, y1]);
    const few = runs.length > 1 && runs.length <= FEW;
    if (runs.length > 1) addSwitch(place, "side by side", few, (on) => { this.apart = on; this.place(); });
    this.apart = few;
    if (few) this.frame();
    this.framed = this.width;
    this.update();
  }

  /** How far the last of the runs that are shown is from the first [m]. */
  get width() { return this.apart ? Math.max(0, this.runs.filter((run) => run.group.visible).length - 1) * this.spread : 0; }

  /** Show other runs, or put them elsewhere: in the middle of the picture again where they lie apart. */
  place() {
    const width = this.width;
    if (width !== this.framed) this.frame();
    this.framed = width;
    this.update();
  }

  update() {
    let beside = 0;
    this.runs.forEach((run) => {
      run.group.position.setY(this.apart ? -beside * this.spread : 0);
      if (run.group.visible) beside++;
      for (const [name, objects] of Object.entries(run.layers)) {
        const told = ["reference", "wanted"].includes(name) && !this.apart && run.twins.some((twin) => twin.group.visible);
        const shown = !this.hidden.has(name) && !told;
        for (const object of objects) object.visible = shown;
      }
    });
    this.redraw();
  }
}

function addMarks(runs, duration) {
  const marks = document.getElementById("marks");
  for (const event of runs.flatMap((run) => run.events)) {
    const mark = element("div", event.kind), end = Math.min(event.end, duration);
    mark.style.left = `min(${(100 * event.start) / duration}%, 100% - 3px)`;
    mark.style.width = `${(100 * (end - event.start)) / duration}%`;
    mark.title = event.text;
    marks.append(mark);
  }
}

function showEvents(runs, found) {
  const badge = document.getElementById("event"), texts = [];
  found.forEach((events, i) => {
    for (const event of events) texts.push(runs.length > 1 ? `${runs[i].run.name}: ${event.text}` : event.text);
  });
  badge.hidden = !texts.length;
  badge.textContent = texts.slice(0, 4).join("\n") + (texts.length > 4 ? `\nand ${texts.length - 4} more` : "");
  badge.className = `panel ${Object.keys(EVENT_COLORS).find((kind) => found.flat().some((event) => event.kind === kind))}`;
}

function addWarnings(warnings) {
  const details = document.getElementById("warnings");
  details.hidden = !warnings.length;
  details.querySelector("summary").textContent = `${warnings.length} warning${warnings.length > 1 ? "s" : ""}`;
  for (const text of warnings) details.querySelector("ul").append(element("li", "", text));
}

async function main() {
  if (typeof DecompressionStream === "undefined") throw new Error("this browser is too old: it cannot unpack the page");
  const [data] = await Promise.all([loadData(), loadViewer()]);
  const THREE = MeshCat.THREE, runs = makeRuns(THREE, data), room = roomOf(THREE, runs, data.extent);
  const stage = new Stage(MeshCat, room);
  for (const run of runs) {
    run.addLines(room.thickness);
    stage.world.add(run.group);
  }
  const duration = Math.max(...runs.map((run) => run.duration));
  const switches = new Switches(stage, runs);
  addLegend(runs, runs[data.first], switches);
  addMarks(runs, duration);
  addWarnings(data.warnings);
  const leader = runs.find((run) => run.robot.mobile) ?? runs[0];
  let before = null;
  const player = new Player(duration, (time) => {
    showEvents(runs, runs.map((run) => run.set(time)));
    const [x, y] = leader.robot.mobile ? leader.now : [0, 0];
    if (switches.follow && before) stage.follow(x - before[0], y - before[1]);
    before = [x, y];
    const wide = switches.width / 2;
    stage.light(x, y - wide, wide);
    stage.draw();
  });
  switches.redraw = () => player.seek(player.time);
  switches.update();
  if (window.top === window && !matchMedia("(prefers-reduced-motion: reduce)").matches) player.play();
  window.replay = { player, runs, stage, ready: performance.now() };
  window.live?.(window.replay);
}

main().catch((error) => {
  const problem = document.getElementById("problem");
  problem.textContent = `The replay cannot be shown: ${error.message}`;
  problem.hidden = false;
  throw error;
});
