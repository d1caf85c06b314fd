"""The setup that a loop or a stepper is made from, and its facts for a recording.

`Setup` is what the blocks between controller and robot need to know; a `Loop` has all of it. `StepperSetup` is the same
for a robot that is not simulated: its plant, sensors and motors are real, so all that would simulate them is off.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from ..actuator import Actuator
from ..compliance import Force, Impedance, require_impedance
from ..disturbance import Disturbance
from ..kinematic import Kinematic
from ..model.robot import Robot
from ..safety import Safety
from ..sensing import Sensor
from ..settings import Numbers, Timing, plain, require_gain
from ..signals import SIGNALS, Array, Layout
from ..torque.controller import CompiledController, Context, TorqueController
from ..torque.learning_law import origin_of
from ..touch import Touch
from .before_run import lags, require_nominal
from .controller import context_of
from .latency import Latency
from .lead import Lead, delays, lead_of, leads
from .plan import Plan
from .servo import Servo, hidden_torques
from .servo_model import linear_servos
from .sight import VelocityFilter
from .suited import postures

# What only a simulated plant knows; a recording from outside does not have these signals.
UNKNOWN = (
    "position", "nu", "true_pose_error", "true_z", "true_e", "psi", "applied", "disturbance",
    "injected", "energy", "work", "energy_residual",
)  # fmt: skip
KNOWN = [name for name, *_ in SIGNALS if name not in UNKNOWN]
Streams = tuple[np.random.Generator, np.random.Generator, np.random.Generator]


class Setup(Protocol):
    """The setup that the hardware model is made from; a `Loop` has all of it."""

    @property
    def robot(self) -> Robot:
        """The robot, as controller and sensors take it."""

    @property
    def true(self) -> Robot:
        """The true robot, which may roll on wheels of other radii."""

    @property
    def layout(self) -> Layout:
        """Where the signals stand in a row."""

    @property
    def nominal(self) -> Robot | None:
        """The robot that the controller believes in."""

    @property
    def timing(self) -> Timing:
        """Periods."""

    @property
    def plant(self) -> str:
        """Name of the plant."""

    @property
    def kinematic(self) -> Kinematic:
        """Gains of the kinematic layer."""

    @property
    def controller(self) -> CompiledController | TorqueController:
        """The torque controller."""

    @property
    def sensor(self) -> Sensor:
        """The sensors."""

    @property
    def actuator(self) -> Actuator:
        """The motors and gears."""

    @property
    def safety(self) -> Safety | None:
        """The supervisor."""

    @property
    def disturbances(self) -> tuple[Disturbance, ...]:
        """The disturbances of the robot."""

    @property
    def latency(self) -> Latency:
        """How long measurements and commands are under way."""

    @property
    def interfaces(self) -> Mapping[str, str]:
        """Interface of motors' joints, effort where they are not named."""

    @property
    def impedance(self) -> Impedance | None:
        """How the hand gives way; None for one that is stiff."""

    @property
    def force(self) -> Force | None:
        """The force that the hand pushes with."""

    @property
    def servo(self) -> Servo:
        """The servos of velocity interfaces, as far as they are known."""

    @property
    def lead(self) -> bool:
        """Whether Psi_hat leads."""

    @property
    def touch(self) -> Touch | None:
        """The observer of external torque; None for nothing."""

    @property
    def delays(self) -> Array:
        """How long the torque of every velocity is known to be under way, half of its hold included, (p,) [s]."""

    @property
    def lags(self) -> Array:
        """Known time constants of the motors, seen from the velocities, (p,) [s]."""

    @property
    def known(self) -> Latency:
        """The latency as the controller is told it."""

    @property
    def smoothing(self) -> float:
        """By how much measured velocities are known to be late: `Sensor.smoothing`, and a slow sensor's hold [s]."""

    def streams(self) -> Streams:
        """Random generators of the sensors, of the disturbances and of the commands' delays."""

    def context(self) -> Context:
        """The context that the controller is given before a run."""


def new_context(setup: Setup, seed: int, within_limits: bool | None, samples: int) -> Context:
    """The context of the controller of a setup, for a run of some samples; `within_limits` as of `context_of`."""
    context = Context(
        layout=setup.layout,
        control_period=setup.timing.control_period,
        samples=samples,
        rng=np.random.default_rng(np.random.SeedSequence(seed).spawn(1)[0]),
        lag=setup.lags,
        way=setup.known.way(setup.timing),
        unseen=unseen_by(setup),
        pose_weights=setup.kinematic.pose_weights(setup.robot.dimensions),
        hidden=hidden_torques(setup.robot, setup.interfaces, setup.servo),
    )
    return context_of(setup.controller, setup.robot, context, within_limits)


def unseen_by(setup: Setup) -> float:
    """See `Context.unseen` [s]."""
    return setup.known.caught_up(setup.timing) + setup.smoothing + setup.known.margin


def lead_signals(setup: Setup) -> int:
    """1 where the rows of a setup have what is sent of Psi_hat beside it, else 0."""
    return int(setup.lead and leads(setup.controller))


def freezes(setup: Setup) -> bool:
    """Whether contact keeps the learner of a setup from learning."""
    return setup.touch is not None and setup.touch.learning != "on"


def new_lead(setup: Setup) -> Lead | None:
    """How the controller of a setup looks ahead; None where it does not. Errors as of `lead_of`."""
    if not setup.layout.lead:
        return None
    return lead_of(
        setup.controller, setup.context(), setup.delays, setup.known.sensing - setup.known.caught_up(setup.timing)
    )


def new_streams(seed: int) -> Streams:
    """Random generators of the sensors, of the disturbances and of the commands' delays, split from a run's seed."""
    sensor, gusts, delays = map(np.random.default_rng, np.random.SeedSequence(seed).spawn(4)[1:])
    return sensor, gusts, delays


def believed_by(setup: Setup) -> Robot:
    """The robot that a controller believes in, where it uses a model."""
    own: Robot | None = setup.controller.model if isinstance(setup.controller, CompiledController) else None
    return own or setup.nominal or setup.robot


def facts_of(setup: Setup, seed: int) -> dict[str, Any]:
    """Facts of a run for its recording."""
    own = {"controller": setup.controller.name, "seed": seed, "control_period": setup.timing.control_period}
    own |= {"kinematic": plain(setup.kinematic), "time": plain(setup.timing)}
    own |= {"controller_settings": setup.controller.facts(), "within_limits": setup.context().limits is not None}
    if isinstance(setup.controller, TorqueController):
        own |= {"law": origin_of(type(setup.controller))}
    believed = {} if setup.nominal is None else {"nominal": setup.nominal.facts()}
    hardware = {} if setup.sensor.exact else {"sensor": plain(setup.sensor)}
    hardware |= {} if setup.actuator.perfect else {"actuator": plain(setup.actuator)}
    hardware |= {} if setup.latency == Latency() else {"latency": plain(setup.latency)}
    hardware |= {"interfaces": dict(setup.interfaces), "servo": plain(setup.servo)} if setup.interfaces else {}
    hardware |= {"lead": setup.delays.tolist()} if setup.layout.lead else {}
    hardware |= {"lag": setup.lags.tolist()} if setup.lags.any() else {}
    hardware |= {"way": way} if (way := setup.known.way(setup.timing)) else {}
    hardware |= {"unseen": unseen_by(setup)}
    hardware |= {} if setup.impedance is None else {"impedance": plain(setup.impedance)}
    hardware |= {} if setup.force is None else {"force": plain(setup.force)}
    hardware |= {} if setup.touch is None else {"touch": plain(setup.touch)}
    hardware |= {} if setup.safety is None else {"safety": plain(setup.safety)}
    hardware |= {"disturbances": plain(setup.disturbances)} if setup.disturbances else {}
    return setup.robot.facts() | own | believed | hardware


@dataclass(frozen=True)
class StepperSetup:
    """The setup of a robot that is not simulated, its latency neither; arguments as of `stepper.Stepper`."""

    robot: Robot
    controller: CompiledController | TorqueController
    kinematic: Kinematic
    safety: Safety
    timing: Timing
    nominal: Robot | None = None
    seed: int = 0
    within_limits: bool | None = None
    plant: str = "ideal"
    sensor: Sensor = field(default_factory=Sensor)
    actuator: Actuator = field(default_factory=Actuator)
    disturbances: tuple[Disturbance, ...] = ()
    latency: Latency = field(default_factory=Latency)
    interfaces: Mapping[str, str] = field(default_factory=dict)
    servo: Servo = field(default_factory=Servo)
    lead: bool = False
    known: Latency = field(default_factory=Latency)
    lag: Numbers = 0.0
    filtered: float = 0.0
    impedance: Impedance | None = None
    force: Force | None = None
    touch: Touch | None = None

    def __post_init__(self) -> None:
        require_gain(self.filtered, "filtered")
        require_impedance(self.impedance, self.force)

    @cached_property
    def layout(self) -> Layout:
        """Where the signals stand in a row."""
        recorded = {"touch": int(self.touch is not None), "task": int(self.impedance is not None)}
        return Layout.of(self.robot.dimensions, hardware=1, lead=lead_signals(self), **recorded)

    @property
    def true(self) -> Robot:
        """See `Setup.true`; nobody knows better."""
        return self.robot

    @property
    def delays(self) -> Array:
        """See `Setup.delays`."""
        return delays(self.robot, self.timing, self.known, self.lag)

    @property
    def lags(self) -> Array:
        """See `Setup.lags`."""
        return lags(self.robot, self.lag)

    @property
    def sight(self) -> VelocityFilter | None:
        """How velocities are measured, as far as it is known."""
        period = self.timing.measurement_period
        return (
            VelocityFilter.late(self.filtered, period) if self.sensor.exact else VelocityFilter.of(self.sensor, period)
        )

    @property
    def smoothing(self) -> float:
        """See `Setup.smoothing`; an observer makes velocities of its own."""
        return self.filtered if self.sensor.exact else self.sensor.smoothing(self.timing.measurement_period)

    def streams(self) -> Streams:
        """Random generators that nothing draws from."""
        return new_streams(self.seed)

    def context(self) -> Context:
        """The context that the controller is given."""
        return new_context(self, self.seed, self.within_limits, 1)


def plan_outside(setup: StepperSetup) -> Plan:
    """The plan of a stepper, for the check of its gains: at some postures in place of its setpoints.

    Raises:
        ConfigError: A nominal robot that is another one.
    """
    robot, layout, believed = setup.robot, setup.layout, believed_by(setup)
    require_nominal(believed, robot)
    gains, K = setup.kinematic.base_gains(layout), setup.kinematic.arm_gains(layout)
    bounds, context = np.full(layout.dof, np.inf), setup.context()
    blocks = setup.timing, setup.controller, context, believed, gains, K, bounds, postures(robot)
    steering = setup.kinematic.steering_of(robot, setup.timing.control_period)
    plan, servo = Plan(robot, robot, layout, *blocks), linear_servos(robot, setup.interfaces, setup.servo, False)
    return replace(
        plan,
        latency=setup.known.total,
        lag=setup.lag,
        sight=setup.sight,
        servo=servo,
        lead=new_lead(setup),
        steering=steering,
        freezes=freezes(setup),
    )


# -- what takes the rows of a run --------------------------------------------------------------------------------------


class Sink(Protocol):
    """A taker of the rows of a run: a `Recorder`, or a `Reducer` that keeps only sums."""

    def append_block(self, rows: Array, step_times: Array) -> None:
        """Take rows (k, width) and the wall-clock time of each (k,) [s]."""

    def weights(self, time: float, arrays: Mapping[str, Array]) -> None:
        """Take a snapshot of the weights at a time [s]."""


@dataclass(frozen=True)
class Watching:
    """A sink that writes where frames are into the rows before it hands them on."""

    sink: Sink
    write: Callable[[Array], None]

    def append_block(self, rows: Array, step_times: Array) -> None:
        """See `Sink`."""
        self.write(rows)
        self.sink.append_block(rows, step_times)

    def weights(self, time: float, arrays: Mapping[str, Array]) -> None:
        """See `Sink`."""
        self.sink.weights(time, arrays)
