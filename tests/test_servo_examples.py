"""examples/lekiwi.py and turtlebot3.py against buses that speak as theirs do: units, ticks, packets, at 30 Hz."""

from __future__ import annotations

import importlib.util
import math
from pathlib import Path

import numpy as np
import pytest
from closed_form import inertial, joint
from robots import place

from mmnn_pin import load
from mmnn_pin.reference.wishes import BaseVelocity, JointGoal

EXAMPLES = Path(__file__).parents[1] / "examples"


def example(name):
    spec = importlib.util.spec_from_file_location(f"example_{name}", EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def wishes(velocity, goal):
    """A velocity of the base at every sample, a goal of the arm at the first."""
    return lambda t: BaseVelocity(velocity) if t > 0.02 else (BaseVelocity(velocity), JointGoal(goal))


LIMIT = '<limit lower="-3" upper="3" effort="3" velocity="4"/>'


def arm(joints):
    """Links of a hobby arm, all about y but for the first."""
    text = ""
    for i in range(joints):
        parent, at = (f"link_{i - 1}", (0.0, 0.0, 0.1)) if i else ("base", (0.0, 0.0, 0.1))
        text += f'<link name="link_{i}">{inertial(0.15, (2e-4, 2e-4, 1e-4), place((0.0, 0.0, 0.05)))}</link>'
        text += joint(f"joint_{i}", parent, f"link_{i}", place(at), "0 1 0" if i else "0 0 1", LIMIT, "revolute")
    return text


def loaded(folder, text):
    """A robot from a file, as a user has it."""
    (folder / "robot.urdf").write_text(text)
    return load(folder / "robot.urdf")


def kiwi(folder):
    """Three omni wheels on crossed axles, and five joints."""
    text = f'<link name="base">{inertial(2.0, (0.02, 0.02, 0.03), place((0, 0, 0.05)))}</link>'
    for name, angle in (("left", 2.6), ("back", 4.7), ("right", 0.52)):
        at = place((0.12 * math.cos(angle), 0.12 * math.sin(angle), 0.05), (0.0, math.pi / 2, angle))
        shape = '<collision><geometry><cylinder radius="0.05" length="0.02"/></geometry></collision>'
        text += f'<link name="{name}">{inertial(0.1, (1e-4, 1e-4, 1e-4))}{shape}</link>'
        text += joint(f"base_{name}_wheel", "base", name, at, "0 0 1", '<limit effort="3" velocity="6"/>')
    return loaded(folder, f'<robot name="kiwi">{text}{arm(5)}</robot>')


def burger(folder):
    """Two wheels, and four joints."""
    text = f'<link name="base">{inertial(1.0, (0.01, 0.01, 0.01), place((0, 0, 0.05)))}</link>'
    for side, y in (("left", 0.08), ("right", -0.08)):
        shape = f'<collision><origin rpy="{np.pi / 2} 0 0"/><geometry><cylinder radius="0.033" length="0.02"/>'
        text += f'<link name="{side}">{inertial(0.05, (1e-5, 2e-5, 1e-5))}{shape}</geometry></collision></link>'
        text += joint(
            f"wheel_{side}_joint", "base", side, place((0, y, 0.033)), "0 1 0", '<limit effort="1" velocity="6"/>'
        )
    return loaded(folder, f'<robot name="burger">{text}{arm(4)}</robot>')


class Clock:
    """Time that passes when one sleeps, and a little at every look, as a bus takes it."""

    def __init__(self):
        self.now, self.each = 0.0, []

    def __call__(self):
        return self.now

    def sleep(self, seconds):
        self.now += seconds
        for act in self.each:
            act(seconds)


class Servo:
    """One on the bus: ticks of 12 bits; it follows its goal with a lag of 50 ms."""

    def __init__(self):
        self.angle, self.rate, self.goal, self.asked, self.wheel = 0.0, 0.0, 0.0, 0.0, False

    def move(self, dt):
        share = 1.0 - math.exp(-dt / 0.05)
        before = self.angle
        if self.wheel:
            self.rate += share * (self.asked - self.rate)
            self.angle += dt * self.rate
        else:
            self.angle += share * (self.goal - self.angle)
            self.rate = (self.angle - before) / dt if dt else 0.0


TICK = math.tau / 4096


class FakeLeKiwi:
    """`get_observation` and `send_action` of LeRobot's LeKiwi: whole ticks in degrees, omni wheels, all keys."""

    MATRIX = np.array([[math.cos(a), math.sin(a), 0.125] for a in np.radians(np.array([240, 0, 120]) - 90)])

    def __init__(self, clock, names):
        self.clock, self.names, self.arm, self.sent = clock, names, {n: Servo() for n in names}, []
        self.wheels = np.zeros(3)
        clock.each.append(lambda dt: [servo.move(dt) for servo in self.arm.values()])

    def get_observation(self):
        self.clock.now += 0.004
        body = np.linalg.inv(self.MATRIX) @ (0.05 * self.wheels)
        said = {f"{n}.pos": math.degrees(TICK * round(s.angle / TICK)) for n, s in self.arm.items()}
        return {**said, "arm_gripper.pos": 12.0, "x.vel": body[0], "y.vel": body[1], "theta.vel": math.degrees(body[2])}

    def send_action(self, action):
        assert set(action) == {*(f"{n}.pos" for n in self.names), "arm_gripper.pos", "x.vel", "y.vel", "theta.vel"}
        assert action["arm_gripper.pos"] == 12.0 and all(math.isfinite(v) for v in action.values())
        for name, servo in self.arm.items():
            servo.goal = math.radians(action[f"{name}.pos"])
        body = np.array([action["x.vel"], action["y.vel"], math.radians(action["theta.vel"])])
        self.wheels = np.round(self.MATRIX @ body / 0.05 / TICK) * TICK
        self.sent.append((self.clock.now, body))
        return action


@pytest.mark.compiled
def test_lekiwi_drives_and_reaches_its_goal_at_30_hz(tmp_path):
    lekiwi, robot, clock = example("lekiwi"), kiwi(tmp_path), Clock()
    assert robot.base.kind == "holonomic" and robot.dimensions.arm == 5
    bus, goal = FakeLeKiwi(clock, lekiwi.ARM), np.array([0.3, -0.4, 0.5, 0.2, -0.3])
    run = lekiwi.run(robot, bus, 4.0, wishes((0.1, 0.05, 0.2), goal), clock=clock, sleep=clock.sleep)
    assert run.outcome.status == "completed", run.outcome
    np.testing.assert_allclose([bus.arm[n].angle for n in lekiwi.ARM], goal, atol=0.02)
    np.testing.assert_allclose(bus.sent[-1][1], (0.1, 0.05, 0.2), atol=0.02)
    assert np.median(np.diff([t for t, _ in bus.sent])) == pytest.approx(1 / 30, rel=1e-6)
    assert abs(run["e"][-1]).max() < 0.02


class FakePacket:
    """Single writes of protocol 2.0; a servo takes a mode only while its torque is off."""

    def __init__(self, servos):
        self.servos, self.torque = servos, dict.fromkeys(servos, 1)

    def write1ByteTxRx(self, port, i, address, value):
        if address == 64:
            self.torque[i] = value
        elif address == 11:
            assert self.torque[i] == 0, "the mode of a servo with torque"
            self.servos[i].wheel = value == 1


class Group:
    """What sync reads and writes share: ids, an address, a length."""

    def __init__(self, port, packet, address, length):
        self.bus, self.address, self.length, self.kept = packet.servos, address, length, {}


class FakeRead(Group):
    """A sync read: four bytes of velocity, four of position; now and then a packet is broken."""

    count = 0

    def addParam(self, i):
        assert i in self.bus
        self.kept[i] = (0, 0)

    def txRxPacket(self):
        self.count += 1
        if self.count % 10 == 0:
            return -3001
        for i in self.kept:
            servo = self.bus[i]
            rate = round(servo.rate / (0.229 * math.tau / 60.0))
            self.kept[i] = rate % (1 << 32), (2048 + round(servo.angle / TICK)) % (1 << 32)
        return 0

    def getData(self, i, address, length):
        assert length == 4 and address in (128, 132)
        return self.kept[i][address == 132]


class FakeWrite(Group):
    """A sync write of four bytes, little end first."""

    def addParam(self, i, data):
        assert len(data) == self.length and all(0 <= byte < 256 for byte in data) and i not in self.kept
        self.kept[i] = int.from_bytes(bytes(data), "little", signed=True)

    def txPacket(self):
        for i, value in self.kept.items():
            servo = self.bus[i]
            if self.address == 104:
                assert servo.wheel
                servo.asked = value * 0.229 * math.tau / 60.0
            else:
                assert not servo.wheel and 0 <= value < 4096
                servo.goal = (value - 2048) * TICK

    def clearParam(self):
        self.kept = {}


@pytest.mark.compiled
def test_turtlebot_drives_and_reaches_its_goal_though_packets_break(tmp_path):
    turtlebot, robot, clock = example("turtlebot3"), burger(tmp_path), Clock()
    servos = {i: Servo() for i in (*turtlebot.WHEELS, *turtlebot.ARM)}
    clock.each.append(lambda dt: [servo.move(dt) for servo in servos.values()])
    bus, goal = (None, FakePacket(servos), FakeRead, FakeWrite), np.array([0.3, -0.4, 0.5, 0.2])
    run = turtlebot.run(robot, bus, 4.0, wishes((0.1, 0.5), goal), clock=clock, sleep=clock.sleep)
    assert run.outcome.status == "completed", run.outcome
    np.testing.assert_allclose([servos[i].angle for i in turtlebot.ARM], goal, atol=0.02)
    speeds = [servos[i].rate * 0.033 for i in turtlebot.WHEELS]
    assert np.mean(speeds) == pytest.approx(0.1, abs=0.01)
    assert (speeds[1] - speeds[0]) / 0.16 == pytest.approx(0.5, abs=0.05)
    assert run["pose"][-1, 2] == pytest.approx(2.0, abs=0.3)
