"""The live view of a stepper: what the page is told, that the loop never waits, that it is this machine alone."""

from __future__ import annotations

import itertools
import json
import os
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request

import numpy as np
import pytest
from browser import browser

from mmnn_pin import PD, Feedback, Measurement, Stepper, StepperSettings, load
from mmnn_pin.errors import ConfigError
from mmnn_pin.lab.show.live import LiveView
from mmnn_pin.lab.show.serving import FIRST, SEQUENCE, SharedFrames, as_json, new_memory
from mmnn_pin.reference.wishes import BaseVelocity
from mmnn_pin.safety import Safety

PERIOD = 0.002


@pytest.fixture(scope="module")
def robot():
    return load("platform_arm")


@pytest.fixture(scope="module")
def stepper(robot):
    with Stepper(robot, PD(Feedback(15.0, 20.0, "inertia")), StepperSettings(safety=Safety(), period=PERIOD)) as made:
        yield made


class Standing:
    """A stepper as the view sees it, at a state that the test says."""

    def __init__(self, stepper, robot):
        d = robot.dimensions
        self.robot, self.time, self.tripped = robot, 0.0, False
        self.measured = Measurement(np.zeros(d.pose), np.zeros(d.base), np.zeros(d.arm), np.zeros(d.arm))
        self.setpoint = Measurement(np.zeros(d.pose), np.zeros(d.base), np.zeros(d.arm), np.zeros(d.arm))


def events(address: str, count: int) -> list[dict]:
    """The next frames of a page."""
    found = []
    with urllib.request.urlopen(address + "live", timeout=20) as source:
        while len(found) < count:
            line = source.readline()
            if line.startswith(b"data: "):
                found.append(json.loads(line[6:]))
    return found


def test_a_page_is_told_what_the_stepper_measures(stepper, robot):
    with LiveView(stepper, port=0) as view:
        assert b"connect-src 'self'" in urllib.request.urlopen(view.url).read()
        pose, q = np.array([0.1, -0.2, 0.3]), np.array([0.4, -0.5])
        for k in range(30):
            stepper.step(k * PERIOD, Measurement(pose, np.zeros(2), q, np.zeros(2)), BaseVelocity((0.0, 0.0)))
            view.show()
        [told] = events(view.url, 1)
        position = np.array(told["position"])
        assert position[:3] == pytest.approx(pose) and position[robot.arm_index] == pytest.approx(q)
        assert np.array(told["reference"])[:3] == pytest.approx(pose, abs=1e-6) and not told["tripped"]
        assert view.frames == 2  # of 60 ms at 20 frames a second


def test_frames_are_decimated_by_the_steppers_time_and_wheels_roll(stepper, robot):
    here = Standing(stepper, robot)
    with LiveView(here, rate=10.0, port=0) as view:
        here.measured.velocity[0] = 0.5
        for k in range(1001):
            here.time = k * PERIOD
            view.show()
        assert view.frames == 20 or view.frames == 21
        [told] = events(view.url, 1)
        rolled = np.array(told["position"])[view.rolling]
        signs = np.array([w.sign / w.radius for w in robot.base.wheels])
        assert rolled == pytest.approx(signs * 0.5 * told["time"], rel=0.02)


def test_wheels_that_steer_are_seen_steering():
    robot = load("car_arm")
    here = Standing(None, robot)
    here.measured = Measurement(
        np.zeros(3), np.array([0.5, 0.0]), np.zeros(4), np.zeros(4), shape=np.array([0.3, 0.25])
    )
    with LiveView(here, port=0) as view:
        view.show()
        [told] = events(view.url, 1)
        assert np.array(told["position"])[robot.shape_index] == pytest.approx([0.3, 0.25])


def test_a_stop_is_told(stepper, robot):
    here = Standing(stepper, robot)
    with LiveView(here, port=0) as view:
        here.time, here.tripped = 1.0, True
        view.show()
        assert events(view.url, 1)[0] | {"position": 0, "reference": 0} == {
            "time": 1.0, "tripped": True, "position": 0, "reference": 0,
        }  # fmt: skip


def test_a_browser_that_does_not_read_costs_the_loop_nothing(stepper, robot):
    here = Standing(stepper, robot)
    with LiveView(here, rate=1e6, port=0) as view:
        port = int(view.url.rsplit(":", 1)[1].strip("/"))
        idle = [socket.create_connection(("127.0.0.1", port)) for _ in range(12)]
        for connection in idle:
            connection.sendall(f"GET /live HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n\r\n".encode())
        begun = time.process_time()
        for k in range(5000):
            here.time = k * PERIOD
            view.show()
        assert time.process_time() - begun < 5 and view.frames == 5000  # 0.1 ms each, however slow the browsers
        for connection in idle:
            connection.close()


def test_it_is_bound_to_the_loopback_and_answers_to_its_name_alone(stepper):
    with LiveView(stepper, port=0) as view:
        port = int(view.url.rsplit(":", 1)[1].strip("/"))
        bound = [line.split()[1] for line in open("/proc/net/tcp").readlines()[1:]]  # noqa: SIM115
        assert f"0100007F:{port:04X}" in bound and f"00000000:{port:04X}" not in bound
        foreign = ({"Host": f"evil.example:{port}"}, {"Origin": "http://evil.example"}, {"Origin": "null"})
        for path, headers in itertools.product(("", "live"), foreign):
            asked = urllib.request.Request(view.url + path, headers=headers)
            with pytest.raises(urllib.error.HTTPError, match="403"):
                urllib.request.urlopen(asked)
        with pytest.raises(urllib.error.HTTPError, match="404"):
            urllib.request.urlopen(view.url + "etc/passwd")


def test_a_reader_never_sees_half_a_frame():
    memory = new_memory(FIRST + 4)
    writer, reader = SharedFrames(memory, FIRST + 4), SharedFrames(memory, FIRST + 4)
    os.close(memory)
    writer.numbers[SEQUENCE] = 2.0
    writer.numbers[FIRST] = float("nan")
    assert json.loads(as_json(reader.read()))["position"] == [0.0, 0.0]
    program = """
import itertools, sys
from mmnn_pin.lab.show.serving import FIRST, SharedFrames
numbers = SharedFrames(int(sys.argv[1]), FIRST + 4).numbers
for k in itertools.count():
    numbers[0] = 2 * k + 1
    for i in range(FIRST, FIRST + 4):
        numbers[i] = k
    numbers[0] = 2 * k + 2
"""
    memory = new_memory(FIRST + 4)
    reader = SharedFrames(memory, FIRST + 4)
    made = subprocess.Popen([sys.executable, "-c", program, str(memory)], pass_fds=(memory,))
    seen: dict[float, list[float]] = {}
    while len(seen) < 200:
        assert made.poll() is None
        frame = reader.read()
        seen[frame[SEQUENCE]] = frame
    made.kill()
    made.wait()
    os.close(memory)
    assert all(len(set(frame[FIRST:])) == 1 for frame in seen.values())


def test_the_server_ends_with_the_process_that_started_it():
    program = (
        "from mmnn_pin import *\nfrom mmnn_pin.safety import Safety\n"
        "from mmnn_pin.lab.show.live import LiveView\nimport time\n"
        "s = Stepper(load('platform_arm'), PD(Feedback(15.0, 20.0, 'inertia')), StepperSettings(safety=Safety()))\n"
        "v = LiveView(s, port=0)\nprint(v.url, v.server.pid, flush=True)\ntime.sleep(600)\n"
    )
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1"}
    parent = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, env=environment, text=True)
    _, pid = parent.stdout.readline().split()
    parent.send_signal(signal.SIGKILL)
    parent.wait()
    for _ in range(100):
        try:
            os.kill(int(pid), 0)
        except ProcessLookupError:
            return
        if open(f"/proc/{pid}/stat").read().split()[2] == "Z":  # noqa: SIM115
            return
        time.sleep(0.1)
    raise AssertionError("the server is left behind")


def test_bad_rates_and_ports_are_refused(stepper):
    with pytest.raises(ConfigError, match="rate"):
        LiveView(stepper, rate=0.0)
    with pytest.raises(ConfigError, match="choose another port"):
        LiveView(stepper, port=65536)


def test_a_browser_shows_the_robot_move(stepper, robot):
    here = Standing(stepper, robot)
    with browser() as opened, LiveView(here, port=0) as view:
        page, problems = opened.new_page(), []
        page.on("console", lambda message: problems.append(message.text) if message.type == "error" else None)
        page.on("pageerror", lambda error: problems.append(str(error)))
        page.goto(view.url)
        page.wait_for_function("window.replay", timeout=60_000)
        for k in range(1, 5):
            here.time, here.measured.pose[0], here.measured.q[0] = float(k), 0.3 * k, 0.1 * k
            view.show()
            page.wait_for_function(f"window.replay.told?.time === {k}", timeout=20_000)
            column = robot.position_names.index(robot.joint_names[0])
            x, q = page.evaluate(f"[window.replay.runs[0].now[0], window.replay.runs[0].now[{column}]]")
            assert (x, q) == pytest.approx((0.3 * k, 0.1 * k), abs=1e-6)
        here.time, here.tripped = 5.0, True
        view.show()
        page.wait_for_function("document.getElementById('event').textContent.includes('stopped')", timeout=20_000)
        assert problems == [] or all("favicon" in text or "404" in text for text in problems), problems
