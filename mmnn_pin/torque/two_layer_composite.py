"""The thesis's two-layer network with a prediction error on filtered torque beside the tracking error.

Over a control period the torque was Psi at the mean state with nu_ref = nu and nudot_ref = nudot (`torque.filtered`):
what the network would see on a reference that the robot follows exactly, its pose error, z, e and r zero. So at

    x* = x(q, nu, nu, nudot)      the network is told     e = tau - W' sigma(V' x*),

and both layers follow e beside s (composite adaptation of a network with an acceleration-free prediction error: Patre,
MacKunis, Johnson, Dixon 2010, IEEE TAC 55(4)), here normalised: with J the derivative of the scaled output,

    W += mu sigma e' / (1 + |J|^2),      V += mu x* (sigma' W e)' / (1 + |J|^2),

so that to first order the error of a sample shrinks by at most mu, for any input. Samples of one motion follow each
other closely, and a network that only follows the newest unlearns the rest: on an eight its frozen weights then explain
nothing. So samples are kept, evenly over the whole run (when there is no more room every second one is dropped), and
each control sample also learns from a few of them (experience replay: Lin 1992, Machine Learning 8; for adaptive
control Chowdhary and Johnson 2010, IEEE CDC).

No guarantee beyond the bounds: V' has the term of `e`, which is not linear in V. |W|, |V| are projected onto balls.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Literal, NamedTuple, Self

import msgspec
import numpy as np
from scipy.special import expit

from ..by_address import by_address
from ..compiled import compiled, copy_to, internal, linked
from ..elementary import exp
from ..errors import ConfigError
from ..parts import Matrix, Vector, layout_of, views
from ..settings import Settings, require_at_most, require_numbers
from ..signals import INDEX, Array, IntArray, Layout
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
    read_facts,
)
from .filtered import Filter, Filtered, new_filter, parts, period, remember
from .law import KERNELS, Kernels, Networks, input_of
from .neural import SEEN, Inputs, Neural, layout_of_state
from .two_layer import MOST_HIDDEN, TwoLayer, shrink

Z, R = INDEX["z"], INDEX["r"]
GOLDEN = 0.6180339887498949  # fractions of its multiples are spread evenly, and in no order
# What every input is on a reference that is followed exactly; the others of `neural.MEASURED` are zero there.
FOLLOWED = {
    "pose_ref": "pose", "pose": "pose", "q_ref": "q", "q": "q",
    "velocity_ref": "base", "velocity": "base", "alpha": "base", "qdot_ref": "arm", "qdot": "arm", "nu_ref": "nu",
    "acceleration_ref": "base'", "alphadot": "base'", "qddot_ref": "arm'", "nudot_ref": "nu'",
}  # fmt: skip
MOST = {"entries": 100_000, "replays": 1000, "hidden": MOST_HIDDEN}
NOISE = 0.1  # of a kept sample, in units
UNKNOWN = 0.005  # share of the output's variance left on random motion, above which a run did not excite
SAMPLES = 300  # of random motion


class TwoLayerCompositeSettings(Settings, frozen=True):
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
        require_numbers(self, "two_layer_composite", ("entries", "every", "unit", "bound", "hidden"))
        require_at_most(self, "two_layer_composite", MOST)
        if self.rate >= 2:
            raise ConfigError(
                f"{self.rate}", why="the error grows", fix="use a rate below 2", key="two_layer_composite.rate"
            )


@by_address
class Experience(NamedTuple):
    """The numbers of a network's prediction error, and room to work in.

    Attributes:
        filter: Of states and torque.
        source: (nx,) which of q, nu, nudot, pose, shape every input is on a reference that is followed exactly; -1
            for 0.
        inputs: As of `LawNumbers`.
        scale_out: (p,) what a network's output is multiplied with, see `Neural.network_scales`.
        unit: (p,) output that counts as 1.
        rate: mu.
        replays: Kept samples that every control sample learns from.
        every: Control samples between two that are kept, until there is no more room.
        radius: Bounds on |W| in units and on |V|.
        seen: (2 n + ..., ) q, nu, nudot, pose, shape of a period.
        x: (nx,) room to work in.
        net: (hidden,) room to work in.
        sigma: (hidden,) room to work in.
        error: (p,) room to work in.
        layout: Of `Experienced` in the state.
    """

    filter: Filter
    source: IntArray
    inputs: Array
    scale_out: Array
    unit: Array
    rate: float
    replays: int
    every: int
    radius: Array
    seen: Array
    x: Array
    net: Array
    sigma: Array
    error: Array
    layout: IntArray


class Experienced(NamedTuple):
    """State of the networks with their kept samples.

    Attributes:
        networks: The networks' own state.
        counts: (3,) samples counted, samples kept, and how many are skipped between two.
        filtered: What the filter remembers.
        kept: (entries, nx + p) inputs and torques that are kept.
    """

    networks: Networks
    counts: Vector
    filtered: Filtered
    kept: Matrix


experienced_of = views(Experienced)


@linked
def estimate(row: Array, at: IntArray, a: Experience, state: Array) -> None:
    """Learn from the last control period and from kept ones.

    Args:
        row: (width,) row of signals.
        at: Offsets of the signals.
        a: The numbers of the law.
        state: The controller's state, see `Experienced`; the output is the networks' own step.
    """
    f, p, nx = a.filter, a.unit.size, a.x.size
    o = experienced_of(state, a.layout)
    counts, kept = o.counts, o.kept
    if period(row, at, f, o.filtered):
        recollect(a)
        for i in range(p):
            f.torque[i] /= a.scale_out[i]
        teach(a, o.networks, a.x, f.torque)
        if int(counts[0]) % (a.every * int(counts[2])) == 0:
            keep_sample(a, counts, kept)
    counts[0] += 1.0
    for i in range(a.replays if counts[1] > 0.0 else 0):
        place = GOLDEN * (counts[0] * a.replays + i)
        sample = kept[int((place - math.floor(place)) * counts[1])]
        teach(a, o.networks, sample[:nx], sample[nx:])


@internal
def recollect(a: Experience) -> None:
    """The input x* of a period, into a.x."""
    f = a.filter
    n, p = f.q.size, f.nu.size
    copy_to(f.q, a.seen[:n])
    copy_to(f.nu, a.seen[n : n + p])
    copy_to(f.nudot, a.seen[n + p : n + 2 * p])
    copy_to(f.pose, a.seen[n + 2 * p : n + 2 * p + f.pose.size])
    copy_to(f.shape, a.seen[n + 2 * p + f.pose.size :])
    for i in range(a.x.size):
        a.x[i] = input_of(a.seen[a.source[i]] if a.source[i] >= 0 else 0.0, a.inputs, i)


@compiled
def keep_sample(a: Experience, counts: Array, kept: Array) -> None:
    """Keep the period just seen; when there is no room (for an even number of them) every second one goes."""
    nx = a.x.size
    if int(counts[1]) == len(kept):
        half = len(kept) // 2
        for i in range(half):
            copy_to(kept[2 * i], kept[i])
        counts[1], counts[2] = half, 2.0 * counts[2]
    sample = kept[int(counts[1])]
    copy_to(a.x, sample[:nx])
    copy_to(a.filter.torque, sample[nx:])
    counts[1] += 1.0


@internal
def teach(a: Experience, o: Networks, x: Array, torque: Array) -> None:
    """One normalised step of base's and arm's network towards a torque (p,) at an input (nx,)."""
    first = 0
    for which in range(2):
        W, V = (o.W1, o.V1) if which == 0 else (o.W2, o.V2)
        m = W.shape[1]
        if m == 0:
            continue
        descend(a, W, V, x, torque[first : first + m], a.unit[first : first + m])
        first += m


@internal
def descend(a: Experience, W: Array, V: Array, x: Array, torque: Array, unit: Array) -> None:
    """One normalised step of one network.

    Args:
        a: The numbers of the law.
        W: (h, m) output weights, updated.
        V: (nx, h) hidden weights, updated.
        x: (nx,) input.
        torque: (m,) that the output should be.
        unit: (m,) what torques are measured by.
    """
    mu = a.rate / squared_slope(a, W, V, x, torque, unit)
    if not math.isfinite(mu):
        return
    net, sigma, e, sum_w, sum_v = a.net, a.sigma, a.error, 0.0, 0.0
    for j in range(W.shape[0]):
        back = 0.0
        for i in range(W.shape[1]):
            back += W[j, i] * e[i] / (unit[i] * unit[i])
            W[j, i] += mu * sigma[j] * e[i]
            part = W[j, i] / unit[i]
            sum_w += part * part
        net[j] = mu * sigma[j] * (1.0 - sigma[j]) * back
    for i in range(x.size):
        for j in range(W.shape[0]):
            V[i, j] += x[i] * net[j]
            sum_v += V[i, j] * V[i, j]
    shrink(W, sum_w, a.radius[0])
    shrink(V, sum_v, a.radius[1])


@internal
def squared_slope(a: Experience, W: Array, V: Array, x: Array, torque: Array, unit: Array) -> float:
    """One and the squares of the output's slopes by all weights; hidden outputs into a.sigma, the error into a.error.

    Arguments as of `descend`.
    """
    h, m, nx = W.shape[0], W.shape[1], x.size
    net, sigma, e = a.net, a.sigma, a.error
    for j in range(h):
        net[j] = 0.0
    for i in range(nx):
        for j in range(h):
            net[j] += V[i, j] * x[i]
    for i in range(m):
        e[i] = torque[i]
    square, inputs = 1.0, 0.0
    for i in range(nx):
        inputs += x[i] * x[i]
    for j in range(h):
        sigma[j] = 1.0 / (1.0 + exp(-net[j]))
        slope = sigma[j] * (1.0 - sigma[j])
        square += sigma[j] * sigma[j]
        for i in range(m):
            e[i] -= W[j, i] * sigma[j]
            part = slope * W[j, i] / unit[i]
            square += inputs * (part * part)
    return square


@linked
def settle(row: Array, at: IntArray, a: Experience, state: Array) -> None:
    """Keep the torque that is held from this sample on."""
    remember(row, at, experienced_of(state, a.layout).filtered)


KERNELS[Experience] = Kernels(estimate, settle)


@dataclass(frozen=True, eq=False)
class TwoLayerComposite(CompiledController):
    """`tau = k s + Psi_hat`, Psi_hat a two-layer network that follows tracking and prediction error.

    Args:
        feedback: k1, k2.
        settings: The prediction error's numbers.
        network: F and G of the tracking error; hidden units and initial weights are those of `settings`.
        inputs: What the networks see; (3.24) lacks q, nu and a constant.
        rates: "per_sample" or "per_second", of F and G.
        learning: Off keeps the weights as they are.
        inertia: (p,) effective inertias that the networks are scaled by, as in `Neural`; None for the thesis's form.
        name: Name in tables and recordings.
        bears: As of `CompiledController`.
    """

    feedback: Feedback = field(default_factory=Feedback)
    settings: TwoLayerCompositeSettings = field(default_factory=TwoLayerCompositeSettings)
    network: TwoLayer = field(default_factory=TwoLayer)
    inputs: Inputs = SEEN
    rates: Literal["per_sample", "per_second"] = "per_sample"
    learning: bool = True
    inertia: tuple[float, ...] | None = None
    name: str = "two_layer_composite"
    bears: Bears | None = None

    within_limits: ClassVar[bool] = True

    @classmethod
    def build(cls, given: ControllerSettings) -> Self:
        """With the rates of the thesis's network, and its own settings."""
        network, own = given.settings
        rates = given.networks["rates"]
        return cls(given.feedback, own, network, rates=rates, learning=given.learning, inertia=given.inertia)

    @classmethod
    def from_facts(cls, name: str, facts: dict[str, Any], told: Told) -> Self | None:
        """From all settings."""
        own = {("settings" if key == "replaying" else key): value for key, value in facts.items()}
        return cls(**read_facts(cls, own, *own)) if own else None

    @property
    def networks(self) -> Neural:
        """The thesis's controller that it adds to: no robust term, no leakage."""
        own = self.settings
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
            bears=self.bears,
        )

    def law(self, context: Context) -> Law:
        """The network's numbers and those of the prediction error.

        Raises:
            ConfigError: A gain of 0: torques are measured by the gains.
        """
        found, layout, own = self.networks.law(context), context.layout, self.settings
        K, h = self.positive_gains(layout), float(context.control_period)
        if not self.learning:
            return found
        inputs, scale_out = self.inputs.numbers(layout), self.networks.network_scales(layout)[1]
        experience = Experience(
            filter=new_filter(context, 0.0, own.pole),
            source=self.followed(layout),
            inputs=inputs,
            scale_out=scale_out,
            unit=own.unit * K / scale_out,
            rate=float(own.rate),
            replays=own.replays,
            every=max(1, round(own.every / h)),
            radius=np.full(2, float(own.bound)),
            seen=np.zeros(layout.arm + 2 * layout.dof + layout.pose + layout.shape),
            x=np.zeros(inputs.shape[1]),
            net=np.zeros(own.hidden),
            sigma=np.zeros(own.hidden),
            error=np.zeros(layout.dof),
            layout=layout_of(Experienced, self.shapes(context)),
        )
        return replace(found, learner=experience)

    def followed(self, layout: Layout) -> IntArray:
        """Which of q, nu, nudot, pose, shape every input is on a reference followed exactly, (nx,); -1 for none."""
        n, p, nb, shape = layout.arm, layout.dof, layout.base, layout.arm + 2 * layout.dof + layout.pose
        if layout.shape and (of_twist := {"velocity_ref", "acceleration_ref"} & set(self.inputs.signals)):
            what, why = f"{min(of_twist)} as an input of {self.name}", "a base that steers has other velocities"
            raise ConfigError(what, why=why, fix="use alpha, alphadot", key="inputs.signals")
        places = {
            "q": range(n), "base": range(n, n + nb), "arm": range(n + nb, n + p), "nu": range(n, n + p),
            "base'": range(n + p, n + p + nb), "arm'": range(n + p + nb, n + 2 * p), "nu'": range(n + p, n + 2 * p),
            "pose": range(n + 2 * p, n + 2 * p + layout.pose),
        }  # fmt: skip
        found: list[int] = []
        for name in (name for name in self.inputs.signals if name != "shape"):
            where = layout.where(name)
            found += places[FOLLOWED[name]] if name in FOLLOWED else [-1] * (where.stop - where.start)
        found += [-1] * bool(self.inputs.bias)
        return np.array(found + np.repeat(np.arange(shape, shape + layout.shape), 2).tolist(), np.int64)

    def shapes(self, context: Context) -> dict[str, tuple[int, ...]]:
        """The networks' state, what the filter remembers, and the kept samples."""
        own, layout = self.networks.shapes(context), context.layout
        entries = 2 * -(-self.settings.entries // 2)
        return {**own, "counts": (3,), **parts(context, 0, 0), "kept": (entries, own["x"][0] + layout.dof)}

    def init(self, context: Context) -> ControllerState:
        """Initial weights, and nothing seen yet."""
        network, state = self.networks.init(context), super().init(context)
        state.values[: network.values.size] = network.values
        state["counts"][2] = 1.0
        return state

    def weights(self, state: ControllerState) -> dict[str, Array]:
        """W1, V1 (base) and W2, V2 (arm)."""
        return self.networks.weights(state)

    def facts(self) -> dict[str, Any]:
        """All settings."""
        return {name: fact for name, fact in all_facts(self).items() if name != "name"}

    def unknown(self, state: ControllerState) -> Array:
        """Share of the variance of the output that is left on random motion of unit speed, per network.

        The output weights are taken as unknown with a deviation of one unit, the hidden units as they are now, and the
        kept samples as measured to `NOISE` units.
        """
        rng, filled, layout = np.random.default_rng(0), int(state["counts"][1]), layout_of_state(state)
        n, p = layout.arm, layout.dof
        layout = replace(layout, shape=state["states"].shape[1] - n - p)
        seen = np.hstack(
            (rng.uniform(-np.pi, np.pi, (SAMPLES, n)), rng.standard_normal((SAMPLES, 2 * p + layout.pose)))
        )
        seen = np.hstack((seen, rng.uniform(-np.pi, np.pi, (SAMPLES, layout.shape))))
        x = self.inputs.seen(np.where(self.followed(layout) >= 0, seen[:, self.followed(layout)], 0.0), layout)
        found = []
        for i in (name[1:] for name in state.shapes if name[0] == "W"):
            hidden, kept = (expit(points @ state[f"V{i}"]) for points in (x, state["kept"][:filled, : x.shape[1]]))
            P = np.linalg.inv(np.eye(hidden.shape[1]) + kept.T @ kept / NOISE**2)
            found.append(np.einsum("ni,ij,nj->", hidden, P, hidden) / np.sum(hidden**2))
        return np.array(found)

    def findings(self, state: ControllerState) -> list[str]:
        """Findings in the weights, and whether the run excited what they would have to know of other motions."""
        found = self.networks.findings(state)
        if not self.learning or not np.isfinite(state.values).all() or state["counts"][1] == 0:
            return found
        unknown = float(self.unknown(state).max())
        if unknown <= UNKNOWN:
            return found
        why = "the samples that it kept do not determine its output on random motion"
        return [*found, f"{self.name}: not excited: {why}"]
