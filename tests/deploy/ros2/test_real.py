"""The node against real ROS 2: rclpy and Fast DDS in a process of their own, on the loopback.

One distribution in the default suite, both and the whole matrix of faults under `long`.
"""

from __future__ import annotations

import math
import subprocess
import sys
import time
from pathlib import Path
from threading import Event, Thread

import numpy as np
import pytest
from graph import SETTINGS, Drive, drive, require_control_msgs, start
from places import ROOT

pytest.importorskip("cyclonedds", reason="pip install 'mmnn_pin[ros2]'")

from random_messages import made

from mmnn_pin.deploy.ros2 import messages as msg
from mmnn_pin.deploy.ros2.link import Inlet, Link, Outlet
from mmnn_pin.deploy.ros2.settings import Network, Topic

EVERY = ["kilted", pytest.param("jazzy", marks=pytest.mark.long)]
DOMAINS = iter(range(60, 100))  # one per test: nobody hears another's robot
GOAL = (0.8, 0.4)  # of the trajectory that the robot's planner sends


@pytest.fixture
def domain() -> int:
    return next(DOMAINS)


def was_tracked(run: Drive) -> None:
    """Base at its velocity, arm at its goal, nothing tripped."""
    assert run.code == 0 and np.isnan(run.trip), run.lines
    row = run.at(5.0)
    assert np.abs(row[6:8] - GOAL).max() < 0.03, row
    assert np.abs(run.at(3.5)[4:6] - (0.2, 0.3)).max() < 0.05, run.at(3.5)


def stood_safely(run: Drive, why: str) -> None:
    """It tripped, said why in one line, and base and arm came to rest."""
    assert run.code == 1, run.lines
    assert run.trip > 0 and any(why in line for line in run.lines.splitlines() if "tripped" in line), run.lines
    row = run.at(run.trip + 1.1)
    assert np.abs(row[4:6]).max() < 0.03 and np.abs(row[8:10]).max() < 0.3, row


@pytest.mark.parametrize("distribution", EVERY)
def test_a_robot_is_driven_through_what_can_be_borne(tmp_path: Path, domain: int, distribution: str) -> None:
    """Joints in another order, NaN in every third message, halves, a second publisher, a publisher that restarts."""
    faults = "permuted_for@0.6", "nan_for@1.6", "half_for@2.2", "duplicate_for@3.2", "restart_for@4.2"
    run = drive(tmp_path, distribution, domain, *faults, seconds=6.0)
    was_tracked(run)
    assert "malformed" in run.lines and "surplus" in run.lines and "not finite" in run.lines
    assert run.robot["diagnostics"] > 20


@pytest.mark.parametrize("distribution", EVERY)
def test_a_robot_that_dies_trips_the_supervisor(tmp_path: Path, domain: int, distribution: str) -> None:
    run = drive(tmp_path, distribution, domain, "kill@1.0", seconds=4.0)
    assert run.code == 1 and "tripped" in run.lines
    told = [line for line in run.lines.splitlines() if "nothing fresh of joints arm_1_joint, arm_2_joint" in line]
    assert any(line.startswith("t = ") for line in told) and any(line.startswith("tripped") for line in told), run.lines


FAULTS = {
    "ahead": ("in the future", "synchronise the clocks"),
    "back": (" old", "synchronise the clocks"),
    "missing": ("arm_2_joint", "nothing fresh of"),
    "nan": ("not finite", "dropped"),
    "half": ("JointState", "dropped"),
}


@pytest.mark.long
@pytest.mark.parametrize("fault", FAULTS)
def test_faults_stop_the_robot_safely(tmp_path: Path, domain: int, fault: str) -> None:
    run = drive(tmp_path, "kilted", domain, f"{fault}@2.0", seconds=6.0)
    for why in FAULTS[fault]:
        stood_safely(run, why)


@pytest.mark.long
@pytest.mark.parametrize("distribution", ["kilted", "jazzy"])
def test_a_joystick_that_falls_silent_stops_the_base(tmp_path: Path, domain: int, distribution: str) -> None:
    run = drive(tmp_path, distribution, domain, "silent_joystick@2.0", seconds=5.0)
    assert run.code == 0 and "setpoints were not renewed in time" in run.lines
    assert np.abs(run.at(4.5)[4:6]).max() < 0.01 and np.abs(run.at(4.9)[6:8] - GOAL).max() < 0.05


@pytest.mark.long
def test_qualities_that_do_not_match_are_named(tmp_path: Path, domain: int) -> None:
    run = drive(tmp_path, "kilted", domain, "best_effort", reliability="reliable", wait=4.0)
    assert run.code == 2 and "/joint_states: its publisher offers best_effort" in run.lines, run.lines


@pytest.mark.long
def test_both_qualities_drive(tmp_path: Path, domain: int) -> None:
    was_tracked(drive(tmp_path, "kilted", domain, reliability="reliable", seconds=5.5))


@pytest.mark.long
def test_a_simulators_clock_drives_and_stops_where_it_jumps(tmp_path: Path, domain: int) -> None:
    sim = ('clock.source="sim"',)
    run = drive(tmp_path, "kilted", domain, "sim_time", seconds=5.5, changes=sim)
    assert run.code == 0 and np.abs(run.at(4.5)[6:8] - GOAL).max() < 0.05, run.lines
    run = drive(tmp_path, "kilted", next(DOMAINS), "sim_time", "sim_back@2.0", seconds=6.0, changes=sim)
    assert run.code == 1 and "stopped from outside" in run.lines and "/clock jumped by -" in run.lines, run.lines


@pytest.mark.long
def test_the_example_with_mujoco_drives(tmp_path: Path) -> None:
    pytest.importorskip("mujoco", reason="pip install 'mmnn_pin[contact]'")
    command = [
        sys.executable,
        "examples/robot/run.py",
        "--seconds",
        "12",
        "--controllers",
        "pd",
        "--out",
        str(tmp_path),
    ]
    run = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, timeout=200)
    assert run.returncode == 0 and "pd " in run.stdout, run.stdout + run.stderr


@pytest.mark.long
def test_another_domain_is_silence(tmp_path: Path, domain: int) -> None:
    run = drive(tmp_path, "kilted", domain, robot_domain=next(DOMAINS), wait=3.0)
    assert run.code == 2 and f"no publisher: domain {domain}" in run.lines, run.lines


@pytest.mark.long
@pytest.mark.parametrize("distribution", ["kilted", "jazzy"])
def test_goals_of_the_action_are_followed(tmp_path: Path, domain: int, distribution: str) -> None:
    """As MoveIt sends them: refused, accepted, replaced, reached, cancelled; one of them longer than a packet."""
    require_control_msgs(distribution)
    run = drive(tmp_path, distribution, domain, "no_plan", seconds=14.0, planner="planner_node.py")
    told = run.robot["planner"]
    assert run.code == 0 and told["there"] and told["long"] and told["accepted"], (told, run.lines)
    assert not told["unknown joint"] and not told["too fast"]
    assert told["reached"] == [4, 0, ""] and told["feedback"] > 5 and told["error"] < 0.2, told
    assert told["names"] == ["arm_1_joint", "arm_2_joint"]
    assert told["cancel"] == 1 and told["cancelled"] == [5, 0, "cancelled"]
    assert np.abs(run.rows[-1, 8:10]).max() < 0.1  # it stands after the cancel


@pytest.mark.parametrize("distribution", EVERY)
def test_a_robot_goes_on_after_its_reset_and_stops_when_told(tmp_path: Path, domain: int, distribution: str) -> None:
    """A silent second trips it; a reset without a measurement is refused, one with it is not."""
    asked = 'switches.reset="/mmnn/reset"', 'switches.stop="/mmnn/stop"'
    run = drive(tmp_path, distribution, domain, "silent_for@2.0", seconds=12.0, changes=asked, planner="switch_node.py")
    told = run.robot["planner"]
    assert run.code == 0 and told["there"] and told["tripped"], (told, run.lines)
    assert told["early"] == [False, "nothing to reset: the supervisor has not tripped"]
    assert not told["blind"][0] and "a reset that is blind" in told["blind"][1]
    assert told["reset"][0] and told["runs"] and told["stop"][0] and told["stopped"]
    assert told["again"][0] and told["runs again"]
    assert "tripped" in run.lines or "nothing fresh" in run.lines
    v = run.rows[:, 4]  # the joystick drives it at first, stands after trip and stop, and drives it again after each
    assert (np.abs(v[run.rows[:, 0] < 2.5].max() - 0.2) < 0.05) and np.abs(run.at(10.0)[4] - 0.2) < 0.05, run.lines


BY_POSITION = SETTINGS.replace(
    """topic = "/effort_controller/commands"
joints""",
    """topic = "/arm_controller/joint_trajectory"
type = "JointTrajectory"
interface = "position"
joints""",
).replace('topic = "/cmd_vel"', 'topic = "/cmd_vel"\nstamped = true')


@pytest.mark.long
@pytest.mark.parametrize("distribution", ["kilted", "jazzy"])
def test_positions_by_trajectories_and_stamped_velocities(tmp_path: Path, domain: int, distribution: str) -> None:
    """`joint_trajectory_controller` takes a point per sample, the joystick sends `TwistStamped`."""
    run = drive(tmp_path, distribution, domain, "stamped", seconds=5.5, text=BY_POSITION)
    was_tracked(run)
    assert run.robot["waited"] == [pytest.approx(0.02)]  # two periods of 100 Hz


ON_A_MAP = (
    SETTINGS
    + """
[path]
topic = "/plan"
speed = 0.25
[tf]
map = "map"
odom = "odom"
"""
)


def tell_the_map(domain: int, over: Event) -> None:
    """`/tf` of a localiser (there are no wheels of tf2_msgs): the map is corrected 2.5 s after the first command."""
    link, begun = Link(Network(domain=domain)), math.inf
    told = Outlet(link, "/tf", msg.TFMessage, Topic("/tf", "reliable", 20))
    commands = Inlet(link, "/effort_controller/commands", msg.Float64MultiArray, Topic("/commands"))
    while not over.wait(0.05):
        now = time.monotonic()
        begun = min(begun, now) if commands.take(now) else begun
        seconds, rest = divmod(time.time(), 1.0)
        header = msg.Header(msg.Time(int(seconds), int(1e9 * rest)), "map")
        there = msg.Vector3(y=0.25 if now > begun + 2.5 else 0.0)
        told.send(msg.TFMessage([msg.TransformStamped(header, "odom", msg.Transform(there, msg.Quaternion(w=1.0)))]))
    link.close()


@pytest.mark.long
@pytest.mark.parametrize("distribution", ["kilted", "jazzy"])
def test_a_path_follows_its_map_whose_corrections_jerk_nobody(tmp_path: Path, domain: int, distribution: str) -> None:
    """2 m ahead in a map that moves by 0.25 m across on the way: the robot ends where the map has it then."""
    over = Event()
    localiser = Thread(target=tell_the_map, args=(domain, over))
    localiser.start()
    try:
        run = drive(tmp_path, distribution, domain, "map", seconds=14.0, text=ON_A_MAP)
    finally:
        over.set()
        localiser.join()
    assert run.code == 0 and np.isnan(run.trip), run.lines
    x, y = run.rows[-1, 1:3]
    assert abs(x - 2.0) < 0.06 and abs(y + 0.25) < 0.06, (x, y)
    step = run.rows[1, 0] - run.rows[0, 0]
    v, w = run.rows[:, 4], run.rows[:, 5]
    assert np.abs(np.diff(v)).max() / step < 2.0 and np.abs(v).max() < 0.5
    assert np.abs(np.diff(w)).max() / step < 15.0 and np.abs(w).max() < 2.0


@pytest.mark.parametrize("distribution", EVERY)
@pytest.mark.parametrize("reliability", ["reliable", pytest.param("best_effort", marks=pytest.mark.long)])
def test_messages_of_five_types_come_back_as_they_were(domain: int, distribution: str, reliability: str) -> None:
    """Through rclpy and back: none wrong, and where it is reliable none lost."""
    rng, count = np.random.default_rng(11), 30
    echo = start(distribution, domain, "echo_node.py", reliability)
    link = Link(Network(domain=domain))
    quality = Topic("/echo", reliability, 200, publishers=1)  # type: ignore[arg-type]
    kinds = msg.JointState, msg.Odometry, msg.TwistStamped, msg.JointTrajectory, msg.Path
    there = [Outlet(link, f"/there/{kind.__name__}", kind, quality) for kind in kinds]
    back = [Inlet(link, f"/back/{kind.__name__}", kind, quality) for kind in kinds]
    try:
        deadline = time.monotonic() + 60.0
        while not all(one.readers for one in there) or not all(one.publishers for one in back):
            assert time.monotonic() < deadline and echo.poll() is None, "they did not find each other"
            time.sleep(0.05)
        time.sleep(1.0)  # the other side knows us, too
        sent = [[made(kind, rng) for _ in range(count)] for kind in kinds]
        for k in range(count):
            for outlet, messages in zip(there, sent, strict=True):
                outlet.send(messages[k])
            time.sleep(0.005)
        heard: list[list[bytes]] = [[] for _ in kinds]
        while time.monotonic() < deadline and any(len(one) < count for one in heard):
            for inlet, came in zip(back, heard, strict=True):
                came += [one.serialize(use_version_2=False) for one in inlet.take(time.monotonic())]
            time.sleep(0.01)
            if reliability == "best_effort" and time.monotonic() > deadline - 50.0:
                break
        link.allowed.clear()  # from now on nobody is a peer
        stranger = Inlet(link, back[0].name, kinds[0], quality)
        while not stranger.foreign and time.monotonic() < deadline:
            there[0].send(sent[0][0])
            time.sleep(0.05)
            assert stranger.take(time.monotonic()) == []
    finally:
        echo.kill()
        echo.wait()
        link.close()
    asked = [[one.serialize(use_version_2=False) for one in messages] for messages in sent]
    assert stranger.foreign and "is not among network.peers" in stranger.why
    assert not any(inlet.dropped for inlet in back)
    for came, whole in zip(heard, asked, strict=True):
        if reliability == "reliable":
            assert came == whole
        else:
            assert len(came) > 0.5 * count and set(came) <= set(whole)


# -- the promise, on the wire ------------------------------------------------------------------------------------------

IN_ODOM = (
    SETTINGS
    + """
[path]
topic = "/plan"
speed = 0.25
"""
)


def kept_its_promise(run: Drive, low: tuple[float, float], high: tuple[float, float], path: bool = False) -> None:
    """Joints stay between start and goal, wheels get no more than was asked, all by what the robot itself saw."""
    q, asked = run.rows[:, 6:8], run.rows[:, 10:12]
    inside = (q >= np.array(low) - 0.12) & (q <= np.array(high) + 0.12)  # what a PD of 10 1/s overshoots
    assert inside.all(), (q.min(axis=0), q.max(axis=0))
    assert np.abs(asked[:, 0]).max() <= (0.4 if path else 0.3), "faster than asked"
    assert np.abs(asked[:, 1]).max() <= (0.4 if path else 0.45), "turns faster than asked"
    moving = asked[:-1][asked[1:].any(axis=1)]  # it may end at once, when the node leaves
    assert np.abs(np.diff(moving, axis=0)).max(initial=0.0) <= 0.12, "a command jumps"


def test_jogs_and_velocities_move_the_robot_as_asked(tmp_path: Path, domain: int) -> None:
    """A point every 80 ms, 0.15 s ahead, for two seconds; the base by `cmd_vel` meanwhile."""
    run = drive(tmp_path, "kilted", domain, "jog", seconds=5.0)
    assert run.code == 0 and np.isnan(run.trip), run.lines
    kept_its_promise(run, (0.2, -0.3), (0.86, -0.3))
    assert abs(run.at(4.9)[6] - 0.82) < 0.04 and run.rows[run.rows[:, 0] < 2.4, 8].min() > -0.02, run.rows[-1]


def test_a_plan_and_a_path_without_headings_move_the_robot_as_asked(tmp_path: Path, domain: int) -> None:
    """2 m ahead with identity for orientations, while the arm follows its plan."""
    run = drive(tmp_path, "kilted", domain, "path", seconds=13.0, text=IN_ODOM)
    assert run.code == 0 and np.isnan(run.trip), run.lines
    kept_its_promise(run, (0.2, -0.3), (0.8, 0.4), path=True)
    assert np.abs(run.rows[-1, 1:4] - (2.0, 0.0, 0.0)).max() < 0.03 and np.abs(run.at(5.0)[6:8] - GOAL).max() < 0.03


@pytest.mark.parametrize(
    ("faults", "changes"), [(("kill@2.0",), ()), (("sim_time", "sim_back@2.0"), ('clock.source="sim"',))]
)
def test_a_robot_that_dies_or_whose_clock_jumps_is_asked_for_nothing_more(
    tmp_path: Path, domain: int, faults: tuple[str, ...], changes: tuple[str, ...]
) -> None:
    run = drive(tmp_path, "kilted", domain, *faults, seconds=6.0, changes=changes)
    assert (run.code == 1 and "tripped" in run.lines) or "stopped" in run.lines, run.lines
    if "rows" in run.robot:
        kept_its_promise(run, (0.2, -0.3), (0.8, 0.4))
        assert np.abs(run.rows[-1, 10:12]).max() < 0.01 and np.abs(run.rows[-1, 4:6]).max() < 0.03, run.rows[-1]
