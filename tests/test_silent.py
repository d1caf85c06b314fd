"""Numbers of the right type that mean nothing: they are refused or told, not computed with."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from mmnn_pin import Loop, Neural, Recording, Stepper, Timing, Trajectory, judge, load
from mmnn_pin.errors import ConfigError, InputError, RobotError
from mmnn_pin.reference import Line
from mmnn_pin.signals import Array
from mmnn_pin.torque.model_based import PD


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    robot, path = load("platform_arm"), tmp_path_factory.mktemp("run") / "run.h5"
    Loop(robot, Trajectory.of(robot, base=Line(0.3)), Neural(), timing=Timing(duration=0.6)).run(path)
    return path


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda t: np.nan * t, "row 0 is at nan s"),
        (lambda t: t[::-1], "the one before at"),
        (lambda t: t + 1e300, "no time is further than"),
        (lambda t: 0.0 * t, "row 1 is at 0 s"),
    ],
)
def test_weights_at_times_that_are_none_are_damage(
    change: Callable[[Array], Array], says: str, run: Path, tmp_path: Path
) -> None:
    shutil.copy(run, tmp_path / "broken.h5")
    with h5py.File(tmp_path / "broken.h5", "r+") as file:
        file["weights/time"][...] = change(file["weights/time"][:])
    found = Recording.open(tmp_path / "broken.h5")
    with pytest.raises(InputError, match=f"weights is damaged: its time: .*{says}"):
        _ = found.weights
    assert np.isfinite(found["z"]).all() and Recording.open(run).weights["time"].size > 1


@pytest.mark.parametrize("given", [{"payload": np.nan}, {"payload": -1.0}, {"windows": 0}, {"windows": -3}])
def test_a_judge_takes_no_such_numbers(given: dict[str, float], run: Path) -> None:
    with pytest.raises(ConfigError, match=f"^{next(iter(given))}: error: "):
        judge(Recording.open(run), **given)  # type: ignore[arg-type]


def test_times_of_waypoints_belong_to_positions_and_increase() -> None:
    robot = load("platform_arm")
    with pytest.raises(InputError, match="times without positions"):
        Trajectory.from_waypoints(robot, base=[(0, 0), (1, 0), (2, 0)], times=[2, 1, 0])
    with pytest.raises(InputError, match="do not increase from 0 on"):
        Trajectory.from_waypoints(robot, arm=[[0, 0], [0.1, 0], [0, 0]], times=[2, 1, 0])


def test_a_joint_that_would_turn_with_a_wheel_is_refused_and_taken_where_it_is_fixed(tmp_path: Path) -> None:
    text = Path(load("platform_arm").path).read_text()
    begin = text.index(">", text.index('<joint name="arm_2_joint"')) + 1
    file = tmp_path / "wheel.urdf"
    file.write_text(text[:begin] + '<mimic joint="wheel_left_joint" multiplier="0.1"/>' + text[begin:])
    with pytest.raises(RobotError, match=r"'arm_2_joint' mimics the wheel 'wheel_left_joint'.*take out its <mimic>"):
        load(file)
    file.write_text(text)
    assert load(file).joint_names == ("arm_1_joint", "arm_2_joint")


@pytest.mark.parametrize("name", ["a/b", "", ".", "..", "a\0b", "hardware_state", "x" * 200])
def test_what_a_stepper_finishes_with_can_be_read(name: str, tmp_path: Path) -> None:
    with Stepper(load("platform_arm"), PD()) as stepper:
        for status in ("nonsense", 3):
            with pytest.raises(ConfigError, match="give 'completed' or"):
                stepper.finish(status)  # type: ignore[arg-type]
        with pytest.raises(ConfigError, match="is no name for an array"):
            stepper.finish(extra={name: np.zeros(2)})
        found = stepper.finish(message="a\x1b[31m\nb\udc80", extra={"x": [np.nan]})
    assert Recording.open(found.save(tmp_path / "kept.h5")).outcome.message == "a [31m b "
