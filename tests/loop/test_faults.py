"""Every fault of `mmnn run faults` through a stepper: what the loop's controller and supervisor do, it does.

The loop simulates sensors, motors and what is wrong with them; beside it a stepper hears the same messages, with the
times at which they were measured, and is asked for every command.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from mmnn_pin import load_experiment
from mmnn_pin.lab.experiments.cases import with_case
from mmnn_pin.loop.ordinary import OrdinaryLoop
from mmnn_pin.loop.stepper import Stepper
from mmnn_pin.sensing.effects import RECEIVED
from mmnn_pin.signals import Array, Measurement, Setpoint

EVERY = load_experiment("faults")
ON_THE_WAY = (
    "command_lost",
    "command_pause",
    "command_nan",
    "command_nan_forever",
)  # after a stepper: the robot's side
CASES = [name for name in EVERY.cases if name not in ON_THE_WAY]


class Beside:
    """The control sample of an engine, and a stepper that is asked with the same messages first.

    Args:
        engine: Of the loop.
        stepper: Of the same loop.
    """

    def __init__(self, engine: OrdinaryLoop, stepper: Stepper) -> None:
        self.engine, self.stepper, self.own, self.last = engine, stepper, engine.control, -1.0
        self.layout, self.different = engine.plan.layout, list[float]()

    def step(self, time: float, setpoint: Array, k: int, before: Array) -> None:
        """See `Control.step`."""
        hardware, d = self.engine.hardware, self.layout
        assert hardware is not None
        message, when = self.engine.row[d.where("pose").start : d.where("qdot").stop], time
        if not hardware.exact:
            wire = hardware.sensors.wire
            message, when = wire.received, float(wire.clock[RECEIVED]) * hardware.sensors.period
        ends = np.cumsum([d.pose, d.base, d.arm])
        heard = Measurement(*np.split(message.copy(), ends)) if when > self.last or k == 0 else None
        self.last = when
        wanted = Setpoint.side_by_side(setpoint, d)
        one = Setpoint(*(getattr(wanted, name).copy() for name in Setpoint.__slots__))
        command = self.stepper.step(time, heard, one, measured=min(when, time))
        self.own.step(time, setpoint, k, before)
        tripped = hardware.way.supervisor.state.tripped[0] > 0.0
        if not tripped and command.effort.tolist() != self.engine.row[d.where("torque")].tolist():
            self.different.append(time)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.own, name)


def compared(case: str, controller: str) -> None:
    """Run a case with a stepper beside it."""
    experiment = with_case(EVERY, case)
    robot = experiment.load_robot()
    loop = replace(experiment.loop(robot, experiment.controller(controller, robot=robot)), engine="ordinary")
    engine = loop.engine_at()
    assert isinstance(engine, OrdinaryLoop)
    with Stepper.of(loop) as stepper:
        beside = engine.control = Beside(engine, stepper)  # type: ignore[assignment]
        outcome = loop.stream(engine, Nothing())
        assert stepper.tripped == (outcome.status == "tripped")
        assert not beside.different, beside.different[:3]
        if stepper.tripped:
            found = stepper.finish().outcome
            assert found.time == pytest.approx(outcome.time, abs=1e-9) and found.signal == outcome.signal


class Nothing:
    """A sink that keeps nothing."""

    def append_block(self, rows: Array, step_times: Array) -> None:
        """No rows."""

    def weights(self, time: float, arrays: Any) -> None:
        """No weights."""


@pytest.mark.long
@pytest.mark.parametrize("controller", ["pd", "two_layer"])
@pytest.mark.parametrize("case", CASES)
def test_a_stepper_does_in_every_fault_what_the_loop_does(case: str, controller: str) -> None:
    compared(case, controller)
