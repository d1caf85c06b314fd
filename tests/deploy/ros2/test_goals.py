"""Goals without a graph: what `joint_trajectory_controller` and Nav2 document, case by case, on a robot that follows.

The robot is where its reference is, but for what a test adds; the cases are those of
control.ros.org, ros2_controllers, joint_trajectory_controller (userdoc, trajectory, speed_scaling).
"""

from __future__ import annotations

import math
from concurrent.futures import wait
from types import SimpleNamespace
from typing import Any

import numpy as np
import plain_messages as msg
import pytest

from mmnn_pin import load
from mmnn_pin.deploy.ros2.mapped import MappedRoute
from mmnn_pin.deploy.ros2.path_goals import INVALID_PATH, NO_CONTROL, NO_FRAME, NO_PROGRESS, PathGoals
from mmnn_pin.deploy.ros2.planned import (
    INVALID_GOAL,
    INVALID_JOINTS,
    OFF_GOAL,
    OFF_PATH,
    OKAY,
    OLD_STAMP,
    PlannedArm,
    Planner,
    RobotSituation,
    base_motion,
)
from mmnn_pin.deploy.ros2.sensing import Clock, Tree
from mmnn_pin.deploy.ros2.settings import Action, Clocks, Frames, PlannedPath
from mmnn_pin.deploy.ros2.trajectory_goals import TrajectoryGoals
from mmnn_pin.reference.follower import Follower
from mmnn_pin.reference.limits import Limits

ROBOT, LIMITS, H = load("platform_arm"), Limits(), 0.01
NAMES = ("arm_1_joint", "arm_2_joint")
ACTION, PATH = Action(), PlannedPath()
START = 50.0  # time of ROS 2 at which a test begins


def lasting(time: float) -> msg.Duration:
    whole = math.floor(time)
    return msg.Duration(whole, round(1e9 * (time - whole)))


def goal(*rows: Any, names: tuple[str, ...] = NAMES, stamp: float = 0.0, **more: Any) -> Any:
    """A goal through rows of `(time, positions, velocities, accelerations)`, the latter two as they are given."""
    points = [
        msg.JointTrajectoryPoint(*(list(part) for part in row[1:]), time_from_start=lasting(row[0])) for row in rows
    ]
    header = msg.Header(msg.Time(int(stamp), round(1e9 * (stamp % 1))))
    empty: dict[str, Any] = {
        "multi_dof_trajectory": msg.MultiDOFJointTrajectory(msg.Header(), [], []),
        "path_tolerance": [], "goal_tolerance": [], "component_path_tolerance": [], "component_goal_tolerance": [],
        "goal_time_tolerance": lasting(0.0),
    }  # fmt: skip
    return SimpleNamespace(trajectory=msg.JointTrajectory(header, list(names), points), **(empty | more))


class Handle:
    """What the server of an action hands over."""

    count = 0

    def __init__(self, request: Any) -> None:
        Handle.count += 1
        self.request, self.goal_id = request, SimpleNamespace(uuid=[Handle.count])
        self.is_cancel_requested, self.feedback, self.outcome = False, list[Any](), ""
        self.publish_feedback = self.feedback.append

    def __getattr__(self, name: str) -> Any:
        if name not in ("succeed", "abort", "canceled"):
            raise AttributeError(name)
        return lambda: setattr(self, "outcome", name)


class Graph:
    """Goals of both actions, a reference and a robot, sample by sample."""

    def __init__(self, action: Action = ACTION, path: PlannedPath = PATH) -> None:
        self.clock, self.follower, planner = Clock(Clocks(), True), Follower(ROBOT, LIMITS, 0.5), Planner()
        self.planner, self.k, self.off, self.stopped = planner, 0, np.zeros(9), False
        self.follower.stand(np.zeros(9))
        self.tree, self.rows, self.moved_on = Tree(), list[Any](), 0.0
        self.tree.take(msg.TFMessage([msg.TransformStamped(
            msg.Header(frame_id="map"), "odom", msg.Transform(msg.Vector3(), msg.Quaternion()),
        )]), 0.0)  # fmt: skip
        self.route = MappedRoute(Frames(), self.tree)
        arm = PlannedArm.of(ROBOT, {}, LIMITS, H)
        told = self.of_joints = TrajectoryGoals(
            planner, self.give_way, arm, action, self.route.place_of, lambda *told: told
        )
        self.of_path = PathGoals(
            planner, self.give_way, self.route, lambda m: base_motion(m, path, LIMITS, ROBOT, H), path, 20.0,
            lambda *told: told,
        )  # fmt: skip
        told.closed = self.of_path.closed = ""
        self.step()

    def give_way(self, why: str, parts: tuple[int, ...]) -> None:
        for goals in (self.of_joints, self.of_path):
            goals.give_way(why, parts)
        if 0 in parts:
            self.route.followed = None

    @property
    def now(self) -> float:
        return START + self.k * H

    def send(self, request: Any, samples: int = 1) -> Handle:
        handle = Handle(request)
        (self.of_path if hasattr(request, "path") else self.of_joints).accept(handle)
        self.steps(samples)
        return handle

    def answer(self, handle: Handle) -> tuple[str, int, str]:
        """Outcome, code and line of a goal that is over; empty of one that is not."""
        goals = self.of_path if hasattr(handle.request, "path") else self.of_joints
        if not goals.goals[bytes(handle.goal_id.uuid)].over.is_set():
            return "", 0, ""
        found = goals.answer(handle)
        return handle.outcome, found.code, found.why

    def step(self) -> None:
        self.clock.tick(msg.Clock(msg.Time(int(self.now), round(1e9 * (self.now % 1)))))
        now, follower = self.follower.now, self.follower
        seen = np.concatenate((now[:5], now[7:11])) + self.off
        situation = RobotSituation(
            now[7:].reshape(3, 2), seen[5:].reshape(2, 2), now[:5], seen[:3], seen[3:5], self.moved_on
        )
        wishes = [wish for goals in (self.of_joints, self.of_path) for wish in goals.poll(
            self.clock, situation, self.stopped
        )]  # fmt: skip
        wait([future for future, _ in self.planner.open])
        wishes += self.planner.poll()
        follower.step(self.k * H, H if self.k else 0.0, seen, tuple(wishes), [follower.check(one) for one in wishes])
        self.moved_on, self.k = 0.5 * sum(follower.pace) * H, self.k + 1
        self.rows.append(now.copy())

    def steps(self, count: int) -> None:
        for _ in range(count):
            self.step()

    @property
    def q(self) -> np.ndarray:
        """(N, 2) joints since the start."""
        return np.array(self.rows)[:, 7:9]


DONE = ("succeed", OKAY, "")
TWO = (1.0, (0.1, -0.1)), (2.0, (0.3, -0.3))


def test_one_point_is_a_trajectory_and_the_last_point_is_held() -> None:
    graph = Graph()
    handle = graph.send(goal((1.0, (0.4, -0.2))), 90)
    assert graph.answer(handle)[0] == "" and len(handle.feedback) > 10
    graph.steps(100)
    assert graph.answer(handle) == DONE and graph.q[-50:] == pytest.approx(np.array([[0.4, -0.2]] * 50))


def test_names_come_in_any_order_and_joints_that_are_not_named_stay() -> None:
    graph = Graph()
    handle = graph.send(goal((1.0, (0.4, -0.2)), names=NAMES[::-1]), 120)
    assert graph.answer(handle) == DONE and graph.q[-1] == pytest.approx([-0.2, 0.4])
    graph.send(goal((1.0, (0.1,)), names=NAMES[:1]), 120)
    assert graph.q[-1] == pytest.approx([0.1, 0.4])


@pytest.mark.parametrize("degree", [3, 5])
def test_points_with_velocities_are_cubics_and_with_accelerations_of_degree_five(degree: int) -> None:
    """Second answer: the polynomial of those values, solved for its coefficients."""
    rows = [(0.0, 0.0, 0.0, 0.0), (1.0, 0.1, 0.2, -0.1), (2.0, 0.3, 0.0, 0.0)]
    parts = (degree + 1) // 2
    graph = Graph()
    graph.send(goal(*((t, *((x, 0.0) for x in row[:parts])) for t, *row in rows)), 205)
    (_, *a), (_, *b) = rows[1:]
    powers = np.arange(degree + 1)
    lines = [
        [math.perm(p, d) * t ** (p - d) if p >= d else 0.0 for p in powers] for t in (0.0, 1.0) for d in range(parts)
    ]
    c = np.linalg.solve(lines, [*a[:parts], *b[:parts]])
    t = np.linspace(0.0, 1.0, 101)
    q = graph.q[:, 0]
    begin = next(k for k in range(len(q)) if q[k] > 0.0) - 1
    assert q[begin + 100 : begin + 201] == pytest.approx(np.polyval(c[::-1], t), abs=1e-9)


BAD: dict[str, tuple[Any, int, str]] = {
    "empty": (goal(), INVALID_GOAL, "no points"),
    "unknown joint": (goal(*TWO, names=("arm_1_joint", "elbow")), INVALID_JOINTS, "joints elbow: there is"),
    "joint twice": (goal(*TWO, names=("arm_1_joint",) * 2), INVALID_JOINTS, "one twice"),
    "no names": (goal(*TWO, names=()), INVALID_JOINTS, "no joints"),
    "times do not increase": (goal(*TWO, (2.0, (0.4, 0.0))), INVALID_GOAL, "times do not increase"),
    "times in disorder": (goal(*TWO[::-1]), INVALID_GOAL, "times do not increase"),
    "too few positions": (goal((1.0, (0.1,)), (2.0, (0.3, 0.3))), INVALID_GOAL, "positions for 2 joints are missing"),
    "no positions": (goal((1.0, (), (0.1, 0.1))), INVALID_GOAL, "positions for 2 joints are missing"),
    "too few velocities": (goal((1.0, (0.1, 0.1), (0.1,)), (2.0, (0.3, 0.3), (0.0, 0.0))), INVALID_GOAL, "velocities"),
    "ends moving": (goal((1.0, (0.1, 0.1), (0.3, 0.0))), INVALID_GOAL, "its last point is not at rest"),
    "not finite": (goal((1.0, (0.1, math.nan))), INVALID_GOAL, "not finite"),
    "all in the past": (goal(*TWO, stamp=START - 5.0), OLD_STAMP, "it was over 3"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_what_is_refused_says_why_and_the_goal_that_is_followed_goes_on(name: str) -> None:
    request, code, why = BAD[name]
    graph = Graph()
    first = graph.send(goal(*TWO), 50)
    outcome = graph.answer(graph.send(request, 3))
    assert outcome[:2] == ("abort", code) and why in outcome[2]
    graph.steps(200)
    assert graph.answer(first) == DONE


def test_no_goal_is_followed_by_a_node_that_is_not_active() -> None:
    graph = Graph()
    graph.of_joints.close("deactivated")
    assert graph.answer(graph.send(goal(*TWO), 3)) == ("abort", INVALID_GOAL, "deactivated")


def test_points_in_the_past_are_passed_over() -> None:
    graph = Graph()
    handle = graph.send(goal(*TWO, stamp=START - 1.5), 120)
    assert graph.answer(handle) == DONE and graph.q[-1] == pytest.approx([0.3, -0.3])
    assert np.abs(np.diff(graph.q, axis=0)).max() < 0.02  # without a jump to where it would be by now


def test_a_start_in_the_future_is_waited_for_while_the_goal_before_goes_on() -> None:
    graph = Graph()
    first = graph.send(goal((1.0, (0.2, 0.2))), 20)
    dropped = graph.send(goal(*TWO, stamp=START + 3.0), 5)
    later = graph.send(goal((1.0, (-0.2, -0.2)), stamp=START + 2.0), 5)  # the newest that waits counts
    assert graph.answer(dropped) == ("abort", INVALID_GOAL, "another goal came")
    wrong = graph.send(goal(*TWO, names=("arm_1_joint", "elbow"), stamp=START + 2.0), 5)
    assert graph.answer(wrong)[:2] == ("abort", INVALID_JOINTS)  # at once, and what waits goes on waiting
    graph.steps(150)
    assert graph.answer(first) == DONE and not later.feedback and graph.q[-1] == pytest.approx([0.2, 0.2])
    graph.steps(150)
    q = graph.q[:, 0]
    assert graph.answer(later) == DONE and later.feedback and q[-1] == pytest.approx(-0.2)
    assert abs(np.flatnonzero(q > 0.2 - 1e-6)[-1] * H - 2.0) < 0.05


def test_a_goal_that_waits_can_be_cancelled() -> None:
    graph = Graph()
    later = graph.send(goal(*TWO, stamp=START + 1.0), 5)
    later.is_cancel_requested = True
    graph.steps(300)
    assert graph.answer(later) == ("canceled", OKAY, "cancelled") and not graph.q.any()


def test_another_goal_takes_its_place_without_a_jump() -> None:
    graph = Graph()
    first = graph.send(goal((2.0, (1.0, 1.0))), 100)
    second = graph.send(goal((1.0, (0.0, 0.0))), 150)
    assert graph.answer(first) == ("abort", INVALID_GOAL, "another goal came") and graph.answer(second) == DONE
    assert np.abs(np.diff(graph.q, 2, axis=0)).max() / H**2 < 20.0 and graph.q[-1] == pytest.approx([0.0, 0.0])


def test_a_cancelled_goal_brakes_and_holds() -> None:
    graph = Graph()
    handle = graph.send(goal((2.0, (1.0, 1.0))), 100)
    handle.is_cancel_requested = True
    graph.steps(100)
    assert graph.answer(handle) == ("canceled", OKAY, "cancelled")
    assert np.abs(np.diff(graph.q[-20:], axis=0)).max() < 1e-9 and 0.4 < graph.q[-1, 0] < 0.9


def one(name: str, position: float, velocity: float = 0.0) -> Any:
    return msg.JointTolerance(name, position, velocity)


ON_WAY: dict[str, tuple[float, list[Any], bool]] = {
    "none is stated": (0.0, [], False),
    "the default": (0.05, [], True),
    "its own": (0.0, [one("arm_2_joint", 0.05)], True),
    "its own is wider": (0.05, [one("arm_2_joint", 0.5)], False),
    "0 says nothing": (0.05, [one("arm_2_joint", 0.0)], True),
    "-1 takes it away": (0.05, [one("arm_2_joint", -1.0)], False),
    "of the velocity": (0.0, [one("arm_2_joint", 0.0, 0.2)], True),
}


@pytest.mark.parametrize("name", ON_WAY)
def test_a_path_tolerance_that_is_violated_ends_it_and_the_arm_holds(name: str) -> None:
    default, given, fails = ON_WAY[name]
    graph = Graph(Action(path_tolerance=default))
    handle = graph.send(goal(*TWO, path_tolerance=given), 100)
    graph.off[6], graph.off[8] = 0.1, 0.3
    graph.steps(60)
    outcome = graph.answer(handle)
    assert outcome[:2] == (("abort", OFF_PATH) if fails else ("", 0))
    if fails:
        assert "arm_2_joint is " in outcome[2] and "off its way" in outcome[2], outcome
        graph.steps(150)
        assert graph.q[-1, 0] < 0.2 and np.abs(np.diff(graph.q[-20:], axis=0)).max() < 1e-9


def test_the_goals_tolerances_and_its_time() -> None:
    """Where it ends 0.03 rad beside: within the default of 0.05, not within its own; -1 of time waits for ever."""
    outcomes = []
    for given, patience in (([], 0.0), ([one("arm_1_joint", 0.02)], 0.5), ([one("arm_1_joint", 0.02)], -1.0)):
        graph = Graph()
        graph.off[5] = 0.03
        handle = graph.send(goal(*TWO, goal_tolerance=given, goal_time_tolerance=lasting(patience)), 245)
        early = graph.answer(handle)
        graph.steps(400 if patience < 0 else 20)
        outcomes.append(early if early[0] else graph.answer(handle))
        if patience < 0.0:
            graph.off[5] = 0.01
            graph.steps(2)
            outcomes.append(graph.answer(handle))
    assert outcomes[0] == DONE and outcomes[2][0] == "" and outcomes[3] == DONE
    assert outcomes[1] == ("abort", OFF_GOAL, "arm_1_joint is off its goal by 0.03, its tolerance is 0.02")


def test_a_goal_is_reached_when_the_joints_have_stopped() -> None:
    graph = Graph()
    graph.off[8] = 0.2
    handle = graph.send(goal(*TWO), 320)
    outcome = graph.answer(handle)
    assert outcome[:2] == ("abort", OFF_GOAL) and "arm_2_joint is 0.2 /s off its goal" in outcome[2]


def test_the_supervisor_ends_a_goal() -> None:
    graph = Graph()
    handle = graph.send(goal(*TWO), 50)
    graph.stopped = True
    graph.step()
    assert graph.answer(handle) == ("abort", OFF_PATH, "the supervisor stopped the robot")
    assert graph.answer(graph.send(goal(*TWO), 2)) == ("abort", INVALID_GOAL, "the supervisor has stopped the robot")


def test_a_scaled_goal_takes_longer_and_its_tolerances_with_it() -> None:
    graph = Graph(Action(path_tolerance=0.01, goal_time=0.2))
    graph.follower.share = 0.5
    handle = graph.send(goal(*TWO), 390)
    assert graph.answer(handle)[0] == "" and graph.q[-1, 0] < 0.3 - 1e-7
    graph.follower.share = 0.0
    graph.steps(300)
    assert graph.answer(handle)[0] == ""
    graph.follower.share = 1.0
    graph.steps(20)
    assert graph.answer(handle) == DONE


def test_base_and_arm_in_one_goal_with_tolerances_by_component() -> None:
    """As MoveIt writes a planar joint: transforms and rates of x, y and theta in the frame of the message."""

    def point(time: float, x: float, v: float) -> msg.MultiDOFJointTrajectoryPoint:
        rate = msg.Twist(msg.Vector3(v), msg.Vector3())
        there = msg.Transform(msg.Vector3(x), msg.Quaternion())
        return msg.MultiDOFJointTrajectoryPoint([there], [rate], time_from_start=lasting(time))

    several = msg.MultiDOFJointTrajectory(
        msg.Header(frame_id="map"), ["world_joint"], [point(0, 0, 0), point(2, 0.4, 0.3), point(4, 0.8, 0)]
    )
    graph = Graph()
    handle = graph.send(goal((4.0, (0.3, 0.3)), multi_dof_trajectory=several), 200)
    row = graph.rows[-1]
    assert row[0] == pytest.approx(0.4, abs=0.01) and row[3] == pytest.approx(0.3, abs=0.01)
    assert handle.feedback[-1][1] == "world_joint"
    graph.steps(215)
    assert (
        graph.answer(handle) == DONE
        and graph.rows[-1][0] == pytest.approx(0.8)
        and graph.q[-1, 0] == pytest.approx(0.3)
    )
    graph = Graph()
    part = msg.JointComponentTolerance("world_joint", 5, position=0.05)  # ROTATION
    handle = graph.send(goal(multi_dof_trajectory=several, component_path_tolerance=[part]), 100)
    graph.off[2] = 0.06
    graph.steps(2)
    outcome = graph.answer(handle)
    assert outcome[:2] == ("abort", OFF_PATH) and "world_joint/theta is off its way by 0.06" in outcome[2]
    graph.steps(100)
    assert not np.any(graph.rows[-1][3:5])


# -- a path of Nav2 ----------------------------------------------------------------------------------------------------


def path(points: Any, frame: str = "map") -> Any:
    poses = [
        msg.PoseStamped(msg.Header(), msg.Pose(msg.Point(x, y), msg.Quaternion(0.0, 0.0, 0.0, 0.0))) for x, y in points
    ]
    return SimpleNamespace(path=msg.Path(msg.Header(frame_id=frame), poses))


ASIDE = [(0.0, 0.05 * i) for i in range(21)]  # a metre to the left


def test_a_path_that_starts_aside_is_begun_with_a_turn_on_the_spot() -> None:
    graph = Graph(path=PlannedPath(speed=0.3))
    handle = graph.send(path(ASIDE), 900)
    table = np.array(graph.rows)
    assert graph.answer(handle) == DONE and table[-1, :3] == pytest.approx([0.0, 1.0, math.pi / 2], abs=1e-3)
    turned = np.flatnonzero(table[:, 2] > 1.5)[0]
    assert np.abs(table[:turned, :2]).max() < 0.01  # it stands while it turns
    assert table[:, 3].max() <= 0.3 + 1e-9 and np.abs(table[:, 4]).max() <= LIMITS.yaw_rate + 1e-9
    distances = [distance for distance, _ in handle.feedback]
    assert distances[0] == pytest.approx(1.0, abs=0.02) and distances[-1] < 0.02 and np.diff(distances).max() <= 1e-9
    assert max(speed for _, speed in handle.feedback) == pytest.approx(0.3, abs=0.01)


def test_a_path_that_is_sent_anew_goes_on_at_speed() -> None:
    """Nav2 plans anew every second: the goal before is aborted, and the base does not brake."""
    graph = Graph(path=PlannedPath(speed=0.3))
    line = [(0.05 * i, 0.0) for i in range(61)]
    first = graph.send(path(line), 300)
    second = graph.send(path([p for p in line if p[0] >= graph.rows[-1][0]]), 100)
    assert graph.answer(first)[:2] == ("abort", 100) and graph.answer(second)[0] == ""
    assert np.array(graph.rows)[250:, 3].min() > 0.2
    second.is_cancel_requested = True
    graph.steps(150)
    assert graph.answer(second) == ("canceled", 0, "cancelled") and graph.rows[-1][3] == 0.0


def test_a_path_that_cannot_be_driven_is_told_in_nav2s_numbers() -> None:
    graph = Graph()
    for request, code, why in (
        (path([]), INVALID_PATH, "no poses"),
        (path([(math.nan, 0.0)]), INVALID_PATH, "not finite"),
        (path(ASIDE, "elsewhere"), NO_FRAME, "no way from 'elsewhere'"),
    ):
        outcome = graph.answer(graph.send(request, 3))
        assert outcome[:2] == ("abort", code) and why in outcome[2], outcome
    graph.off[1] = 0.5
    handle = graph.send(path([(0.1 * i, 0.0) for i in range(6)]), 700)
    outcome = graph.answer(handle)
    assert outcome[:2] == ("abort", NO_PROGRESS) and "0.5 m and 0 rad from its end" in outcome[2]
    handle = graph.send(path(ASIDE), 50)
    graph.stopped = True
    graph.step()
    assert graph.answer(handle)[:2] == ("abort", NO_CONTROL)


def test_a_goal_of_the_arm_leaves_the_path_alone_and_one_of_the_base_ends_it() -> None:
    graph = Graph()
    line = graph.send(path([(0.1 * i, 0.0) for i in range(31)]), 100)
    arm = graph.send(goal(*TWO), 250)
    assert graph.answer(arm) == DONE and graph.answer(line)[0] == ""
    here = graph.rows[-1][0]
    transform = msg.Transform(msg.Vector3(here + 1.0), msg.Quaternion())
    points = [msg.MultiDOFJointTrajectoryPoint([transform], time_from_start=lasting(8.0))]
    several = msg.MultiDOFJointTrajectory(msg.Header(), ["base"], points)
    both = graph.send(goal(multi_dof_trajectory=several), 850)
    assert graph.answer(line)[:2] == ("abort", 100) and graph.answer(both) == DONE
