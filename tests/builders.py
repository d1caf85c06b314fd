"""Trajectories, loops, recordings and parameters for tests, in one line each."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from mmnn_pin import PD, Circle, Feedback, Loop, Sine, Timing, Trajectory, load
from mmnn_pin.loop.before_run import Start
from mmnn_pin.model.robot import Robot
from mmnn_pin.plant import integrators
from mmnn_pin.plant.ideal import IdealPlant
from mmnn_pin.recording.recorder import Recorder
from mmnn_pin.recording.recording import Outcome, Recording
from mmnn_pin.signals import Array, Layout

THESIS = Feedback(500.0, 30.0)
MOBILE, FIXED = Layout(base=2, arm=2, full=7, motors=4), Layout(base=0, arm=2, full=2, motors=2)


@cache
def thesis_robot(friction: tuple[float, ...] = (30.0, 5.0, 0.5, 0.5)) -> Robot:
    """The thesis's robot with viscous friction on nu."""
    return load("platform_arm").with_friction(friction)


def trajectory(robot: Robot, ramp: float = 0.5) -> Trajectory:
    """A circle from rest, and a sine of its own for every joint."""
    arm = [Sine(0.5 / (1 + 0.3 * i), 2.0 + 0.7 * i, phase=0.4 * i) for i in range(robot.dimensions.arm)]
    return Trajectory(Circle(1.0, 0.4, ramp=ramp) if robot.dimensions.base else None, tuple(arm))


def with_gains(controller: Any) -> Any:
    """A controller that is given no gains, with the thesis's; any other as it is."""
    feedback = getattr(controller, "feedback", None)
    return replace(controller, feedback=THESIS) if feedback == Feedback() else controller


def loop(controller: Any = None, *, robot: Robot | None = None, duration: float = 0.2, **more: Any) -> Loop:
    """A closed loop of PD on the thesis's robot, started a little off its trajectory; `more` as in `Loop`."""
    robot = robot or thesis_robot()
    settings = {
        "trajectory": trajectory(robot),
        "timing": Timing(duration=duration),
        "start": Start(pose_offset=(-0.02, 0.01, 0.03), joint_offset=0.04),
    }
    return Loop(robot=robot, controller=with_gains(controller or PD()), **(settings | more))


def recording(
    controller: str = "pd",
    layout: Layout = MOBILE,
    *,
    rows: int = 40,
    period: float = 0.1,
    signals: Mapping[str, Any] | None = None,
    noise: float = 0.0,
    seed: int = 0,
    outcome: Outcome | None = None,
    **facts: Any,
) -> Recording:
    """A recording without a run.

    Args:
        controller: Whose.
        layout: Of its rows.
        rows: How many.
        period: Time between them [s].
        signals: Name of a signal to its values, (rows, size) or what broadcasts to that; the others are 0.
        noise: Standard deviation of all signals but these and the time.
        seed: Of the noise.
        outcome: How it ended; completed by default.
        facts: What else it says of itself.
    """
    table = noise * np.random.default_rng(seed).normal(size=(rows, layout.width))
    table[:, layout.where("time")] = period * np.arange(rows)[:, None]
    for name, values in (signals or {}).items():
        table[:, layout.where(name)] = values
    names = ("v", "w", "lift", "elbow")
    motors = ("left", "right", "lift", "elbow")
    about = {"velocity_names": names[-layout.dof :], "actuator_names": motors[-layout.motors :]}
    with Recorder(layout, {"controller": controller, "control_period": period} | about | facts) as recorder:
        recorder.append_block(table, np.zeros(rows))
        return recorder.finish(outcome or Outcome("completed", period * rows))


def first_of(names: Iterable[str], *quick: str) -> list[Any]:
    """Parameters of a test: those named as quick always run; the others, the same code compiled again, are long."""
    return [pytest.param(name, marks=() if name in quick else pytest.mark.long) for name in names]


def step_feedback(plant: IdealPlant, time: float, feedback: Callable[[float, Array, Array], Array]) -> None:
    """Advance a plant by its step with RK4 under a feedback `tau(t, position, nu)`, evaluated at every stage."""
    nv, p = plant.position.size, plant.nu.size
    plant.trial[:] = plant.y
    for stage, ahead in enumerate((0.0, 0.5, 0.5, 1.0)):
        position, nu = plant.trial[:nv], plant.trial[nv : nv + p]
        tau = np.ascontiguousarray(feedback(time + ahead * plant.dt, position, nu), float)
        plant.dynamics.refresh(position, nu)
        integrators.derivative(plant.trial, tau, plant.joints, plant.terms)
        integrators.rk4_stage(stage, plant.dt, plant.y, plant.ydot, plant.total, plant.trial)
    plant.y[:] = plant.trial
