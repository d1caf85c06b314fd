"""The replay in a real browser: it shows the robot where Pinocchio has it, moves it, and asks for nothing."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from browser import Opened, browser, opened
from replays import recorded
from robots import mobile_arm

from mmnn_pin import load
from mmnn_pin.lab.show.figure import STYLES, in_the_dark
from mmnn_pin.lab.show.replay import page
from mmnn_pin.model.loading import build
from mmnn_pin.model.robots import extra
from mmnn_pin.model.urdf.reading import parse
from mmnn_pin.recording.recording import Outcome

ORANGE = np.array([238, 125, 33])  # of the thesis robot's forearm
ROBOTS = [
    "platform_arm",
    pytest.param("tiago_no_hand", marks=pytest.mark.skipif("tiago" not in extra(), reason="not here")),
]


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    with browser() as started:
        yield started


@pytest.fixture(scope="module")
def thesis(chromium: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Opened]:
    """The thesis robot, paused."""
    file = page({"two_layer": recorded(load("platform_arm"))}).save(tmp_path_factory.mktemp("page") / "thesis.html")
    with opened(chromium, file) as seen:
        seen.page.evaluate("replay.player.pause()")
        yield seen


def seek(seen: Opened, time: float) -> None:
    """Show this time and stay there: the page plays by itself, and from the end it starts again."""
    seen.page.evaluate(f"replay.player.pause(), replay.player.seek({time})")


def near(picture: np.ndarray, color: np.ndarray, within: int = 60) -> np.ndarray:
    """Where a picture has about this colour, in any brightness above a third."""
    brightness = picture.max(axis=2, keepdims=True) / color.max()
    return (np.abs(picture - brightness * color).max(axis=2) < within) & (brightness[..., 0] > 1 / 3)


@pytest.mark.parametrize("name", ROBOTS)
def test_it_moves_and_asks_for_nothing(chromium: Any, tmp_path: Path, name: str) -> None:
    file = page({"two_layer": recorded(load(name))}).save(tmp_path / f"{name}.html")
    with opened(chromium, file) as seen:
        seen.page.evaluate("replay.player.pause()")
        pictures = []
        for time in (0.1, 1.8):
            seek(seen, time)
            pictures.append(seen.shot(tmp_path / f"replay_{name}_{time}.png")[100:500])
        for picture in pictures:
            assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 500  # not blank, not flat
        changed = (np.abs(pictures[0] - pictures[1]).max(axis=2) > 30).mean()
        assert changed > 0.01
        seek(seen, 0.1)
        assert (np.abs(seen.shot()[100:500] - pictures[0]).max(axis=2) > 30).mean() < 0.001
        assert seen.problems == [] and seen.requests == []


def test_the_forearm_is_where_pinocchio_has_it(thesis: Opened) -> None:
    middles = []
    for time in (0.1, 1.5):
        seek(thesis, time)
        rows, columns = np.nonzero(near(thesis.shot()[100:500], ORANGE, 40))
        assert len(rows) > 100
        middles.append((rows.mean(), columns.mean()))
    assert np.hypot(*np.subtract(*middles)) > 40  # pixels


@pytest.mark.parametrize(
    "robot", [load("platform_arm"), mobile_arm(), load("truck_trailer_arm")], ids=["thesis", "any axes", "steers"]
)
def test_bodies_are_where_pinocchio_has_them(chromium: Any, tmp_path: Path, robot: Any) -> None:
    recording = recorded(robot, duration=1.0)
    file = page({"run": recording}).save(tmp_path / "page.html")
    data, model = robot.model.createData(), robot.model
    with opened(chromium, file) as seen:
        for row in (0, 250, 499):
            seek(seen, recording.time[row])
            shown = seen.page.evaluate("replay.runs[0].view.matrices.map((matrix) => matrix.elements)")
            names = seen.page.evaluate("replay.runs[0].robot.bodies.map((body) => body.column ?? -1)")
            pin.forwardKinematics(model, data, robot.configuration(recording["position"][row]))
            for elements, column in zip(shown[1:], names[1:], strict=True):
                placed = data.oMi[model.getJointId(robot.position_names[column])].homogeneous.copy()
                placed[2, 3] -= robot.base.floor
                np.testing.assert_allclose(np.reshape(elements, (4, 4)).T, placed, atol=2e-5)


def test_a_hand_and_its_path_are_where_pinocchio_has_them(chromium: Any, tmp_path: Path) -> None:
    robot = load("platform_arm")
    recording = recorded(robot, duration=1.0, hands=("arm_tip",))
    data, frame = robot.model.createData(), robot.model.getFrameId("arm_tip")
    file = page({"run": recording}).save(tmp_path / "hand.html")
    with opened(chromium, file) as seen:
        for row in (0, 250, 499):
            seek(seen, recording.time[row])
            position = recording["position"][row].copy()
            for axes in ("axes", "wish"):
                pin.forwardKinematics(robot.model, data, robot.configuration(position))
                placed = pin.updateFramePlacement(robot.model, data, frame).homogeneous.copy()
                placed[2, 3] -= robot.base.floor
                shown = f"replay.runs[0].hands[0].{axes}; part.updateMatrix(); return part.matrix.elements"
                found = np.reshape(seen.page.evaluate(f"(() => {{ const part = {shown} }})()"), (4, 4)).T
                size = np.linalg.norm(found[:3, 0])
                assert size > 0.02
                np.testing.assert_allclose(found[:3, :3] / size, placed[:3, :3], atol=2e-5)
                np.testing.assert_allclose(found[:3, 3], placed[:3, 3], atol=2e-5)
                position[:3], position[robot.arm_index] = recording["pose_ref"][row], recording["q_ref"][row]
        drawn = np.reshape(seen.page.evaluate("replay.runs[0].drawn(replay.runs[0].hands[0].wanted)"), (-1, 3))
        np.testing.assert_allclose(drawn[[0, -1], :2], recording["hand_ref"][[0, -1], :2], atol=1e-5)
        with_axes = seen.shot(tmp_path / "replay_hand.png")
        seen.page.get_by_label("hand frame").uncheck()
        assert (np.abs(seen.shot() - with_axes).max(axis=2) > 60).sum() > 50
        assert seen.problems == [] and seen.requests == []


def test_the_scrub_bar_moves_it(thesis: Opened) -> None:
    seek(thesis, 0.0)
    before = thesis.shot()[100:500]
    bar = thesis.page.locator("#scrub").bounding_box()
    thesis.page.mouse.click(bar["x"] + 0.75 * bar["width"], bar["y"] + bar["height"] / 2)
    time = thesis.page.evaluate("replay.player.time")
    assert 1.3 < time < 1.7
    assert thesis.page.locator("#time").inner_text() == f"{time:.2f} / 2.00 s"
    assert (np.abs(thesis.shot()[100:500] - before).max(axis=2) > 30).mean() > 0.01
    thesis.page.keyboard.press("Home")
    assert thesis.page.evaluate("replay.player.time") == 0


def test_it_plays_at_its_speed_and_pauses(thesis: Opened) -> None:
    run = """(speed) => { const player = replay.player; document.getElementById("speed").value = speed;
        player.seek(0.5); player.play(); player.advance(0.1); player.pause(); return player.time; }"""
    assert thesis.page.evaluate(run, "0.5") == pytest.approx(0.55)
    assert thesis.page.evaluate(run, "2") == pytest.approx(0.7)
    thesis.page.evaluate("document.getElementById('speed').value = '1'")
    thesis.page.locator("#play").click()
    thesis.page.wait_for_function("replay.player.time > 0.8")
    assert thesis.page.locator("#play").get_attribute("aria-label") == "Pause"
    thesis.page.locator("#play").click()
    assert not thesis.page.evaluate("replay.player.playing")


def test_two_runs_have_their_colours_and_can_be_hidden(chromium: Any, tmp_path: Path) -> None:
    robot = load("platform_arm")
    runs = {"one_layer": recorded(robot, "one_layer"), "two_layer": recorded(robot, lag=0.8)}
    file = page(runs).save(tmp_path / "two.html")
    red, blue = np.array([213, 94, 0]), np.array([0, 114, 178])
    with opened(chromium, file) as seen:
        seen.page.evaluate("replay.player.pause()")
        seen.page.get_by_label("side by side").uncheck()  # as few runs stand at first
        seek(seen, 1.9)
        both = seen.shot(tmp_path / "replay_two_runs.png")[120:500]
        assert near(both, red, 40).sum() > 300 and near(both, blue, 40).sum() > 300
        seen.page.locator("#legend input").first.uncheck()
        left = seen.shot()[120:500]
        assert near(left, red, 40).sum() < 0.1 * near(both, red, 40).sum()
        assert seen.page.locator("#legend").inner_text().split() == ["one_layer", "two_layer", "reference"]
        ghosts = "replay.runs.map((run) => run.ghost.group.visible)"
        assert seen.page.evaluate(ghosts) == [True, True]  # of two with one reference the first that is shown has it
        seen.page.locator("#legend input").first.check()
        assert seen.page.evaluate(ghosts) == [True, False]
        seen.page.get_by_label("side by side").check()
        assert seen.page.evaluate(ghosts) == [True, True]
        seen.shot(tmp_path / "replay_side_by_side.png")
        assert seen.problems == []


def test_the_wanted_path_is_dashed_in_the_colour_of_the_ghost(thesis: Opened) -> None:
    """As the legend has it; the driven path is one piece, so that the two are told apart under any colours."""
    count = "replay.runs[0].layers.{}[0].geometry.index.count"
    wanted, driven = (thesis.page.evaluate(count.format(layer)) for layer in ("wanted", "paths"))
    corners = "replay.runs[0].layers.{}[0].geometry.attributes.position.count"
    all_wanted, all_driven = (thesis.page.evaluate(corners.format(layer)) for layer in ("wanted", "paths"))
    assert 0.4 < wanted / (6 * all_wanted) < 0.6 and driven == 6 * (all_driven - 4)
    ghost = "replay.runs[0].ghost.bodies.flatMap((b) => b.children).at(-1).material.color.getHexString()"
    path = "replay.runs[0].layers.wanted[0].material.color.getHexString()"
    assert thesis.page.evaluate(ghost) == thesis.page.evaluate(path)
    edge = "getComputedStyle(document.querySelector('.line.wanted')).borderTopColor"
    assert thesis.page.evaluate(edge) == "rgb(91, 91, 214)"


def test_of_many_runs_the_best_is_shown_and_others_stand_beside_it(chromium: Any, tmp_path: Path) -> None:
    robot = load("platform_arm")
    names = ("computed_torque", "pd", "pd_gravity", "pid", "two_layer")
    runs = {name: recorded(robot, name, duration=0.2) for name in names}
    file = page(runs, best="two_layer").save(tmp_path / "many.html")
    with opened(chromium, file, color_scheme="dark") as seen:
        assert seen.page.evaluate("replay.runs.map((run) => run.group.visible)") == [False, False, False, False, True]
        assert seen.page.evaluate("replay.runs.map((run) => run.color)") == [
            in_the_dark(STYLES[n].color) for n in names
        ]
        places = "replay.runs.filter((run) => run.group.visible).map((run) => run.group.position.y)"
        seen.page.get_by_label("pd", exact=True).check()
        assert seen.page.evaluate(places) == [0, 0]
        seen.page.get_by_label("side by side").check()
        first, second = seen.page.evaluate(places)
        seen.page.get_by_label("pd_gravity").check()
        assert seen.page.evaluate(places) == [first, second, 2 * second] and second < 0
        seen.page.get_by_label("pd", exact=True).uncheck()
        assert seen.page.evaluate(places) == [first, second]  # no gap where one is hidden
        assert seen.problems == []


def test_what_happens_is_coloured_while_it_lasts(chromium: Any, tmp_path: Path) -> None:
    outcome = Outcome("diverged", 1.2, "nu[0]", "nu[0] left its bounds (21) at t = 1.2 s")
    lost = recorded(load("platform_arm"), duration=1.2, outcome=outcome)
    file = page({"lost": lost, "kept": recorded(load("platform_arm"), "pd", lag=0.5)}).save(tmp_path / "lost.html")
    with opened(chromium, file) as seen:
        seen.page.evaluate("replay.player.pause()")
        seen.page.get_by_label("side by side").uncheck()
        red, badge = [], seen.page.locator("#event")
        for time in (1.0, 1.5):
            seek(seen, time)
            red.append(
                near(seen.shot(tmp_path / f"replay_diverged_{time}.png")[120:500], np.array([224, 48, 36]), 30).sum()
            )
            assert badge.is_visible() == (time > 1.2)
        assert red[1] > 500 > red[0]
        assert badge.inner_text() == "lost: diverged: nu[0] left its bounds (21) at t = 1.2 s"
        assert seen.page.locator("#marks .stop").count() == 1


def test_names_are_only_texts(chromium: Any, tmp_path: Path) -> None:
    bad = "</script><script>alert(1)</script><img src=x onerror=alert(2)>"
    escaped, urdf = bad.replace("<", "&lt;"), load("platform_arm").urdf
    for name in ("wheel_left_joint", "arm_1", "wheel_right"):
        assert f'"{name}"' in urdf
        urdf = urdf.replace(f'"{name}"', f'"{escaped}{name}"')
    robot = build(parse(urdf.encode(), tmp_path / "r.urdf"))

    def strain(table: np.ndarray, where: Any) -> None:
        table[:, where("motor_torque")] = 1e4

    recording = recorded(robot, bad, change=strain, robot=bad, experiment=bad)
    with opened(chromium, page({bad: recording}).save(tmp_path / "bad.html")) as seen:
        seek(seen, 1.0)
        assert f"{bad}wheel_left_joint at its limit" in seen.page.locator("#event").inner_text()
        assert seen.page.locator("#legend").inner_text().startswith(bad) and seen.page.title() == bad
        assert seen.page.locator("img").count() == 0
        assert seen.problems == [] and seen.requests == []


def test_it_works_inside_another_page(chromium: Any, tmp_path: Path) -> None:
    made = page({"two_layer": recorded(load("platform_arm"))})
    file = tmp_path / "outer.html"
    file.write_text(f"<!DOCTYPE html><meta charset=utf-8><title>outer</title><body>{made.iframe(400)}", "utf-8")
    with opened(chromium, file, ready="document.querySelector('iframe')") as seen:
        inner = seen.page.frame_locator("iframe")
        inner.locator("#time").filter(has_text="0.00 / 2.00 s").wait_for()
        assert inner.locator("#play").get_attribute("aria-label") == "Play"  # at rest until it is asked to play
        assert len(np.unique(seen.shot(tmp_path / "replay_inside.png").reshape(-1, 3), axis=0)) > 200  # blank: 1
        assert seen.problems == [] and [url for url in seen.requests if not url.startswith("about:")] == []


def test_a_phone_shows_all_controls(chromium: Any, tmp_path: Path) -> None:
    file = page({"two_layer": recorded(load("platform_arm"))}).save(tmp_path / "page.html")
    with opened(chromium, file, viewport={"width": 375, "height": 700}, color_scheme="dark") as seen:
        seen.page.evaluate("replay.player.pause()")
        seen.shot(tmp_path / "replay_phone_dark.png")
        for box in (c.bounding_box() for c in seen.page.locator("#controls input, #controls button").all()):
            assert box["x"] >= 0 and box["x"] + box["width"] <= 375 and box["y"] + box["height"] <= 700
        assert seen.page.evaluate("document.documentElement.scrollWidth") == 375
        place = "label.getWorldPosition(label.position.clone()).project(replay.stage.viewer.camera)"
        shown = f"replay.stage.labels.filter((label) => label.visible).map((label) => {place})"
        at = np.array([(p["x"] * 375 / 2, p["y"] * 700 / 2) for p in seen.page.evaluate(shown)])
        far = np.abs(at[:, None] - at)[~np.eye(len(at), dtype=bool)]  # [pixels]
        assert len(at) >= 2 and ((far[:, 0] > 40) | (far[:, 1] > 16)).all(), "numbers of the floor do not cover another"
