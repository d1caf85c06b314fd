"""What a gain is scaled by: the inertia that each velocity feels along a reference."""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm

from ...loop.before_run import Start, viscous_friction
from ...model.dynamics import Dynamics
from ...model.robot import Robot
from ...reference import Trajectory
from ...signals import Array


def effective_inertia(robot: Robot, trajectory: Trajectory, duration: float, period: float, places: int = 10) -> Array:
    """Effective inertia of every velocity, the smallest one along a reference, (p,) [kg, kg m^2].

    It is `period / Gamma_ii`, with `Gamma = int_0^period exp(-M^-1 D t) dt M^-1` the velocity that a torque held for
    one control period gives, M the reduced mass matrix and D its viscous friction. Without friction this is
    `1 / (M^-1)_ii`: what a torque on that velocity alone accelerates while all others move freely. A link of a few
    milligram square metres in a joint with 1 N m s weighs what its friction makes of it.

    Args:
        robot: The robot, or the one that the designer of the gains believes in.
        trajectory: The reference.
        duration: Its length [s].
        period: Control period [s].
        places: Instants, evenly spaced.
    """
    dynamics, D, p = Dynamics(robot), viscous_friction(robot), robot.layout.dof
    table = trajectory.table(np.linspace(0.0, duration, places), robot.layout)
    found = []
    for row in table:
        M_inv = np.linalg.inv(dynamics.mass_matrix(Start().state(robot, row)[0]))
        held = expm(np.block([[-M_inv @ D, M_inv], [np.zeros((p, 2 * p))]]) * period)
        found.append(period / np.diag(held[:p, p:]))
    return np.min(found, axis=0)
