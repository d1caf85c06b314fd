"""What the reference of a task asks of the motors: their speeds and torques over their limits."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...loop.before_run import Start
from ...model.dynamics import Dynamics
from ...model.limits import speed_limits
from ..proof.held_out import whole_reference
from .task import Task

PLACES = 500  # along the reference, at which torques are computed


@dataclass(frozen=True)
class Demand:
    """Largest share of the motors' limits along a reference that is followed exactly; 0 for motors without a limit.

    Attributes:
        motors: Names.
        speed: (motors,) speed over the speed limit.
        torque: (motors,) torque over the effort limit, that of the robot as the training starts.
    """

    motors: tuple[str, ...]
    speed: tuple[float, ...]
    torque: tuple[float, ...]

    def to_dict(self) -> dict[str, Any]:
        """Motor to its shares."""
        each = zip(self.motors, self.speed, self.torque, strict=True)
        return {motor: {"speed": speed, "torque": torque} for motor, speed, torque in each}


def demand(task: Task) -> Demand:
    """What a task's reference asks: rates `E' nu_ref` (wheels roll) and torques `E^-1 Psi` at `nudot_ref`."""
    robot, layout = task.robot, task.robot.layout
    rows = whole_reference(task.experiment, robot)
    nu = np.hstack([rows[:, layout.where(name)] for name in ("velocity_ref", "qdot_ref")])
    nudot = np.hstack([rows[:, layout.where(name)] for name in ("acceleration_ref", "qddot_ref")])
    table = rows[:, layout.where("pose_ref").start : layout.where("qddot_ref").stop]
    speed = np.abs(nu @ robot.E).max(axis=0) / speed_limits(robot)
    dynamics, psi, torque = Dynamics(robot), np.zeros(layout.dof), np.zeros(len(robot.actuator_names))
    inverse = np.linalg.pinv(robot.E)
    for k in np.unique(np.linspace(0, len(table) - 1, PLACES).astype(int)):
        position, _ = Start().state(robot, table[k])
        dynamics.refresh(position, nu[k])
        dynamics.refresh_psi(nu[k], nudot[k], psi)
        torque = np.maximum(torque, np.abs(inverse @ psi))
    limits = robot.effort_limits
    return Demand(tuple(robot.actuator_names), tuple(speed.tolist()), tuple((torque / limits).tolist()))


def held_out_torque(task: Task) -> dict[str, float]:
    """Largest share of a motor's torque limit on each held-out trajectory, of the robot as it is there, with its load.

    Raises:
        RecordingError: The robot is lost on one of them.
    """
    layout, inverse = task.robot.layout, np.linalg.pinv(task.robot.E)
    return {
        name: float((np.abs(rows[:, layout.where("psi")] @ inverse.T) / task.robot.effort_limits).max())
        for name, rows in task.rows.items()
    }
