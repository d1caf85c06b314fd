"""The Lyapunov function of a recording changes as its derivative says; monitors draw what was recorded."""

from __future__ import annotations

import numpy as np
import pytest
from numba import config
from replays import recorded
from robots import feedback, fixed_arm, mobile_arm
from test_holonomic import PATHS, mecanum

from mmnn_pin import PD, Hold, Loop, Neural, Sine, Start, Timing, Trajectory, TwoLayer, load
from mmnn_pin.cli.plot import WHATS
from mmnn_pin.errors import RecordingError
from mmnn_pin.kinematic import Kinematic
from mmnn_pin.model.robot import Robot
from mmnn_pin.recording import Outcome, Recording
from mmnn_pin.reference import Holonomic
from mmnn_pin.show import lyapunov as module
from mmnn_pin.show.gallery import PICTURES
from mmnn_pin.show.lyapunov import lyapunov
from mmnn_pin.show.monitors import MONITORS, lyapunov_figure, residuals_figure, step_times_figure, weights_figure

ROBOTS = {"differential": mobile_arm, "holonomic": mecanum, "fixed": fixed_arm}
PERIOD = 5e-4


def run_of(robot: Robot, period: float, duration: float, engine: str = "auto") -> Recording:
    base = {0: None, 2: PATHS["eight"], 3: Holonomic(PATHS["eight"], Sine(0.5, 4.0))}[robot.layout.base]
    trajectory = Trajectory(base, (Sine(0.4, 2.0), Hold(0.2)))
    kinematic = Kinematic(kx=3.0, ky=20.0, kth=5.0, K=4.0, holonomic=(2.0, 3.0, 4.0))
    start = Start(pose_offset=(0.05, -0.04, 0.2) if base else (0.0, 0.0, 0.0), joint_offset=0.1, moving=True)
    gains = feedback(robot, 0.002)
    timing = Timing(duration, period, period)
    return Loop(robot, trajectory, PD(gains), kinematic, timing, start, engine=engine).run()  # type: ignore[arg-type]


@pytest.mark.parametrize("kind", ROBOTS)
def test_the_derivative_is_that_of_v(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The torque is held between samples, so the sum of the derivatives misses V by an error of first order."""
    robot = ROBOTS[kind](2)
    monkeypatch.setattr(module, "recorded_robot", lambda recording: robot)  # the mecanum base has no URDF
    duration, missed = 0.02 if config.DISABLE_JIT else 0.5, []
    for period in (PERIOD, PERIOD / 2):
        found = lyapunov(run_of(robot, period, duration), most=10**6)
        for v, rate in ((found.pose, found.pose_rate), (found.motion, found.motion_rate)):
            error = np.abs(v[1:] - v[0] - np.cumsum(period * rate)[:-1]).max()
            missed.append(error / np.ptp(v) if v.any() else 0.0)
    assert max(missed) < 0.05
    assert missed[2] <= 0.7 * missed[0] and missed[3] < 0.7 * missed[1]
    assert (found.pose.any(), found.motion.any()) == (kind != "fixed", True)
    np.testing.assert_array_equal(found.derivative, found.pose_rate + found.motion_rate)


def test_v_is_zero_where_the_errors_are() -> None:
    rec = recorded(load("platform_arm"), lag=0.0, kinematic={"ky": 64.0})
    found = lyapunov(rec)
    assert not found.total.any() and not found.derivative.any() and len(found.time) <= module.MOST
    with pytest.raises(RecordingError, match="gains"):
        lyapunov(recorded(load("platform_arm")))
    with pytest.raises(RecordingError, match="pose"):
        lyapunov(recorded(load("platform_arm"), kinematic={"ky": 0.0}))


def test_a_lost_run_has_v_as_long_as_it_is_finite() -> None:
    def lose(table: np.ndarray, where) -> None:
        table[:, where("pose_error")] = 0.1
        table[-5:, 1:] = np.nan

    rec = recorded(
        load("platform_arm"), kinematic={}, duration=0.2, change=lose, outcome=Outcome("diverged", 0.2, "nu[0]", "lost")
    )
    assert len(lyapunov(rec).time) == 95
    assert np.isfinite(lyapunov_figure({"pd": rec}).axes[0].get_ylim()).all()


def test_figures_draw_what_was_recorded() -> None:
    robot = load("platform_arm")
    trajectory = Trajectory(PATHS["line"], (Sine(0.4, 2.0), Hold(0.2)))
    timing = Timing(0.02 if config.DISABLE_JIT else 0.1, 0.001, 0.001)
    runs = {}
    for controller in (Neural(TwoLayer(hidden=4)), PD()):
        loop = Loop(robot, trajectory, controller, timing=timing, engine="ordinary")
        runs[controller.name] = loop.run()
    upper, lower = weights_figure(runs).axes
    for column, axes in enumerate((upper, lower)):
        (line,) = [line for line in axes.get_lines() if len(line.get_xdata()) > 2]
        np.testing.assert_array_equal(line.get_ydata(), runs["two_layer"]["weight_norm"][:, column])
    (axes,) = residuals_figure(runs).axes
    lines = [line for line in axes.get_lines() if len(line.get_xdata()) > 2]
    for line, rec in zip(lines, runs.values(), strict=True):
        np.testing.assert_allclose(line.get_ydata(), 1e3 * rec["energy_residual"])
    (axes,) = step_times_figure(runs).axes
    steps = [patch.get_xy()[:, 1] for patch in axes.patches]
    assert [counts.max() > 0 for counts in steps] == [True, True] and axes.get_xscale() == "log"
    if not config.DISABLE_JIT:
        compiled = Loop(robot, trajectory, PD(), timing=timing).run()
        with pytest.raises(RecordingError, match="compiled"):
            step_times_figure({"pd": compiled})
    with pytest.raises(RecordingError):
        weights_figure({"pd": runs["pd"]})


def test_the_command_offers_every_picture() -> None:
    assert set(WHATS) == set(PICTURES) and set(MONITORS) <= set(PICTURES)
