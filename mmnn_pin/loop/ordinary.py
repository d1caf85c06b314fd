"""The ordinary loop: it steps through Python, so a controller may be plain Python and the plant any.

The dynamics are those of the compiled twin, and the blocks those of the compiled loop: the same bits.
"""

from __future__ import annotations

import time as clock
from typing import Any

import numpy as np

from ..disturbance import block
from ..model.reduction import quadratic
from ..plant import Plant
from ..plant.contact.plant import ContactPlant
from ..plant.ideal import IdealPlant
from ..safety import TRIPPED, has_ended
from ..sensing import exact
from ..signals import Array
from .hardware import Hardware, act, load_at, look, note, push, see_world, sense, shift_energy, turn_motors
from .plan import Plan
from .sample import Control, after_torque

PATIENCE = 0.2  # [s] of wall clock after which a block of samples is handed over


class OrdinaryLoop:
    """A loop that steps through Python.

    Args:
        plan: Of the loop.
        position: Where to start, (nv,).
        nu: With which velocity, (p,).
        state: The controller's state.
        hardware: Sensors, motors, supervisor and disturbances; None for an ideal robot.

    Attributes:
        rows: Buffer for a block of samples.
        step_times: Wall-clock time from measurement to torque of each of them [s].
        counter: (1,) how many of them are done.
        y: The plant's position, nu and work.
        row: The row that is being computed.

    Raises:
        ConfigError: The contact plant, and MuJoCo is not installed.
        RobotError: The contact plant, and a robot that it cannot carry.
    """

    name = "ordinary"

    def __init__(self, plan: Plan, position: Array, nu: Array, state: Any, hardware: Hardware | None) -> None:
        layout = plan.layout
        self.plan, self.state, self.hardware, self.at = plan, state, hardware, layout.offsets
        self.row, self.rows, self.step_times = (
            layout.new_row(),
            np.zeros((plan.block, layout.width)),
            np.zeros(plan.block),
        )
        self.counter = np.zeros(1, np.int64)
        self.plant = plant_of(plan)
        self.plant.start(position, nu)
        self.y = self.plant.y
        self.control = Control(plan, self.row, state, hardware)
        self.places, self.E_inv, self.start_energy = plan.robot.measured_index, plan.E_inv, self.energy()
        names = ("torque", "nu_ref", "nudot_ref", "psi")
        self.tau, self.nu_ref, self.nudot_ref, self.psi = (self.row[layout.where(name)] for name in names)

    def advance(self, first: int, last: int) -> int:
        """Run control samples first ... last - 1, or fewer when that takes long.

        Returns:
            -1, the column of `row` that went bad, or `TRIPPED`; the samples before are in `rows`.
        """
        timing, hardware = self.plan.timing, self.hardware
        started = clock.perf_counter()
        for k in range(first, last):
            began, time = clock.perf_counter(), k * timing.control_period
            self.pick_up(time)
            self.measure(k * timing.steps_per_control)
            self.control.step(time, self.plan.setpoints[k], k, self.plan.setpoints[max(k - 1, 0)])
            step_time = clock.perf_counter() - began
            bad = self.observe()
            if bad >= 0:
                return bad
            done = k - first
            self.rows[done], self.step_times[done], self.counter[0] = self.row, step_time, done + 1
            self.move(k)
            if hardware is not None:
                note(timing.steps_per_control, self.rows[done], self.at, hardware.way.totals)
                supervisor = hardware.way.supervisor
                if supervisor.on and has_ended(time, supervisor.numbers, supervisor.state):
                    return TRIPPED
            if began - started > PATIENCE:
                break
        return -1

    def measure(self, step: int) -> None:
        """Write the measurement into the row, if one is due at this step of the plant."""
        number, rest = divmod(step, self.plan.timing.steps_per_measurement)
        if rest:
            return
        if self.hardware is None:
            exact(self.row, self.at, self.plant.position, self.plant.nu, self.places)
        else:
            time = number * self.plan.timing.measurement_period
            sense(number, time, self.row, self.at, self.plant.position, self.plant.nu, self.places, self.hardware)

    def observe(self) -> int:
        """Write into the row the signals of a sample that only a simulation knows; -1, or the column that went bad."""
        plant, dynamics = self.plant, self.plant.dynamics
        plant.observe(self.row, self.plan.layout)
        dynamics.refresh_psi(self.nu_ref, self.nudot_ref, self.psi)
        start = self.start_energy if self.hardware is None else self.start_energy + self.hardware.world.shift[0]
        potential, bounds = dynamics.potential(), self.plan.bounds
        numbers = potential, start, bounds, self.plan.hitch
        return after_torque(self.row, self.at, plant.y, self.places, dynamics.M, self.E_inv, *numbers)

    def move(self, k: int) -> None:
        """Motors and plant over the control period of sample k; the sensors go on measuring."""
        plant, timing, steps = self.plant, self.plan.timing, self.plan.timing.steps_per_control
        for i in range(steps):
            n = k * steps + i
            if i > 0:
                self.measure(n)
            if self.hardware is None:
                plant.step(self.tau)
            else:
                self.act(k, n * timing.plant_step, self.hardware)
            plant.refresh()

    def act(self, k: int, time: float, hardware: Hardware) -> None:
        """One step of the plant with imperfect motors, pushes and blocked joints."""
        plant, world = self.plant, hardware.world
        turn_motors(hardware, plant.dynamics.maps)
        plant.motor_speeds(hardware.motors.wire.joint)
        see_world(plant.position, plant.nu, plant.dynamics.maps, world)
        push(k, time, hardware)
        if hardware.split is not None:
            wire = hardware.motors.wire
            look(hardware, plant.position)
            plant.respond(hardware.tau, hardware.E, wire.free, wire.answer)
        act(k, time, self.row, self.at, hardware)
        if isinstance(plant, ContactPlant):
            plant.hand, plant.by_hand = world.wire.hand, world.wire.by_hand
        block(time, world.blocked, plant.hold)
        plant.step(hardware.tau, world.wire.force)

    def pick_up(self, time: float) -> None:
        """Carry the payload from its time to its end."""
        if self.plan.loaded is None or self.hardware is None:
            return
        world, loaded = self.hardware.world, self.plan.loaded
        if (load := load_at(time, world)) != world.shift[1]:
            before = self.energy()
            self.plant.carry(loaded if load == 1.0 else self.plan.true)
            gain = self.energy() - before
            shift_energy(load, gain if load == 1.0 else -gain, world)

    def energy(self) -> float:
        """Kinetic and potential energy at the plant's state [J]."""
        dynamics, nu = self.plant.dynamics, self.plant.nu
        return 0.5 * quadratic(dynamics.M, nu) + dynamics.potential()

    def rehearse(self, samples: int) -> None:
        """Ask the controller at some samples without moving, and without a supervisor: what fails, fails now."""
        self.control.equip(None)
        for k in range(samples):
            exact(self.row, self.at, self.plant.position, self.plant.nu, self.places)
            self.control.step(k * self.plan.timing.control_period, self.plan.setpoints[k])


def plant_of(plan: Plan) -> Plant:
    """The plant that a loop asks for; errors as in `OrdinaryLoop`."""
    timing = plan.timing
    if plan.contact is not None:
        return ContactPlant(plan.true, timing.plant_step, timing.integrator, plan.contact, plan.touched)
    return IdealPlant(plan.true, timing.plant_step, timing.integrator)
