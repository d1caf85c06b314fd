"""What is said about a robot reaches `mmnn run`, and a recording builds its robot again."""

from __future__ import annotations

import gzip
import json
from pathlib import Path

import msgspec
import numpy as np
import pytest
from builders import THESIS
from drives import Drive
from numba import config
from test_base import four

from mmnn_pin.cli import main
from mmnn_pin.errors import ConfigError, RecordingError
from mmnn_pin.lab.experiments.experiment import Experiment
from mmnn_pin.lab.experiments.runner import run_experiment
from mmnn_pin.loop.loop import Loop
from mmnn_pin.model.base.overrides import Overrides
from mmnn_pin.model.checks.second_answers import WorldFrame
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.model.loading import load
from mmnn_pin.model.robot import Robot
from mmnn_pin.recording.recorder import Recorder
from mmnn_pin.recording.recording import Outcome, Recording, recorded_position, recorded_robot
from mmnn_pin.reference import Hold, Line, Trajectory
from mmnn_pin.safety import Safety
from mmnn_pin.settings import Timing
from mmnn_pin.signals import Layout
from mmnn_pin.torque.controller import Feedback
from mmnn_pin.torque.model_based import PD, ComputedTorque
from mmnn_pin.torque.neural import Neural
from mmnn_pin.torque.two_layer import TwoLayer

LENGTH = 0.004 if config.DISABLE_JIT else 0.05
SHORT = ["--controller", "pd", "--set", f"time.duration={LENGTH}"]


@pytest.fixture
def place(tmp_path, monkeypatch) -> Path:
    """A folder with a URDF whose base is undecided, where the test runs."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "r.urdf").write_text(four())
    return tmp_path


def track(*arguments: str, out: str = "out") -> tuple[int, Path]:
    return main(["run", "track", "--robot", "r.urdf", "--out", out, *SHORT, *arguments]), Path(out) / "pd.h5"


# -- said on the command line -----------------------------------------------------------------------------------------


def test_run_takes_what_is_said_about_the_robot(place, capsys):
    assert track()[0] == 2
    said = ["--wheels", "fl,fr", "--radius", "0.11", "--track", "0.7", "--lock", "elbow=0.5"]
    code, file = track(*said)
    assert code == 0
    recording = Recording.open(file)
    assert recording.meta["velocity_names"] == ("v", "w", "shoulder")
    assert recording.meta["overrides"] == {"wheels": ["fl", "fr"], "radius": 0.11, "track": 0.7, "lock": ["elbow=0.5"]}
    np.testing.assert_array_equal(recording["position"][:, recording.meta["position_names"].index("elbow")], 0.5)


def test_every_option_of_inspect_is_one_of_run(capsys):
    helps = {}
    for command in ("inspect", "model", "check", "run"):
        assert main([command, "--help"]) == 0
        helps[command] = capsys.readouterr().out
    for name in Overrides.__struct_fields__:
        option = "--" + name.replace("_", "-").replace("package-dirs", "package-dir").replace(
            "controllers-file", "controllers"
        )
        assert [command for command, text in helps.items() if f"  {option} " not in text] == [], option


def test_the_config_of_a_recording_repeats_its_run(place, capsys):
    """Also what stood beside the URDF is in it, and the file may be gone."""
    beside = place / "r.mmnn.toml"
    beside.write_text('wheels = ["fl", "fr"]\nfree = ["all"]\n')
    _, file = track("--radius", "0.12")
    beside.unlink()
    first = Recording.open(file)
    again = run_experiment(msgspec.json.decode(first.config_text, type=Experiment), "track").recordings["pd"]
    assert again.config_text == first.config_text
    for name in first:
        np.testing.assert_array_equal(first[name], again[name], err_msg=name)


def test_another_robot_leaves_what_the_toml_says_of_its_own(place, capsys):
    (place / "mine.toml").write_text(
        'robot = "r.urdf"\n[overrides]\nwheels = ["fl", "fr"]\nlock = ["elbow"]\n'
        '[reference]\nbase = {type = "line", speed = 0.1}\narm = {type = "hold", value = 0.3}\n'
        '[feedback]\nscaling = "inertia"\nbase = 30.0\narm = 60.0\n'
    )
    assert main(["run", "mine.toml", *SHORT, "--out", "a"]) == 0
    assert Recording.open("a/pd.h5").meta["velocity_names"] == ("v", "w", "shoulder")
    (place / "other.urdf").write_text(Drive().urdf())
    assert main(["run", "mine.toml", *SHORT, "--out", "b", "--robot", "other.urdf"]) == 0
    assert Recording.open("b/pd.h5").meta["overrides"] == {}
    assert main(["run", "mine.toml", *SHORT, "--out", "c", "--radius", "0.2"]) == 0
    assert Recording.open("c/pd.h5").meta["overrides"] == {"wheels": ["fl", "fr"], "lock": ["elbow"], "radius": 0.2}


@pytest.mark.parametrize(("said", "words"), [
    (["--radius", "-1"], "overrides.radius: error: -1.0 cannot be a radius"),
    (["--base", "omni"], "overrides.base: error: unknown base 'omni'"),
    (["--wheels", "fl,nope"], "unknown wheel joint 'nope'"),
    (["--set", "overrides.whels=3"], "--set overrides.whels: error: unknown key 'whels'"),
    (["--set", "overrides.radius='a'"], "overrides.radius: error: 'a' is a text: give a number"),
])  # fmt: skip
def test_what_cannot_be_is_one_line_and_nothing_is_written(place, capsys, said, words):
    code, _ = track(*said)
    err = capsys.readouterr().err
    assert code == 2 and err.count("\n") == 1 and words in err and not (place / "out").exists()


def test_package_folders_beside_the_urdf_start_from_its_folder(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "a" / "r.urdf").write_text(Drive().urdf())
    (tmp_path / "a" / "r.mmnn.toml").write_text('package_dirs = ["../elsewhere"]\nstrict = true\n')
    said = load(tmp_path / "a" / "r.urdf").overrides
    assert said.strict and [Path(folder).resolve() for folder in said.package_dirs] == [tmp_path / "elsewhere"]


# -- a recording's robot ----------------------------------------------------------------------------------------------


def heavy(place: Path) -> Robot:
    robot = load(place / "r.urdf", wheels=("fl", "fr"), lock=("elbow=0.4",))
    return robot.with_masses({"root": 1.5, "shoulder": 0.7}).with_masses({"root": 2.0}).with_friction([3.0, 2.0, 0.1])


def recorded(robot: Robot, file: Path | None = None, **more) -> Recording:
    trajectory = Trajectory(Line(0.1), (Hold(0.0),))
    return Loop(robot, trajectory, timing=Timing(duration=0.01), check_gains=False, **more).run(file)


@pytest.mark.parametrize("kept", ["file", "memory"])
def test_a_recording_builds_its_robot_again(place, kept):
    robot = heavy(place)
    again = recorded_robot(recorded(robot, place / "run.h5" if kept == "file" else None, controller=PD(THESIS)))
    assert dict(again.masses) == {"root": 3.0, "shoulder": 0.7}
    np.testing.assert_array_equal(again.viscous, robot.viscous)
    np.testing.assert_array_equal(again.T, robot.T)
    position = np.random.default_rng(0).uniform(-1, 1, robot.dimensions.full)
    M, plain = (Dynamics(r).mass_matrix(position) for r in (again, load(place / "r.urdf", wheels=("fl", "fr"),
                                                                       lock=("elbow=0.4",))))  # fmt: skip
    np.testing.assert_array_equal(M, Dynamics(robot).mass_matrix(position))
    assert M[0, 0] > 1.5 * plain[0, 0]


def test_it_tells_what_a_controller_believed(place):
    robot = heavy(place)
    meta = recorded(robot, controller=ComputedTorque(THESIS), nominal=robot.with_masses(0.5)).meta
    assert meta["nominal"]["mass_factors"]["root"] == 1.5 and meta["mass_factors"]["root"] == 3.0


def test_facts_that_are_missing_or_of_another_robot_are_told(place):
    run = recorded(heavy(place), controller=PD(THESIS))
    run.meta["overrides"] = {"wheels": ["fl", "fr"]}
    with pytest.raises(RecordingError, match="another robot"):
        recorded_robot(run)
    del run.meta["mass_factors"]
    with pytest.raises(RecordingError, match="does not tell 'mass_factors'"):
        recorded_robot(run)


@pytest.mark.parametrize("factors", [{"root": 2.0}, {"elbow": 5.0, "fl": 3.0}, 0.3])
def test_the_world_frame_has_the_factors_too(factors):
    """Two routes to the reduced mass matrix of a robot with other masses."""
    robot = load("platform_arm")
    names = {"elbow": "arm_2_joint", "fl": "wheel_left_joint"}
    table = {names.get(k, k): v for k, v in factors.items()} if isinstance(factors, dict) else factors
    changed = robot.with_masses(table)
    position = np.random.default_rng(1).uniform(-1, 1, robot.dimensions.full)
    world = WorldFrame(changed)
    M = world.reduced_mass_matrix(world.coordinates(position))
    np.testing.assert_allclose(M, Dynamics(changed).mass_matrix(position), rtol=1e-10, atol=1e-12)
    assert abs(M / Dynamics(robot).mass_matrix(position) - 1).max() > 0.1


def test_json_of_inspect_tells_what_beside_file_says_of_a_refused_robot(place, capsys):
    (place / "r.mmnn.toml").write_text("radius = 0.2\n")
    assert main(["inspect", "r.urdf", "--json"]) == 2
    codes = [finding["code"] for finding in json.loads(capsys.readouterr().out)["findings"]]
    assert codes == ["overrides", "base-undecided"]


def test_a_recording_of_the_first_version_opens_and_its_run_goes_on(tmp_path):
    old = tmp_path / "old.h5"
    old.write_bytes(gzip.decompress((Path(__file__).parent / "data/before_0_2.h5.gz").read_bytes()))
    run = Recording.open(old)
    assert run.complete and run.outcome.status == "completed" and len(run) == 10
    assert set(run.final) == {"position", "nu", "memory", "rig_memory"}  # as they were called then
    robot, gains = recorded_robot(run), Feedback(500.0, 8.0)
    controller = Neural(TwoLayer(hidden=3), gains)
    reference, timing = Trajectory(Line(0.3), (Hold(0.1), Hold(0.2))), Timing(duration=0.04)
    loop = Loop(robot, reference, controller, timing=timing, safety=Safety(), engine="ordinary", seed=7)
    state = loop.state_from()
    state.values[:] = run.final["memory"]
    plant_state = run.final["position"], run.final["nu"]
    with pytest.raises(ConfigError, match="hardware_state: error: an array that is of shape"):
        loop.run(state=state, plant_state=plant_state, hardware_state=run.final["rig_memory"], first=10)
    resumed = loop.run(state=state, plant_state=plant_state, first=10)  # supervisors remember more today
    whole = loop.run()
    np.testing.assert_allclose(resumed["torque"], whole["torque"][10:], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(run["torque"], whole["torque"][:10], rtol=1e-9, atol=1e-9)


def test_where_a_measured_base_stood_that_steers():
    """On a robot nobody knows the true position: steering, linkage and hitch are where they were measured."""
    robot = load("truck_trailer_arm")
    layout, angles = Layout.of(robot.dimensions), np.array([[0.0, 0.0, 0.0], [0.4, 0.3, -0.5]])
    table = np.zeros((2, layout.width))
    table[:, layout.where("time")], table[:, layout.where("shape")] = [[0.0], [0.1]], angles
    recorder = Recorder(layout, robot.facts(), signals=("pose", "q", "shape"))
    recorder.append_block(table)
    found = recorded_position(recorder.finish(Outcome("completed", 0.1)), robot)[:, robot.shape_index]
    right = np.arctan2(0.6, 0.6 / np.tan(0.4) + 2 * 0.17)  # both front axles meet the rear one in one place
    np.testing.assert_allclose(found, [[0.0, 0.0, 0.0], [0.4, right, -0.5]], atol=1e-12)
