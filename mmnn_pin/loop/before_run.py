"""What a loop refuses before it runs: gains unstable when sampled, a nominal robot of another shape, a first sample."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..errors import ConfigError
from ..model.dynamics import Dynamics
from ..one_thread import one_thread
from ..signals import INDEX
from ..timing import Timing
from ..torque.controller import CompiledController
from ..torque.learning_law import LearningLaw
from .sampled import require_stable, sampled_loop, viscous_friction
from .start import FIRST_REFERENCE, Start

if TYPE_CHECKING:
    from .loop import Loop


@one_thread
def require_stable_gains(loop: Loop) -> None:
    """Judge the sampled PD loop at ten places along the reference.

    Raises:
        ConfigError: It is unstable at one of them, with the numbers.
    """
    if not loop.check_gains or not isinstance(loop.controller, CompiledController | LearningLaw):
        return
    robot, layout, dynamics, table = loop.robot, loop.robot.layout, Dynamics(loop.robot), loop.table()
    gains = loop.controller.feedback_gain(layout)
    base_gains, K = loop.kinematic.base_gains(layout.base), loop.kinematic.arm_gains(layout)
    h = max(loop.timing.control_period, loop.timing.sensor_period or 0.0)  # a slow sensor holds the torque, too
    start = layout.offsets[FIRST_REFERENCE]
    velocity = slice(*(layout.offsets[INDEX["velocity_ref"] + i] - start for i in (0, 1)))
    friction = viscous_friction(robot)
    for i in np.unique(np.linspace(0, len(table) - 1, 10).astype(int)):
        position, _ = Start().state(robot, table[i])
        M = dynamics.mass_matrix(position)
        verdict = sampled_loop(M, gains, table[i, velocity], base_gains, K, h, friction)
        require_stable(verdict, gains, robot.velocity_names, h)


def require_nominal(loop: Loop) -> None:
    """Refuse a nominal robot of another shape.

    Raises:
        ConfigError: It has another base or other joints.
    """
    own = loop.robot.layout
    believed = replace(loop.believed.layout, wheels=own.wheels, hardware=own.hardware)
    if believed != own:
        raise ConfigError(
            f"the nominal robot has {believed}, the robot {own}",
            fix="use one with the same base and the same joints",
            key="nominal",
        )


def require_first(timing: Timing, first: int) -> None:
    """Refuse to start at a control sample at which there is no measurement.

    Raises:
        ConfigError: There is none, or no such sample.
    """
    if not 0 <= first < timing.samples or first * timing.steps_per_control % timing.steps_per_measurement:
        raise ConfigError(
            f"cannot start at control sample {first}",
            why=f"the run has {timing.samples}, and a held measurement is not part of the state",
            fix="choose one of them at which there is a measurement",
            key="first",
        )
