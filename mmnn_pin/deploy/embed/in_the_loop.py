"""The exported controller in a closed loop: as a process on this machine, or on an emulated board, in lockstep.

`Linked` is a stepper whose samples are computed elsewhere: it sends a measurement and a setpoint, and fills its own
memory with all that the controller remembers. So what reads that memory, the recording among it, need not know.
"""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, NoReturn, Self

import numpy as np

from ...elementary.matrices import product
from ...errors import ConfigError, MmnnError
from ...loop.loop import Loop
from ...loop.servo import Command
from ...loop.stepper import Stepper
from ...plant.ideal import IdealPlant
from ...recording.recording import Recording
from ...reference.follower import joint_sample
from ...reference.limits import Limits
from ...reference.wishes import BaseVelocity, JointSample, Stand, Wish
from ...signals import Array, Measurement, Setpoint
from .board import (
    BAD_SETPOINT,
    BAD_TIME,
    FOLLOW_BOTH,
    FOLLOW_JOINTS,
    FOLLOW_SAMPLE,
    FOLLOW_VELOCITY,
    GO_ON,
    STAND,
    Fresh,
)
from .files import Export, translated
from .golden import PAUSE, RESET, RESUME, STOP

SAMPLE = 0.0  # kinds of frames: else an action of `golden`
HOST, QEMU = "host", "qemu"
BOARD = (
    "qemu-system-arm -M mps2-an500 -nographic -monitor none -serial none -semihosting-config enable=on,target=native"
)
M7 = "-mcpu=cortex-m7 -mthumb -mfpu=fpv5-d16 -mfloat-abi=hard --specs=rdimon.specs -nostartfiles"
NEEDED = {HOST: (), QEMU: ("arm-none-eabi-gcc", "qemu-system-arm")}


@dataclass(frozen=True)
class RunComparison:
    """Two runs of the same loop, by Python and by an exported controller."""

    where: str  # `HOST` or `QEMU`
    samples: int  # of the run
    status: str  # how it ended
    differences: list[str]  # signals, weights and states that are not equal bit for bit


class Linked(Fresh):
    """A stepper whose samples are computed by an exported controller; arguments as of `Stepper`.

    Attributes:
        process: Where they are computed.
    """

    process: subprocess.Popen[bytes]
    export: Export

    def link(self, export: Export, command: Sequence[str]) -> Self:
        """Start the controller's process.

        Args:
            export: The controller, translated from this stepper.
            command: What starts it.
        """
        self.export = export
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        return self

    def step(
        self,
        time: float,
        measurement: Measurement | None = None,
        setpoint: Wish | tuple[Wish, ...] | None = None,
        *,
        measured: float | None = None,
    ) -> Command:
        """One sample, computed by the process; as `Stepper.step`.

        Raises:
            ConfigError: Also for motions and joint goals, which are planned in Python.
            MmnnError: The process has ended.
        """
        kind, asked = self._wish(setpoint)
        received = np.zeros(self.received.size)
        if measurement is not None:
            parts = [getattr(measurement, part.name) for part in fields(Measurement)]
            received[:] = np.concatenate([np.ravel(part) for part in parts])
        head = (SAMPLE, time, float(measurement is not None), time if measured is None else measured, float(kind))
        result = self._exchange(np.concatenate((head, received, asked)))
        if result == BAD_TIME:
            raise ConfigError(f"a control sample at t = {time:g} s", fix="go forward in time", key="time")
        if result == BAD_SETPOINT:
            raise ConfigError("a setpoint that is not finite", fix="give finite numbers", key="setpoint")
        self.hardware.way.totals.command[:] = self.motor_torque
        self.hardware.way.sent[:] = self.row[self.setup.layout.where("torque")]
        self._command()
        self.time, self.k = float(time), self.k + 1
        return self.command

    def stop(self, why: str = "") -> None:
        """An emergency stop; as `Stepper.stop`."""
        super().stop(why)
        self._act(STOP)

    def reset(self) -> None:
        """Go on after a trip; as `Stepper.reset`."""
        super().reset()
        self._act(RESET)

    def pause(self) -> None:
        """Brake and hold; as `Stepper.pause`."""
        super().pause()
        self._act(PAUSE)

    def resume(self) -> None:
        """Follow setpoints again; as `Stepper.resume`."""
        super().resume()
        self._act(RESUME)

    def change(self, *given: Any, **more: Any) -> NoReturn:
        """Refused: the exported controller is asked by its own functions (`ConfigError`)."""
        why, fix = "it runs elsewhere", "call mmnn_set_gains there, or export it anew with --set"
        raise ConfigError("other gains for an exported controller", why=why, fix=fix, key="gains")

    def __exit__(self, *given: Any) -> None:
        """Close the recording, and end the process."""
        super().__exit__(*given)
        self.process.communicate()

    def _act(self, action: int) -> None:
        """Send an action alone."""
        self._exchange(np.concatenate(([float(action)], np.zeros(self._width() - 1))))

    def _width(self) -> int:
        return 5 + self.received.size + self.follower.guide.wanted.size

    def _wish(self, setpoint: Wish | tuple[Wish, ...] | None) -> tuple[int, Array]:
        """Number and sample of a setpoint."""
        asked = np.zeros(self.follower.guide.wanted.size)
        if setpoint is None:
            return GO_ON, asked
        if isinstance(setpoint, Setpoint):
            asked[:] = np.concatenate([np.ravel(getattr(setpoint, name)) for name in setpoint.__slots__])
            return FOLLOW_SAMPLE, asked
        d, kind = self.robot.dimensions, GO_ON
        for one in setpoint if isinstance(setpoint, tuple) else (setpoint,):
            if isinstance(one, BaseVelocity):
                asked[d.pose : d.pose + d.twist] = one.velocity
                kind = FOLLOW_VELOCITY if kind == GO_ON else FOLLOW_BOTH
            elif isinstance(one, JointSample):
                asked[d.pose + 2 * d.twist :] = joint_sample(one, d.arm)
                kind = FOLLOW_JOINTS if kind == GO_ON else FOLLOW_BOTH
            else:
                kind = GO_ON
                break
        if kind != GO_ON:
            return kind, asked
        if isinstance(setpoint, Stand):
            return STAND, asked
        why, fix = "motions are planned in Python", "hand in their samples as full setpoints"
        raise ConfigError(f"a {type(setpoint).__name__} for an exported controller", why=why, fix=fix, key="setpoint")

    def _exchange(self, frame: Array) -> int:
        """Send a frame, take over what is remembered; the result of the step."""
        members = self.export.remembered
        size = 8 * (2 + sum(member.data.size for member in members))
        assert self.process.stdin is not None and self.process.stdout is not None
        try:
            self.process.stdin.write(np.asarray(frame, "<f8").tobytes())
            self.process.stdin.flush()
        except OSError as error:
            raise MmnnError("the exported controller has ended") from error
        answer = np.frombuffer(self.process.stdout.read(size), "<f8")
        if answer.size * 8 != size:
            raise MmnnError("the exported controller has ended")
        self.follower.losses = int(answer[1])
        at = 2
        for member in members:
            member.live[:] = answer[at : at + member.data.size]
            at += member.data.size
        return int(answer[0])


def require_tools(where: str) -> None:
    """Refuse a place that nothing can be compiled for (`ConfigError`)."""
    for tool in NEEDED[where]:
        if shutil.which(tool) is None:
            fix = "apt-get install gcc-arm-none-eabi libnewlib-arm-none-eabi qemu-system-arm, or use --plant host"
            raise ConfigError(f"no '{tool}'", why="the emulated board needs it", fix=fix, key="plant")


def build(folder: Path, where: str, compiler: Sequence[str], program: Path) -> list[str]:
    """Compile the link of an exported controller; the command that starts it.

    Raises:
        ConfigError: A tool is missing.
        MmnnError: It does not compile.
    """
    require_tools(where)
    ours, program = ["controller.c", "tuning.c", "robot_law.c", "mmnn_math.c", "in_the_loop/link.c"], program.resolve()
    common = ["-std=c99", "-O2", "-ffp-contract=off", "-I.", *ours, "-o", str(program)]
    start = ["qemu_mps2/startup.c", "-T", "qemu_mps2/mps2.ld"]
    command = [*compiler, *common] if where == HOST else ["arm-none-eabi-gcc", *M7.split(), *common, *start]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    if done.returncode:
        raise MmnnError(f"the link does not compile: {' '.join(done.stderr.splitlines()[:2])}")
    return [str(program)] if where == HOST else [*BOARD.split(), "-kernel", str(program)]


def closed(loop: Loop, stepper: Stepper, steps: int) -> Recording:
    """A run of a loop's robot along its trajectory, controlled by a stepper.

    Args:
        loop: Robot, trajectory, start and plant; sensors and motors are perfect.
        stepper: Of this loop.
        steps: Control samples.
    """
    robot, timing, d = loop.robot, loop.timing, loop.robot.dimensions
    table = loop.trajectory.table(np.arange(steps) * timing.control_period, d)
    plant = IdealPlant(robot, timing.plant_step, timing.integrator)
    plant.start(*loop.start.state(robot, table[0]))
    with stepper:
        for k, asked in enumerate(table):
            position, nu = plant.position, plant.nu
            q, shape = position[robot.arm_index], position[robot.shape_index]
            measurement = Measurement(position[: d.pose], nu[: d.base], q, nu[d.base :], shape)
            command = stepper.step(k * timing.control_period, measurement, Setpoint.side_by_side(asked, d))
            stepper.record()
            tau = product(robot.E_at(plant.position), command.motor_effort)
            for _ in range(timing.steps_per_control):
                plant.step(tau)
                plant.refresh()
            if stepper.is_over or not np.isfinite(plant.y).all():
                break
        return stepper.finish()


def compared(
    loop: Loop,
    folder: Path,
    where: str,
    compiler: Sequence[str],
    steps: int,
    path: Path,
    limits: Limits = Limits(),  # noqa: B008 (frozen)
) -> RunComparison:
    """Run a loop with an exported controller and with Python, and compare the recordings.

    Args:
        loop: With a supervisor, as it was exported.
        folder: Of the export.
        where: `HOST`, or `QEMU` for the emulated board.
        compiler: For the former.
        steps: Control samples.
        path: For the recording of the exported controller's run.
        limits: As it was exported with.
    """
    linked = Linked.of(loop, path=path, force=True, limits=limits)
    export = translated(linked, "")
    linked.link(export, build(folder, where, compiler, path.with_suffix(".elf" if where == QEMU else "")))
    ours, theirs = closed(loop, Stepper.of(loop, limits=limits), steps), closed(loop, linked, steps)
    return RunComparison(where, len(theirs["time"]), theirs.outcome.status, differences(ours, theirs))


def differences(a: Recording, b: Recording) -> list[str]:
    """Names of the signals, weights and states of two recordings that are not equal bit for bit."""
    tables = (a.names, a, b), (a.weights, a.weights, b.weights), (a.final, a.final, b.final)
    pairs = ((name, one[name], other[name]) for names, one, other in tables for name in names)
    found = [name for name, *both in pairs if len({np.asarray(values).tobytes() for values in both}) > 1]
    return found + [f"outcome {b.outcome}, not {a.outcome}"] * (a.outcome != b.outcome)
