"""The run that is looked into: its robot, its rows, its gains, and the learner built again from its recording."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import msgspec
import numpy as np

from ...errors import RecordingError
from ...kinematic import Kinematic, command
from ...model.dynamics import Dynamics
from ...model.robot import Robot
from ...recording.recording import Recording, recorded_robot
from ...sensing import exact
from ...settings import Timing
from ...signals import Array, Layout
from ...torque.neural import Neural
from .given import Given
from .learner import Learner
from .networks import Networks
from .rebuild import recorded_learner

NEEDED = ("time", "position", "nu", "nu_ref", "nudot_ref", "psi", "psi_hat", "robust", "torque")


@dataclass(frozen=True, eq=False)
class Subject:
    """A recorded run and what it was made of.

    Attributes:
        recording: The run.
        robot: Its true robot.
        kinematic: Gains of its kinematic layer.
        timing: Its periods.
        rows: (N, width) its signals as rows; those up to the first that is not finite.
    """

    recording: Recording
    robot: Robot
    kinematic: Kinematic
    timing: Timing
    rows: Array

    @classmethod
    def of(cls, recording: Recording) -> Subject:
        """Everything from a recording.

        Raises:
            RecordingError: It holds less than two rows that are finite, or does not tell its robot, gains or periods.
            InputError: Its robot cannot be built.
        """
        if not recording.urdf.strip():
            why = "without it there is no model to compare with"
            raise RecordingError("the recording does not hold its robot's URDF", why=why, file=recording.path)
        robot = recorded_robot(recording)
        for key, what in (("kinematic", "gains of its kinematic layer"), ("time", "periods")):
            if key not in recording.meta:
                why = "an older mmnn_pin wrote it"
                raise RecordingError(f"the recording does not tell the {what}", why=why, file=recording.path)
        require_signals(recording)
        rows = finite_rows(recording, robot.layout)
        if len(rows) < 2:
            why = f"{len(rows)} of its rows are finite; its run was {recording.outcome.status}"
            raise RecordingError("too short to tell anything", why=why, fix="run longer", file=recording.path)
        return cls(
            recording,
            robot,
            msgspec.convert(recording.meta["kinematic"], Kinematic),
            msgspec.convert(recording.meta["time"], Timing),
            rows,
        )

    @property
    def layout(self) -> Layout:
        """Where the signals stand in the rows; those of wheels' contacts are left out."""
        return self.robot.layout

    @property
    def controller(self) -> str:
        """Name of the controller."""
        return str(self.recording.meta.get("controller", "the controller"))

    @property
    def plant(self) -> str:
        """`ideal` or `contact`."""
        return str(self.recording.meta.get("plant", "ideal"))

    @property
    def exact_sensors(self) -> bool:
        """Whether the controller was told the true state at every control sample."""
        every = self.timing.steps_per_control % self.timing.steps_per_measurement == 0
        return "sensor" not in self.recording.meta and not self.given.senses and every

    @cached_property
    def learner(self) -> Learner | None:
        """The learner, or None where the controller of the run has none; errors as in `recorded_learner`."""
        return recorded_learner(self.recording, self.robot)

    @property
    def networks(self) -> Networks | None:
        """The learner where it is one of the thesis, networks alone; None otherwise; errors as of `learner`."""
        found = self.learner
        return found if isinstance(found, Networks) and isinstance(found.controller, Neural) else None

    @cached_property
    def given(self) -> Given:
        """What motors, pushes and a payload gave to the robot."""
        return Given.of(self.recording, self.robot, self.timing)

    @cached_property
    def _dynamics(self) -> tuple[Dynamics, Dynamics]:
        return Dynamics(self.robot), Dynamics(self.given.loaded or self.robot)

    def dynamics(self, time: float) -> Dynamics:
        """Pinocchio's dynamics of the robot in the control period that begins at a time [s]."""
        return self._dynamics[int(time + 5e-10 >= self.given.pick)]

    def truth(self, rows: Array) -> Array:
        """Rows as they were if the sensors told the true state: measurement, command, errors and Psi of the truth."""
        if self.exact_sensors:
            return rows
        rows, layout, arm = rows.copy(), self.layout, self.robot.arm_index
        gains, K = self.kinematic.base_gains(layout.base), self.kinematic.arm_gains(layout)
        for row in rows:
            position, nu = row[layout.where("position")], row[layout.where("nu")]
            exact(row, layout.offsets, position, nu, arm)
            command(row, layout.offsets, gains, K)
            nu_ref, nudot_ref, psi = (row[layout.where(name)] for name in ("nu_ref", "nudot_ref", "psi"))
            dynamics = self.dynamics(float(row[layout.where("time")][0]))
            dynamics.refresh(position, nu)
            dynamics.refresh_psi(nu_ref, nudot_ref, psi)
        return rows

    def signal(self, name: str) -> Array:
        """A signal of the run, (N, size)."""
        return self.rows[:, self.layout.where(name)]


def require_signals(recording: Recording) -> None:
    """Refuse a recording without the signals that everything here is made of.

    Raises:
        RecordingError: With the name of the first that is missing.
    """
    for name in NEEDED:
        if name not in recording:
            why = f"the signal '{name}' is not in the recording, as in one from outside a simulation"
            raise RecordingError("no truth to compare with", why=why, file=recording.path)


def finite_rows(recording: Recording, layout: Layout) -> Array:
    """Rows of a recording, (N, width), up to the first one that is not finite."""
    rows = np.zeros((len(recording), layout.width))
    for name in recording:
        where = layout.where(name)
        if where.stop > where.start:
            rows[:, where] = recording[name].reshape(len(recording), where.stop - where.start)
    bad = np.flatnonzero(~np.isfinite(rows).all(axis=1))
    return rows[: bad[0]] if len(bad) else rows
