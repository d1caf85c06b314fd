"""The compiled loop: the ordinary loop's blocks without Python between the steps.

The dynamics come from the flattened tree (`model/tree`); everything else is the same functions that the ordinary
loop calls. The two agree to rounding.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..model.reduction import quadratic
from ..model.tree.body import body_of, evaluate, new_work
from ..model.tree.dynamics import potential_energy
from ..plant.integrators import METHODS
from ..signals import Array
from ..torque.controller import CompiledController
from .compiled_steps import Blocks, Plan, advance
from .new_hardware import new_hardware

if TYPE_CHECKING:
    from .loop import Loop


class CompiledLoop:
    """A loop without Python between the steps; attributes and arguments as in `OrdinaryLoop`.

    Raises:
        RobotError: The robot has a joint that cannot be flattened.
    """

    name = "compiled"

    def __init__(
        self, loop: Loop, table: Array, position: Array, nu: Array, state: Any, hardware_state: Array | None, block: int
    ) -> None:
        assert isinstance(loop.controller, CompiledController)
        robot, layout, timing = loop.robot, loop.robot.layout, loop.timing
        self.row, self.rows, self.step_times = layout.new_row(), np.zeros((block, layout.width)), np.zeros(block)
        self.counter, self.state = np.zeros(1, np.int64), state
        self.y = np.concatenate((position, nu, [0.0]))
        self.body = body_of(robot)
        self.work = new_work(self.body)
        uses_model = loop.controller.uses_model
        nominal = loop.believed
        self.nominal = body_of(nominal) if uses_model else self.body
        self.nominal_work = new_work(self.nominal)
        self.nominal_y = np.concatenate((nominal.neutral_position(), np.zeros(layout.dof + 1)))
        context = loop.context()
        law = loop.controller.law(context)
        self.learner, self.limits = law.learner, context.limits
        self.hardware, loaded = new_hardware(loop, nu, state, hardware_state), loop.loaded()
        self.loaded = self.body if loaded is None else body_of(loaded)
        self.blocks = Blocks(
            at=layout.offsets,
            table=table,
            gains=loop.kinematic.base_gains(layout.base),
            K=loop.kinematic.arm_gains(layout),
            law=law.numbers,
            E_inv=np.ascontiguousarray(np.linalg.pinv(robot.E)),
            bounds=loop.bounds.vector(layout),
        )
        self.plan = Plan(
            h=timing.control_period,
            dt=timing.plant_step,
            steps=timing.steps_per_control,
            per_measurement=timing.steps_per_measurement,
            method=METHODS[timing.integrator],
            uses_model=uses_model,
            start_energy=self._energy(position, nu),
        )

    @property
    def hardware_state(self) -> Array:
        """What sensors, motors and supervisor remember."""
        return np.zeros(0) if self.hardware is None else self.hardware.state

    def advance(self, first: int, last: int) -> int:
        """Run control samples first ... last - 1; -1, the column of `row` that went bad, or `TRIPPED`."""
        return advance(
            first, last, self.counter, self.rows, self.row, self.blocks, self.plan, self.state.values, self.body,
            self.loaded, self.work, self.nominal, self.nominal_work, self.nominal_y, self.y, self.hardware,
            self.learner, self.limits,
        )  # fmt: skip

    def _energy(self, position: Array, nu: Array) -> float:
        """Kinetic and potential energy at the start [J]; `energy_of` would be compiled for this one call."""
        evaluate(self.body, self.work, position, nu)
        potential = potential_energy(self.body.tree, position, self.work.scratch) if self.body.feels_gravity else 0.0
        return 0.5 * quadratic(self.work.M, nu) + potential
