"""One control sample at a time, from measurements that come from outside: the same blocks as in a loop, in real time.

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
from ..signals import SIGNALS, Array, Measurement
from ..torque.controller import CompiledController, ControllerState
from ..torque.learning_law import LearningLaw
from .before_run import require_nominal, require_stable_gains
from .control import Control
from .controller_state import told_with
from .loop import Loop
from .new_hardware import new_hardware

# What only a simulated plant knows; a recording from outside does not have these signals.
UNKNOWN = (
    "position", "nu", "true_pose_error", "true_z", "true_e", "psi", "applied", "disturbance",
    "energy", "work", "energy_residual",
)  # fmt: skip
KNOWN = [name for name, *_ in SIGNALS if name not in UNKNOWN]
MEASURED = ("pose", "velocity", "q", "qdot")
LARGEST = 1e9  # a measurement beyond this is none [SI units]


class Cycle:
    """A controller with its reference, kinematic layer and supervisor, one control sample per call.

        with Cycle(loop, "run.h5") as cycle:
            for k in range(cycle.samples):
                torque = cycle.step(k * period, measurement)  # send it, then
                cycle.record()
            recording = cycle.finish()

    `step` does not touch the disk, and everything it calls has been compiled before the first one. What the loop
    simulates, that is its plant, sensors, motors and disturbances, is left out.

    Args:
        loop: The closed loop; it needs a supervisor.
        path: File for the recording; None keeps it in memory.
        force: Replace an existing file.
        meta: More facts for the recording.
        state: A controller's memory to start from (it is copied); None for a new one.

    Attributes:
        samples: How many control samples the reference has.
        period: Time between two of them [s].
        torque: (p,) generalized torque of the last sample [N, N m for the base; N m or N for the arm].
        motor_torque: (motors,) the same at the motors [N m or N].
        row: (width,) all signals of the last sample; those of `UNKNOWN` mean nothing.
        state: The controller's memory.
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
            raise ConfigError("a cycle without a supervisor", why=why, fix=fix, key="safety")
        self.loop = replace(loop, plant="ideal", sensor=Sensor(), actuator=Actuator(), disturbances=())
        require_stable_gains(self.loop)
        require_nominal(self.loop)
        layout, timing = self.loop.robot.layout, self.loop.timing
        self.table, self.state = self.loop.table(), self.loop.state_from(state)
        self.samples, self.period = timing.samples, timing.control_period
        hardware = new_hardware(self.loop, np.zeros(layout.dof), self.state)
        assert hardware is not None
        self.hardware, self.row, self.at = hardware, layout.new_row(), layout.offsets
        self.control = Control(self.loop, self.row, self.state, self.hardware)
        self.torque, self.motor_torque = self.row[layout.where("torque")], self.row[layout.where("motor_torque")]
        self.received = self.row[layout.where("pose").start : layout.where("qdot").stop]
        self.measured = Measurement.of(self.row, layout)
        self.nothing = np.zeros(layout.full + layout.dof + 1)  # of the true state
        self.time, self.k, self.step_time = -math.inf, -1, 0.0
        self.every, self.weighed = max(1, round(self.loop.weights_interval / self.period)), -1
        self._rehearse()
        facts = {name: fact for name, fact in self.loop.facts().items() if name != "plant"} | {"loop": "outside"}
        self.recorder = Recorder(layout, facts | dict(meta or {}), path, force, KNOWN)
        self._weigh(0)

    def step(self, time: float, measurement: Measurement | None = None, measured: float | None = None) -> Array:
        """One control sample.

        Without a measurement the last one is held, until the supervisor finds it too old. One that is not finite is
        refused and counted, one older than the last is ignored. Before the first the torque is zero.

        Args:
            time: Since the start [s], larger than at the last call; the reference is that of the nearest sample.
            measurement: What came in since the last call, or None.
            measured: When it was measured [s], at most `time`; None for now.

        Returns:
            The torque (p,), a view that the next call overwrites.

        Raises:
            ConfigError: A time outside the run or not after the last one, a measurement of another robot.
        """
        began, time = perf_counter(), float(time)
        k = self._sample(time)
        if measurement is not None:
            self._take(measurement, time, time if measured is None else measured)
        self.control.step(k, time, self.nothing, self.table[k], False)
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
        final = {"rig_memory": self.hardware.state, **(extra or {})}
        final |= {"memory": self.state.values} if isinstance(self.state, ControllerState) else {}
        return self.recorder.finish(told_with(outcome, self.loop.controller, self.state), final)

    def __enter__(self) -> Cycle:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.recorder.__exit__(kind, error, traceback)

    def _sample(self, time: float) -> int:
        """Number of the reference's sample nearest to a time."""
        if not (self.time < time and 0.0 <= time / self.period < self.samples - 0.5):
            what, end = f"a control sample at t = {time:g} s", (self.samples - 1) * self.period
            why = f"the last one was at {self.time:g} s, the reference goes from 0 to {end:g} s"
            raise ConfigError(what, why=why, fix="go forward in time, or set a longer time.duration", key="time")
        return round(time / self.period)

    def _take(self, measurement: Measurement, time: float, measured: float) -> None:
        """Put a measurement into the row and before the supervisor."""
        old = self.hardware.supervisor.state[GOOD] > 0.0 and measured < self.hardware.supervisor.state[HEARD]
        if old:
            return
        for name in MEASURED:
            values, mine = getattr(measurement, name), getattr(self.measured, name)
            if values.shape != mine.shape:
                what, fix = f"a measured {name} of shape {values.shape}", f"give one of shape {mine.shape}"
                raise ConfigError(what, fix=fix, key="measurement")
        for name in MEASURED:
            getattr(self.measured, name)[:] = getattr(measurement, name)
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
            self.control.step(0, 0.0, self.nothing, self.table[0], False)
        has_ended(0.0, self.hardware.supervisor.numbers, self.hardware.supervisor.state)
        self.hardware.state[:], self.control.weights[:], self.row[:] = *kept, 0.0
