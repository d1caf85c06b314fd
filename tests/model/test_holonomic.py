"""Holonomic bases: the tracking law, paths with a heading of their own, the sampled loop, and a mecanum robot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from builders import first_of
from hypothesis import given, settings
from hypothesis import strategies as st
from learning import assert_engines_agree, assert_frozen
from numba import config
from robots import mobile_arm

from mmnn_pin.errors import ConfigError, TrajectoryError
from mmnn_pin.kinematic import Kinematic, body_error
from mmnn_pin.lab.experiments.config import load_experiment
from mmnn_pin.loop.before_run import Start
from mmnn_pin.loop.loop import Loop
from mmnn_pin.loop.sampled import sampled_loop
from mmnn_pin.model.base.holonomic import HolonomicBase, holonomic_command
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.model.regressor import Regressor
from mmnn_pin.model.robot import Robot
from mmnn_pin.model.tree.body import parameters
from mmnn_pin.reference import (
    BaseTable,
    Circle,
    Eight,
    Hold,
    HolonomicPath,
    Line,
    MinimumJerk,
    Sine,
    Trajectory,
    Waypoints,
)
from mmnn_pin.settings import Timing
from mmnn_pin.signals import Array, Dimensions
from mmnn_pin.torque.controller import Feedback
from mmnn_pin.torque.model_based import PD, ComputedTorque
from mmnn_pin.torque.neural import Neural
from mmnn_pin.torque.two_layer import TwoLayer

GAINS = np.array([2.0, 3.0, 4.0])
PATHS = {
    "line": Line(0.4, (1.0, 2.0, 0.3), ramp=0.5),
    "circle": Circle(1.0, 0.5, ramp=0.5),
    "eight": Eight(2.0, 1.0, 8.0, ramp=1.0),
    "waypoints": Waypoints(((0, 0), (2, 0), (2, 2)), 0.5, 0.3),
}
HEADINGS = {"along": None, "hold": Hold(0.7), "sine": Sine(0.8, 3.0), "turn": MinimumJerk(0.0, 3.0, 2.0, 0.5)}


def mecanum(arm: int = 2) -> Robot:
    """The differential drive of `robots`, moved as a mecanum base would: all three planar velocities are free.

    Its two wheels stand still and three motors act on the base directly; only the dimensions matter here.
    """
    robot = mobile_arm(arm)
    nv, p = robot.dimensions.full, arm + 3
    T = np.zeros((nv, p))
    T[:3, :3] = np.linalg.inv(robot.base.to_control)
    T[robot.arm_index, 3 + np.arange(arm)] = 1.0
    still = [i for i in range(3, nv) if i not in robot.arm_index]
    stands = {robot.full_velocity_names[i]: 0.0 for i in still}
    E_full = np.eye(nv)[:, [0, 1, 2, *robot.arm_index]]
    return replace(
        robot,
        base=HolonomicBase(frame=robot.base.frame, floor=robot.base.floor),
        dimensions=Dimensions(base=3, arm=arm, full=nv, motors=p, kind="holonomic", sideways=True),
        velocity_names=("vx", "vy", "w", *robot.joint_names),
        actuator_names=("push", "slide", "turn", *robot.joint_names),
        template=T,
        E_full=E_full,
        arm=replace(robot.arm, locked=stands),
        effort_limits=np.full(p, np.inf),
        viscous=np.zeros(p),
    )


def command(error: Array, v_ref: Array, a_ref: Array, velocity: Array) -> tuple[Array, Array]:
    alpha, alphadot = np.zeros(3), np.zeros(3)
    holonomic_command(error, v_ref, a_ref, velocity, GAINS, alpha, alphadot)
    return alpha, alphadot


def moved(pose: Array, velocity: Array, t: float) -> Array:
    """Pose after a time of constant velocity in the world (an error of order t^2 in the curve, which cancels)."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    vx, vy, w = velocity
    return pose + t * np.array([c * vx - s * vy, s * vx + c * vy, w])


numbers = st.floats(-2, 2)


@settings(max_examples=40, deadline=None)
@given(*(st.tuples(numbers, numbers, numbers).map(np.array) for _ in range(5)))
def test_alphadot_is_the_derivative_of_alpha(pose_ref, pose, v_ref, a_ref, velocity):
    def alpha_at(t: float) -> Array:
        error = np.zeros(3)
        body_error(moved(pose_ref, v_ref, t), moved(pose, velocity, t), error)
        return command(error, v_ref + t * a_ref, a_ref, velocity)[0]

    if abs(abs(pose_ref[2] - pose[2]) - np.pi) < 1e-3:
        return  # the wrapped heading error jumps here, though alpha does not
    error, h = np.zeros(3), 1e-5
    body_error(pose_ref, pose, error)
    slope = (alpha_at(h) - alpha_at(-h)) / (2 * h)
    np.testing.assert_allclose(command(error, v_ref, a_ref, velocity)[1], slope, rtol=1e-6, atol=1e-6)


@settings(max_examples=40, deadline=None)
@given(*(st.tuples(numbers, numbers, numbers).map(np.array) for _ in range(3)))
def test_lyapunov_function_decreases_as_stated(error, v_ref, z):
    """`Vdot = -kx ex^2 - ky ey^2 - kphi sin^2 ephi + ex z1 + ey z2 + sin(ephi) z3` along the true error motion."""

    def V(e: Array) -> float:
        return (e[0] ** 2 + e[1] ** 2) / 2 + 1 - np.cos(e[2])

    pose_ref, pose = np.zeros(3), np.zeros(3)
    # A pose with this error: the reference at the origin of the world, looked at from the base.
    pose[2] = -error[2]
    c, s = np.cos(pose[2]), np.sin(pose[2])
    pose[0], pose[1] = -(c * error[0] - s * error[1]), -(s * error[0] + c * error[1])
    velocity = command(error, v_ref, np.zeros(3), np.zeros(3))[0] - z

    def V_at(t: float) -> float:
        e = np.zeros(3)
        body_error(moved(pose_ref, v_ref, t), moved(pose, velocity, t), e)
        return V(e)

    h, sine = 1e-5, np.sin(error[2])
    expected = -GAINS @ [error[0] ** 2, error[1] ** 2, sine**2] + z @ [error[0], error[1], sine]
    assert (V_at(h) - V_at(-h)) / (2 * h) == pytest.approx(expected, rel=1e-5, abs=1e-5)


@pytest.mark.parametrize("heading", HEADINGS)
@pytest.mark.parametrize("path", PATHS)
def test_path_velocities_are_the_derivatives_of_its_poses(path, heading):
    holonomic_path = HolonomicPath(PATHS[path], HEADINGS[heading])
    t, h = np.linspace(0.2, 3.9, 38) + 0.013, 1e-5
    at, before, after = (holonomic_path.sample(times) for times in (t, t - h, t + h))
    rate = (after.pose - before.pose) / (2 * h)
    c, s = np.cos(at.pose[:, 2]), np.sin(at.pose[:, 2])
    own = np.stack([c * rate[:, 0] + s * rate[:, 1], c * rate[:, 1] - s * rate[:, 0], rate[:, 2]], axis=1)
    np.testing.assert_allclose(at.velocity, own, atol=1e-7)
    np.testing.assert_allclose(at.acceleration, (after.velocity - before.velocity) / (2 * h), atol=1e-5)
    np.testing.assert_allclose(at.pose[:, :2], PATHS[path].sample(t).pose[:, :2], atol=1e-12)
    if heading == "along":
        np.testing.assert_allclose(at.velocity[:, 1], 0.0, atol=1e-12)


def test_table_of_a_holonomic_path(tmp_path):
    t = np.linspace(0, 4, 201)
    samples = HolonomicPath(PATHS["eight"], HEADINGS["sine"]).sample(t)
    table = BaseTable(t, samples.pose, samples.velocity)
    assert table.sideways
    np.testing.assert_allclose(
        table.sample([1.234]).pose, HolonomicPath(PATHS["eight"], HEADINGS["sine"]).sample([1.234]).pose, atol=1e-5
    )
    file = tmp_path / "path.csv"
    rows = np.column_stack([t, samples.pose, samples.velocity])
    np.savetxt(file, rows, delimiter=",", header="t,x,y,phi,vx,vy,w", comments="")
    np.testing.assert_allclose(BaseTable.read(file).velocity, samples.velocity)
    wrong = samples.velocity.copy()
    wrong[:, 1] += 0.3
    with pytest.raises(TrajectoryError, match=r"vy = .* m/s at t"):
        BaseTable(t, samples.pose, wrong)
    with pytest.raises(TrajectoryError, match="moves sideways"):
        BaseTable(t, samples.pose, samples.velocity[:, [0, 2]])


def test_paths_and_bases_that_do_not_fit_are_refused():
    with pytest.raises(TrajectoryError, match="not a path"):
        HolonomicPath("eight")  # type: ignore[arg-type]
    robot = mecanum()
    with pytest.raises(TrajectoryError, match=r"\(v, w\) for a base of \(vx, vy, w\)"):
        Trajectory(PATHS["line"], (Hold(0.0),) * 2).table([0.0, 1.0], robot.dimensions)
    experiment = load_experiment("track", ["reference.heading={type='hold', value=1.0}"])
    with pytest.raises(ConfigError, match="heading for differential bases"):
        experiment.trajectory(mobile_arm(2).dimensions)
    path = experiment.trajectory(robot.dimensions).base
    assert path is not None and path.sideways
    np.testing.assert_allclose(path.sample([0.0, 1.0, 3.0]).pose[:, 2], 1.0)


@pytest.mark.parametrize("share", [0.5, 1.5])
def test_sampled_loop_agrees_with_the_run(share):
    """A radius below 1 settles, one above grows, from a small error in a straight sideways motion."""
    robot, h = mecanum(), 0.01
    path = HolonomicPath(Line(0.3), Hold(0.4))
    inverse = np.linalg.inv(mass(robot))
    gains = share * 2 / (h * np.linalg.eigvals(inverse @ np.diag(1 / np.diag(inverse))).real.max() * np.diag(inverse))
    trajectory = Trajectory(path, (Hold(0.0),) * 2)
    kinematic = Kinematic(holonomic=(2.0, 3.0, 1.0), K=2.0)
    v_ref = path.sample([0.0]).velocity[0]
    verdict = sampled_loop(
        mass(robot), gains, robot.base.linear_errors(v_ref, kinematic.base_gains(robot.dimensions)), np.full(2, 2.0), h
    )
    assert verdict.stable == (share < 1)
    feedback = Feedback(base=tuple(gains[:3].tolist()), arm=tuple(gains[3:].tolist()))
    timing = Timing(0.3 if config.DISABLE_JIT else 3.0, h, h / 2)
    start = Start(pose_offset=(1e-3, -1e-3, 1e-3), moving=True)
    loop = Loop(no_friction(robot), trajectory, PD(feedback), kinematic, timing, start, check_gains=False)
    run = loop.run()
    grew = run.outcome.status == "diverged" or abs(run["z"][-20:]).max() > 1e-2
    assert grew != verdict.stable


def mass(robot: Robot) -> Array:
    return Dynamics(robot).mass_matrix(robot.neutral_position())


def no_friction(robot: Robot) -> Robot:
    return replace(robot, damping=np.zeros(robot.dimensions.full), coulomb=np.zeros(robot.dimensions.full))


@pytest.mark.parametrize("engine", ["ordinary", "compiled"])
@pytest.mark.parametrize("kind", ["computed_torque", "two_layer"])
def test_mecanum_follows_an_eight_while_it_turns(kind, engine):
    robot = mecanum()
    trajectory = Trajectory(HolonomicPath(PATHS["eight"], Sine(0.5, 4.0)), (Sine(0.3, 3.0), Hold(0.2)))
    feedback = Feedback(base=(800.0, 800.0, 80.0), arm=5.0)
    controller = ComputedTorque(feedback) if kind == "computed_torque" else Neural(TwoLayer(hidden=6), feedback)
    timing = Timing(0.03 if config.DISABLE_JIT else 2.0, 0.002, 0.001)
    start = Start(pose_offset=(0.02, -0.03, 0.05), moving=True)
    run = Loop(robot, trajectory, controller, timing=timing, start=start, engine=engine).run()  # type: ignore[arg-type]
    assert run.outcome.status == "completed"
    assert run["alpha"].shape[1] == 3 and run["psi_hat"].shape[1] == 5
    if kind == "computed_torque" and not config.DISABLE_JIT:
        assert np.linalg.norm(run["pose_error"][-1]) < 1e-4 < np.linalg.norm(run["pose_error"][0])


LEARNERS = [
    *("kalman_regressor", "kalman_bilinear", "kalman_features", "kalman_residual", "concurrent", "adaptive"),
    *("adaptive_composite", "two_layer_residual"),
]


def learning_loop(name: str, duration: float) -> Loop:
    """A mecanum robot on an eight while it turns, learned of by a controller of the experiments, or PD."""
    robot, small = mecanum(1), ["kalman.bilinear.hidden=3", "kalman.residual.hidden=3", "kalman.features.hidden=30"]
    gains = [
        "feedback.base=[400.0, 400.0, 40.0]",
        "feedback.arm=5.0",
        "concurrent.entries=20",
    ]
    quick = [f"kalman.{table}.state_pole=500.0" for table in ("regressor", "bilinear", "features", "residual")]
    experiment = load_experiment("chapter4", [*small, *gains, *quick, "robust.base=0.0", "robust.arm=0.0"])
    trajectory = Trajectory(HolonomicPath(PATHS["eight"], Sine(0.5, 4.0)), (Sine(0.3, 3.0),))
    controller = experiment.controller(name, robot=robot)
    return Loop(robot, trajectory, controller, timing=Timing(duration, 0.002, 0.002), start=Start(moving=True))


@pytest.mark.parametrize("name", first_of(LEARNERS, "adaptive_composite"))
def test_learners_of_a_holonomic_base_learn(name):
    """Sideways motion too: the base follows better than by PD, from what was learned."""
    short = config.DISABLE_JIT
    run = learning_loop(name, 0.03 if short else 2.0).run()
    assert run.outcome.status == "completed" and run["psi_hat"].shape[1] == 4
    assert all(np.isfinite(run["psi_hat"]).ravel())
    if not short:
        plain = learning_loop("pd", 2.0).run()
        late = slice(len(run) // 2, None)
        error, of_pd = (np.sqrt(np.mean(np.asarray(r["true_z"])[late] ** 2, axis=0)) for r in (run, plain))
        assert (error < 0.7 * of_pd).all(), error / of_pd


@pytest.mark.parametrize("name", first_of(LEARNERS, "adaptive_composite", "kalman_regressor"))
def test_both_engines_and_fixed_weights_on_a_holonomic_base(name, monkeypatch):
    if config.DISABLE_JIT:
        monkeypatch.setattr("mmnn_pin.torque.kalman.SAMPLES", 10)  # of the prior: the time that plain Python takes
        monkeypatch.setattr("mmnn_pin.torque.concurrent.SAMPLES", 30)
        monkeypatch.setattr("mmnn_pin.torque.prior.SAMPLES", 5)
    loop = learning_loop(name, 0.01 if config.DISABLE_JIT else 0.2)
    assert_engines_agree(loop)
    assert_frozen(loop)


def test_the_regressor_of_a_holonomic_base_is_its_dynamics():
    """`Y theta = Psi` with sideways velocities; theta from the robot, Psi from Pinocchio."""
    robot, rng = mecanum(2).with_friction((30.0, 40.0, 5.0, 0.2, 0.1)), np.random.default_rng(0)
    regressor, dynamics, theta = Regressor.of(robot), Dynamics(robot), parameters(robot)
    for _ in range(20):
        position = regressor.random_position(rng)
        nu, nu_ref, nudot_ref = rng.standard_normal((3, 5))
        psi = dynamics.psi(position, nu, nu_ref, nudot_ref)
        ours = regressor.matrix(position, nu, nu_ref, nudot_ref) @ theta
        np.testing.assert_allclose(ours, psi, rtol=0, atol=1e-10 * np.abs(psi).max())
