"""The hand as an experiment: its table, its bad input, and what is told of the true hand."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mmnn_pin import load
from mmnn_pin.errors import ConfigError, InputError, TrajectoryError
from mmnn_pin.lab.experiments.config import load_experiment
from mmnn_pin.lab.experiments.hand import HandErrors, hand_errors, hand_motion, peak_speeds
from mmnn_pin.lab.experiments.runner import run_experiment
from mmnn_pin.lab.show.comparison import tables_of
from mmnn_pin.lab.show.curves import CHARTS
from mmnn_pin.lab.show.table import terminal_text
from mmnn_pin.model.robots import bundled, extra
from mmnn_pin.recording.recording import Recording, recorded_robot
from mmnn_pin.signals import HAND

pytest.importorskip("daqp", reason="pip install 'mmnn_pin[tasks]'")
SHORT = ("time.control_period=0.01", "time.plant_step=0.01")
LINE = 'reference.hand.path=[{type="line", by=[0.2, 0.0, 0.0], speed=0.2}]'


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ("reference.hand.frame=arm_tipp", "did you mean 'arm_tip'"),
        ("reference.hand.position=-1.0", "reference.hand.position"),
        ("reference.hand.body.arm=-1.0", "reference.hand.arm"),
        ("reference.hand.limits.speed=-1.0", "limits.speed"),
        ("reference.hand.limits.joint_margin=4.0", "leaves a joint no room"),
        ("reference.hand.path=[]", "without a path"),
        ("reference.hand.priority=-1", "reference.hand.priority"),
        ('reference.hand.others=[{frame="arm_1", priority=-2}]', "reference.hand.priority: error: -2"),
        ('reference.hand.path=[{type="lin"}]', "did you mean 'line'"),
        ('reference.hand.path=[{type="circle", radius=-1.0}]', "not positive"),
        ("reference.hand.posture=[9.0, 0.0]", "its ends are"),
        ('reference.base={type="line", speed=0.1}', "a hand beside"),
        ("time.duration=2.0", "set time.duration=15"),
    ],
)
def test_bad_input_is_one_line(change: str, what: str) -> None:
    robot = load("platform_arm")
    with pytest.raises(InputError) as error:
        load_experiment("hand", [*SHORT, change]).trajectory_of(robot)
    assert what in str(error.value) and "\n" not in str(error.value)


def test_priorities_of_a_file_reach_the_program() -> None:
    others = 'reference.hand.others=[{frame="arm_1", orientation=0.0, priority=1}]'
    tables = load_experiment("hand", [*SHORT, others]).reference.hand
    assert tables is not None and tables.body_of(load("platform_arm"), 0.01).levels == [[0], [1]]
    first = load_experiment("hand", [*SHORT, others, "reference.hand.priority=2"]).reference.hand
    assert first is not None and first.body_of(load("platform_arm"), 0.01).levels == [[1], [0]]


def test_a_robot_without_an_arm_has_no_hand() -> None:
    robot = load("platform_arm", lock=["arm_1_joint", "arm_2_joint"])
    with pytest.raises(ConfigError, match="has no arm"):
        load_experiment("hand", SHORT).trajectory_of(robot)


def test_a_path_too_far_says_where_and_the_fix_works() -> None:
    robot, far = load("two_axis_arm"), [*SHORT, LINE, "reference.hand.scale=3.0", "time.duration=4.0"]
    with pytest.raises(TrajectoryError, match=r"mm from \(.*\) at t = .*tolerance|cannot follow"):
        load_experiment("hand", far).trajectory_of(robot)
    load_experiment("hand", [*far, "reference.hand.tolerance=1.0"]).trajectory_of(robot)


def test_a_size_that_can_be_followed_is_told_and_works() -> None:
    robot = load("two_axis_arm")
    long = [*SHORT, 'reference.hand.path=[{type="line", by=[8.0, 0.0, 0.0], speed=2.0}]', "time.duration=6.0"]
    with pytest.raises(TrajectoryError, match="cannot follow") as refused:
        load_experiment("hand", long).trajectory_of(robot)
    fix = re.search(r"--set (reference.hand.scale=[0-9.]+) draws it smaller", str(refused.value))
    assert fix is not None
    load_experiment("hand", [*long, fix[1]]).trajectory_of(robot)


def test_the_motion_is_made_once_for_a_robot_and_fits_its_table() -> None:
    experiment, robot = load_experiment("hand", [*SHORT, LINE, "time.duration=3.0"]), load("platform_arm")
    assert experiment.reference.hand is not None
    one = hand_motion(experiment.reference.hand, robot, experiment.time)
    assert one is hand_motion(experiment.reference.hand, load("platform_arm").with_masses(1.3), experiment.time)
    table = experiment.trajectory_of(robot).table(np.arange(300) * 0.01, robot.dimensions)
    np.testing.assert_allclose(table[:, :3], one.samples.pose[:300], atol=1e-12)
    assert one.gap.max() < 1e-3


def test_errors_of_the_hand_add_up() -> None:
    rng, n = np.random.default_rng(0), 50
    places = np.hstack((np.zeros((n, 6)), np.ones((n, 1))))
    wanted, reference, measured, true = (places.copy() for _ in range(4))
    for table, size in ((reference, 1e-6), (measured, 1e-3), (true, 1e-3)):
        table[:, :3] += size * rng.standard_normal((n, 3))
    true[:, 3:] = -Rotation.from_rotvec([0.0, 0.0, 0.01]).as_quat()  # q and -q turn alike
    errors = HandErrors("hand", np.arange(n) * 0.1, wanted, reference, measured, true, True)
    v, told = errors.vectors(), errors.numbers()
    np.testing.assert_allclose(v["total"], v["kinematic"] + v["tracking"] + v["model"], atol=1e-15)
    np.testing.assert_allclose(errors.angle(), 0.01, rtol=1e-9)
    late = np.linalg.norm(true[10:, :3], axis=1)  # after the first second
    assert told["position_peak_mm"] == pytest.approx(1e3 * late.max())
    assert told["position_rms_mm"] == pytest.approx(1e3 * np.sqrt((late**2).mean()))
    assert told["orientation_rms_mrad"] == pytest.approx(10.0)


def test_a_recording_tells_of_its_hand_alone(tmp_path: Path) -> None:
    """Wanted and true pose stand in the file; errors, figure and table come from there, not from the motion."""
    way = 'reference.hand.path=[{type="line", by=[0.1, 0.0, 0.0], speed=0.1, ramp=0.2}]'
    short = [*SHORT, way, "time.duration=1.5", "controllers=['pd']", "windows=[[0.0, 1.5]]"]
    result = run_experiment(load_experiment("hand", short), "hand", out=tmp_path)
    (found,) = result.hand["pd"]
    read = Recording.open(tmp_path / "pd.h5")
    assert read.labels("hand") == read.labels("hand_ref") == tuple(f"arm_tip.{each}" for each in HAND)
    assert read.meta["hands"] == {"arm_tip": False} and found.frame == "arm_tip" and not found.turned
    (again,) = hand_errors(read, recorded_robot(read))
    np.testing.assert_array_equal(again.distance(), found.distance())
    gap = read["hand"][:, :3] - read["hand_ref"][:, :3]
    np.testing.assert_allclose(found.distance(), np.linalg.norm(gap, axis=1), atol=1e-15)
    assert 1e-6 < found.distance().max() < 0.1 and np.abs(found.vectors()["kinematic"]).max() < 1e-3
    moved = read["hand_ref"][-1, :3] - read["hand_ref"][0, :3]
    np.testing.assert_allclose(np.linalg.norm(moved), 0.1, atol=1e-3)
    panels = list(CHARTS["hand"].panels({"pd": read}))
    assert panels[0].title == "distance of arm_tip" and len(panels) == 2
    assert "hand position [mm]" in terminal_text([next(iter(tables_of(result)))])


def test_peak_speeds_are_those_of_wheels_and_joints() -> None:
    robot = load("platform_arm")
    nu = np.array([[0.2, 0.5, -1.0, 0.3], [0.1, 0.0, 0.4, 0.0]])
    found = peak_speeds({"nu": nu}, robot)  # type: ignore[arg-type]
    wheel = robot.base.wheels[0]
    assert found[wheel.joint] == pytest.approx(max(abs(0.2 - wheel.y * 0.5), 0.1) / wheel.radius)
    assert found["arm_1_joint"] == 1.0 and found["arm_2_joint"] == 0.3


@pytest.mark.long
@pytest.mark.parametrize("name", sorted(bundled() | extra()))
def test_the_default_path_is_within_reach_of_every_robot(name: str) -> None:
    try:
        robot = load(name)
    except InputError as error:
        pytest.skip(str(error))
    experiment = load_experiment("hand", SHORT)
    assert experiment.reference.hand is not None
    if (robot.lower[robot.arm_index] >= robot.upper[robot.arm_index]).any():  # as double_pendulum's
        with pytest.raises(ConfigError, match="cannot move: the URDF limits it to 0"):
            experiment.trajectory_of(robot)
        return
    motion = hand_motion(experiment.reference.hand, robot, experiment.time)
    assert motion.misses == 0 and motion.gap.max() < experiment.reference.hand.tolerance
