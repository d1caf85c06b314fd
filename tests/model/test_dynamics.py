"""The reduced dynamics against three other answers: by hand, in the world frame of the thesis, and unreduced (KKT)."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from builders import step_feedback
from closed_form import QUARTER, Link, Planar, along, arm_link, inertial, joint
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import simpson

from mmnn_pin.errors import RobotError
from mmnn_pin.model import Robot, load
from mmnn_pin.model.base.overrides import Overrides
from mmnn_pin.model.checks.second_answers import WorldFrame
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.model.loading import build
from mmnn_pin.model.urdf.reading import parse
from mmnn_pin.plant.ideal import IdealPlant

G = 9.81
RANDOM = 1e-10  # relative; small wheels spin fast, and what they round off is large beside a small C
LIFT_MASS, BOOM_MASS, BOOM_CENTRE = 3.0, 2.0, 0.3


def robot_of(text: str) -> Robot:
    return build(parse(text.encode(), "robot.urdf"))


def lengths(low: float, high: float):
    return st.floats(low, high).map(lambda value: round(value, 6))


def pairs(low: float, high: float):
    return st.tuples(lengths(low, high), lengths(low, high))


signs = st.sampled_from([1, -1])
links = st.builds(
    Link,
    length=lengths(0.1, 1.0),
    mass=lengths(0.2, 8.0),
    centre=lengths(-0.1, 0.6),
    inertia=lengths(0.01, 0.5),
    damping=lengths(0.0, 2.0),
    coulomb=lengths(0.0, 2.0),
)
planars = st.builds(
    Planar,
    half_track=lengths(0.1, 0.6),
    radii=pairs(0.04, 0.2),
    flips=st.tuples(signs, signs),
    wheel_mass=lengths(0.2, 6.0),
    wheel_spin=lengths(0.001, 0.1),
    wheel_turn=lengths(0.001, 0.2),
    wheel_damping=lengths(0.0, 0.5),
    wheel_coulomb=lengths(0.0, 0.5),
    mass=lengths(5.0, 150.0),
    inertia=lengths(0.1, 9.0),
    centre=pairs(-0.3, 0.3),
    mount=pairs(-0.4, 0.4),
    links=st.tuples(links, links),
    root=st.tuples(lengths(-0.5, 0.5), lengths(-0.5, 0.5), lengths(-1.5, 1.5)),
)
seeds = st.integers(0, 10_000)
OFFSET = Planar(
    half_track=0.3,
    radii=(0.1, 0.13),
    flips=(-1, 1),
    wheel_damping=0.3,
    wheel_coulomb=0.2,
    centre=(0.1, -0.05),
    mount=(0.2, 0.1),
    links=(Link(0.5, 3.0, 0.2, 0.1, 0.2, 0.3), Link(damping=0.4)),
    root=(0.2, -0.1, 0.4),
)


def tower() -> Robot:
    """The robot with an offset axle and, beside the planar arm, a lift, a boom that feels gravity and a caster."""
    text = f'<link name="lift">{inertial(LIFT_MASS, (0.02, 0.02, 0.03))}</link>'
    limit = '<limit lower="-9" upper="9" effort="9" velocity="9"/><dynamics damping="0.5"/>'
    up = '<origin xyz="-0.1 0.05 0.5"/>'
    text += joint("lift_joint", "base", "lift", up, "0 0 1", limit, "prismatic")
    centre = f'<origin xyz="{BOOM_CENTRE} 0 0"/>'
    text += f'<link name="boom">{inertial(BOOM_MASS, (0.01, 0.05, 0.06), centre)}</link>'
    text += joint("boom_joint", "lift", "boom", '<origin xyz="0.1 0 0"/>', "0 1 0")
    leg = '<collision><origin xyz="0 0 -0.1"/><geometry><box size="0.02 0.02 0.2"/></geometry></collision>'
    text += f'<link name="caster">{inertial(0.5, (0.01, 0.01, 0.01))}{leg}</link>'
    text += joint("caster_joint", "base", "caster", '<origin xyz="-0.2 0 0.2"/>', "0 0 1")
    document = parse(OFFSET.urdf().replace("</robot>", text + "</robot>").encode(), "robot.urdf")
    return build(document, Overrides(free=("all",)))  # beside a tower the short arm could be a head


ROBOTS = {"platform_arm": load("platform_arm"), "offset": robot_of(OFFSET.urdf()), "tower": tower()}
ARMS = {"two_axis_arm": load("two_axis_arm")}
mobile = pytest.mark.parametrize("robot", ROBOTS.values(), ids=ROBOTS)
every = pytest.mark.parametrize("robot", (ROBOTS | ARMS).values(), ids=ROBOTS | ARMS)


def state(robot: Robot, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.uniform(-3, 3, robot.dimensions.full), rng.uniform(-2, 2, robot.dimensions.dof)


def rate(robot: Robot, position: np.ndarray, nu: np.ndarray) -> np.ndarray:
    """Time derivative of a position, as the thesis has it: qdot = S(phi) v."""
    out = robot.T @ nu
    if robot.dimensions.base:
        out[:3] = nu[0] * np.cos(position[2]), nu[0] * np.sin(position[2]), nu[1]
    return out


def close(actual: np.ndarray, wanted: np.ndarray, rtol: float = 1e-12) -> None:
    """Equal within a fraction of the largest entry."""
    np.testing.assert_allclose(actual, wanted, rtol=0, atol=rtol * max(1.0, np.abs(wanted).max()))


# --- By hand ----------------------------------------------------------------------------------------------------------


def hand_agrees(planar: Planar, robot: Robot, seed: int, rtol: float = 1e-12) -> None:
    dynamics = Dynamics(robot)
    position, nu = state(robot, seed)
    nu_ref, nudot_ref = np.random.default_rng(seed + 1).uniform(-2, 2, (2, 4))
    q = position[robot.arm_index]
    M, C, F = planar.mass_matrix(q), planar.coriolis_matrix(q, nu), planar.friction(nu)
    close(dynamics.mass_matrix(position), M, rtol)
    close(dynamics.coriolis_matrix(position, nu), C, rtol)
    close(dynamics.friction(nu), F, rtol)
    close(dynamics.psi(position, nu, nu_ref, nudot_ref), M @ nudot_ref + C @ nu_ref + F, rtol)
    close(robot.E, np.vstack((planar.wheel_rows(), np.eye(4)[2:])).T, rtol)


@pytest.mark.parametrize("seed", range(5))
def test_shipped_robot_is_the_one_of_the_tables_worked_out_by_hand(seed):
    hand_agrees(Planar(), ROBOTS["platform_arm"], seed)


@settings(max_examples=25, deadline=None)
@given(planar=planars, seed=seeds)
def test_planar_robots_are_those_worked_out_by_hand(planar, seed):
    hand_agrees(planar, robot_of(planar.urdf()), seed, RANDOM)


def test_tables_lumped_by_hand():
    b, r = 0.171, 0.075
    light = tuple(Link(mass=1e-12, inertia=1e-12) for _ in range(2))
    M = Planar(links=light).mass_matrix(np.zeros(2))[:2, :2]
    in_w = 6.609 + 2 * 5 * b**2 + 2 * 0.135 + 2 * 0.010 * b**2 / r**2
    close(M, np.diag([94 + 2 * 5 + 2 * 0.010 / r**2, in_w]), 1e-9)


# --- In the world frame -----------------------------------------------------------------------------------------------


@mobile
@pytest.mark.parametrize("seed", range(4))
def test_body_velocities_give_the_matrices_of_the_world_frame(robot, seed):
    dynamics, world = Dynamics(robot), WorldFrame(robot)
    position, nu = state(robot, seed)
    q = world.coordinates(position)
    S = world.null_space(q[2])
    close(dynamics.mass_matrix(position), world.reduced_mass_matrix(q))
    close(dynamics.coriolis_matrix(position, nu), world.reduced_coriolis_matrix(q, nu))
    close(dynamics.gravity(position), S.T @ world.gravity(q))


@settings(max_examples=15, deadline=None)
@given(planar=planars, seed=seeds)
def test_random_planar_robots_agree_with_the_world_frame(planar, seed):
    robot = robot_of(planar.urdf())
    world, (position, nu) = WorldFrame(robot), state(robot, seed)
    C = world.reduced_coriolis_matrix(world.coordinates(position), nu)
    close(Dynamics(robot).coriolis_matrix(position, nu), C, RANDOM)


@mobile
def test_leaving_Sdot_out_is_a_gross_error(robot):
    world = WorldFrame(robot)
    position, nu = np.zeros(robot.dimensions.full), np.ones(robot.dimensions.dof)
    q = world.coordinates(position)
    S = world.null_space(q[2])
    without = S.T @ world.coriolis_matrix(q, S @ nu) @ S
    error = (Dynamics(robot).coriolis_matrix(position, nu) - without) @ nu
    assert np.abs(error).max() > 1.0  # [N, N m] at unit velocities


@mobile
def test_S_and_its_rate_are_what_the_motion_says(robot):
    world, (position, nu) = WorldFrame(robot), state(robot)
    dt, phi, phidot = 1e-5, world.coordinates(position)[2], nu[1]
    step = dt * rate(robot, position, nu)
    qdot = (world.coordinates(position + step) - world.coordinates(position - step)) / (2 * dt)
    close(world.null_space(phi) @ nu, qdot, 1e-8)
    Sdot = (world.null_space(phi + dt * phidot) - world.null_space(phi - dt * phidot)) / (2 * dt)
    close(world.null_space_rate(phi, phidot), Sdot, 1e-8)


def test_S_of_the_thesis_is_its_upper_left_block():
    S = WorldFrame(ROBOTS["platform_arm"]).null_space(0.7)
    close(S[:3, :2], np.array([[np.cos(0.7), 0], [np.sin(0.7), 0], [0, 1]]))
    assert not S[:3, 2:].any()


def test_world_frame_is_that_of_a_differential_drive():
    with pytest.raises(RobotError, match="'fixed'"):
        WorldFrame(ARMS["two_axis_arm"])


# --- Unreduced: the KKT system in world coordinates -------------------------------------------------------------------


def constraints(robot: Robot, phi: float) -> tuple[np.ndarray, np.ndarray]:
    """A(q) of (2.12) in world coordinates and its derivative by phi: no lateral slip, wheels roll, the rest stands.

    Worked out from where the wheels are, not from the robot's T and A.
    """
    a, c, psi = robot.frame
    forward = along(phi + psi)
    left = QUARTER @ forward
    turning = QUARTER @ np.column_stack((along(phi), QUARTER @ along(phi))) @ (a, c)  # of the control frame, per phidot
    A, dA = np.zeros((2, len(robot.A), robot.dimensions.full))
    A[0, :2], A[0, 2], dA[0, :2] = left, left @ turning, -forward
    for i, wheel in enumerate(robot.base.wheels, start=1):
        A[i, :2], A[i, 2], dA[i, :2] = forward, forward @ turning - wheel.y, left
        A[i, robot.full_velocity_names.index(wheel.joint)] = -wheel.sign * wheel.radius
    for i, name in enumerate(robot.base.locked, start=3):
        A[i, robot.full_velocity_names.index(name)] = 1.0
    return A, dA


def kkt(robot: Robot, position: np.ndarray, nu: np.ndarray, motors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Acceleration nudot and lambda from `[M A'; A 0] [qddot; lambda] = [E u - C qdot - F; -Adot qdot]`."""
    world = WorldFrame(robot)
    q = world.coordinates(position)
    S = world.null_space(q[2])
    qdot = S @ nu
    A, dA = constraints(robot, q[2])
    Adot = dA * qdot[2]
    F = world.gravity(q) + robot.damping * qdot + robot.coulomb * np.tanh(qdot / 0.01)
    F[robot.arm_index] += robot.viscous[2:] * nu[2:]
    push = np.zeros(len(q))
    push[[robot.full_velocity_names.index(name) for name in robot.actuator_names]] = motors
    matrix = np.block([[world.mass_matrix(q), A.T], [A, np.zeros((len(A), len(A)))]])
    rest = push - world.coriolis_matrix(q, qdot) @ qdot - F
    solution = np.linalg.solve(matrix, np.concatenate((rest, -Adot @ qdot)))
    qddot, multipliers = np.split(solution, [len(q)])
    Sdot = world.null_space_rate(q[2], qdot[2])
    return np.linalg.lstsq(S, qddot - Sdot @ nu, rcond=None)[0], multipliers


@mobile
def test_constraints_of_the_unreduced_model_hold_and_turn_with_the_robot(robot):
    world, nu = WorldFrame(robot), np.ones(robot.dimensions.dof)
    phi = 0.3
    qdot = world.null_space(phi) @ nu
    A, dA = constraints(robot, phi)
    assert np.abs(A @ qdot).max() < 1e-13 * np.abs(qdot).max()
    assert np.abs(dA * qdot[2] @ qdot).max() > 0.5  # Adot qdot does not vanish as it does in body velocities


def kkt_agrees(robot: Robot, seed: int) -> None:
    robot = robot.with_friction([0.0, 0.0, *np.linspace(0.3, 0.7, robot.dimensions.arm)])
    dynamics, (position, nu) = Dynamics(robot), state(robot, seed)
    motors = np.random.default_rng(seed + 2).uniform(-5, 5, robot.dimensions.motors)
    nudot, multipliers = kkt(robot, position, nu, motors)
    close(dynamics.acceleration(position, nu, robot.E @ motors), nudot, 1e-8)
    close(dynamics.constraint_forces(position, nu, motors), multipliers, 1e-8)


@mobile
@pytest.mark.parametrize("seed", range(4))
def test_acceleration_and_constraint_forces_solve_the_unreduced_model(robot, seed):
    kkt_agrees(robot, seed)


@settings(max_examples=15, deadline=None)
@given(planar=planars, seed=seeds)
def test_random_planar_robots_solve_the_unreduced_model(planar, seed):
    kkt_agrees(robot_of(planar.urdf()), seed)


def test_lateral_force_of_a_body_on_a_circle_is_its_centripetal_force():
    light = tuple(Link(mass=1e-9, inertia=1e-9) for _ in range(2))
    planar = Planar(links=light)
    robot = robot_of(planar.urdf())
    v, w = 0.8, 1.5
    multipliers = Dynamics(robot).constraint_forces(np.zeros(7), np.array([v, w, 0, 0]), np.zeros(4))
    assert -multipliers[0] == pytest.approx((94 + 10) * v * w, rel=1e-6)  # to the left, where it turns to
    assert multipliers[1:] == pytest.approx([0, 0], abs=1e-6)


@mobile
def test_constraint_forces_balance_whatever_friction_the_base_has(robot):
    robot = robot.with_friction(np.linspace(1, 9, robot.dimensions.dof))
    dynamics, (position, nu) = Dynamics(robot), state(robot)
    motors = np.linspace(-2, 3, robot.dimensions.motors)
    tau = robot.E @ motors
    a = robot.T @ dynamics.acceleration(position, nu, tau)
    model, q, v = robot.model, robot.configuration(position), robot.T @ nu
    inverse = pin.rnea(model, model.createData(), q, v, a) + robot.A.T @ dynamics.constraint_forces(
        position, nu, motors
    )
    friction = robot.E_full @ motors - inverse  # all that is left
    close(robot.T.T @ friction, dynamics.friction(nu), 1e-10)
    assert v @ friction == pytest.approx(nu @ dynamics.friction(nu))


# --- Identities -------------------------------------------------------------------------------------------------------


@every
@pytest.mark.parametrize("seed", range(3))
def test_mass_matrix_changes_with_C_and_its_transpose(robot, seed):
    dynamics, (position, nu) = Dynamics(robot), state(robot, seed)
    step = 1e-5 * rate(robot, position, nu)
    Mdot = (dynamics.mass_matrix(position + step) - dynamics.mass_matrix(position - step)) / 2e-5
    C = dynamics.coriolis_matrix(position, nu)
    close(C + C.T, Mdot, 1e-8)
    assert np.abs(Mdot).max() > 1e-3 and np.abs(C - C.T).max() > 1e-3


@every
@pytest.mark.parametrize("seed", range(3))
def test_workspace_agrees_with_the_matrices(robot, seed):
    robot = robot.with_friction(np.linspace(1, 2, robot.dimensions.dof))
    dynamics, (position, nu) = Dynamics(robot), state(robot, seed)
    rng = np.random.default_rng(seed)
    nudot, nu_ref, nudot_ref = rng.uniform(-3, 3, (3, robot.dimensions.dof))
    rest = dynamics.coriolis_matrix(position, nu) @ nu + dynamics.gravity(position) + dynamics.friction(nu)
    M = dynamics.mass_matrix(position)
    psi, written = dynamics.psi(position, nu, nu_ref, nudot_ref), np.zeros(robot.dimensions.dof)
    dynamics.refresh(position, nu)
    close(dynamics.M, M)
    close(dynamics.h, rest)
    dynamics.refresh_psi(nu_ref, nudot_ref, written)
    close(written, psi)
    close(dynamics.acceleration(position, nu, M @ nudot + rest), nudot, 1e-10)


@every
def test_psi_of_the_motion_itself_is_inverse_dynamics(robot):
    robot = robot.with_friction(0.7)
    dynamics, (position, nu) = Dynamics(robot), state(robot)
    nudot = np.linspace(-1, 2, robot.dimensions.dof)
    full = pin.rnea(robot.model, robot.model.createData(), robot.configuration(position), robot.T @ nu, robot.T @ nudot)
    psi = dynamics.psi(position, nu, nu, nudot)
    close(psi, robot.T.T @ full + dynamics.friction(nu))
    close(dynamics.acceleration(position, nu, psi), nudot, 1e-10)


@every
def test_psi_is_not_linear_in_the_motion_itself_but_in_its_references(robot):
    dynamics, (position, nu) = Dynamics(robot), state(robot)
    a, b = np.random.default_rng(3).uniform(-2, 2, (2, 2, robot.dimensions.dof))
    zero = dynamics.psi(position, nu, 0 * nu, 0 * nu)
    close(zero, dynamics.gravity(position) + dynamics.friction(nu))
    close(
        dynamics.psi(position, nu, *(a + b)) + zero,
        dynamics.psi(position, nu, *a) + dynamics.psi(position, nu, *b),
        1e-11,
    )


@every
def test_passivity_of_the_error_dynamics_along_a_motion(robot):
    """`d/dt (s' M s / 2) = s' (Psi - tau)` for any reference and any torque, integrated over a simulated motion."""
    robot = robot.with_friction(0.05)
    plant, dynamics = IdealPlant(robot, 1e-3), Dynamics(robot)
    phases = np.arange(robot.dimensions.dof)
    position, nu = state(robot)
    plant.start(position, 0.3 * nu)
    inertia = np.diag(dynamics.mass_matrix(position))

    def torque(time: float, position: np.ndarray, nu: np.ndarray) -> np.ndarray:
        return inertia * (3.0 * np.sin(5.0 * time + phases) - nu) + dynamics.gravity(position)

    stored, supplied = [], []
    for k in range(101):
        time = k * plant.dt
        nu_ref, nudot_ref = np.cos(3.0 * time + phases), -3.0 * np.sin(3.0 * time + phases)
        s, tau = nu_ref - plant.nu, torque(time, plant.position, plant.nu)
        stored.append(0.5 * s @ dynamics.mass_matrix(plant.position) @ s)
        supplied.append(s @ (dynamics.psi(plant.position, plant.nu, nu_ref, nudot_ref) - tau))
        step_feedback(plant, time, torque)
    assert np.ptp(stored) > 1e-3
    tolerance = 1e-4 if robot.coulomb.any() else 1e-8  # Coulomb friction turns within a step
    assert simpson(supplied, dx=plant.dt) == pytest.approx(stored[-1] - stored[0], abs=tolerance * max(stored))


@every
def test_energy_changes_with_the_power_of_torques_and_friction(robot):
    robot = robot.with_friction(np.linspace(0.5, 1.0, robot.dimensions.dof))
    dynamics, (position, nu) = Dynamics(robot), state(robot)
    tau = np.linspace(-4, 5, robot.dimensions.dof)
    dt, nudot = 1e-5, dynamics.acceleration(position, nu, tau)
    before, after = (dynamics.energy(position + t * rate(robot, position, nu), nu + t * nudot) for t in (-dt, dt))
    assert (after - before) / (2 * dt) == pytest.approx(nu @ (tau - dynamics.friction(nu)), rel=1e-6, abs=1e-6)


# --- Signs ------------------------------------------------------------------------------------------------------------


@settings(max_examples=30, deadline=None)
@given(planar=planars, seed=seeds)
def test_motors_do_the_same_work_on_their_joints_and_on_nu(planar, seed):
    robot = robot_of(planar.urdf())
    u, nu = np.random.default_rng(seed).uniform(-5, 5, (2, 4))
    rates = np.concatenate((planar.wheel_rows() @ nu, nu[2:]))
    assert (robot.E @ u) @ nu == pytest.approx(u @ rates, abs=1e-9)
    assert robot.actuator_names == ("left_joint", "right_joint", "one_joint", "two_joint")


@settings(max_examples=15, deadline=None)
@given(flips=st.tuples(signs, signs))
def test_pushing_the_left_wheel_forward_turns_the_robot_right(flips):
    robot = robot_of(Planar(flips=flips).urdf())
    dynamics = Dynamics(robot)
    v, w, *_ = dynamics.acceleration(np.zeros(7), np.zeros(4), robot.E @ [flips[0], 0, 0, 0])
    assert v > 0 and w < 0
    v, w, *_ = dynamics.acceleration(np.zeros(7), np.zeros(4), robot.E @ [0, flips[1], 0, 0])
    assert v > 0 and w > 0
    v, w, *_ = dynamics.acceleration(np.zeros(7), np.zeros(4), robot.E @ [*flips, 0, 0])
    assert v > 0 and w == pytest.approx(0, abs=1e-12)


@every
@pytest.mark.parametrize("seed", range(3))
def test_friction_takes_energy_out_and_slows_down(robot, seed):
    robot = robot.with_friction(0.5)
    dynamics, (position, nu) = Dynamics(robot), state(robot, seed)
    assert nu @ dynamics.friction(nu) > 0
    close(dynamics.friction(-nu), -dynamics.friction(nu))
    bare = Dynamics(load("two_axis_arm") if not robot.dimensions.base else robot.with_friction(0.0))
    slowed = dynamics.acceleration(position, nu, nu) - bare.acceleration(position, nu, nu)
    assert nu @ bare.mass_matrix(position) @ slowed < 0


def test_friction_adds_up_from_the_joints_and_from_the_declared():
    planar = Planar(wheel_damping=0.2, wheel_coulomb=0.1, links=(Link(damping=0.3), Link(coulomb=0.4)))
    robot = robot_of(planar.urdf()).with_friction([5, 6, 7, 8])
    nu = np.array([0.5, 0.3, -0.2, 0.004])
    close(Dynamics(robot).friction(nu), planar.friction(nu) + [5, 6, 7, 8] * nu)
    close(Dynamics(robot).friction(nu)[3:], np.array([0.4 * np.tanh(0.4) + 8 * 0.004]))


def test_gravity_of_a_lift_and_a_boom_by_hand():
    robot = ROBOTS["tower"]
    dynamics, (position, _) = Dynamics(robot), state(robot)
    angle, height = (position[robot.full_velocity_names.index(n)] for n in ("boom_joint", "lift_joint"))
    wanted = dict.fromkeys(robot.velocity_names, 0.0)
    wanted["lift_joint"] = (LIFT_MASS + BOOM_MASS) * G
    wanted["boom_joint"] = -BOOM_MASS * G * BOOM_CENTRE * np.cos(angle)  # a turn about +y lowers the boom
    close(dynamics.gravity(position), np.array(list(wanted.values())), 1e-12)
    lower = position.copy()
    lower[robot.full_velocity_names.index("lift_joint")] = 0.0
    still = np.zeros(robot.dimensions.dof)
    raised = dynamics.energy(position, still) - dynamics.energy(lower, still)
    assert raised == pytest.approx((LIFT_MASS + BOOM_MASS) * G * height)


@pytest.mark.parametrize(("axis", "feels"), [("0 0 1", False), ("0 1 0", True), ("0 0.001 1", True)])
def test_gravity_is_felt_by_an_arm_with_a_horizontal_axis(axis, feels):
    text = '<robot name="a"><link name="base"/>' + arm_link("one", "base", "<origin/>", Link()) + "</robot>"
    robot = robot_of(text.replace('"0 0 1"', f'"{axis}"'))
    dynamics = Dynamics(robot)
    assert dynamics.feels_gravity is feels
    dynamics.refresh(np.array([0.4]), np.zeros(1))
    assert (abs(dynamics.h[0]) > 1e-3) == feels and (dynamics.potential() != 0) == feels


def test_thesis_robots_do_not_feel_gravity_and_the_tower_does():
    flags = {name: Dynamics(robot).feels_gravity for name, robot in (ROBOTS | ARMS).items()}
    assert flags == {"platform_arm": False, "two_axis_arm": False, "offset": False, "tower": True}


def test_friction_declared_on_the_base_leaves_the_lateral_force_alone_at_the_axle() -> None:
    free = load("platform_arm")
    braked = free.with_friction([30.0, 5.0, 0.5, 0.5])
    rng = np.random.default_rng(3)
    position, nu, motors = rng.standard_normal(7), rng.standard_normal(4), np.zeros(4)
    rows = slice(0, 1)  # the force that keeps the wheels from sliding sideways
    coasting = Dynamics(free).constraint_forces(position, nu, motors)[rows]
    # The same motion with the friction's work put back by the motors needs the same lateral force.
    pushed = np.linalg.solve(braked.E, braked.viscous * nu)
    assert Dynamics(braked).constraint_forces(position, nu, pushed)[rows] == pytest.approx(coasting, rel=1e-9)
