"""The node: a stepper at a fixed rate between what the graph publishes and what it subscribes to.

A sample: read, step, send; then record, diagnose, and say in one line what is wrong. The stepper's own timeouts answer
when measurements or setpoints stay away. Ctrl-C is an emergency stop: the robot brakes and holds, then the node leaves.
"""

from __future__ import annotations

import gc
import math
import signal
import sys
import time as clock
from collections.abc import Callable
from typing import Any

import numpy as np

from ...errors import ConfigError, InputError
from ...loop.stepper import SLOW, Stepper
from ...recording.recording import Recording, Status
from ...reference.wishes import Motion, Wish
from . import messages as msg
from .action import encoded, typename
from .asking import Asking
from .link import Inlet, Link, Outlet, address_of
from .outputs import Commands, diagnostics
from .planned import Arm
from .sensing import Clock, Sensing, Tree
from .services import Services
from .settings import Node, Switches, Topic

STOPS = (signal.SIGINT, signal.SIGTERM)
WATCH = 0.2  # time between two looks at what is wrong [s]
SWITCH = 2e-4  # how long another thread may hold the interpreter [s]
STOP, RESET = range(2)  # the services
LATCHED = Topic("/tf_static", "reliable", 100, 1e5, 100)
SIMULATED = Topic("/clock", "best_effort", 4, 10.0, 1)


class Pace:
    """Ticks of a fixed rate; those that have passed already are skipped and counted.

    Args:
        period: Between two ticks [s].

    Attributes:
        late: Start of every cycle after its tick [s], of the first `most` of them.
        count: Cycles so far.
        skipped: Ticks that passed while a cycle took too long.
    """

    def __init__(self, period: float, most: int = 1_000_000) -> None:
        self.period, self.late, self.count, self.skipped, self.next = period, np.full(most, np.nan), 0, 0, 0
        self.start = clock.monotonic()

    def wait(self) -> float:
        """Sleep until the next tick to come, and its time [s]."""
        passed = math.floor((clock.monotonic() - self.start) / self.period)
        if passed > self.next:
            self.skipped += passed - self.next
            self.next = passed
        tick = self.next * self.period
        clock.sleep(max(0.0, self.start + tick - clock.monotonic()))
        if self.count < len(self.late):
            self.late[self.count] = clock.monotonic() - self.start - tick
        self.count, self.next = self.count + 1, self.next + 1
        return tick


class Bridge:
    """One robot's stepper in a graph.

    Args:
        stepper: Made for the robot, with the interfaces of `outputs.interfaces`.
        settings: Topics and all that.
        say: Told one line at a time.

    Raises:
        InputError: Settings that do not fit the robot, no way into the network.
    """

    def __init__(self, stepper: Stepper, settings: Node, say: Callable[[str], None]) -> None:
        self.stepper, self.settings, self.said, self.problem = stepper, settings, say, ""
        robot, link = stepper.robot, Link(settings.network)
        self.link, self.clock, self.tree = link, Clock(settings.clock), Tree()
        self.sensing = Sensing(robot, settings, self.tree)
        self.commands = Commands(link, robot, settings)
        arm = Arm.of(robot, settings.joint_states.names, settings.limits, stepper.period)
        self.asking = Asking(link, arm, settings, self.tree)
        self.joints = Inlet(link, settings.joint_states.topic, msg.JointState, settings.joint_states)
        by_topic = robot.dimensions.base and settings.odometry.pose == "odometry"
        self.base = Inlet(link, settings.odometry.topic, msg.Odometry, settings.odometry) if by_topic else None
        self.frames = [] if settings.tf is None else [
            Inlet(link, settings.tf.topic, msg.TFMessage, settings.tf),
            Inlet(link, LATCHED.topic, msg.TFMessage, LATCHED, latched=True),
        ]  # fmt: skip
        self.ticking = Inlet(link, SIMULATED.topic, msg.Clock, SIMULATED) if settings.clock.source == "sim" else None
        told = settings.diagnostics
        self.health = (
            None if told is None else Outlet(link, told.topic, msg.DiagnosticArray, Topic(told.topic, "reliable"))
        )
        self.needed = [inlet for inlet in (self.ticking, self.joints, self.base) if inlet is not None]
        self.inlets = [*self.needed, *self.frames, *self.asking.inlets]
        self.before = {inlet.name: 0 for inlet in self.inlets}
        self.stopped: list[int] = []
        self.switches = None if settings.switches is None else services_of(link, settings.switches)

    # -- before --------------------------------------------------------------------------------------------------------

    def meet(self, patience: float) -> None:
        """Wait for a whole measurement, and for the controllers that take the commands.

        Raises:
            InputError: They do not come in time [s], with what is missing and what was wrong with what came.
        """
        deadline = clock.monotonic() + patience
        while True:
            self.read()
            lacking = self.missing()
            if not lacking or self.stopped:
                return
            if clock.monotonic() > deadline:
                n = self.settings.network
                why = f"domain {n.domain}, interface {n.interface}, peers {', '.join(n.peers)}, {patience:g} s"
                raise InputError(lacking, why=why, fix="see `mmnn docs how-to/ros2`, 'When nothing comes'")
            clock.sleep(0.005)

    def missing(self) -> str:
        """What has to come before the robot may be moved; empty for nothing."""
        for inlet in self.needed:
            if inlet.received == 0 or inlet.why:
                if inlet.clashes and not inlet.received:
                    return f"{inlet.name}: its publisher offers best_effort, and reliable is asked for: set reliability"
                if not inlet.received:
                    return f"{inlet.name}: {'nothing comes' if inlet.publishers else 'no publisher'}"
                if self.sensing.when == -math.inf:
                    return f"{inlet.name}: {inlet.why}"
        if self.sensing.when == -math.inf:
            return f"no measurement of {self.sensing.lacking(math.inf)}"
        unheard = self.commands.unheard
        clash = f"{self.commands.clashes[0]}: its reader asks for reliable" if self.commands.clashes else ""
        return clash or (f"nobody reads {', '.join(unheard)}: load the robot's controllers" if unheard else "")

    # -- one sample ----------------------------------------------------------------------------------------------------

    def read(self) -> float:
        """Take what came; the steady time [s]."""
        steady = clock.monotonic()
        if self.ticking is not None:
            for tick in self.ticking.take(steady):
                self.clock.tick(tick)
        for inlet in self.frames:
            for message in inlet.take(steady):
                self._noted(inlet, self.tree.take(message, self.clock.now))
        if self.base is not None:
            self._measured(self.base, self.sensing.take_base, steady)
        self._measured(self.joints, self.sensing.take_joints, steady)
        return steady

    def _measured(self, inlet: Inlet, take: Callable[[Any, float], str], steady: float) -> None:
        """Read the newest message of a topic, if its stamp can be."""
        if (message := inlet.newest(steady)) is not None:
            when = self.clock.measured(message.header.stamp, inlet.silence)
            self._noted(inlet, when if isinstance(when, str) else take(message, when))

    def _noted(self, inlet: Inlet, why: str) -> None:
        if why:
            inlet.refuse(why)

    def sample(self, time: float, more: tuple[Wish, ...] = ()) -> None:
        """Read, step, send."""
        steady = self.read()
        d, follower = self.stepper.robot.dimensions, self.stepper.follower
        reference = follower.now[follower.q :].reshape(3, d.arm)
        arm = np.array([self.sensing.q[: d.arm], self.sensing.qdot[: d.arm]])
        base = follower.now[: d.pose + d.base]
        asked = self.asking.poll(self.clock, steady, reference, base, arm, self.stepper.tripped)
        measurement = self.sensing.measurement()
        measured = min(self.sensing.when, time) if measurement is not None else None
        try:
            command = self.stepper.step(time, measurement, asked + more or None, measured=measured)
        except ConfigError as error:  # the reference has moved on since it was planned: what does not fit is left out
            if not asked:
                raise
            self.asking.give_way(f"{error.what}: {error.why}")
            self._say_once(f"not followed: {error.what}: {error.why}")
            command = self.stepper.step(time, measurement, None, measured=measured)
        self.commands.send(command, self.clock.stamp)

    def _switched(self, time: float) -> None:
        """Stop or reset, where a service asks for it."""
        for caller, _ in [] if self.switches is None else self.switches.take():
            done, why = True, "stopped by its service" if caller.service == STOP else ""
            if caller.service == STOP:
                self.stepper.stop(why)
            else:
                try:
                    self.stepper.reset()
                    self.clock.resume(time)
                    why = "it goes on from where it stands"
                except ConfigError as error:
                    done, why = False, ": ".join(filter(None, (error.what, error.why, error.fix)))
            self.tell(f"{'stop' if caller.service == STOP else 'reset'}: {why}")
            assert self.switches is not None
            self.switches.reply(caller, encoded(msg.TriggerResponse(done, why)))

    # -- the run -------------------------------------------------------------------------------------------------------

    def run(self, patience: float, seconds: float = math.inf, motion: Motion | None = None) -> Recording:
        """Control until the end, a trip or Ctrl-C; its recording.

        Args:
            patience: How long to wait for the robot [s].
            seconds: How long to control it.
            motion: To follow from the start.

        Raises:
            InputError: The robot is not there.
        """
        before = [signal.signal(number, lambda came, _: self.stopped.append(came)) for number in STOPS]
        switch = sys.getswitchinterval()
        sys.setswitchinterval(SWITCH)
        try:
            self.asking.rehearse()
            self.meet(patience)
            gc.collect()
            gc.freeze()  # what is there is no garbage: a collection looks only at what comes
            try:
                status, message = self._drive(seconds, motion)
            finally:  # also where the recording cannot be written any more
                self._leave()
        finally:
            sys.setswitchinterval(switch)
            for number, handler in zip(STOPS, before, strict=True):
                signal.signal(number, handler)
        dropped = [text for inlet in self.inlets for text in inlet.counted()]
        skipped = [f"{self.pace.skipped} cycles skipped by overruns"] if self.pace.skipped else []
        told = "; ".join(text for text in (message, *dropped, *skipped) if text)
        late = self.pace.late[: min(self.pace.count, len(self.pace.late))]
        return self.stepper.finish(status, told, {"late": late})

    def _drive(self, seconds: float, motion: Motion | None) -> tuple[Status, str]:
        before = self.clock.now
        self.clock.start()
        self.sensing.shift(before)
        self.pace, watched, reported = Pace(self.stepper.period), 0.0, -math.inf
        told, asked = self.settings.diagnostics, () if motion is None else (motion,)
        while not self.stepper.is_over or (self.switches is not None and not self.stopped):
            time = self._next(self.pace)
            self.sample(time, asked)
            asked = ()
            self._switched(time)
            self.stepper.record()
            if self.health is not None and told is not None and time - reported >= 1.0 / told.rate:
                reported = time
                self.health.send(diagnostics(self.stepper, self.clock.stamp, self.problem, self._counts()))
            if time - watched >= WATCH:
                watched = time
                self._watch(time)
            if time >= seconds:
                return "completed", ""
            if len(self.stopped) > 1:
                return "interrupted", "left at once"
        if self.stopped:
            return "interrupted", f"stopped by {signal.Signals(self.stopped[0]).name}"
        return "completed", self.problem

    def _next(self, pace: Pace) -> float:
        """Wait for the next sample, by the steady clock or the simulator's, and its time [s]."""
        if self.ticking is None:
            return pace.wait()
        pace.count += 1
        while not (self.clock.jumped or self.stopped):
            for tick in self.ticking.take(clock.monotonic()):
                self.clock.tick(tick)
            if self.clock.now >= self.stepper.time + self.stepper.period - 1e-9:
                return self.clock.now
            clock.sleep(0.0002)
        clock.sleep(self.stepper.period)  # a stop does not wait for the simulator
        return max(self.stepper.time, 0.0) + self.stepper.period

    def _leave(self) -> None:
        """Efforts fade, velocities end."""
        if self.stepper.command is None:
            return
        steps = max(1, round(0.25 / self.stepper.period))
        command = self.stepper.command
        last = type(command)(*(array.copy() for array in command))
        for k in range(steps):
            self.commands.end(last, 1.0 - (k + 1) / steps, self.clock.stamp)
            clock.sleep(self.stepper.period)

    # -- what is wrong -------------------------------------------------------------------------------------------------

    def tell(self, text: str) -> None:
        """Say a line with the time."""
        self.said(f"t = {max(self.stepper.time, 0.0):.2f} s: {text}")

    def _watch(self, time: float) -> None:
        """Stop where a clock jumped or Ctrl-C came; say what is new."""
        if self.clock.jumped and not self.stepper.tripped:
            self.stepper.stop(self.clock.jumped)
            self._say_once(self.clock.jumped)
        if self.stopped and not self.stepper.tripped:
            self.stepper.stop(f"stopped by {signal.Signals(self.stopped[0]).name}")
        problems = []
        for inlet in self.inlets:
            if (dropped := inlet.dropped) > self.before[inlet.name]:
                problems.append(f"{inlet.name}: {dropped - self.before[inlet.name]} dropped: {inlet.why}")
                self.before[inlet.name] = dropped
        if lacking := self.sensing.lacking(self.clock.now):
            silent = [inlet.name for inlet in self.needed if not inlet.publishers]
            gone = f", no publisher of {', '.join(silent)}" if silent else ""
            problems.append(f"nothing fresh of {lacking}{gone}")
        if unheard := self.commands.unheard:
            problems.append(f"nobody reads {', '.join(unheard)}")
        if self.stepper.is_late:
            problems.append(f"cycles are more than {SLOW:g} times the period apart: ask for a lower rate")
        if problems and not self.stepper.tripped:
            self._say_once("; ".join(problems))
        elif not problems and not self.stepper.tripped:
            self.problem = ""

    def _say_once(self, text: str) -> None:
        """Say what is wrong when it begins, and when it changes in kind."""
        kind = "".join(c for c in text if not c.isdigit())
        if kind != "".join(c for c in self.problem if not c.isdigit()):
            self.tell(text)
        self.problem = text

    def _counts(self) -> dict[str, float]:
        found: dict[str, float] = {}
        for inlet in self.inlets:
            for name in ("malformed", "foreign", "surplus", "refused"):
                found[f"{inlet.name} {name}"] = float(getattr(inlet, name))
        return found | {"skipped": float(self.pace.skipped)}

    def __enter__(self) -> Bridge:
        return self

    def __exit__(self, *_: Any) -> None:
        self.asking.close()
        if self.switches is not None:
            self.switches.close()
        self.link.close()


def services_of(link: Link, settings: Switches) -> Services:
    """Services that stop and reset, in this order."""
    kinds = typename(msg.TriggerRequest), typename(msg.TriggerResponse)
    names = [(link.resolved(name), *kinds) for name in (settings.stop, settings.reset)]
    return Services(link.network, [address_of(peer) for peer in link.network.peers], names)
