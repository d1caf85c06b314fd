"""One control sample at a time for a robot that is not simulated: a loop of one's own, in real time.

    measurement ─▶ [supervisor: fresh? finite?] ─┬─▶ [kinematic] ─▶ [torque] ─▶ [supervisor: limits] ─▶ command
    wish ─▶ [guide: where it stands, no jump] ─▶ setpoint ─┘

Time is an argument, never a clock: pacing and messages are the caller's (`examples/own_loop.py`, `examples/udp`).
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from types import TracebackType
from typing import Any, Self

import msgspec
import numpy as np
from numpy.typing import ArrayLike

from ..compliance import Force, Impedance, set_force, soften
from ..elementary import hypot
from ..elementary.arrays import is_below
from ..elementary.matrices import product
from ..errors import ConfigError, UnknownName, keyed, printable
from ..kinematic import Kinematic, see
from ..model.base.rolling import STEERED, followed, maps_in
from ..model.base.steered import SteeredBase
from ..model.robot import Robot
from ..recording.recorder import Recorder
from ..recording.recording import Outcome, Recording, Status
from ..reference.follower import LARGEST, Follower, require_shapes
from ..reference.limits import Limits
from ..reference.trajectory import Trajectory
from ..reference.wishes import Motion, Wish
from ..safety import Safety, accept, has_ended, press, release, remarks, trip_of
from ..sensing import Sensor, observe
from ..settings import Numbers, Settings, Timing, require_gain
from ..settings.arguments import checked, faced, shortly
from ..signals import Array, Measurement, Setpoint
from ..torque.controller import CompiledController, ControllerState, TorqueController
from ..torque.learning_law import LearningLaw
from ..touch import Touch
from .before_run import require_seed, samples_between
from .controller import state_from, with_findings
from .latency import Latency
from .lead import Past, bring_up
from .loop import Loop
from .new_hardware import new_hardware
from .reductions import reductions
from .sample import Control
from .sampled import delay_margin
from .servo import Command, Servo, Split, interfaces_of, limit_commands, movers, own_velocities
from .setup import KNOWN, StepperSetup, facts_of, plan_outside
from .sight import VelocityFilter
from .stable_gains import require_stable_gains
from .suited import LoopToSuit, suited
from .suited_safety import suited_safety

CALM = Kinematic(kx=3.0, ky=16.0, kth=8.0, K=5.0, holonomic=(3.0, 3.0, 3.0))
SLOW = 1.5  # times its period that a stepper's samples are apart when it is said
TINY = 1e-9  # a velocity that is none [m/s, rad/s]
NAME = r"\w{1,100}"  # of an array
MOST_TOLD = 20  # trips that a recording tells of


class StepperSettings(Settings, frozen=True):
    """Settings of a `Stepper` beside its robot and its controller.

    Args:
        kinematic: Gains of the kinematic layer.
        safety: Limits of the supervisor.
        period: Control period [s].
        limits: Limits of references that the stepper makes.
        setpoint_timeout: Age of the last sample or velocity at which the base brakes and the arm holds [s].
        nominal: The model of a controller that uses a model and has none of its own; None for `robot`.
        seed: Seed of a controller's random numbers.
        within_limits: As in `Loop`.
        latency: Known delay from the measurement to the motors [s]; gains that are unstable with it are refused. A
            `Latency` says which part is the measurement's. A number is the command's delay, with `predict` the
            measurement's.
        predict: Whether a measurement is moved on with the reference, over its latency at most; None as `Latency` says.
        lag: Known time constants of the motors, one number or one per motor [s]; gains are checked with them.
        lead: Whether Psi_hat leads by half the period, the lag and the latency that is not predicted (`loop.lead`).
        filtered: Time constant of the filter of measured velocities (`Sensor.smoothing`) [s]; gains are checked with
            it.
        touch: Observer of external torque; None for none.
        observer: Poles of a model-based observer (see `Sensor.velocity`) [rad/s]. It estimates q and all velocities
            from angles and base velocities measured at every sample; 0 takes measurements unchanged.
        interfaces: What the motors take, by joint: "velocity" or "position"; "effort" for joints that are not named.
        servo: The robot's servos behind velocity and position interfaces, as far as known, see `loop.servo`.
        check_gains: Refuse gains that make the sampled PD loop unstable at one of some postures.
        path: File for the recording; None keeps it in memory, which then grows with `record`.
        force: Replace an existing file.
        meta: More facts for the recording.
        state: State of a controller, from `snapshot` or a recording (it is copied); None for a new one.
        weights_interval: Time between two records of the weights [s].
        impedance: Compliance of the hand; None for a stiff one.
        hand_force: Force with which the hand pushes.

    Raises:
        ConfigError: No supervisor, or numbers out of range.

    >>> from mmnn_pin.safety import Safety
    >>> StepperSettings(safety=Safety(torque="urdf"), period=0.002).period
    0.002
    """

    kinematic: Kinematic = CALM
    safety: Safety | None = Safety()
    period: float = 0.002
    limits: Limits = Limits()
    setpoint_timeout: float = 0.5
    nominal: Robot | None = None
    seed: int = 0
    within_limits: bool | None = None
    latency: float | Latency = 0.0
    predict: bool | None = None
    lag: Numbers = 0.0
    lead: bool = False
    filtered: float = 0.0
    touch: Touch | None = None
    observer: float = 0.0
    interfaces: Mapping[str, str] = {}
    servo: Servo = Servo()
    check_gains: bool = True
    path: str | Path | None = None
    force: bool = False
    meta: Mapping[str, Any] = {}
    state: Any = None
    weights_interval: float = 0.1
    impedance: Impedance | None = None
    hand_force: Force | None = None

    def __post_init__(self) -> None:
        if self.safety is None:
            why, fix = "the motors are real: something must stand before them", "give safety=Safety()"
            raise ConfigError("a stepper without a supervisor", why=why, fix=fix, key="safety")
        require_gain(self.setpoint_timeout, "setpoint_timeout")
        require_seed(self.seed)
        if not isinstance(self.lag, int | float):
            msgspec.structs.force_setattr(self, "lag", tuple(self.lag))


@faced
class Stepper:
    """Kinematic layer, controller and supervisor of a robot, one control sample per call.

        stepper = Stepper(robot, PD(Feedback(30.0, 60.0, "inertia")), StepperSettings(safety=Safety(torque="urdf")))
        while not stepper.is_over:
            command = stepper.step(time, measurement, setpoint)     # send command.effort, then
            stepper.record()

    `step` does not touch the disk, keeps no memory, and all that it calls has been compiled before. It starts where the
    robot is measured first, at rest or braking. A setpoint is one of `reference.wishes`, or a tuple of one for the base
    and one for the arm, or None to go on; full samples (`Setpoint`) and base velocities have to be renewed.

    Args:
        robot: The robot.
        controller: A controller of this package or a `TorqueController` of your own. Gains that you do not give suit
            the robot (`loop.suited`); those given as bandwidths are multiplied with the robot's effective inertias.
        settings: Everything else.

    Attributes:
        row: (width,) all signals of the last sample; those of `setup.UNKNOWN` mean nothing.
        measured: The last good measurement, views into the row.
        setpoint: The setpoint of the last sample, views.
        command: What the last step returned.
        external_torque: (p,) torque of the world on the velocities at the last measurement, a view; (0,) without
            `touch` [N, N m].
        external_wrench: (6,) force and moment of the world on the hand, in the world's axes, likewise [N, N m].
        state: What the controller has learned.
        time: Of the last sample [s].
        step_time: Wall-clock time that the last step took [s].
        is_late: Whether it has been stepped more slowly than its period says, by far.
        told: What a recording will tell of it: what its loop does not bear and was reduced, trips, delays.

    Raises:
        ConfigError: Gains that are unstable when sampled, numbers out of range, or a state of another controller.
        RecordingError: The recording cannot be written.

    >>> from mmnn_pin.safety import Safety
    >>> robot = load("platform_arm")
    >>> at_rest = Measurement(np.zeros(3), np.zeros(2), q=np.zeros(2), qdot=np.zeros(2))
    >>> with Stepper(robot, PD(), StepperSettings(safety=Safety(torque="urdf"))) as stepper:
    ...     stepper.step(0.0, at_rest, None).motor_effort.shape
    (4,)
    """

    @checked
    def __init__(
        self,
        robot: Robot,
        controller: CompiledController | TorqueController,
        settings: StepperSettings = StepperSettings(),  # noqa: B008 (frozen)
    ) -> None:
        safety = settings.safety
        assert safety is not None
        period, known = settings.period, Latency.of(settings.latency, settings.predict)
        with keyed(lambda key: "period"):
            timing = Timing(duration=period, control_period=period, plant_step=period)
        with keyed(lambda key: "observer"):
            sensor = Sensor(velocity="model", bandwidth=settings.observer) if settings.observer else Sensor()
        delay = known.total + known.margin
        sight = VelocityFilter.late(settings.filtered, period) if sensor.exact else VelocityFilter.of(sensor, period)
        late = 0.0 if sensor.exact else sensor.smoothing(period)
        behind = (tuple(settings.interfaces.items()), settings.servo)
        given = LoopToSuit(settings.kinematic, period, delay, known.margin, settings.lag, b"", late, sight, *behind)
        controller = suited(controller, robot, lambda: given)
        setup = StepperSetup(
            robot, controller, settings.kinematic, safety, timing, settings.nominal, settings.seed,
            settings.within_limits, sensor=sensor, known=known, interfaces=dict(settings.interfaces),
            servo=settings.servo, lead=settings.lead, lag=settings.lag, filtered=settings.filtered,
            impedance=settings.impedance, force=settings.hand_force,
            touch=settings.touch,
        )  # fmt: skip
        self.period, self.check_gains, self.latency = period, settings.check_gains, known.total
        self.safety, self.limits, layout = safety, settings.limits, setup.layout
        self.follower, self.at = Follower(robot, self.limits, settings.setpoint_timeout), layout.offsets
        row = self.row = layout.new_row()
        self.received = row[layout.where("pose").start : layout.where("shape").stop]  # all of `measured`, in one piece
        self.measured, self.setpoint = Measurement.of(row, layout), Setpoint.of(row, layout)
        self.torque, self.motor_torque = row[layout.where("torque")], row[layout.where("motor_torque")]
        self.external_torque = row[layout.where("external_torque")]
        self.external_wrench = row[layout.where("external_wrench")]
        sizes = [layout.dof] * 3 + [layout.motors] * 3 + [layout.twist]
        self.command = Command._make(np.full(size, np.nan) for size in sizes)
        self.seen = np.zeros(layout.pose + layout.twist + 2 * layout.arm)
        self.kinds = np.array(interfaces_of(robot, setup.interfaces)[0])
        # Which velocities, and which motors, take a torque.
        self.by_effort = self.kinds == "effort", ~movers(robot)[self.kinds != "effort"].any(axis=0)
        self.placed = placed_motors(robot, movers(robot)[self.kinds == "position"].any(axis=0))
        self.time, self.k, self.step_time, self.told = -math.inf, -1, 0.0, list[str]()
        self.is_late = False
        self.told += reductions(robot, controller, given)
        self.every, self.weighed = samples_between(settings.weights_interval, period), -1
        now = self.follower.now
        self.past, self.before = Past.of(known.caught_up(timing), period, now), now.copy()
        self._equip(setup, state_from(controller, setup.context(), settings.state))
        self._rehearse()
        facts = facts_of(self.setup, settings.seed) | {"loop": "outside"} | dict(settings.meta)
        self.recorder = Recorder(layout, facts, settings.path, settings.force, KNOWN)
        self._weigh(0)

    @classmethod
    def of(cls, loop: Loop, **more: Any) -> Self:
        """The stepper of a loop's robot, controller, gains and supervisor; what the loop simulates is left out.

        Full samples are followed as they come, as the loop does, unless `limits` are given.

        Args:
            loop: The closed loop.
            more: Fields of `StepperSettings` that it does not say.

        Raises:
            UnknownName: There is no such field.
        """
        age = loop.sensor.base_age(loop.timing.measurement_period)
        said = {
            "kinematic": loop.kinematic,
            "safety": loop.safety,
            "period": loop.timing.control_period,
            "limits": Limits(samples="exact"),
            "nominal": loop.nominal,
            "seed": loop.seed,
            "within_limits": loop.within_limits,
            "latency": msgspec.structs.replace(loop.latency, margin=loop.latency.margin + age),
            "lag": loop.actuator.lag,
            "lead": loop.lead,
            "filtered": loop.smoothing if loop.sensor.velocity != "model" else 0.0,
            "touch": loop.touch,
            "interfaces": loop.interfaces,
            "servo": loop.servo,
            "check_gains": loop.check_gains,
            "weights_interval": loop.weights_interval,
            "impedance": loop.impedance,
            "hand_force": loop.force,
        } | more
        for name in set(said) - set(StepperSettings.__struct_fields__):
            raise UnknownName("setting of a stepper", name, StepperSettings.__struct_fields__, key=name)
        return cls(loop.robot, loop.controller, StepperSettings(**said))

    def step(
        self,
        time: float,
        measurement: Measurement | None = None,
        setpoint: Wish | tuple[Wish, ...] | None = None,
        *,
        measured: float | None = None,
    ) -> Command:
        """One control sample: setpoint -> kinematic -> torque -> safety.

        Without a measurement the last one is held, until the supervisor finds it too old. One that is not finite is
        refused and counted, one older than the last is ignored. Before the first the effort is zero.

        Args:
            time: Since a start of yours [s], larger than at the last call.
            measurement: What came in since the last call, or None.
            setpoint: What the robot should do from now on; None to go on.
            measured: When the measurement was taken [s], at most `time`; None for now.

        Returns:
            The command, whose arrays the next call overwrites.

        Raises:
            ConfigError: A time not after the last one; a measurement or a setpoint of another robot, a setpoint that is
                not finite, a joint goal that cannot be reached. Nothing has changed then, and the caller may go on.
        """
        began, time = perf_counter(), seconds(time, "time")
        if not self.time < time < math.inf:
            what, why = f"a control sample at t = {time:g} s", f"the last one was at {self.time:g} s"
            raise ConfigError(what, why=why, fix="go forward in time", key="time")
        wishes = () if setpoint is None else setpoint if isinstance(setpoint, tuple) else (setpoint,)
        courses = [self.follower.check(wish) for wish in wishes]
        if measurement is not None:
            self._take(measurement, time, time if measured is None else seconds(measured, "measured"))
        supervisor = self.hardware.way.supervisor
        self.received[:] = supervisor.message  # as it was taken: `bring_up` has moved that of the last sample
        self._see()
        if not self.follower.stands and supervisor.state.good[0] > 0.0:
            self.follower.stand(self.seen)
        self.follower.step(time, time - self.time if self.k >= 0 else 0.0, self.seen, wishes, courses)
        if self.past.longest > 0.0:
            heard = supervisor.state.heard[0]
            bring_up(self.row, self.at, time, heard, self.follower.guide, self.past, self.control.steering)
        self.control.step(time, self.follower.now, before=self.before if self.k >= 0 else None)
        self.before[:] = self.follower.now
        self._command()
        if supervisor.state.period[0] > SLOW * self.period and not self.is_late:
            self.is_late, steady = True, 1e3 * supervisor.state.steady[0]
            self._tell(f"stepped every {steady:.3g} ms, its period is {1e3 * self.period:.3g} ms")
        self.time, self.k, self.step_time = time, self.k + 1, perf_counter() - began
        return self.command

    def record(self) -> None:
        """Add the last sample to the recording; call it once the command is sent: now and then it writes to the disk.

        Raises:
            RecordingError: The file cannot be written; the rows already in it can be read.
        """
        self.recorder.append(self.row, self.step_time)
        if (self.k + 1) // self.every > self.weighed // self.every:
            self._weigh(self.k + 1)

    # -- between two samples ---------------------------------------------------------------------------------------

    def plan(self, trajectory: Trajectory, duration: float, *, from_here: bool = False) -> Motion:
        """A trajectory as samples to hand in; it may be made in another thread. Arguments and errors of `Motion.of`."""
        return Motion.of(trajectory, duration, self.period, self.robot.dimensions, from_here)

    def pause(self) -> None:
        """Brake and hold; setpoints are not followed, and motions wait, until `resume`."""
        self.follower.pause(self.time)

    def resume(self) -> None:
        """Go on with the motions that wait; they are joined without a jump."""
        self.follower.resume(self.time)

    def stop(self, why: str = "") -> None:
        """Stop as after a trip, from the next sample on, whatever the setpoints say: an emergency stop from outside.

        Args:
            why: For the recording.
        """
        if not self.tripped:
            press(max(self.time, 0.0), self.hardware.way.supervisor)
            self._tell(str(why))  # whatever it is: the robot stops

    def reset(self) -> None:
        """Go on after a trip: the robot holds where it is measured now; what was learned stays.

        Raises:
            ConfigError: Nothing has tripped, or there is no fresh measurement.
        """
        if not self.tripped:
            raise ConfigError("nothing to reset", why="the supervisor has not tripped", key="reset")
        text = trip_of(self.hardware.way.supervisor.state, self.robot)[2]
        if not release(self.time, self.hardware.way.supervisor):
            why, fix = "the last measurement is too old", "go on stepping until measurements come, then reset"
            raise ConfigError("a reset that is blind", why=why, fix=fix, key="reset")
        self._tell(text)
        self.received[:] = self.hardware.way.supervisor.message
        self._see()
        self.follower.stand(self.seen)
        self.past.times[:] = -math.inf

    @checked
    def change(
        self,
        controller: CompiledController | TorqueController | None = None,
        kinematic: Kinematic | None = None,
        limits: Limits | None = None,
    ) -> None:
        """Other gains, settings or limits from the next sample on; what was learned stays. Call it between two samples.

        Raises:
            ConfigError: A controller that remembers something else, gains that are unstable; nothing has changed then.
        """
        kinematic = kinematic or self.setup.kinematic
        made = self.setup.controller
        if controller is not None:
            lag, delay = self.setup.lag, self.latency + self.setup.known.margin
            sight, late = self.setup.sight, 0.0 if self.setup.sensor.exact else self.setup.smoothing
            margin, behind = self.setup.known.margin, (tuple(self.setup.interfaces.items()), self.setup.servo)
            given = LoopToSuit(kinematic, self.period, delay, margin, lag, b"", late, sight, *behind)
            made = suited(controller, self.robot, lambda: given)
        setup = replace(self.setup, controller=made, kinematic=kinematic)
        before, self.limits, direction = self.limits, limits or self.limits, self.direction.copy()
        try:
            self._equip(setup, state_from(made, setup.context(), self.state), self.hardware.state)
        except ConfigError:
            self.limits = before
            raise
        self.direction[:] = direction
        if limits is not None:
            self.follower.limit(self.robot, limits)

    def snapshot(self) -> Any:
        """A copy of what was learned, to start another stepper from (`state`)."""
        return state_from(self.setup.controller, self.setup.context(), self.state)

    def delay_margin(self) -> float:
        """Delay from the measurement to the motors at which the loop turns unstable, at the worst posture [s]."""
        return delay_margin(self.judged)

    # -- what it tells -----------------------------------------------------------------------------------------------

    @property
    def robot(self) -> Robot:
        """The robot."""
        return self.setup.robot

    @property
    def direction(self) -> Array:
        """(3,) direction in which u of a base that steers is counted, `base.rolling.Maps.n`; zeros for any."""
        steering = self.control.steering
        return np.zeros(3) if steering is None else steering.maps.n

    @property
    def tripped(self) -> bool:
        """Whether the supervisor has stopped the robot."""
        return bool(self.hardware.way.supervisor.state.tripped[0])

    @property
    def hand(self) -> str:
        """Frame of the hand at which `external_wrench` is told; empty without `touch`."""
        touch = self.setup.touch
        return "" if touch is None else touch.hand or self.robot.hands[0]

    @property
    def is_touched(self) -> bool:
        """Whether there is contact; never without `touch`."""
        touch = self.hardware.touch
        return touch is not None and bool(self.row[self.setup.layout.where("contact")][0])

    @property
    def is_over(self) -> bool:
        """Whether the supervisor has stopped the robot and shown its stop for `safety.stop_time`."""
        return bool(has_ended(self.time, self.hardware.way.supervisor.numbers, self.hardware.way.supervisor.state))

    @property
    def is_moving(self) -> bool:
        """Whether a motion or a joint goal is still under way."""
        return self.follower.is_moving

    @checked
    def finish(
        self, status: Status = "completed", message: str = "", extra: Mapping[str, ArrayLike] | None = None
    ) -> Recording:
        """Close the recording; a run that the supervisor stopped is `tripped`, whatever the status says.

        Args:
            status: How it ended otherwise.
            message: More about it.
            extra: More arrays for the recording's `final`, by names of letters, digits and `_`.

        Raises:
            ConfigError: Another status; a name that `final` cannot have, or has already.
            RecordingError: The file cannot be written; the rows already in it can be read.
        """
        outcome, supervisor = Outcome(status, (self.k + 1) * self.period), self.hardware.way.supervisor
        if self.tripped:
            outcome = Outcome("tripped", *trip_of(supervisor.state, self.robot))
        losses = self.follower.losses
        lost = [f"setpoints were not renewed in time, {losses} times"] if losses else []
        found = [*remarks(supervisor.state, self.robot, outcome.status), *self.told, *lost]
        outcome = replace(outcome, message="; ".join(text for text in (outcome.message, *found, message) if text))
        if self.weighed < self.k + 1:
            self._weigh(self.k + 1)
        final = {"hardware_state": self.hardware.state}
        final |= {"controller_state": self.state.values} if isinstance(self.state, ControllerState) else {}
        for name in extra or {}:
            if not (isinstance(name, str) and re.fullmatch(NAME, name)) or name in final:
                raise ConfigError(f"{shortly(name)} is no name for an array", fix="give another", key="finish.extra")
        outcome = replace(outcome, message=printable(outcome.message))
        return self.recorder.finish(
            with_findings(outcome, self.setup.controller, self.state), {**final, **(extra or {})}
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.recorder.__exit__(kind, error, traceback)

    # -- inside --------------------------------------------------------------------------------------------------------

    def _equip(self, setup: StepperSetup, state: Any, hardware_state: Array | None = None) -> None:
        """Wire controller and supervisor to the row; nothing changes where that fails."""
        robot, layout, plan = setup.robot, setup.layout, plan_outside(setup)
        if self.check_gains:
            require_stable_gains(plan)
        self.fastest = self.limits.of_base(layout)[0]
        of_base = velocity_limits(robot, self.limits.of_base(layout)[:2])
        limits = np.concatenate((of_base, self.limits.of_arm(robot)[:2]), axis=1)
        setup = replace(setup, safety=suited_safety(self.safety, plan, limits, self.limits.samples == "limited"))
        hardware = new_hardware(setup, (robot.rest, np.zeros(layout.dof)), state, hardware_state, plan.steering)
        assert hardware is not None
        if hardware.split is not None:
            limit_commands(hardware.split, limits[0], limits[1], self.latency)
        control = Control(plan, self.row, state, hardware)
        self.setup, self.state, self.hardware, self.control, self.judged = setup, state, hardware, control, plan

    def comply(self, stiffness: ArrayLike, damping: ArrayLike | None = None) -> None:
        """Change the stiffness of a compliant hand from now on.

        Args:
            stiffness: Of its position, one number or one per axis [N/m].
            damping: Likewise [N s/m]; None keeps the damping ratio.

        Raises:
            ConfigError: The hand is stiff, numbers that are negative or not finite, or beyond the bound.
        """
        if self.hardware.task is None:
            raise ConfigError("the hand is stiff", fix="give StepperSettings(impedance=Impedance())", key="impedance")
        soften(self.hardware.task, stiffness, damping)

    def push(self, force: ArrayLike) -> None:
        """Change the force with which a compliant hand pushes, (3,) in the world, from now on [N].

        Raises:
            ConfigError: The hand is stiff or has no force, or numbers that are not finite.
        """
        if self.hardware.task is None:
            raise ConfigError("the hand is stiff", fix="give StepperSettings(impedance=Impedance())", key="impedance")
        set_force(self.hardware.task, force, max(self.time, 0.0))

    def _command(self) -> None:
        """Fill the command from the row and from the servo rows."""
        command, split, (rows, motors) = self.command, self.hardware.split, self.by_effort
        self.motor_torque[:] = self.hardware.way.totals.command
        np.copyto(command.effort, self.torque, where=rows)
        np.copyto(command.motor_effort, self.motor_torque, where=motors)
        if split is not None:
            np.copyto(command.velocity, split.command, where=self.kinds == "velocity")
            np.copyto(command.motor_velocity, product(split.E.T, split.command), where=~motors)
            rolling = self.robot.rolling
            for i, j, motor, pivot in self.placed:
                command.position[i] = command.motor_position[motor] = split.place[j]
                if pivot >= 0 and rolling is not None:
                    now = self.measured.shape[pivot]
                    command.motor_position[motor] = followed(rolling, pivot, split.place[j], now)
            if command.twist.size and self.kinds[0] == "velocity":
                command.twist[:] = self._twist(split)

    def _twist(self, split: Split) -> Array:
        """The base's velocity of a sample, see `Command`; in a stop it brakes along the curve on which it moves."""
        d, steering = self.robot.dimensions, self.control.steering
        if steering is None:
            return split.command[: d.base]
        columns, u = self.robot.base.columns, split.command[: d.base]
        asked = steering.later[0] + steering.later[1] / split.numbers[0, 0]
        if self.tripped:
            asked = product(steering.maps.V[0], u)
        found = asked[columns]
        return found * min(1.0, float(np.min(self.fastest / np.maximum(np.abs(found), TINY))))

    def _see(self) -> None:
        """The last good measurement as the follower reads it."""
        if self.control.steering is None:
            self.seen = self.received
        else:
            see(self.row, self.at, self.control.steering, self.seen)

    def _take(self, measurement: Measurement, time: float, measured: float) -> None:
        """Put a measurement into the row and before the supervisor."""
        supervisor = self.hardware.way.supervisor
        require_shapes("measurement", measurement, self.measured)
        if supervisor.state.good[0] > 0.0 and measured < supervisor.state.heard[0]:
            return
        parts = measurement.pose, measurement.velocity, measurement.q, measurement.qdot, measurement.shape
        np.concatenate(parts, out=self.received, casting="unsafe")
        if math.isnan(measured) or not is_below(self.received, LARGEST):
            self.received[0] = np.nan
        elif not self.setup.sensor.exact:
            observe(self.hardware.sensors, self.measured, self.received)
        when = min(float(measured), time)  # what is old is no basis for a stop by feedback, even if it came just now
        accept(self.row, self.at, when, when, True, supervisor.door)

    def _tell(self, text: str) -> None:
        if text and len(self.told) < MOST_TOLD:
            self.told.append(text)

    def _weigh(self, k: int) -> None:
        """Record the weights as they are before control sample k."""
        self.weighed = k
        if weights := self.setup.controller.weights(self.state):
            self.recorder.weights(k * self.period, weights)

    def _rehearse(self) -> None:
        """Compile all that a step calls, and forget it."""
        kept = self.hardware.state.copy(), self.control.controls.state.copy()
        supervisor = self.hardware.way.supervisor
        is_below(self.received, LARGEST)
        accept(self.row, self.at, 0.0, 0.0, True, supervisor.door)
        self._see()
        self.follower.rehearse(self.seen)
        if isinstance(self.setup.controller, CompiledController | LearningLaw):
            self.control.step(0.0, self.follower.now)
        has_ended(0.0, supervisor.numbers, supervisor.state)
        bring_up(self.row, self.at, 0.0, 0.0, self.follower.guide, self.past, self.control.steering)
        self.past.times[:] = -math.inf
        torque = self.control.torque  # which way u counts is found anew, by learners, too
        for maps in maps_in((self.control.steering, torque.learner, torque.later)):
            maps.n[:] = 0.0
        self.hardware.state[:], self.control.controls.state[:], self.row[:] = *kept, 0.0


def velocity_limits(robot: Robot, limits: Array) -> Array:
    """Limits (k, twist) of a reference's velocities and their rates as of base velocities, (k, nb).

    Of u, n' W eta, they are those along the path; a steering joint has its own.
    """
    base = robot.base
    if not isinstance(base, SteeredBase):
        return limits
    own = limits
    if base.body == STEERED:
        own = np.array([[hypot(limits[0, 0], base.length * limits[0, -1])], [limits[1, 0]]])
    return np.hstack((own, np.full((len(limits), len(base.masters)), np.inf)))


def placed_motors(robot: Robot, placed: Array) -> list[tuple[int, int, int, int]]:
    """Of every motor that takes a position its velocity, its place in `Split.place`, and its pivot if it follows.

    Args:
        robot: The robot.
        placed: (motors,) which take positions.
    """
    d, base, found = robot.dimensions, robot.base, list[tuple[int, int, int, int]]()
    masters, own = (base.masters if isinstance(base, SteeredBase) else []), own_velocities(robot)
    for motor in map(int, np.flatnonzero(placed)):
        arm = motor - (d.motors - d.arm)
        if arm >= 0:
            found.append((d.base + arm, arm, motor, -1))
            continue
        pivot = base.shape.index(robot.actuator_names[motor])
        follows = pivot not in masters
        i = 0 if follows else masters.index(pivot)
        found.append((own + i, d.arm + i, motor, pivot if follows else -1))
    return found


def seconds(value: Any, key: str) -> float:
    """A time of a sample [s] as a number.

    Raises:
        ConfigError: It is none.
    """
    try:
        return float(value)
    except (TypeError, ValueError):
        raise ConfigError(f"{shortly(value)} is no time", fix="give seconds", key=key) from None
