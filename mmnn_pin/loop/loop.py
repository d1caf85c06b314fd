"""The closed loop: setpoints, kinematic layer, torque controller, plant, sensor; every control sample is a row.

`Loop` describes one, checks it and makes a `Plan` of it, by which one of two engines steps: the compiled loop has no
Python in it, the ordinary loop takes any controller and any robot. They call the same blocks. `Loop.run` streams the
rows into a recording.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property, lru_cache, partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ..actuator import Actuator
from ..compiled import one_thread
from ..compliance import Force, Impedance, require_impedance
from ..disturbance import Disturbance, payload, touched_frame
from ..elementary import cos_sin
from ..errors import ConfigError, RobotError, UnknownName, keyed
from ..kinematic import Kinematic
from ..model.base.steered import SteeredBase
from ..model.robot import Robot, carrying
from ..plant.contact.feet import Contact
from ..recording.recorder import Recorder
from ..recording.recording import Outcome, Recording
from ..reference import Trajectory
from ..reference.steerable import require_steerable, start_angles
from ..safety import Safety
from ..sensing import Sensor
from ..settings import Timing, given_array, plain
from ..settings.arguments import checked, faced, require_types
from ..signals import Array, Dimensions, Layout, Setpoint
from ..torque.controller import CompiledController, Context, ControllerState, TorqueController
from ..touch import Touch
from .before_run import Bounds, Start, lags, require_first, require_nominal, require_seed, samples_between
from .compiled import CompiledLoop
from .controller import state_from, with_findings
from .course import Engine, to_the_end, with_remarks
from .latency import Latency
from .lead import delays
from .new_hardware import new_hardware
from .ordinary import OrdinaryLoop
from .plan import Plan
from .reductions import reductions
from .sampled import delay_margin
from .servo import Servo
from .servo_model import linear_servos
from .setup import (
    Sink,
    Streams,
    Watching,
    believed_by,
    facts_of,
    freezes,
    lead_signals,
    new_context,
    new_lead,
    new_streams,
)
from .sight import VelocityFilter
from .stable_gains import require_stable_gains
from .suited import LoopToSuit, suited, timing_for

BLOCK = 250  # most samples that an engine hands over at a time
PLANTS = ("ideal", "contact")


@faced
@dataclass(frozen=True)
class Loop:
    """A closed loop, ready to run.

    Args:
        robot: The true robot, simulated by the plant, except the radii of its wheels (`radii`).
        trajectory: The reference.
        controller: A controller of this package or a `TorqueController` of your own. Gains that you do not give are
            computed from the robot (`loop.suited`), with the delay margin that the latency needs.
        kinematic: Gains of the kinematic layer.
        timing: Periods, and the integrator; by default one that is stable with the robot's friction
            (`suited.timing_for`).
        start: Where the run starts.
        nominal: The model of a controller that uses a model and has none of its own; None for the true robot.
        bounds: Speeds beyond which a run counts as diverged.
        seed: The run's one seed.
        weights_interval: Time between two records of the weights [s].
        check_gains: Refuse gains that make the sampled PD loop alone unstable.
        engine: "compiled", "ordinary", or "auto": compiled where robot and controller can be, which the recording says.
        plant: "ideal", wheels that roll exactly, or "contact", wheels that may slip, in MuJoCo and the ordinary engine.
        contact: The floor of the contact plant.
        sensor: Errors and delays of the sensors; exact by default.
        actuator: Limits and errors of the motors; none by default.
        safety: A supervisor between controller and motors; None for none.
        disturbances: What happens to the robot during the run.
        within_limits: Whether Psi_hat gets only what the feedback leaves of every motor's limit (see `torque.law`);
            None for the controller's own choice: all learners but the thesis's networks do.
        latency: Delays of measurements and commands; gains that are unstable with them are refused.
        interfaces: What motors take, by joint: "velocity" or "position"; "effort" for joints that are not named.
        servo: The servos behind velocity and position interfaces.
        lead: Whether Psi_hat leads by half the control period, the latency of the commands and the motors' lag, see
            `loop.lead`.
        impedance: Compliance of the hand; None for a stiff one. Gains of the kinematic layer are then unused.
        force: Force with which the hand pushes.
        radii: True radii of the drive wheels over the robot's, one factor for all or one per wheel's joint. The plant
            rolls on them; controller, motor commands and wheel odometry use the robot's.
        touch: Observer of external torque, without a force sensor; None for none.

    >>> robot = load("platform_arm")
    >>> path = Trajectory.of(robot, base=Line(speed=0.3), arm={"arm_1_joint": Sine(0.5, period=4.0)})
    >>> run = Loop(robot, path, PD(), timing=Timing(duration=0.1)).run()
    >>> run
    <Recording: pd on platform_arm: completed at t = 0.1 s, 50 rows>
    """

    robot: Robot
    trajectory: Trajectory
    controller: TorqueController | CompiledController
    kinematic: Kinematic = field(default_factory=Kinematic)
    timing: Timing = field(default_factory=Timing)
    start: Start = field(default_factory=Start)
    nominal: Robot | None = None
    bounds: Bounds = field(default_factory=Bounds)
    seed: int = 0
    weights_interval: float = 0.1
    check_gains: bool = True
    engine: Literal["auto", "compiled", "ordinary"] = "auto"
    plant: str = "ideal"
    contact: Contact = field(default_factory=Contact)
    sensor: Sensor = field(default_factory=Sensor)
    actuator: Actuator = field(default_factory=Actuator)
    safety: Safety | None = None
    disturbances: tuple[Disturbance, ...] = ()
    within_limits: bool | None = None
    latency: Latency = field(default_factory=Latency)
    interfaces: Mapping[str, str] = field(default_factory=dict)
    servo: Servo = field(default_factory=Servo)
    lead: bool = False
    radii: float | Mapping[str, float] = 1.0
    impedance: Impedance | None = None
    force: Force | None = None
    touch: Touch | None = None

    def __post_init__(self) -> None:
        require_types(self)
        require_seed(self.seed)
        require_impedance(self.impedance, self.force)
        samples_between(self.weights_interval, self.timing.control_period)
        if self.plant not in PLANTS:
            raise UnknownName("plant", self.plant, PLANTS, key="plant")
        object.__setattr__(self, "timing", timing_for(self.robot, self.timing))
        given = partial(LoopToSuit.of, self, self.trajectory, self.timing, self.robot.dimensions)
        made = suited(self.controller, self.robot, given)
        object.__setattr__(self, "controller", made)

    @cached_property
    def true(self) -> Robot:
        """The true robot; errors as of `Robot.with_radii`."""
        return self.robot if self.radii == 1.0 else self.robot.with_radii(self.radii)

    @cached_property
    def layout(self) -> Layout:
        """Where the signals stand in a row, with those that plant, motors, supervisor and disturbances add."""
        wheels = len(self.robot.base.wheels) if self.plant == "contact" else 0
        task, changed = int(self.impedance is not None), self.true is not self.robot
        more = bool(task) or self.latency.total > 0.0 or bool(self.interfaces) or changed or self.touch is not None
        hardware = int(not self.actuator.perfect or self.safety is not None or bool(self.disturbances) or more)
        hands = 0 if self.trajectory.watched is None else len(self.trajectory.watched.frames)
        recorded = {"lead": lead_signals(self), "hands": hands, "touch": int(self.touch is not None), "task": task}
        recorded["scene"] = int(bool(touched_frame(self.disturbances, self.robot)))
        return Layout.of(self.robot.dimensions, wheels=wheels, hardware=hardware, **recorded)

    @checked
    @one_thread
    def run(
        self,
        path: str | Path | None = None,
        *,
        force: bool = False,
        meta: Mapping[str, Any] | None = None,
        state: Any = None,
        plant_state: tuple[Array, Array] | None = None,
        hardware_state: Array | None = None,
        first: int = 0,
        progress: Callable[[float], None] | None = None,
    ) -> Recording:
        """Run to the end, to divergence or to Ctrl-C; a diverged run is a recording too.

        Args:
            path: File for the recording; None keeps it in memory.
            force: Replace an existing file.
            meta: More facts for the recording.
            state: A controller's state to start from (it is copied); None for a new one.
            plant_state: Position (nv,) and nu (p,) to start from instead of `start`.
            hardware_state: What sensors, motors and supervisor remember (it is copied); None for a new one.
            first: Control sample to start at, one with a measurement; with the states of an earlier run at
                that sample, the run resumes.
            progress: Called now and then with the simulated time [s].

        Raises:
            ConfigError: Gains of wrong shape, or a PD loop that is unstable when sampled; an engine that cannot run
                this; a state of another controller; a first sample outside the run or between two measurements.
            TrajectoryError: A reference that the base cannot follow.
            RecordingError: The recording cannot be written.
        """
        self.require_stable_gains()
        engine = self.engine_at(state, plant_state, first, hardware_state)
        facts = self.facts() | {"loop": engine.name} | dict(meta or {})
        with Recorder(self.layout, facts, path, force, expected=self.timing.samples - first) as recorder:
            outcome = self.stream(engine, recorder, first=first, progress=progress)
            return recorder.finish(with_findings(outcome, self.controller, engine.state), self.final(engine))

    def engine_at(
        self,
        state: Any = None,
        plant_state: tuple[Array, Array] | None = None,
        first: int = 0,
        hardware_state: Array | None = None,
    ) -> Engine:
        """The engine that steps this loop, at its start; arguments as in `run`.

        Raises:
            ConfigError: The engine cannot run this controller; a nominal robot of another shape; a state of another
                controller, a plant's state of wrong shape or not finite, a first sample outside the run or between two
                measurements.
            RobotError: The compiled engine is asked for and the robot cannot be flattened.
            TrajectoryError: A reference that the base cannot follow.
        """
        require_first(self.timing, first)
        require_nominal(self.believed, self.robot)
        if first:
            require_resumable(self.robot)
        plan, state = self.plan(), self.state_from(state)
        dims, ahead = self.robot.dimensions, Setpoint.side_by_side(plan.setpoints[first:], plan.layout)
        if plant_state is None:
            angles = None if plan.hitch.size else start_angles(self.robot.base, ahead)
            position, nu = self.start.state(self.robot, plan.setpoints[first], angles)
            if plan.hitch.size:  # it is the trailer that begins on the reference, its truck straight ahead
                c, s = cos_sin(position[2])
                position[:2] += (plan.hitch[2] + plan.hitch[3]) * np.array([c, s])
            plant_state = position, nu
        position, nu = plant_state
        position, nu = given_array("plant_state", position, (dims.full,)), given_array("plant_state", nu, (dims.dof,))
        arguments = (
            plan,
            position,
            nu,
            state,
            new_hardware(self, (position, nu), state, hardware_state, plan.steering),
        )
        if self.engine == "compiled":
            require_compilable(self)
            return CompiledLoop(*arguments)
        compilable = not isinstance(self.controller, TorqueController) and self.plant == "ideal"
        if self.engine == "auto" and compilable:
            with suppress(RobotError):  # a joint that cannot be flattened
                return CompiledLoop(*arguments)
        return OrdinaryLoop(*arguments)

    def plan(self) -> Plan:
        """The plan of this loop, by which an engine steps it.

        Raises:
            TrajectoryError: A reference that the base cannot follow.
            UnknownName: A payload on a joint that does not exist.
        """
        return Plan(
            robot=self.robot,
            true=self.true,
            layout=self.layout,
            timing=self.timing,
            controller=self.controller,
            context=self.context(),
            believed=self.believed,
            gains=self.kinematic.base_gains(self.layout),
            K=self.kinematic.arm_gains(self.layout),
            bounds=self.bounds.vector(self.layout),
            setpoints=self.table(),
            loaded=self.loaded(),
            contact=self.contact if self.plant == "contact" else None,
            block=max(1, min(BLOCK, round(self.weights_interval / self.timing.control_period))),
            latency=self.latency.total + self.sensor.base_age(self.timing.measurement_period),
            lag=self.actuator.lag,
            sight=VelocityFilter.of(self.sensor, self.timing.measurement_period),
            servo=linear_servos(self.robot, self.interfaces, self.servo, True),
            lead=new_lead(self),
            age=self.latency.caught_up(self.timing),
            touched=touched_frame(self.disturbances, self.robot),
            steering=self.kinematic.steering_of(self.robot, self.timing.control_period),
            freezes=freezes(self),
            hitch=self.kinematic.hitch_of(self.robot, self.robot.rows),
        )

    def require_stable_gains(self) -> None:
        """Judge the sampled PD loop along the reference, unless `check_gains` is off.

        Raises:
            ConfigError: It is unstable, with the numbers.
        """
        if self.check_gains:
            require_stable_gains(self.plan())

    @property
    def delays(self) -> Array:
        """How long the torque of every velocity is known to be under way, half of its hold included, (p,) [s]."""
        return delays(self.robot, self.timing, self.known, self.actuator.lag)

    @property
    def lags(self) -> Array:
        """Known time constants of the motors, seen from the velocities, (p,) [s]."""
        return lags(self.robot, self.actuator.lag)

    @property
    def known(self) -> Latency:
        """The latency as the controller is told it."""
        return self.latency

    @property
    def smoothing(self) -> float:
        """By how much the sensors' filter of velocities is late, and what a slow sensor says is held longer [s]."""
        period = self.timing.measurement_period
        return self.sensor.smoothing(period) + max(0.0, period - self.timing.control_period)

    def delay_margin(self) -> float:
        """Delay between measurement and torque at which the sampled loop turns unstable along the reference [s].

        NaN for a controller in plain Python, whose gains are not known.
        """
        return delay_margin(self.plan())

    def reductions(self) -> list[str]:
        """Lines on its controller that was reduced because the loop bears no more."""
        given = LoopToSuit.of(self, self.trajectory, self.timing, self.robot.dimensions)
        return reductions(self.robot, self.controller, given)

    def rehearse(self) -> None:
        """Ask a controller in plain Python at two samples, with a state that is dropped: what fails, fails now.

        Nothing is done where the loop is compiled.

        Raises:
            InputError: It fails, or returns something of another shape; what `engine_at` refuses.
        """
        engine = self.engine_at()
        if isinstance(engine, OrdinaryLoop):
            engine.rehearse(min(2, self.timing.samples))

    def final(self, engine: Engine) -> dict[str, Array]:
        """Position, nu, and the states of hardware and controller where an engine stands."""
        nv, p, hardware = self.layout.full, self.layout.dof, engine.hardware
        final = {"position": engine.y[:nv], "nu": engine.y[nv : nv + p]}
        final["hardware_state"] = np.zeros(0) if hardware is None else hardware.state
        return final | ({"controller_state": engine.state.values} if isinstance(engine.state, ControllerState) else {})

    def context(self) -> Context:
        """The controller's `Context`, before the run."""
        return new_context(self, self.seed, self.within_limits, self.timing.samples)

    def streams(self) -> Streams:
        """Random generators of the sensors, of the disturbances and of the commands' delays, from the run's seed."""
        return new_streams(self.seed)

    def loaded(self) -> Robot | None:
        """The robot once it has picked up its payload; None without one.

        Raises:
            UnknownName: A payload on a joint that does not exist.
        """
        key, load = payload(self.disturbances)
        if load is None:
            return None
        with keyed(lambda inside: f"{key}.{inside}"):
            return carrying(self.true, load.mass, load.joint, load.at)

    def table(self) -> Array:
        """The reference at every control sample, (samples, ...), in the order of the row's signals.

        Raises:
            TrajectoryError: The base cannot follow it.
        """
        arguments = (self.trajectory, self.timing.samples, self.timing.control_period, self.layout)
        try:
            rows = sampled_reference(*arguments).copy()
        except TypeError:  # a path of arrays has no hash
            rows = sampled_reference.__wrapped__(*arguments)
        times = np.asarray(np.arange(len(rows)) * self.timing.control_period)
        guided = self.kinematic.guide == "trailer"
        require_steerable(self.robot.base, times, Setpoint.side_by_side(rows, self.layout), guided)
        return rows

    def facts(self) -> dict[str, Any]:
        """Facts of this run for its recording."""
        floor = {"contact": plain(self.contact)} if self.plant == "contact" else {}
        watched = self.trajectory.watched
        hands = {} if watched is None else {"hands": dict(watched.frames)}
        radii = {} if self.true is self.robot else {"radii": plain(self.radii)}
        return facts_of(self, self.seed) | {"plant": self.plant} | floor | hands | radii

    @property
    def samples_between_weights(self) -> int:
        """Control samples between two records of the weights."""
        return samples_between(self.weights_interval, self.timing.control_period)

    @property
    def believed(self) -> Robot:
        """The robot that the controller believes in, where it uses a model."""
        return believed_by(self)

    def state_from(self, given: Any = None) -> Any:
        """A copy of a controller's state that fits this loop; a new one for None.

        Raises:
            ConfigError: It is of another controller or of other settings, or not finite.
        """
        return state_from(self.controller, self.context(), given)

    def stream(
        self,
        engine: Engine,
        sink: Sink,
        *,
        first: int = 0,
        progress: Callable[[float], None] | None = None,
        cancelled: Callable[[], bool] = bool,
    ) -> Outcome:
        """Run to the end, block after block of samples, each handed to a sink whatever ends it.

        Args:
            engine: Made by `engine_at`.
            sink: Takes the rows and the weights.
            first: Control sample to start at.
            progress: Called after every block with the simulated time [s].
            cancelled: Asked after every block; true ends the run as interrupted.
        """
        if self.trajectory.watched is not None:
            sink = Watching(sink, self.trajectory.watched.writer(self.robot, self.layout))
        outcome = to_the_end(self, self.samples_between_weights, engine, sink, first, progress, cancelled)
        return with_remarks(outcome, engine, self.robot)


def require_resumable(robot: Robot) -> None:
    """Refuse to go on with a run of a swerve drive: position and nu do not tell which way its u counts.

    Raises:
        ConfigError: It is one.
    """
    if isinstance(robot.base, SteeredBase) and robot.base.agree:
        why = "which way u counts has come about on the way, and is not in its state"
        raise ConfigError("a run of a swerve drive cannot go on", why=why, fix="use first = 0", key="first")


def require_compilable(loop: Loop) -> None:
    """Refuse the compiled engine to a loop with Python or MuJoCo in it (`ConfigError`)."""
    if isinstance(loop.controller, TorqueController):
        what, why, fix = "a controller in plain Python cannot be compiled", "", "use engine = 'auto'"
    elif loop.plant == "contact":
        what, why = "the contact plant cannot be compiled", "MuJoCo steps it, the ordinary loop only"
        fix = "use engine = 'auto', or the ideal plant"
    else:
        return
    raise ConfigError(what, why=why, fix=fix, key="engine")


@lru_cache(maxsize=4)  # runs of a batch mostly share their reference
def sampled_reference(trajectory: Trajectory, samples: int, period: float, layout: Dimensions) -> Array:
    """Rows of a trajectory at all control samples; errors as in `Loop.table`."""
    return trajectory.table(np.arange(samples) * period, layout)
