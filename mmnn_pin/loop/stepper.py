"""One control sample at a time, with measurements and setpoints from outside: the blocks of a loop, in real time.

Time is an argument here, too: pacing and messages are the caller's (`examples/realtime`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..actuator import Actuator
from ..errors import ConfigError
from ..recording.recorder import Recorder
from ..recording.recording import Outcome, Recording, Status
from ..safety import HAS_TRIPPED, accept, has_ended, remarks, trip_of
from ..safety.supervisor import GOOD, HEARD
from ..sensing import Sensor
from ..signals import SIGNALS, Array, Measurement, Setpoint
from ..torque.controller import CompiledController, ControllerState
from ..torque.learning_law import LearningLaw
from .before_run import require_nominal
from .controller import with_findings
from .loop import Loop
from .new_hardware import new_hardware
from .sample import Control

# What only a simulated plant knows; a recording from outside does not have these signals.
UNKNOWN = (
    "position", "nu", "true_pose_error", "true_z", "true_e", "psi", "applied", "disturbance",
    "energy", "work", "energy_residual",
)  # fmt: skip
KNOWN = [name for name, *_ in SIGNALS if name not in UNKNOWN]
MEASURED = ("pose", "velocity", "q", "qdot")
LARGEST = 1e9  # a measurement or a setpoint beyond this is none [SI units]


class Stepper:
    """A kinematic layer, a controller and a supervisor, one control sample per call.

        with Stepper(loop, "run.h5") as stepper:
            for k in range(stepper.samples):
                torque = stepper.step(k * period, measurement)  # send it, then
                stepper.record()
            recording = stepper.finish()

    Setpoints come one by one, `step(time, measurement, setpoint)`, for as long as there are any, or from the loop's
    trajectory where none are given.

    `step` does not touch the disk, and everything it calls has been compiled before the first one. What the loop
    simulates, that is its plant, sensors, motors and disturbances, is left out.

    Args:
        loop: The closed loop; it needs a supervisor. Its duration ends the trajectory, not setpoints that are given.
        path: File for the recording; None keeps it in memory.
        force: Replace an existing file.
        meta: More facts for the recording.
        state: A controller's state to start from (it is copied); None for a new one.

    Attributes:
        samples: How many control samples the trajectory has.
        period: Time between two of them [s].
        torque: (p,) generalized torque of the last sample [N, N m for the base; N m or N for the arm].
        motor_torque: (motors,) the same at the motors [N m or N].
        row: (width,) all signals of the last sample; those of `UNKNOWN` mean nothing.
        state: The controller's state.
        step_time: Wall-clock time that the last step took [s].

    Raises:
        ConfigError: No supervisor; what `Loop.run` refuses.
        TrajectoryError: A reference that the base cannot follow.
        RecordingError: The recording cannot be written.
    """

    def __init__(
        self,
        loop: Loop,
        path: str | Path | None = None,
        *,
        force: bool = False,
        meta: Mapping[str, Any] | None = None,
        state: Any = None,
    ) -> None:
        if loop.safety is None:
            why, fix = "the motors are real: something must stand before them", "give the loop safety=Safety()"
            raise ConfigError("a stepper without a supervisor", why=why, fix=fix, key="safety")
        self.loop = replace(loop, plant="ideal", sensor=Sensor(), actuator=Actuator(), disturbances=())
        self.loop.require_stable_gains()
        require_nominal(self.loop.believed, self.loop.robot)
        plan, layout, timing = self.loop.plan(), self.loop.layout, self.loop.timing
        self.table, self.state = plan.setpoints, self.loop.state_from(state)
        self.samples, self.period = timing.samples, timing.control_period
        hardware = new_hardware(self.loop, np.zeros(layout.dof), self.state)
        assert hardware is not None
        self.hardware, self.row, self.at = hardware, layout.new_row(), layout.offsets
        self.control = Control(plan, self.row, self.state, self.hardware)
        self.torque, self.motor_torque = self.row[layout.where("torque")], self.row[layout.where("motor_torque")]
        self.received = self.row[layout.where("pose").start : layout.where("qdot").stop]
        self.measured = Measurement.of(self.row, layout)
        self.asked = np.zeros(self.table.shape[1])  # the setpoint that came last
        self.setpoint = Setpoint.side_by_side(self.asked, layout)
        self.time, self.k, self.step_time = -math.inf, -1, 0.0
        self.every, self.weighed = max(1, round(self.loop.weights_interval / self.period)), -1
        self._rehearse()
        facts = {name: fact for name, fact in self.loop.facts().items() if name != "plant"} | {"loop": "outside"}
        self.recorder = Recorder(layout, facts | dict(meta or {}), path, force, KNOWN)
        self._weigh(0)

    def step(
        self,
        time: float,
        measurement: Measurement | None = None,
        setpoint: Setpoint | None = None,
        *,
        measured: float | None = None,
    ) -> Array:
        """One control sample: setpoint -> kinematic -> torque -> safety.

        Without a measurement the last one is held, until the supervisor finds it too old. One that is not finite is
        refused and counted, one older than the last is ignored. Before the first the torque is zero.

        Args:
            time: Since the start [s], larger than at the last call.
            measurement: What came in since the last call, or None.
            setpoint: What the robot should do now; None for the trajectory's sample nearest in time.
            measured: When the measurement was taken [s], at most `time`; None for now.

        Returns:
            The torque (p,), a view that the next call overwrites.

        Raises:
            ConfigError: A time not after the last one, or outside the trajectory where no setpoint is given; a
                measurement or a setpoint of another robot, a setpoint that is not finite.
        """
        began, time = perf_counter(), float(time)
        k = self._sample(time, setpoint is None)
        if setpoint is not None:
            _copy("setpoint", setpoint, self.setpoint)
            if not (np.abs(self.asked) < LARGEST).all():
                raise ConfigError("a setpoint that is not finite", fix="give finite numbers", key="setpoint")
        if measurement is not None:
            self._take(measurement, time, time if measured is None else measured)
        self.control.step(time, self.table[k] if setpoint is None else self.asked)
        self.motor_torque[:] = self.hardware.totals.command
        self.time, self.k = time, k
        self.step_time = perf_counter() - began
        return self.torque

    def record(self) -> None:
        """Add the last sample to the recording; call it once the torque is sent: now and then it writes to the disk.

        Raises:
            RecordingError: The file cannot be written; the rows already in it can be read.
        """
        self.recorder.append(self.row, self.step_time)
        if (self.k + 1) // self.every > self.weighed // self.every:
            self._weigh(self.k + 1)

    @property
    def tripped(self) -> bool:
        """Whether the supervisor has stopped the run."""
        return bool(self.hardware.supervisor.state[HAS_TRIPPED])

    @property
    def is_over(self) -> bool:
        """Whether the supervisor has stopped the run and shown its stop for `safety.stop_time`."""
        return bool(has_ended(self.time, self.hardware.supervisor.numbers, self.hardware.supervisor.state))

    def finish(
        self, status: Status = "completed", message: str = "", extra: Mapping[str, ArrayLike] | None = None
    ) -> Recording:
        """Close the recording; a run that the supervisor stopped is `tripped`, whatever the status says.

        Args:
            status: How it ended otherwise.
            message: What else to tell of it.
            extra: More arrays for the recording's `final`.

        Raises:
            RecordingError: The file cannot be written; the rows already in it can be read.
        """
        outcome = Outcome(status, (self.k + 1) * self.period)
        if self.tripped:
            outcome = Outcome("tripped", *trip_of(self.hardware.supervisor.state, self.loop.robot))
        found = remarks(self.hardware.supervisor.state, self.loop.robot, outcome.status)
        outcome = replace(outcome, message="; ".join(text for text in (outcome.message, *found, message) if text))
        if self.weighed < self.k + 1:
            self._weigh(self.k + 1)
        final = {"hardware_state": self.hardware.state, **(extra or {})}
        final |= {"controller_state": self.state.values} if isinstance(self.state, ControllerState) else {}
        return self.recorder.finish(with_findings(outcome, self.loop.controller, self.state), final)

    def __enter__(self) -> Stepper:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.recorder.__exit__(kind, error, traceback)

    def _sample(self, time: float, in_table: bool) -> int:
        """Number of the sample nearest to a time, which must be in the trajectory's table where that is read."""
        end = (self.samples - 1) * self.period if in_table else math.inf
        if not (self.time < time < math.inf and 0.0 <= time / self.period < end / self.period + 0.5):
            what = f"a control sample at t = {time:g} s"
            why = f"the last one was at {self.time:g} s, the reference goes from 0 to {end:g} s"
            raise ConfigError(what, why=why, fix="go forward in time, or set a longer time.duration", key="time")
        return round(time / self.period)

    def _take(self, measurement: Measurement, time: float, measured: float) -> None:
        """Put a measurement into the row and before the supervisor."""
        old = self.hardware.supervisor.state[GOOD] > 0.0 and measured < self.hardware.supervisor.state[HEARD]
        if old:
            return
        _copy("measurement", measurement, self.measured)
        if math.isnan(measured) or not (np.abs(self.received) < LARGEST).all():
            self.received[0] = np.nan
        when = min(float(measured), time)  # what is old is no basis for a stop by feedback, even if it came just now
        supervisor = self.hardware.supervisor
        accept(self.row, self.at, when, when, True, supervisor.message, supervisor.state)

    def _weigh(self, k: int) -> None:
        """Record the weights as they are before control sample k."""
        self.weighed = k
        if weights := self.loop.controller.weights(self.state):
            self.recorder.weights(k * self.period, weights)

    def _rehearse(self) -> None:
        """Compile all that a step calls, and forget it."""
        kept = self.hardware.state.copy(), self.control.weights.copy()
        supervisor = self.hardware.supervisor
        accept(self.row, self.at, 0.0, 0.0, True, supervisor.message, supervisor.state)
        if isinstance(self.loop.controller, CompiledController | LearningLaw):
            self.control.step(0.0, self.table[0])
        has_ended(0.0, supervisor.numbers, supervisor.state)
        self.hardware.state[:], self.control.weights[:], self.row[:] = *kept, 0.0


def _copy(key: str, given: Measurement | Setpoint, into: Measurement | Setpoint) -> None:
    """Copy all arrays of a record, or none.

    Raises:
        ConfigError: One has another shape.
    """
    for name in given.__slots__:
        values, mine = getattr(given, name), getattr(into, name)
        if values.shape != mine.shape:
            what, fix = f"a {key} with {name} of shape {values.shape}", f"give one of shape {mine.shape}"
            raise ConfigError(what, fix=fix, key=key)
    for name in given.__slots__:
        getattr(into, name)[:] = getattr(given, name)
