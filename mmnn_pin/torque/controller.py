"""The interface of a torque controller: velocity command and measurement in, generalized torque out.

A controller's settings are frozen; what it remembers is a `ControllerState` made by `init` and updated in place, so
that a run can be frozen, resumed, or started twice from equal weights. Controllers of this package are a `Law`: numbers
for a compiled step. A user's own controller is a subclass of `TorqueController` in plain Python.
"""

from __future__ import annotations

import copy
import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import ConfigError
from ..settings import Settings, require_gains
from ..signals import Array, Layout, Measurement, Setpoint, VelocityCommand

if TYPE_CHECKING:
    from .adaptation import Adaptation
    from .linear import Linear
    from .motor_limits import MotorLimits
    from .recall import History
    from .replay import Replay


@dataclass(frozen=True)
class Context:
    """What a controller is told before a run.

    Args:
        layout: Dimensions of the robot and the places of the signals.
        control_period: Time between two control samples [s].
        samples: Number of control samples of the run.
        rng: The controller's own random generator, split from the run's seed.
        regressor: How the robot moves (`model.regressor.Regressor`), for a `LearningLaw` that asks for it; else None.
        limits: What Psi_hat is kept within; None where it is not kept within anything.
    """

    layout: Layout
    control_period: float
    samples: int
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))
    regressor: Any = None
    limits: MotorLimits | None = None


@dataclass
class ControllerState:
    """What a controller remembers between samples: one flat array, and named views into it.

    Attributes:
        values: (size,) everything, float64.
        shapes: Name and shape of each part, in the order in which they stand in `values`.
    """

    values: Array
    shapes: dict[str, tuple[int, ...]] = field(default_factory=dict)

    @classmethod
    def of(cls, **shapes: tuple[int, ...]) -> ControllerState:
        """Zero memory with these parts."""
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

    def snapshot(self) -> ControllerState:
        """Copy that later steps do not touch; hand it to a run to resume from here."""
        return copy.deepcopy(self)


@dataclass(frozen=True)
class Law:
    """A controller as numbers for the compiled step `torque.law.step`.

    Attributes:
        kind: Which law.
        sizes: int64 numbers.
        settings: float64 numbers.
        adaptation: The numbers of an adaptive law, which writes psi_hat before the step; None for the others, whose
            runs do not compile it.
        history: The numbers of a concurrent learner, likewise.
        replay: The numbers of a network's prediction error, likewise.
        linear: The numbers of a linear learner, likewise.
    """

    kind: int
    sizes: NDArray[np.int64]
    settings: Array
    adaptation: Adaptation | None = None
    history: History | None = None
    replay: Replay | None = None
    linear: Linear | None = None


class TorqueController(ABC):
    """A torque controller in plain Python; subclass it to plug in your own.

    Such a controller runs in the ordinary loop only, which is the slower one.

    Attributes:
        name: Name in tables, plots and recordings.
        notes: Things the user should be told before a run.
        within_limits: Whether the loop keeps the Psi_hat that it tells within what the rest of the torque leaves of the
            motors' limits, unless the loop says (see `motor_limits`).
    """

    name: str = "custom"
    within_limits: ClassVar[bool] = False

    @property
    def notes(self) -> list[str]:
        """What a user should know about these settings."""
        return []

    def init(self, context: Context) -> Any:
        """Memory for a new run; None if there is nothing to remember."""
        return None

    @abstractmethod
    def step(
        self, time: float, reference: Setpoint, measurement: Measurement, command: VelocityCommand, state: Any
    ) -> Array | tuple[Array, Array]:
        """Generalized torque of this sample, (p,) [N, N m for the base; N m or N for the arm].

        Or the torque and what of it is an estimate of Psi, (p,), which is recorded, so that it can be judged. The
        records are views that change at the next sample: copy what you keep. `state` is what `init` returned.
        """

    def weights(self, state: Any) -> dict[str, Array]:
        """Named arrays to be recorded at intervals."""
        return {}

    def facts(self) -> dict[str, Any]:
        """Settings that a recording should hold."""
        return {}

    def findings(self, state: Any) -> list[str]:
        """What the memory shows after a run that the user should be told, such as "not excited"."""
        return []


class CompiledController(ABC):
    """A controller of this package: a `Law` and a `ControllerState` for the compiled step.

    Attributes:
        name: Name in tables, plots and recordings.
        within_limits: Whether Psi_hat is kept within what the feedback leaves of the motors' limits, unless the loop
            says (see `motor_limits`); off for the thesis's laws.
    """

    name: str
    within_limits: ClassVar[bool] = False

    @property
    def uses_model(self) -> bool:
        """Whether the law adds Psi of a model: its own, or the loop's nominal robot (the true one: an oracle)."""
        return False

    @property
    def model(self) -> Any:
        """The `Robot` whose Psi the law adds; None for the loop's nominal one."""
        return None

    @property
    def notes(self) -> list[str]:
        """What a user should know about these settings."""
        return []

    @abstractmethod
    def law(self, context: Context) -> Law:
        """The settings as numbers."""

    @abstractmethod
    def init(self, context: Context) -> ControllerState:
        """Memory for a new run."""

    @abstractmethod
    def feedback_gain(self, layout: Layout) -> Array:
        """Constant gain on `[z; r]`, (p,), used to judge the sampled loop before the run."""

    def weights(self, state: ControllerState) -> dict[str, Array]:
        """Named views of what is learned, to be recorded at intervals."""
        return {}

    def facts(self) -> dict[str, Any]:
        """Settings that a recording should hold; of a learner enough for `recorded_learner` to build it again."""
        return {}

    def features(self, law: Law, state: ControllerState) -> Array | None:
        """What the weights were multiplied with at the last step of a law, `Psi_hat = (Phi W).ravel()`.

        (rows, k), a view, with rows times the columns of W equal to p; None where Psi_hat is not linear in the weights.
        """
        return None

    def findings(self, state: ControllerState) -> list[str]:
        """What the memory shows after a run that the user should be told."""
        return []


class Feedback(Settings, frozen=True):
    """Gain on `[z; r]`: `k1` for the base, `k2` for the arm (3.39).

    Args:
        base: k1, one number or one per base velocity [N s/m, N m s; 1/s when scaled].
        arm: k2, one number or one per joint [N m s or N s/m; 1/s when scaled].
        scaling: "none" takes the numbers as they are. "inertia" takes them as bandwidths and multiplies each with the
            effective inertia of its velocity, `1 / (M^-1)_ii` (see `scaled`).

    Raises:
        ConfigError: A gain is negative or not finite.
    """

    base: float | tuple[float, ...] = 500.0
    arm: float | tuple[float, ...] = 30.0
    scaling: Literal["none", "inertia"] = "none"

    def __post_init__(self) -> None:
        require_gains(self, "feedback", "base", "arm")

    def scaled(self, layout: Layout, inertia: Array) -> Feedback:
        """The feedback with its bandwidths turned into gains; itself when it is not to be scaled.

        Every velocity alone then has the bandwidth asked for, a joint of grams like a base of a hundred kilograms, and
        the sampled loop is stable for any M while `bandwidth h p < 2`.

        Args:
            layout: Sizes.
            inertia: (p,) effective inertias [kg, kg m^2].
        """
        if self.scaling == "none":
            return self
        gains = per_velocity(self.base, self.arm, layout, "feedback") * inertia
        return Feedback(*split(gains, layout))

    def vector(self, layout: Layout) -> Array:
        """Gains of all p velocities.

        Raises:
            ConfigError: Neither one number nor as many as velocities, or bandwidths that are not scaled yet.
        """
        if self.scaling != "none":
            raise ConfigError("bandwidths, not gains", fix="call scaled(layout, inertia) first", key="feedback.scaling")
        return per_velocity(self.base, self.arm, layout, "feedback")


def per_velocity(base: float | tuple[float, ...], arm: float | tuple[float, ...], layout: Layout, key: str) -> Array:
    """Numbers of the base and of the arm as one vector (p,).

    Raises:
        ConfigError: Neither one number nor as many as velocities.
    """
    parts = []
    for name, value, size in (("base", base, layout.base), ("arm", arm, layout.arm)):
        if size and np.ndim(value) and np.shape(value) != (size,):
            raise ConfigError(
                f"{np.size(value)} gains for {size} velocities",
                fix="give one number or one per velocity",
                key=f"{key}.{name}",
            )
        parts.append(np.broadcast_to(np.asarray(value, float), (size,)) if size else np.zeros(0))
    return np.concatenate(parts)


def split(values: Array, layout: Layout) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Numbers of all p velocities as those of the base and those of the arm."""
    numbers = tuple(float(value) for value in values)
    return numbers[: layout.base], numbers[layout.base :]
