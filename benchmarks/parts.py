"""The parts of one step by themselves, repeated on one state: where each microsecond goes.

Parts of the compiled loop are repeated inside compiled code, parts of the ordinary loop from Python, as it calls them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import njit
from workload import thesis_loop

from mmnn_pin.loop.compiled import CompiledLoop
from mmnn_pin.loop.ordinary import OrdinaryLoop
from mmnn_pin.loop.sample import after_torque, before_torque
from mmnn_pin.model.reduction import friction, spread
from mmnn_pin.model.tree.dynamics import psi_again, terms
from mmnn_pin.plant.integrators import SEMI_IMPLICIT, PlantJoints, PlantTerms, euler
from mmnn_pin.sensing import exact
from mmnn_pin.torque import law

REPEAT = 5000
Part = Callable[[int], None]
repeated = njit(nogil=True, error_model="numpy")


@repeated
def repeat_terms(n, tree, position, nu, scratch, M, h):  # type: ignore[no-untyped-def]
    """Mass matrix and bias forces."""
    for _ in range(n):
        terms(tree, position, nu, scratch, M, h)


@repeated
def repeat_psi(n, tree, position, nu_ref, nudot_ref, scratch, psi):  # type: ignore[no-untyped-def]
    """Psi at the same place."""
    for _ in range(n):
        psi_again(tree, position, nu_ref, nudot_ref, scratch, psi)


@repeated
def repeat_friction(n, T, v, nu, damping, dry, viscous, F):  # type: ignore[no-untyped-def]
    """Joint rates and friction."""
    for _ in range(n):
        spread(T, nu, v)
        friction(T, v, nu, damping, dry, viscous, F)


@repeated
def repeat_before(n, row, at, position, nu, setpoint, arm, gains, K):  # type: ignore[no-untyped-def]
    """Measurement, setpoint and velocity command."""
    for i in range(n):
        exact(row, at, position, nu, arm)
        before_torque(row, at, 0.001 * i, setpoint, gains, K)


@repeated
def repeat_law(n, row, at, numbers, state):  # type: ignore[no-untyped-def]
    """Torque and update of the weights."""
    for _ in range(n):
        law.step(row, at, numbers, state, None, None)


@repeated
def repeat_after(n, row, at, y, arm, M, E_inv, bounds):  # type: ignore[no-untyped-def]
    """True errors, motor torques, energy balance, guard."""
    for _ in range(n):
        after_torque(row, at, y, arm, M, E_inv, 0.0, 0.0, bounds)


@repeated
def repeat_plant(n, dt, joints, terms, tau, y):  # type: ignore[no-untyped-def]
    """Acceleration and integration."""
    for _ in range(n):
        euler(SEMI_IMPLICIT, dt, joints, terms, tau, y)


@repeated
def repeat_row(n, rows, row):  # type: ignore[no-untyped-def]
    """Copy of the row."""
    for i in range(n):
        rows[i % len(rows)] = row


def compiled_parts() -> dict[str, Part]:
    """Parts of the compiled step on the thesis robot after 0.1 s."""
    loop = thesis_loop(0.2, engine="compiled")
    engine = loop.engine_at()
    assert isinstance(engine, CompiledLoop)
    engine.advance(0, 100)
    layout, e, y, position, nu = loop.layout, engine.run, engine.y, engine.true.position, engine.true.nu
    at, row, b, w = e.at, engine.row, engine.true.body, engine.true.work
    nu_ref, nudot_ref, psi, tau = (row[layout.where(name)] for name in ("nu_ref", "nudot_ref", "psi", "torque"))
    state = engine.state.values
    joints = PlantJoints(b.T, b.damping, b.dry, b.viscous, b.base, b.sideways)
    terms_at = PlantTerms(w.v, w.M, w.h, w.F, w.hold, w.ydot, w.L, w.rest, w.grip)
    return {
        "reference, measurement, velocity command": lambda n: repeat_before(
            n, row, at, position, nu, e.setpoints[100], b.arm, e.gains, e.K
        ),
        "networks: torque and update of the weights": lambda n: repeat_law(n, row, at, e.law, state),
        "tree: M, C nu + gravity": lambda n: repeat_terms(n, b.tree, position, nu, w.scratch, w.M, w.h),
        "joint rates and friction": lambda n: repeat_friction(n, b.T, w.v, nu, b.damping, b.dry, b.viscous, w.F),
        "tree: Psi": lambda n: repeat_psi(n, b.tree, position, nu_ref, nudot_ref, w.scratch, psi),
        "motor torques, energy balance, guard": lambda n: repeat_after(n, row, at, y, b.arm, w.M, e.E_inv, e.bounds),
        "plant: solve and integrate": lambda n: repeat_plant(n, 0.0, joints, terms_at, tau, y),
        "copy of the row": lambda n: repeat_row(n, engine.rows, row),
    }


def ordinary_parts() -> dict[str, Part]:
    """Parts of the ordinary step on the thesis robot after 0.1 s."""
    loop = thesis_loop(0.2, engine="ordinary")
    engine = loop.engine_at()
    assert isinstance(engine, OrdinaryLoop)
    engine.advance(0, 100)
    e, plant, dynamics, arm = engine, engine.plant, engine.plant.dynamics, loop.robot.arm_index
    calls: dict[str, Callable[[], Any]] = {
        "reference, measurement, velocity command": lambda: (
            exact(e.row, e.at, plant.position, plant.nu, arm),
            before_torque(e.row, e.at, 0.1, e.plan.setpoints[100], e.plan.gains, e.plan.K),
        ),
        "networks: torque and update of the weights": lambda: e.control.torque.step(0.1),
        "Pinocchio: M, C nu + gravity, reduced": plant.refresh,
        "Pinocchio: Psi": lambda: dynamics.refresh_psi(e.nu_ref, e.nudot_ref, e.psi),
        "motor torques, energy balance, guard": lambda: after_torque(
            e.row, e.at, plant.y, arm, dynamics.M, e.E_inv, 0.0, 0.0, e.plan.bounds
        ),
        "plant: solve and integrate": lambda: plant.step(e.tau),
    }

    def repeat(call: Callable[[], Any]) -> Part:
        def run(n: int) -> None:
            for _ in range(n):
                call()

        return run

    return {name: repeat(call) for name, call in calls.items()}


PARTS = {"compiled": compiled_parts, "loop": ordinary_parts}
