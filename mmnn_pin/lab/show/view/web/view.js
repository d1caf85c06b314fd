const find = (what) => document.querySelector(what);
const viewer = new MeshCat.Viewer(find("#pane"));
viewer.connect(`ws://${location.host}/`);
const [middle, eye] = JSON.parse(find("#pane").dataset.camera).map(([x, y, z]) => [x, z, -y]); // three.js: y is up
viewer.set_property(["Cameras", "default", "rotated", "<object>"], "position", eye);
viewer.controls.target.set(...middle);
viewer.controls.update();

const sliders = new Map([...document.querySelectorAll(".joint input")].map((input) => [input.name, input]));
const time = find("#time");
let wish = null, busy = false;
window.view = { joints: {}, asked: 0 };

// One wish at a time; what is asked meanwhile goes together into the next.
async function ask(more) {
  wish = { ...wish, ...more, joints: { ...wish?.joints, ...more.joints } };
  if (busy) return;
  busy = true;
  while (wish) {
    const sent = wish;
    wish = null;
    try {
      const body = { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(sent) };
      show(await (await fetch("/view", body)).json());
      window.view.asked += 1;
    } catch (error) {
      console.info("the server has left", error);
    }
  }
  busy = false;
}

function show(state) {
  window.view.joints = state.joints;
  for (const [name, value] of Object.entries(state.joints)) {
    const input = sliders.get(name);
    if (input !== document.activeElement || state.playing) input.value = value;
    input.nextElementSibling.value = value.toFixed(2);
  }
  find("#run").hidden = state.end <= state.start;
  [time.min, time.max] = [state.start, state.end];
  if (time !== document.activeElement || state.playing) time.value = state.time;
  time.nextElementSibling.value = `${state.time.toFixed(1)} s`;
  find("#play").textContent = state.playing ? "Pause" : "Play";
}

for (const input of sliders.values())
  input.addEventListener("input", () => ask({ joints: { [input.name]: Number(input.value) } }));
find("#frames").addEventListener("change", (event) => ask({ frames: event.target.checked }));
find("#play").addEventListener("click", () => ask({ playing: find("#play").textContent === "Play" }));
time.addEventListener("input", () => ask({ playing: false, time: Number(time.value) }));
setInterval(() => find("#run").hidden || busy || ask({}), 200);
ask({});
