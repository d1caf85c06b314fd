"""The thesis's two-layer network with a prediction error on filtered torque beside the tracking error; see `replay`."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import msgspec
import numpy as np
from scipy.special import expit

from ..errors import ConfigError
from ..settings import Settings, plain, require_at_most, require_numbers
from ..signals import Array, IntArray, Layout
from .controller import CompiledController, Context, ControllerState, Feedback, Law
from .filtered import new_filter, parts
from .inputs import Inputs
from .neural import Neural, layout_of
from .neural_settings import MOST_HIDDEN, TwoLayer
from .replay import Replay

# What every input is on a reference that is followed exactly; the others of `inputs.MEASURED` are zero there.
FOLLOWED = {
    "pose_ref": "pose", "pose": "pose", "q_ref": "q", "q": "q",
    "velocity_ref": "base", "velocity": "base", "alpha": "base", "qdot_ref": "arm", "qdot": "arm", "nu_ref": "nu",
    "acceleration_ref": "base'", "alphadot": "base'", "qddot_ref": "arm'", "nudot_ref": "nu'",
}  # fmt: skip


class Replaying(Settings, frozen=True):
    """How a two-layer network learns from filtered torque.

    Args:
        rate: mu, share of its error that a sample corrects, from 0 to below 2.
        replays: Kept samples that every control sample learns from beside the newest.
        entries: Samples that are kept, evenly over the run; an even number.
        every: Time between two kept samples at first [s].
        pole: Of the low-pass on states and torque ahead of the network [1/s].
        tracking: Factor on the thesis's rates F and G; its e-modification is left out.
        unit: Torque that counts as one, divided by K [m/s, rad/s].
        bound: Bound on |W| in units, and on |V|.
        hidden: Hidden units per network.
        v_range: Half-width of the initial V.

    Raises:
        ConfigError: A number that is negative, not finite or 0 where it must not be, or a rate of 2 or more.
    """

    rate: float = 0.3
    replays: int = 4
    entries: int = 1000
    every: float = 0.02
    pole: float = 60.0
    tracking: float = 0.3
    unit: float = 0.1
    bound: float = 100.0
    hidden: int = 22
    v_range: float = 0.5

    def __post_init__(self) -> None:
        require_numbers(self, "replay", ("entries", "every", "unit", "bound", "hidden"))
        require_at_most(self, "replay", MOST)
        if self.rate >= 2:
            raise ConfigError(f"{self.rate}", why="the error grows", fix="use a rate below 2", key="replay.rate")


MOST = {"entries": 100_000, "replays": 1000, "hidden": MOST_HIDDEN}
NOISE = 0.1  # of a kept sample, in units
UNKNOWN = 0.005  # share of the output's variance left on random motion, above which a run did not excite
SAMPLES = 300  # of random motion
SEEN = Inputs(signals=("q", "velocity", "qdot", "nu_ref", "nudot_ref"), bias=1.0)


@dataclass(frozen=True, eq=False)
class CompositeNetwork(CompiledController):
    """`tau = k s + Psi_hat`, Psi_hat a two-layer network that follows tracking and prediction error.

    Args:
        feedback: k1, k2.
        replaying: The prediction error's numbers.
        network: F and G of the tracking error; hidden units and initial weights are those of `replaying`.
        inputs: What the networks see; (3.24) lacks q, nu and a constant.
        rates: "per_sample" or "per_second", of F and G.
        learning: Off keeps the weights as they are.
        inertia: (p,) effective inertias that the networks are scaled by, as in `Neural`; None for the thesis's form.
        name: Name in tables and recordings.
    """

    feedback: Feedback = field(default_factory=Feedback)
    replaying: Replaying = field(default_factory=Replaying)
    network: TwoLayer = field(default_factory=TwoLayer)
    inputs: Inputs = SEEN
    rates: Any = "per_sample"
    learning: bool = True
    inertia: tuple[float, ...] | None = None
    name: str = "two_layer_composite"

    within_limits: ClassVar[bool] = True

    @property
    def learner(self) -> Neural:
        """The thesis's controller that it adds to: no robust term, no leakage."""
        own = self.replaying
        slower = [tuple(own.tracking * rate for rate in rates) for rates in (self.network.F, self.network.G)]
        changed = {"F": slower[0], "G": slower[1], "hidden": own.hidden, "v_range": own.v_range, "initial": "random"}
        network = msgspec.structs.replace(self.network, **changed)
        return Neural(
            network=network,
            feedback=self.feedback,
            robust=None,
            inputs=self.inputs,
            rates=self.rates,
            learning=self.learning,
            leakage=False,
            inertia=self.inertia,
            called=self.name,
        )

    def law(self, context: Context) -> Law:
        """The network's numbers and those of the prediction error.

        Raises:
            ConfigError: A gain of 0: torques are measured by the gains.
        """
        numbers, layout, own = self.learner.law(context), context.layout, self.replaying
        K, h = self.feedback.vector(layout), float(context.control_period)
        if not (K > 0).all():
            raise ConfigError(f"gains {K.tolist()}", why=f"{self.name} needs all > 0", fix="raise them", key="feedback")
        if not self.learning:
            return numbers
        (scale, offset), scale_out = self.inputs.affine(layout), self.learner.network_scales(layout)[1]
        replay = Replay(
            filter=new_filter(layout, h, 0.0, own.pole),
            first=self.learner.init(context).values.size,
            sizes=numbers.sizes,
            source=self.followed(layout),
            scale=scale,
            offset=offset,
            scale_out=scale_out,
            unit=own.unit * K / scale_out,
            rate=float(own.rate),
            replays=own.replays,
            every=max(1, round(own.every / h)),
            radius=np.full(2, float(own.bound)),
            seen=np.zeros(layout.arm + 2 * layout.dof + layout.pose),
            x=np.zeros(scale.size),
            net=np.zeros(own.hidden),
            sigma=np.zeros(own.hidden),
            error=np.zeros(layout.dof),
        )
        return replace(numbers, replay=replay)

    def followed(self, layout: Layout) -> IntArray:
        """Which of q, nu, nudot, pose every input is where the reference is followed exactly, (nx,); -1 for none."""
        n, p, nb = layout.arm, layout.dof, layout.base
        places = {
            "q": range(n), "base": range(n, n + nb), "arm": range(n + nb, n + p), "nu": range(n, n + p),
            "base'": range(n + p, n + p + nb), "arm'": range(n + p + nb, n + 2 * p), "nu'": range(n + p, n + 2 * p),
            "pose": range(n + 2 * p, n + 2 * p + layout.pose),
        }  # fmt: skip
        found: list[int] = []
        for name in self.inputs.signals:
            where = layout.where(name)
            found += places[FOLLOWED[name]] if name in FOLLOWED else [-1] * (where.stop - where.start)
        return np.array(found + [-1] * bool(self.inputs.bias), np.int64)

    def init(self, context: Context) -> ControllerState:
        """Initial weights, and nothing seen yet."""
        network, layout = self.learner.init(context), context.layout
        nx = network["x"].size
        entries = 2 * -(-self.replaying.entries // 2)
        more = {"counts": (3,), **parts(layout, 0, 0), "kept": (entries, nx + layout.dof)}
        state = ControllerState.of(**network.shapes, **more)
        state.values[: network.values.size] = network.values
        state["counts"][2] = 1.0
        return state

    def feedback_gain(self, layout: Layout) -> Array:
        """K, (p,)."""
        return self.feedback.vector(layout)

    def weights(self, state: ControllerState) -> dict[str, Array]:
        """W1, V1 (base) and W2, V2 (arm)."""
        return self.learner.weights(state)

    def facts(self) -> dict[str, Any]:
        """All settings."""
        own = {"feedback": self.feedback, "replaying": self.replaying, "network": self.network, "inputs": self.inputs}
        more = {"rates": self.rates, "learning": self.learning, "inertia": self.inertia}
        return {name: plain(value) for name, value in own.items()} | plain(more)

    def unknown(self, state: ControllerState) -> Array:
        """Share of the variance of the output that is left on random motion of unit speed, per network.

        The output weights are taken as unknown with a deviation of one unit, the hidden units as they are now, and the
        kept samples as measured to `NOISE` units.
        """
        rng, filled, layout = np.random.default_rng(0), int(state["counts"][1]), layout_of(state)
        n, p = layout.arm, layout.dof
        scale, offset = self.inputs.affine(layout)
        seen = np.hstack(
            (rng.uniform(-np.pi, np.pi, (SAMPLES, n)), rng.standard_normal((SAMPLES, 2 * p + layout.pose)))
        )
        source = self.followed(layout)
        x = offset + scale * np.where(source >= 0, seen[:, source], 0.0)
        found = []
        for i in (name[1:] for name in state.shapes if name[0] == "W"):
            hidden, kept = (expit(points @ state[f"V{i}"]) for points in (x, state["kept"][:filled, : x.shape[1]]))
            P = np.linalg.inv(np.eye(hidden.shape[1]) + kept.T @ kept / NOISE**2)
            found.append(np.einsum("ni,ij,nj->", hidden, P, hidden) / np.sum(hidden**2))
        return np.array(found)

    def findings(self, state: ControllerState) -> list[str]:
        """What the weights show, and whether the run excited what they would have to know of other motions."""
        found = self.learner.findings(state)
        if not self.learning or not np.isfinite(state.values).all() or state["counts"][1] == 0:
            return found
        unknown = float(self.unknown(state).max())
        if unknown <= UNKNOWN:
            return found
        why = "the samples that it kept do not determine its output on random motion"
        return [*found, f"{self.name}: not excited: {why}"]
