"""The compiled loop: the ordinary loop's blocks without Python between the steps.

The dynamics come from the flattened tree (`model/tree`); everything else is the same functions that the ordinary
loop calls. The two agree bit for bit.

`advance` is the loop. It and its stages are compiled anew for a learner or a hardware model that is new; what they
call is linked, and compiled once. What stands behind `hardware is not None` or `learner is not None` is compiled only
for runs that have one.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ..by_address import by_address
from ..compiled import compiled, copy_to, internal
from ..compliance import Compliance
from ..disturbance import block
from ..errors import ConfigError
from ..kinematic import Steering
from ..model.reduction import quadratic
from ..model.robot import Robot
from ..model.tree.body import Body, body_of, energy_of, evaluate
from ..model.tree.dynamics import potential_energy
from ..model.tree.twin import Twin, psi_of
from ..parts import view
from ..plant.integrators import (
    IMPLICIT_FRICTION,
    METHODS,
    RK4,
    STAGES,
    derivative,
    euler,
    implicit_stage,
    respond,
    rk4_stage,
)
from ..safety import TRIPPED, has_ended
from ..sensing import exact
from ..signals import INDEX, Array, IntArray
from ..torque.controller import ControllerState
from ..torque.law import Ahead, MotorLimits
from ..touch import Feeler
from .hardware import (
    Hardware,
    World,
    act,
    load_at,
    look,
    note,
    push,
    rotate,
    see_world,
    sense,
    shift_energy,
    turn_motors,
)
from .machine import Machine, new_machine
from .plan import Plan
from .sample import Control, Controls, after_torque, sample
from .servo import Split

NU_REF, NUDOT_REF, PSI, TORQUE = (INDEX[n] for n in ("nu_ref", "nudot_ref", "psi", "torque"))


@by_address
class RunNumbers(NamedTuple):
    """The numbers of a run: periods, steps per control and measurement, integrator, energy at the start."""

    h: float
    dt: float
    steps: int
    per_measurement: int
    method: int
    start_energy: float


@by_address
class CompiledRun(NamedTuple):
    """The numbers of a run, what its control samples work on, and where they go."""

    numbers: RunNumbers
    controls: Controls
    E_inv: Array
    bounds: Array
    hitch: Array
    counter: IntArray
    rows: Array


class CompiledLoop:
    """A loop without Python between the steps; attributes and arguments as in `OrdinaryLoop`.

    Raises:
        RobotError: The robot has a joint that cannot be flattened.
    """

    name = "compiled"

    def __init__(
        self, plan: Plan, position: Array, nu: Array, state: ControllerState, hardware: Hardware | None
    ) -> None:
        layout, timing = plan.layout, plan.timing
        self.row, self.rows = layout.new_row(), np.zeros((plan.block, layout.width))
        self.step_times, self.counter = np.zeros(plan.block), np.zeros(1, np.int64)
        self.state, self.hardware = state, hardware
        control = Control(plan, self.row, state, hardware)
        if not control.torque.compiled:
            body_of(plan.believed)  # says why it cannot be flattened
        true = new_machine(plan.true, plan.loaded, position, nu)
        self.y = true.y
        self.run = CompiledRun(
            numbers=RunNumbers(
                h=timing.control_period,
                dt=timing.plant_step,
                steps=timing.steps_per_control,
                per_measurement=timing.steps_per_measurement,
                method=METHODS[timing.integrator],
                start_energy=start_energy(plan.true, true),
            ),
            controls=control.controls,
            E_inv=plan.E_inv,
            bounds=plan.bounds,
            hitch=plan.hitch,
            counter=self.counter,
            rows=self.rows,
        )
        self.blocks = (self.run, true, *control.blocks[1:-1])

    def advance(self, first: int, last: int) -> int:
        """Run control samples first ... last - 1; -1, the column of `row` that went bad, or `TRIPPED`.

        Raises:
            ConfigError: More samples than `rows` has, or samples that the run does not have.
        """
        if not 0 <= first <= last <= min(first + len(self.rows), len(self.run.controls.setpoints)):
            what = f"control samples {first} to {last} of a run of {len(self.run.controls.setpoints)}"
            raise ConfigError(what, fix=f"ask for some that it has, at most {len(self.rows)} at a time", key="last")
        return advance(first, last, *self.blocks)


def start_energy(robot: Robot, true: Machine) -> float:
    """Kinetic and potential energy at the start [J], by functions that other callers have compiled already."""
    twin = Twin(robot)
    twin.refresh(true.position, true.nu)
    return 0.5 * quadratic(twin.M, true.nu) + twin.potential()


@compiled
def advance(  # noqa: PLR0913 - parts that are None are not compiled
    first: int,
    last: int,
    run: CompiledRun,
    true: Machine,
    model: Machine | None,
    hardware: Hardware | None,
    learner: Any,
    limits: MotorLimits | None,
    ahead: Ahead | None,
    later: Any,
    split: Split | None,
    steering: Steering | None,
    task: Compliance | None,
    touch: Feeler | None,
    kept: Controls | None,
    held: Any,
) -> int:
    """Control samples first ... last - 1 into the rows; -1, the column of the row that went bad, or `TRIPPED`.

    Args:
        first: Control sample.
        last: Control sample.
        run: Settings and buffers.
        true: The true robot, which moves.
        model: As of `sample`, like all that follow.
        hardware: Likewise.
        learner: Likewise.
        limits: Likewise.
        ahead: Likewise.
        later: Likewise.
        split: Likewise.
        steering: Likewise.
        task: Likewise.
        touch: Likewise.
        kept: Likewise.
        held: Likewise.
    """
    n, row, at, setpoints = run.numbers, run.controls.row, run.controls.at, run.controls.setpoints
    for k in range(first, last):
        time, body, energy = k * n.h, true.body, n.start_energy
        if hardware is not None:
            pick_up(time, true, hardware.world)
            energy = n.start_energy + hardware.world.shift[0]
            if hardware.world.shift[1] == 1.0:
                body = true.loaded
        if k * n.steps % n.per_measurement == 0:
            measure(k * n.steps // n.per_measurement, time, run, true, hardware)
        sample(
            k, time, setpoints[k], setpoints[max(k - 1, 0)], run.controls, model, hardware, learner, limits, ahead,
            later, split, steering, task, touch, kept, held, None,
        )  # fmt: skip
        bad = observe(run, body, true, energy)
        if bad >= 0:
            return bad
        copy_to(row, run.rows[k - first])
        run.counter[0] = k - first + 1
        tau = view(row, at, TORQUE)
        for i in range(n.steps):
            step = k * n.steps + i
            if i > 0 and step % n.per_measurement == 0:
                measure(step // n.per_measurement, step * n.dt, run, true, hardware)
            if i > 0:
                evaluate(body, true.work, true.position, true.nu)
            if hardware is not None:
                drive(k, step * n.dt, run, true, hardware)
                tau = hardware.tau
            move(n, body, true, tau)
        if hardware is not None:
            note(n.steps, run.rows[k - first], at, hardware.way.totals)
            supervisor = hardware.way.supervisor
            if supervisor.on and has_ended(time, supervisor.numbers, supervisor.state):
                return TRIPPED
    return -1


@internal
def measure(number: int, time: float, run: CompiledRun, true: Machine, hardware: Hardware | None) -> None:
    """The measurement of this number at a time [s], into the row."""
    if hardware is not None:
        sense(number, time, run.controls.row, run.controls.at, true.position, true.nu, true.body.places, hardware)
    else:
        exact(run.controls.row, run.controls.at, true.position, true.nu, true.body.places)


@internal
def drive(k: int, time: float, run: CompiledRun, true: Machine, hardware: Hardware) -> None:
    """Motors, pushes and blocked joints of sample k over the step at a time [s]: `hardware.tau`, `work.hold`."""
    turn_motors(hardware, true.work.maps)
    rotate(true.nu, hardware.E, hardware.motors.wire.joint)
    see_world(true.position, true.nu, true.work.maps, hardware.world)
    push(k, time, hardware)
    if hardware.split is not None:
        wire = hardware.motors.wire
        look(hardware, true.position)
        respond(run.numbers.dt, true.joints, true.terms, true.nu, hardware.tau, hardware.E, wire.free, wire.answer)
    act(k, time, run.controls.row, run.controls.at, hardware)
    block(time, hardware.world.blocked, true.work.hold)


@internal
def pick_up(time: float, true: Machine, world: World) -> None:
    """Carry the payload from its time to its end."""
    load = load_at(time, world)
    if load != world.shift[1]:
        empty = energy_of(true.body, true.work, true.position, true.nu)
        shift_energy(load, energy_of(true.loaded, true.work, true.position, true.nu) - empty, world)


@internal
def observe(run: CompiledRun, body: Body, true: Machine, energy: float) -> int:
    """Write into the row the signals of a sample that only a simulation knows; -1, or the column that went bad."""
    row, at, work = run.controls.row, run.controls.at, true.work
    psi = view(row, at, PSI)
    evaluate(body, work, true.position, true.nu)
    psi_of(body, work, true.position, view(row, at, NU_REF), view(row, at, NUDOT_REF), psi)
    potential = potential_energy(body.tree, true.position, work.scratch) if body.feels_gravity else 0.0
    return after_torque(row, at, true.y, body.places, work.M, run.E_inv, potential, energy, run.bounds, run.hitch)


@internal
def move(n: RunNumbers, body: Body, true: Machine, tau: Array) -> None:
    """A step of the plant under a torque (p,) from where the dynamics are evaluated."""
    work, terms, y, joints = true.work, true.terms, true.y, true.joints
    nv, p = body.T.shape
    copy_to(y, work.trial)
    for stage in range(STAGES[n.method]):
        if stage > 0:
            evaluate(body, work, work.trial[:nv], work.trial[nv : nv + p])
        if n.method == RK4:
            derivative(work.trial, tau, joints, terms)
            rk4_stage(stage, n.dt, y, work.ydot, work.total, work.trial)
        elif n.method == IMPLICIT_FRICTION:
            implicit_stage(stage, n.dt, joints, terms, tau, y, work.total, work.trial)
        else:
            euler(n.method, n.dt, joints, terms, tau, y)
    if n.method == RK4:
        copy_to(work.trial, y)
