"""From messages to a measurement, and from a planner's messages to motions; no network."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
import plain_messages as msg
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mmnn_pin import PD, Stepper, StepperSettings, load
from mmnn_pin.deploy.ros2.mapped import Followed, MappedRoute
from mmnn_pin.deploy.ros2.planned import INVALID_JOINTS, OLD_STAMP, PlannedArm, Refused, base_motion, rest_of
from mmnn_pin.deploy.ros2.sensing import Clock, Sensing, Tree, composed, inverse, of_frame
from mmnn_pin.deploy.ros2.settings import Clocks, Frames, Joints, Node, Odometry, Output, PlannedPath
from mmnn_pin.model.base.overrides import Overrides
from mmnn_pin.model.loading import build
from mmnn_pin.model.urdf.reading import parse
from mmnn_pin.reference.drive import RouteDrive
from mmnn_pin.reference.follower import Follower
from mmnn_pin.reference.guide import ARM, BASE
from mmnn_pin.reference.limits import Limits
from mmnn_pin.reference.wishes import Stand
from mmnn_pin.safety import Safety
from mmnn_pin.signals import Measurement

ROBOT = load("platform_arm")
COMMANDS = {"a": Output(joints=ROBOT.actuator_names)}
NAMES = ["arm_1_joint", "x", "arm_2_joint", "wheel_left_joint", "wheel_right_joint"]
NOW = msg.Header(msg.Time(), "odom")


def sensing(**more: Any) -> Sensing:
    return Sensing(ROBOT, Node("platform_arm", COMMANDS, **({"odometry": Odometry(at=(0.0, 0.0, 0.0))} | more)), Tree())


def joints(names: list[str], q: list[float], qdot: list[float]) -> msg.JointState:
    return msg.JointState(NOW, names, q, qdot, [])


def quaternion(angle: float) -> msg.Quaternion:
    return msg.Quaternion(0.0, 0.0, math.sin(angle / 2), math.cos(angle / 2))


def odometry(
    x: float, y: float, phi: float, v: float = 0.0, w: float = 0.0, frame: str = "base_footprint"
) -> msg.Odometry:
    pose = msg.PoseWithCovariance(msg.Pose(msg.Point(x, y), quaternion(phi)), [0.0] * 36)
    twist = msg.TwistWithCovariance(msg.Twist(msg.Vector3(v), msg.Vector3(z=w)), [0.0] * 36)
    return msg.Odometry(NOW, frame, pose, twist)


@settings(deadline=None)
@given(st.permutations(range(5)))
def test_joints_are_read_by_their_names(order: list[int]) -> None:
    s = sensing()
    values, rates = [0.1, 9.0, -0.2, 7.0, 8.0], [1.0, 9.0, -2.0, 7.0, 8.0]
    told = joints(*([column[i] for i in order] for column in (NAMES, values, rates)))
    assert s.take_joints(told, 0.0) == "" and s.take_base(odometry(1.0, 2.0, 0.5), 0.0) == ""
    m = s.measurement()
    assert m is not None and m.q.tolist() == [0.1, -0.2] and m.qdot.tolist() == [1.0, -2.0]
    assert s.measurement() is None  # nothing new


def test_joints_of_other_names_and_in_two_messages() -> None:
    s = sensing(joint_states=Joints(names=("arm_1_joint=shoulder",)))
    s.take_base(odometry(0.0, 0.0, 0.0), 0.0)
    assert s.take_joints(joints(["shoulder"], [0.3], [0.1]), 1.0) == "" and s.measurement() is None
    assert s.take_joints(joints(["arm_2_joint"], [0.4], [0.2]), 2.0) == ""
    m = s.measurement()
    assert m is not None and m.q.tolist() == [0.3, 0.4] and s.when == 0.0
    s.take_base(odometry(0.0, 0.0, 0.0), 3.0)
    assert s.when == 1.0 and s.lacking(3.0) == "joints shoulder, arm_2_joint"


three = st.tuples(*[st.floats(-3.0, 3.0)] * 3)


@given(three, three, three)
def test_odometry_of_a_frame_beside_the_control_frame_is_how_that_moves(at: Any, pose: Any, velocity: Any) -> None:
    """Second answer: the frame's own pose before and after a short time."""
    step = 1e-6
    places = [composed(composed(pose, tuple(k * step * v for v in velocity)), inverse(at)) for k in (-0.5, 0.5)]
    there, own = of_frame(at, np.array(pose), np.array(velocity))
    c, s = math.cos(there[2]), math.sin(there[2])
    x, y, w = ((b - a) / step for a, b in zip(*places, strict=True))
    assert own == pytest.approx([c * x + s * y, c * y - s * x, velocity[2]], abs=1e-4)
    assert abs(math.remainder(w - velocity[2], math.tau / step)) < 1e-4
    assert there[:2] == pytest.approx(composed(pose, inverse(at))[:2])


REFUSED = {
    "sizes": (joints(["arm_1_joint", "arm_2_joint"], [0.1], [0.1, 0.1]), "1 positions for 2 joints"),
    "no rates": (joints(["arm_1_joint", "arm_2_joint"], [0.1, 0.1], []), "0 velocities for 2 joints"),
    "nan": (joints(["arm_1_joint", "arm_2_joint"], [0.1, math.nan], [0.0, 0.0]), "not finite"),
    "huge": (joints(["arm_1_joint", "arm_2_joint"], [0.1, 0.1], [0.0, 1e12]), "not finite"),
    "twice": (joints(["arm_1_joint", "arm_1_joint"], [0.1, 0.1], [0.0, 0.0]), "a joint appears twice"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_joint_states_that_are_wrong_change_nothing(name: str) -> None:
    s = sensing()
    s.take_joints(joints(["arm_1_joint", "arm_2_joint"], [0.5, 0.6], [0.0, 0.0]), 0.0)
    message, why = REFUSED[name]
    assert why in s.take_joints(message, 1.0)
    assert s.q.tolist() == [0.5, 0.6] and s.heard.tolist() == [0.0, 0.0]
    good = joints(["arm_2_joint", "arm_1_joint"], [0.2, 0.1], [0.0, 0.0])
    assert s.take_joints(good, -1.0) == "it is older than the one before" and s.take_joints(good, 2.0) == ""


def test_the_heading_goes_on_and_jumps_are_refused() -> None:
    s = sensing()
    for i in range(100):
        angle = 0.1 * i
        there = odometry(math.cos(angle), math.sin(angle), math.remainder(angle, math.tau), 1.0, 1.0)
        assert s.take_base(there, 0.1 * i) == ""
    assert s.pose[2] == pytest.approx(9.9)
    assert "the pose jumps by 3.9" in s.take_base(odometry(3.0, 0.0, 9.9, 1.0, 1.0), 9.91)
    broken = odometry(0.0, 0.0, 0.0)
    broken.pose.pose.orientation = msg.Quaternion(0.0, 0.0, 0.0, 0.0)
    assert s.take_base(broken, 10.0) == "a quaternion that is none"
    assert s.take_base(odometry(math.nan, 0.0, 0.0), 10.0) == "a pose that is not finite"
    assert s.take_base(odometry(0.0, 0.0, 0.0, math.inf), 10.0) == "a velocity is not finite"


@settings(deadline=None)
@given(*[st.floats(-2.0, 2.0)] * 6)
def test_the_control_frame_beside_the_childs(x: float, y: float, turn: float, px: float, py: float, phi: float) -> None:
    """Velocity of a point of a rigid body by finite differences of its place."""
    s, v, w, dt = sensing(odometry=Odometry(at=(x, y, turn), jump=1e9, turn=1e9)), 0.4, 0.7, 1e-6
    s.take_base(odometry(px, py, phi, v, w), 0.0)
    before = s.pose.copy()
    moved = (px + dt * v * math.cos(phi), py + dt * v * math.sin(phi), phi + dt * w)
    s.take_base(odometry(*moved, v, w), dt)
    rate = (s.pose - before) / dt
    ahead = rate[0] * math.cos(s.pose[2]) + rate[1] * math.sin(s.pose[2])
    assert s.velocity == pytest.approx([ahead, w], abs=1e-4)


def test_a_link_of_the_urdf_tells_where_the_control_frame_is() -> None:
    s = sensing(odometry=Odometry())
    assert s.take_base(odometry(1.0, 2.0, 0.3, frame="base_footprint"), 0.0) == ""
    assert s.pose == pytest.approx([1.0, 2.0, 0.3])
    with pytest.raises(Exception, match="no link of the URDF"):
        sensing(odometry=Odometry()).take_base(odometry(0.0, 0.0, 0.0, frame="nowhere"), 0.0)
    with pytest.raises(Exception, match="moves against the base"):
        sensing(odometry=Odometry()).take_base(odometry(0.0, 0.0, 0.0, frame="arm_2"), 0.0)


def transform(above: str, below: str, x: float, y: float, turn: float) -> msg.TransformStamped:
    return msg.TransformStamped(
        msg.Header(msg.Time(), above), below, msg.Transform(msg.Vector3(x, y), quaternion(turn))
    )


def test_frames_are_composed_and_poses_come_by_them() -> None:
    tree = Tree()
    one, two = (0.3, -0.2, 0.5), (1.0, 2.0, -0.7)
    tree.take(msg.TFMessage([transform("map", "odom", *one), transform("odom", "base_footprint", *two)]), 3.0)
    found = tree.between("map", "base_footprint")
    assert found is not None and found[0] == pytest.approx(composed(one, two)) and found[1] == 3.0
    back = tree.between("base_footprint", "map")
    assert back is not None and composed(found[0], back[0]) == pytest.approx((0.0, 0.0, 0.0))
    assert tree.between("odom", "camera") is None and composed(inverse(one), one) == pytest.approx((0.0, 0.0, 0.0))
    node = Node("platform_arm", COMMANDS, odometry=Odometry(source="tf", at=(0.0, 0.0, 0.0)), tf=Frames())
    s = Sensing(ROBOT, node, tree)
    v, w = 0.3, 0.4  # by the wheels: radius 0.075, half the track 0.171
    rates = [0.0, 9.0, 0.0, (v - 0.171 * w) / 0.075, (v + 0.171 * w) / 0.075]
    assert s.take_joints(joints(NAMES, [0.0] * 5, rates), 3.1) == ""
    assert s.pose == pytest.approx(two) and s.velocity == pytest.approx([v, w])


def test_stamps_are_judged() -> None:
    clock = Clock(Clocks())
    clock.start()
    now = clock.by_ros

    def at(age: float) -> msg.Time:
        seconds, rest = divmod(now - age, 1.0)
        return msg.Time(int(seconds), int(1e9 * rest))

    assert clock.measured(at(0.05), 0.2) == pytest.approx(clock.now - 0.05, abs=0.02)
    assert "10 s old" in str(clock.measured(at(10.0), 0.2)) and "in the future" in str(clock.measured(at(-5.0), 0.2))
    assert isinstance(clock.measured(msg.Time(), 0.2), float)  # no stamp
    assert isinstance(Clock(Clocks(stamps="ignore")).measured(at(1e6), 0.2), float)
    simulated = Clock(Clocks(), is_simulated=True)
    for second in (5, 6):
        simulated.tick(msg.Clock(msg.Time(5, 0 if second == 5 else 200_000_000)))
    assert simulated.by_ros == pytest.approx(5.2) and not simulated.jumped
    before = simulated.now
    simulated.tick(msg.Clock(msg.Time(3)))
    assert "jumped by -2.2 s" in simulated.jumped and simulated.by_ros == pytest.approx(3.0)
    assert simulated.now == pytest.approx(before)  # it goes on from where it was, with the simulator's
    assert simulated.measured(msg.Time(3), 0.2) == pytest.approx(before)


# -- motions -----------------------------------------------------------------------------------------------------------

ARM_OF = PlannedArm.of(ROBOT, {}, Limits(joint_speed=2.0), 0.01)
HERE = np.array([[0.1, 0.2], [0.0, 0.0], [0.0, 0.0]])


def plan(points: list[list[float]], names: tuple[str, ...] = ("arm_2_joint", "arm_1_joint"), step: float = 1.0) -> Any:
    made = [
        msg.JointTrajectoryPoint(q, [], [], [], msg.Duration(int(step * i), int(1e9 * (step * i % 1))))
        for i, q in enumerate(points)
    ]
    return msg.JointTrajectory(msg.Header(msg.Time()), list(names), made)


def test_a_trajectory_goes_through_its_points_and_what_it_does_not_name_stays() -> None:
    motion = ARM_OF.motion(plan([[0.2, 0.1], [0.5, 0.6], [0.0, 0.0]]), HERE)
    q = motion.table[:, -6:-4]
    assert motion.parts == (ARM,) and len(q) == 201
    assert q[[0, 100, 200]] == pytest.approx(np.array([[0.1, 0.2], [0.6, 0.5], [0.0, 0.0]]))
    alone = ARM_OF.motion(plan([[0.2], [0.6]], ("arm_2_joint",)), HERE).table[:, -6:-4]
    assert (alone[:, 0] == 0.1).all() and alone[-1, 1] == pytest.approx(0.6)
    assert ARM_OF.motion(plan([]), HERE) == Stand((ARM,))


def test_a_trajectory_that_began_before_is_joined_on_its_way() -> None:
    whole = ARM_OF.motion(plan([[0.2, 0.1], [0.5, 0.6]]), HERE)
    late = ARM_OF.motion(plan([[0.2, 0.1], [0.5, 0.6]]), HERE, since=0.4)
    assert late.table == pytest.approx(whole.table[40:])


BAD: dict[str, tuple[Any, float, int, str]] = {
    "unknown joint": (plan([[0.0], [0.1]], ("elbow",)), 0.0, INVALID_JOINTS, "joints elbow: there is arm_1_joint"),
    "joint twice": (plan([[0.0, 0.0], [0.1, 0.1]], ("arm_1_joint",) * 2), 0.0, INVALID_JOINTS, "one twice"),
    "too fast": (plan([[0.0, 0.0], [3.0, 0.0]]), 0.0, -1, "arm_2_joint at"),
    "beyond its end": (plan([[0.0, 3.0], [0.0, 3.3]]), 0.0, -1, "its ends are"),
    "over": (plan([[0.0, 0.0], [0.1, 0.1]]), 5.0, OLD_STAMP, "it was over 4 s ago"),
    "nan": (plan([[0.0, 0.0], [0.1, math.nan]]), 0.0, -1, "not finite"),
    "missing number": (plan([[0.0, 0.0], [0.1]]), 0.0, -1, "missing at a point"),
    "times": (plan([[0.0, 0.0], [0.1, 0.1]], step=0.0), 0.0, -1, "do not increase"),
}


@pytest.mark.parametrize("name", BAD)
def test_trajectories_that_break_a_rule_are_refused(name: str) -> None:
    message, since, code, why = BAD[name]
    with pytest.raises(Refused, match=why) as refused:
        ARM_OF.motion(message, HERE, since)
    assert refused.value.code == code


def path(points: Any, looks: float) -> msg.Path:
    pose = [msg.Pose(msg.Point(float(x), float(y)), quaternion(looks)) for x, y in points]
    return msg.Path(NOW, [msg.PoseStamped(NOW, one) for one in pose])


@settings(max_examples=25, deadline=None)
@given(st.floats(-1.0, 1.0), st.floats(0.1, 0.8), st.floats(-3.0, 3.0), st.booleans(), st.floats(0.03, 0.4))
def test_paths_can_be_driven_and_keep_to_their_limits(
    bend: float, length: float, turn: float, back: bool, speed: float
) -> None:
    s = np.linspace(0.0, 4.0 * length, 60)
    x, y = s, 0.2 * np.sin(3.0 * bend * s)
    c, sn = math.cos(turn), math.sin(turn)
    points = np.stack([c * x - sn * y, sn * x + c * y], axis=1)
    looks = math.atan2(points[1, 1] - points[0, 1], points[1, 0] - points[0, 0]) + (math.pi if back else 0.0)
    route, limits = PlannedPath(speed=speed, acceleration=0.5, lateral=0.3), Limits(yaw_rate=0.8)
    motion = base_motion(path(points, looks), route, limits, ROBOT, 0.01)
    assert not isinstance(motion, Stand)
    table = motion.table
    pose, v, w, vdot = table[:, :3], table[:, 3], table[:, 4], table[:, 5]
    assert motion.parts == (BASE,) and (v <= 1e-9).all() == back
    assert pose[[0, -1], :2] == pytest.approx(points[[0, -1]], abs=0.02) and abs(v[[0, -1]]).max() < 0.02
    assert abs(v).max() < 1.05 * speed and abs(w).max() < 0.88 and abs(v * w).max() < 0.33 and abs(vdot).max() < 0.8
    middle = 0.5 * (v[1:] + v[:-1]), 0.5 * (pose[1:, 2] + pose[:-1, 2])
    driven = np.stack([middle[0] * np.cos(middle[1]), middle[0] * np.sin(middle[1])], axis=1)
    assert np.diff(pose[:, :2], axis=0) / 0.01 == pytest.approx(driven, abs=0.01)  # it rolls, and does not slip
    away = np.hypot(*(pose[:, None, :2] - points[None]).T).min(axis=0).max()
    assert away < 0.08


def test_a_path_keeps_to_the_speeds_of_the_wheels() -> None:
    text = re.sub(r'velocity="30[.0]*"', 'velocity="3"', ROBOT.urdf)
    slow = build(parse(text.encode(), "slow.urdf"), Overrides())
    around = [(math.sin(a), 1.0 - math.cos(a)) for a in np.linspace(0.0, 4.0, 60)]
    motion = base_motion(path(around, 0.0), PlannedPath(speed=1.0, lateral=5.0), Limits(), slow, 0.01)
    assert not isinstance(motion, Stand)
    wheels = abs(motion.table[:, 3:5] @ slow.E[:2, :2]).max(axis=0)  # [rad/s]
    assert wheels.max() == pytest.approx(3.0, rel=0.03) and wheels.min() < 2.5


def test_a_path_is_moved_with_its_map() -> None:
    motion = base_motion(path([(0.1 * i, 0.0) for i in range(20)], 0.0), PlannedPath(), Limits(), ROBOT, 0.01)
    moved, out = rest_of(motion, 1.0, (2.0, 3.0, math.pi / 2)), np.zeros(motion.table.shape[1])
    moved.write(0.0, out)
    assert out[:3] == pytest.approx([2.0, 3.0 + motion.table[100, 0], math.pi / 2])
    assert base_motion(path([], 0.0), PlannedPath(), Limits(), ROBOT, 0.01) == Stand((BASE,))
    with pytest.raises(Refused, match="not finite"):
        base_motion(path([(1.0, 1.0), (1.0, math.nan)], 0.0), PlannedPath(), Limits(), ROBOT, 0.01)
    with pytest.raises(Refused, match="20,000 poses"):
        base_motion(path([(1.0, 1.0)] * 20_000, 0.0), PlannedPath(), Limits(), ROBOT, 0.01)


def closed_loop(motion: Any, start: tuple[float, float, float], seconds: float) -> np.ndarray:
    """Poses and velocities (N, 5) of an exact unicycle whose wheels turn as they are told."""
    robot, n = ROBOT, ROBOT.dimensions.arm
    wheels = robot.actuator_names[:2]
    stepper = Stepper(
        robot, PD(), StepperSettings(safety=Safety(), period=0.01, interfaces=dict.fromkeys(wheels, "velocity"))
    )
    q, pose, nu, seen = robot.rest[robot.arm_index], np.array(start, float), np.zeros(2), []
    for k in range(round(seconds / 0.01)):
        measured = Measurement(pose.copy(), nu.copy(), q, np.zeros(n))
        turning = stepper.step(0.01 * k, measured, motion if k == 5 else None).motor_velocity[:2]
        nu = np.linalg.solve(robot.E.T[:2, :2], np.nan_to_num(turning))
        middle = pose[2] + 0.005 * nu[1]
        pose += 0.01 * np.array([nu[0] * math.cos(middle), nu[0] * math.sin(middle), nu[1]])
        assert not stepper.is_over, stepper.tripped
        seen.append(np.append(pose, nu))
    return np.array(seen)


BACK, TIP = [(-0.05 * i, 0.0) for i in range(41)], [(1.0 - abs(1.0 - 0.05 * i), 0.0) for i in range(36)]
# points, quaternions (z, w), pose of the robot; turned, ahead, in reverse, heading at the end
CLOSED = {
    "identities": (BACK, [(0, 1)] * 41, (0, 0, math.pi), (0, 2, 0, math.pi)),
    "zeros": (BACK, [(0, 0)] * 41, (0, 0, math.pi), (0, 2, 0, math.pi)),
    "first true": (BACK, [(1, 0)] + [(0, 1)] * 40, (0, 0, math.pi), (0, 2, 0, math.pi)),
    "turned away": (BACK, [(0, 1)] * 41, (0, 0, 0), (math.pi, 2, 0, math.pi)),
    "tip": (TIP, [(0, 1)] * 36, (0, 0, 0), (0, 1, 0.75, 0)),
    "tip without headings": (TIP, [(0, 0)] * 36, (0, 0, 0), (math.pi, 1.75, 0, math.pi)),
    "aside": (BACK, [(1, 0)] * 41, (1, -1, 0), (3 * math.pi / 4 + math.pi / 4, 2 + math.sqrt(2), 0, math.pi)),
    "one": ([(0.6, 0.8)], [(0.6, 0.8)], (0, 0, 0), (2 * math.atan2(0.6, 0.8), 1, 0, 2 * math.atan2(0.6, 0.8))),
}


@pytest.mark.parametrize("case", CLOSED)
def test_in_closed_loop_what_moves_is_what_was_asked(case: str) -> None:
    points, quaternions, start, (turned, ahead, reverse, heading) = CLOSED[case]
    poses = [
        msg.Pose(msg.Point(float(x), float(y)), msg.Quaternion(0.0, 0.0, float(z), float(w)))
        for (x, y), (z, w) in zip(points, quaternions, strict=True)
    ]
    message = msg.Path(NOW, [msg.PoseStamped(NOW, pose) for pose in poses])
    motion = base_motion(message, PlannedPath(), Limits(), ROBOT, 0.01)
    seen = closed_loop(motion, start, 25.0)
    v, w = seen[:, 3], seen[:, 4]
    assert 0.01 * np.abs(w).sum() == pytest.approx(turned, abs=0.1)
    assert 0.01 * np.array([np.maximum(v, 0).sum(), np.maximum(-v, 0).sum()]) == pytest.approx(
        [ahead, reverse], abs=0.03
    )
    assert math.dist(seen[-1, :2], points[-1]) < 0.02 and abs(math.remainder(seen[-1, 2] - heading, math.tau)) < 0.05
    assert not case.startswith("tip") or seen[:, 0].max() == pytest.approx(1.0, abs=0.02)
    here = base_motion(message, PlannedPath(), Limits(), ROBOT, 0.01, (start, np.zeros(2)))
    assert isinstance(motion, RouteDrive) and isinstance(here, RouteDrive)
    assert np.array_equal(here.table, motion.placed(np.array(start, float)).table)


def test_a_path_in_a_maps_frame_begins_at_the_reference() -> None:
    """The base is at rest in the odometry's frame, 0.5 m beside the path, by its own angles and through the wishes."""
    tree = Tree()
    place = (1.0, 1.5, math.pi / 2)  # of the map in the odometry's frame
    tree.take(msg.TFMessage([transform("map", "odom", *inverse(place))]), 0.0)
    motion = base_motion(
        path([(0.0, 0.1 * i) for i in range(1, 21)], math.pi / 2), PlannedPath(), Limits(), ROBOT, 0.01
    )
    base = np.array([1.0, 2.0, 7.0, 0.0, 0.0])  # y of the map is -x of the odometry
    route = MappedRoute(Frames(), tree)
    with pytest.raises(Refused, match="no way from 'elsewhere'"):
        route.placed(motion, "elsewhere", base)
    wishes: list[Any] = [route.follow(route.placed(motion, "map", base))]
    assert route.end == pytest.approx((-1.0, 1.5, math.pi))
    follower = Follower(ROBOT, Limits(), 0.5)
    follower.stand(np.array([1.0, 2.0, 7.0, 0.0, 0.0, *np.zeros(4)]))
    seen = []
    for k in range(3000):
        follower.step(0.01 * k, 0.01, follower.measured, tuple(wishes), [follower.check(wish) for wish in wishes])
        wishes = []
        seen.append(follower.now[:5].copy())
    table = np.array(seen)
    assert table[0, :3] == pytest.approx([1.0, 2.0, 7.0], abs=1e-3)
    assert np.abs(np.diff(table[:, :3], axis=0)).max() < 0.02
    assert table[-1, :2] == pytest.approx([-1.0, 1.5], abs=1e-6) and math.remainder(
        table[-1, 2], math.tau
    ) == pytest.approx(math.pi)


def test_a_correction_of_the_map_does_not_jerk_the_robot() -> None:
    """The path goes on where the corrected map has it, and the reference never leaps."""
    tree = Tree()
    route = MappedRoute(Frames(), tree)
    tree.take(msg.TFMessage([transform("map", "odom", 0.0, 0.0, 0.0)]), 0.0)
    motion = base_motion(path([(0.1 * i, 0.0) for i in range(31)], 0.0), PlannedPath(speed=0.4), Limits(), ROBOT, 0.01)
    assert not isinstance(motion, Stand)
    follower = Follower(ROBOT, Limits(), 0.5)
    here = np.zeros(3 + 2 + 2 + 2)
    follower.stand(here)
    route.follow(Followed(motion, "map", (0.0, 0.0, 0.0)))
    wishes, seen = [rest_of(motion, 0.0)], []
    for k in range(1200):
        if k == 300:
            tree.take(msg.TFMessage([transform("map", "odom", -0.2, -0.3, 0.1)]), 3.0)
        wishes += route.placed_anew(0.01 if k else 0.0)
        follower.step(0.01 * k, 0.01, here, tuple(wishes), [follower.check(wish) for wish in wishes])
        wishes = []
        seen.append(follower.now.copy())
    table = np.array(seen)
    assert np.abs(np.diff(table[:, :2], axis=0)).max() < 0.02 and np.abs(np.diff(table[:, 2])).max() < 0.02
    corrected = composed(inverse((-0.2, -0.3, 0.1)), (3.0, 0.0, 0.0))
    assert table[-1, :3] == pytest.approx(corrected, abs=0.02)
    assert np.abs(np.diff(table[:, 3])).max() < 0.05  # nor does its speed
