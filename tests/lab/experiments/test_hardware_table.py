"""The table of hardware: profiles, what follows from them by hand, who counts more, and every robot on some of them."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest

from mmnn_pin import Stepper, load, load_experiment
from mmnn_pin.cli.ros2 import asked
from mmnn_pin.deploy.ros2.settings import settings_of
from mmnn_pin.deploy.ros2.wiring import interfaces
from mmnn_pin.errors import ConfigError, InputError, UnknownName
from mmnn_pin.files import read_toml
from mmnn_pin.lab.experiments.config import read_hardware
from mmnn_pin.lab.experiments.hardware import Fitted, lines
from mmnn_pin.lab.experiments.hardware_table import BaseHardware, HardwareTable, JointHardware, profiles, proposed
from mmnn_pin.lab.experiments.runner import require_runnable, run_experiment
from mmnn_pin.loop.servo import Command
from mmnn_pin.loop.suited import MotorLoad
from mmnn_pin.model.robot import speed_limits
from mmnn_pin.model.robots import bundled, extra, robot_data
from mmnn_pin.safety import Safety
from mmnn_pin.signals import Setpoint

needs_data = pytest.mark.skipif(robot_data() is None, reason="example-robot-data is not installed")
ONE = ["controllers=['computed_torque']", "plots=[]"]
ROBOTS = {**bundled(), **extra()}
NAMES = {
    "so100": "feetech-sts3215", "so101": "feetech-sts3215", "panda": "franka", "ur5": "ur-e", "ur10_limited": "ur-e",
    "tiago_dual": "tiago", "tiago_pro": "tiago", "kinova": "unknown", "platform_arm": "unknown", "baxter": "unknown",
}  # fmt: skip


def on(robot, hardware, *more):
    said = [] if hardware is None else [f"hardware={hardware}" if hardware[0] == "{" else f'hardware="{hardware}"']
    return load_experiment("track", [f'robot="{robot}"', *said, *ONE, *more])


# -- profiles ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", profiles())
def test_a_profile_has_a_source_for_what_it_says_and_says_what_is_assumed(name):
    table = read_hardware(name)
    assert table.title and table.sources and not table.notes and table.profile in {"", *profiles()}
    guessed = [source for source in table.sources if source.startswith("assumed: ")]
    assert guessed or name == "ideal"
    said = read_toml(profiles()[name])
    assert set(said) - {"title", "sources", "robots", "profile"} <= set(HardwareTable.__struct_fields__)


def test_numbers_of_the_servos_follow_from_their_data_sheets():
    """Kt / R of BAM and the P gains of LeRobot and Robotis, once more."""
    kt, R, volt = 1.2116, 2.6762, 7.4
    feetech = read_hardware("feetech-sts3215").arm
    assert feetech.stall == pytest.approx(kt * volt / R, rel=2e-3)
    assert feetech.damping == pytest.approx(kt**2 / R, rel=2e-3)
    assert feetech.torque == pytest.approx(19.5 * 9.81e-2, rel=2e-3)
    assert feetech.speed == pytest.approx(math.radians(60) / 0.192, rel=2e-3)
    xm430 = read_hardware("dynamixel-xm430").arm
    duty = 800 / 128 / 885 * 4096 / math.tau  # per radian
    assert xm430.stiffness == pytest.approx(duty * 4.1, rel=5e-3)
    assert xm430.damping == pytest.approx(4.1 / (46 * math.tau / 60), rel=5e-3)
    assert feetech.encoder == xm430.encoder == pytest.approx(math.tau / 4096, rel=1e-3)


@needs_data
def test_a_robot_is_proposed_the_hardware_of_its_name():
    assert {name: proposed(load(name)) for name in NAMES} == NAMES


# -- what follows ------------------------------------------------------------------------------------------------------


@needs_data
def test_what_follows_from_a_profile_is_what_one_would_write_by_hand():
    found = Fitted(read_hardware("feetech-sts3215"), load("so101")).settings()
    joints = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")
    servo = {"bandwidth": pytest.approx(17.8 / 0.6081), "stiffness": 17.8, "damping": 0.549, "stall": 3.35}
    assert found == {
        "interfaces": dict.fromkeys(joints, "position"),
        "servo": servo | {"dead_band": 0.0008, "period": 0.001},
        "actuator": {"torque_limit": "urdf"},
        "effort_limits": 1.91,
        "speed_limits": 5.45,
        "armature": 0.0284,
        "friction": {"arm": 0.0591, "coulomb": 0.0524},
        "sensor": {"resolution": 0.001534, "velocity": "filtered", "bandwidth": 40.0},
        "latency": {"command": 0.01, "jitter": 0.0},
        "time": {"control_period": 0.02, "plant_step": 0.001},
    }


def test_groups_patterns_and_single_joints_find_their_motors():
    robot = load("platform_arm")
    left, right, first, second = robot.actuator_names
    table = HardwareTable(
        arm=JointHardware(interface="position", stiffness=20.0, damping=1.0, encoder=0.01),
        wheels=JointHardware(interface="velocity", bandwidth=8.0, encoder=0.02),
        joints={
            second: JointHardware(interface="current", torque_constant=0.2, lag=0.002),
            "arm_*": JointHardware(torque=9.0),
        },
    )
    fitted = Fitted(table, robot)
    found = fitted.settings()
    four = np.arange(4.0)
    sent = fitted.sent(Command(four, four, four, four, four + 10.0, four + 20.0, four[:2]))
    assert fitted.units() == {second: ("current", 0.2)}
    assert sent == {left: 10.0, right: 11.0, first: 22.0, second: 3.0 / 0.2}
    assert found["interfaces"] == {left: "velocity", right: "velocity", first: "position"}
    assert found["servo"]["bandwidth"] == [8.0, 8.0, 20.0, 30.0]  # nothing is known of the last one
    assert found["servo"]["stiffness"] == [0.0, 0.0, 20.0, 20.0]
    assert found["actuator"]["lag"] == [0.0, 0.0, 0.0, 0.002] and found["effort_limits"] == [0.0, 0.0, 9.0, 9.0]
    assert found["sensor"] == {"resolution": 0.01, "wheel_resolution": 0.02}
    with pytest.raises(ConfigError, match="'arm_1_joint' takes a pwm: how much torque"):
        Fitted(HardwareTable(arm=JointHardware(interface="pwm")), robot)
    with pytest.raises(UnknownName, match="elbow"):
        Fitted(HardwareTable(joints={"elbow": JointHardware()}), robot)


def test_a_base_has_a_rate_and_a_lag_of_its_own():
    """Its pose is new so seldom, the arm's measurements are not late for it, and the loop is judged with the oldest."""
    robot, wheels = load("platform_arm"), JointHardware(interface="velocity", bandwidth=8.0)

    def found(**base):
        own = base.pop("wheels", JointHardware(interface="velocity"))
        table = HardwareTable(rate=50.0, delay=0.01, wheels=own, base=BaseHardware(**base))
        return Fitted(table, robot).settings()

    slow = found(rate=20.0, delay=0.02, lag=0.25)
    assert slow["sensor"] == {"base_period": 0.05, "base_delay": 0.02} and slow["latency"]["command"] == 0.01
    assert slow["servo"]["bandwidth"][:2] == [4.0, 4.0] and "lag" not in slow["actuator"]
    assert found(lag=0.25, wheels=wheels)["servo"]["bandwidth"][:2] == [4.0, 4.0]
    assert found(lag=0.05, wheels=wheels)["servo"]["bandwidth"][:2] == [8.0, 8.0]
    assert found(lag=0.05, wheels=JointHardware())["actuator"]["lag"] == [0.05, 0.05, 0.0, 0.0]
    told = on("platform_arm", '{profile="unknown", base={rate=10.0, delay=0.04}}', "time.duration=0.5")
    run, plan = told.loop(robot, "pd"), told.loop(robot, "pd").plan()
    assert plan.latency == pytest.approx(told.latency.total + 6 * 0.02)
    with Stepper.of(run, safety=Safety(torque="urdf")) as stepper:
        assert stepper.setup.known.margin == pytest.approx(told.latency.margin + 6 * 0.02)
    pose = run.run()["pose"]
    changed = np.flatnonzero((np.diff(pose, axis=0) != 0.0).any(axis=1)) + 1
    assert changed.size and not (np.diff(changed) % 5).any()


def test_limits_of_a_table_stand_in_place_of_the_urdfs_for_everybody():
    robot = load("platform_arm")
    changed = robot.with_armature(0.01).with_limits((0.0, 0.0, 3.0, 0.0), 2.0)
    assert changed.effort_limits.tolist() == [*robot.effort_limits[:2], 3.0, robot.effort_limits[3]]
    assert speed_limits(changed).tolist() == [2.0] * 4
    assert changed.described.effort_limits.tolist() == changed.effort_limits.tolist()
    assert robot.with_limits(0.0, 0.0) is robot
    with pytest.raises(ConfigError, match="effort_limits"):
        robot.with_limits((1.0, 2.0), 0.0)


def test_casters_whose_motors_drive_the_base_are_driven_alike():
    kinds = Fitted(read_hardware("unknown"), load("casters_arm")).settings()["interfaces"]
    assert {kind for name, kind in kinds.items() if not name.startswith("arm")} == {"velocity"}


@needs_data
def test_a_joint_that_slides_has_no_servo_per_radian():
    robot = load("tiago_no_hand")
    fitted = Fitted(read_hardware("feetech-sts3215"), robot)
    lift = fitted.motors[robot.actuator_names.index("torso_lift_joint")]
    assert lift == JointHardware(interface="position", rate=1000.0)


def test_who_says_more_counts_more_and_messages_name_the_users_own_file(tmp_path):
    urdf, own = tmp_path / "mine.urdf", tmp_path / "mine.toml"
    urdf.write_text(ROBOTS["platform_arm"].read_text())
    beside = tmp_path / "mine.hardware.toml"
    beside.write_text('profile = "unknown"\nrate = 40\n[arm]\nbandwidth = 25.0\n')
    found = on(urdf, None)
    assert found.time.control_period == 1 / 40 and found.servo.bandwidth == (10.0, 10.0, 25.0, 25.0)
    own.write_text('experiment = "track"\nrobot = "mine.urdf"\n[servo]\ngain = 0.1\n[time]\ncontrol_period = 0.01\n')
    read = load_experiment(own, [*ONE, "servo.bandwidth=12"])
    assert (read.servo.gain, read.servo.bandwidth, read.time.control_period) == (0.1, 12.0, 0.01)
    assert on(urdf, "ideal").interfaces == {}
    slow = {name: on(urdf, name, "hardware.rate=25.0") for name in (None, "unknown")}  # on top of either
    assert {name: found.time.control_period for name, found in slow.items()} == {None: 0.04, "unknown": 0.04}
    assert [slow[name].servo.bandwidth[2] for name in slow] == [25.0, 20.0]
    with pytest.raises(
        ConfigError, match=r"--set hardware\.arm\.stifness: error: unknown key 'stifness': did you mean 'stiffness'"
    ):
        on(urdf, "unknown", "hardware.arm.stifness=3.0")
    beside.write_text("[arm]\nstifness = 3.0\n")
    with pytest.raises(InputError, match=rf"{re.escape(str(beside))}.*arm.*stifness"):
        on(urdf, None)
    beside.write_text("[arm]\nencoder = -1.0\n")
    with pytest.raises(ConfigError, match=rf"{re.escape(str(beside))}:2:arm.encoder: error: -1"):
        on(urdf, None)
    for text, line in {
        "[joints.elbow]\ntorque = 3.0\n": ":1:joints: error: unknown joint 'elbow': there is: wheel_left_joint",
        "[joints]\n'elb*'.torque = 3.0\n": ":2:joints: error: unknown joint 'elb*'",
        "[arm]\ninterface = 'pwm'\n": ":joints.arm_1_joint: error: 'arm_1_joint' takes a pwm",
        "[arm]\ninterface = 'torque'\n": ":2:arm.interface: error: unknown value 'torque': there is: effort, ",
        "[wheel]\nspeed = 3.0\n": ":1: error: unknown key 'wheel': did you mean 'wheels'?",
        "[base]\ndelay = 30\n": ":2:base.delay: error: 30 s: give seconds from 0 to 1",
        "jitter = 20\n": ":1:jitter: error: 20 s: give seconds from 0 to 1",
        "filter = 0\n": ":1:filter: error: 0 rad/s: use a number > 0",
        "joints.a.rate = 'x'\n": ":1:joints.a.rate: error: 'x' is a text: give a number",
    }.items():
        beside.write_text(text)
        with pytest.raises(InputError) as error:
            on(urdf, None)
        assert str(error.value).startswith(f"{beside}{line}")
    beside.write_text('profile = "mine.hardware.toml"\n')
    with pytest.raises(ConfigError, match="starts from itself"):
        on(urdf, None)
    for hardware, text in (("feetech", "hardware"), ("no.toml", "no such file")):
        with pytest.raises(InputError, match=text) as error:
            on("platform_arm", hardware)
        assert "site-packages" not in str(error.value) and "experiments/track.toml" not in str(error.value)


def test_an_error_names_the_file_that_has_the_key(tmp_path):
    inner, outer, experiment = (tmp_path / f"{name}.toml" for name in ("inner", "outer", "experiment"))
    outer.write_text("profile = 'inner.toml'\n\n[arm]\nencoder = 0.1\n")
    experiment.write_text(f"experiment = 'track'\nhardware = {{profile = '{inner}', arm.encoder = 0.1}}\n")
    for text, line in {
        "\n[arm]\ntorque = -1\n": "3:arm.torque: error: -1",
        "[arm]\ntorqe = 1\n": "2:arm: error: unknown key 'torqe'",
        "joints.elbow.rate = 5.0\n": "1:joints: error: unknown joint 'elbow'",
        "[joints.arm_1_joint]\ninterface = 'pwm'\n": "1:joints.arm_1_joint: error: 'arm_1_joint' takes a pwm",
    }.items():
        inner.write_text(text)
        asked = [
            ("track", [f"hardware={outer}"]),
            ("track", [f"hardware={inner}", "hardware.rate=90"]),
            (experiment, []),
        ]
        for named, texts in asked:
            with pytest.raises(InputError) as error:
                load_experiment(named, texts)
            assert str(error.value).startswith(f"{inner}:{line}")
    inner.write_text("rate = 100.0\n")
    outer.write_text("profile = 'inner.toml'\nrat = 5.0\n")
    with pytest.raises(ConfigError, match=rf"{re.escape(str(outer))}:2: error: unknown key 'rat'"):
        load_experiment("track", [f"hardware={outer}"])


@pytest.mark.parametrize("given", ["5", "[1]", "true", "{profile='unknown', sources=5}"])
def test_what_is_no_table_is_refused(given):
    with pytest.raises(ConfigError, match=r"hardware.*: error: (no hardware|5 is a whole number)"):
        load_experiment("track", [f"hardware={given}"])


def test_a_table_within_an_experiment_names_its_own_keys():
    with pytest.raises(ConfigError, match=r"hardware\.arm\.torque: error: 0"):
        load_experiment("track", ['hardware={profile="unknown", arm={torque=0}}'])


@needs_data
@pytest.mark.parametrize(
    ("robot", "hardware", "text"),
    [
        ("z1", "feetech-sts3215", "too weak for z1"),
        ("platform_arm", "feetech-sts3215", "too slow or too soft for"),
        ("kinova", '{profile="unknown", arm={interface="effort"}}', "too slow or too soft for"),  # its weight falls
    ],
)
def test_hardware_that_cannot_is_refused_and_the_way_out_works(robot, hardware, text):
    with pytest.raises(ConfigError, match=text) as refused:
        on(robot, hardware)
    found = on(robot, re.search(r"--hardware (\S+)", refused.value.fix)[1])
    require_runnable(found, found.load_robot())


@needs_data
@pytest.mark.parametrize("robot", ["so101", "kinova", "ur10"])
def test_the_profile_of_what_is_not_known_carries_arms_as_they_stand(robot):
    """`mmnn inspect` advises it to whoever has a robot that no profile names."""
    found = on(robot, "unknown")
    require_runnable(found, found.load_robot())


@needs_data
def test_a_latency_without_hardware_names_gains_that_hold_when_they_are_followed():
    late = ["armature=[0, 0, 0, 0.239, 0.239, 0.239]", "latency.command=0.03", "controllers=['pd_gravity']"]
    found = on("kinova", None, *late)
    with pytest.raises(ConfigError, match=r"lower the gains of the kinematic layer, --set kinematic\.K=") as refused:
        require_runnable(found, found.load_robot())
    found = on("kinova", None, *late, re.search(r"--set (kinematic.K=\S+),", refused.value.fix)[1])
    require_runnable(found, found.load_robot())


ROD = """<robot name="rod"><link name="stand"/><link name="rod"><inertial><origin xyz="0.5 0 0"/><mass value="1"/>
<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="turn" type="continuous"><parent link="stand"/><child link="rod"/><axis xyz="0 1 0"/>
<limit effort="4" velocity="5"/></joint></robot>"""


def test_a_joint_without_limits_that_cannot_hold_its_load_swings_where_it_can(tmp_path):
    file = tmp_path / "rod.urdf"
    file.write_text(ROD)  # level it weighs 4.9 N m
    experiment = load_experiment("track", [f'robot="{file}"', *ONE])
    robot = experiment.load_robot()
    motion = experiment.trajectory_of(robot)
    assert MotorLoad(robot).along(motion, 10.0)[0].max() < 0.95
    level = Setpoint.side_by_side(motion.table(np.zeros(1), robot.dimensions), robot.dimensions).q[0, 0]
    assert abs(math.cos(level)) < 0.8


# -- robots on hardware ------------------------------------------------------------------------------------------------

PAIRS = [
    ("so100", "feetech-sts3215"), ("two_dofs", "dynamixel-xm430"), ("panda", "unknown"), ("panda", "franka"),
    ("tricycle_arm", "unknown"), ("casters_arm", "turtlebot3"), ("platform_arm", "tiago"),
    ("ur3", "ur-e"), ("tracked_arm", "kinova-gen3"), ("double_pendulum", "lekiwi"), ("finger_edu", "turtlebot3"),
]  # fmt: skip


@needs_data
@pytest.mark.parametrize(("robot", "hardware"), PAIRS)
def test_a_robot_on_hardware_may_run(robot, hardware):
    """All of `mmnn list` on all profiles: `python -m research.studies.hardware`."""
    found = on(robot, hardware)
    require_runnable(found, found.load_robot())
    assert next(lines(found.hardware)).startswith("hardware: ")


@needs_data
@pytest.mark.compiled
def test_an_arm_of_hobby_servos_errs_as_these_do_and_a_stepper_has_the_same_settings():
    found = on("so101", "feetech-sts3215", "time.duration=3", "controllers=['pd']")
    robot = found.load_robot()
    run = run_experiment(found, "track").recordings["pd"]
    errors = np.abs(run["q"] - run["q_ref"])
    assert run.outcome.status == "completed" and 1e-3 < errors.max() < math.radians(5.0)
    assert np.abs(run["applied"]).max() <= 1.91
    # what it sags by at first is what a stiffness of 17.8 N m/rad gives way to the weight
    weight = np.abs(robot.gravity(run["q"][0])).max()
    assert errors[:25].max() == pytest.approx(weight / 17.8, rel=0.5)
    loop = found.loop(robot, "computed_torque")
    with Stepper.of(loop, safety=Safety(torque="urdf")) as stepper:
        assert stepper.period == 0.02 and stepper.setup.servo == found.servo and stepper.latency == 0.01
        assert stepper.setup.interfaces == found.interfaces and set(stepper.kinds) == {"position"}


@needs_data
def test_ros_2_takes_it_by_a_parameter():
    joints = ["shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll"]
    given = {"robot": "so101", "hardware": "feetech-sts3215", "rate": 50.0, "controller": "pd"}
    given |= {"commands.arm.joints": joints, "commands.arm.interface": "position"}
    experiment, robot = asked(settings_of(given))
    assert experiment.latency.command == 0.01 and experiment.servo.stiffness == 17.8
    assert interfaces(robot, settings_of(given)) == dict(experiment.interfaces)
