"""What bases that only drive leave open: mass and the wheels' rotors, dry friction and constants."""

from __future__ import annotations

from dataclasses import replace
from random import Random

import numpy as np
from drawn import chassis
from drives import ARM, robot_of
from hypothesis import given, settings
from hypothesis import strategies as st
from motions import rubbing, simulated

from mmnn_pin import identify
from mmnn_pin.deploy.identify.report import total_of
from mmnn_pin.model.robot import Robot
from mmnn_pin.model.tree.body import parameters

BASES = {"skid_steer": "skid_steer", "differential_drive": "differential_drive", "mecanum": "holonomic"}


def drawn(kind: str, rotors: float, seed: int) -> tuple[Robot, Robot, float]:
    """A robot as its file has it, as it is, and what it drives as [kg].

    Args:
        kind: Of `BASES`.
        rotors: What those of the wheels add to its mass, relative.
        seed: Of sizes and masses.
    """
    rng = Random(seed)
    made = chassis(rng.choice, kind)
    file = robot_of(made.text.replace("</robot>", f"{ARM}</robot>"), base=BASES[kind])
    true = file.with_masses({name: rng.uniform(0.8, 1.25) for name in ("root", *file.joint_names)})
    true = rubbing(true, 0.3, 0.2)
    model, wheels = true.model.copy(), [true.full_velocity_names.index(wheel.joint) for wheel in true.base.wheels]
    felt, mass = float((true.T[wheels, 0] ** 2).sum()), sum(body.mass for body in model.inertias)
    armature = np.array(model.armature)
    armature[wheels] = rotors * mass / felt
    model.armature = armature
    spin = sum(float(file.T[i, 0] ** 2) * 0.004 for i in wheels)  # a wheel's moment about its axle, see `drawn.wheel`
    return file, replace(true, model=model), mass * (1 + rotors) + spin


@settings(deadline=None, max_examples=9)
@given(
    st.sampled_from(sorted(BASES)), st.sampled_from([0.0, 1e-4, 0.01]), st.sampled_from([0.0, 0.15]), st.integers(0, 99)
)
def test_it_is_within_its_band(kind: str, noise: float, rotors: float, seed: int) -> None:
    """An exact log, too: its normal equations are singular in floating point, and bands were 0, or an error."""
    file, true, driven = drawn(kind, rotors, seed)
    found = identify(file, simulated(true, 15.0, noise, seed=seed))
    total, mass = total_of(found), sum(body.mass for body in true.model.inertias)
    assert abs(total["mass"] - mass) < 1.96 * total["mass_sd"] < 1.96 * mass
    assert abs(total["driven"] - driven) < 4 * total["driven_sd"] + 0.01 * driven
    assert total["driven_sd"] < 0.2 * total["mass_sd"]  # the sum is known, its parts are not
    covariance = found.consistent.covariance
    assert np.linalg.eigvalsh(covariance)[0] > -1e-9 * np.trace(covariance)


@settings(deadline=None, max_examples=6)
@given(st.sampled_from(sorted(BASES)), st.sampled_from([0.0, 0.3]), st.integers(0, 99))
def test_friction_of_wheels_that_never_turn_back_is_within_its_band(kind: str, dry: float, seed: int) -> None:
    """An exact log from rest: the ringing of the filter told dry friction and constants apart, wrongly."""
    file, _, _ = drawn(kind, 0.0, seed)
    true = rubbing(file, 0.1, dry)
    log = simulated(true, 15.0, seed=seed, ahead=5.0)
    assert all((np.diff(log.position[wheel.joint]) > 0).all() for wheel in true.base.wheels)
    found = identify(file, log)
    truth = np.concatenate((parameters(true), np.zeros(found.unknowns.size - found.unknowns.regressor.size)))
    at = found.unknowns.columns("viscous", "coulomb", "offset")
    away, sd = np.abs(found.theta - truth)[at], np.sqrt(np.diag(found.consistent.covariance))[at]
    size = np.abs(found.prior.B[at]).max(axis=1)
    assert (away <= 1.96 * sd + 1e-3 * size).all()
    assert found.error("identified") < 0.01  # the sum is known
    (note,) = (note for note in found.notes if "only sums" in note)
    assert all(f"{wheel.joint}.coulomb" in note for wheel in true.base.wheels)
