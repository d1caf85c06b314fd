"""The ordinary loop: Pinocchio does the dynamics, the blocks between are compiled, a controller may be plain Python."""

from __future__ import annotations

import time as clock
from typing import TYPE_CHECKING, Any

import numpy as np

from .errors import ConfigError
from .model.dynamics import Dynamics
from .model.robot import Robot
from .plant.contact.plant import ContactPlant
from .plant.ideal import IdealPlant
from .sample import after_torque, before_torque
from .sensing import exact, measure
from .signals import Array, Measurement, Reference, VelocityCommand
from .torque import law
from .torque.controller import CompiledController, TorqueController, Wiring

if TYPE_CHECKING:
    from .loop import Loop

PATIENCE = 0.2  # [s] of wall clock after which a block of samples is handed over


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
        law.step(self.law.kind, self.row, self.at, self.law.sizes, self.law.settings, self.memory.values)

    def _model_psi(self, model: Dynamics) -> None:
        """Psi of the nominal model at the measured state, into psi_hat."""
        measured, nb = self.measurement, self.measurement.velocity.size
        self.position[: measured.pose.size] = measured.pose
        self.position[self.arm_index] = measured.q
        self.nu[:nb], self.nu[nb:] = measured.velocity, measured.qdot
        model.refresh(self.position, self.nu)
        model.refresh_psi(self.command.nu_ref, self.command.nudot_ref, self.psi_hat)


class OrdinaryLoop:
    """A loop that steps through Python.

    Args:
        loop: The closed loop.
        table: Reference at every control sample.
        position: Where to start, (nv,).
        nu: With which velocity, (p,).
        memory: The controller's memory.
        sensor_memory: The sensors' memory; None for a new one.
        block: Samples handed over at a time.

    Attributes:
        rows: Buffer for a block of samples.
        step_times: Wall-clock time from measurement to torque of each of them [s].
        counter: (1,) how many of them are done.
        y: The plant's position, nu and work.
        row: The row that is being computed.
    """

    name = "ordinary"

    def __init__(
        self, loop: Loop, table: Array, position: Array, nu: Array, memory: Any, sensor_memory: Array | None, block: int
    ) -> None:
        layout = loop.robot.layout
        self.loop, self.table, self.at = loop, table, layout.offsets
        self.row, self.rows, self.step_times = layout.new_row(), np.zeros((block, layout.width)), np.zeros(block)
        self.counter = np.zeros(1, np.int64)
        self.memory = memory
        self.torque = Torque(loop.controller, loop.wiring(), self.row, loop.nominal or loop.robot, memory)
        self.plant = plant_of(loop)
        self.plant.start(position, nu)
        self.y = self.plant.y
        self.exact, self.sensing, self.sensor_memory, self.noise = loop.sensors(sensor_memory)
        self.gains, self.K = loop.kinematic.base_gains(layout.base), loop.kinematic.arm_gains(layout)
        self.bounds, self.E_inv = loop.bounds.vector(layout), np.ascontiguousarray(np.linalg.pinv(loop.robot.E))
        self.start_energy = float(0.5 * nu @ self.plant.dynamics.M @ nu) + self.plant.dynamics.potential()
        names = ("torque", "nu_ref", "nudot_ref", "psi")
        self.tau, self.nu_ref, self.nudot_ref, self.psi = (self.row[layout.where(name)] for name in names)

    def measure(self, number: int) -> None:
        """Take the measurement of this number."""
        if self.exact:
            exact(self.row, self.at, self.plant.position, self.plant.nu, self.loop.robot.arm_index)
            return
        s = self.sensing
        measure(
            self.row, self.at, self.plant.position, self.plant.nu, s.encoders, s.W, s.numbers, self.noise[number],
            self.sensor_memory,
        )  # fmt: skip

    def advance(self, first: int, last: int) -> int:
        """Run control samples first ... last - 1, or fewer when that takes long.

        Returns:
            -1, or the column of `row` that went bad; the samples before are in `rows`.
        """
        loop, row, plant, dynamics = self.loop, self.row, self.plant, self.plant.dynamics
        timing, arm, h = loop.timing, loop.robot.arm_index, loop.timing.control_period
        steps, per_measurement = timing.steps_per_control, timing.steps_per_measurement
        at, table, gains, K, E_inv, exactly = self.at, self.table, self.gains, self.K, self.E_inv, self.exact
        bounds, start_energy = self.bounds, self.start_energy
        started = clock.perf_counter()
        for k in range(first, last):
            began = clock.perf_counter()
            now = k * steps % per_measurement == 0
            if now and not exactly:
                self.measure(k * steps // per_measurement)
            before_torque(row, at, k * h, plant.y, table[k], now and exactly, arm, gains, K)
            plant.observe(row)
            self.torque.step(k * h)
            step_time = clock.perf_counter() - began
            dynamics.refresh_psi(self.nu_ref, self.nudot_ref, self.psi)
            potential, work = dynamics.potential(), plant.y[-1]
            bad = after_torque(row, at, dynamics.M, E_inv, potential, work, start_energy, bounds)
            if bad >= 0:
                return bad
            done = k - first
            self.rows[done], self.step_times[done], self.counter[0] = row, step_time, done + 1
            for i in range(steps):
                if i > 0 and (k * steps + i) % per_measurement == 0:
                    self.measure((k * steps + i) // per_measurement)
                plant.step(self.tau)
                plant.refresh()
            if began - started > PATIENCE:
                break
        return -1


def plant_of(loop: Loop) -> IdealPlant | ContactPlant:
    """The plant that a loop asks for.

    Raises:
        ConfigError: The contact plant, and MuJoCo is not installed.
        RobotError: The contact plant, and a robot that it cannot carry.
    """
    timing = loop.timing
    if loop.plant == "contact":
        return ContactPlant(loop.robot, timing.plant_step, timing.integrator, loop.contact)
    return IdealPlant(loop.robot, timing.plant_step, timing.integrator)
