"""The plant process: a simulated robot in real time that sends measurements and takes motor torques.

It knows the truth and records it. Without commands for half a second its motors' torques go to zero.
"""

import json
import time as clock
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import task
from faults import FAULTS, Faults
from link import BYE, COMMAND, HELLO, MEASUREMENT, Channel

from mmnn_pin import PD, TorqueController
from mmnn_pin.errors import InputError
from mmnn_pin.recording.recorder import Recorder
from mmnn_pin.signals import Layout

TIMEOUT, RAMP, LINGER = 0.5, 0.25, 1.0  # [s]
LONGER = 5.0  # it outlives the controller's run by at most this [s]


class Motors(TorqueController):
    """The torque is what came over the link; a loop that asks for it is held back to real time."""

    name = "remote"

    def __init__(self, robot, channel, fault):
        self.E, self.channel, self.fault = robot.E, channel, fault
        self.command, self.refused, self.start, self.ramped = np.zeros(robot.dimensions.motors), 0, 0.0, None
        self.dismissed = False  # by a controller that said so
        self.heard, self.silent = 0.0, 0.0  # when the last command came, since when none has [s]

    def wait(self, patience, measured):
        """Tell what is measured until the controller sends its first command."""
        deadline = clock.monotonic() + patience
        while (kind := self.channel.receive()) != COMMAND:
            if clock.monotonic() > deadline:
                raise InputError("no controller", why=f"no command within {patience:g} s", fix="start control.py")
            if kind == HELLO:
                self.channel.send(MEASUREMENT, measured)
            clock.sleep(0.001)
        self.take(kind, 0.0)
        self.start = clock.monotonic()

    def step(self, time, reference, measurement, command, state):
        """Torque of one sample."""
        clock.sleep(max(0.0, self.start + time - clock.monotonic()))
        m = measurement
        packet = self.channel.pack(MEASUREMENT, np.concatenate((m.pose, m.velocity, m.q, m.qdot)))
        for one in self.fault.packets(time, packet):
            self.channel.put(one)
        self.take(self.channel.receive(), time)
        self.silent = time - self.heard - TIMEOUT
        if self.silent > 0 and self.ramped is None:
            self.ramped = time
        return self.E @ self.command * (1.0 if self.silent <= 0 else max(0.0, 1 - self.silent / RAMP))

    def take(self, kind, time):
        """A packet that came, if one did."""
        if kind == BYE:
            self.heard, self.dismissed = min(self.heard, time - TIMEOUT), True
        elif kind == COMMAND and not np.isfinite(self.channel.values).all():
            self.refused += 1
        elif kind == COMMAND:
            self.command[:], self.heard, self.ramped = self.channel.values, time, None

    def is_over(self):
        """Whether the motors have been without a torque for long enough."""
        return self.silent > RAMP + LINGER


def main():
    """Run until the controller has gone."""
    options = task.parser(__doc__)
    options.add_argument("--fault", nargs="+", default=(), choices=FAULTS, help="of the sensor, from the middle on")
    options.add_argument("--wait", type=float, default=300.0, help="how long to wait for the controller [s]")
    options = options.parse_args()
    experiment, robot = task.task(options)
    layout = Layout.of(robot.dimensions)
    size = layout.pose + layout.base + 2 * layout.arm
    channel = Channel(size, layout.motors, options.port)
    motors = Motors(robot, channel, Faults(options.fault, options.seconds / 2))
    period = experiment.time.control_period
    samples = experiment.time.samples + round(LONGER / period)
    timing = msgspec.structs.replace(experiment.time, duration=samples * period)
    loop = replace(experiment.loop(robot, motors), safety=None, timing=timing)
    once = msgspec.structs.replace(timing, duration=period)  # compiles all that a sample calls
    replace(loop, controller=PD(), timing=once, check_gains=False, engine="ordinary").run()
    engine = loop.engine_at()
    path = Path(options.out) / "plant.h5"
    facts = loop.facts() | {"loop": "plant", "config": experiment.to_json()}
    with Recorder(loop.layout, facts, path, options.force) as recorder:
        print(f"port {channel.port}", flush=True)
        position, nu = loop.start.state(robot, loop.table()[0])
        n = layout.base
        motors.wait(options.wait, np.concatenate((position[: layout.pose], nu[:n], position[robot.arm_index], nu[n:])))
        outcome = loop.stream(engine, recorder, cancelled=motors.is_over)
        run = recorder.finish(outcome, loop.final(engine))
    told = {name: getattr(channel, name) for name in ("received", "out_of_order", "malformed")}
    told |= {name: getattr(motors, name) for name in ("refused", "ramped", "dismissed")}
    told |= {"motor_torque": run["motor_torque"][-1].tolist()}
    print(json.dumps(told | {"outcome": outcome.message, "recording": str(path)}), flush=True)
    return 0


if __name__ == "__main__":
    task.call(main)
