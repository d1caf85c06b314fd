"""The compiled loop: the ordinary loop's blocks without Python between the steps.

The dynamics come from the flattened tree, which is checked against Pinocchio when it is built; everything else is
the same functions that the ordinary loop calls. The two agree to rounding.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np

from .compiled import compiled, copy_to
from .disturbance.effects import BRAKE, EARLY, mark
from .model.dynamics import Dynamics
from .model.reduction import as_measured, friction, quadratic, spread
from .model.robot import Robot
from .model.tree import flatten
from .model.tree_dynamics import potential_energy, psi_again, terms
from .model.tree_motion import Tree, new_scratch
from .plant.integrators import METHODS, RK4, derivative, euler, rk4_stage
from .rig import Rig, act, is_stopped, new_rig, note, rotate, send, sense
from .safety import TRIPPED, has_ended
from .sample import after_torque, before_torque
from .sensing import exact
from .signals import INDEX, Array, IntArray
from .torque import law
from .torque.controller import CompiledController
from .torque.learners import Learners, estimate, learners_of, settle
from .torque.motor_limits import MotorLimits

if TYPE_CHECKING:
    from .loop import Loop

NU_REF, NUDOT_REF, PSI, PSI_HAT, TORQUE = (INDEX[n] for n in ("nu_ref", "nudot_ref", "psi", "psi_hat", "torque"))
POSE, VELOCITY, Q, QDOT = (INDEX[n] for n in ("pose", "velocity", "q", "qdot"))


class Body(NamedTuple):
    """A robot as arrays: its tree, T (nv, p), friction of joints (nv,) and base (p,), `Robot.arm_map`."""

    tree: Tree
    T: Array
    damping: Array
    dry: Array
    viscous: Array
    arm: IntArray
    base: int
    feels_gravity: bool
    offset: Array
    columns: Array


class Work(NamedTuple):
    """Scratch memory for one robot in one thread."""

    scratch: Array
    v: Array
    M: Array
    h: Array
    F: Array
    L: Array
    rest: Array
    grip: Array
    hold: Array
    ydot: Array
    total: Array
    trial: Array


class Plan(NamedTuple):
    """The numbers of a run: control period, plant step, steps per control and measurement, integrator, law."""

    h: float
    dt: float
    steps: int
    per_measurement: int
    method: int
    kind: int
    uses_model: bool
    start_energy: float


class Blocks(NamedTuple):
    """Settings of the blocks as arrays."""

    at: IntArray
    table: Array
    gains: Array
    K: Array
    sizes: IntArray
    settings: Array
    E_inv: Array
    bounds: Array


BODIES: WeakKeyDictionary[Robot, Body] = WeakKeyDictionary()


def body_of(robot: Robot) -> Body:
    """Robot as arrays, made once per robot.

    Raises:
        RobotError: It has a joint that cannot be flattened.
    """
    if robot not in BODIES:
        BODIES[robot] = new_body(robot)
    return BODIES[robot]


def new_body(robot: Robot) -> Body:
    """Robot as arrays; its tree is checked against Pinocchio.

    Raises:
        RobotError: It has a joint that cannot be flattened.
    """
    frame = robot.frame if robot.layout.base else np.zeros(3)
    tree = flatten(robot.model, robot.T, robot.neutral_position(), tuple(frame))
    offset, columns = robot.arm_map()
    return Body(
        tree=tree,
        T=np.array(robot.T),
        damping=np.array(robot.damping),
        dry=robot.dry,
        viscous=np.array(robot.viscous),
        arm=np.array(robot.arm_index),
        base=robot.layout.base,
        feels_gravity=Dynamics(robot).feels_gravity,
        offset=offset,
        columns=columns,
    )


def new_work(body: Body) -> Work:
    """Scratch memory for a robot."""
    nv, p = body.T.shape
    size = nv + p + 1
    shapes = ((nv,), (p, p), (p,), (p,), (p, p), (p,), (nv, p + 2), (nv,), (size,), (size,), (size,))
    return Work(new_scratch(body.tree), *(np.zeros(shape) for shape in shapes))


@compiled
def evaluate(body: Body, work: Work, position: Array, nu: Array) -> None:
    """M, `h = C nu + gravity + friction`, friction F and `v = T nu` at a state."""
    terms(body.tree, position, nu, work.scratch, work.M, work.h)
    spread(body.T, nu, work.v)
    friction(body.T, work.v, nu, body.damping, body.dry, body.viscous, work.F)
    for i in range(nu.size):
        work.h[i] += work.F[i]


@compiled
def energy_of(body: Body, work: Work, position: Array, nu: Array) -> float:
    """Kinetic and potential energy at a state [J]; the work's terms become those of that state."""
    evaluate(body, work, position, nu)
    potential = potential_energy(body.tree, position, work.scratch) if body.feels_gravity else 0.0
    return float(0.5 * quadratic(work.M, nu) + potential)


@compiled
def advance(
    first: int,
    last: int,
    counter: IntArray,
    rows: Array,
    row: Array,
    blocks: Blocks,
    plan: Plan,
    memory: Array,
    body: Body,
    loaded: Body,
    work: Work,
    nominal: Body,
    nominal_work: Work,
    nominal_y: Array,
    y: Array,
    rig: Rig | None,
    learners: Learners | None,
    limits: MotorLimits | None,
) -> int:
    """Control samples first ... last - 1 into rows; -1, the column of row that went bad, or `TRIPPED`.

    One function on purpose: compiled code is optimised anew at every level of calls, seconds of a first run. What
    stands behind `rig is not None` or `learners is not None` is compiled only for runs that have one.
    """
    nv, p = body.T.shape
    at, position, nu = blocks.at, y[:nv], y[nv : nv + p]
    nu_ref, nudot_ref = row[at[NU_REF] : at[NU_REF + 1]], row[at[NUDOT_REF] : at[NUDOT_REF + 1]]
    psi, psi_hat = row[at[PSI] : at[PSI + 1]], row[at[PSI_HAT] : at[PSI_HAT + 1]]
    tau, start_energy = row[at[TORQUE] : at[TORQUE + 1]], plan.start_energy
    for k in range(first, last):
        now, asked = k * plan.steps % plan.per_measurement == 0, True
        if rig is not None:
            if k * plan.h + EARLY >= rig.pick:
                if rig.shift[1] == 0.0:
                    before = energy_of(body, work, position, nu)
                    rig.shift[0], rig.shift[1] = energy_of(loaded, work, position, nu) - before, 1.0
                body, start_energy = loaded, plan.start_energy + rig.shift[0]
            if now:
                sense(k * plan.steps // plan.per_measurement, k * plan.h, row, at, position, nu, body.arm, rig)
            now, asked = False, not is_stopped(rig)
        before_torque(row, at, k * plan.h, y, blocks.table[k], now, body.arm, blocks.gains, blocks.K)
        if asked and plan.uses_model:
            as_measured(
                nominal.offset, nominal.columns, row[at[POSE] : at[POSE + 1]], row[at[VELOCITY] : at[Q]],
                row[at[Q] : at[QDOT]], row[at[QDOT] : at[QDOT + 1]], nominal_y[:nv], nominal_y[nv : nv + p],
            )  # fmt: skip
            evaluate(nominal, nominal_work, nominal_y[:nv], nominal_y[nv : nv + p])
            psi_again(nominal.tree, nominal_y[:nv], nu_ref, nudot_ref, nominal_work.scratch, psi_hat)
            for i in range(p):
                psi_hat[i] += nominal_work.F[i]
        if learners is not None and asked:
            estimate(row, at, learners, memory)
        if asked:
            law.step(plan.kind, row, at, blocks.sizes, blocks.settings, memory, limits)
        if rig is not None:
            send(k, k * plan.h, row, at, memory, rig)
        if learners is not None and asked:
            settle(row, at, learners, memory)
        evaluate(body, work, position, nu)
        psi_again(body.tree, position, nu_ref, nudot_ref, work.scratch, psi)
        for i in range(p):
            psi[i] += work.F[i]
        potential = potential_energy(body.tree, position, work.scratch) if body.feels_gravity else 0.0
        work_done = y[nv + p]
        bad = after_torque(row, at, work.M, blocks.E_inv, potential, work_done, start_energy, blocks.bounds)
        if bad >= 0:
            return bad
        copy_to(row, rows[k - first])
        counter[0] = k - first + 1
        for i in range(plan.steps):
            n = k * plan.steps + i
            if i > 0 and n % plan.per_measurement == 0:
                if rig is not None:
                    sense(n // plan.per_measurement, n * plan.dt, row, at, position, nu, body.arm, rig)
                else:
                    exact(row, at, position, nu, body.arm)
            if rig is not None:
                rotate(nu, rig)
                act(k, n * plan.dt, plan.dt, row, at, rig)
                mark(n * plan.dt, rig.blocked, work.hold, BRAKE)
                tau = rig.tau
            if plan.method != RK4:
                if i > 0:
                    evaluate(body, work, position, nu)
                euler(
                    plan.method, plan.dt, body.T, work.v, work.M, work.h, work.F, body.damping, body.dry, work.hold,
                    body.viscous, tau, body.base, work.L, work.rest, work.grip, y, work.ydot,
                )  # fmt: skip
                continue
            copy_to(y, work.trial)
            for stage in range(4):
                if i > 0 or stage > 0:
                    evaluate(body, work, work.trial[:nv], work.trial[nv : nv + p])
                derivative(work.trial, work.v, work.M, work.h, work.F, tau, body.base, work.L, work.rest, work.ydot)
                rk4_stage(stage, plan.dt, y, work.ydot, work.total, work.trial)
            copy_to(work.trial, y)
        if rig is not None:
            note(plan.steps, rows[k - first], at, rig)
            if rig.supervised and has_ended(k * plan.h, rig.limits, rig.guard):
                return TRIPPED
    return -1


class CompiledLoop:
    """A loop without Python between the steps; attributes and arguments as in `OrdinaryLoop`.

    Raises:
        RobotError: The robot has a joint that cannot be flattened.
    """

    name = "compiled"

    def __init__(
        self, loop: Loop, table: Array, position: Array, nu: Array, memory: Any, rig_memory: Array | None, block: int
    ) -> None:
        assert isinstance(loop.controller, CompiledController)
        robot, layout, timing = loop.robot, loop.robot.layout, loop.timing
        self.row, self.rows, self.step_times = layout.new_row(), np.zeros((block, layout.width)), np.zeros(block)
        self.counter, self.memory = np.zeros(1, np.int64), memory
        self.y = np.concatenate((position, nu, [0.0]))
        self.body = body_of(robot)
        self.work = new_work(self.body)
        uses_model = loop.controller.uses_model
        nominal = loop.believed
        self.nominal = body_of(nominal) if uses_model else self.body
        self.nominal_work = new_work(self.nominal)
        self.nominal_y = np.concatenate((nominal.neutral_position(), np.zeros(layout.dof + 1)))
        wiring = loop.wiring()
        numbers = loop.controller.law(wiring)
        self.learners, self.limits = learners_of(numbers), wiring.limits
        self.rig, loaded = new_rig(loop, nu, memory, rig_memory), loop.loaded()
        self.loaded = self.body if loaded is None else body_of(loaded)
        self.blocks = Blocks(
            at=layout.offsets,
            table=table,
            gains=loop.kinematic.base_gains(layout.base),
            K=loop.kinematic.arm_gains(layout),
            sizes=numbers.sizes,
            settings=numbers.settings,
            E_inv=np.ascontiguousarray(np.linalg.pinv(robot.E)),
            bounds=loop.bounds.vector(layout),
        )
        self.plan = Plan(
            h=timing.control_period,
            dt=timing.plant_step,
            steps=timing.steps_per_control,
            per_measurement=timing.steps_per_measurement,
            method=METHODS[timing.integrator],
            kind=numbers.kind,
            uses_model=uses_model,
            start_energy=self._energy(position, nu),
        )

    @property
    def rig_memory(self) -> Array:
        """What sensors, motors and supervisor remember."""
        return np.zeros(0) if self.rig is None else self.rig.memory

    def advance(self, first: int, last: int) -> int:
        """Run control samples first ... last - 1; -1, the column of `row` that went bad, or `TRIPPED`."""
        return advance(
            first, last, self.counter, self.rows, self.row, self.blocks, self.plan, self.memory.values, self.body,
            self.loaded, self.work, self.nominal, self.nominal_work, self.nominal_y, self.y, self.rig,
            self.learners, self.limits,
        )  # fmt: skip

    def _energy(self, position: Array, nu: Array) -> float:
        evaluate(self.body, self.work, position, nu)
        potential = potential_energy(self.body.tree, position, self.work.scratch) if self.body.feels_gravity else 0.0
        return 0.5 * quadratic(self.work.M, nu) + potential
