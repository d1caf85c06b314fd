"""The thesis's controllers: feedback, a network for the base and one for the arm, and a robust term (3.39), (3.50).

    tau = k s + Psi_hat + Kz (|Z| + ZB) s,      s = [z; r]

`torque.two_layer` and `torque.one_layer` have the networks. They see measured and commanded signals only; this module
never imports the model.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Literal, Self

import msgspec
import numpy as np

from ..errors import ConfigError, UnknownName
from ..parts import layout_of
from ..settings import Settings, require_gains
from ..signals import Array, Dimensions, Layout
from . import law
from .controller import (
    Bears,
    CompiledController,
    Context,
    ControllerSettings,
    ControllerState,
    Feedback,
    Law,
    Told,
    all_facts,
    per_velocity,
    read_facts,
    split,
)
from .law import COSINE, SINE, input_of
from .one_layer import OneLayer
from .two_layer import TwoLayer, numerical_rank

# How the weights of a controller start, whatever `two_layer.initial` says.
STARTS: dict[str, Literal["zero", "random"]] = {"two_layer_zero": "zero", "two_layer_random": "random"}
UNIT = 0.1  # torque that counts as one in a bound on W, over the gain on s [m/s, rad/s]


# Input of the networks in the order of (3.24) and of Appendix B.
THESIS_INPUT = ("pose_ref", "alpha", "alphadot", "pose_error", "z", "e", "r", "q_ref", "qdot_ref", "qddot_ref")
# What a network may see: the reference, the measurement and what is computed from them.
MEASURED = (
    *("pose_ref", "velocity_ref", "acceleration_ref", "q_ref", "qdot_ref", "qddot_ref"),
    *("pose", "velocity", "q", "qdot", "shape"),
    *("alpha", "alphadot", "pose_error", "z", "e", "edot", "r", "nu_ref", "nudot_ref"),
)


class Inputs(Settings, frozen=True):
    """The inputs of the networks.

    On a base that steers they end with the cosines and sines of its measured angles: T and all of Psi are functions of
    these, an angle that turns without an end takes no unit out of its range, and a half turn is not lost.

    Args:
        signals: Names of signals, each one measured or computed from measured ones; default (3.24).
        pose_error: Frame of the signal `pose_error`, which (3.24) does not state: "body" (3.1) or "world".
        scale: Factor on every input (180/pi puts joint angles in degrees).
        error_scale: Factor on the error s that teaches, undone at the output: with 180/pi for both the whole network
            works in degrees, and so do its leakage and the norm of its weights.
        bias: A constant input, which (3.24) lacks; 0 for none.
        constant_yaw_rate: Appendix B's slip `wd = (5)`: this number in place of the second component of alpha.

    Raises:
        UnknownName: A signal that does not exist or that a controller may not know.
        ConfigError: A number is not finite, or an error_scale that is not positive.
    """

    signals: tuple[str, ...] = THESIS_INPUT
    pose_error: Literal["body", "world"] = "body"
    scale: float = 1.0
    error_scale: float = 1.0
    bias: float = 0.0
    constant_yaw_rate: float | None = None

    def __post_init__(self) -> None:
        for name in self.signals:
            if name not in MEASURED:
                raise UnknownName("network input", name, MEASURED, key="inputs.signals")
        for name in ("scale", "error_scale", "bias", "constant_yaw_rate"):
            value = getattr(self, name)
            if value is not None and not np.isfinite(value):
                raise ConfigError(f"{value} is not finite", fix="use a finite number", key=f"inputs.{name}")
        if self.error_scale <= 0:
            raise ConfigError(f"{self.error_scale}", fix="use a number > 0", key="inputs.error_scale")

    def rows(self, layout: Layout) -> np.ndarray:
        """Places of the inputs in a row, (nx,) int64; cosine and sine of an angle have the same one."""
        frames, shape = {"pose_error": "world_error"} if self.pose_error == "world" else {}, layout.where("shape")
        where = [layout.where(frames.get(name, name)) for name in self.signals if name != "shape"]
        places = [np.arange(part.start, part.stop) for part in where]
        places += [np.zeros(1, np.int64)] if self.bias else []
        places += [np.repeat(np.arange(shape.start, shape.stop), 2)]
        return np.concatenate(places).astype(np.int64)

    def numbers(self, layout: Layout) -> Array:
        """Scale and offset of every input, (2, nx); of a base that steers also `COSINE` or `SINE`, else 0, (3, nx)."""
        rows, angles = self.rows(layout), 2 * layout.shape
        inputs = np.zeros((3 if angles else 2, rows.size))
        inputs[0], last = self.scale, rows.size - angles - 1
        if self.constant_yaw_rate is not None and layout.base and not (layout.sideways or angles):
            wd = rows == layout.where("alpha").start + 1
            inputs[0, wd], inputs[1, wd] = 0.0, self.constant_yaw_rate
        if self.bias:
            inputs[0, last], inputs[1, last] = 0.0, self.bias
        if angles:
            inputs[2, last + 1 :] = np.tile((COSINE, SINE), layout.shape)
        return inputs

    def seen(self, values: Array, layout: Layout) -> Array:
        """The inputs that the signals at `rows` are, (..., nx)."""
        inputs, x = self.numbers(layout), np.zeros(values.shape)
        for place in np.ndindex(x.shape):
            x[place] = input_of(float(values[place]), inputs, place[-1])
        return x


SEEN = Inputs(signals=("q", "velocity", "qdot", "nu_ref", "nudot_ref"), bias=1.0)  # what Psi is a function of


class Robust(Settings, frozen=True):
    """Robust term `Kz (|Z_hat|_F + ZB) s` (3.50).

    Args:
        base: Kz of the base, one number or one per velocity.
        arm: Kz of the arm, likewise.
        ZB: Bound assumed on the norm of the ideal weights, (base, arm).

    Raises:
        ConfigError: A number is negative or not finite.
    """

    base: float | tuple[float, ...] = 5.0
    arm: float | tuple[float, ...] = 0.2
    ZB: tuple[float, float] = (5.0, 5.0)

    def __post_init__(self) -> None:
        require_gains(self, "robust")

    def scaled(self, layout: Dimensions, inertia: Array) -> Robust:
        """The term with every Kz multiplied with an effective inertia (p,), as `Feedback.scaled` does with k."""
        Kz = per_velocity(self.base, self.arm, layout, "robust") * inertia
        return Robust(*split(Kz, layout), self.ZB)


@dataclass(frozen=True)
class Neural(CompiledController):
    """Feedback, networks and robust term: `tau = k s + Psi_hat + Kz (|Z| + ZB) s` with `s = [z; r]` (3.39), (3.50).

    Args:
        network: `TwoLayer` or `OneLayer`.
        feedback: k1, k2.
        robust: Kz, ZB; None switches the robust term off.
        inputs: What the networks see.
        rates: "per_sample" as in Appendix B, or "per_second" (the rates times the control period, Euler).
        learning: Off keeps the weights as they are.
        leakage: Off drops the e-modification.
        update: "after_output" or "before_output" (Appendix B, with the hidden outputs of the previous call).
        projection: Bound on |W|_F in units and on |V|_F of every network: larger ones are scaled back onto it. A unit
            is what the feedback answers to an error of 0.1 m/s or rad/s, see `radii`. None for no bound.
        inertia: (p,) effective inertias that the networks are scaled by (see `network_scales`); None for the thesis's
            form. The feedback and the robust term are scaled by themselves (`Feedback.scaled`, `Robust.scaled`).
        called: Name in tables and recordings; empty for that of the network.
        adds_model: Whether the Psi of the loop's model is added (`torque.two_layer_residual`).
        within_loop: Whether updates and robust term are cut to what the loop bears of them, see `torque.law`; the
            thesis's are not. Gains that a loop chooses for its robot switch it on.
        bears: As of `CompiledController`.

    >>> robot = load("platform_arm")
    >>> path = Trajectory.of(robot, base=Line(speed=0.3))
    >>> run = Loop(robot, path, Neural(), timing=Timing(duration=0.1)).run()
    >>> bool(abs(run["psi_hat"]).max() > 0.0)
    True
    """

    network: TwoLayer | OneLayer = field(default_factory=TwoLayer)
    feedback: Feedback = field(default_factory=Feedback)
    robust: Robust | None = field(default_factory=Robust)
    inputs: Inputs = field(default_factory=Inputs)
    rates: Literal["per_sample", "per_second"] = "per_sample"
    learning: bool = True
    leakage: bool = True
    update: Literal["after_output", "before_output"] = "after_output"
    projection: float | None = None
    inertia: tuple[float, ...] | None = None
    called: str = ""
    adds_model: bool = False
    within_loop: bool = False
    bears: Bears | None = None

    @property
    def networks(self) -> Neural:
        """The controller of the networks: this one."""
        return self

    @property
    def excited_by(self) -> tuple[str, ...]:
        """The signals of its input."""
        return self.inputs.signals

    @property
    def name(self) -> str:  # type: ignore[override]
        """Name in tables and recordings: the given one, or that of the network."""
        return self.called or self.network.name

    @property
    def notes(self) -> list[str]:
        """Warns of weights that start from zero."""
        if isinstance(self.network, TwoLayer) and self.network.initial == "zero" and self.network.hidden > 1:
            return [
                f"{self.name} starts from zero weights: all {self.network.hidden} hidden units of a network stay equal "
                "for ever, W and V keep rank one; only random ones let it use its units"
            ]
        return []

    def law(self, context: Context) -> Law:
        """The settings as numbers."""
        layout = context.layout
        robust = self.robust or Robust(0.0, 0.0, (0.0, 0.0))
        bounds, Kz = self.radii(layout), per_velocity(robust.base, robust.arm, layout, "robust")
        networks = [(*self.network.rates(i, self.leakage), robust.ZB[i], *bounds[i + 1]) for i in range(2)]
        inputs = self.inputs.numbers(layout)
        as_they_are = (inputs[0] == 1.0).all() and not inputs[1:].any()
        top = np.full(layout.dof, np.inf) if self.bears is None else self.bears.room * self.feedback_gain(layout)
        numbers = law.packed(
            kind=self.network.kind,
            gains=np.array((self.feedback.vector(layout), Kz, *self.network_scales(layout), top)),
            share=math.inf if self.bears is None else self.answer(context),
            learning=self.learning,
            update_first=self.update == "before_output",
            adds_model=self.adds_model,
            dt=1.0 if self.rates == "per_sample" else float(context.control_period),
            networks=np.array(networks, float),
            rows=self.inputs.rows(layout),
            inputs=np.zeros((2, 0)) if as_they_are else inputs,
            layout=layout_of(law.Networks, self.shapes(context)),
        )
        return Law(numbers)

    def shapes(self, context: Context) -> dict[str, tuple[int, ...]]:
        """Weights; and input, hidden outputs, net inputs and error of the last call."""
        nx, h = self.inputs.rows(context.layout).size, self.network.hidden
        shapes: dict[str, tuple[int, ...]] = {"x": (nx,)}
        for i, size in channels(context.layout):
            shapes |= {f"W{i}": (h, size), f"V{i}": (nx, h), f"sigma{i}": (h,), f"net{i}": (h,), f"s{i}": (size,)}
        return shapes

    def init(self, context: Context) -> ControllerState:
        """Initial weights."""
        state = super().init(context)
        for i, _ in channels(context.layout):
            self.network.initialise(state[f"W{i}"], state[f"V{i}"], context.rng)
        return state

    def network_scales(self, layout: Dimensions) -> tuple[Array, Array]:
        """Factors on the s that a network sees and on the torque that it gives, (p,) each; ones without `inertia`.

        With the effective inertias m and their mean c over the network's velocities, `s_i sqrt(m_i / c)` goes in and
        the output times `sqrt(m_i c)` comes out. This is a change of coordinates in which every velocity has the
        inertia 1, the thesis's law (3.39), (3.48)-(3.50) untouched: `s' Psi` is only divided by c, so one set of
        rates suits a joint of grams and a base of a hundred kilograms. `inputs.error_scale` u is a change of unit: u s
        goes in, the output divided by u comes out.

        Raises:
            ConfigError: Not p positive inertias.
        """
        unit = np.full(layout.dof, self.inputs.error_scale)
        if self.inertia is None:
            return unit, 1 / unit
        m = np.array(self.inertia, float)
        if m.shape != (layout.dof,) or not (np.isfinite(m) & (m > 0)).all():
            raise ConfigError(f"{self.inertia}", fix=f"give {layout.dof} inertias > 0", key="inertia")
        parts = (m[: layout.base], m[layout.base :])
        c = np.concatenate([np.full(part.size, part.mean()) for part in parts if part.size])
        return unit * np.sqrt(m / c), np.sqrt(m * c) / unit

    def radii(self, layout: Dimensions) -> dict[int, tuple[float, float]]:
        """Bounds on |W|_F and |V|_F of the base's (1) and the arm's (2) network; inf where nothing is projected.

        W is a torque over the network's scale, so its bound goes with the largest gain that is there from the first
        sample on; V has no unit that the robot knows.

        Raises:
            ConfigError: A projection that is not above 0 or not finite, or one for a network that learns and has no
                gain at all: nothing says which torques are large.
        """
        if self.projection is None or not self.learning:
            return {1: (math.inf, math.inf), 2: (math.inf, math.inf)}
        bound = float(self.projection)
        if not 0 < bound < math.inf:
            raise ConfigError(f"{bound}", fix="use a finite number > 0, None for no bound", key="projection")
        gain = self.feedback_gain(layout) / self.network_scales(layout)[1]
        largest = {1: gain[: layout.base].max(initial=0.0), 2: gain[layout.base :].max(initial=0.0)}
        for i, _ in channels(layout):
            if not largest[i] > 0:
                part, why = ("base", "arm")[i - 1], f"they measure the bound on the weights of {self.name}"
                raise ConfigError(f"all gains of the {part} are 0", why=why, fix="raise one", key=f"feedback.{part}")
        return {i: (bound * UNIT * float(most), bound) for i, most in largest.items()}

    def feedback_gain(self, layout: Dimensions) -> Array:
        """Gain on `[z; r]` that is there from the first sample on: k + Kz ZB, (p,)."""
        robust = self.robust or Robust(0.0, 0.0, (0.0, 0.0))
        ZB = per_velocity(robust.ZB[0], robust.ZB[1], layout, "robust.ZB")
        return self.feedback.vector(layout) + per_velocity(robust.base, robust.arm, layout, "robust") * ZB

    def weights(self, state: ControllerState) -> dict[str, Array]:
        """W1, V1 (base) and W2, V2 (arm); V holds the fixed centres of a one-layer network and is left out there."""
        letters = "WV" if self.network.hidden_learns else "W"
        return {name: state[name] for name in state.shapes if name[0] in letters}

    def facts(self) -> dict[str, Any]:
        """All settings, as JSON has them."""
        return {name: fact for name, fact in all_facts(self).items() if name != "adds_model"}

    @classmethod
    def build(cls, given: ControllerSettings) -> Self:
        """The network of a name, with the switches of the experiment."""
        start = STARTS.get(given.name)
        network = given.settings if start is None else msgspec.structs.replace(given.settings, initial=start)
        return cls(
            network=network,
            feedback=given.feedback,
            learning=given.learning,
            inertia=given.inertia,
            called=given.name,
            **given.networks,
        )

    @classmethod
    def from_facts(cls, name: str, facts: dict[str, Any], told: Told) -> Self | None:
        """The controller of a recording; None where an older version wrote it without settings."""
        if not facts:
            return None
        kind: Any = OneLayer if name == "one_layer" else TwoLayer
        network = msgspec.convert(facts["network"], kind)
        return cls(network=network, **read_facts(cls, facts, *(key for key in facts if key != "network")))

    def findings(self, state: ControllerState) -> list[str]:
        """Findings in the weights after a run: layers that have collapsed to rank one, and those on their bound."""
        layers = {name: W for name, W in self.weights(state).items() if np.isfinite(W).all()}
        collapsed = [name for name, W in layers.items() if min(W.shape) > 1 and numerical_rank(W) == 1]
        held = [] if self.projection is None else self._held(layers, state)
        told = []
        if collapsed:
            told.append(f"{self.name}: {', '.join(collapsed)} ended at rank one: the hidden units act as one")
        if held:
            told.append(f"{self.name}: {', '.join(held)} ended on the bound of learning.projection")
        return told

    def _held(self, layers: dict[str, Array], state: ControllerState) -> list[str]:
        """Which of the layers are on their bound."""
        radii = self.radii(layout_of_state(state))
        most = {f"{letter}{i}": (1 - 1e-9) * pair[k] for i, pair in radii.items() for k, letter in enumerate("WV")}
        return [name for name, W in layers.items() if np.linalg.norm(W) >= most[name]]


def channels(layout: Dimensions) -> list[tuple[int, int]]:
    """Networks of a robot: (1, nb) for the base and (2, n) for the arm, where there is one."""
    return [(i, size) for i, size in ((1, layout.base), (2, layout.arm)) if size]


def layout_of_state(state: ControllerState) -> Layout:
    """Base and arm of the robot that a state with networks is for; other sizes as of one that is just that."""
    base, arm = (state[f"s{i}"].size if f"s{i}" in state.shapes else 0 for i in (1, 2))
    return Layout(base, arm, base + arm, base + arm)
