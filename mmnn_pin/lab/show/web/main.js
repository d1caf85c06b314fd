/** Draw the plots, and let the legend hide and show runs. */
async function show() {
  const report = await loadData();
  report.visible = report.runs.map(() => true);
  const groups = [...document.querySelectorAll("[data-section]")].map((place) => new Group(place, report.sections[place.dataset.section], report));
  const draw = () => groups.forEach((group) => group.draw());
  for (const button of document.querySelectorAll("#legend button")) {
    button.addEventListener("click", () => {
      const run = Number(button.dataset.run);
      report.visible[run] = !report.visible[run];
      button.setAttribute("aria-pressed", report.visible[run]);
      draw();
    });
  }
  for (const part of document.querySelectorAll("details.fold")) part.addEventListener("toggle", draw);
  let width = 0;
  new ResizeObserver(([entry]) => { if (Math.abs(entry.contentRect.width - width) > 1) { width = entry.contentRect.width; draw(); } }).observe(document.querySelector("main"));
  draw();
  window.report = { ...report, groups, ready: performance.now() };
}

/** Put the replay into the page. */
function showReplay() {
  const stage = document.getElementById("stage"), frame = document.createElement("iframe");
  frame.title = "replay";
  frame.sandbox = "allow-scripts";
  frame.srcdoc = JSON.parse(document.getElementById("replay-page").textContent);
  stage.className = "shown";
  stage.replaceChildren(frame);
  frame.focus();
}

document.getElementById("load")?.addEventListener("click", showReplay);
/** Open what is folded where a link leads into it. */
function unfold() {
  const place = document.getElementById(location.hash.slice(1));
  for (let part = place; part; part = part.parentElement) if (part.tagName === "DETAILS") part.open = true;
  place?.scrollIntoView();
}

addEventListener("hashchange", unfold);
unfold();
addEventListener("beforeprint", () => { for (const part of document.querySelectorAll("details")) part.open = true; });
show();
