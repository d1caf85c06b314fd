"""The replay's page, read by a reader of its own: robots, meshes, motion and events as recorded; and who shows it."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from replays import data_of, recorded, unpacked
from robots import fixed_arm, mobile_arm

from mmnn_pin import load
from mmnn_pin.cli import main
from mmnn_pin.errors import RecordingError
from mmnn_pin.model.robot import Robot, build
from mmnn_pin.model.robots import extra
from mmnn_pin.model.urdf import parse
from mmnn_pin.recorder import Recorder
from mmnn_pin.recording import Outcome
from mmnn_pin.show.figure import STYLES
from mmnn_pin.show.replay import page
from mmnn_pin.show.replay.events import events_of
from mmnn_pin.show.replay.meshes import STEPS, BrokenMesh, read_mesh
from mmnn_pin.show.replay.motion import frames_of, wanted
from mmnn_pin.show.replay.server import served

INERTIAL = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
ONE_JOINT = fixed_arm(1)
ROBOTS = ["platform_arm", "two_axis_arm", *(n for n in ("tiago_no_hand", "tiago_pro") if n in extra())]


def arm_with(folder: Path, *geometries: str, tag: str = "visual") -> Robot:
    """A fixed arm of one joint whose link has these shapes."""
    shapes = "".join(f"<{tag}><geometry>{geometry}</geometry></{tag}>" for geometry in geometries)
    joint = '<joint name="j" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>'
    joint += '<limit lower="-1" upper="1" effort="5" velocity="1"/></joint>'
    text = f'<robot name="r"><link name="base"/><link name="arm">{INERTIAL}{shapes}</link>{joint}</robot>'
    return build(parse(text.encode(), folder / "r.urdf"))


def mesh(name: str, scale: str = "1 1 1") -> str:
    return f'<mesh filename="{name}" scale="{scale}"/>'


def short(*arguments: object, **options: object):
    return recorded(*arguments, **{"duration": 0.1} | options)


# -- robots -----------------------------------------------------------------------------------------------------------


def placements(robot: dict, position: np.ndarray) -> list[np.ndarray]:
    """(4, 4) of every body of a page's robot, from what the page is told."""
    x, y, psi, floor = robot["frame"]
    pose = position[:3] if robot["mobile"] else np.zeros(3)
    control = pin.SE3(turn(2, psi), np.array([x, y, floor]))
    found = [pin.SE3(turn(2, pose[2]), np.array([*pose[:2], 0.0])) * control.inverse()]
    for body in robot["bodies"][1:]:
        origin, axis, q = np.reshape(body["origin"], (4, 4)).T, np.array(body["axis"]), position[body["column"]]
        slides = body["kind"] == "prismatic"
        moved = pin.SE3(np.eye(3), q * axis) if slides else pin.SE3(pin.exp3(q * axis), np.zeros(3))
        found.append(found[body["parent"]] * pin.SE3(origin) * moved)
    return [placement.homogeneous for placement in found]


def turn(axis: int, angle: float) -> np.ndarray:
    return pin.exp3(angle * np.eye(3)[axis])


@pytest.mark.parametrize("robot", [*ROBOTS, mobile_arm(), fixed_arm()], ids=[*ROBOTS, "mobile", "fixed"])
def test_bodies_and_tips_are_where_pinocchio_has_them(robot: str | Robot) -> None:
    robot = load(robot) if isinstance(robot, str) else robot
    recording = short(robot)
    shown = data_of(page({"run": recording}).html)["robots"][0]
    model, data, position = robot.model, robot.model.createData(), recording["position"][-1]
    pin.framesForwardKinematics(model, data, robot.configuration(position))
    up = np.zeros((4, 4))
    up[2, 3] = robot.base.floor
    found = placements(shown, position)
    for body, placement in zip(shown["bodies"][1:], found[1:], strict=True):
        joint = model.getJointId(robot.position_names[body["column"]])
        np.testing.assert_allclose(placement, data.oMi[joint].homogeneous - up, atol=1e-8)
    frames = [data.oMf[i].translation - up[:3, 3] for i in range(model.nframes)]
    for tip in shown["tips"]:
        point = (found[tip["body"]] @ [*tip["point"], 1])[:3]
        assert min(np.linalg.norm(frame - point) for frame in frames) < 1e-8


def test_the_tip_is_the_end_of_the_arm() -> None:
    (tip,) = data_of(page({"run": short(load("platform_arm"))}).html)["robots"][0]["tips"]
    assert tip["point"][0] > 0.1  # the frame at the end, not the last joint


def test_a_robot_and_its_shapes_are_there_once_whatever_the_number_of_runs(tmp_path: Path) -> None:
    trimesh.creation.icosphere().export(tmp_path / "ball.stl")
    robot = arm_with(
        tmp_path, mesh("ball.stl"), mesh("ball.stl", "2 2 2"), '<box size="1 2 3"/>', '<box size="1 2 3"/>'
    )
    data = data_of(page({name: short(robot, name) for name in ("pd", "two_layer")}).html)
    assert len(data["robots"]) == 1 and [run["robot"] for run in data["runs"]] == [0, 0]
    assert [shape["kind"] for shape in data["geometries"]] == ["mesh", "box"]
    assert [visual["geometry"] for visual in data["robots"][0]["visuals"]] == [0, 0, 1, 1]
    scales = [np.diag(np.reshape(visual["place"], (4, 4)))[:3] for visual in data["robots"][0]["visuals"][:2]]
    np.testing.assert_allclose(scales, [[1, 1, 1], [2, 2, 2]])


def test_colours_are_those_of_the_urdf_and_of_the_plots(tmp_path: Path) -> None:
    text = arm_with(tmp_path, '<box size="1 1 1"/>').urdf
    text = text.replace("</geometry>", '</geometry><material name="red"/>')
    text = text.replace(
        '<link name="base"/>', '<material name="red"><color rgba="1 0 0 0.5"/></material><link name="base"/>'
    )
    data = data_of(page({"one": short(build(parse(text.encode(), tmp_path / "r.urdf")), "one_layer")}).html)
    assert data["robots"][0]["visuals"][0]["color"] == [1, 0, 0, 0.5]
    assert data["runs"][0]["color"] == STYLES["one_layer"].color


def test_a_robot_without_visuals_shows_its_collision_shapes_and_one_without_any_boxes(tmp_path: Path) -> None:
    made = page({"run": short(arm_with(tmp_path, '<sphere radius="0.3"/>', tag="collision"))})
    assert data_of(made.html)["geometries"] == [{"kind": "sphere", "size": [0.3, 0.0]}]
    assert "collision" in made.warnings[0]
    made = page({"run": short(arm_with(tmp_path))})
    assert len(data_of(made.html)["robots"][0]["visuals"]) == 2 and "box" in made.warnings[0]


# -- meshes -----------------------------------------------------------------------------------------------------------


def corners(data: dict, geometry: int = 0) -> np.ndarray:
    """(m, 3, 3) corners of the triangles of a page's mesh."""
    shape = data["geometries"][geometry]
    return (shape["points"].reshape(-1, 3) * shape["step"] + shape["corner"])[shape["triangles"].reshape(-1, 3)]


@pytest.mark.parametrize("suffix", ["stl", "obj", "dae", "ply"])
def test_meshes_are_shown_within_a_step_of_the_grid(tmp_path: Path, suffix: str) -> None:
    solid = trimesh.creation.torus(0.7, 0.2)
    solid.export(tmp_path / f"solid.{suffix}")
    shown = corners(data_of(page({"run": short(arm_with(tmp_path, mesh(f"solid.{suffix}")))}).html))
    assert np.abs(np.sort(shown, axis=None) - np.sort(solid.triangles, axis=None)).max() < 2 / STEPS
    assert len(shown) == len(solid.faces)


def test_doubles_are_merged_and_flat_triangles_left_out(tmp_path: Path) -> None:
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 0], [0, 1, 0], [-1, 0, 0], [0, 0, 0]], float)
    trimesh.Trimesh(points, [[0, 1, 2], [3, 4, 5], [0, 3, 6]], process=False).export(tmp_path / "m.ply")
    (part,) = read_mesh(tmp_path / "m.ply")
    assert part.grid.shape == (4, 3) and len(part.triangles) == 2


def test_collada_units_and_colours_count(tmp_path: Path) -> None:
    solid = trimesh.creation.box((1.0, 2.0, 3.0))
    solid.visual = trimesh.visual.TextureVisuals(
        material=trimesh.visual.material.PBRMaterial(baseColorFactor=[51, 102, 255, 255])
    )
    text = solid.export(file_type="dae").decode()
    assert "<unit" not in text
    text = text.replace("<up_axis>", '<unit name="centimeter" meter="0.01"/><up_axis>')
    (tmp_path / "box.dae").write_text(text)
    data = data_of(page({"run": short(arm_with(tmp_path, mesh("box.dae")))}).html)
    np.testing.assert_allclose(np.ptp(corners(data).reshape(-1, 3), axis=0), [0.01, 0.02, 0.03], rtol=1e-6)
    np.testing.assert_allclose(data["robots"][0]["visuals"][0]["color"], [0.2, 0.4, 1.0, 1.0], atol=0.01)


BROKEN = {
    "missing.stl": None,
    "empty.stl": b"",
    "text.stl": b"no mesh at all",
    "short.stl": trimesh.creation.box().export(file_type="stl")[:300],
    "words.dae": b"<COLLADA>",
    "nothing.obj": b"# only words\n",
    "nan.obj": b"v 0 0 0\nv 1 0 nan\nv 0 1 0\nf 1 2 3\n",
    "index.obj": b"v 0 0 0\nf 1 2 9\n",
    "http://example.org/far.stl": None,
    "/etc/passwd": None,
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_mesh_that_cannot_be_shown_is_a_box_with_a_warning(tmp_path: Path, name: str) -> None:
    if BROKEN[name] is not None:
        (tmp_path / name).write_bytes(BROKEN[name])
    made = page({"run": short(arm_with(tmp_path, mesh(name), '<sphere radius="1"/>'))})
    data = data_of(made.html)
    assert [shape["kind"] for shape in data["geometries"]] == ["box", "sphere"]
    assert len(made.warnings) == 1 and name in made.warnings[0] and data["warnings"] == list(made.warnings)


def test_meshes_of_a_package_are_found_where_they_are_said_to_be(tmp_path: Path) -> None:
    (tmp_path / "elsewhere/pack").mkdir(parents=True)
    (tmp_path / "here").mkdir()
    trimesh.creation.box().export(tmp_path / "elsewhere/pack/m.stl")
    recording = short(arm_with(tmp_path / "here", mesh("package://pack/m.stl"), mesh("package://pack/other.stl")))
    (warning,) = page({"run": recording}).warnings
    assert "package://pack/m.stl" in warning and "1 more" in warning and "--package-dir" in warning
    (warning,) = page({"run": recording}, package_dirs=[tmp_path / "elsewhere"]).warnings
    assert "package://pack/other.stl" in warning and "more" not in warning


def test_a_broken_mesh_says_why(tmp_path: Path) -> None:
    (tmp_path / "m.obj").write_bytes(BROKEN["nan.obj"])
    with pytest.raises(BrokenMesh, match="finite"):
        read_mesh(tmp_path / "m.obj")


# -- motion -----------------------------------------------------------------------------------------------------------


@settings(deadline=None, max_examples=30)
@given(st.floats(0.05, 1.0), st.sampled_from([0.001, 0.007, 0.05, 0.4]), st.floats(0.5, 200.0))
def test_frames_are_those_nearest_to_the_display_s_times(duration: float, period: float, fps: float) -> None:
    recording = recorded(ONE_JOINT, duration=max(duration, period), period=period)
    rows, times = frames_of(recording, fps), recording.time
    assert rows[0] == 0 and rows[-1] == len(times) - 1 and (np.diff(rows) > 0).all()
    for wish in np.arange(0, times[-1], 1 / fps):
        assert np.abs(times[rows] - wish).min() <= np.abs(times - wish).min() + 1e-12
    assert len(rows) <= np.ceil(times[-1] * fps) + 2


def test_rows_that_are_not_finite_are_left_out() -> None:
    def lose(table: np.ndarray, where: object) -> None:
        table[-5:, where("position")] *= np.array([1e9, 1e100, 1e300, np.inf, np.nan])[:, None]

    lost = recorded(load("platform_arm"), change=lose, outcome=Outcome("diverged", 2.0, "nu[0]"))
    made = page({"run": lost})
    assert np.isfinite(data_of(made.html)["runs"][0]["position"]).all()
    assert frames_of(lost, 60.0)[-1] == len(lost) - 6


def test_nothing_to_show_is_refused() -> None:
    def lose(table: np.ndarray, where: object) -> None:
        table[:, where("position")] = np.nan

    robot = load("platform_arm")
    with pytest.raises(RecordingError, match="no position in it is finite"):
        page({"run": short(robot, change=lose)})
    with pytest.raises(RecordingError, match="before its first sample"):
        page({"run": Recorder(robot.layout, robot.facts()).finish(Outcome("interrupted", 0.0))})
    with pytest.raises(RecordingError, match="no recording"):
        page({})


def test_positions_and_times_are_those_recorded() -> None:
    recording = recorded(load("platform_arm"))
    made = page({"run": recording}, fps=25.0)
    (run,) = data_of(made.html)["runs"]
    rows = frames_of(recording, 25.0)
    assert made.frames == len(rows) == run["frames"] == 51 and made.samples == len(recording)
    np.testing.assert_allclose(run["position"].reshape(len(rows), -1), recording["position"][rows], atol=1e-6)
    np.testing.assert_allclose(run["time"], recording.time[rows], atol=1e-6)


def test_the_ghost_is_where_the_reference_asks_and_mimic_joints_follow() -> None:
    robot = load("platform_arm")
    recording = recorded(robot, lag=0.5)
    rows = np.array([0, 400, 999])
    table = wanted(recording, robot, rows)
    np.testing.assert_array_equal(table[:, :3], recording["pose_ref"][rows])
    np.testing.assert_array_equal(table[:, robot.arm_index], recording["q_ref"][rows])
    wheel = robot.position_names.index("wheel_left_joint")
    np.testing.assert_array_equal(table[:, wheel], recording["position"][rows, wheel])
    twin = (
        '<joint name="twin" type="revolute"><parent link="arm"/><child link="claw"/><mimic joint="j" multiplier="-2" '
    )
    twin += 'offset="0.1"/><limit lower="-9" upper="9" effort="1" velocity="1"/></joint>'
    urdf = arm_with(Path()).urdf.replace("</robot>", f'<link name="claw">{INERTIAL}</link>{twin}</robot>')
    robot = build(parse(urdf.encode(), "r.urdf"))
    table = wanted(short(robot), robot, np.array([10, 20]))
    master, slave = (robot.position_names.index(name) for name in ("j", "twin"))
    np.testing.assert_allclose(table[:, slave], 0.1 - 2 * table[:, master])


# -- events -----------------------------------------------------------------------------------------------------------


def test_an_early_end_is_an_event_to_the_end() -> None:
    (event,) = events_of(short(load("platform_arm"), outcome=Outcome("tripped", 0.06, "nu[0]", "too fast")))
    assert (event.kind, event.start, event.end, event.text) == ("stop", 0.06, np.inf, "tripped: too fast")
    assert events_of(short(load("platform_arm"))) == []


def test_motors_at_their_limits_are_events_while_it_lasts() -> None:
    robot = load("platform_arm")
    left, limit = robot.actuator_names.index("wheel_left_joint"), robot.effort_limits[0]

    def strain(table: np.ndarray, where: object) -> None:
        torque = table[:, where("motor_torque")]
        torque[100:201, left], torque[210:221, left], torque[600:, left] = -limit, 2 * limit, limit
        torque[300:400, left] = 0.99 * limit

    recording = recorded(robot, change=strain)
    found = [(event.start, event.end) for event in events_of(recording)]
    np.testing.assert_allclose(found, [(0.2, 0.44), (1.2, 1.998)])  # the short pause in the first is too short to see
    made = data_of(page({"run": recording}).html)
    (body,) = made["runs"][0]["events"][0]["bodies"]
    assert made["robots"][0]["bodies"][body]["column"] == robot.position_names.index("wheel_left_joint")


def test_wheels_that_slip_are_events() -> None:
    def slide(table: np.ndarray, where: object) -> None:
        table[250:351, where("slip")] = [0.0, 0.5]
        table[:100, where("slip")] = 0.002  # creep

    (event,) = events_of(recorded(load("platform_arm"), wheels=2, change=slide))
    assert (event.kind, event.joints, event.text) == ("slip", ("wheel_right_joint",), "wheel_right_joint slips")
    assert (event.start, event.end) == pytest.approx((0.5, 0.7))


# -- the page ---------------------------------------------------------------------------------------------------------


class Elements(HTMLParser):
    """All elements of a page, and whatever names another file."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.links: list[str] = []
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.links += [str(value) for name, value in attrs if name in ("src", "href", "srcset", "action")]


def test_the_page_needs_nothing_else_and_forbids_asking_for_it() -> None:
    html = page({"run": short(load("platform_arm"))}).html
    assert Elements(html).links == [] and "@import" not in html and "url(" not in html
    assert "default-src 'none'" in html
    assert unpacked(html, "viewer").startswith(b"/*\nMIT License")


def test_names_do_not_become_elements() -> None:
    bad = "</title></script><script>alert(1)</script><img src=x>"
    plain = Elements(page({"run": short(load("platform_arm"))}).html).tags
    recording = short(load("platform_arm"), bad, outcome=Outcome("diverged", 0.1, bad, bad), robot=bad)
    made = page({bad: recording}, title=bad)
    assert Elements(made.html).tags == plain
    assert data_of(made.html)["runs"][0]["name"] == bad
    assert Elements(made.iframe()).tags == ["iframe"]


def test_a_large_page_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.modules[page.__module__], "LARGE", 1000)
    assert "the page is large" in page({"run": short(load("platform_arm"))}).warnings[-1]


def test_the_pages_stay_small(tmp_path: Path) -> None:
    assert page({"run": recorded(load("platform_arm"), duration=5.0)}).size < 2e6
    if "tiago" in extra():
        assert page({"run": recorded(load("tiago"), duration=5.0)}).size < 12e6


@pytest.mark.skipif(os.environ.get("NUMBA_DISABLE_JIT") == "1", reason="slow in plain Python")
def test_the_benchmark_measures() -> None:
    script = Path(__file__).parents[1] / "benchmarks/replay.py"
    command = [sys.executable, script, "platform_arm", "--duration", "0.2", "--json"]
    (figures,) = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    assert 0.2 < figures["size [MB]"] < 2 and 0 < figures["written in [s]"] < 30 and figures["frames"] == 13
    assert figures["shown in [s]"] is None or 0 < figures["shown in [s]"] < 60


# -- the server and the command line ----------------------------------------------------------------------------------


def is_open(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def is_alive(process: int) -> bool:
    """Whether a process runs; one that waits to be reaped does not."""
    state = subprocess.run(["ps", "-o", "state=", "-p", str(process)], capture_output=True, text=True).stdout
    return bool(state.strip()) and not state.startswith("Z")


def test_a_busy_port_moves_to_the_next_and_all_are_closed_after() -> None:
    with served("<p>one", 0) as first:
        port = int(first.rpartition(":")[2].strip("/"))
        with served("<p>two", port) as second:
            assert second != first
            assert [urllib.request.urlopen(url).read() for url in (first, second)] == [b"<p>one", b"<p>two"]
            with pytest.raises(urllib.error.HTTPError, match="404"):
                urllib.request.urlopen(first + "../../etc/passwd")
    assert not is_open(port)


@pytest.fixture(scope="module")
def run_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording on disk."""
    file, recording = tmp_path_factory.mktemp("runs") / "pd.h5", short(load("platform_arm"), "pd")
    recorder = Recorder(load("platform_arm").layout, recording.meta | {"urdf": recording.urdf}, file)
    recorder.append_block(np.hstack([recording[name].reshape(len(recording), -1) for name in recording]))
    recorder.finish(Outcome("completed", 0.1))
    return file


def serving(*prefix: str, run_file: Path) -> tuple[subprocess.Popen, int, int]:
    """A replay that serves: the process started, the replay's own id, its port."""
    command = [sys.executable, "-c", "import os, mmnn_pin.cli as c; print(os.getpid(), flush=True); c.main()"]
    command += ["replay", str(run_file), "--no-browser", "--json", "--port", "0"]
    process = subprocess.Popen([*prefix, *command], stdout=subprocess.PIPE, text=True)
    own, told = int(process.stdout.readline()), json.loads(process.stdout.readline())
    return process, own, int(told["url"].rpartition(":")[2].strip("/"))


def test_ctrl_c_ends_the_server(run_file: Path) -> None:
    process, own, port = serving(run_file=run_file)
    assert process.pid == own and is_open(port)
    process.send_signal(signal.SIGINT)
    assert process.wait(10) == 0
    assert not is_open(port)


def test_the_server_ends_with_a_killed_parent(run_file: Path) -> None:
    starter = "import subprocess, sys; subprocess.run(sys.argv[1:])"
    process, own, port = serving(sys.executable, "-c", starter, run_file=run_file)
    assert process.pid != own and is_open(port)
    process.kill()
    process.wait()
    until = time.monotonic() + 10
    while (is_open(port) or is_alive(own)) and time.monotonic() < until:
        time.sleep(0.05)
    assert not is_open(port) and not is_alive(own)


def test_html_is_written_once_and_its_size_told(run_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    out = tmp_path / "new" / "run.html"
    assert main(["replay", str(run_file), "--html", str(out), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["bytes"] == out.stat().st_size and (told["frames"], told["samples"]) == (7, 50)
    assert told["html"] == str(out) and told["warnings"] == []
    before = out.read_bytes()
    assert main(["replay", str(run_file), "--html", str(out)]) == 2
    assert "--force" in capsys.readouterr().err and out.read_bytes() == before
    assert main(["replay", str(run_file), "--html", str(out), "--force", "--fps", "500"]) == 0
    assert "50 frames of 50 samples" in capsys.readouterr().out
    assert sorted(os.listdir(out.parent)) == ["run.html"]


def test_a_page_that_cannot_be_written_is_told(run_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    (tmp_path / "file").write_text("")
    assert main(["replay", str(run_file), "--html", str(tmp_path / "file" / "x.html")]) == 2
    assert "cannot write the replay" in capsys.readouterr().err
