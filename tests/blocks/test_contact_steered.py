"""Bases that steer on the contact plant: rolling, linkages, friction and pushes against the ideal plant, and slipping."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from drives import robot_of as drive_of
from numba import config
from steered import ARM, LAYOUTS, Array, car, robot_of, swings, truck

from mmnn_pin.errors import RobotError
from mmnn_pin.model import Robot
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.plant.contact.feet import Contact, Patch, feet_of
from mmnn_pin.plant.ideal import IdealPlant

mujoco = pytest.importorskip("mujoco")
from mmnn_pin.plant.contact.plant import ContactPlant  # noqa: E402

PLAIN = bool(config.DISABLE_JIT)
DT = 0.001  # [s]
STANDING = [name for name in LAYOUTS if name not in ("swerve of 2", "turret")]  # on three wheels or more
EVERY = pytest.mark.parametrize("name", STANDING)
FRICTION = 0.02, 0.05  # of every joint: viscous and dry [N m s, N m]


def made(name: str) -> Robot:
    return robot_of(LAYOUTS[name]())


def turned(robot: Robot, angle: float = 0.3) -> Array:
    """A position off the origin with all pivots turned, to the left, and the arm bent."""
    position = robot.neutral_position()
    position[:3], position[robot.arm_index] = (0.3, -0.2, 0.5), 0.3
    for pivot in robot.base.pivots:
        position[robot.rows[pivot.joint]] = pivot.sign * angle
    return robot.follow(position)


def going(robot: Robot, speed: float = 0.6) -> Array:
    """A velocity at which all turns: a swerve drive's masters with each other."""
    nu = np.full(robot.dimensions.dof, 0.2)
    nu[0] = speed
    if swings(robot.base):
        nu[1 : robot.dimensions.base] = [0.2 * pivot.sign for pivot in robot.base.pivots]
    return nu


@EVERY
def test_it_starts_with_the_velocities_it_is_given(name: str) -> None:
    """`nu` from the frame's velocity and the pivots undoes `T nu`."""
    robot, rng = made(name), np.random.default_rng(0)
    plant = ContactPlant(robot, DT)
    for _ in range(5):
        nu = rng.standard_normal(robot.dimensions.dof)
        if swings(robot.base):
            nu[1 : robot.dimensions.base] = going(robot)[1 : robot.dimensions.base]
        plant.start(turned(robot, rng.uniform(-0.6, 0.6)), nu)
        np.testing.assert_allclose(plant.nu, nu, atol=1e-12)
        np.testing.assert_allclose(plant.velocity, robot.T_at(plant.position) @ nu, atol=1e-12)
        plant._take_slip()
        assert plant.residual[0] < 1e-12


@EVERY
def test_it_rolls_as_the_ideal_plant(name: str) -> None:
    """Under the torques of motors, with friction in every joint, both by RK4; followers stay on their linkage."""
    robot = made(name).with_joint_friction(*FRICTION)
    plants = IdealPlant(robot, DT), ContactPlant(robot, DT, "rk4", Contact(step=DT))
    dynamics, start, tau = Dynamics(robot), turned(robot), np.zeros(robot.dimensions.dof)
    for plant in plants:
        plant.start(start, going(robot))
    for k in range(50 if PLAIN else 500):
        tau[0] = 15.0 * np.cos(0.004 * k)
        gravity = dynamics.gravity(plants[0].position)
        for plant in plants:
            plant.step(tau + gravity)
            plant.refresh()
    apart = np.abs(plants[1].position - plants[0].position)
    assert plants[1].findings() == [] and plants[1].traction.max() < 0.9
    assert np.abs(plants[0].position - start)[:2].max() > (0.01 if PLAIN else 0.2)
    assert apart[:3].max() < 5e-5 and apart.max() < 5e-4
    np.testing.assert_allclose(plants[1].nu, plants[0].nu, atol=1e-3)
    np.testing.assert_allclose(robot.follow(plants[1].position.copy()), plants[1].position, atol=1e-6)
    assert plants[1].y[-1] == pytest.approx(plants[0].y[-1], abs=0.02)
