"""A running stepper, seen in a browser: the replay's page, moved by samples as they come.

    with Stepper(robot, controller) as stepper, LiveView(stepper) as view:     # view.url
        stepper.step(...)
        view.show()

`show` copies one sample of many into shared memory, and a process of its own shows it (`serving`).
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from ...children import environment
from ...elementary.matrices import product
from ...errors import ConfigError
from ...loop.stepper import Stepper
from .replay.page import live_page
from .serving import FIRST, SEQUENCE, TIME, TRIPPED, SharedFrames, new_memory

CHILD = "from mmnn_pin.lab.show.serving import child; child()"
PORT = 8124


class LiveView:
    """A page on this machine that shows what a stepper measures and wants.

    Args:
        stepper: The stepper.
        rate: Frames per second of the stepper's own time [Hz].
        port: Port to listen on, on the loopback alone; when it is busy, the next one that is free. 0 takes any.
        package_dirs: Folders to look for meshes in.

    Attributes:
        url: Where the page is.
        frames: Frames shown.

    Raises:
        ConfigError: A rate that is not positive, or no free port.
    """

    def __init__(
        self, stepper: Stepper, rate: float = 20.0, port: int = PORT, package_dirs: Sequence[str | Path] = ()
    ) -> None:
        if not 0 < rate < np.inf:
            raise ConfigError(f"{rate} is no rate of frames", fix="give one above 0, such as 20", key="rate")
        robot = stepper.robot
        self.stepper, self.robot, self.period, self.due = stepper, robot, 1 / rate, -np.inf
        self.position, self.wanted, self.frames = robot.rest.copy(), robot.rest.copy(), 0
        self.still, self.arm = robot.arm_map()
        self.rolling = [robot.full_velocity_names.index(wheel.joint) for wheel in robot.base.wheels]
        numbers, page = FIRST + 2 * self.position.size, live_page(robot, self.position, package_dirs)
        memory = new_memory(numbers)
        try:
            self.numbers = np.frombuffer(SharedFrames(memory, numbers).memory, dtype=np.float64)
            job = {"file": memory, "numbers": numbers, "rate": rate, "port": port, "bytes": len(page)}
            self.server = subprocess.Popen(
                [sys.executable, "-P", "-c", CHILD], pass_fds=(memory,), env=environment(),
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
            )  # fmt: skip
        finally:
            os.close(memory)
        assert self.server.stdin is not None and self.server.stdout is not None
        try:
            self.server.stdin.write(json.dumps(job).encode() + b"\n" + page)
            self.server.stdin.flush()
        except BrokenPipeError:
            pass  # it says so below
        answer = self.server.stdout.readline()
        if not answer:
            raise ConfigError(f"no page can be served from port {port} on", fix="choose another port", key="port")
        self.url = f"http://127.0.0.1:{int(answer)}/"

    def show(self) -> None:
        """Take the stepper's last sample, where one is due; call it after the command has been sent."""
        stepper = self.stepper
        if stepper.time < self.due:
            return
        measured, asked, robot, pose = stepper.measured, stepper.setpoint, self.robot, self.robot.dimensions.pose
        passed = min(stepper.time - self.due + self.period, 1.0) if self.frames else 0.0
        self.due = stepper.time + self.period
        nu = np.concatenate((measured.velocity, measured.qdot))
        turned = self.position[self.rolling] + passed * product(robot.T_at(self.position)[self.rolling], nu)
        for table, pose_of, q in ((self.position, measured.pose, measured.q), (self.wanted, asked.pose, asked.q)):
            table[:] = self.still + product(self.arm, q)  # mimic joints follow
            table[:pose], table[self.rolling], table[robot.shape_index] = pose_of, turned, measured.shape
        self.frames += 1
        self.numbers[SEQUENCE] = 2 * self.frames - 1  # odd: it is being written
        self.numbers[TIME], self.numbers[TRIPPED] = stepper.time, stepper.tripped
        self.numbers[FIRST:] = np.concatenate((self.position, self.wanted))
        self.numbers[SEQUENCE] = 2 * self.frames

    def close(self) -> None:
        """End the server."""
        assert self.server.stdin is not None and self.server.stdout is not None
        self.server.stdin.close()
        self.server.wait()
        self.server.stdout.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()
