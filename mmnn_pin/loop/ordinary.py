"""The ordinary loop: Pinocchio does the dynamics, the blocks between are compiled, a controller may be plain Python."""

from __future__ import annotations

import time as clock
from typing import TYPE_CHECKING, Any

import numpy as np

from ..disturbance import block
from ..plant import Plant
from ..plant.contact.plant import ContactPlant
from ..plant.ideal import IdealPlant
from ..safety import TRIPPED, has_ended
from ..sensing import exact
from ..signals import EARLY, Array
from .control import Control
from .hardware import Hardware, act, note, sense
from .new_hardware import new_hardware
from .sample import after_torque

if TYPE_CHECKING:
    from .loop import Loop

PATIENCE = 0.2  # [s] of wall clock after which a block of samples is handed over


class OrdinaryLoop:
    """A loop that steps through Python.

    Args:
        loop: The closed loop.
        table: Reference at every control sample.
        position: Where to start, (nv,).
        nu: With which velocity, (p,).
        state: The controller's memory.
        hardware_state: The memory of sensors, motors and supervisor; None for a new one.
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
        self, loop: Loop, table: Array, position: Array, nu: Array, state: Any, hardware_state: Array | None, block: int
    ) -> None:
        layout = loop.robot.layout
        self.loop, self.table, self.at = loop, table, layout.offsets
        self.row, self.rows, self.step_times = layout.new_row(), np.zeros((block, layout.width)), np.zeros(block)
        self.counter = np.zeros(1, np.int64)
        self.state = state
        self.plant = plant_of(loop)
        self.plant.start(position, nu)
        self.y, self.loaded = self.plant.y, loop.loaded()
        self.hardware = new_hardware(loop, nu, state, hardware_state)
        self.control = Control(loop, self.row, state, self.hardware)
        self.bounds, self.E_inv = loop.bounds.vector(layout), np.ascontiguousarray(np.linalg.pinv(loop.robot.E))
        self.start_energy = self.energy()
        names = ("torque", "nu_ref", "nudot_ref", "psi")
        self.tau, self.nu_ref, self.nudot_ref, self.psi = (self.row[layout.where(name)] for name in names)

    @property
    def hardware_state(self) -> Array:
        """What sensors, motors and supervisor remember."""
        return np.zeros(0) if self.hardware is None else self.hardware.state

    def measure(self, number: int, hardware: Hardware) -> None:
        """Take the measurement of this number."""
        position, nu, arm = self.plant.position, self.plant.nu, self.loop.robot.arm_index
        sense(number, number * self.loop.timing.measurement_period, self.row, self.at, position, nu, arm, hardware)

    def advance(self, first: int, last: int) -> int:
        """Run control samples first ... last - 1, or fewer when that takes long.

        Returns:
            -1, or the column of `row` that went bad; the samples before are in `rows`.
        """
        loop, row, plant, hardware = self.loop, self.row, self.plant, self.hardware
        timing, arm, h = loop.timing, loop.robot.arm_index, loop.timing.control_period
        steps, per_measurement = timing.steps_per_control, timing.steps_per_measurement
        at, table, E_inv = self.at, self.table, self.E_inv
        started = clock.perf_counter()
        for k in range(first, last):
            began = clock.perf_counter()
            now = k * steps % per_measurement == 0
            if hardware is not None:
                self.pick_up(k * h, hardware)
                if now:
                    self.measure(k * steps // per_measurement, hardware)
            self.control.step(k, k * h, plant.y, table[k], now and hardware is None)
            step_time = clock.perf_counter() - began
            plant.observe(row)
            dynamics = plant.dynamics
            dynamics.refresh_psi(self.nu_ref, self.nudot_ref, self.psi)
            potential, work = dynamics.potential(), plant.y[-1]
            start_energy = self.start_energy if hardware is None else self.start_energy + hardware.world.shift[0]
            bad = after_torque(row, at, dynamics.M, E_inv, potential, work, start_energy, self.bounds)
            if bad >= 0:
                return bad
            done = k - first
            self.rows[done], self.step_times[done], self.counter[0] = row, step_time, done + 1
            for i in range(steps):
                n = k * steps + i
                if i > 0 and n % per_measurement == 0:
                    if hardware is None:
                        exact(row, at, plant.position, plant.nu, arm)
                    else:
                        self.measure(n // per_measurement, hardware)
                if hardware is None:
                    plant.step(self.tau)
                else:
                    self.act(k, n * timing.plant_step, hardware)
                plant.refresh()
            if hardware is not None:
                note(steps, self.rows[done], at, hardware.totals)
                supervisor = hardware.supervisor
                if supervisor.on and has_ended(k * h, supervisor.numbers, supervisor.state):
                    return TRIPPED
            if began - started > PATIENCE:
                break
        return -1

    def act(self, k: int, time: float, hardware: Hardware) -> None:
        """One step of the plant with imperfect motors, pushes and blocked joints."""
        plant, world = self.plant, hardware.world
        plant.motor_speeds(hardware.motors.wire.joint)
        act(k, time, self.row, self.at, hardware)
        block(time, world.blocked, plant.hold)
        plant.step(hardware.tau, world.wire.force)

    def pick_up(self, time: float, hardware: Hardware) -> None:
        """Carry the payload once its time has come; what energy comes with it is no error of the balance."""
        if self.loaded is None or time + EARLY < hardware.world.pick:
            return
        plant, before = self.plant, self.energy()
        plant.carry(self.loaded)
        self.loaded = None
        shift = hardware.world.shift
        if shift[1] == 0.0:
            shift[0], shift[1] = self.energy() - before, 1.0

    def energy(self) -> float:
        """Kinetic and potential energy at the plant's state [J]."""
        dynamics, nu = self.plant.dynamics, self.plant.nu
        return float(0.5 * nu @ dynamics.M @ nu) + dynamics.potential()


def plant_of(loop: Loop) -> Plant:
    """The plant that a loop asks for.

    Raises:
        ConfigError: The contact plant, and MuJoCo is not installed.
        RobotError: The contact plant, and a robot that it cannot carry.
    """
    timing = loop.timing
    if loop.plant == "contact":
        return ContactPlant(loop.robot, timing.plant_step, timing.integrator, loop.contact)
    return IdealPlant(loop.robot, timing.plant_step, timing.integrator)
