"""Steps of MuJoCo's engine in which wheels roll while the base turns.

MuJoCo asks of the velocity `J v` of a contact that it decay, `J vdot = -b J v`, and leaves out `Jdot v`: under a base
that turns at w a wheel at speed u creeps sideways by `u w / b`, and 1/b is about a step. That is an error of first
order in the pose, whatever the integrator. So `Jdot v` is taken from what contacts of wheels, and a linkage, are asked
(`efc_aref`).

MuJoCo's RK4 gives no place for that; ours evaluates friction anew in every stage, too.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from .motion import cross
from .pivots import Pivots
from .tree import engine


class Steps:
    """Moves MuJoCo's state by one step.

    Args:
        model: MuJoCo's model (`mjModel`), with its step.
        wheels: Ids of the wheels' spheres.
        method: "rk4", or MuJoCo's Euler with implicit damping for any other.
        pivots: What steers, whose linkages turn along curves; None where nothing does.
    """

    def __init__(self, model: Any, wheels: frozenset[int], method: str, pivots: Pivots | None = None) -> None:
        self.pivots = pivots
        self.mj, self.model, self.wheels, self.h = engine(), model, wheels, model.opt.timestep
        self.take = self._rk4 if method == "rk4" else self._euler
        self.along, self.about = np.zeros((2, 3, model.nv))

    def _euler(self, data: Any, force: Callable[[], None]) -> None:
        """One step; `force` writes damping and applied forces for the state in `data`."""
        force()
        self.mj.mj_step1(self.model, data)
        self._roll(data)
        self.mj.mj_step2(self.model, data)

    def _rk4(self, data: Any, force: Callable[[], None]) -> None:
        """One step of the classical Runge-Kutta method, as MuJoCo takes it; `force` is called in every stage."""
        h, start, v = self.h, data.qpos.copy(), data.qvel.copy()
        speed, rate = np.zeros((2, self.model.nv))
        for weight, ahead in ((1, 0.5), (2, 0.5), (2, 1.0), (1, 0.0)):
            now, vdot = data.qvel.copy(), self._acceleration(data, force)
            speed += weight / 6 * now
            rate += weight / 6 * vdot
            if ahead:
                self._place(data, start, now, ahead * h)
                data.qvel[:] = v + ahead * h * vdot
        self._place(data, start, speed, h)
        data.qvel[:] = v + h * rate
        data.time += h

    def _place(self, data: Any, start: Any, speed: Any, h: float) -> None:
        """Write the position that a velocity reaches from another one in a time h [s]."""
        data.qpos[:] = start
        self.mj.mj_integratePos(self.model, data.qpos, speed, h)

    def _acceleration(self, data: Any, force: Callable[[], None]) -> Any:
        """(nv,) at the state in `data`."""
        force()
        for part in (self.mj.mj_fwdPosition, self.mj.mj_fwdVelocity):
            part(self.model, data)
        self._roll(data)
        for part in (self.mj.mj_fwdActuation, self.mj.mj_fwdAcceleration, self.mj.mj_fwdConstraint):
            part(self.model, data)
        return data.qacc.copy()

    def _roll(self, data: Any) -> None:
        """Take `Jdot v` of every wheel's contact from what it is asked.

        The contact's velocity is that of the sphere's centre, and the sphere's turning about it times a lever that
        always points down.
        """
        if self.pivots is not None:
            self.pivots.curve(data)
        for i in range(data.ncon):  # to iterate over data.contact itself takes a hundred times as long
            contact = data.contact[i]
            sphere = int(contact.geom2)
            if sphere not in self.wheels or contact.efc_address < 0:
                continue
            centre, body = data.geom_xpos[sphere], self.model.geom_bodyid[sphere]
            self.mj.mj_jacDot(self.model, data, self.along, self.about, centre, body)
            lever = contact.pos - centre
            curving = self.along @ data.qvel + cross(self.about @ data.qvel, lever)
            row = contact.efc_address
            data.efc_aref[row : row + 3] -= contact.frame.reshape(3, 3) @ curving
