"""The ordinary loop: Pinocchio does the dynamics, the blocks between are compiled, a controller may be plain Python."""

from __future__ import annotations

import time as clock
from typing import TYPE_CHECKING, Any

import numpy as np

from .disturbance.effects import BRAKE, EARLY, mark
from .errors import ConfigError
from .model.dynamics import Dynamics
from .model.robot import Robot
from .plant.contact.plant import ContactPlant
from .plant.ideal import IdealPlant
from .rig import Rig, act, is_stopped, new_rig, note, send, sense
from .safety import TRIPPED, has_ended
from .sample import after_torque, before_torque
from .sensing import exact
from .signals import Array, Measurement, Reference, VelocityCommand
from .torque import law
from .torque.controller import CompiledController, Memory, TorqueController, Wiring

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
        rig_memory: The memory of sensors, motors and supervisor; None for a new one.
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
        self, loop: Loop, table: Array, position: Array, nu: Array, memory: Any, rig_memory: Array | None, block: int
    ) -> None:
        layout = loop.robot.layout
        self.loop, self.table, self.at = loop, table, layout.offsets
        self.row, self.rows, self.step_times = layout.new_row(), np.zeros((block, layout.width)), np.zeros(block)
        self.counter = np.zeros(1, np.int64)
        self.memory = memory
        self.torque = Torque(loop.controller, loop.wiring(), self.row, loop.nominal or loop.robot, memory)
        self.plant = plant_of(loop)
        self.plant.start(position, nu)
        self.y, self.loaded = self.plant.y, loop.loaded()
        self.rig = new_rig(loop, nu, memory, rig_memory)
        self.gains, self.K = loop.kinematic.base_gains(layout.base), loop.kinematic.arm_gains(layout)
        self.bounds, self.E_inv = loop.bounds.vector(layout), np.ascontiguousarray(np.linalg.pinv(loop.robot.E))
        self.start_energy = self.energy()
        self.weights = memory.values if isinstance(memory, Memory) else np.zeros(0)
        names = ("torque", "nu_ref", "nudot_ref", "psi")
        self.tau, self.nu_ref, self.nudot_ref, self.psi = (self.row[layout.where(name)] for name in names)

    @property
    def rig_memory(self) -> Array:
        """What sensors, motors and supervisor remember."""
        return np.zeros(0) if self.rig is None else self.rig.memory

    def measure(self, number: int, rig: Rig) -> None:
        """Take the measurement of this number."""
        position, nu, arm = self.plant.position, self.plant.nu, self.loop.robot.arm_index
        sense(number, number * self.loop.timing.measurement_period, self.row, self.at, position, nu, arm, rig)

    def advance(self, first: int, last: int) -> int:
        """Run control samples first ... last - 1, or fewer when that takes long.

        Returns:
            -1, or the column of `row` that went bad; the samples before are in `rows`.
        """
        loop, row, plant, rig = self.loop, self.row, self.plant, self.rig
        timing, arm, h = loop.timing, loop.robot.arm_index, loop.timing.control_period
        steps, per_measurement = timing.steps_per_control, timing.steps_per_measurement
        at, table, gains, K, E_inv = self.at, self.table, self.gains, self.K, self.E_inv
        started = clock.perf_counter()
        for k in range(first, last):
            began = clock.perf_counter()
            now = k * steps % per_measurement == 0
            if rig is not None:
                self.pick_up(k * h, rig)
                if now:
                    self.measure(k * steps // per_measurement, rig)
            before_torque(row, at, k * h, plant.y, table[k], now and rig is None, arm, gains, K)
            plant.observe(row)
            if rig is None or not is_stopped(rig):
                self.torque.step(k * h)
            if rig is not None:
                send(k, k * h, row, at, self.weights, rig)
            step_time = clock.perf_counter() - began
            dynamics = plant.dynamics
            dynamics.refresh_psi(self.nu_ref, self.nudot_ref, self.psi)
            potential, work = dynamics.potential(), plant.y[-1]
            start_energy = self.start_energy if rig is None else self.start_energy + rig.shift[0]
            bad = after_torque(row, at, dynamics.M, E_inv, potential, work, start_energy, self.bounds)
            if bad >= 0:
                return bad
            done = k - first
            self.rows[done], self.step_times[done], self.counter[0] = row, step_time, done + 1
            for i in range(steps):
                n = k * steps + i
                if i > 0 and n % per_measurement == 0:
                    if rig is None:
                        exact(row, at, plant.position, plant.nu, arm)
                    else:
                        self.measure(n // per_measurement, rig)
                if rig is None:
                    plant.step(self.tau)
                else:
                    self.act(k, n * timing.plant_step, rig)
                plant.refresh()
            if rig is not None:
                note(steps, self.rows[done], at, rig)
                if rig.supervised and has_ended(k * h, rig.limits, rig.guard):
                    return TRIPPED
            if began - started > PATIENCE:
                break
        return -1

    def act(self, k: int, time: float, rig: Rig) -> None:
        """One step of the plant with imperfect motors, pushes and blocked joints."""
        plant, dt = self.plant, self.loop.timing.plant_step
        plant.motor_speeds(rig.speed)
        act(k, time, dt, self.row, self.at, rig)
        mark(time, rig.blocked, plant.hold, BRAKE)
        plant.step(rig.tau, rig.force)

    def pick_up(self, time: float, rig: Rig) -> None:
        """Carry the payload once its time has come; what energy comes with it is no error of the balance."""
        if self.loaded is None or time + EARLY < rig.pick:
            return
        plant, before = self.plant, self.energy()
        plant.carry(self.loaded)
        self.loaded = None
        if rig.shift[1] == 0.0:
            rig.shift[0], rig.shift[1] = self.energy() - before, 1.0

    def energy(self) -> float:
        """Kinetic and potential energy at the plant's state [J]."""
        dynamics, nu = self.plant.dynamics, self.plant.nu
        return float(0.5 * nu @ dynamics.M @ nu) + dynamics.potential()


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
