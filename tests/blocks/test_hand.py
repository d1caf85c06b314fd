"""Tasks of the hand: Jacobians, the program, limits, paths, and what happens where a goal cannot be had."""

from __future__ import annotations

from functools import cache

import msgspec
import numpy as np
import pinocchio as pin
import pytest
from closed_form import inertial, joint
from hypothesis import given, settings
from hypothesis import strategies as st
from robots import HALF_TRACK, RADIUS, place
from robots import robot_of as built
from scipy.spatial.transform import Rotation

from mmnn_pin import Loop, Timing, load
from mmnn_pin.errors import ConfigError, RobotError, TrajectoryError, UnknownName
from mmnn_pin.model.chain import chain_of, gradient, hands_of, move, poses
from mmnn_pin.model.robot import Robot
from mmnn_pin.reference import check_followable
from mmnn_pin.reference.follower import Follower
from mmnn_pin.reference.hand import (
    Capsule,
    FollowHand,
    HandCircle,
    HandLine,
    HandSpline,
    HandWish,
    Pieces,
    Task,
    Wait,
    WholeBody,
    WholeBodySettings,
    plan,
)
from mmnn_pin.reference.hand.capsules import Pairs, nearest
from mmnn_pin.reference.hand.path import HandPath
from mmnn_pin.reference.hand.tasks import TARGET
from mmnn_pin.reference.limits import Limits
from mmnn_pin.signals import Setpoint
from mmnn_pin.torque.controller import Feedback
from mmnn_pin.torque.model_based import PD

pytest.importorskip("daqp", reason="pip install 'mmnn_pin[tasks]'")
ROBOTS = ("platform_arm", "tiago", "tiago_pro", "panda", "two_axis_arm")  # differential, holonomic, fixed, two arms
H = 0.01


@cache
def robot_of(name: str) -> Robot:
    try:
        return load(name)
    except (RobotError, UnknownName) as error:  # example-robot-data
        pytest.skip(str(error))


def state(robot: Robot, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A random position and velocity."""
    rng, d = np.random.default_rng(seed), robot.dimensions
    offset, arm = robot.arm_map()
    position = offset + arm @ rng.uniform(-1, 1, d.arm)
    position[: d.pose] = rng.uniform(-2, 2, d.pose)
    return position, rng.standard_normal(d.dof)


def moved(robot: Robot, frame: str, position: np.ndarray, nu: np.ndarray) -> tuple[np.ndarray, ...]:
    out = np.zeros(12), np.zeros(6), np.zeros(6), np.zeros((6, nu.size))
    move(chain_of(robot, frame), position, nu, *out)
    return out


@pytest.mark.parametrize("name", ROBOTS)
def test_the_chain_moves_as_the_unreduced_model_of_pinocchio_does(name: str) -> None:
    robot = robot_of(name)
    data = robot.model.createData()
    for seed, frame in enumerate(hands_of(robot)):
        position, nu = state(robot, seed)
        place, twist, bias, J = moved(robot, frame, position, nu)
        q, v, i = robot.configuration(position), robot.T @ nu, robot.model.getFrameId(frame)
        pin.forwardKinematics(robot.model, data, q, v, np.zeros(robot.model.nv))
        at = pin.updateFramePlacement(robot.model, data, i)
        JS = pin.computeFrameJacobian(robot.model, data, q, i, pin.LOCAL_WORLD_ALIGNED) @ robot.T
        a = pin.getFrameClassicalAcceleration(robot.model, data, i, pin.LOCAL_WORLD_ALIGNED).vector
        for ours, theirs in ((place[:9], at.rotation.ravel()), (place[9:], at.translation), (J, JS), (bias, a)):
            np.testing.assert_allclose(ours, theirs, atol=1e-12)
        np.testing.assert_allclose(twist, JS @ nu, atol=1e-12)


@pytest.mark.parametrize("name", ROBOTS)
def test_jacobian_and_bias_are_finite_differences_of_the_placement(name: str) -> None:
    """The robot is moved by `S nu`, so side-slip cannot enter; the step is symmetric, its error is of order eps^2."""
    robot, eps = robot_of(name), 1e-5
    frame = hands_of(robot)[0]
    position, nu = state(robot, 3)
    _, twist, bias, _ = moved(robot, frame, position, nu)

    def after(dt: float) -> np.ndarray:
        there = position + dt * (robot.T @ nu)
        if d := robot.dimensions.pose:
            phi = position[2]
            for _ in range(20):  # the base on its arc, by the midpoint rule
                phi += dt / 40 * nu[robot.dimensions.base - 1]
                vx, vy = nu[0], nu[1] if robot.dimensions.base == 3 else 0.0
                step = np.array([np.cos(phi) * vx - np.sin(phi) * vy, np.sin(phi) * vx + np.cos(phi) * vy])
                there[:2] = (position[:2] if _ == 0 else there[:2]) + dt / 20 * step
                phi += dt / 40 * nu[robot.dimensions.base - 1]
            there[2] = phi
            assert d == 3
        return there

    ahead, behind = (moved(robot, frame, after(s * eps), nu) for s in (1, -1))
    np.testing.assert_allclose((ahead[0][9:] - behind[0][9:]) / (2 * eps), twist[:3], atol=1e-8)
    np.testing.assert_allclose((ahead[1] - behind[1]) / (2 * eps), bias, atol=1e-7)


@pytest.mark.parametrize("name", ROBOTS)
def test_the_gradient_of_the_jacobian_is_its_finite_difference(name: str) -> None:
    robot, eps = robot_of(name), 1e-6
    frame, d = hands_of(robot)[0], robot.dimensions
    position, nu = state(robot, 4)
    chain, B, found = chain_of(robot, frame), np.random.default_rng(0).standard_normal((6, d.arm)), np.zeros(d.arm)
    move(chain, position, nu, np.zeros(12), np.zeros(6), np.zeros(6), np.zeros((6, d.dof)))
    gradient(chain, B, d.base, found)
    arm = robot.arm_map()[1]
    for i in range(d.arm):
        J = [moved(robot, frame, position + s * eps * arm[:, i], nu)[3][:, d.base :] for s in (1, -1)]
        assert found[i] == pytest.approx(float((B * (J[0] - J[1])).sum()) / (2 * eps), abs=1e-7)


# -- paths -------------------------------------------------------------------------------------------------------------

TURNED = tuple(map(tuple, Rotation.random(4, random_state=1).as_quat()))
CURVE = HandSpline(((0.0, 0.0, 0.0), (0.1, 0.2, 0.0), (0.3, 0.1, 0.2), (0.4, 0.0, 0.1)), (0.0, 1.0, 1.5, 3.0), TURNED)
PATHS = (
    HandLine((0.4, 0.2, -0.1)),
    HandCircle(0.2, ahead=(0.0, 1.0, 0.0), centre=(0.0, 0.0, 1.0), laps=1.5),
    CURVE,
    Pieces((HandLine((0.4, 0.0, 0.0)), Wait(0.5), HandCircle(0.2), CURVE)),
)


@pytest.mark.parametrize("path", PATHS)
def test_the_derivatives_of_a_path_are_its_finite_differences(path: HandPath) -> None:
    t, eps = np.linspace(0.02, path.duration - 0.02, 97), 1e-4
    here, ahead, behind = path.sample(t), path.sample(t + eps), path.sample(t - eps)

    def slope(name: str) -> np.ndarray:
        return (getattr(ahead, name) - getattr(behind, name)) / (2 * eps)

    turning = np.einsum("nij,nkj->nik", slope("rotation"), here.rotation)
    spin = np.stack((turning[:, 2, 1], turning[:, 0, 2], turning[:, 1, 0]), axis=1)
    for ours, theirs in ((here.velocity, slope("position")), (here.spin, spin)):
        np.testing.assert_allclose(ours, theirs, atol=2e-4 * max(1.0, abs(ours).max()))
    smooth = abs(slope("velocity") - here.acceleration).max(axis=1) < 1e-3 * max(1.0, abs(here.acceleration).max())
    assert smooth.mean() > 0.95  # all but where the jerk or the acceleration of a piece jumps
    np.testing.assert_allclose(
        here.rotation @ here.rotation.transpose(0, 2, 1), np.tile(np.eye(3), (97, 1, 1)), atol=1e-12
    )


def test_a_path_rests_at_both_ends_and_pieces_join() -> None:
    path = PATHS[3]
    ends = path.sample([0.0, path.duration, path.duration + 5])
    np.testing.assert_allclose(ends.velocity, 0.0, atol=1e-12)
    np.testing.assert_allclose(ends.position[1], [0.8, 0.0, 0.1], atol=1e-12)
    np.testing.assert_allclose(ends.position[1], ends.position[2], atol=1e-12)
    turned = (Rotation.from_quat(TURNED[-1]) * Rotation.from_quat(TURNED[0]).inv()).as_matrix()
    np.testing.assert_allclose(ends.rotation[1], turned, atol=1e-12)


def test_poses_come_from_a_file(tmp_path) -> None:  # type: ignore[no-untyped-def]
    file = tmp_path / "poses.csv"
    file.write_text("t,x,y,z,qx,qy,qz,qw\n0,1,2,3,0,0,0,1\n1,1.1,2,3,0,0,0,1\n2,1.1,2.2,3,0,0,1,0\n")
    path = HandSpline.read(file)
    begin, R = path.begin
    assert begin is not None and begin.tolist() == [1.0, 2.0, 3.0] and R is not None
    np.testing.assert_allclose(path.sample([2.0]).position, [[0.1, 0.2, 0.0]], atol=1e-12)
    np.testing.assert_allclose(path.sample([2.0]).rotation[0], np.diag([-1.0, -1.0, 1.0]), atol=1e-12)
    file.write_text("t,x,y,z\n0,1,2,3\n1,1,x,3\n")
    with pytest.raises(TrajectoryError, match=r"poses.csv:3: error: y = 'x' is not a number"):
        HandSpline.read(file)
    file.write_text("t,x,y\n0,1,2\n")
    with pytest.raises(TrajectoryError, match="no column z"):
        HandSpline.read(file)


# -- the program -------------------------------------------------------------------------------------------------------


def by_quadprog(body: WholeBody) -> np.ndarray:
    """The program that was solved last, by Goldfarb and Idnani's method."""
    quadprog = pytest.importorskip("quadprog")
    p = body.nu.size
    hard = len(body.lows)
    rows = np.vstack((np.eye(p), body.G[: hard - p]))
    C = np.vstack((rows, -rows)).T
    b = np.hstack((body.lower[:hard], -body.upper[:hard]))
    keep = np.isfinite(b) & (abs(b) < 1e20)
    return np.asarray(quadprog.solve_qp(body.H, -body.f, C[:, keep], b[keep])[0])


@cache
def body_of(name: str) -> WholeBody:
    robot = robot_of(name)
    turned = 0.1 if robot.dimensions.arm >= 6 else 0.0
    tight = WholeBodySettings(wheel_speed=1.0 if robot.base.wheels else "urdf", heading=0.5, manipulability=0.1)
    return WholeBody(robot, [Task(orientation=turned)], settings=tight, period=H, limits=Limits(joint_margin=0.01))


def begun(name: str, seed: int) -> WholeBody:
    """A body at rest in a random posture."""
    body, rng = body_of(name), np.random.default_rng(seed)
    ends = np.clip(body.bounds.ends, -np.pi, np.pi)
    body.given = False
    body.put(rng.uniform(-2, 2, body.pose.size), rng.uniform(*ends))
    return body


@pytest.mark.parametrize("name", ROBOTS)
def test_the_solution_is_quadprogs(name: str) -> None:
    body = begun(name, 0)
    target = body.target_here(0)
    target[:3] += [0.6, -0.4, 0.1]
    for _ in range(25):
        found = body.solve(target[None]).copy()
        np.testing.assert_allclose(found, by_quadprog(body), atol=1e-9)
        body.step(target[None])
    assert body.misses == 0


@pytest.mark.parametrize("name", ROBOTS)
@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 10_000), far=st.sampled_from([0.05, 1.0, 30.0, 1e4]), half=st.booleans())
def test_any_goal_keeps_all_limits(name: str, seed: int, far: float, half: bool) -> None:
    """Goals out of reach, behind the robot, in the floor, turned by half a turn, from singular postures, too."""
    body = begun(name, seed)
    if half:
        body.q[:] = np.clip(0.0, *body.bounds.ends)  # stretched: singular
        body.look_around()
    direction = np.random.default_rng(seed).standard_normal(3)
    target, b = body.target_here(0), body.bounds
    target[:3] += far * direction / np.linalg.norm(direction)
    if half:
        target[9:18] = (np.diag([-1.0, -1.0, 1.0]) @ target[9:18].reshape(3, 3)).ravel()
    nb = body.robot.dimensions.base
    for _ in range(40):
        body.step(target[None])
        assert np.isfinite(body.nudot).all()
        assert (abs(body.nudot) <= b.acceleration + 1e-6).all()
        assert (abs(body.nu) <= b.speed + 1e-9).all()
        assert (abs(b.wheels @ body.nu[:nb]) <= b.wheel_speed + 1e-9).all() if nb else True
        assert (body.q >= b.ends[0] - 1e-9).all() and (body.q <= b.ends[1] + 1e-9).all()
    assert body.misses == 0


def test_weights_share_the_motion_out() -> None:
    """A dear base moves less, and the hand is where it should be all the same."""
    robot, moves = robot_of("platform_arm"), []
    for cost in (0.01, 100.0):
        body = WholeBody(robot, [Task(orientation=0.0)], settings=WholeBodySettings(base=cost), period=H)
        motion = plan(body, [HandLine((0.1, 0.05, 0.0), speed=0.1)], 3.0, tolerance=1e-3)
        moves.append(abs(motion.samples.pose[-1, 0]))
    assert moves[1] < 0.3 * moves[0]


def test_negative_weights_and_unknown_frames_are_one_line() -> None:
    with pytest.raises(ConfigError, match="position"):
        Task(position=-1.0)
    with pytest.raises(ConfigError, match=r"reference.hand.base"):
        WholeBodySettings(base=-1.0)
    with pytest.raises(UnknownName, match="did you mean 'arm_tip'"):
        WholeBody(robot_of("platform_arm"), [Task("arm_tp")])
    with pytest.raises(ConfigError, match="no room"):
        WholeBody(robot_of("platform_arm"), limits=Limits(joint_margin=4.0))


# -- made ahead --------------------------------------------------------------------------------------------------------


@pytest.mark.compiled
@pytest.mark.parametrize("name", ROBOTS)
def test_a_motion_follows_its_path_within_a_millimetre(name: str) -> None:
    body, by = begun(name, 1), 0.3 if robot_of(name).dimensions.base else 0.05
    body.bounds.wheel_speed[:] = 100.0
    path = Pieces((HandLine((by, 0.0, 0.0), speed=0.2 * by / 0.3), HandCircle(by / 3, speed=0.2 * by / 0.3)))
    motion = plan(body, [path], path.duration + 0.2, tolerance=1e-3)
    samples, t = motion.samples, np.linspace(0.0, path.duration, 301)
    if robot_of(name).dimensions.base:
        base = motion.trajectory.base
        assert base is not None
        driven = base.sample(t)
        check_followable(t, driven.pose, driven.velocity, 2e-3)
    joint = motion.trajectory.arm[0]
    at, eps = t[1:-1] + 0.3 * H, 1e-5
    q = [joint.sample(at + s * eps).q for s in (1, -1)]
    np.testing.assert_allclose((q[0] - q[1]) / (2 * eps), joint.sample(at).qdot, atol=1e-6)
    assert motion.misses == 0 and len(samples.nu) == len(motion.targets)


@pytest.mark.compiled
def test_the_robot_drives_there_first() -> None:
    body = begun("platform_arm", 2)
    body.bounds.wheel_speed[:] = 30.0
    height = float(body.places[0, 11])
    motion = plan(body, [HandCircle(0.2)], 25.0, at=(-2.0, 1.0, height), start=(0.5, -0.5, 2.0), tolerance=1e-3)
    begins = round(motion.begins / H)
    np.testing.assert_allclose(motion.reached[begins, 0, 9:], [-2.0, 1.0, height], atol=1e-3)
    assert 5.0 < motion.begins < 20.0
    t = np.linspace(0, 25.0, 1001)
    base = motion.trajectory.base
    assert base is not None
    driven = base.sample(t)
    check_followable(t, driven.pose, driven.velocity, 5e-3)


@pytest.mark.compiled
def test_a_path_out_of_reach_says_where_and_by_how_much() -> None:
    body = begun("two_axis_arm", 1)
    with pytest.raises(TrajectoryError, match=r"'arm_tip' cannot follow its path: .* mm from \(.*\) at t = "):
        plan(body, [HandLine((1.0, 0.0, 0.0))], 6.5)
    with pytest.raises(TrajectoryError, match=r"time.duration=6"):
        plan(body, [HandLine((1.0, 0.0, 0.0))], 3.0)


# -- bodies that keep apart --------------------------------------------------------------------------------------------


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10_000), flat=st.sampled_from(["", "sphere", "parallel"]))
def test_the_distance_of_capsules_is_coals(seed: int, flat: str) -> None:
    coal = pytest.importorskip("coal")
    rng = np.random.default_rng(seed)
    a, b, c, d = rng.standard_normal((4, 3))
    if flat == "sphere":
        b = a.copy()
    if flat == "parallel":
        d = c + 1.3 * (b - a)

    def shape(p: np.ndarray, q: np.ndarray) -> tuple:
        length = float(np.linalg.norm(q - p))
        z = (q - p) / length if length > 1e-9 else np.array([0.0, 0.0, 1.0])
        R = Rotation.align_vectors([z], [[0.0, 0.0, 1.0]])[0].as_matrix()
        return coal.Capsule(1e-3, length), coal.Transform3s(R, (p + q) / 2)

    (one, at), (other, there) = shape(a, b), shape(c, d)
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    theirs = coal.distance(one, at, other, there, request, result) + 2e-3
    if theirs > 1e-2:
        assert nearest(a, b, c, d, np.zeros(2)) == pytest.approx(theirs, abs=1e-4)


@pytest.mark.compiled
def test_a_hand_stops_before_it_hits_the_robot() -> None:
    """Without capsules the hand passes through the mast; with them it stays outside of their radii."""
    robot, least = robot_of("platform_arm"), []
    base = next(f.name for f in robot.model.frames if f.parentJoint == 1 and f.type == pin.FrameType.BODY)
    bodies = (Capsule("arm_tip", 0.05), Capsule(base, 0.15, (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)))
    for capsules in ((), bodies):
        body = WholeBody(robot, [Task(orientation=0.0)], period=H, capsules=capsules)
        body.put(np.zeros(3), np.array([0.4, 0.8]))
        pairs = Pairs(robot, bodies, 0.02)
        target = body.target_here(0)
        target[:2] = 0.0
        near = []
        for _ in range(300):
            body.step(target[None])
            body.look_around()
            pairs.fill(body.position, body.nu, H, np.zeros((1, 4)), np.zeros(1), np.zeros(1))
            near.append(pairs.distance[0])
        least.append(min(near))
    assert least[0] < 0.0 < 0.015 < least[1]


def test_a_camera_looks_at_a_point() -> None:
    robot = robot_of("panda")
    body = WholeBody(robot, [Task(looks="z", at=(0.8, 0.3, 0.2))], period=H)
    body.put(np.zeros(0), np.array([0.1, -0.3, 0.2, -1.8, 0.1, 1.6, 0.3]))
    for _ in range(400):
        body.step(np.zeros((1, TARGET)))
    body.look_around()
    axis, way = body.places[0, [2, 5, 8]], np.array([0.8, 0.3, 0.2]) - body.places[0, 9:]
    assert np.linalg.norm(np.cross(axis, way / np.linalg.norm(way))) < 1e-3 and axis @ way > 0


@pytest.mark.compiled
def test_the_base_turns_towards_the_goal_where_that_is_wished_for() -> None:
    """A goal to the side that the arm reaches by itself: only the wish turns the base, and the hand stays in place."""
    turned = []
    for heading in (0.0, 1.0):
        robot = robot_of("platform_arm")
        wishes = WholeBodySettings(heading=heading, base=0.01, posture=0.0)
        body = WholeBody(robot, [Task(orientation=0.0)], settings=wishes, period=H)
        body.put(np.zeros(3), np.array([1.2, 0.5]))
        goal = body.target_here(0)
        for _ in range(2000):
            body.step(goal[None])
        body.look_around()
        way = goal[:2] - body.pose[:2]
        turned.append(abs(np.arctan2(way[1], way[0]) - body.pose[2]))
        np.testing.assert_allclose(body.places[0, 9:], goal[:3], atol=2e-3)
    assert turned[1] < 0.02 < 0.3 < turned[0]


def test_the_arm_leaves_singular_postures_where_that_is_wished_for() -> None:
    """Seven joints that hold a position: the wish moves them, without the hand, to where sqrt det J J' is larger."""
    reached = []
    for wish in (0.0, 0.5):
        robot = robot_of("panda")
        body = WholeBody(
            robot, [Task(orientation=0.0)], settings=WholeBodySettings(manipulability=wish, posture=0.0), period=H
        )
        body.put(np.zeros(0), np.array([0.1, -0.3, 0.2, -0.6, 0.1, 0.6, 0.3]))
        goal = body.target_here(0)
        for _ in range(500):
            body.step(goal[None])
        body.look_around()
        np.testing.assert_allclose(body.places[0, 9:], goal[:3], atol=1e-3)
        J = body.J[0][:3]
        reached.append(np.sqrt(np.linalg.det(J @ J.T)))
    assert reached[1] > 1.1 * reached[0]


def test_joints_drift_to_the_posture_only_where_the_hand_leaves_them_free() -> None:
    robot, wanted = robot_of("panda"), np.array([0.5, -0.2, -0.3, -1.6, 0.3, 1.5, 0.8])
    body = WholeBody(robot, [Task(orientation=0.0)], settings=WholeBodySettings(posture=1.0), period=H, posture=wanted)
    body.put(np.zeros(0), np.array([0.1, -0.3, 0.2, -1.8, 0.1, 1.6, 0.3]))
    goal, far = body.target_here(0), abs(body.q - wanted).max()
    for _ in range(1000):
        body.step(goal[None])
    body.look_around()
    np.testing.assert_allclose(body.places[0, 9:], goal[:3], atol=1e-3)
    free = np.linalg.svd(body.J[0][:3])[2][3:]  # motions of the joints that do not move the hand
    assert abs(free @ (body.q - wanted)).max() < 0.05 * far < abs(body.q - wanted).max()


# -- priorities, and two arms ------------------------------------------------------------------------------------------


def ordered(lower: tuple[Task, ...], limits: Limits, seed: int = 5) -> tuple[WholeBody, np.ndarray]:
    """A body whose hand has the first place, and targets for it and for the other tasks that none can fulfil."""
    body = WholeBody(robot_of("panda"), (Task("panda_link8", orientation=0.0), *lower), period=H, limits=limits)
    body.put(np.zeros(0), np.array([0.1, -0.3, 0.2, -1.8, 0.1, 1.6, 0.3]), np.full(7, 0.05))
    rng, targets = np.random.default_rng(seed), np.array([body.target_here(i) for i in range(len(body.tasks))])
    targets[:, :3] += rng.uniform(-0.3, 0.3, (len(targets), 3))
    return body, targets


LATER = (
    Task("panda_link5", orientation=0.0, priority=1),
    Task("panda_link7", looks="x", at=(0.0, 1.0, 2.0), priority=2),
)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000), tight=st.booleans())
def test_a_later_task_never_disturbs_an_earlier_one(seed: int, tight: bool) -> None:
    """What the first asks for moves as without the others; what the second asks for, as without the third."""
    limits = Limits(speed=0.1, joint_speed=0.3, joint_acceleration=1.0) if tight else Limits()
    found = []
    for count in range(3):
        body, targets = ordered(LATER[:count], limits, seed)
        nudot = body.solve(targets[: 1 + count]).copy()
        found.append([(body.J[i] @ nudot)[:3] for i in range(1 + count)])
    for with_more in found[1:]:
        np.testing.assert_allclose(with_more[0], found[0][0], atol=1e-7)
    np.testing.assert_allclose(found[2][1], found[1][1], atol=1e-7)


@pytest.mark.parametrize("seed", range(4))
def test_priorities_are_the_lexicographic_solution(seed: int) -> None:
    """Far from limits the solution of the null-space method: each level as well as those before allow."""
    body, targets = ordered(LATER[:1], Limits(), seed)
    targets[:, :3] = np.array([body.target_here(i)[:3] for i in range(2)]) + 1e-3 * targets[:, :3]
    nudot = body.solve(targets)
    first, second = (WholeBody(body.robot, [task], period=H) for task in body.tasks)
    x, free = np.zeros(7), np.eye(7)
    for i, alone in enumerate((first, second)):
        alone.put(np.zeros(0), body.q, body.nu)
        alone.solve(targets[i][None])
        x = x - free @ np.linalg.solve(free.T @ alone.H @ free, free.T @ (alone.f + alone.H @ x))
        rows = np.vstack([each.J[0][:3] for each in (first, second)[: i + 1]])
        free = np.linalg.svd(rows)[2][len(rows) :].T
    np.testing.assert_allclose(nudot, x, atol=1e-7)
    together, _ = ordered((msgspec.structs.replace(LATER[0], priority=0),), Limits(), seed)
    assert np.abs((body.J[0] @ (together.solve(targets) - nudot))[:3]).max() > 1e-3  # weights alone do disturb


def two_armed() -> Robot:
    """A differential drive with an arm of six joints on either side."""
    text = f'<link name="base">{inertial(40.0, (1.0, 1.5, 2.0), place((0.05, 0.0, 0.2)))}</link>'
    for side, y in (("left", HALF_TRACK), ("right", -HALF_TRACK)):
        shape = f'<collision><origin rpy="{np.pi / 2} 0 0"/><geometry><cylinder radius="{RADIUS}" length="0.03"/>'
        text += f'<link name="{side}">{inertial(2.0, (0.005, 0.01, 0.005))}{shape}</geometry></collision></link>'
        text += joint(f"{side}_wheel", "base", side, place((0.0, y, RADIUS)), "0 1 0")
        parent, limit = "base", '<limit lower="-2.8" upper="2.8" effort="99" velocity="3"/>'
        for i, axis in enumerate(("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0")):
            name, at = f"{side}_{i}", (0.1, y, 0.6) if i == 0 else (0.0 if i == 1 else 0.25, 0.0, 0.0)
            text += f'<link name="{name}">{inertial(1.0, (0.01, 0.01, 0.01), place((0.1, 0.0, 0.0)))}</link>'
            text += joint(f"{name}_joint", parent, name, place(at), axis, limit, "revolute")
            parent = name
        text += f'<link name="{side}_hand"/><joint name="{side}_tool" type="fixed">{place((0.1, 0, 0))}'
        text += f'<parent link="{parent}"/><child link="{side}_hand"/></joint>'
    return built(f'<robot name="two_armed">{text}</robot>')


@pytest.mark.compiled
@pytest.mark.parametrize("name", ["two_armed", "tiago_dual"])
def test_two_arms_follow_a_path_each_while_the_base_drives(name: str) -> None:
    robot = two_armed() if name == "two_armed" else robot_of(name)
    frames = hands_of(robot)[:2]
    assert (len(frames) == 2 and {*frames} <= {"left_hand", "right_hand"}) or name == "tiago_dual"
    body = WholeBody(robot, [Task(frame, orientation=0.02) for frame in frames], period=H)
    ways = ((0.3, 0.0, 0.05), (0.3, 0.0, -0.05))
    paths = [Pieces((HandLine(way, speed=0.1), Wait(0.5))) for way in ways]
    motion = plan(body, paths, 5.0, tolerance=2e-3)
    last = motion.reached[-1] - motion.reached[0]
    np.testing.assert_allclose(last[:, 9:], ways, atol=2e-3)
    assert motion.gaps.shape == (len(motion.targets), 2) and motion.gap.max() < 2e-3 and motion.misses == 0
    assert motion.trajectory.watched is not None and list(motion.trajectory.watched.frames) == frames
    with pytest.raises(TrajectoryError, match=f"'{frames[1]}' cannot follow"):
        plan(body, [paths[0], HandLine((0.0, -5.0, 0.0), speed=2.0)], 5.0, tolerance=2e-3)


def test_what_is_recorded_of_a_hand_is_pinocchios_and_scipys() -> None:
    """`hand` from the true position, `hand_ref` from the path, at each row's time; any rotation."""
    robot, body = robot_of("platform_arm"), begun("platform_arm", 1)
    body.bounds.wheel_speed[:] = 100.0
    path = HandLine((0.3, 0.0, 0.0))
    motion = plan(body, [path], 3.0, tolerance=1e-3)
    timing, gains = Timing(duration=2.0, control_period=0.02, plant_step=0.02), Feedback(base=100.0, arm=5.0)
    loop = Loop(robot, motion.trajectory, PD(gains), timing=timing)
    rows = np.zeros((3, loop.layout.width))
    rows[:, loop.layout.where("time")] = [[0.0], [1.0], [9.0]]
    position, data = np.array([state(robot, seed)[0] for seed in range(3)]), robot.model.createData()
    rows[:, loop.layout.where("position")] = position
    motion.trajectory.watched.writer(robot, loop.layout)(rows)
    begin = motion.reached[0, 0, 9:]
    c, s = np.cos(motion.samples.pose[0, 2]), np.sin(motion.samples.pose[0, 2])
    for row, q, t in zip(rows, position, (0.0, 1.0, 9.0), strict=True):
        pin.forwardKinematics(robot.model, data, robot.configuration(q))
        at = pin.updateFramePlacement(robot.model, data, robot.model.getFrameId("arm_tip"))
        found, asked = (row[loop.layout.where(name)] for name in ("hand", "hand_ref"))
        np.testing.assert_allclose(found[:3], at.translation, atol=1e-12)
        np.testing.assert_allclose(Rotation.from_quat(found[3:]).as_matrix(), at.rotation, atol=1e-12)
        away = path.sample([t]).position[0]
        np.testing.assert_allclose(asked[:3], begin + np.array([c * away[0], s * away[0], 0.0]), atol=1e-9)
    assert loop.facts()["hands"] == {"arm_tip": False}
    turned = Rotation.random(200, random_state=2)
    half = Rotation.from_rotvec(np.pi * np.vstack((np.eye(3), [[0.6, 0.8, 0.0]])))
    for one in (turned, half):
        q = poses(np.hstack((one.as_matrix().reshape(-1, 9), np.zeros((len(one), 3)))))[:, 3:]
        np.testing.assert_allclose(Rotation.from_quat(q).as_matrix(), one.as_matrix(), atol=1e-12)
        np.testing.assert_allclose(np.linalg.norm(q, axis=1), 1.0, atol=1e-12)


# -- while a robot runs ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("on_measured", [True, False])
def test_online_the_measured_hand_is_driven_to_the_path(on_measured: bool) -> None:
    """A robot whose joints stand 0.02 rad from their reference: closed on it, its hand is where it should be."""
    robot = robot_of("platform_arm")
    d, lag = robot.dimensions, np.array([0.02, -0.02])
    body = WholeBody(robot, [Task(orientation=0.0)], period=H)
    follower = Follower(robot, Limits(), 0.5)
    measured = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.4, 0.9, 0.0, 0.0])
    follower.stand(measured)
    path = Pieces((HandLine((0.3, 0.1, 0.0)), Wait(1.5)))
    begin = moved(robot, "arm_tip", robot.neutral_position() + robot.arm_map()[1] @ measured[5:7], np.zeros(4))[0][9:]
    wishes, time = (FollowHand(body, path, on_measured),), 0.0
    courses = [follower.check(wishes[0])]
    while follower.is_moving or time == 0.0:
        follower.step(time, H if time else 0.0, measured, wishes if not time else (), courses if not time else [])
        now = Setpoint.side_by_side(follower.now, d)
        measured = np.hstack((now.pose, now.velocity, now.q + lag, now.qdot))
        time += H
    position = robot.neutral_position()
    position[:3], position[robot.arm_index] = measured[:3], measured[5:7]
    missed = np.linalg.norm(moved(robot, "arm_tip", position, np.zeros(4))[0][9:] - begin - [0.3, 0.1, 0.0])
    assert missed < 1e-3 if on_measured else missed > 5e-3


@given(st.integers(0, 10**6))
@settings(max_examples=10)
def test_a_wished_hand_goes_where_it_is_told_within_its_speed_and_stops_when_nothing_comes(seed: int) -> None:
    """Places one after the other, then a velocity that grows old: the hand's reference by differences of its place."""
    robot, rng = robot_of("ur5"), np.random.default_rng(seed)
    body = WholeBody(robot, [Task(orientation=0.1)], period=0.01)
    follower, wish = Follower(robot, Limits(), 0.5), HandWish(body, (0.2, 0.8), 0.3)
    q = np.array([0.3, -1.2, 1.4, -1.0, -1.3, 0.2])
    measured = np.hstack((q, 0.0 * q))
    follower.stand(measured)
    begin = moved(robot, wish.body.frames[0], q, np.zeros(6))[0]
    start = begin[9:]
    goals = start + rng.uniform(-0.1, 0.1, (2, 3))
    twist = np.append(rng.uniform(-0.05, 0.05, 3), np.zeros(3))
    places = []
    for k in range(900):
        if k in (0, 300):
            wish.go(goals[k // 300])
        if 600 <= k < 650:
            wish.move(twist)
        given = (wish,) if k == 0 else ()
        follower.step(0.01 * k, 0.01 if k else 0.0, measured, given, [follower.check(w) for w in given])
        measured = np.hstack((follower.now[:6], follower.now[6:12]))
        places.append(moved(robot, wish.body.frames[0], follower.now[:6], np.zeros(6))[0][9:])
    places = np.array(places)
    assert np.linalg.norm(places[299] - goals[0]) < 2e-3
    assert np.linalg.norm(places[599] - goals[1]) < 2e-3
    assert np.linalg.norm(np.diff(places, axis=0), axis=1).max() / 0.01 < 0.2 * 1.1
    went = places[700] - places[640]
    assert np.dot(went, twist[:3]) > 0.0
    assert np.linalg.norm(places[-1] - places[-50]) < 1e-4
    for wrong in (lambda: wish.go((np.nan, 0, 0)), lambda: wish.go((0, 0, 0), (0, 0, 0, 2)), lambda: wish.move([1.0])):
        with pytest.raises(ConfigError):
            wrong()
    with pytest.raises(ConfigError):
        HandWish(body, (0.0, 1.0))
