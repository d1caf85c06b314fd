"""Control samples and the plant's steps between them without Python: the compiled loop's one function."""

from __future__ import annotations

from typing import Any, NamedTuple

from ..compiled import compiled, copy_to
from ..disturbance import block
from ..model.reduction import as_measured
from ..model.tree.body import Body, Work, energy_of, evaluate
from ..model.tree.dynamics import potential_energy, psi_again
from ..plant.integrators import RK4, Joints, Terms, derivative, euler, rk4_stage
from ..safety import TRIPPED, has_ended
from ..sensing import exact
from ..signals import EARLY, INDEX, Array, IntArray
from ..torque import law
from ..torque.law import MotorLimits, Packed, estimate, settle
from .hardware import Hardware, act, is_stopped, note, rotate, send, sense
from .sample import after_torque, before_torque

NU_REF, NUDOT_REF, PSI, PSI_HAT, TORQUE = (INDEX[n] for n in ("nu_ref", "nudot_ref", "psi", "psi_hat", "torque"))
POSE, VELOCITY, Q, QDOT = (INDEX[n] for n in ("pose", "velocity", "q", "qdot"))


class Plan(NamedTuple):
    """The numbers of a run: control period, plant step, steps per control and measurement, integrator."""

    h: float
    dt: float
    steps: int
    per_measurement: int
    method: int
    uses_model: bool
    start_energy: float


class Blocks(NamedTuple):
    """Settings of the blocks as arrays."""

    at: IntArray
    table: Array
    gains: Array
    K: Array
    law: Packed
    E_inv: Array
    bounds: Array


@compiled
def advance(
    first: int,
    last: int,
    counter: IntArray,
    rows: Array,
    row: Array,
    blocks: Blocks,
    plan: Plan,
    state: Array,
    body: Body,
    loaded: Body,
    work: Work,
    nominal: Body,
    nominal_work: Work,
    nominal_y: Array,
    y: Array,
    hardware: Hardware | None,
    learner: Any,
    limits: MotorLimits | None,
) -> int:
    """Control samples first ... last - 1 into rows; -1, the column of row that went bad, or `TRIPPED`.

    One function on purpose: compiled code is optimised anew at every level of calls, seconds of a first run. What
    stands behind `hardware is not None` or `learner is not None` is compiled only for runs that have one.
    """
    nv, p = body.T.shape
    at, position, nu = blocks.at, y[:nv], y[nv : nv + p]
    nu_ref, nudot_ref = row[at[NU_REF] : at[NU_REF + 1]], row[at[NUDOT_REF] : at[NUDOT_REF + 1]]
    psi, psi_hat = row[at[PSI] : at[PSI + 1]], row[at[PSI_HAT] : at[PSI_HAT + 1]]
    tau, start_energy = row[at[TORQUE] : at[TORQUE + 1]], plan.start_energy
    terms = Terms(work.v, work.M, work.h, work.F, work.hold, work.ydot, work.L, work.rest, work.grip)
    for k in range(first, last):
        now, asked = k * plan.steps % plan.per_measurement == 0, True
        if hardware is not None:
            if k * plan.h + EARLY >= hardware.world.pick:
                shift = hardware.world.shift
                if shift[1] == 0.0:
                    before = energy_of(body, work, position, nu)
                    shift[0], shift[1] = energy_of(loaded, work, position, nu) - before, 1.0
                body, start_energy = loaded, plan.start_energy + shift[0]
            if now:
                sense(k * plan.steps // plan.per_measurement, k * plan.h, row, at, position, nu, body.arm, hardware)
            now, asked = False, not is_stopped(hardware.supervisor.on, hardware.supervisor.state)
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
        if learner is not None and asked:
            estimate(row, at, learner, state)
        if asked:
            law.step(row, at, blocks.law, state, limits)
        if hardware is not None:
            send(k, k * plan.h, row, at, state, hardware)
        if learner is not None and asked:
            settle(row, at, learner, state)
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
                if hardware is not None:
                    sense(n // plan.per_measurement, n * plan.dt, row, at, position, nu, body.arm, hardware)
                else:
                    exact(row, at, position, nu, body.arm)
            if hardware is not None:
                rotate(nu, hardware.E, hardware.motors.wire.joint)
                act(k, n * plan.dt, row, at, hardware)
                block(n * plan.dt, hardware.world.blocked, work.hold)
                tau = hardware.tau
            if plan.method != RK4:
                if i > 0:
                    evaluate(body, work, position, nu)
                joints = Joints(body.T, body.damping, body.dry, body.viscous, body.base)
                euler(plan.method, plan.dt, joints, terms, tau, y)
                continue
            copy_to(y, work.trial)
            for stage in range(4):
                if i > 0 or stage > 0:
                    evaluate(body, work, work.trial[:nv], work.trial[nv : nv + p])
                derivative(work.trial, tau, body.base, terms)
                rk4_stage(stage, plan.dt, y, work.ydot, work.total, work.trial)
            copy_to(work.trial, y)
        if hardware is not None:
            note(plan.steps, rows[k - first], at, hardware.totals)
            supervisor = hardware.supervisor
            if supervisor.on and has_ended(k * plan.h, supervisor.numbers, supervisor.state):
                return TRIPPED
    return -1
