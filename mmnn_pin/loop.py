"""The closed loop: reference, kinematic layer, torque controller, plant, sensor; every control sample is a row.

`Loop.run` streams the rows into a recording. Two engines do the steps: the compiled loop, without Python in it, and
the ordinary loop, which takes any controller and any robot. They call the same blocks.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np

from .actuator import Actuator
from .compiled_loop import CompiledLoop
from .control import findings_of, wiring_of
from .disturbance import Disturbance, payload
from .errors import ConfigError, InputError, RobotError, UnknownName
from .kinematic import Kinematic
from .model.dynamics import Dynamics
from .model.payload import carrying
from .model.robot import Robot
from .one_thread import one_thread
from .ordinary_loop import OrdinaryLoop
from .plant.contact.floor import Contact
from .recorder import Recorder
from .recording import Outcome, Recording
from .reference import Trajectory
from .safety import HAS_TRIPPED, TRIPPED, Safety, remarks, trip_of
from .sampled import require_stable, sampled_loop, viscous_friction
from .sensing import Sensor
from .settings import plain
from .signals import INDEX, SIGNALS, Array, Layout
from .start import FIRST_REFERENCE, Bounds, Start
from .timing import Timing
from .torque.controller import CompiledController, Memory, TorqueController, Wiring
from .torque.learning_law import LearningLaw
from .torque.origin import blamed, origin_of

Engine = CompiledLoop | OrdinaryLoop
PLANTS = ("ideal", "contact")


class Sink(Protocol):
    """What takes the rows of a run: a `Recorder`, or a `Reducer` that keeps only sums."""

    def append_block(self, rows: Array, step_times: Array) -> None:
        """Take rows (k, width) and the wall-clock time of each (k,) [s]."""

    def weights(self, time: float, arrays: Mapping[str, Array]) -> None:
        """Take a snapshot of the weights at a time [s]."""


@dataclass(frozen=True)
class Loop:
    """A closed loop, ready to run.

    Args:
        robot: The true robot, simulated by the plant.
        trajectory: What it should do.
        controller: A controller of this package or a `TorqueController` of your own.
        kinematic: Gains of the kinematic layer.
        timing: Periods.
        start: Where the run starts.
        nominal: The robot that a controller believes in which uses a model and brings none; None for the true one.
        bounds: Where a state counts as lost.
        seed: The run's one seed.
        weights_interval: Time between two records of the weights [s].
        check_gains: Refuse gains that make the sampled PD loop alone unstable.
        engine: "compiled", "ordinary", or "auto": compiled where robot and controller can be, which the recording says.
        plant: "ideal", wheels that roll exactly, or "contact", wheels that may slip, in MuJoCo and the ordinary engine.
        contact: The floor of the contact plant.
        sensor: What the sensors do to the truth; exact by default.
        actuator: What the motors make of their commands; perfect by default.
        safety: A supervisor between controller and motors; None for none.
        disturbances: What happens to the robot during the run.
        within_limits: Whether Psi_hat takes of every motor's limit only what the feedback leaves (see
            `torque.motor_limits`); None for what the controller says: learners beyond the thesis do.
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

    def __post_init__(self) -> None:
        """The rows of both robots have the signals that plant, motors, supervisor and disturbances add."""
        if self.plant not in PLANTS:
            raise UnknownName("plant", self.plant, PLANTS, key="plant")
        wheels = len(self.robot.base.wheels) if self.plant == "contact" else 0
        rig = int(not self.actuator.perfect or self.safety is not None or bool(self.disturbances))
        for name in ("robot", "nominal"):
            robot = getattr(self, name)
            if robot is not None and (robot.layout.wheels, robot.layout.rig) != (wheels, rig):
                object.__setattr__(self, name, replace(robot, layout=replace(robot.layout, wheels=wheels, rig=rig)))

    @one_thread
    def run(
        self,
        path: str | Path | None = None,
        *,
        force: bool = False,
        meta: Mapping[str, Any] | None = None,
        memory: Any = None,
        state: tuple[Array, Array] | None = None,
        rig_memory: Array | None = None,
        first: int = 0,
        progress: Callable[[float], None] | None = None,
    ) -> Recording:
        """Run to the end, to divergence or to Ctrl-C; a diverged run is a recording too.

        Args:
            path: File for the recording; None keeps it in memory.
            force: Replace an existing file.
            meta: More facts for the recording.
            memory: A controller's memory to start from (it is copied); None for a new one.
            state: Position (nv,) and nu (p,) to start from instead of `start`.
            rig_memory: What sensors, motors and supervisor remember (it is copied); None for a new one.
            first: Control sample to start at, one with a measurement; with the memories and state of an earlier run at
                that sample, the run resumes.
            progress: Called now and then with the simulated time [s].

        Raises:
            ConfigError: Gains of wrong shape, or a PD loop that is unstable when sampled; an engine that cannot run
                this; a memory of another controller; a first sample outside the run or between two measurements.
            TrajectoryError: A reference that the base cannot follow.
            RecordingError: The recording cannot be written.
        """
        self.require_stable_gains()
        engine = self.engine_at(memory, state, first, rig_memory)
        facts = self.facts() | {"loop": engine.name} | dict(meta or {})
        with Recorder(self.robot.layout, facts, path, force) as recorder:
            outcome = self.judged(self.stream(engine, recorder, first=first, progress=progress), engine.memory)
            return recorder.finish(outcome, self.final(engine))

    def engine_at(
        self,
        memory: Any = None,
        state: tuple[Array, Array] | None = None,
        first: int = 0,
        rig_memory: Array | None = None,
    ) -> Engine:
        """The engine that steps this loop, at its start; arguments as in `run`.

        Raises:
            ConfigError: The engine cannot run this controller; a nominal robot of another shape; a memory of another
                controller, a state of wrong shape or not finite, a first sample outside the run or between two
                measurements.
            RobotError: The compiled engine is asked for and the robot cannot be flattened.
            TrajectoryError: A reference that the base cannot follow.
        """
        self._require_first(first)
        self.require_nominal()
        table, layout, memory = self.table(), self.robot.layout, self.memory_from(memory)
        position, nu = self.start.state(self.robot, table[first]) if state is None else state
        position, nu = finite("state", position, (layout.full,)), finite("state", nu, (layout.dof,))
        return self._engine(table, position, nu, memory, rig_memory)

    def rehearse(self) -> None:
        """Ask a controller in plain Python at two samples, with a memory that is dropped: what fails, fails now.

        Raises:
            InputError: It fails, or returns something of another shape; what `engine_at` refuses.
        """
        engine = self.engine_at()
        assert isinstance(engine, OrdinaryLoop)
        engine.control.rig = None
        for k in range(min(2, self.timing.samples)):
            engine.control.step(k, k * self.timing.control_period, engine.plant.y, engine.table[k], True)

    def judged(self, outcome: Outcome, memory: Any) -> Outcome:
        """An outcome whose message also tells what the controller's memory shows after the run."""
        if outcome.status == "interrupted":
            return outcome
        findings = findings_of(self.controller, memory)
        return replace(outcome, message="; ".join(text for text in (outcome.message, *findings) if text))

    def final(self, engine: Engine) -> dict[str, Array]:
        """Position, nu, the rig's and the controller's memory where an engine stands."""
        nv, p = self.robot.layout.full, self.robot.layout.dof
        state = {"position": engine.y[:nv], "nu": engine.y[nv : nv + p], "rig_memory": engine.rig_memory}
        return state | ({"memory": engine.memory.values} if isinstance(engine.memory, Memory) else {})

    def wiring(self) -> Wiring:
        """What the controller is told before the run."""
        rng = np.random.default_rng(np.random.SeedSequence(self.seed).spawn(1)[0])
        period, samples = self.timing.control_period, self.timing.samples
        return wiring_of(self.controller, self.robot, period, samples, rng, self.within_limits)

    def streams(self) -> tuple[np.random.Generator, np.random.Generator]:
        """Random generators of the sensors and of the disturbances, split from the run's seed."""
        sensor, gusts = np.random.SeedSequence(self.seed).spawn(3)[1:]
        return np.random.default_rng(sensor), np.random.default_rng(gusts)

    def loaded(self) -> Robot | None:
        """The robot once it has picked up its payload; None without one.

        Raises:
            UnknownName: A payload on a joint that does not exist.
        """
        key, load = payload(self.disturbances)
        if load is None:
            return None
        try:
            return carrying(self.robot, load.mass, load.joint, load.at)
        except InputError as error:
            error.key = f"{key}.{error.key}"
            raise

    def table(self) -> Array:
        """The reference at every control sample, (samples, ...), in the order of the row's signals.

        Raises:
            TrajectoryError: The base cannot follow it.
        """
        arguments = (self.trajectory, self.timing.samples, self.timing.control_period, self.robot.layout)
        try:
            return sampled_reference(*arguments).copy()
        except TypeError:  # a path of arrays has no hash
            return sampled_reference.__wrapped__(*arguments)

    def facts(self) -> dict[str, Any]:
        """What a recording should know of this run."""
        own = {"controller": self.controller.name, "seed": self.seed, "control_period": self.timing.control_period}
        own |= {"kinematic": plain(self.kinematic), "time": plain(self.timing)}
        own |= {"controller_settings": self.controller.facts(), "within_limits": self.wiring().limits is not None}
        own |= {"law": origin_of(type(self.controller))} if isinstance(self.controller, TorqueController) else {}
        believed = {} if self.nominal is None else {"nominal": self.nominal.facts()}
        rig = {} if self.sensor.exact else {"sensor": plain(self.sensor)}
        rig |= {} if self.actuator.perfect else {"actuator": plain(self.actuator)}
        rig |= {} if self.safety is None else {"safety": plain(self.safety)}
        rig |= {"disturbances": plain(self.disturbances)} if self.disturbances else {}
        floor = {"contact": plain(self.contact)} if self.plant == "contact" else {}
        return self.robot.facts() | own | believed | rig | {"plant": self.plant} | floor

    @one_thread
    def require_stable_gains(self) -> None:
        """Judge the sampled PD loop at ten places along the reference.

        Raises:
            ConfigError: It is unstable at one of them, with the numbers.
        """
        if not self.check_gains or not isinstance(self.controller, CompiledController | LearningLaw):
            return
        layout, dynamics, table = self.robot.layout, Dynamics(self.robot), self.table()
        gains = self.controller.feedback_gain(layout)
        base_gains, K = self.kinematic.base_gains(layout.base), self.kinematic.arm_gains(layout)
        h = max(self.timing.control_period, self.timing.sensor_period or 0.0)  # a slow sensor holds the torque, too
        start = layout.offsets[FIRST_REFERENCE]
        velocity = slice(*(layout.offsets[INDEX["velocity_ref"] + i] - start for i in (0, 1)))
        friction = viscous_friction(self.robot)
        for i in np.unique(np.linspace(0, len(table) - 1, 10).astype(int)):
            position, _ = Start().state(self.robot, table[i])
            M = dynamics.mass_matrix(position)
            verdict = sampled_loop(M, gains, table[i, velocity], base_gains, K, h, friction)
            require_stable(verdict, gains, self.robot.velocity_names, h)

    def _require_first(self, first: int) -> None:
        timing = self.timing
        if not 0 <= first < timing.samples or first * timing.steps_per_control % timing.steps_per_measurement:
            raise ConfigError(
                f"cannot start at control sample {first}",
                why=f"the run has {timing.samples}, and a held measurement is not part of the state",
                fix="choose one of them at which there is a measurement",
                key="first",
            )

    @property
    def believed(self) -> Robot:
        """The robot that the controller believes in, where it uses a model."""
        own: Robot | None = self.controller.model if isinstance(self.controller, CompiledController) else None
        return own or self.nominal or self.robot

    def require_nominal(self) -> None:
        """Refuse a nominal robot of another shape.

        Raises:
            ConfigError: It has another base or other joints.
        """
        believed = replace(self.believed.layout, wheels=self.robot.layout.wheels, rig=self.robot.layout.rig)
        if believed != self.robot.layout:
            raise ConfigError(
                f"the nominal robot has {believed}, the robot {self.robot.layout}",
                fix="use one with the same base and the same joints",
                key="nominal",
            )

    def memory_from(self, given: Any = None) -> Any:
        """A copy of a controller's memory that fits this loop; a new one for None.

        Raises:
            ConfigError: It is of another controller or of other settings, or not finite.
        """
        new = self._new_memory()
        if given is None:
            return new
        if not isinstance(new, Memory):
            return copy.deepcopy(given)
        if not isinstance(given, Memory) or given.shapes != new.shapes:
            is_of = given.shapes if isinstance(given, Memory) else type(given).__name__
            raise ConfigError(
                f"not a memory of {self.controller.name} with these settings",
                why=f"it is {is_of}, not {new.shapes}",
                fix="use one made by its init",
                key="memory",
            )
        new.values[:] = finite("memory", given.values, new.values.shape)
        return new

    def _new_memory(self) -> Any:
        """What the controller's `init` gives.

        Raises:
            InputError: It fails, or a learning law gives something else than a `Memory`.
        """
        if isinstance(self.controller, CompiledController):
            return self.controller.init(self.wiring())
        try:
            new = self.controller.init(self.wiring())
        except InputError:
            raise
        except Exception as error:
            raise blamed(error, self.controller) from error
        if isinstance(self.controller, LearningLaw):
            if not isinstance(new, Memory):
                what = f"{self.controller.name}.init returned {type(new).__name__}"
                raise ConfigError(what, why="a law learns in a `Memory`", fix="return Memory.of(name=shape, ...)")
            self.controller.weights(new)
        return new

    def _engine(self, table: Array, position: Array, nu: Array, memory: Any, rig_memory: Array | None) -> Engine:
        block = max(1, min(250, round(self.weights_interval / self.timing.control_period)))
        if isinstance(self.controller, TorqueController):
            if self.engine == "compiled":
                raise ConfigError(
                    "a controller in plain Python cannot be compiled", fix="use engine = 'auto'", key="engine"
                )
            return OrdinaryLoop(self, table, position, nu, memory, rig_memory, block)
        if self.plant == "contact":
            if self.engine == "compiled":
                why, fix = "MuJoCo steps it, the ordinary loop only", "use engine = 'auto', or the ideal plant"
                raise ConfigError("the contact plant cannot be compiled", why=why, fix=fix, key="engine")
            return OrdinaryLoop(self, table, position, nu, memory, rig_memory, block)
        if self.engine != "ordinary":
            try:
                return CompiledLoop(self, table, position, nu, memory, rig_memory, block)
            except RobotError:
                if self.engine == "compiled":
                    raise
        return OrdinaryLoop(self, table, position, nu, memory, rig_memory, block)

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
        outcome = self._stream(engine, sink, first, progress, cancelled)
        found = engine.plant.findings() if isinstance(engine, OrdinaryLoop) else []
        if engine.rig is not None and engine.rig.supervised:
            found = remarks(engine.rig.guard, self.robot, outcome.status) + found
        return replace(outcome, message="; ".join(text for text in (outcome.message, *found) if text))

    def _stream(
        self,
        engine: Engine,
        sink: Sink,
        first: int,
        progress: Callable[[float], None] | None,
        cancelled: Callable[[], bool],
    ) -> Outcome:
        memory, k, h, samples = engine.memory, first, self.timing.control_period, self.timing.samples
        every = max(1, round(self.weights_interval / h))
        try:
            while k < samples:
                if k % every == 0 and (weights := self.controller.weights(memory)):
                    sink.weights(k * h, weights)
                engine.counter[0] = 0
                try:
                    bad = engine.advance(k, min(k + len(engine.rows), (k // every + 1) * every, samples))
                finally:
                    done = int(engine.counter[0])
                    sink.append_block(engine.rows[:done], engine.step_times[:done])
                    k += done
                if bad == TRIPPED:
                    break
                if bad >= 0:
                    return diverged(engine.row, self.robot.layout, bad, k * h, sink)
                if progress is not None:
                    progress(k * h)
                if cancelled():
                    return Outcome("interrupted", k * h, message=f"stopped at t = {k * h:g} s")
        except KeyboardInterrupt:
            return Outcome("interrupted", k * h, message="stopped by Ctrl-C")
        if weights := self.controller.weights(memory):
            sink.weights(k * h, weights)
        if engine.rig is not None and engine.rig.supervised and engine.rig.guard[HAS_TRIPPED]:
            return Outcome("tripped", *trip_of(engine.rig.guard, self.robot))
        return Outcome("completed", samples * h)


@lru_cache(maxsize=4)  # runs of a batch mostly share their reference
def sampled_reference(trajectory: Trajectory, samples: int, period: float, layout: Layout) -> Array:
    """Rows of a trajectory at all control samples; errors as in `Loop.table`."""
    return trajectory.table(np.arange(samples) * period, layout)


def finite(key: str, values: Any, shape: tuple[int, ...]) -> Array:
    """Copy of an array that must be finite and of a shape.

    Raises:
        ConfigError: It is not.
    """
    array = np.array(values, float)
    if array.shape != shape or not np.isfinite(array).all():
        what = f"of shape {array.shape}" if array.shape != shape else "not finite"
        raise ConfigError(f"an array that is {what}", fix=f"give finite numbers of shape {shape}", key=key)
    return array


def diverged(row: Array, layout: Layout, column: int, time: float, sink: Sink) -> Outcome:
    """Outcome of a run whose row went bad at a column; a row that is still finite is kept."""
    i = int(np.searchsorted(layout.offsets, column, side="right") - 1)
    signal, value = f"{SIGNALS[i][0]}[{column - layout.offsets[i]}]", row[column]
    if np.isfinite(row).all():
        sink.append_block(row[None], np.zeros(1))
    why = "left its bounds" if np.isfinite(value) else "is not finite"
    return Outcome("diverged", time, signal, f"{signal} {why} ({value:.3g}) at t = {time:g} s")
