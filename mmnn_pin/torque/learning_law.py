"""A learning law of your own in plain Python: `tau = K s + Psi_hat`, `s = [z; r]`, with Psi_hat and its learning yours.

    class MyLaw(LearningLaw):
        rate: float = 10.0  # annotated attributes are its settings

        def init(self, context):
            return ControllerState.of(W=(50, context.layout.dof))

        def estimate(self, sample, state):
            return features(sample) @ state["W"]

        def learn(self, sample, state):
            state["W"] += self.rate * sample.period * np.outer(features(sample), sample.s)

The loop does the rest: it adds the feedback, which is the same for all controllers of an experiment, and records
Psi_hat, gains and weights, so that all monitors work. Such a law runs in the ordinary loop and in a `Stepper`.
"""

from __future__ import annotations

import hashlib
import inspect
import math
import sys
import traceback
from abc import abstractmethod
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, dataclass_transform

import numpy as np
from numpy.typing import ArrayLike

from ..errors import ConfigError, InputError, UnknownName
from ..model.regressor import Massless, measured, regress
from ..settings.arguments import require_types
from ..signals import Array, Dimensions, Measurement, Setpoint, VelocityCommand
from .controller import Context, ControllerState, Feedback, TorqueController, all_facts
from .neural import MEASURED

DIGEST = "__mmnn_sha256__"  # of a module: what its file was when it was read


@dataclass_transform(frozen_default=True, kw_only_default=True)
@dataclass(frozen=True, kw_only=True, eq=False)
class LearningLaw(TorqueController):
    """`tau = K s + Psi_hat` with `init`, `estimate` and `learn` of your own.

    Annotated attributes of a child are settings: keyword arguments, and keys of a table `[laws.NAME]` of an experiment.
    A child is frozen; all that changes during a run is in its `ControllerState`, so that it can be frozen, resumed and
    recorded.

    Attributes:
        name: Name in tables and recordings; that of the class unless it says.
        learned: Names of the parts of the state that are weights: they are recorded at intervals, their norm at every
            sample, and a supervisor bounds them. Empty for all parts.
        within_limits: Whether Psi_hat gets only what the feedback leaves of the motors' limits, unless the loop says.
        knows_motion: Whether it gets `sample.regressor`: how the robot moves, not what it weighs.

    Args:
        feedback: K; an experiment gives its own.
        learning: Off holds the weights fixed: `learn` is not called.

    >>> from mmnn_pin.torque.controller import ControllerState
    >>> class Bias(LearningLaw):
    ...     rate: float = 100.0
    ...     def init(self, context):
    ...         return ControllerState.of(bias=(context.layout.dof,))
    ...     def estimate(self, sample, state):
    ...         return state["bias"]
    ...     def learn(self, sample, state):
    ...         state["bias"] += self.rate * sample.period * sample.s
    >>> robot = load("platform_arm")
    >>> path = Trajectory.of(robot, base=Line(speed=0.3))
    >>> compare(robot, path, ["pd", Bias(rate=50.0)], duration=0.1)
    <Result: pd completed, Bias completed>
    """

    feedback: Feedback = field(default_factory=Feedback)
    learning: bool = True

    def __post_init__(self) -> None:
        require_types(self)

    learned: ClassVar[tuple[str, ...]] = ()
    knows_motion: ClassVar[bool] = False
    within_limits: ClassVar[bool] = True

    def __init_subclass__(cls, **more: Any) -> None:
        super().__init_subclass__(**more)
        if "__init__" in cls.__dict__:
            raise TypeError(f"{cls.__name__} has an __init__: write its settings as annotated attributes instead")
        if "name" not in cls.__dict__:
            cls.name = cls.__name__
        dataclass(frozen=True, kw_only=True, eq=False)(cls)

    @abstractmethod
    def init(self, context: Context) -> ControllerState:
        """State for a new run: `ControllerState.of(name=shape, ...)`, zeros to be filled."""

    @abstractmethod
    def estimate(self, sample: Sample, state: ControllerState) -> Array:
        """The estimate of `Psi = M nudot_ref + C nu_ref + gravity + friction` at this sample, (p,) [N, N m]."""

    @abstractmethod
    def learn(self, sample: Sample, state: ControllerState) -> None:
        """Change the state in place; called after `estimate` of the same sample."""

    def features(self, sample: Sample, state: ControllerState) -> Array | None:
        """The features that multiply the weights, if Psi_hat is linear in them; `mmnn prove` reports their excitation.

        (p, k) where all components share the k weights, (k,) where each has its own; None for none of these.
        """
        return None

    @property
    def excited_by(self) -> tuple[str, ...]:
        """All that it may look at, where it gives `features`."""
        return (*MEASURED, "world_error") if type(self).features is not LearningLaw.features else ()

    def gain(self, state: ControllerState) -> ArrayLike | None:
        """Gamma where the law follows s by `W' = Gamma Phi' s + ...`, if it has `features` Phi.

        One number, (k,) for a diagonal or (k, k), positive definite; a sample changes W by the control period times W'.
        With it `mmnn prove` has the weights' part of the Lyapunov function; None leaves that out.
        """
        return None

    def learning_gain(self, state: ControllerState, context: Context) -> ArrayLike | None:
        """The law's Gamma, as `gain` gives it."""
        return self.gain(state)

    def weights(self, state: ControllerState) -> dict[str, Array]:
        """The parts of the state that are `learned`.

        Raises:
            UnknownName: It has no part of that name.
        """
        for part in self.learned:
            if part not in state.shapes:
                raise UnknownName(f"part of the state of {self.name}", part, state.shapes, key="learned")
        return {part: state[part] for part in self.learned or state.shapes}

    def feedback_gain(self, layout: Dimensions) -> Array:
        """K, (p,)."""
        return self.feedback.vector(layout)

    def facts(self) -> dict[str, Any]:
        """All settings, as JSON has them."""
        return all_facts(self)

    def step(
        self, time: float, reference: Setpoint, measurement: Measurement, command: VelocityCommand, state: Any
    ) -> Array:
        """Not for this kind of controller: the loop calls `estimate` and `learn`.

        Raises:
            ConfigError: Always.
        """
        raise ConfigError(f"{self.name} has no step", fix="call estimate and learn, as `loop.sample.Torque` does")


@dataclass(eq=False)
class Sample:
    """One control sample: what is measured and commanded, and what was sent last.

    The arrays are read-only and overwritten at the next one: copy what you keep or change.

    Attributes:
        time: [s].
        period: Control period [s].
        s: (p,) error `[z; r] = nu_ref - nu`.
        nu: (p,) measured velocities.
        first: Whether this is the first sample, of a run or after it was resumed.
        sent: (p,) torque of the control period that has just ended, as the motors were asked for it, supervisor
            included; zeros at the first sample.
        reference: What the robot should do.
        measurement: What the sensors say: pose, velocity, q, qdot.
        command: What the kinematic layer asks for: nu_ref, nudot_ref, alpha, the errors z, e, r ...
    """

    time: float
    period: float
    first: bool
    s: Array
    nu: Array
    sent: Array
    reference: Setpoint
    measurement: Measurement
    command: VelocityCommand
    _torque: Array
    _known: Massless | None
    _written: Array
    _new: bool = True

    @classmethod
    def of(cls, row: Array, context: Context) -> Sample:
        """The samples of a row (width,)."""
        layout, h = context.layout, context.control_period
        seen = read_only(row)
        views = (Setpoint.of(seen, layout), Measurement.of(seen, layout), VelocityCommand.of(seen, layout))
        known = None if context.regressor is None else context.regressor.workspace()
        written = np.zeros((3, layout.dof))
        s, nu, sent = read_only(written)
        return cls(0.0, h, True, s, nu, sent, *views, seen[layout.where("torque")], known, written)

    @property
    def q(self) -> Array:
        """Measured joint angles, (n,) [rad or m]."""
        return self.measurement.q

    @property
    def nu_ref(self) -> Array:
        """Reference velocities, (p,)."""
        return self.command.nu_ref

    @property
    def nudot_ref(self) -> Array:
        """Their time derivative, (p,)."""
        return self.command.nudot_ref

    @property
    def regressor(self) -> Array:
        """The Y of `Psi = Y theta` at this sample, (p, k), a view; for a law with `knows_motion`.

        Raises:
            ConfigError: The law does not ask for it.
        """
        return self.regressor_at(self.q, self.nu, self.nu_ref, self.nudot_ref)

    def regressor_at(self, q: Array, nu: Array, nu_ref: Array, nudot_ref: Array) -> Array:
        """Y at other angles (n,) and velocities (p,), at the measured pose and shape, (p, k); a view, as `regressor`.

        Raises:
            ConfigError: The law does not ask for it.
        """
        if self._known is None:
            raise ConfigError("the law is not told how the robot moves", fix="write knows_motion = True in its class")
        nb, q, nu, seen = self._known.base, np.asarray(q, float), np.asarray(nu, float), self.measurement
        measured(self._known, seen.pose.copy(), nu[:nb].copy(), q.copy(), nu[nb:].copy(), seen.shape.copy())
        regress(self._known, np.array(nu_ref, float), np.array(nudot_ref, float))
        return self._known.Y

    def refresh(self, time: float) -> None:
        """Take in a new sample of the row, before its torque is written."""
        nb, command, measurement = len(self.command.z), self.command, self.measurement
        self.first, self.time = self._new, time
        self._new = False
        s, nu, sent = self._written
        s[:nb], s[nb:] = command.z, command.r
        nu[:nb], nu[nb:] = measurement.velocity, measurement.qdot
        sent[:] = self._torque


def read_only(array: Array) -> Array:
    """A view that cannot be written to: a law that changed a signal would change the feedback or the recording."""
    view = array.view()
    view.flags.writeable = False
    return view


def norms(weights: dict[str, Array], layout: Dimensions) -> tuple[float, float]:
    """Norm of the weights that serve the base, and of those that serve the arm.

    Matrices with a column per velocity are split; whatever else there is counts with the first.
    """
    squares = [0.0, 0.0]
    for array in weights.values():
        split = array.ndim == 2 and array.shape[1] == layout.dof
        first, rest = (array[:, : layout.base], array[:, layout.base :]) if split else (array, array[:0])
        squares[0] += float(np.sum(first * first))
        squares[1] += float(np.sum(rest * rest))
    return math.sqrt(squares[0]), math.sqrt(squares[1])


def origin_of(kind: type[TorqueController]) -> dict[str, Any]:
    """Class, file and hash of the file of a controller; file and hash are empty where there is none.

    The hash is that of the file as it was read, where `experiments.laws` read it.
    """
    file = file_of(kind)
    digest = getattr(sys.modules.get(kind.__module__), DIGEST, "")
    if not digest and file is not None and file.is_file():
        digest = sha256(file.read_bytes())
    return {"class": kind.__qualname__, "file": "" if file is None else str(file), "sha256": digest}


def sha256(content: bytes) -> str:
    """Hash of a file's content."""
    return hashlib.sha256(content).hexdigest()


def file_of(kind: type[TorqueController]) -> Path | None:
    """The file in which a class is written; None for one that was typed in."""
    try:
        return Path(inspect.getfile(kind)).absolute()
    except (TypeError, OSError):
        return None


def blamed(error: BaseException, controller: TorqueController) -> InputError:
    """An error of a controller in plain Python, told in one line with the place in its file."""
    return told(error, f"controller '{controller.name}' failed", file_of(type(controller)))


def told(error: BaseException, what: str, file: Path | None) -> InputError:
    """An error in one line, with the innermost line of a file that it passed through."""
    lines = [(Path(f.filename).absolute(), f.lineno) for f in traceback.extract_tb(error.__traceback__)]
    if isinstance(error, SyntaxError) and error.filename:
        lines.append((Path(error.filename).absolute(), error.lineno))
    line = next((number for where, number in reversed(lines) if where == file), None)
    text = error.msg if isinstance(error, SyntaxError) else str(error)
    return InputError(what, why=" ".join(f"{type(error).__name__}: {text}".split()), file=file, line=line)
