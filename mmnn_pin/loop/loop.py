"""The closed loop: reference, kinematic layer, torque controller, plant, sensor; every control sample is a row.

`Loop.run` streams the rows into a recording. One of two engines does the steps (`engines`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ..actuator import Actuator
from ..disturbance import Disturbance, payload
from ..errors import InputError, UnknownName
from ..given_arrays import given_array
from ..kinematic import Kinematic
from ..model.robot import Robot, carrying
from ..one_thread import one_thread
from ..plant.contact.feet import Contact
from ..recording.recorder import Recorder
from ..recording.recording import Outcome, Recording
from ..reference import Trajectory
from ..safety import Safety
from ..sensing import Sensor
from ..settings import plain
from ..signals import Array, Layout
from ..timing import Timing
from ..torque.controller import CompiledController, Context, ControllerState, TorqueController
from ..torque.learning_law import origin_of
from .before_run import require_first, require_nominal, require_stable_gains
from .control import context_of
from .controller_state import state_from, told_with
from .engines import Engine, new_engine
from .ordinary import OrdinaryLoop
from .start import Bounds, Start
from .streaming import Sink, run_to_end, with_remarks

PLANTS = ("ideal", "contact")


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
            `torque.law`); None for what the controller says: learners beyond the thesis do.
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
        hardware = int(not self.actuator.perfect or self.safety is not None or bool(self.disturbances))
        for name in ("robot", "nominal"):
            robot = getattr(self, name)
            if robot is not None and (robot.layout.wheels, robot.layout.hardware) != (wheels, hardware):
                object.__setattr__(
                    self, name, replace(robot, layout=replace(robot.layout, wheels=wheels, hardware=hardware))
                )

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
            state: A controller's memory to start from (it is copied); None for a new one.
            plant_state: Position (nv,) and nu (p,) to start from instead of `start`.
            hardware_state: What sensors, motors and supervisor remember (it is copied); None for a new one.
            first: Control sample to start at, one with a measurement; with the memories and state of an earlier run at
                that sample, the run resumes.
            progress: Called now and then with the simulated time [s].

        Raises:
            ConfigError: Gains of wrong shape, or a PD loop that is unstable when sampled; an engine that cannot run
                this; a memory of another controller; a first sample outside the run or between two measurements.
            TrajectoryError: A reference that the base cannot follow.
            RecordingError: The recording cannot be written.
        """
        require_stable_gains(self)
        engine = self.engine_at(state, plant_state, first, hardware_state)
        facts = self.facts() | {"loop": engine.name} | dict(meta or {})
        with Recorder(self.robot.layout, facts, path, force) as recorder:
            outcome = self.stream(engine, recorder, first=first, progress=progress)
            return recorder.finish(told_with(outcome, self.controller, engine.state), self.final(engine))

    def engine_at(
        self,
        state: Any = None,
        plant_state: tuple[Array, Array] | None = None,
        first: int = 0,
        hardware_state: Array | None = None,
    ) -> Engine:
        """The engine that steps this loop, at its start; arguments as in `run`.

        Raises:
            ConfigError: The engine cannot run this controller; a nominal robot of another shape; a memory of another
                controller, a state of wrong shape or not finite, a first sample outside the run or between two
                measurements.
            RobotError: The compiled engine is asked for and the robot cannot be flattened.
            TrajectoryError: A reference that the base cannot follow.
        """
        require_first(self.timing, first)
        require_nominal(self)
        table, layout, state = self.table(), self.robot.layout, self.state_from(state)
        position, nu = self.start.state(self.robot, table[first]) if plant_state is None else plant_state
        position, nu = given_array("state", position, (layout.full,)), given_array("state", nu, (layout.dof,))
        return new_engine(self, table, position, nu, state, hardware_state)

    def rehearse(self) -> None:
        """Ask a controller in plain Python at two samples, with a memory that is dropped: what fails, fails now.

        Raises:
            InputError: It fails, or returns something of another shape; what `engine_at` refuses.
        """
        engine = self.engine_at()
        assert isinstance(engine, OrdinaryLoop)
        engine.control.hardware = None
        for k in range(min(2, self.timing.samples)):
            engine.control.step(k, k * self.timing.control_period, engine.plant.y, engine.table[k], True)

    def final(self, engine: Engine) -> dict[str, Array]:
        """Position, nu, the hardware's and the controller's state where an engine stands."""
        nv, p = self.robot.layout.full, self.robot.layout.dof
        final = {"position": engine.y[:nv], "nu": engine.y[nv : nv + p], "rig_memory": engine.hardware_state}
        return final | ({"memory": engine.state.values} if isinstance(engine.state, ControllerState) else {})

    def context(self) -> Context:
        """What the controller is told before the run."""
        rng = np.random.default_rng(np.random.SeedSequence(self.seed).spawn(1)[0])
        period, samples = self.timing.control_period, self.timing.samples
        return context_of(self.controller, self.robot, period, samples, rng, self.within_limits)

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
        own |= {"controller_settings": self.controller.facts(), "within_limits": self.context().limits is not None}
        own |= {"law": origin_of(type(self.controller))} if isinstance(self.controller, TorqueController) else {}
        believed = {} if self.nominal is None else {"nominal": self.nominal.facts()}
        hardware = {} if self.sensor.exact else {"sensor": plain(self.sensor)}
        hardware |= {} if self.actuator.perfect else {"actuator": plain(self.actuator)}
        hardware |= {} if self.safety is None else {"safety": plain(self.safety)}
        hardware |= {"disturbances": plain(self.disturbances)} if self.disturbances else {}
        floor = {"contact": plain(self.contact)} if self.plant == "contact" else {}
        return self.robot.facts() | own | believed | hardware | {"plant": self.plant} | floor

    @property
    def believed(self) -> Robot:
        """The robot that the controller believes in, where it uses a model."""
        own: Robot | None = self.controller.model if isinstance(self.controller, CompiledController) else None
        return own or self.nominal or self.robot

    def state_from(self, given: Any = None) -> Any:
        """A copy of a controller's memory that fits this loop; a new one for None.

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
        outcome = run_to_end(self, engine, sink, first, progress, cancelled)
        return with_remarks(outcome, engine, self.robot)


@lru_cache(maxsize=4)  # runs of a batch mostly share their reference
def sampled_reference(trajectory: Trajectory, samples: int, period: float, layout: Layout) -> Array:
    """Rows of a trajectory at all control samples; errors as in `Loop.table`."""
    return trajectory.table(np.arange(samples) * period, layout)
