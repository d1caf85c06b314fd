"""A robot as it was understood: roles, places and colours of its parts, in meshcat and in a picture."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import yourdfpy
from browser import browser
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.colors import to_rgb
from replays import recorded

from mmnn_pin import load
from mmnn_pin.cli import main
from mmnn_pin.errors import ConfigError
from mmnn_pin.lab.show import solids as parts
from mmnn_pin.lab.show.picture import rendered
from mmnn_pin.lab.show.solids import placements, roles_of, solids_of, triangles_of
from mmnn_pin.lab.show.view.view import CELL, CELLS, Playback, floor, geometry_of


@pytest.fixture(scope="module")
def tiago():
    return load("tiago")


@pytest.fixture(scope="module")
def shown():
    with load("platform_arm").view(port=0) as made:
        yield made


def asked(shown, wish, **headers):
    """What the page's server answers to a wish."""
    data = wish if isinstance(wish, bytes) else json.dumps(wish).encode()
    about = {"Content-Type": "application/json"} | headers
    with urllib.request.urlopen(urllib.request.Request(shown.url, data, about), timeout=20) as answer:
        return json.loads(answer.read())


def refused(shown, wish, **headers):
    with pytest.raises(urllib.error.HTTPError) as error:
        asked(shown, wish, **headers)
    return error.value.code


# -- roles and places ----------------------------------------------------------------------------------------------


def test_every_joint_has_the_role_that_inspect_tells(tiago):
    roles = roles_of(tiago)
    assert set(roles) == set(tiago.position_names[3:])
    assert roles["wheel_left_joint"] is parts.LEFT and roles["wheel_right_joint"] is parts.RIGHT
    assert roles["head_1_joint"] is parts.HEAD and roles["hand_thumb_flex_1_joint"] is parts.JAW
    assert {name for name, role in roles.items() if role is parts.ARM} == set(tiago.joint_names)
    panda = roles_of(load("panda"))
    assert panda["panda_finger_joint1"] is panda["panda_finger_joint2"] is parts.JAW  # the second follows the first
    held = load("tiago", lock=["arm_7_joint=0.3"])
    assert roles_of(held)["arm_7_joint"] is parts.LOCKED


def test_steered_bases_have_steering_casters_and_wheels_with_and_without_motors():
    roles = roles_of(load("truck_trailer_arm"))
    assert roles["front_left_steering_joint"] is parts.STEERING and roles["hitch_joint"] is parts.CASTER
    assert roles["rear_left_wheel_joint"] is parts.DRIVEN and roles["trailer_left_wheel_joint"] is parts.ROLLING


@pytest.mark.parametrize("name", ["tiago", "car_arm"])
def test_shapes_stand_where_yourdfpy_has_their_links(name):
    robot = load(name)
    q = robot.random(3)
    q[:3] = 0.0
    position = robot.position(q)
    model = yourdfpy.URDF.load(str(robot.path), load_meshes=False, build_scene_graph=True)
    moves = dict(zip(robot.position_names[3:], position[3:], strict=True))
    model.update_cfg([moves[joint] for joint in model.actuated_joint_names])
    found, _ = solids_of(robot)
    root = model.base_link
    [first] = [at @ np.linalg.inv(s.place) for s, at in zip(found, placements(robot, position, found), strict=True)
               if s.frame == root][:1] or [None]  # fmt: skip
    if first is None:
        data = robot.model.createData()
        pin.framesForwardKinematics(robot.model, data, robot.configuration(position))
        first = data.oMf[robot.model.getFrameId(root)].homogeneous
    for solid, at in zip(found, placements(robot, position, found), strict=True):
        assert at == pytest.approx(first @ model.get_transform(solid.frame, root) @ solid.place, abs=1e-9)


def test_pinocchio_draws_the_same_places(tiago):
    position = tiago.position(tiago.random(5))
    found, _ = solids_of(tiago)
    geometry = geometry_of(tiago, found)
    data, placed = tiago.model.createData(), geometry.createData()
    pin.updateGeometryPlacements(tiago.model, data, geometry, placed, tiago.configuration(position))
    for at, where in zip(placements(tiago, position, found), placed.oMg, strict=True):
        assert where.homogeneous == pytest.approx(at, abs=1e-6)


# -- the picture ---------------------------------------------------------------------------------------------------


@given(st.floats(0.2, 3.0), st.integers(100, 300))
@settings(max_examples=10, deadline=None)
def test_a_disc_covers_its_area_and_the_nearest_is_seen(radius, pixels):
    angles = np.linspace(0, 2 * np.pi, 65)
    rim = np.column_stack((np.cos(angles), np.sin(angles), np.zeros(65))) * radius
    disc = np.stack((np.zeros((64, 3)), rim[:-1], rim[1:]), axis=1)
    over = disc * [0.5, 0.5, 1.0] + [0.0, 0.0, 1.0]
    colors = np.repeat([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], 64, axis=0)
    spacing = 2 * radius / pixels
    image, extent = rendered(np.concatenate((disc, over)), colors, np.eye(3), spacing)
    cell = (2 * spacing) ** 2
    rim = 2 * np.pi * radius * spacing  # what a pixel more around it covers
    assert image[..., 3].sum() * cell == pytest.approx(np.pi * radius**2, abs=rim)
    assert (image[..., 3] * image[..., 1]).sum() * cell == pytest.approx(np.pi * radius**2 / 4, abs=rim)
    assert extent[0] == pytest.approx(-radius) and extent[3] == pytest.approx(radius, abs=4 * spacing)


def test_the_floor_is_drawn_cell_by_cell():
    """Every edge of every cell once: no line is so long that it goes on behind the eye."""
    points = np.asarray(floor().geometry.position).T / CELL
    edges = {tuple(map(int, edge)) for edge in points.reshape(-1, 6).round()}
    steps = [np.subtract(edge[3:], edge[:3]).tolist() for edge in edges]
    assert len(edges) == 4 * CELLS * (2 * CELLS + 1) == len(points) / 2
    assert {tuple(step) for step in steps} == {(1, 0, 0), (0, 1, 0)} and np.abs(points).max() == CELLS


def test_inspect_writes_a_picture_in_the_colours_of_the_roles(tmp_path, capsys):
    from PIL import Image

    file = tmp_path / "robot.png"
    assert main(["inspect", "platform_arm", "--picture", str(file)]) == 0
    pixels = np.asarray(Image.open(file).convert("RGB")).reshape(-1, 3) / 255
    hues = pixels / np.maximum(pixels.max(axis=1, keepdims=True), 1e-9)
    for role in (parts.ARM, parts.LEFT):
        hue = np.array(to_rgb(role.color)) / max(to_rgb(role.color))
        assert (np.abs(hues - hue).max(axis=1) < 0.03).sum() > 200, role.name
    capsys.readouterr()
    assert main(["inspect", "platform_arm", "--picture", str(file)]) == 2
    assert "the file exists" in capsys.readouterr().err


# -- the view ------------------------------------------------------------------------------------------------------


def test_a_slider_moves_the_robot_and_what_follows_it():
    robot = load("panda", free=("panda_finger_joint1",))
    follower, slave = next(iter(robot.arm.slaves.items()))
    with robot.view(port=0) as made:
        told = asked(made, {"joints": {slave.master: 0.02, "panda_joint4": -1.0}})["joints"]
        assert told[slave.master] == 0.02 and told["panda_joint4"] == -1.0 and follower not in told
        position = dict(zip(robot.position_names, made.position, strict=True))
        assert position[follower] == pytest.approx(slave.at(0.02))
        drawn = made.viewer.visual_data.oMg
        found, _ = solids_of(robot)
        for at, where in zip(placements(robot, made.position, found), drawn, strict=True):
            assert where.homogeneous == pytest.approx(at, abs=1e-6)


def test_what_is_no_wish_is_refused_and_moves_nothing(shown):
    before = shown.position.copy()
    for wish in (b"{", b"[1]", {"joints": {"no_joint": 1.0}}, {"joints": {"arm_1_joint": float("nan")}}, {"joints": 3},
                 {"time": "x"}, b"1" * 70_000):  # fmt: skip
        assert refused(shown, wish) == 400
    assert refused(shown, {}, **{"Content-Type": "text/plain"}) == 400
    assert refused(shown, {}, Host="elsewhere.example") == 403
    assert refused(shown, {}, Origin="http://elsewhere.example") == 403
    assert (shown.position == before).all()


def test_requests_that_no_page_makes_get_nothing_and_leave_no_line(shown, capfd):
    place = ("127.0.0.1", int(shown.url.split(":")[2].split("/")[0]))
    head = b" HTTP/1.1\r\nHost: 127.0.0.1\r\n"
    odd = {
        b"GET /static/../../../../etc/passwd" + head: b"403",
        b"GET /static/..%2f..%2f..%2fetc/passwd" + head: b"403",
    }
    odd |= {b"DELETE /view" + head: b"405", b"GET /view" + head + b"A: b\r\n" * 20_000: None}
    odd |= {b"POST /view" + head + b"Content-Length: 1000000000\r\n": b"400"}
    for request, status in odd.items():
        with socket.create_connection(place, timeout=20) as line, contextlib.suppress(ConnectionError):
            line.sendall(request + b"\r\n")
            said = line.recv(100).partition(b"\r\n")[0]
            assert (status or b"HTTP/1.1 4") in said or (status is None and not said)
    assert asked(shown, {}) and capfd.readouterr() == ("", "")


def test_the_server_hears_this_machine_alone(shown):
    port = int(shown.url.split(":")[2].split("/")[0])
    lines = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()]
    listening = [words[1] for words in lines if words[3] == "0A"]
    assert f"0100007F:{port:04X}" in listening and f"00000000:{port:04X}" not in listening


def test_a_q_of_another_size_is_one_line(shown):
    with pytest.raises(ConfigError):
        shown.display([0.0])
    with pytest.raises(ConfigError):
        load("platform_arm").view([1.0], port=0)


def test_names_of_a_file_are_escaped(tmp_path):
    text = load("platform_arm").urdf.replace("arm_1_joint", "&lt;script>alert(1)&lt;/script>")
    (tmp_path / "evil.urdf").write_text(text)
    with load(tmp_path / "evil.urdf").view(port=0) as made:
        page = urllib.request.urlopen(made.url).read().decode()
    assert "<script>alert(1)" not in page and "&lt;script&gt;alert(1)" in page


def test_a_run_plays_and_can_be_sought():
    run = recorded(load("platform_arm"), duration=1.0)
    with run.view(port=0) as made:
        first = asked(made, {"playing": False})
        assert first["end"] == pytest.approx(run.time[-1]) and first["start"] == 0.0
        for now in (0.0, 0.37, 0.9):
            asked(made, {"time": now})
            k = int(np.argmin(np.abs(run.time - now)))
            near = run["q"][max(k - 40, 0) : k + 40]
            moved = made.position[made.robot.arm_index]
            assert (near.min(axis=0) - 1e-9 <= moved).all() and (moved <= near.max(axis=0) + 1e-9).all()
        asked(made, {"time": 0.0, "playing": True})
        end = time.monotonic() + 30
        while asked(made, {})["time"] == 0.0:
            assert time.monotonic() < end, "it does not play"


def test_a_playback_begins_again_after_its_end():
    shown = []
    run = Playback(np.array([0.0, 0.05, 0.1]), np.array([[0.0], [1.0], [2.0]]))
    run.start(lambda position: shown.append(float(position[0])))
    end = time.monotonic() + 30
    while not (2.0 in shown and 0.0 in shown[shown.index(2.0) :]):
        assert time.monotonic() < end
        time.sleep(0.01)
    run.stop()


@pytest.mark.parametrize("command", [["view", "platform_arm"], ["replay", "RUN", "--live"]])
def test_commands_serve_until_ctrl_c(command, tmp_path):
    if "RUN" in command:
        recorded(load("platform_arm"), duration=0.3).save(tmp_path / "run.h5")
    full = [
        sys.executable,
        "-c",
        "from mmnn_pin.cli import main; raise SystemExit(main())",
        *command,
        "--port",
        "0",
        "--no-browser",
        "--json",
    ]
    full = [str(tmp_path / "run.h5") if word == "RUN" else word for word in full]
    process = subprocess.Popen(full, stdout=subprocess.PIPE, text=True)
    try:
        url = json.loads(process.stdout.readline())["url"]
        assert b"arm_1_joint" in urllib.request.urlopen(url).read()
        process.send_signal(signal.SIGINT)
        assert process.wait(30) in (0, 130)  # 130 where it came before it waits
    finally:
        process.kill()
        process.stdout.close()


def test_live_plays_one_run_and_writes_no_page(tmp_path, capsys):
    for name in ("a", "b"):
        recorded(load("platform_arm"), duration=0.3).save(tmp_path / f"{name}.h5")
    assert main(["replay", str(tmp_path), "--live", "--no-browser"]) == 2
    assert "--live plays one run, not 2" in capsys.readouterr().err
    assert main(["replay", str(tmp_path / "a.h5"), "--live", "--html", str(tmp_path / "p.html")]) == 2
    assert "--live writes no page" in capsys.readouterr().err and not (tmp_path / "p.html").exists()


def test_a_browser_shows_the_robot_moves_it_and_hides_its_frames(shown, tmp_path):
    with browser() as driver:
        page = driver.new_page(viewport={"width": 900, "height": 600})
        problems = []
        page.on("console", lambda message: problems.append(message.text) if message.type == "error" else None)
        page.on("pageerror", lambda error: problems.append(str(error)))
        page.goto(shown.url)
        page.wait_for_function("window.view && window.view.asked > 0", timeout=60_000)

        def arm() -> int:
            from io import BytesIO

            from PIL import Image

            page.wait_for_timeout(1500)
            data = page.screenshot(clip={"x": 340, "y": 40, "width": 560, "height": 560})
            folder = os.environ.get("MMNN_SCREENSHOTS") or str(tmp_path)
            os.makedirs(folder, exist_ok=True)
            with open(os.path.join(folder, "view.png"), "wb") as file:
                file.write(data)
            return np.asarray(Image.open(BytesIO(data)).convert("RGB")).astype(int)

        before = arm()
        orange = (before[..., 0] > 150) & (before[..., 2] < 90) & (before[..., 1] > 70)
        assert orange.sum() > 500  # the arm
        page.fill('.joint input[name="arm_1_joint"]', "2.0")
        page.wait_for_function("Math.abs(window.view.joints.arm_1_joint - 2.0) < 1e-3")
        moved = arm()
        assert (np.abs(moved - before).max(axis=2) > 40).sum() > 500
        page.check("#frames")
        assert (np.abs(arm() - moved).max(axis=2) > 40).sum() > 50
        assert problems == []


def test_triangles_of_solids_are_the_sizes_that_the_file_says():
    from mmnn_pin.lab.show.files import Blob
    from mmnn_pin.lab.show.replay.shapes import Shapes

    shapes = Shapes(Blob())
    shapes.geometries += [{"kind": "box", "size": [1.0, 2.0, 3.0]}, {"kind": "cylinder", "size": [0.5, 2.0]},
                          {"kind": "sphere", "size": [0.7, 0.0]}]  # fmt: skip
    spans = [np.ptp(triangles_of(shapes, i)[0], axis=0) for i in range(3)]
    assert spans[0] == pytest.approx([1, 2, 3]) and spans[1] == pytest.approx([1, 1, 2])
    assert spans[2] == pytest.approx([1.4, 1.4, 1.4], rel=0.02)
