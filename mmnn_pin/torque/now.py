"""What a learning law is told at a control sample: what is measured and commanded, and what was sent last."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..errors import ConfigError
from ..model.tree.regressor import measured, regress
from ..signals import Array, Measurement, Setpoint, VelocityCommand
from .controller import Context

if TYPE_CHECKING:
    from ..model.tree.regressor import Massless


@dataclass(eq=False)
class Now:
    """One control sample. The arrays are read-only and overwritten at the next one: copy what you keep or change.

    Attributes:
        time: [s].
        period: Control period [s].
        s: (p,) error `[z; r] = nu_ref - nu`.
        nu: (p,) measured velocities.
        first: Whether this is the first sample, of a run or after it was resumed.
        sent: (p,) torque of the control period that has just ended, as the motors were asked for it, supervisor
            included; zeros at the first sample.
        reference: What the robot should do.
        measurement: What the sensors say: pose, velocity, q, qdot.
        command: What the kinematic layer asks for: nu_ref, nudot_ref, alpha, the errors z, e, r ...
    """

    time: float
    period: float
    first: bool
    s: Array
    nu: Array
    sent: Array
    reference: Setpoint
    measurement: Measurement
    command: VelocityCommand
    _torque: Array
    _known: Massless | None
    _written: Array
    _new: bool = True

    @classmethod
    def of(cls, row: Array, context: Context) -> Now:
        """The samples of a row (width,)."""
        layout, h = context.layout, context.control_period
        told = read_only(row)
        views = (Setpoint.of(told, layout), Measurement.of(told, layout), VelocityCommand.of(told, layout))
        known = None if context.regressor is None else context.regressor.workspace()
        written = np.zeros((3, layout.dof))
        s, nu, sent = read_only(written)
        return cls(0.0, h, True, s, nu, sent, *views, told[layout.where("torque")], known, written)

    @property
    def q(self) -> Array:
        """Measured joint angles, (n,) [rad or m]."""
        return self.measurement.q

    @property
    def nu_ref(self) -> Array:
        """Reference velocities, (p,)."""
        return self.command.nu_ref

    @property
    def nudot_ref(self) -> Array:
        """Their time derivative, (p,)."""
        return self.command.nudot_ref

    @property
    def regressor(self) -> Array:
        """Y at this sample, (p, k): `Psi = Y theta`; for a law with `knows_motion`. A view.

        Raises:
            ConfigError: The law does not ask for it.
        """
        return self.regressor_at(self.q, self.nu, self.nu_ref, self.nudot_ref)

    def regressor_at(self, q: Array, nu: Array, nu_ref: Array, nudot_ref: Array) -> Array:
        """Y at other angles (n,) and velocities (p,), at the measured pose, (p, k); a view, as `regressor`.

        Raises:
            ConfigError: The law does not ask for it.
        """
        if self._known is None:
            raise ConfigError("the law is not told how the robot moves", fix="write knows_motion = True in its class")
        nb, q, nu = self._known.base, np.asarray(q, float), np.asarray(nu, float)
        measured(self._known, self.measurement.pose.copy(), nu[:nb].copy(), q.copy(), nu[nb:].copy())
        regress(self._known, np.array(nu_ref, float), np.array(nudot_ref, float))
        return self._known.Y

    def refresh(self, time: float) -> None:
        """Take in a new sample of the row, before its torque is written."""
        nb, command, measurement = len(self.command.z), self.command, self.measurement
        self.first, self.time = self._new, time
        self._new = False
        s, nu, sent = self._written
        s[:nb], s[nb:] = command.z, command.r
        nu[:nb], nu[nb:] = measurement.velocity, measurement.qdot
        sent[:] = self._torque


def read_only(array: Array) -> Array:
    """A view that cannot be written to: a law that changed a signal would change the feedback or the recording."""
    view = array.view()
    view.flags.writeable = False
    return view
