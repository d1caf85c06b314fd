"""A controller as an rclpy lifecycle node: configure, activate, deactivate, cleanup, shutdown, and an error on the way.

                  executor's threads                                        the caller's thread
    lifecycle, parameters, services, action ──▶ Bridge.between ──▶ Bridge.run: read, step, send, at its period

Configuring reads the parameters, loads the robot, makes the stepper and all topics; activating waits for the robot and
lets the control loop run; deactivating brakes, holds and lets efforts fade. What was learned stays until a cleanup.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from threading import Event, Thread
from typing import Any, Protocol

import rclpy
from rcl_interfaces.msg import SetParametersResult
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from ...errors import InputError, MmnnError
from ...kinematic import Kinematic
from ...loop.stepper import Stepper
from ...recording.recording import Recording
from ...reference.wishes import Motion
from ...torque.controller import CompiledController, TorqueController
from .bridge import Bridge, GraphRow
from .parameters import declare, given, is_live, value_of
from .settings import Node, settings_of

STOPS = (signal.SIGINT, signal.SIGTERM)
LEAVING = 10.0  # longest time in which the control loop ends [s]
THREADS = 8  # of the executor; a goal of an action keeps one until it is over
DEACTIVATED = "deactivated"
LOOK = 0.02  # time between two looks for work [s]
SUCCESS, FAILURE, ERROR = (
    TransitionCallbackReturn.SUCCESS,
    TransitionCallbackReturn.FAILURE,
    TransitionCallbackReturn.ERROR,
)


class Maker(Protocol):
    """A maker of steppers out of settings."""

    def stepper(self, settings: Node, count: int) -> Stepper:
        """A stepper, the count-th of the process."""

    def motion(self, stepper: Stepper) -> tuple[Motion | None, float]:
        """The motion that a stepper follows from the start, None for none; and for how long [s]."""

    def law(self, settings: Node, before: Node) -> tuple[CompiledController | TorqueController, Kinematic]:
        """Controller and kinematic gains of changed settings; raises a ConfigError where more than those changed."""


class ControllerNode(LifecycleNode):
    """The node.

    Args:
        make: Makes steppers.
        patience: How long activating waits for the robot [s].

    Attributes:
        bridge: The control loop; None while it is not configured.
        problem: Why the last transition failed.
        recording: Of the last run; None before one is over.
    """

    def __init__(self, make: Maker, patience: float) -> None:
        super().__init__("mmnn", automatically_declare_parameters_from_overrides=True)
        self.make, self.patience = make, patience
        self.bridge: Bridge | None = None
        self.problem: InputError | None = None
        self.failure: Exception | None = None
        self.recording: Recording | None = None
        self.count, self.stopped, self.is_managed = 0, list[int](), True
        self.runs, self.is_wanted, self.is_done = False, Event(), Event()
        declare(self)
        self.add_on_set_parameters_callback(self._changed)
        at_once = ReentrantCallbackGroup()
        self.create_service(Trigger, "~/stop", self._stop, callback_group=at_once)
        self.create_service(Trigger, "~/reset", self._reset, callback_group=at_once)

    # -- transitions ---------------------------------------------------------------------------------------------------

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Read the parameters and make all that they ask for."""
        try:
            self.settings = settings_of(given(self))
            stepper = self.make.stepper(self.settings, self.count)
            self.count += 1
            self.motion, self.seconds = self.make.motion(stepper)
            self.bridge = Bridge(self, stepper, self.settings, bool(self.get_parameter("use_sim_time").value))
        except Exception as error:
            return self._failed(error)
        return SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Wait for the robot, then let the control loop run."""
        assert self.bridge is not None
        try:
            self.bridge.leave = ""
            self.bridge.meet(self.patience)
        except Exception as error:
            return self._failed(error)
        self.runs = True
        self.is_done.clear()
        self.is_wanted.set()
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Brake, hold, let efforts fade."""
        assert self.bridge is not None
        if self.is_wanted.is_set():
            self.bridge.leave = self.bridge.leave or DEACTIVATED
            self.is_done.wait(LEAVING)
        self.runs = False
        return ERROR if self.failure is not None else super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Close the recording, leave all topics."""
        self._release()
        return SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """As deactivate and cleanup."""
        if self.runs:
            self.on_deactivate(state)
        self._release()
        return SUCCESS

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """As cleanup; it may be configured anew."""
        self._release()
        return SUCCESS

    def _failed(self, error: Exception) -> TransitionCallbackReturn:
        """A transition that failed by what it was given, or by an error, which rclpy would swallow."""
        if self.is_managed:
            self.get_logger().error(str(error))
        if isinstance(error, InputError):
            self.problem = error
            return FAILURE
        self.failure = error
        return ERROR

    def _release(self) -> None:
        """Close the recording, and leave all topics of the bridge."""
        if (bridge := self.bridge) is None:
            return
        self.bridge = None
        bridge.close()
        signals = f"stopped by {signal.Signals(self.stopped[0]).name}" if self.stopped else ""
        try:
            self.recording = bridge.finish("interrupted" if self.stopped else "completed", signals or bridge.problem)
        except Exception as error:  # where the recording has failed it says so once more
            self.failure = self.failure or error

    # -- services and parameters ---------------------------------------------------------------------------------------

    def _stop(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._switched("stop", response)

    def _reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._switched("reset", response)

    def _switched(self, name: str, response: Trigger.Response) -> Trigger.Response:
        bridge = self.bridge
        done, why = (False, "the node is not configured") if bridge is None else getattr(bridge, name)()
        response.success, response.message = done, why
        self.get_logger().info(f"{name}: {why}")
        return response

    def _changed(self, parameters: Sequence[Parameter]) -> SetParametersResult:
        """Take live parameters at once, others while nothing is configured."""
        if (bridge := self.bridge) is None:
            return SetParametersResult(successful=True)
        try:
            if fixed := [one.name for one in parameters if not is_live(one.name)]:
                raise InputError(f"{', '.join(fixed)} cannot change now", fix="clean up, set it, configure anew")
            changed = settings_of(given(self) | {one.name: value_of(one) for one in parameters})
            controller, kinematic = self.make.law(changed, self.settings)
            bridge.between(lambda: bridge.change(changed, controller, kinematic))
        except MmnnError as error:
            return SetParametersResult(successful=False, reason=str(error))
        self.settings = changed
        return SetParametersResult(successful=True)

    # -- the caller's thread -------------------------------------------------------------------------------------------

    def control(self, is_managed: bool) -> Recording | None:
        """Run the control loop whenever the node is active, until it is over; the recording of the last run.

        Args:
            is_managed: Whether somebody else configures and activates it; else it does so itself, and ends with it.

        Raises:
            InputError: A transition of its own that fails.
            RecordingError: The recording cannot be written.
        """
        before = [signal.signal(number, self._signalled) for number in STOPS]
        self.is_managed = is_managed
        try:
            if not is_managed:
                self._begin()
            while not self.stopped:
                if self.is_wanted.wait(LOOK):
                    self._run()
                    if not (is_managed or self._may_go_on()):
                        break
        finally:
            self._end()
            for number, handler in zip(STOPS, before, strict=True):
                signal.signal(number, handler)
        if self.failure is not None:
            raise self.failure
        return self.recording

    def _begin(self) -> None:
        """Configure and activate itself."""
        for transition in (self.trigger_configure, self.trigger_activate):
            if transition() is not SUCCESS and not self.stopped:
                raise self.failure or self.problem or InputError(f"{transition.__name__} failed")

    def _run(self) -> None:
        """Control until the loop is over."""
        assert self.bridge is not None
        try:
            self.bridge.run(self.seconds, self.motion)
        except Exception as error:
            self.failure = error
        self.motion = None
        self.is_wanted.clear()
        self.is_done.set()
        if self.is_managed and not self.stopped and self.bridge.leave != DEACTIVATED:
            self.trigger_deactivate()

    def _may_go_on(self) -> bool:
        """Whether somebody deactivated it, who may activate it again."""
        return self.bridge is not None and self.bridge.leave == DEACTIVATED and self.failure is None

    def _end(self) -> None:
        """Leave the state that it is in."""
        if self.bridge is not None:
            if self.runs:
                self.trigger_deactivate()
            if self.bridge is not None:
                self.trigger_cleanup()
        if not (self.failure or self.problem):  # after an error there may be nothing left to shut down
            self.trigger_shutdown()

    def _signalled(self, number: int, _: Any) -> None:
        self.stopped.append(number)
        if self.bridge is not None:
            self.bridge.leave = f"stopped by {signal.Signals(self.stopped[0]).name}"
            self.bridge.hurry = len(self.stopped) > 1


@contextmanager
def made(make: Maker, arguments: Sequence[str], patience: float = 0.0) -> Iterator[ControllerNode]:
    """The node, served by an executor in threads of its own.

    Args:
        make: Makes steppers.
        arguments: Of the command line, for ROS 2 (`--ros-args ...`).
        patience: How long to wait for the robot [s].

    Raises:
        InputError: Arguments that ROS 2 does not take.
    """
    os.environ.setdefault("SKIP_DEFAULT_XML_FILE", "1")  # else Fast DDS takes the settings of the folder it is run in
    try:
        rclpy.init(args=["mmnn", *arguments], signal_handler_options=rclpy.SignalHandlerOptions.NO)
        node, executor = ControllerNode(make, patience), MultiThreadedExecutor(THREADS)
    except InputError:
        rclpy.try_shutdown()
        raise
    except (RuntimeError, ValueError, TypeError) as error:  # of rclpy: RCLError and others
        rclpy.try_shutdown()
        secured = os.environ.get("ROS_SECURITY_ENABLE", "").lower() == "true"
        fix = (
            "ros2 security create_enclave KEYSTORE /mmnn, and --ros-args --enclave /mmnn" if secured else "see the file"
        )
        raise InputError("ROS 2 does not take this", why=" ".join(str(error).split()), fix=fix) from error
    executor.add_node(node)
    spinning = Thread(target=executor.spin, daemon=True)
    spinning.start()
    try:
        yield node
    finally:
        executor.shutdown(LEAVING)
        spinning.join(LEAVING)
        node.destroy_node()
        rclpy.try_shutdown()


def settings(make: Maker, arguments: Sequence[str]) -> Node:
    """The settings that arguments for ROS 2 say; errors as of `made` and `settings_of`."""
    with made(make, arguments) as node:
        return settings_of(given(node))


def checked(make: Maker, arguments: Sequence[str]) -> tuple[str, list[GraphRow]]:
    """The robot's name and all topics of the node, as configuring makes them; errors as of `control`."""
    with made(make, arguments) as node:
        node.is_managed = False
        if node.trigger_configure() is not SUCCESS or node.bridge is None:
            raise node.failure or node.problem or InputError("it cannot be configured")
        return node.bridge.stepper.robot.name, node.bridge.rows()


def control(make: Maker, arguments: Sequence[str], patience: float, is_managed: bool) -> tuple[Recording | None, bool]:
    """Run the node; the recording of its last run, and whether a signal ended it.

    Args:
        make: Makes steppers.
        arguments: Of the command line, for ROS 2 (`--ros-args ...`).
        patience: How long to wait for the robot [s].
        is_managed: As in `ControllerNode.control`.

    Raises:
        InputError: Arguments that ROS 2 does not take, a transition that fails.
        RecordingError: The recording cannot be written.
    """
    with made(make, arguments, patience) as node:
        return node.control(is_managed), bool(node.stopped)
