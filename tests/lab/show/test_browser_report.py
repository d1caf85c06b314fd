"""The report in a real browser: plots drawn, values read, runs hidden, replay opened, nothing asked for, any width."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import browser, opened
from numba import config
from replays import recorded

from mmnn_pin import load
from mmnn_pin.lab.experiments.config import load_experiment
from mmnn_pin.lab.experiments.runner import run_experiment
from mmnn_pin.lab.show.report import report
from mmnn_pin.model.robots import extra

READY = "window.report"
DURATION = 0.05 if config.DISABLE_JIT else 1.0
TIAGO = pytest.mark.skipif("tiago" not in extra(), reason="not here")


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    with browser() as started:
        yield started


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The report on four runs of the thesis robot."""
    settings = [f"time.duration={DURATION}", f"windows=[[0.0, {DURATION}]]", "plots=[]"]
    settings += ["controllers=['two_layer', 'pd', 'pd_effective', 'computed_torque']"]
    runs = run_experiment(load_experiment("chapter4", settings), "chapter4").recordings
    return report(runs, command="mmnn report runs").save(tmp_path_factory.mktemp("report") / "report.html")


@pytest.mark.parametrize("look", ["light", "dark", "phone"])
def test_it_is_whole_at_any_width_by_day_and_by_night(chromium: Any, page: Path, tmp_path: Path, look: str) -> None:
    size = {"width": 390, "height": 844} if look == "phone" else {"width": 1280, "height": 900}
    scheme = "dark" if look == "dark" else "light"
    with opened(chromium, page, READY, viewport=size, color_scheme=scheme) as seen:
        assert seen.page.evaluate("document.documentElement.scrollWidth") <= size["width"]
        assert seen.page.evaluate("document.documentElement.scrollHeight / innerHeight") <= 5.0  # screens
        for part, few in (("table tr", 30), (".plot svg", 20), (".curve", 60)):
            assert seen.page.locator(part).count() > few
        broken = (
            "[...document.querySelectorAll('.curve')].filter((c) => !/^M[-\\d. ML]+$/.test(c.getAttribute('d'))).length"
        )
        assert seen.page.evaluate(broken) == 0
        picture = seen.shot(tmp_path / f"report_{look}_top.png")
        assert (np.median(picture) < 80) == (look == "dark")
        seen.page.evaluate("document.getElementById('plots').scrollIntoView({behavior: 'instant'})")
        plots = seen.shot(tmp_path / f"report_{look}_plots.png")
        assert len(np.unique(plots.reshape(-1, 3), axis=0)) > 100
        assert seen.problems == [] and seen.requests == []


def test_a_robot_of_many_joints_fits_on_five_screens_of_a_desktop(chromium: Any, tmp_path: Path) -> None:
    """Its long table scrolls in a place of its own."""
    runs = {name: recorded(load("tiago_dual"), name, control_period=0.002) for name in ("pd", "pid")}
    file = report(runs, with_replay=False).save(tmp_path / "dual.html")
    with opened(chromium, file, READY, viewport={"width": 1280, "height": 800}) as seen:
        assert seen.page.evaluate("document.documentElement.scrollHeight / innerHeight") <= 5.0
        box = "(([t]) => [t.clientHeight / innerHeight, t.scrollHeight / t.clientHeight])"
        high, longer = seen.page.evaluate(f"{box}(document.querySelectorAll('#tables .scroll'))")
        assert high <= 0.86 and longer > 1.2


def test_what_is_not_judged_is_shaded_and_more_plots_are_a_press_away(chromium: Any, tmp_path: Path) -> None:
    runs = {"pd": recorded(load("tiago_no_hand"), "pd", control_period=0.002)}
    file = report(runs, with_replay=False).save(tmp_path / "tiago.html")
    with opened(chromium, file, READY, viewport={"width": 390, "height": 844}) as seen:
        assert seen.page.evaluate("document.documentElement.scrollHeight / innerHeight") <= 5.0
        judged = seen.page.evaluate(f"report.groups[{PLACE}].judged")
        shaded = seen.page.locator("#plots .plot:visible .transient").evaluate_all(
            "all => all.map(s => s.getBBox().width)"
        )
        assert len(shaded) == (4 if judged[0] > 0 else 0) and all(width > 0 for width in shaded)
        hidden = seen.page.locator("#plots .plot[hidden]")
        assert seen.page.locator("#plots .plot:visible").count() == 4 and hidden.count() > 4
        seen.page.get_by_role("button", name="Show all").click()
        assert hidden.count() == 0
        assert seen.problems == []


PLACE = '[...document.querySelectorAll("[data-section]")].findIndex(p => p.dataset.section === "errors")'
ZOOM = f"report.groups[{PLACE}].stretch"


def test_values_are_read_and_zoomed_with_mouse_and_keys(chromium: Any, page: Path) -> None:
    with opened(chromium, page, READY, viewport={"width": 1280, "height": 900}) as seen:
        plot = seen.page.locator("#plots .plot").first
        plot.scroll_into_view_if_needed()
        box = plot.locator("svg").bounding_box()
        middle = box["y"] + box["height"] / 2
        seen.page.mouse.move(box["x"] + 0.6 * box["width"], middle)
        told = plot.locator("output").inner_text()
        time = float(told.split()[2])
        x = seen.page.evaluate(
            f"(() => {{ const c = report.sections.errors[0].curves[0]; return c.y[nearest(c.x, {time})]; }})()"
        )
        assert 0.4 * DURATION < time < 0.7 * DURATION and f"two_layer {x:.4g}".replace("-", "−") in told
        seen.page.mouse.down()
        seen.page.mouse.move(box["x"] + 0.9 * box["width"], middle, steps=4)
        seen.page.mouse.up()
        low, high = seen.page.evaluate(ZOOM)
        assert abs(low - time) < 0.02 * DURATION and low < high < DURATION
        seen.page.mouse.dblclick(box["x"] + 0.5 * box["width"], middle)
        assert seen.page.evaluate(ZOOM) is None
        plot.locator("svg").focus()
        for key in ("ArrowRight", "+", "+", "ArrowLeft"):
            seen.page.keyboard.press(key)
        low, high = seen.page.evaluate(ZOOM)
        assert high - low < 0.3 * DURATION and plot.locator("output").inner_text().startswith("t = ")
        seen.page.keyboard.press("0")
        assert seen.page.evaluate(ZOOM) is None
        assert seen.problems == []


def test_a_run_is_hidden_and_shown_again(chromium: Any, page: Path) -> None:
    with opened(chromium, page, READY) as seen:
        count = seen.page.locator(".curve").count()
        button = seen.page.locator("#legend button", has_text="computed_torque")
        button.focus()
        seen.page.keyboard.press("Enter")
        assert button.get_attribute("aria-pressed") == "false"
        assert 10 < seen.page.locator(".curve").count() < count
        button.click()
        assert seen.page.locator(".curve").count() == count


def test_the_replay_opens_in_the_page(chromium: Any, page: Path, tmp_path: Path) -> None:
    with opened(chromium, page, READY) as seen:
        assert seen.page.locator("iframe").count() == 0  # nothing of it before it is asked for
        seen.page.locator("#load").focus()
        seen.page.keyboard.press("Enter")
        seen.page.locator("iframe").wait_for()
        (frame,) = seen.page.main_frame.child_frames
        frame.wait_for_function("window.replay", timeout=60_000)
        frame.evaluate(f"replay.player.pause(); replay.player.seek({DURATION / 2})")
        seen.page.locator("#stage").scroll_into_view_if_needed()
        picture = seen.shot(tmp_path / "report_replay.png")
        assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 500
        assert seen.problems == [] and [url for url in seen.requests if url != "about:srcdoc"] == []


@TIAGO
def test_a_robot_with_meshes_and_names_that_would_run(chromium: Any, tmp_path: Path) -> None:
    """TIAGo, and a name that is a script: dialogs, errors and requests would be seen."""
    name = "<img src=x onerror=alert(1)>"
    runs = {
        name: recorded(load("tiago_no_hand"), name, control_period=0.002, experiment="<script>alert(2)</script>"),
        "pd": recorded(load("tiago_no_hand"), "pd", control_period=0.002, lag=0.2),
    }
    file = report(runs, with_replay=False).save(tmp_path / "tiago.html")
    with opened(chromium, file, READY, viewport={"width": 390, "height": 844}) as seen:
        assert seen.page.evaluate("document.documentElement.scrollWidth") <= 390
        assert seen.page.locator(".plot svg").count() > 10
        seen.page.locator(".plot svg").first.focus()
        seen.page.keyboard.press("ArrowRight")
        assert name in seen.page.locator(".plot output").first.inner_text()
        assert seen.problems == [] and seen.requests == []
