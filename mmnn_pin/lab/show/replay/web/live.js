const SILENT = 2000; // milliseconds without a frame after which the page says so

/** Show frames as the server tells them, in place of a recorded run's. */
window.live = ({ runs: [run], player }) => {
  const find = (id) => document.getElementById(id), badge = find("event");
  let heard = performance.now(), tripped = false;
  const tell = (text) => { badge.hidden = !text; badge.textContent = text; badge.className = "panel stop"; };
  for (const id of ["play", "track", "speed"]) find(id).style.display = "none";
  find("speed").parentElement.style.display = "none";
  const source = new EventSource("live");
  source.onmessage = ({ data }) => {
    const frame = JSON.parse(data);
    heard = performance.now();
    tripped = frame.tripped;
    run.run.position.set(frame.position);
    run.run.reference?.set(frame.reference);
    player.seek(0);
    find("time").textContent = `${frame.time.toFixed(2)} s`;
    tell(tripped ? "the supervisor has stopped the robot" : "");
    window.replay.told = frame;
  };
  source.onerror = () => tell("the robot's process does not answer");
  setInterval(() => {
    if (performance.now() - heard > SILENT) tell("no sample for two seconds");
  }, 500);
};
