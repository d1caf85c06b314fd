"""The compiled loop: the ordinary loop's blocks without Python between the steps.

The dynamics come from the flattened tree (`model/tree`); everything else is the same functions that the ordinary
loop calls. The two agree bit for bit.

`advance` is the loop. It and its stages are compiled anew for a learner or a hardware model that is new; what they
call is linked, and compiled once. What stands behind `hardware is not None` or `learner is not None` is compiled only
for runs that have one.
"""

from __future__ import annotations

from typing import Any, ClassVar, NamedTuple

import numpy as np

from ..by_address import by_address
from ..compiled import compiled, copy_to, internal
from ..disturbance import block
from ..model.reduction import as_measured, quadratic
from ..model.robot import Robot
from ..model.tree.body import Body, Work, body_of, energy_of, evaluate, new_work
from ..model.tree.dynamics import potential_energy
from ..model.tree.twin import Twin, psi_of
from ..parts import view
from ..plant.integrators import METHODS, RK4, Joints, Terms, derivative, euler, rk4_stage
from ..safety import TRIPPED, has_ended
from ..sensing import exact
from ..signals import EARLY, INDEX, Array, IntArray
from ..torque import law
from ..torque.controller import CompiledController, ControllerState
from ..torque.law import Ahead, MotorLimits, Packed, estimate, settle
from .hardware import Hardware, act, is_stopped, note, rotate, send, sense
from .lead import catch_up, look_ahead, reference_then
from .sample import Plan, after_torque, before_torque
from .servo import Split, answered, ask

NU_REF, NUDOT_REF, PSI, PSI_HAT, TORQUE = (INDEX[n] for n in ("nu_ref", "nudot_ref", "psi", "psi_hat", "torque"))
POSE, VELOCITY, Q, QDOT = (INDEX[n] for n in ("pose", "velocity", "q", "qdot"))


@by_address
class Numbers(NamedTuple):
    """The numbers of a run: periods, steps per control and measurement, integrator, age of a measurement."""

    h: float
    dt: float
    steps: int
    per_measurement: int
    method: int
    uses_model: bool
    start_energy: float
    age: float


@by_address
class Run(NamedTuple):
    """The blocks' settings as arrays, the controller's state, and where the samples go."""

    numbers: Numbers
    at: IntArray
    setpoints: Array
    then: Array
    gains: Array
    K: Array
    law: Packed
    E_inv: Array
    bounds: Array
    state: Array
    counter: IntArray
    rows: Array
    row: Array


@by_address
class Machine(NamedTuple):
    """A robot in motion: its body, also with its payload, memory to work in and views of it, position, nu."""

    body: Body
    loaded: Body
    work: Work
    terms: Terms
    joints: Joints
    y: Array
    position: Array
    nu: Array


def new_machine(robot: Robot, loaded: Robot | None, position: Array, nu: Array) -> Machine:
    """A robot at a position (nv,) with velocity nu (p,).

    Raises:
        RobotError: It has a joint that cannot be flattened.
    """
    body, y, nv = body_of(robot), np.concatenate((position, nu, [0.0])), position.size
    work = new_work(body)
    terms = Terms(work.v, work.M, work.h, work.F, work.hold, work.ydot, work.L, work.rest, work.grip)
    joints = Joints(body.T, body.damping, body.dry, body.viscous, body.base, body.sideways)
    with_load = body if loaded is None else body_of(loaded)
    return Machine(body, with_load, work, terms, joints, y, y[:nv], y[nv : nv + nu.size])


class CompiledLoop:
    """A loop without Python between the steps; attributes and arguments as in `OrdinaryLoop`.

    Raises:
        RobotError: The robot has a joint that cannot be flattened.
    """

    name = "compiled"
    instead: ClassVar[Any] = None  # what steps all loops in place of compiled code, see `early`

    def __init__(
        self, plan: Plan, position: Array, nu: Array, state: ControllerState, hardware: Hardware | None
    ) -> None:
        assert isinstance(plan.controller, CompiledController)
        layout, timing, torque = plan.layout, plan.timing, plan.controller.law(plan.context)
        self.row, self.rows, self.step_times = (
            layout.new_row(),
            np.zeros((plan.block, layout.width)),
            np.zeros(plan.block),
        )
        self.counter, self.state, self.hardware = np.zeros(1, np.int64), state, hardware
        self.learner, self.limits = torque.learner, plan.context.limits
        self.split = None if hardware is None else hardware.split
        self.ahead = None if plan.lead is None else plan.lead.ahead
        self.later = None if plan.lead is None else plan.lead.learner
        self.true = new_machine(plan.true, plan.loaded, position, nu)
        uses_model = plan.controller.uses_model
        nominal = plan.believed if uses_model else plan.robot
        self.nominal = new_machine(nominal, None, nominal.neutral_position(), np.zeros(layout.dof))
        self.y = self.true.y
        self.run = Run(
            numbers=Numbers(
                h=timing.control_period,
                dt=timing.plant_step,
                steps=timing.steps_per_control,
                per_measurement=timing.steps_per_measurement,
                method=METHODS[timing.integrator],
                uses_model=uses_model,
                start_energy=start_energy(plan.true, self.true),
                age=plan.age,
            ),
            at=layout.offsets,
            setpoints=plan.setpoints,
            then=plan.setpoints[0].copy(),
            gains=plan.gains,
            K=plan.K,
            law=torque.numbers,
            E_inv=plan.E_inv,
            bounds=plan.bounds,
            state=state.values,
            counter=self.counter,
            rows=self.rows,
            row=self.row,
        )
        blocks = (self.true, self.nominal, self.hardware, self.learner, self.limits, self.ahead, self.later, self.split)
        self.blocks = (self.run, *blocks)

    def advance(self, first: int, last: int, at: int = 0) -> int:
        """Run control samples first ... last - 1; -1, the column of `row` that went bad, or `TRIPPED`.

        Their rows stand from place `at` on.
        """
        return self.step(first, last, at) if self.instead is None else self.instead.advance(self, first, last, at)

    def step(self, first: int, last: int, at: int) -> int:
        """The same by this module's functions, compiled or not."""
        run, *blocks = self.blocks
        bad = advance(first, last, run if at == 0 else run._replace(rows=self.rows[at:]), *blocks)
        self.counter[0] += at
        return bad


def start_energy(robot: Robot, true: Machine) -> float:
    """Kinetic and potential energy at the start [J], by functions that other callers have compiled already."""
    twin = Twin(robot)
    twin.refresh(true.position, true.nu)
    return 0.5 * quadratic(twin.M, true.nu) + twin.potential()


@compiled
def advance(
    first: int,
    last: int,
    run: Run,
    true: Machine,
    nominal: Machine,
    hardware: Hardware | None,
    learner: Any,
    limits: MotorLimits | None,
    ahead: Ahead | None,
    later: Any,
    split: Split | None,
) -> int:
    """Control samples first ... last - 1 into the rows; -1, the column of the row that went bad, or `TRIPPED`.

    Args:
        first: Control sample.
        last: Control sample.
        run: Settings and buffers.
        true: The true robot, which moves.
        nominal: The one that the controller believes in, where it uses a model.
        hardware: Sensors, motors, supervisor and disturbances; None for an ideal robot.
        learner: What the controller learns with beside networks; None for nothing.
        limits: What Psi_hat is kept within; None for nothing.
        ahead: Where Psi_hat leads; None where it does not.
        later: The learner with its weights held, which is asked there.
        split: The rows that take a velocity, which are the hardware's; None where all take effort.
    """
    n = run.numbers
    for k in range(first, last):
        time, body, energy = k * n.h, true.body, n.start_energy
        if hardware is not None and time + EARLY >= hardware.world.pick:
            pick_up(time, true, hardware)
            energy = n.start_energy + hardware.world.shift[0]
            if hardware.world.shift[1] == 1.0:
                body = true.loaded
        if k * n.steps % n.per_measurement == 0:
            measure(k * n.steps // n.per_measurement, time, run, true, hardware)
        control(k, time, run, nominal, hardware, learner, limits, ahead, later, split)
        bad = observe(run, body, true, energy)
        if bad >= 0:
            return bad
        copy_to(run.row, run.rows[k - first])
        run.counter[0] = k - first + 1
        tau = view(run.row, run.at, TORQUE)
        for i in range(n.steps):
            step = k * n.steps + i
            if i > 0 and step % n.per_measurement == 0:
                measure(step // n.per_measurement, step * n.dt, run, true, hardware)
            if hardware is not None:
                drive(k, step * n.dt, run, true, hardware)
                tau = hardware.tau
            move(n, i, body, true, tau)
        if hardware is not None:
            note(n.steps, run.rows[k - first], run.at, hardware.way.totals)
            supervisor = hardware.way.supervisor
            if supervisor.on and has_ended(time, supervisor.numbers, supervisor.state):
                return TRIPPED
    return -1


@internal
def measure(number: int, time: float, run: Run, true: Machine, hardware: Hardware | None) -> None:
    """The measurement of this number at a time [s], into the row."""
    if hardware is not None:
        sense(number, time, run.row, run.at, true.position, true.nu, true.body.arm, hardware)
    else:
        exact(run.row, run.at, true.position, true.nu, true.body.arm)


@internal
def control(
    k: int,
    time: float,
    run: Run,
    nominal: Machine,
    hardware: Hardware | None,
    learner: Any,
    limits: MotorLimits | None,
    ahead: Ahead | None,
    later: Any,
    split: Split | None,
) -> None:
    """Setpoint -> kinematic -> torque -> safety of sample k, as `sample.Control.step`."""
    n, row, at, asked = run.numbers, run.row, run.at, True
    before = run.setpoints[max(k - 1, 0)]
    if n.age > 0.0:
        reference_then(run.setpoints, k, n.age / n.h, run.then)
        catch_up(row, at, run.setpoints[k], run.then, n.age)
    before_torque(row, at, time, run.setpoints[k], run.gains, run.K)
    if hardware is not None:
        asked = not is_stopped(hardware.way.supervisor.on, hardware.way.supervisor.state)
    if split is not None and asked:
        ask(row, at, split)
    if asked:
        if ahead is not None:
            look_ahead(row, at, before, ahead)
            if n.uses_model:
                model_psi(ahead.row, at, nominal)
            if later is not None:
                estimate(ahead.row, at, later, run.state)
        if n.uses_model:
            model_psi(row, at, nominal)
        if learner is not None:
            estimate(row, at, learner, run.state)
        if ahead is not None:  # networks have learned by now: their weights are those of this sample's psi_hat
            law.step(ahead.row, at, ahead.law, run.state, None, None)
        law.step(row, at, run.law, run.state, limits, ahead)
    if split is not None:
        answered(row, at, not asked, split)
    if hardware is not None:
        send(k, time, row, at, run.state, hardware.way)
    if learner is not None and asked:
        settle(row, at, learner, run.state)


@internal
def drive(k: int, time: float, run: Run, true: Machine, hardware: Hardware) -> None:
    """Motors, pushes and blocked joints of sample k over the step at a time [s]: `hardware.tau`, `work.hold`."""
    rotate(true.nu, hardware.E, hardware.motors.wire.joint)
    act(k, time, run.row, run.at, hardware)
    block(time, hardware.world.blocked, true.work.hold)


@internal
def pick_up(time: float, true: Machine, hardware: Hardware) -> None:
    """Note the energy that comes with the payload and goes with it, once each: it is no error of the balance."""
    shift, now = hardware.world.shift, 1.0 if time + EARLY < hardware.world.drop else 2.0
    if shift[1] != now:
        empty = energy_of(true.body, true.work, true.position, true.nu)
        gain = energy_of(true.loaded, true.work, true.position, true.nu) - empty
        shift[0] += gain if now == 1.0 else -gain if shift[1] == 1.0 else 0.0
        shift[1] = now


@internal
def model_psi(row: Array, at: IntArray, nominal: Machine) -> None:
    """Psi of the nominal robot at the measured state, into psi_hat."""
    body, work, psi_hat = nominal.body, nominal.work, view(row, at, PSI_HAT)
    as_measured(
        body.offset, body.columns, view(row, at, POSE), view(row, at, VELOCITY), view(row, at, Q),
        view(row, at, QDOT), nominal.position, nominal.nu,
    )  # fmt: skip
    evaluate(body, work, nominal.position, nominal.nu)
    psi_of(body, work, nominal.position, view(row, at, NU_REF), view(row, at, NUDOT_REF), psi_hat)


@internal
def observe(run: Run, body: Body, true: Machine, energy: float) -> int:
    """What only a simulation knows of a sample, into the row; -1, or the column that went bad."""
    row, at, work = run.row, run.at, true.work
    psi = view(row, at, PSI)
    evaluate(body, work, true.position, true.nu)
    psi_of(body, work, true.position, view(row, at, NU_REF), view(row, at, NUDOT_REF), psi)
    potential = potential_energy(body.tree, true.position, work.scratch) if body.feels_gravity else 0.0
    return after_torque(row, at, true.y, body.arm, work.M, run.E_inv, potential, energy, run.bounds)


@internal
def move(n: Numbers, i: int, body: Body, true: Machine, tau: Array) -> None:
    """Step i of the plant in a control period under a torque (p,); at step 0 the dynamics are evaluated already."""
    work, terms, y = true.work, true.terms, true.y
    if n.method != RK4:
        if i > 0:
            evaluate(body, work, true.position, true.nu)
        euler(n.method, n.dt, true.joints, terms, tau, y)
    else:
        nv, p = body.T.shape
        copy_to(y, work.trial)
        for stage in range(4):
            if i > 0 or stage > 0:
                evaluate(body, work, work.trial[:nv], work.trial[nv : nv + p])
            derivative(work.trial, tau, true.joints, terms)
            rk4_stage(stage, n.dt, y, work.ydot, work.total, work.trial)
        copy_to(work.trial, y)
