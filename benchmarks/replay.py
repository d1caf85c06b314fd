"""Measures replays: seconds to write the page of a run, its size, and how soon a browser shows it.

    python benchmarks/replay.py [ROBOT ...] [--duration S] [--peers] [--json]

The run is `track` under PD. The browser is a Chromium found on the PATH, without a graphics card, driven by playwright;
without them that column stays empty. With --peers also, where they are installed, the pages that Pinocchio's viewers
write of the same robot: meshcat's without any motion, viser's with as many frames.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

SOFTWARE_GL = ("--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
PEERS = {
    "meshcat": "V.viewer.static_html()",
    "viser": "film(V.viewer.get_scene_serializer())",
}
PEER = """
import os, sys
from mmnn_pin.recording.recording import recorded_robot
from mmnn_pin.model.base.overrides import folders_of
from mmnn_pin.recording.recording import Recording
from mmnn_pin.lab.show.replay.motion import frames_of
import pinocchio as pin, pinocchio.visualize
R = Recording.open(sys.argv[1])
robot = recorded_robot(R)
folders = list(map(str, folders_of(robot.path, robot.overrides)))
visual = pin.buildGeomFromUrdfString(robot.model, robot.urdf, pin.GeometryType.VISUAL, folders)
V = getattr(pinocchio.visualize, "{name}Visualizer")(robot.model, pin.GeometryModel(), visual)
V.initViewer(open=False)
V.loadViewerModel()
def film(serializer):
    for position in R["position"][frames_of(R, 60.0)]:
        V.display(robot.configuration(position))
        serializer.insert_sleep(1 / 60)
    return serializer.as_html()
print("bytes", len({page}))
if "{name}" == "Meshcat":
    V.viewer.window.server_proc.kill()
os._exit(0)
"""


def main() -> None:
    """Parse the command line, measure, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("robots", nargs="*", default=["platform_arm"])
    parser.add_argument("--duration", type=float, default=5.0, help="of the run [s]")
    parser.add_argument("--peers", action="store_true")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    peers = PEERS if options.peers else ()
    with tempfile.TemporaryDirectory() as folder:
        rows = [measure(robot, options.duration, peers, Path(folder) / Path(robot).stem) for robot in options.robots]
    if options.json:
        print(json.dumps(rows))
        return
    for row in rows:
        print(
            "   ".join(
                f"{key} {value:.3g}" if isinstance(value, float) else f"{key} {value}" for key, value in row.items()
            )
        )


def measure(robot: str, duration: float, peers: Iterable[str], folder: Path) -> dict[str, Any]:
    """The figures of one robot: seconds, and megabytes of 10^6 bytes."""
    run, out = folder / "pd.h5", folder / "page.html"
    mmnn("run", "track", "--robot", robot, "--controller", "pd", "--set", f"time.duration={duration}", "--out", folder)
    start = time.perf_counter()
    told = json.loads(mmnn("replay", run, "--html", out, "--json"))
    seconds = time.perf_counter() - start
    others = {f"{name} [MB]": peer(name, run) for name in peers}
    figures = {"robot": robot, "frames": told["frames"], "written in [s]": seconds, "size [MB]": told["bytes"] / 1e6}
    return figures | {"shown in [s]": shown_in(out)} | others


def mmnn(*arguments: object) -> str:
    """What the command line prints."""
    command = [sys.executable, "-c", "import mmnn_pin.cli as c, sys; sys.exit(c.main())", *map(str, arguments)]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def shown_in(page: Path) -> float | None:
    """Seconds from opening a page to the first picture that can be played."""
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        return None
    if (path := shutil.which("chromium")) is None:
        return None
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=path, args=list(SOFTWARE_GL))
        tab = browser.new_page()
        tab.goto(page.as_uri())
        tab.wait_for_function("window.replay")
        ready = tab.evaluate("replay.ready") / 1000
        browser.close()
    return float(ready)


def peer(name: str, run: Path) -> float | None:
    """Megabytes of the page that one of Pinocchio's viewers writes."""
    code = PEER.format(name=name.capitalize(), page=PEERS[name])
    done = subprocess.run([sys.executable, "-c", code, str(run)], capture_output=True, text=True, env=os.environ)
    sizes = [line.split()[1] for line in done.stdout.splitlines() if line.startswith("bytes ")]
    return int(sizes[0]) / 1e6 if sizes else None


if __name__ == "__main__":
    main()
