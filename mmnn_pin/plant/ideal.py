"""The ideal plant: wheels that roll exactly, `nudot = M^-1 (tau - C nu - gravity - friction)`."""

from __future__ import annotations

import numpy as np

from ..errors import UnknownName
from ..model.reduction import spread
from ..model.robot import Robot
from ..model.tree.twin import terms_of
from ..signals import Array, Layout
from . import NO_PUSH, integrators


class IdealPlant:
    """A robot whose wheels neither slip nor slide, integrated with a fixed step.

    Args:
        robot: The true robot.
        dt: Step [s].
        method: "rk4", "semi_implicit_euler", "implicit_friction" or "stick".

    Attributes:
        y: (nv + p + 1,) position, nu and the work done on the robot since the start.
        position: View of the position in y.
        nu: View of nu in y.
        dynamics: Reduced dynamics of the robot at the present state.
        hold: (nv,) friction of joints that are blocked; the method "stick" only [N m or N].

    Raises:
        UnknownName: No such method.
    """

    def __init__(self, robot: Robot, dt: float, method: str = "rk4") -> None:
        if method not in integrators.METHODS:
            raise UnknownName("integrator", method, integrators.METHODS, key="time.integrator")
        self.robot, self.dt, self.method = robot, dt, integrators.METHODS[method]
        self.to_motors = np.ascontiguousarray(robot.E_at(robot.rest).T)
        nv, p = robot.dimensions.full, robot.dimensions.dof
        self.y, self.trial, self.ydot, self.total = (np.zeros(nv + p + 1) for _ in range(4))
        self.position, self.nu = self.y[:nv], self.y[nv : nv + p]
        self.hold = np.zeros(nv)
        self._take(robot)

    def start(self, position: Array, nu: Array) -> None:
        """Put the robot at a position (nv,) with velocity nu (p,) and no work done."""
        self.position[:], self.nu[:], self.y[-1] = position, nu, 0.0
        self.refresh()

    def refresh(self) -> None:
        """Evaluate M and h at the present state; `step` starts from there."""
        self.dynamics.refresh(self.position, self.nu)

    def step(self, tau: Array, pushed: Array = NO_PUSH) -> None:
        """Advance by dt under a held torque, (p,); `refresh` must have been called at this state.

        `pushed` is the part of it that does not come from the motors, which makes no difference here.
        """
        if self.method == integrators.IMPLICIT_FRICTION:
            self._implicit(tau)
            return
        if self.method != integrators.RK4:
            integrators.euler(self.method, self.dt, self.joints, self.terms, tau, self.y)
            return
        self._derivative(self.y, tau)
        integrators.rk4_stage(0, self.dt, self.y, self.ydot, self.total, self.trial)
        for stage in (1, 2, 3):
            self._evaluate(tau)
            integrators.rk4_stage(stage, self.dt, self.y, self.ydot, self.total, self.trial)
        self.y[:] = self.trial

    def _implicit(self, tau: Array) -> None:
        nv, p, whole, trial = self.position.size, self.nu.size, self.total, self.trial
        for stage in (0, 1):
            if stage > 0:
                self.dynamics.refresh(trial[:nv], trial[nv : nv + p])
            integrators.implicit_stage(stage, self.dt, self.joints, self.terms, tau, self.y, whole, trial)

    def carry(self, robot: Robot) -> None:
        """Go on with a robot that carries more."""
        n = self.dynamics.maps.n
        self._take(robot)
        self.dynamics.maps.n[:] = n
        self.refresh()

    def motor_speeds(self, speeds: Array) -> None:
        """Speed of every motor's joint, (motors,) [rad/s or m/s]."""
        if self.robot.steers:
            np.copyto(self.to_motors, self.robot.E_full.T @ self.dynamics.maps.T)
        spread(self.to_motors, self.nu, speeds)

    def respond(self, tau: Array, E: Array, free: Array, answer: Array) -> None:
        """See `integrators.respond`."""
        integrators.respond(self.dt, self.joints, self.terms, self.nu, tau, E, free, answer)

    def observe(self, row: Array, layout: Layout) -> None:
        """Nothing: the row has all that this plant knows."""

    def findings(self) -> list[str]:
        """Nothing: its wheels roll."""
        return []

    def _evaluate(self, tau: Array) -> None:
        nv, p = self.position.size, self.nu.size
        self.dynamics.refresh(self.trial[:nv], self.trial[nv : nv + p])
        self._derivative(self.trial, tau)

    def _derivative(self, y: Array, tau: Array) -> None:
        integrators.derivative(y, tau, self.joints, self.terms)

    def _take(self, robot: Robot) -> None:
        """Dynamics of a robot, and its arrays for the integrators."""
        self.robot, self.dynamics = robot, terms_of(robot)
        d = self.dynamics
        friction = robot.damping, robot.dry, robot.viscous
        self.joints = integrators.plant_joints(friction, robot.dimensions.base, robot.dimensions.sideways, d.maps)
        self.terms = integrators.plant_terms(d.v, d.M, d.h, d.F, self.hold, self.ydot)
