"""The regressor of the reduced dynamics: `Y theta = Psi` against Pinocchio, and what it does not know."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import config
from robots import fixed_arm, mobile_arm
from test_tree import random_map, random_model

from mmnn_pin import PD, Feedback, load, load_experiment
from mmnn_pin.disturbance import Payload
from mmnn_pin.errors import RobotError
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.model.regressor import (
    Regressor,
    inertial_parameters,
    measured,
    regress,
    with_any_inertias,
    without_masses,
)
from mmnn_pin.model.robots import extra
from mmnn_pin.model.tree.body import parameters
from mmnn_pin.model.tree.tree import configuration, flatten

RELATIVE = 1e-10
seeds = st.integers(0, 2**32 - 1)


def robot_named(name):
    made = {"mobile": mobile_arm, "fixed": fixed_arm}
    robot = made[name](5) if name in made else load(name)
    rough = robot.with_joint_friction(viscous=0.3, coulomb=0.5)
    return rough.with_friction(1.0 + np.arange(robot.dimensions.dof))


def worst(robot, samples=10, seed=0):
    """Largest difference of `Y theta` from our Psi, relative to the largest force."""
    regressor, theta, dynamics, found = Regressor.of(robot), parameters(robot), Dynamics(robot), []
    rng = np.random.default_rng(seed)
    for _ in range(samples):
        position, motion = regressor.random_position(rng), rng.standard_normal((3, robot.dimensions.dof))
        psi = dynamics.psi(position, *motion)
        found.append(np.abs(regressor.matrix(position, *motion) @ theta - psi).max() / np.abs(psi).max())
    return max(found)


@pytest.mark.parametrize("name", ["platform_arm", "two_axis_arm", "mobile", "fixed"])
def test_the_regressor_times_the_parameters_is_psi(name):
    assert worst(robot_named(name)) < RELATIVE


def test_threads_may_share_a_regressor():
    """As the runs of a batch do whose controller is one and the same."""
    regressor, rng = Regressor.of(load("platform_arm")), np.random.default_rng(0)
    at = [
        (regressor.random_position(rng), *rng.standard_normal((3, 4))) for _ in range(20 if config.DISABLE_JIT else 300)
    ]
    alone = [regressor.matrix(*one) for one in at]
    with ThreadPoolExecutor(4) as pool:
        for _ in range(1 if config.DISABLE_JIT else 20):
            np.testing.assert_array_equal(list(pool.map(lambda one: regressor.matrix(*one), at)), alone)


@pytest.mark.compiled
@pytest.mark.skipif(not extra(), reason="example-robot-data is not installed")
def test_the_regressor_of_every_example_robot_that_loads():
    done = []
    for name in extra():
        try:
            robot = load(name)
        except RobotError:
            continue
        assert worst(robot, samples=3) < RELATIVE, name
        done.append(name)
    assert done


@settings(max_examples=30, deadline=None)
@given(seeds, st.integers(1, 7), st.booleans())
def test_random_trees(seed, joints, mobile):
    rng = np.random.default_rng(seed)
    pin.seed(seed % 2**31)
    model = random_model(rng, joints, mobile)
    T = random_map(rng, model, mobile)
    base = 0 if not mobile else 2 if not T[1].any() else 3
    frame = tuple(rng.uniform(-1, 1, 3)) if mobile else (0.0, 0.0, 0.0)
    rest = rng.uniform(-1, 1, model.nv)
    tree = flatten(model, T, rest, frame, absorb=False)
    known = without_masses(tree, T, base, rest, np.zeros((model.nv, 0)), 0.01)
    nu, nu_ref, nudot_ref = rng.standard_normal((3, T.shape[1]))
    position = rng.uniform(-2, 2, model.nv)
    position[~T.any(axis=1)] = rest[~T.any(axis=1)]
    known.position[:], known.nu[:] = position, nu
    regress(known, nu_ref, nudot_ref)
    root = 3 if mobile else 0
    armature = model.armature[root:][T[root:].any(axis=1)]
    inertial = inertial_parameters(tree, base)
    ours = known.Y[:, : inertial.size] @ inertial
    ours += known.Y[:, inertial.size : inertial.size + armature.size] @ armature
    data, q = model.createData(), configuration(model, position, frame)
    still = np.diag(model.armature)
    still[root:][:, root:] = 0.0  # armature of the root's velocities is no joint's rotor
    M = pin.crba(model, data, q)
    M = np.triu(M) + np.triu(M, 1).T - still
    C = pin.computeCoriolisMatrix(model, data, q, T @ nu)
    psi = T.T @ (M @ T @ nudot_ref + C @ T @ nu_ref + pin.computeGeneralizedGravity(model, data, q))
    scale = np.abs(T.T @ M @ T).max() * (1 + np.abs(T @ nu).max()) * (1 + np.abs(T @ nu_ref).max())
    np.testing.assert_allclose(ours, psi, atol=RELATIVE * max(scale, np.abs(psi).max()))


@pytest.mark.parametrize("name", ["platform_arm", "two_axis_arm", "mobile", "fixed"])
@pytest.mark.parametrize("seed", [1, 2])
def test_it_is_pinocchios_regressor_where_the_reference_is_the_motion(name, seed):
    """`computeJointTorqueRegressor` is linear in parameters of its own order: ten times as many bodies, other axes."""
    robot = robot_named(name)
    regressor, T = Regressor.of(robot), np.array(robot.T)
    model = with_any_inertias(robot.model, seed)
    frame = tuple(robot.frame) if robot.dimensions.base else (0.0, 0.0, 0.0)
    tree = flatten(model, T, robot.neutral_position(), frame, absorb=False)
    theta = inertial_parameters(tree, robot.dimensions.base)
    pi = np.concatenate([inertia.toDynamicParameters() for inertia in list(model.inertias)[1:]])
    rng = np.random.default_rng(seed)
    position, (nu, nudot) = regressor.random_position(rng), rng.standard_normal((2, robot.dimensions.dof))
    q = configuration(model, position, tree.frame)
    theirs = T.T @ pin.computeJointTorqueRegressor(model, model.createData(), q, T @ nu, T @ nudot) @ pi
    ours = regressor.matrix(position, nu, nu, nudot)[:, : theta.size] @ theta
    np.testing.assert_allclose(ours, theirs, atol=RELATIVE * np.abs(theirs).max())


def test_it_does_not_know_what_the_robot_weighs():
    robot = robot_named("mobile")
    model = with_any_inertias(robot.model, 7)
    other = replace(robot, model=model, damping=robot.damping * 3, coulomb=robot.coulomb * 2, viscous=robot.viscous + 1)
    assert not np.allclose(parameters(robot), parameters(other))
    one, two = Regressor.of(robot).massless, Regressor.of(other).massless
    for a, b in zip((*one.tree, *one[1:-2], *one.maps), (*two.tree, *two[1:-2], *two.maps), strict=True):
        np.testing.assert_array_equal(a, b)


def test_two_links_in_a_plane_have_the_base_parameters_of_the_textbook():
    """Without gravity: I_1 + l_1^2 m_2, I_2, m_2 l_1 c_2 (x and y), the second rotor, and friction of two joints."""
    assert Regressor.of(load("two_axis_arm")).identifiable().shape[1] == 5 + 2 + 2


@pytest.mark.parametrize("name", ["platform_arm", "mobile"])
def test_what_is_not_identifiable_changes_nothing(name):
    regressor, rng = Regressor.of(robot_named(name)), np.random.default_rng(9)
    basis = regressor.identifiable()
    assert 0 < basis.shape[1] < regressor.size
    Y = regressor.matrix(regressor.random_position(rng), *rng.standard_normal((3, regressor.massless.nu.size)))
    np.testing.assert_allclose(Y @ basis @ basis.T, Y, atol=1e-7 * np.abs(Y).max())


def test_every_column_has_a_name():
    regressor = Regressor.of(robot_named("mobile"))
    assert len(set(regressor.labels)) == regressor.size == regressor.massless.Y.shape[1]
    assert regressor.labels[0] == "root.m" and regressor.labels[10] == f"{regressor.bodies[1]}.m"
    assert regressor.labels[-1] == f"{regressor.joints[-1]}.coulomb"


def test_what_a_robot_picks_up_changes_the_columns_of_the_ends_of_its_arm():
    """The parameters of the robot with a load on its last link, less its own."""
    loop = load_experiment("track", ["robot=platform_arm"]).loop(load("platform_arm"), PD(Feedback(1.0, 1.0)))
    picked_up = Payload(mass=2.0, joint="arm_2_joint", at=(0.2, 0.1, 0.05), start=1.0)
    robot = replace(loop, disturbances=(picked_up,)).loaded()
    regressor = Regressor.of(load("platform_arm"))
    changed = np.flatnonzero(np.abs(parameters(robot) - parameters(load("platform_arm"))) > 1e-12)
    assert changed.size == 10 and changed.tolist() == regressor.carrying.tolist()


def test_a_measurement_becomes_a_state():
    robot = robot_named("mobile")
    known, rng = Regressor.of(robot).workspace(), np.random.default_rng(0)
    pose, velocity, q, qdot = rng.standard_normal(3), rng.standard_normal(2), *rng.standard_normal((2, 5))
    measured(known, pose, velocity, q, qdot, np.zeros(0))
    expected = robot.neutral_position()
    expected[:3], expected[robot.arm_index] = pose, q
    np.testing.assert_allclose(known.position, robot.follow(expected), atol=1e-15)
    np.testing.assert_array_equal(known.nu, [*velocity, *qdot])


def test_a_wrong_regressor_is_refused():
    robot = robot_named("platform_arm")
    regressor, T = Regressor.of(robot), np.array(robot.T)
    model = with_any_inertias(robot.model)
    theta = inertial_parameters(flatten(model, T, robot.neutral_position(), tuple(robot.frame), absorb=False), 2)
    regressor.verify(model, T, theta)
    with pytest.raises(RobotError, match="differs from Pinocchio's dynamics"):
        regressor.verify(model, T, theta * 1.001)
