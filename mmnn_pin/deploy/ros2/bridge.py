"""The control loop: a stepper at a fixed rate between what the graph publishes and what it subscribes to.

A sample: read, step, send; then record, diagnose, and say in one line what is wrong. The stepper's own timeouts answer
when measurements or setpoints stay away. It runs outside of any executor; what callbacks ask of it is done between two
samples.
"""

from __future__ import annotations

import gc
import math
import os
import sys
import time as clock
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from queue import Empty, SimpleQueue
from threading import Lock
from typing import Any, NamedTuple, TypeVar

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node as RosNode
from rosgraph_msgs.msg import Clock as ClockMessage
from sensor_msgs.msg import JointState

from ...errors import ConfigError, InputError
from ...kinematic import Kinematic
from ...loop.stepper import SLOW, Stepper
from ...recording.recording import Recording, Status
from ...reference.guide import ARM, BASE, new_guide
from ...reference.wishes import Motion, Wish
from ...signals import Array
from ...torque.controller import CompiledController, TorqueController
from .asking import Asking
from .hand import HandAsking
from .inlets import Inlet, Outlet
from .outputs import Commands, diagnostics, stamp_of, wrench_of
from .planned import PlannedArm, RobotSituation
from .sensing import Clock, Sensing, Tree
from .settings import Node
from .telling import LearnedShare, Telling
from .wiring import odometry_topic

WATCH = 0.2  # time between two looks at what is wrong [s]
SWITCH = 2e-4  # how long another thread may hold the interpreter [s]
COUNTS = ("surplus", "refused")  # of an inlet
SETTLED = 5.0  # time in which nodes have heard of each other [s]
FADE = 0.25  # time in which efforts end [s]
ANSWER = 5.0  # longest wait for the loop's answer [s]
MANY = 1000  # publishers of frames
MOST_LATE = 1_000_000  # cycles whose lateness is kept
T = TypeVar("T")


class GraphRow(NamedTuple):
    """A topic, a service or an action of the node: which way, its name, type and quality of service, what it is for."""

    way: str
    name: str
    type: str
    qos: str
    what: str


class Pace:
    """Ticks of a fixed rate; those that have passed already are skipped and counted.

    Args:
        period: Between two ticks [s].
        begin: Time of the first tick [s].

    Attributes:
        late: Start of every cycle after its tick [s], of the first of them.
        count: Cycles so far.
        skipped: Ticks that passed while a cycle took too long.
    """

    def __init__(self, period: float, begin: float) -> None:
        self.period, self.begin, self.late = period, begin, np.full(MOST_LATE, np.nan)
        self.count = self.skipped = self.next = 0
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
        return self.begin + tick


class Bridge:
    """One robot's stepper in a graph.

    Args:
        node: The node, for its topics.
        stepper: Made for the robot, with the interfaces of `wiring.interfaces`.
        settings: All parameters.
        is_simulated: Whether a simulator tells the time.

    Attributes:
        leave: Why the loop is to stop the robot and end; empty to go on. Another thread may say so.
        hurry: Whether it is to end at once.
        late: Start of every cycle after its tick [s], of each time that it was active.
        skipped: Ticks that passed while a cycle took too long.

    Raises:
        InputError: Settings that do not fit the robot.
    """

    def __init__(self, node: RosNode, stepper: Stepper, settings: Node, is_simulated: bool) -> None:
        self.node, self.stepper, self.settings, self.problem = node, stepper, settings, ""
        robot = stepper.robot
        self.clock, self.tree = Clock(settings.clock, is_simulated), Tree()
        self.sensing = Sensing(robot, settings, self.tree)
        self.commands = Commands(node, robot, settings)
        arm = PlannedArm.of(robot, settings.joint_states.theirs, settings.limits, stepper.period)
        self.asking = Asking(node, arm, settings, self.tree)
        self.hand = HandAsking.of(node, stepper, settings, self.asking.route)
        self._listen()
        self.health = Outlet(node, "/diagnostics", DiagnosticArray, depth=4) if settings.diagnostics else None
        touches = self.stepper.external_wrench.size > 0
        self.felt = Outlet(node, "~/external_wrench", WrenchStamped) if touches else None
        self.telling, self.share = Telling(node, self.stepper, settings, self.sensing), LearnedShare()
        self.began = math.nan
        self.before = {inlet.name: 0 for inlet in self.inlets}
        self.leave, self.hurry, self.is_running = "", False, False
        self.late: list[Array] = []
        self.skipped = 0
        self.calls: SimpleQueue[tuple[Callable[[], Any], Future[Any]]] = SimpleQueue()
        self.lock, self.aside = Lock(), ThreadPoolExecutor(1, "aside")
        self.asking.rehearse()

    def _listen(self) -> None:
        """Subscribe to what is measured."""
        node, s = self.node, self.settings
        self.joints = Inlet(node, "joint_states", JointState, publishers=s.joint_states.publishers)
        self.base = self.ticking = None
        self.frames: list[Inlet] = []
        if self.stepper.robot.dimensions.base and s.odometry.source == "odometry":
            name = odometry_topic(self.stepper.robot, s)
            self.base = Inlet(node, name, Odometry, publishers=s.odometry.publishers)
        if self.stepper.robot.dimensions.base:
            self.frames = frames_of(node, s.odometry.source == "tf")
        if self.clock.is_simulated:
            self.ticking = Inlet(node, "/clock", ClockMessage)
        self.needed = [inlet for inlet in (self.ticking, self.joints, self.base) if inlet is not None]
        self.inlets = [*self.needed, *self.frames, *self.asking.inlets, *(self.hand.inlets if self.hand else [])]

    def rows(self) -> list[GraphRow]:
        """All topics, services and actions."""
        heard = ((one.name, type_of(one.kind), quality_of(one.subscription)) for one in self.inlets)
        found = [GraphRow("subscribes", *one, "") for one in heard]
        found += [GraphRow("serves", one.name, one.type, "reliable", "") for one in self.asking.actions]
        for name in ("~/stop", "~/reset"):
            name = self.node.resolve_service_name(name)
            found.append(GraphRow("serves", name, "std_srvs/srv/Trigger", "reliable", ""))
        for output, one, _ in self.commands.outlets:
            what = "" if output.is_base else f"{output.interface} of {', '.join(output.joints)}"
            found.append(GraphRow("publishes", one.name, type_of(one.kind), quality_of(one.publisher), what))
        told = [(one, "") for one in (*(one for one, _, _ in self.telling.outlets), self.health)]
        for out, what in [*told, (self.felt, "of the world on the hand, without a sensor")]:
            if out is not None:
                found.append(GraphRow("publishes", out.name, type_of(out.kind), quality_of(out.publisher), what))
        return found

    # -- before --------------------------------------------------------------------------------------------------------

    def meet(self, patience: float) -> None:
        """Wait for a whole measurement, and for the controllers that take the commands.

        Raises:
            InputError: They do not come in time [s], with what is missing and what was wrong with what came.
        """
        deadline = clock.monotonic() + patience
        while lacking := self.missing():
            if self.leave or clock.monotonic() > deadline:
                fix = "see `mmnn docs how-to/ros2`, 'When nothing comes'"
                raise InputError(lacking, why=f"after {patience:g} s" if not self.leave else self.leave, fix=fix)
            clock.sleep(0.005)

    def missing(self) -> str:
        """The first thing that keeps the robot from being moved, in words; empty for nothing."""
        self.read()
        for inlet in self.needed:
            if crowd := inlet.crowd():
                return f"{inlet.name}: {crowd}"
            if not inlet.received and inlet.clash:
                return f"{inlet.name}: its publisher offers another {inlet.clash}: set qos_overrides"
            if not inlet.received:
                return f"{inlet.name}: {'nothing comes' if inlet.publishers else 'no publisher'}"
        wrong = next((f"{inlet.name}: {inlet.why}" for inlet in self.needed if inlet.why), "")
        if lacking := self.sensing.lacking(self.clock.now):
            return wrong or f"no measurement of {lacking}"
        return self.commands.trouble

    # -- one sample ----------------------------------------------------------------------------------------------------

    def read(self) -> None:
        """Take what came."""
        if self.ticking is not None:
            for tick in self.ticking.take():
                self.clock.tick(tick)
        for inlet in self.frames:
            for message in inlet.take():
                self._noted(inlet, self.tree.take(message, self.clock.now))
        if self.base is not None:
            self._measured(self.base, self.sensing.take_base, self.settings.odometry.age)
        self._measured(self.joints, self.sensing.take_joints, self.settings.joint_states.age)

    def _measured(self, inlet: Inlet, take: Callable[[Any, float], str], oldest: float) -> None:
        """Read the newest message of a topic, if its stamp can be."""
        if (message := inlet.newest()) is not None:
            when = self.clock.measured(message.header.stamp, oldest)
            self._noted(inlet, when if isinstance(when, str) else take(message, when))

    def _noted(self, inlet: Inlet, why: str) -> None:
        if why:
            inlet.refuse(why)

    def sample(self, time: float, more: tuple[Wish, ...] = ()) -> None:
        """Read, step, send."""
        self.read()
        d, follower = self.stepper.robot.dimensions, self.stepper.follower
        reference = follower.now[follower.q :].reshape(3, d.arm)
        arm = np.array([self.sensing.q[: d.arm], self.sensing.qdot[: d.arm]])
        base, moved_on = follower.now[: d.pose + d.twist], 0.5 * sum(follower.pace) * (time - self.stepper.time)
        seen = self.sensing
        now = RobotSituation(reference, arm, base, seen.pose, seen.velocity, moved_on if self.stepper.k >= 0 else 0.0)
        self.now = now
        if self.asking.share is not None:
            follower.share, self.asking.share = self.asking.share, None
        asked = self.asking.poll(self.clock, now, self.stepper.tripped)
        if self.hand is not None and (led := self.hand.poll(self.clock)):
            self.asking.give_way("the hand is led", (BASE, ARM))
            asked = (*asked, *led)
        measurement = self.sensing.measurement(self.stepper.direction)
        measured = min(self.sensing.when, time) if measurement is not None else None
        try:
            command = self.stepper.step(time, measurement, asked + more or None, measured=measured)
        except ConfigError as error:  # the reference has moved on since it was planned: what does not fit is left out
            if not asked:
                raise
            self.asking.give_way(f"{error.what}: {error.why}", (BASE, ARM))
            self._say_once(f"not followed: {error.what}: {error.why}")
            command = self.stepper.step(time, measurement, None, measured=measured)
        self.commands.send(command, stamp_of(self.clock.by_ros))

    # -- what callbacks ask of it --------------------------------------------------------------------------------------

    def between(self, call: Callable[[], T]) -> T:
        """The result of a call that the loop makes between two samples; errors as of the call.

        Raises:
            TimeoutError: The loop does not come to it.
        """
        with self.lock:
            if not self.is_running:
                return call()
            future: Future[T] = Future()
            self.calls.put((call, future))
        return future.result(ANSWER)

    def stop(self) -> tuple[bool, str]:
        """An emergency stop."""
        if not self.is_running:
            return False, "the node is not active: nothing moves"
        self.between(lambda: self.stepper.stop("stopped by its service"))
        return True, "stopped by its service"

    def reset(self) -> tuple[bool, str]:
        """Go on after a trip, from where the robot stands."""
        if not self.is_running:
            return False, "the node is not active"
        try:
            self.between(self._reset)
        except ConfigError as error:
            return False, ": ".join(filter(None, (error.what, error.why, error.fix)))
        return True, "it goes on from where it stands"

    def _reset(self) -> None:
        self.stepper.reset()
        self.clock.jumped = ""

    def change(self, settings: Node, controller: CompiledController | TorqueController, kinematic: Kinematic) -> None:
        """Other limits, gains and settings of the controller from the next sample on; what was learned stays.

        Raises:
            ConfigError: They do not suit; nothing has changed then.
        """
        self.stepper.change(controller, kinematic, settings.limits)
        if settings.speed_scaling != self.settings.speed_scaling:
            self.asking.share = settings.speed_scaling
        self.settings = self.asking.settings = settings
        self.asking.change(new_guide(self.stepper.robot, settings.limits))

    def _answer(self) -> None:
        """Do what was asked for between two samples."""
        while True:
            try:
                call, future = self.calls.get_nowait()
            except Empty:
                return
            try:
                future.set_result(call())
            except InputError as error:
                future.set_exception(error)

    # -- the run -------------------------------------------------------------------------------------------------------

    def run(self, seconds: float = math.inf, motion: Motion | None = None) -> None:
        """Control until the end, a trip or `leave`; then efforts have faded.

        Args:
            seconds: How long.
            motion: To follow from the start.
        """
        switch = sys.getswitchinterval()
        sys.setswitchinterval(SWITCH)
        self._start()
        try:
            with self._real_time(self.settings.thread_priority):
                self._drive(seconds, motion)
        finally:  # also where the recording cannot be written any more
            with self.lock:
                self.is_running = False
            self._answer()
            self.skipped += self.pace.skipped
            self.asking.close(self.leave or "the node is not active")
            self._fade()
            sys.setswitchinterval(switch)

    @contextmanager
    def _real_time(self, priority: int) -> Iterator[None]:
        """This thread before all ordinary ones, if the system lets it; threads that it starts stay ordinary."""
        try:
            policy = os.SCHED_FIFO if priority else os.SCHED_OTHER
            os.sched_setscheduler(0, policy | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
        except (AttributeError, OSError):  # not Linux, or not allowed
            text = "control runs as an ordinary thread: for its thread_priority give the user 'rtprio' (limits.conf)"
            self.node.get_logger().info(text)
        try:
            yield
        finally:
            with suppress(AttributeError, OSError):
                os.sched_setscheduler(0, os.SCHED_OTHER | os.SCHED_RESET_ON_FORK, os.sched_param(0))

    def _start(self) -> None:
        """The node's time goes on after the last sample; what is heard is as old as it was."""
        gc.collect()
        gc.freeze()  # what is there is no garbage: a collection looks only at what comes
        begin, before = max(self.stepper.time + self.stepper.period, 0.0), self.clock.now
        self.clock.begin += before - begin
        self.sensing.shift(before - begin)
        if math.isnan(self.began):
            self.began = self.clock.by_ros - begin
        self.pace = Pace(self.stepper.period, begin)
        self.late.append(self.pace.late)
        self.asking.open()
        self.is_running = True

    def _drive(self, seconds: float, motion: Motion | None) -> None:
        watched = reported = -math.inf
        asked: tuple[Wish, ...] = () if motion is None else (motion,)
        stopped, ends = self.stepper.tripped, self.pace.begin + seconds
        while stopped or not (self.stepper.is_over and (self.leave or self.settings.end_after_trip)):
            time = self._next()
            self.sample(time, asked)
            if stopped:  # it was active before: activating it again is a reset
                stopped = not self._is_reset()
            if self.felt is not None:
                self.felt.send(wrench_of(self.stepper, stamp_of(self.clock.by_ros)))
            for tell in self.telling.due(time, self.now, self.clock.by_ros):
                self.aside.submit(tell)
            self._answer()
            self.stepper.record()
            asked = ()
            if self.health is not None and time - reported >= 1.0 / self.settings.diagnostics:
                reported = time
                self._diagnose(self.health)
            if time - watched >= WATCH:
                watched = time
                self._watch(time)
            if time >= ends or self.hurry:
                return

    def _is_reset(self) -> bool:
        """Reset where there is a fresh measurement, or where the loop is to end."""
        try:
            self._reset()
        except ConfigError:
            return bool(self.leave)
        return True

    def _next(self) -> float:
        """Wait for the next sample, by the steady clock or the simulator's, and its time [s]."""
        if self.ticking is None:
            return self.pace.wait()
        self.pace.count += 1
        while not self.leave:
            for tick in self.ticking.take():
                self.clock.tick(tick)
            if self.clock.now >= self.stepper.time + self.stepper.period - 1e-9:
                return self.clock.now
            clock.sleep(0.0002)
        clock.sleep(self.stepper.period)  # a stop does not wait for the simulator
        return max(self.stepper.time, 0.0) + self.stepper.period

    def _fade(self) -> None:
        """Efforts fade, velocities end."""
        if self.stepper.k < 0:
            return
        steps = max(1, round(FADE / self.stepper.period))
        command = self.stepper.command
        last = type(command)(*(array.copy() for array in command))
        for k in range(steps):
            self.commands.end(last, 1.0 - (k + 1) / steps, stamp_of(self.clock.by_ros))
            clock.sleep(self.stepper.period)

    def finish(self, status: Status, message: str) -> Recording | None:
        """Close the recording, and plan nothing more; None where nothing ran."""
        self.asking.planner.close()
        self.aside.shutdown()
        if self.stepper.k < 0:
            self.stepper.__exit__(None, None, None)
            return None
        dropped = [text for inlet in self.inlets for text in inlet.counted()]
        skipped = [f"{self.skipped} cycles skipped by overruns"] if self.skipped else []
        told = "; ".join(text for text in (message, *dropped, *skipped) if text)
        late = np.concatenate(self.late) if self.late else np.zeros(0)
        return self.stepper.finish(status, told, {"late": late[~np.isnan(late)], "began": np.array([self.began])})

    def close(self) -> None:
        """Leave all topics."""
        self.asking.close("the node was cleaned up")
        for action in self.asking.actions:
            action.server.destroy()
        for inlet in self.inlets:
            self.node.destroy_subscription(inlet.subscription)
        outlets = [outlet for _, outlet, _ in self.commands.outlets]
        outlets += [outlet for outlet, _, _ in self.telling.outlets]
        for one in [*outlets, *(one for one in (self.health, self.felt) if one is not None)]:
            self.node.destroy_publisher(one.publisher)

    # -- what is wrong -------------------------------------------------------------------------------------------------

    def tell(self, text: str) -> None:
        """Say a line with the time, beside the loop: a logger is slow."""
        text = f"t = {max(self.stepper.time, 0.0):.2f} s: {text}"
        self.aside.submit(self.node.get_logger().warning, text)

    def _diagnose(self, health: Outlet) -> None:
        """Tell of the node, beside the loop."""
        row, stamp, problem, counts = self.stepper.row.copy(), stamp_of(self.clock.by_ros), self.problem, self._counts()
        where, every = self.stepper.setup.layout.where, 1.0 / self.settings.diagnostics
        share = self.share.take(row[where("psi_hat")], row[where("torque")], every)
        self.aside.submit(lambda: health.send(diagnostics(self.stepper, row, stamp, problem, counts, share)))

    def _watch(self, time: float) -> None:
        """Stop where a clock jumped, another node commands the robot, or the loop is to end; say what is new."""
        crowd = self.commands.crowd()
        if time < self.pace.begin + SETTLED:  # it came later than the other, which it had not heard of yet
            self.leave = self.leave or crowd
        for why in (self.clock.jumped, self.leave):
            if why and not self.stepper.tripped:
                self.stepper.stop(why)
                self._say_once(why)
        problems = [*self._dropped(), *self._silent(), *([crowd] if crowd else [])]
        if unheard := self.commands.unheard:
            problems.append(f"nobody reads {', '.join(unheard)}")
        if self.stepper.is_late:
            problems.append(f"cycles are more than {SLOW:g} times the period apart: ask for a lower rate")
        if problems and not self.stepper.tripped:
            self._say_once("; ".join(problems))
        elif not problems and not self.stepper.tripped:
            self.problem = ""

    def _dropped(self) -> list[str]:
        """Lines on inlets that dropped messages since the last look: how many, and why."""
        found = []
        for inlet in self.inlets:
            if (dropped := inlet.dropped) > self.before[inlet.name]:
                found.append(f"{inlet.name}: {dropped - self.before[inlet.name]} dropped: {inlet.crowd() or inlet.why}")
                self.before[inlet.name] = dropped
        return found

    def _silent(self) -> list[str]:
        """A line that names measurements which come no more; empty where all come."""
        lacking = self.sensing.lacking(self.clock.now)
        if not lacking:
            return []
        silent = [inlet.name for inlet in self.needed if not inlet.publishers]
        gone = f", no publisher of {', '.join(silent)}" if silent else ""
        return [f"nothing fresh of {lacking}{gone}"]

    def _say_once(self, text: str) -> None:
        """Say what is wrong when it begins, and when it changes in kind."""
        kind = "".join(c for c in text if not c.isdigit())
        if kind != "".join(c for c in self.problem if not c.isdigit()):
            self.tell(text)
        self.problem = text

    def _counts(self) -> dict[str, float]:
        found = {f"{one.name} {name}": float(getattr(one, name)) for one in self.inlets for name in COUNTS}
        return found | {"skipped": float(self.skipped + self.pace.skipped)}


def type_of(kind: type[Any]) -> str:
    """The name of a message's type."""
    return f"{kind.__module__.partition('.')[0]}/msg/{kind.__name__}"


def quality_of(endpoint: Any) -> str:
    """Quality of service of a publisher or a subscription."""
    quality = endpoint.qos_profile
    return f"{quality.reliability.name.lower()}, depth {quality.depth}"


def frames_of(node: RosNode, needed: bool) -> list[Inlet]:
    """`/tf` and `/tf_static`; none, with a warning, where their messages are not there.

    Raises:
        ConfigError: They are needed, and not there.
    """
    try:
        from tf2_msgs.msg import TFMessage
    except ImportError as error:
        fix = "apt install ros-$ROS_DISTRO-tf2-msgs; beside wheels see `mmnn docs how-to/ros2`"
        if needed:
            raise ConfigError("poses by /tf without the package tf2_msgs", fix=fix, key="odometry.source") from error
        node.get_logger().warning(f"no paths in the frame of a map without the package tf2_msgs: {fix}")
        return []
    moving = Inlet(node, "/tf", TFMessage, depth=20, publishers=MANY)
    return [moving, Inlet(node, "/tf_static", TFMessage, depth=20, publishers=MANY, reliable=True, latched=True)]
