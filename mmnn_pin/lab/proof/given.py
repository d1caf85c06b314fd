"""What a run's rig gave to its robot: the torque of the motors, pushes, a payload; all constant over a control period.

A recording holds the means over every control period. Motors with lag, limits of speed or backlash, and pushes that
change, vary within one that has several steps of the plant; then the motion cannot be made again from the recording.
"""

from __future__ import annotations

from dataclasses import dataclass

import msgspec
import numpy as np

from ...disturbance import Block, DeadMotor, Disturbance, Frozen, Messages, Push, payload
from ...model.payload import carrying
from ...model.robot import Robot
from ...recording.recording import Recording
from ...settings import Timing
from ...signals import Array


@dataclass(frozen=True, eq=False)
class Given:
    """What was given to a robot.

    Attributes:
        torque: (N, p) generalized torque of the motors [N, N m].
        push: (N, p) external force `f` of `M nudot + C nu + ... = tau + f`; d of the equality is `-f` [N, N m].
        loaded: The robot once it carries its payload; None without one.
        pick: When that is [s], inf for never.
        varies: Whether torque or push change within control periods.
        blocked: Whether a joint is blocked at some time.
        senses: Whether disturbances touch what the controller is told.
    """

    torque: Array
    push: Array
    loaded: Robot | None
    pick: float
    varies: bool
    blocked: bool
    senses: bool

    @classmethod
    def of(cls, recording: Recording, robot: Robot, timing: Timing) -> Given:
        """From a recording."""
        events = msgspec.convert(recording.meta.get("disturbances", ()), tuple[Disturbance, ...])
        driven = "actuator" in recording.meta or has(events, DeadMotor)
        rows, p = len(recording), robot.layout.dof
        torque, push = recording["torque"].reshape(rows, p), np.zeros((rows, p))
        if driven:
            applied = recording["applied"].reshape(rows, -1) @ robot.E.T
            driven = not np.allclose(applied, torque, rtol=1e-9, atol=1e-9 * np.abs(torque).max(initial=0.0))
            torque = applied if driven else torque
        if "disturbance" in recording:
            push = recording["disturbance"].reshape(rows, p)
        _, load = payload(events)
        changes = driven or any(changing(one, timing.control_period) for one in events if isinstance(one, Push))
        return cls(
            torque=torque,
            push=push,
            loaded=None if load is None else carrying(robot, load.mass, load.joint, load.at),
            pick=np.inf if load is None else load.start,
            varies=changes and timing.steps_per_control > 1,
            blocked=has(events, Block),
            senses=has(events, Frozen, Messages),
        )


def has(events: tuple[Disturbance, ...], *kinds: type) -> bool:
    """Whether there is a disturbance of one of these kinds."""
    return any(isinstance(one, kinds) for one in events)


def changing(push: Push, period: float) -> bool:
    """Whether a push changes within control periods: by its shape, or as it begins or ends between two samples."""
    edges = [edge / period for edge in (push.start, push.end) if np.isfinite(edge)]
    return push.shape in ("impulse", "sine") or any(abs(edge - round(edge)) > 1e-6 for edge in edges)
