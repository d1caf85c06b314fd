"""One control sample, from reference and measurement to the torque that is sent, in the ordinary loop and outside."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .errors import ConfigError
from .model.dynamics import Dynamics
from .model.robot import Robot
from .rig import Rig, is_stopped, send
from .sample import before_torque, estimate
from .signals import Array, Measurement, Reference, VelocityCommand
from .torque import law
from .torque.controller import CompiledController, Memory, TorqueController, Wiring
from .torque.linear import keep_torque, learn

if TYPE_CHECKING:
    from .loop import Loop


class Control:
    """Kinematic layer, controller and supervisor wired to one row.

    Args:
        loop: The closed loop.
        row: The row that they read and write.
        memory: The controller's memory.
        rig: With the supervisor, or None.
    """

    def __init__(self, loop: Loop, row: Array, memory: Any, rig: Rig | None) -> None:
        layout = loop.robot.layout
        self.row, self.at, self.rig, self.arm = row, layout.offsets, rig, loop.robot.arm_index
        self.torque = Torque(loop.controller, loop.wiring(), row, loop.nominal or loop.robot, memory)
        self.gains, self.K = loop.kinematic.base_gains(layout.base), loop.kinematic.arm_gains(layout)
        self.weights = memory.values if isinstance(memory, Memory) else np.zeros(0)

    def step(self, k: int, time: float, y: Array, reference: Array, measure_exactly: bool) -> None:
        """Write everything of control sample k up to the torque into the row.

        Args:
            k: Number of the sample.
            time: [s].
            y: The plant's position and nu, (nv + p + 1,).
            reference: The sample's row of the reference table.
            measure_exactly: Measure that state, else the row already has the measurement.
        """
        before_torque(self.row, self.at, time, y, reference, measure_exactly, self.arm, self.gains, self.K)
        asked = self.rig is None or not is_stopped(self.rig)
        if asked:
            self.torque.step(time)
        if self.rig is not None:
            send(k, time, self.row, self.at, self.weights, self.rig)
            if asked:
                self.torque.keep()


class Torque:
    """One controller wired to one row; the same face for compiled and for Python controllers.

    Args:
        controller: The controller.
        wiring: What it is told before the run.
        row: The row it reads and writes.
        nominal: The robot that a model-based controller believes in.
        memory: Its memory.
    """

    def __init__(
        self,
        controller: TorqueController | CompiledController,
        wiring: Wiring,
        row: Array,
        nominal: Robot,
        memory: Any,
    ) -> None:
        layout = wiring.layout
        self.controller, self.memory, self.row, self.at = controller, memory, row, layout.offsets
        self.reference, self.measurement = Reference.of(row, layout), Measurement.of(row, layout)
        self.command = VelocityCommand.of(row, layout)
        self.torque, self.psi_hat = row[layout.where("torque")], row[layout.where("psi_hat")]
        self.model: Dynamics | None = None
        self.python = controller if isinstance(controller, TorqueController) else None
        if isinstance(controller, CompiledController):
            self.law = controller.law(wiring)
            if controller.uses_model:
                self.model, self.arm_index = Dynamics(nominal), nominal.arm_index
                self.position, self.nu = nominal.neutral_position(), np.zeros(layout.dof)

    def step(self, time: float) -> None:
        """Write psi_hat, robust, effective_gain and torque of this sample into the row."""
        if self.python is not None:
            torque = self.python.step(time, self.reference, self.measurement, self.command, self.memory)
            if np.shape(torque) != self.torque.shape:
                raise ConfigError(
                    f"controller '{self.controller.name}' returned a torque of shape {np.shape(torque)}",
                    fix=f"return an array of shape {self.torque.shape}",
                )
            self.torque[:] = torque
            return
        if self.model is not None:
            self._model_psi(self.model)
        if self.law.adaptation is not None:
            estimate(self.row, self.at, self.law.adaptation, self.memory.values)
        if (a := self.law.linear) is not None:
            learn(self.row, self.at, a, a.known, a.random, self.memory.values)
        law.step(self.law.kind, self.row, self.at, self.law.sizes, self.law.settings, self.memory.values)
        self.keep()

    def keep(self) -> None:
        """Let a linear learner remember the torque in the row: the one of the law, or what a supervisor made of it."""
        if self.python is None and self.law.linear is not None:
            keep_torque(self.row, self.at, self.law.linear, self.memory.values)

    def _model_psi(self, model: Dynamics) -> None:
        """Psi of the nominal model at the measured state, into psi_hat."""
        measured, nb = self.measurement, self.measurement.velocity.size
        self.position[: measured.pose.size] = measured.pose
        self.position[self.arm_index] = measured.q
        self.nu[:nb], self.nu[nb:] = measured.velocity, measured.qdot
        model.refresh(self.position, self.nu)
        model.refresh_psi(self.command.nu_ref, self.command.nudot_ref, self.psi_hat)
