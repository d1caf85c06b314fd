"""The interface of a torque controller: velocity command and measurement in, generalized torque out.

Settings are frozen; what a controller remembers is a `ControllerState`, so that a run can be resumed, or started twice.
A `CompiledController` is one of this package, a `Law`; a `TorqueController` a user's, in plain Python.
"""

from __future__ import annotations

import copy
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar, Literal, NamedTuple, Protocol, Self, TypeVar, get_type_hints

import msgspec
import numpy as np
from numpy.typing import ArrayLike

from ..errors import ConfigError
from ..parts import fields_of
from ..settings import Numbers, Settings, one_or_each, plain, require_gain
from ..settings.arguments import require_types
from ..signals import Array, Dimensions, Layout, Measurement, Setpoint, VelocityCommand
from .law import MotorLimits, Packed

T = TypeVar("T")
BANDWIDTHS = 30.0, 60.0  # of a base and of joints whose gains are not given [1/s]


class Bears(NamedTuple):
    """How much a sampled loop bears of a learner, beside its feedback K s and `M nudot_ref` (`loop.rates.borne`)."""

    rate: float  # how fast Psi_hat may answer s, over K [1/s]
    room: float  # factor by which the gains may grow
    weight: tuple[float, ...]  # (p,) inertia that a velocity may feel of an estimate, over its gain [s]


@dataclass(frozen=True)
class Context:
    """The context that a controller is given once before a run.

    Args:
        layout: Dimensions of the robot and the places of the signals.
        control_period: Time between two control samples [s].
        samples: Number of control samples of the run.
        rng: The controller's own random generator, split from the run's seed.
        regressor: How the robot moves (`model.regressor.Regressor`), for a `LearningLaw` that asks for it; else None.
        limits: Limits that Psi_hat is kept within; None for none.
        lag: (p,) known time constants of the motors, seen from the velocities [s]; None for none.
        way: Known time from the command of a torque to the measurement that shows it, less what is predicted [s].
        unseen: Further time until velocities show it: prediction, `sensing.Sensor.smoothing`, `latency.margin` [s].
        pose_weights: (nb,) what the squares of the base's velocity errors count in its pose error; None for all alike.
        hidden: (p,) whether a servo hides the torque of a velocity; None for none.
    """

    layout: Layout
    control_period: float
    samples: int
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))
    regressor: Any = None
    limits: MotorLimits | None = None
    lag: Array | None = None
    way: float = 0.0
    unseen: float = 0.0
    pose_weights: Array | None = None
    hidden: Array | None = None

    @property
    def late(self) -> float:
        """All known delays from a torque to the velocities that show it, its hold left out [s]."""
        return max(0.0, self.way) + self.unseen + (0.0 if self.lag is None else float(self.lag.max(initial=0.0)))


@dataclass
class ControllerState:
    """State of a controller between samples.

    Attributes:
        values: (size,) all of it, float64; parts are named views into it.
        shapes: Name and shape of each part, in the order in which they stand in `values`.
    """

    values: Array
    shapes: dict[str, tuple[int, ...]] = field(default_factory=dict)

    @classmethod
    def of(cls, **shapes: tuple[int, ...]) -> ControllerState:
        """Zeros with these parts."""
        return cls(np.zeros(sum(math.prod(shape) for shape in shapes.values())), shapes)

    def __getitem__(self, name: str) -> Array:
        """View of one part."""
        start = 0
        for other, shape in self.shapes.items():
            size = math.prod(shape)
            if other == name:
                return self.values[start : start + size].reshape(shape)
            start += size
        raise KeyError(name)

    def __setitem__(self, name: str, value: ArrayLike) -> None:
        """Write one part in place."""
        self[name][...] = value

    def view(self, kind: type[T]) -> T:
        """The parts that a named tuple of views names, as compiled code sees them (`parts.views`)."""
        return kind(*(self[name] if isinstance(part, int) else self.view(part) for name, part in fields_of(kind)))

    def snapshot(self) -> ControllerState:
        """Copy that later steps do not touch; hand it to a run to resume from here."""
        return copy.deepcopy(self)


@dataclass(frozen=True)
class Law:
    """A controller as numbers for `torque.law`."""

    numbers: Packed  # what the torque is made of
    # what it learns with, a named tuple whose type says which code; None where no more is to be compiled
    learner: Any = None


class MachineLimits(NamedTuple):
    """The machine, as far as it may be known without knowing how the robot moves."""

    velocities: tuple[str, ...]  # (p,) names of the velocities
    lower: Array  # (n,) limits of the arm's joints [rad or m], infinite for none
    upper: Array  # (n,) limits of the arm's joints [rad or m], infinite for none
    # (n,) largest torques of its motors at the joints [N m or N], inf where one of the robot's has no limit
    effort: Array
    # (shape, 2) lower and upper stops of the pivots of a base that steers [rad], infinite for none
    stops: Array = np.zeros((0, 2))

    def typical_shape(self, rng: np.random.Generator) -> Array:
        """Random angles of the pivots within their stops, at most half a turn, (shape,) [rad]."""
        low, high = np.clip(self.stops, -np.pi, np.pi).T
        return np.asarray(rng.uniform(low, high), float)

    @property
    def ranges(self) -> tuple[Array, Array]:
        """Lower and upper ends of the arm's motion, (n,) each; half a turn either way where there are no limits."""
        whole = np.isfinite(self.upper - self.lower)
        return np.where(whole, self.lower, -np.pi), np.where(whole, self.upper, np.pi)

    def strength(self, K: Array) -> float:
        """Torque limits of the arm over its gains, the median of the joints [rad/s]; 0 without limits."""
        n = self.effort.size
        return float(np.median(self.effort / K[-n:])) if n and np.isfinite(self.effort).all() else 0.0


class Told(Protocol):
    """Knowledge of its robot that a controller is given, as the list of controllers grants it (`Entry.told`)."""

    @property
    def motion(self) -> Any:
        """How it moves: a `model.regressor.Regressor`, which knows no masses."""

    @property
    def machine(self) -> MachineLimits:
        """Names, ends of the joints, limits of the motors."""

    @property
    def nominal(self) -> Any:
        """A `Robot` that is not quite the true one."""

    @property
    def parameters(self) -> Array:
        """The parameters of that one in the order of the regressor, (k,)."""

    @property
    def described(self) -> Array:
        """The parameters of the robot as its file describes it, likewise."""


class Feedback(Settings, frozen=True):
    """Gain on `[z; r]`: `k1` for the base, `k2` for the arm (3.39).

    Args:
        base: k1, one number or one per base velocity [N s/m, N m s; 1/s when scaled]; None for what suits the robot.
        arm: k2, one number or one per joint [N m s or N s/m; 1/s when scaled]; None for what suits the robot.
        scaling: "none" takes the numbers as they are. "inertia" takes them as bandwidths and multiplies each with the
            effective inertia of its velocity, `1 / (M^-1)_ii`. `loop.suited` does so for what is None.

    Raises:
        ConfigError: A gain is negative or not finite.

    >>> PD(Feedback(base=300.0, arm=(40.0, 20.0))).feedback.arm
    (40.0, 20.0)
    """

    base: float | tuple[float, ...] | None = None
    arm: float | tuple[float, ...] | None = None
    scaling: Literal["none", "inertia"] = "none"

    def __post_init__(self) -> None:
        for name in ("base", "arm"):
            require_gain(0.0 if getattr(self, name) is None else getattr(self, name), f"feedback.{name}")

    def complete(self, layout: Dimensions) -> bool:
        """Whether every velocity has its gain, as a number that stands for itself."""
        return self.scaling == "none" and self.given(layout)

    def given(self, layout: Dimensions) -> bool:
        """Whether every velocity has its number, a gain or a bandwidth."""
        return not (layout.base and self.base is None) and not (layout.arm and self.arm is None)

    def scaled(self, layout: Dimensions, inertia: Array, share: float = 1.0) -> Feedback:
        """The feedback with its bandwidths turned into gains; itself when there is nothing to turn.

        Every velocity alone then has its bandwidth; the sampled loop is stable for any M while `bandwidth h p < 2`.

        Args:
            layout: Sizes.
            inertia: (p,) effective inertias [kg, kg m^2].
            share: Of `BANDWIDTHS`, for what is None.
        """
        if self.complete(layout):
            return self
        parts, sizes = [], (layout.base, layout.arm)
        for part, own, each in zip(("base", "arm"), split(inertia, layout), BANDWIDTHS, strict=True):
            value = getattr(self, part)
            numbers = one_or_each(share * each if value is None else value, len(own), "velocity", f"feedback.{part}")
            parts.append(numbers * (1.0 if value is not None and self.scaling == "none" else np.array(own)))
        base, arm = (tuple(part.tolist()) if size else None for part, size in zip(parts, sizes, strict=True))
        return Feedback(base, arm)

    def vector(self, layout: Dimensions) -> Array:
        """Gains of all p velocities.

        Raises:
            ConfigError: Neither one number nor as many as velocities, bandwidths that are not scaled yet, or none.
        """
        if self.scaling != "none":
            raise ConfigError("bandwidths, not gains", fix="call scaled(layout, inertia) first", key="feedback.scaling")
        if not self.given(layout):
            why, fix = "a loop or a stepper chooses them for its robot", "give both: Feedback(base=..., arm=...)"
            raise ConfigError("no gains", why=why, fix=fix, key="feedback")
        return per_velocity(self.base or 0.0, self.arm or 0.0, layout, "feedback")


@dataclass(frozen=True)
class ControllerSettings:
    """Settings with which an experiment makes a controller: those common to all of them, and its own."""

    name: str  # name of the controller in the experiment
    settings: Any  # its own table; None for a controller that has none
    feedback: Feedback  # K
    learning: bool  # whether it learns
    told: Told  # what it is told of the robot
    # (p,) effective inertias that networks are scaled by; None for the thesis's form
    inertia: tuple[float, ...] | None = None
    # of the thesis's networks beside: robust, inputs, rates, leakage, update, projection
    networks: dict[str, Any] = field(default_factory=dict)
    gains: Array | None = None  # (samples, p) gains of a PD at an effective gain


class Controller(ABC):
    """Base class of all torque controllers.

    Attributes:
        name: Name in tables, plots and recordings.
        notes: Things the user should be told before a run.
        within_limits: Whether Psi_hat stays within what the feedback leaves of the motors, unless the loop says.
    """

    name: str = "custom"
    within_limits: ClassVar[bool] = False

    @property
    def notes(self) -> list[str]:
        """Notes for the user about these settings."""
        return []

    @abstractmethod
    def init(self, context: Context) -> Any:
        """State for a new run."""

    def weights(self, state: Any) -> dict[str, Array]:
        """Named views of what is learned, to be recorded at intervals."""
        return {}

    def facts(self) -> dict[str, Any]:
        """Settings that a recording should hold; of a learner enough for `from_facts` to make it again."""
        return {}

    def findings(self, state: Any) -> list[str]:
        """Findings in the state after a run that the user should be told, such as "not excited"."""
        return []

    @property
    def networks(self) -> Any:
        """The thesis's controller (`torque.neural.Neural`) where the law has its networks; None where it has none."""
        return None

    @property
    def excited_by(self) -> tuple[str, ...]:
        """Signals of a run by which `lab.psi.excitation` judges what it excited; none where `findings` say it."""
        return ()


class TorqueController(Controller):
    """A torque controller of your own in plain Python: a subclass. Of the engines only the ordinary loop runs it.

    >>> class Damper(TorqueController):
    ...     def step(self, time, reference, measurement, command, state):
    ...         nu = np.concatenate((measurement.velocity, measurement.qdot))
    ...         return np.array([900.0, 150.0, 8.0, 8.0]) * (command.nu_ref - nu)
    >>> robot = load("platform_arm")
    >>> compare(robot, Trajectory.of(robot, base=Line(speed=0.3)), {"damper": Damper()}, duration=0.1)
    <Result: damper completed>
    """

    def init(self, context: Context) -> Any:
        """State for a new run; None if there is nothing to remember."""
        return None

    @abstractmethod
    def step(
        self, time: float, reference: Setpoint, measurement: Measurement, command: VelocityCommand, state: Any
    ) -> Array | tuple[Array, Array]:
        """Generalized torque of this sample, (p,) [N, N m for the base; N m or N for the arm].

        Or the torque and what of it is an estimate of Psi, (p,), to be judged. Views change: copy what you keep.
        """


class CompiledController(Controller):
    """A controller of this package: a `Law` and a `ControllerState` for the compiled step.

    Most are a frozen dataclass with the first three fields, by which they are made, recorded and made again; those that
    learn from s have the fourth.

    Attributes:
        feedback: K.
        settings: The table of the learner.
        learning: Off keeps what is learned as it is.
        bears: What its loop bears of it; a loop or a stepper says it, None where nobody knows the loop.
        by_velocity: Whether it goes by torques of single velocities, and does without those that servos hide.
    """

    feedback: Feedback
    settings: Any
    learning: bool
    bears: Bears | None = None
    by_velocity: ClassVar[bool] = False
    __post_init__ = require_types

    @classmethod
    def build(cls, given: ControllerSettings) -> Self:
        """The controller of an experiment."""
        return cls(feedback=given.feedback, settings=given.settings, learning=given.learning)  # type: ignore[call-arg]

    @classmethod
    def from_facts(cls, name: str, facts: dict[str, Any], told: Told) -> Self | None:
        """The controller of a recording by its name in the experiment; None where its facts do not tell enough.

        `facts` may be those of an older version, and `told` is of the recorded robot.
        """
        names = ("feedback", "settings", "learning")
        return cls(**read_facts(cls, facts, *names, *borne(facts))) if set(names) <= set(facts) else None

    def facts(self) -> dict[str, Any]:
        """Gains and settings; enough for `from_facts`."""
        own = {name: plain(getattr(self, name)) for name in ("feedback", "settings", "learning")}
        return own if self.bears is None else own | {"bears": list(self.bears)}

    def answer(self, context: Context, most: float = 1.0) -> float:
        """Largest answer of a sample to s that the loop bears, as a share of the feedback, at most `most`.

        Answers of every sample are an integral with the rate answer / h. Of a loop that nobody knows it is what an
        integral alone bears: `h / (h + d)` of all known delays d.
        """
        h = context.control_period
        return min(most, h / (h + context.late) if self.bears is None else h * self.bears.rate)

    @property
    def model(self) -> Any:
        """The `Robot` whose Psi the law adds; None for the loop's nominal one."""
        return None

    @property
    def uses_model(self) -> bool:
        """Whether the law adds Psi of a model: its own, or the loop's nominal robot (the true one: an oracle)."""
        return False

    @abstractmethod
    def law(self, context: Context) -> Law:
        """The settings as numbers."""

    def shapes(self, context: Context) -> dict[str, tuple[int, ...]]:
        """Name and shape of every part of the state, in the order in which they are kept."""
        return {}

    def init(self, context: Context) -> ControllerState:
        """State for a new run: zeros, unless the law starts from something else."""
        return ControllerState.of(**self.shapes(context))

    def feedback_gain(self, layout: Dimensions) -> Array:
        """Constant gain on `[z; r]`, (p,), used to judge the sampled loop before the run."""
        return self.feedback.vector(layout)

    def positive_gains(self, layout: Dimensions, why: str = "") -> Array:
        """K (p,) of a law that measures by its gains.

        Raises:
            ConfigError: A gain of 0.
        """
        K = self.feedback.vector(layout)
        if not (K > 0).all():
            raise ConfigError(f"gains {K}", why=why or f"{self.name} needs all > 0", fix="raise them", key="feedback")
        return K

    def features(self, law: Law, state: ControllerState) -> Array | None:
        """The features Phi of the last step, `Psi_hat = (Phi W).ravel()`, a view (rows, k); None if not linear."""
        return None


def borne(facts: Mapping[str, Any]) -> list[str]:
    """The field `bears`, where the facts of a recording have it."""
    return [name for name in facts if name == "bears"]


def all_facts(controller: Any) -> dict[str, Any]:
    """All fields of a controller, as JSON has them."""
    return {f.name: plain(getattr(controller, f.name)) for f in fields(controller)}


def read_facts(kind: type[Any], facts: Mapping[str, Any], *names: str) -> dict[str, Any]:
    """Some of a controller's fields from what a recording tells, of the types that its class declares.

    Raises:
        msgspec.ValidationError: Settings of another version.
    """
    hints = get_type_hints(kind)
    return {name: msgspec.convert(facts[name], hints[name]) for name in names}


def per_velocity(base: Numbers, arm: Numbers, layout: Dimensions, key: str) -> Array:
    """Numbers of the base and of the arm as one vector (p,).

    Raises:
        ConfigError: Neither one number nor as many as velocities.
    """
    parts = (("base", base, layout.base), ("arm", arm, layout.arm))
    each = [one_or_each(x, size, "velocity", f"{key}.{name}") if size else np.zeros(0) for name, x, size in parts]
    return np.concatenate(each)


def split(values: Array, layout: Dimensions) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Numbers of all p velocities as those of the base and those of the arm."""
    return tuple(values[: layout.base].tolist()), tuple(values[layout.base :].tolist())
