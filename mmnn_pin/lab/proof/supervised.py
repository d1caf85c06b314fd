"""What a box of errors may reach of a supervisor's limits: where one may be passed, another loop begins."""

from __future__ import annotations

from dataclasses import dataclass

import msgspec
import numpy as np

from ...model.robot import Robot
from ...safety import Safety
from ...safety.supervisor import HEADING, POSITION
from ...signals import Array
from .subject import Subject


@dataclass(frozen=True, eq=False)
class Supervisor:
    """Limits, inf where there is none.

    Attributes:
        torque: (motors,) of every motor, clipped [N m or N].
        speed: (p,) of every velocity [m/s, rad/s].
        position: Distance of the base from its reference [m].
        heading: Heading error [rad].
        joints: (n,) errors of the arm [rad or m].
        E_inv: (motors, p) motor torques from torques on nu.
    """

    torque: Array
    speed: Array
    position: float
    heading: float
    joints: Array
    E_inv: Array

    @classmethod
    def of(cls, safety: Safety, robot: Robot, period: float) -> Supervisor:
        """From settings."""
        its = safety.supervisor(robot, period, np.zeros(robot.layout.dof), np.zeros(robot.layout.arm))
        position, heading = its.numbers[[POSITION, HEADING]]
        return cls(its.torque, its.speed, position, heading, its.error, np.asarray(np.linalg.inv(robot.E)))


@dataclass(frozen=True)
class Limit:
    """What may be reached of a limit.

    Attributes:
        name: Which.
        value: Largest value in the box.
        limit: The limit.
        words: What it is.
    """

    name: str
    value: float
    limit: float
    words: str


def supervisor_of(subject: Subject) -> Supervisor | None:
    """The supervisor of a run, if there is one."""
    safety = subject.recording.meta.get("safety")
    if not safety:
        return None
    return Supervisor.of(msgspec.convert(safety, Safety), subject.robot, subject.timing.control_period)


def limits_in(supervisor: Supervisor, bounds: dict[str, Array], torque: Array) -> list[Limit]:
    """What a box may reach of every limit: bounds of its signals (see `signal_bounds`), torques on nu up to (p,)."""
    nu = np.concatenate((bounds["velocity"], bounds["qdot"]))
    told = [
        worst("torque", np.abs(supervisor.E_inv) @ torque, supervisor.torque, "largest motor torque [N m or N]"),
        worst("speed", nu, supervisor.speed, "largest speed [m/s, rad/s or m/s of a joint]"),
        worst("position", bounds["world_error"][:1], supervisor.position, "largest distance from the reference [m]"),
        worst("heading", bounds["pose_error"][2:], supervisor.heading, "largest heading error [rad]"),
        worst("joint error", bounds["e"], supervisor.joints, "largest error of a joint [rad or m]"),
    ]
    return [limit for limit in told if limit is not None]


def worst(name: str, values: Array, limits: Array | float, words: str) -> Limit | None:
    """The value that comes nearest to its limit or passes it furthest; None where there is no limit."""
    limits = np.broadcast_to(limits, values.shape)
    if not np.isfinite(limits).any():
        return None
    k = int(np.argmax(values / limits))
    return Limit(f"supervisor, {name}", float(values[k]), float(limits[k]), f"{words}, within the supervisor's limit")
