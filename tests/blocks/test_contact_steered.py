"""Bases that steer on the contact plant: rolling, linkages, friction, pushes against the ideal plant, and slipping."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numba import config
from steered import LAYOUTS, Array, car, robot_of, swings, truck

from mmnn_pin.errors import RobotError
from mmnn_pin.lab.experiments.config import load_experiment
from mmnn_pin.lab.experiments.runner import run_experiment
from mmnn_pin.model import Robot, load
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
    masters = 1 + np.arange(len(robot.base.masters) if swings(robot.base) else 0)
    for k in range(50 if PLAIN else 500):
        tau[0] = 15.0 * np.cos(0.004 * k)
        gravity = dynamics.gravity(plants[0].position)
        for plant in plants:
            if masters.size:  # so that all wheels of a swerve drive agree: where two do not, the floor holds both
                at = plant.position[robot.shape_index], plant.nu[masters]
                there = start[robot.shape_index] + going(robot)[masters] * k * DT
                tau[masters] = 200.0 * (there - at[0]) + 5.0 * (going(robot)[masters] - at[1])
            plant.step(tau + gravity)
            plant.refresh()
    apart = np.abs(plants[1].position - plants[0].position)
    stiff = swings(robot.base)  # four rigid wheels: 0.3 mrad between them use all their grip
    assert plants[1].findings() == [] and (plants[1].traction.max() < 0.9 or stiff)
    assert np.abs(plants[0].position - start)[:2].max() > (0.01 if PLAIN else 0.2)
    assert apart[:3].max() < 2e-5 and apart.max() < (5e-4 if stiff else 1e-4)
    np.testing.assert_allclose(plants[1].nu, plants[0].nu, atol=2e-3 if stiff else 1e-4)
    np.testing.assert_allclose(robot.follow(plants[1].position.copy()), plants[1].position, atol=1e-6)
    assert plants[1].y[-1] == pytest.approx(plants[0].y[-1], abs=1e-3)


@EVERY
def test_it_accelerates_as_the_ideal_plant(name: str) -> None:
    """What small torques on every velocity do from rest over 20 ms, as a mass matrix."""
    robot = made(name)
    start, p, steps = turned(robot), robot.dimensions.dof, 20
    M, hold = Dynamics(robot).mass_matrix(start), Dynamics(robot).gravity(start)
    size = np.sqrt(np.diag(M))

    def response(plant: IdealPlant | ContactPlant) -> Array:
        columns = []
        for kick in np.diag(0.01 * size):
            found = []
            for sign in (1.0, -1.0):
                plant.start(start, np.zeros(p))
                for _ in range(steps):
                    plant.step(hold + sign * kick)
                    plant.refresh()
                found.append(plant.nu.copy())
            columns.append((found[0] - found[1]) / (2 * kick.max() * steps * DT))
        return np.linalg.inv(np.array(columns).T)

    ours, expected = response(ContactPlant(robot, DT)), response(IdealPlant(robot, DT))
    assert np.abs((ours - expected) / np.outer(size, size)).max() < 1e-4


@EVERY
def test_pushes_and_friction_on_its_velocities(name: str) -> None:
    """On u a push is a force on the frame, on a steering rate a torque on its joint; so is declared friction."""
    nb = (robot := made(name)).dimensions.base
    robot = robot.with_friction((*(20.0, *[2.0] * (nb - 1)), *[0.5] * 3))
    plants = IdealPlant(robot, DT), ContactPlant(robot, DT, "rk4", Contact(step=DT))
    push, dynamics = np.zeros(robot.dimensions.dof), Dynamics(robot)
    push[0], push[nb:] = 30.0, 0.5
    for i in range(1, nb):
        push[i] = 0.0 if swings(robot.base) else 2.0
    for plant in plants:
        plant.start(turned(robot), np.zeros(robot.dimensions.dof))
        for _ in range(30 if PLAIN else 200):
            plant.step(push + dynamics.gravity(plant.position), push)
            plant.refresh()
    scale = np.abs(plants[0].nu).max()
    assert scale > (0.003 if PLAIN else 0.02)
    np.testing.assert_allclose(plants[1].nu, plants[0].nu, atol=1e-3 * scale)
    apart = np.abs(plants[1].position - plants[0].position).max()
    assert apart < (1e-3 if swings(robot.base) else 1e-4)


@EVERY
def test_contact_points_slide_as_mujoco_says(name: str) -> None:
    """At any velocities, rolling or not: those of the wheels' material points on the floor."""
    robot, rng = made(name), np.random.default_rng(1)
    plant = ContactPlant(robot, DT)
    plant.start(turned(robot), going(robot))
    velocity, wheels = np.zeros(6), {i: geom for geom, i in plant.wheel_of.items()}
    for _ in range(5):
        plant.data.qvel[:] = rng.standard_normal(plant.model.nv)
        plant.data.qvel[2:5] = 0.0
        mujoco.mj_forward(plant.model, plant.data)
        plant._read()
        plant._take_slip()
        for i, wheel in enumerate(robot.base.wheels):
            mujoco.mj_objectVelocity(plant.model, plant.data, mujoco.mjtObj.mjOBJ_GEOM, wheels[i], velocity, 0)
            matter = velocity[3:] + np.cross(velocity[:3], [0.0, 0.0, -wheel.radius])
            assert plant.speed[i] == pytest.approx(np.hypot(matter[0], matter[1]), rel=1e-9)
        assert plant.residual[0] == pytest.approx(np.linalg.norm(plant.speed), rel=1e-12)


@EVERY
def test_motors_give_the_torque_on_nu(name: str) -> None:
    """The least ones that do, where the pivots stand."""
    robot, tau = made(name), np.arange(1.0, 1.0 + made(name).dimensions.dof)
    plant = ContactPlant(robot, DT)
    plant.start(turned(robot, 0.5), np.zeros(robot.dimensions.dof))
    motors, E = plant.pivots.drive(tau), robot.E_at(plant.position)
    np.testing.assert_allclose(E @ motors, tau, rtol=1e-9)
    np.testing.assert_allclose(motors, np.linalg.pinv(E) @ tau, rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize("method", ["rk4", "implicit_friction"])
def test_a_linkage_is_stiff_as_the_master_turns(method: str) -> None:
    """From stop to stop: the follower is where both axles meet the fixed one, and moves as it does."""
    robot = made("car")
    plant, dynamics = ContactPlant(robot, DT, method, Contact(step=DT)), Dynamics(robot)
    plant.start(turned(robot, -0.6), np.zeros(robot.dimensions.dof))
    apart, turning = 0.0, 0.0
    for k in range(50 if PLAIN else 400):
        tau = dynamics.gravity(plant.position)
        tau[1] += 8.0 * (3.0 * np.sin(0.01 * k) - plant.nu[1])
        plant.step(tau)
        plant.refresh()
        rates = plant.velocity[robot.shape_index]
        exact = robot.T_at(plant.position)[robot.shape_index] @ plant.nu
        apart = max(apart, np.abs(robot.follow(plant.position.copy()) - plant.position).max())
        turning = max(turning, np.abs(rates - exact).max())
    assert apart < (1e-5 if method == "rk4" else 2e-4) and turning < 0.01
    assert abs(plant.position[robot.shape_index[0]] + 0.6) > (0.01 if PLAIN else 0.5)


def test_ice_under_it_is_told() -> None:
    """A car that turns on little friction slides ahead, and says which wheel was the fastest."""
    robot = made("car")
    plant = ContactPlant(robot, DT, "rk4", Contact(friction=0.05))
    plant.start(turned(robot, 0.6), going(robot, 2.0))
    for _ in range(20 if PLAIN else 100):
        plant.step(np.zeros(robot.dimensions.dof))
        plant.refresh()
    assert plant.traction.max() == pytest.approx(1.0, abs=0.02) and plant.speed.max() > 0.02
    (told,) = plant.findings()
    assert "slipped" in told and any(f"'{wheel.joint}'" in told for wheel in robot.base.wheels)


def test_patches_are_under_the_wheels_where_they_stand() -> None:
    """Of a trailer's wheels, too, turned on its hitch."""
    robot = robot_of(truck(1))
    plant = ContactPlant(robot, DT, "rk4")
    plant.start(turned(robot, 0.6), np.zeros(robot.dimensions.dof))
    for i, wheel in enumerate(robot.base.wheels):
        x, y, _ = plant.data.geom(f"wheel {i}").xpos
        if not x:
            mujoco.mj_forward(plant.model, plant.data)
            x, y, _ = plant.data.geom(f"wheel {i}").xpos
        near = Patch(0.123, (x - 1e-3, x + 1e-3), (y - 1e-3, y + 1e-3))
        plant.contact = Contact(patches=(near,))
        plant._take_floor(plant.motion)
        grips = plant.model.pair_friction[plant.pairs, 0]
        assert [
            name for name, grip in zip([w.joint for w in robot.base.wheels], grips, strict=True) if grip == 0.123
        ] == [wheel.joint]


def test_the_sign_of_u_outlives_a_payload() -> None:
    """A swerve drive whose wheels have turned by half a turn goes on with u as before."""
    robot = made("swerve of 4")
    for plant in (ContactPlant(robot, DT), IdealPlant(robot, DT)):
        plant.start(turned(robot, 0.0), np.zeros(robot.dimensions.dof))
        for angle in np.linspace(0.0, 3.0, 40):
            position = turned(robot, angle)
            if isinstance(plant, ContactPlant):
                plant.data.qpos[plant.at_q] = position[plant.moving]
                plant._read()
            else:
                plant.position[:] = position
            plant.refresh()
        n = plant.dynamics.maps.n.copy()
        assert np.cos(3.0) * n[0] + np.sin(3.0) * n[1] > 0.99
        plant.carry(robot.with_masses(1.2))
        np.testing.assert_allclose(plant.dynamics.maps.n, n, atol=1e-12)


def test_what_does_not_roll_is_refused() -> None:
    """A steered wheel without a joint of its own, in one line."""
    base = car()
    still = replace(base, wheels=tuple(wheel for wheel in base.wheels if wheel.joint != "front_left"))
    words = "what 'left_steer' steers has no joint to roll about: use the ideal one, --set plant=ideal"
    with pytest.raises(RobotError, match=words):
        feet_of(robot_of(still))


@pytest.mark.skipif(PLAIN, reason="slow in plain Python")
@pytest.mark.parametrize("name", ["truck_trailer_arm", "casters_arm"])
def test_closed_loop_on_bundled_robots(name: str) -> None:
    """Track on both plants; slip and traction have the wheels' names."""
    settings = [f"robot='{name}'", "time.duration=1.0", "controllers=['computed_torque']"]
    runs = [
        run_experiment(load_experiment("track", [*settings, f"plant='{plant}'"]), "x").recordings["computed_torque"]
        for plant in ("ideal", "contact")
    ]
    apart = runs[1]["position"][:, :2] - runs[0]["position"][:, :2]
    assert np.linalg.norm(apart, axis=1).max() < 0.2e-3
    assert runs[1]["traction"].max() < 1 and runs[1]["slip"].max() < 0.01
    wheels = load(name).wheel_names
    assert runs[1].labels("slip") == runs[1].labels("traction") == wheels and len(wheels) in (4, 6)
