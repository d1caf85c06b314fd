"""Slotine-Li adaptive control with estimates that stay physical: settings, compiled law, controller.

    tau = Y theta_hat + K s,    V = s' M s / 2 + sum_b D(P_b || P_hat_b) / gamma_b + sum_j theta_tilde_j^2 / (2 gamma_j)

The controller knows how the robot moves (`model.regressor`, Y), never what it weighs: it starts from a prior or from
the parameters of a nominal robot that it is given as numbers. With P the pseudo-inertia of a body
(`torque.pseudo_inertia`), the log-det Bregman divergence `D(P || Q) = log |Q| / |P| + tr(Q^-1 P) - 4` and L the
symmetric matrix of `tr(dP L) = s' Y dtheta`, the natural law of Lee, Kwon, Park 2018 (IEEE/RSJ IROS) is

    P_hat' = gamma P_hat L P_hat,       so that      d/dt D(P || P_hat) = -gamma s' Y (theta - theta_hat)

and V' = -s' K s. gamma [1/J] does not depend on frames or units; each body has its own, by the gains of what moves it
(`prior.tempo`). The rest, rotors and friction, follows the plain gradient `theta_hat_j' = gamma_j Y_j' s`.

Begun with a fit (`start`), it moves by how sure the parameters are. With Sigma their covariance and Gamma the metric
above at the start,

    theta_hat' = (Gamma(theta_hat)^-1 + Lambda)^-1 Y' s, Lambda = (DOUBT^2 g^-1/2 Sigma^-1 g^-1/2 - Gamma(theta_0)^-1)_+

with g the diagonal of `rate` times every parameter's tempo, so that the gain at the start is `g^1/2 Sigma g^1/2` over
`DOUBT^2` where the fit tells something, and that of no fit where it does not (`DOUBT`, of a body: then D / gamma is
`DOUBT^2 / gamma` times minus the logarithm of the fit's prior). The gain's inverse is the Hessian of the sum of the
potentials of D / gamma and of `theta' Lambda theta / 2` (mirror descent: Wensing and Slotine 2020, IEEE L-CSS 4(1)), so
`V + theta_tilde' Lambda theta_tilde / 2` in the place of V has V' = -s' K s as before.

Leakage (sigma-modification, Ioannou and Kokotovic 1984; times |s| the e-modification of Narendra and Annaswamy 1987)
pulls the dual variable to its start, `d/dt P_hat^-1 = -gamma L + sigma (P_0^-1 - P_hat^-1)`: by the three-point
identity V' gains exactly `-sigma / gamma (D(P || P_hat) + D(P_hat || P_0) - D(P || P_0))`.

Sampling: within one sample the estimate answers s with the torque `h Y Gamma Y' s`, a feedback that is late. All rates
of a sample are multiplied with `eta = min(1, share s' K s / (h s' Y Gamma Y' s))`, so that it stays below a share of
the feedback proper, the least eta of all velocities and of those of base and arm alone: else noise of a strong base
lets a light arm be answered with more (Ioannou and Sun 1996, Robust Adaptive Control). Where it is less than 1,
V' = -s' K s + (1 - eta) s' Y theta_tilde, and what holds are the bounds: clipping the eigenvalues of
`P_0^-1/2 P_hat P_0^-1/2` is the projection in D: D(P || P_hat) never grows for a P within the bounds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np

from ..by_address import by_address
from ..compiled import compiled, internal, linked
from ..elementary.matrices import cholesky, inverse, product, solve, svd
from ..errors import ConfigError
from ..model.regressor import Massless, measured, regress
from ..parts import Matrix, Vector, layout_of, views
from ..settings import Settings, require_numbers
from ..signals import INDEX, Array, IntArray
from .controller import Context, ControllerState, Law
from .law import KERNELS, Kernels, constant_gain, nothing_to_keep
from .prior import (
    DOUBT,
    ParameterLearner,
    balls,
    gains_of,
    inertia_of_bodies,
    lightness,
    prior_of,
    require_one_start,
    scales,
    tempo,
)
from .pseudo_inertia import BODY, Bodies, directions, lifted, move, natural, pseudo_inertias, vector_of

POSE, VELOCITY, Q, QDOT, SHAPE = (INDEX[name] for name in ("pose", "velocity", "q", "qdot", "shape"))
NU_REF, NUDOT_REF, Z, R = (INDEX[name] for name in ("nu_ref", "nudot_ref", "z", "r"))
PSI_HAT, EFFECTIVE_GAIN, WEIGHT_NORM = INDEX["psi_hat"], INDEX["effective_gain"], INDEX["weight_norm"]
TAKEN = 0.01  # how often a sample is taken for the excitation [s]
EXCITED = 1e-3  # share of what random motion of unit speed excites, above which a direction counts as excited


class AdaptiveSettings(Settings, frozen=True):
    """How an adaptive controller learns.

    The rates are in units of energy: a body's estimate moves by its own size where `rate` times the work that its error
    does in a sample is one. They hold for gains of 500 N s/m (forward velocity of the base) and of 30 N m s (joints of
    the arm) and `prior.tempo` scales them for others: light arms, and light joints, have little energy. Friction is
    measured by `c_j = 1 / (t_j K^-1 t_j')`, the feedback gain that joint j with the row t_j of T feels.

    Args:
        rate: gamma of the pseudo-inertias [1/J].
        viscous: Rate of viscous friction; gamma_j is `viscous c_j^2` [s^2/J rad^2, 1/s^2 J m^2].
        coulomb: Rate of dry friction; gamma_j is `coulomb c_j^2` [1/J].
        rotor: Rate of the rotors' inertias; gamma_j is `rotor c_j^2`. Mostly a link's own inertia says the same: 0.
        leakage: sigma, how fast the estimate is pulled back to its start [1/s].
        share: Largest answer of one sample to s, as a share of the feedback; rates that ask for more are cut, and so is
            what the loop does not bear (`loop.rates.borne`).
        modification: "sigma" leaks always, "e" in proportion to |s|.
        bounds: The largest ratio of an estimate to its start, either way.
        heaviest: The largest ratio of an estimate to a body of `mass` and `size`, where it starts from these. Too light
            an estimate gives too little feedforward; too heavy a one acts as feedback, through the feedback inside
            nudot_ref, and noise of velocities drives it up. A prior that was made lighter may grow as much more.
        friction_bound: Largest friction that is believed: viscous in c_j, dry in c_j times 1 rad/s or m/s.
        initial: "prior" for balls of `mass` and `size` at every joint without friction; "nominal" for a robot's (in an
            experiment the one of `[nominal]`).
        start: A file `NAME.identified.json` of `mmnn identify` in place of both: it begins with the parameters found
            there, and moves those less that are sure by their covariance; without leakage.
        mass: Masses of the prior, (base, every other body) [kg].
        size: Radii of gyration of the prior about each axis, likewise [m].
        slowest: The prior is made lighter where the inertia that a velocity feels of it is more than this times its
            gain, or than the loop bears [s]; see `torque.prior`.
        slowest_learned: Bound on the weight of a body that starts from the prior: the inertia that a velocity feels of
            it is at most this times its gain, and at most what the loop bears [s]: the feedback inside nudot_ref of a
            heavier one would not be stable.

    Raises:
        ConfigError: A number that is negative, not finite or 0 where it must not be.
    """

    rate: float = 100.0
    viscous: float = 1.0
    coulomb: float = 10.0
    rotor: float = 0.0
    leakage: float = 0.0
    share: float = 1.0
    modification: Literal["sigma", "e"] = "sigma"
    bounds: float = 100.0
    heaviest: float = 10.0
    friction_bound: float = 10.0
    initial: Literal["prior", "nominal"] = "prior"
    start: str = ""
    mass: tuple[float, float] = (30.0, 2.0)
    size: tuple[float, float] = (0.3, 0.2)
    slowest: float = 0.3
    slowest_learned: float = 1000.0

    def __post_init__(self) -> None:
        require_numbers(self, "adaptive", ("mass", "size", "slowest", "slowest_learned"))
        for name in ("bounds", "heaviest"):
            if not getattr(self, name) > 1:
                raise ConfigError(f"{getattr(self, name)}", fix="use a finite ratio > 1", key=f"adaptive.{name}")
        require_one_start(self, "adaptive")
        if self.start and self.leakage:
            why = "the covariance of `start` holds what is known"
            raise ConfigError(f"{self.leakage:g}", why=why, fix="use 0", key="adaptive.leakage")


@by_address
class Adaptation(NamedTuple):
    """The numbers of an adaptive controller."""

    known: Massless  # the robot without its masses; `known.Y` (p, k) is written by `model.tree.regressor.regress`
    gain: Array  # (p,) K of `tau = K s + Psi_hat` [N s/m, N m s/rad; N m s/rad or N s/m]
    learning: bool  # off keeps the estimate
    tracking: float  # factor on the gradient of the tracking error, 1 without a prediction error
    sigma: float  # leakage [1/s]
    by_error: bool  # whether leakage is multiplied with |s|
    share: float  # largest answer of a sample, as a share of the feedback
    stride: int  # every how many samples `Y' Y` is added to the state
    bodies: Bodies  # the metric of the estimate
    gradient: Array  # (k,) room to work in
    layout: IntArray  # of `Estimate` in the state


class Estimate(NamedTuple):
    """State of an adaptive controller: theta (k,), the number of samples, the sum of `Y' Y` (k, k)."""

    theta: Vector
    samples: Vector
    gram: Matrix


estimate_of = views(Estimate)


@linked
def estimate(row: Array, at: IntArray, a: Adaptation, state: Array) -> None:
    """Psi_hat at the measured state, then the update of theta."""
    look(row, at, a.known)
    adapt(row, at, a, estimate_of(state, a.layout))


@internal
def look(row: Array, at: IntArray, known: Massless) -> None:
    """Y at a sample, into known.Y."""
    velocity, q = row[at[VELOCITY] : at[Q]], row[at[Q] : at[QDOT]]
    qdot, shape = row[at[QDOT] : at[QDOT + 1]], row[at[SHAPE] : at[SHAPE + 1]]
    measured(known, row[at[POSE] : at[POSE + 1]], velocity, q, qdot, shape)
    regress(known, row[at[NU_REF] : at[NU_REF + 1]], row[at[NUDOT_REF] : at[NUDOT_REF + 1]])


@internal
def adapt(row: Array, at: IntArray, a: Adaptation, o: Estimate) -> None:
    """Psi_hat and gain of one sample, then the update of theta.

    Args:
        row: (width,) row of signals; psi_hat, effective_gain and weight_norm are written.
        at: Offsets of the signals.
        a: The numbers of the law.
        o: What it remembers.
    """
    Y, theta, (p, k) = a.known.Y, o.theta, a.known.Y.shape
    square, first = 0.0, BODY * len(a.bodies.roots)
    z, r = row[at[Z] : at[Z + 1]], row[at[R] : at[R + 1]]
    for i in range(p):
        s = z[i] if i < z.size else r[i - z.size]
        square += s * s
        psi_hat = 0.0
        for j in range(k):
            psi_hat += Y[i, j] * theta[j]
        row[at[PSI_HAT] + i], row[at[EFFECTIVE_GAIN] + i] = psi_hat, a.gain[i]
    row[at[WEIGHT_NORM]], row[at[WEIGHT_NORM] + 1] = norm(theta[:first]), norm(theta[first:])
    if not a.learning:
        return
    eta = a.tracking
    if 0 < z.size < p:
        eta = within_share(eta, theta, z, r, 0, z.size, a)
        eta = within_share(eta, theta, z, r, z.size, p, a)
    eta = within_share(eta, theta, z, r, 0, p, a)
    move(theta, eta, a.sigma * math.sqrt(square) if a.by_error else a.sigma, a.bodies)
    if int(o.samples[0]) % a.stride == 0:
        for i in range(p):
            for j in range(k):
                if Y[i, j] != 0.0:
                    for c in range(k):
                        o.gram[j, c] += Y[i, j] * Y[i, c]
    o.samples[0] += 1.0


@internal
def within_share(eta: float, theta: Array, z: Array, r: Array, first: int, last: int, a: Adaptation) -> float:
    """eta, or less, so that the velocities from `first` to `last` alone answer at most their share."""
    Y, g, feedback = a.known.Y, a.gradient, 0.0
    for j in range(g.size):
        g[j] = 0.0
    for i in range(first, last):
        s = z[i] if i < z.size else r[i - z.size]
        feedback += a.gain[i] * s * s
        for j in range(g.size):
            g[j] += Y[i, j] * s
    answer, most = directions(theta, g, a.bodies), a.share * feedback
    return most / answer if eta * answer > most else eta


@compiled
def norm(vector: Array) -> float:
    """Length of a vector."""
    total = 0.0
    for i in range(vector.size):
        total += vector[i] * vector[i]
    return math.sqrt(total)


KERNELS[Adaptation] = Kernels(estimate, nothing_to_keep)


@dataclass(frozen=True, eq=False)
class Adaptive(ParameterLearner):
    """`tau = Y theta_hat + K s` with `V' = -s' K s`: s goes to zero without leakage, bounds and disturbances.

    Args and errors are those of `ParameterLearner`; the pseudo-inertias of the start are positive definite.
    """

    settings: AdaptiveSettings = field(default_factory=AdaptiveSettings)
    name: str = "adaptive"

    @property
    def notes(self) -> list[str]:
        """How many of the parameters matter."""
        known = self.unit.shape[1]
        return [f"{self.name}: {known} combinations of its {self.regressor.size} parameters matter on this robot"]

    def law(self, context: Context) -> Law:
        """The numbers of the law, with room of its own to work in.

        Raises:
            ConfigError: A gain of 0: the bound on s then does not hold.
        """
        K = self.positive_gains(context.layout, "adaptation needs all > 0")
        return Law(constant_gain(K), self.adaptation(context, K))

    def adaptation(self, context: Context, K: Array, tracking: float = 1.0) -> Adaptation:
        """The adaptation's numbers: the gradient of the tracking error times a factor."""
        own, start = self.settings, self.start()
        scale, first, every = scales(self.regressor, K), self.regressor.inertial, self._rates
        roots = np.array([cholesky(P) for P in pseudo_inertias(start[:first])]).reshape(-1, 4, 4)
        bodies = Bodies(
            h=float(context.control_period),
            gamma=every[:first:BODY].copy(),
            least=1.0 / own.bounds,
            most=self.most(),
            roots=roots,
            inverses=np.array([inverse(C) for C in roots]).reshape(roots.shape),
            rates=every[first:].copy(),
            start=start[first:].copy(),
            top=np.maximum(own.friction_bound * scale, start[first:]),
            steps=np.zeros(roots.shape),
            rest=np.zeros(scale.size),
            factors=np.zeros(roots.shape),
            work=np.zeros((3, 4, 4)),
            known=self._information.copy(),
            system=np.zeros_like(self._information),
            column=np.zeros(start.size),
        )
        return Adaptation(
            known=self.regressor.workspace(),
            gain=K,
            learning=self.learning,
            tracking=tracking,
            sigma=float(own.leakage),
            by_error=own.modification == "e",
            share=self.answer(context, own.share),
            stride=max(1, round(TAKEN / context.control_period)),
            bodies=bodies,
            gradient=np.zeros(start.size),
            layout=layout_of(Estimate, self.shapes(context)),
        )

    @cached_property
    def _rates(self) -> Array:
        """Rates of every number of a body, gamma, and gamma_j of the rest, (k,)."""
        K, own = gains_of(self.regressor, self.feedback), self.settings
        rest = np.repeat([own.rotor, own.viscous, own.coulomb], self.counts()) * scales(self.regressor, K) ** 2
        return self._tempo * np.concatenate((own.rate * np.repeat(self._haste, BODY), rest))

    @cached_property
    def _tempo(self) -> Array:
        """Factors on the rates of all parameters, (k,)."""
        bodies, rest = tempo(self.regressor, gains_of(self.regressor, self.feedback))
        return np.concatenate((np.repeat(bodies, BODY), rest))

    @cached_property
    def _information(self) -> Array:
        """Lambda (k, k), see the module; (0, 0) where no covariance is known."""
        rates, first = self._rates, self.regressor.inertial
        if self.covariance is None or not rates[0] > 0.0:
            return np.zeros((0, 0))
        said = np.flatnonzero((np.diag(self.covariance) > 0.0) & (rates > 0.0))
        Gamma = np.diag(rates)
        for b, P in enumerate(pseudo_inertias(self.start()[:first])):
            here = slice(BODY * b, BODY * b + BODY)
            Gamma[here, here] = rates[BODY * b] * natural(P)
        root, gamma = cholesky(Gamma[np.ix_(said, said)]), self.settings.rate * self._tempo[said]
        sure = solve(cholesky(self.covariance[np.ix_(said, said)]), root * (DOUBT / np.sqrt(gamma))[:, None])
        _, size, directions = svd(sure)
        more = solve(root.T, directions) * np.sqrt(np.maximum(size * size - 1.0, 0.0))
        known = np.zeros_like(Gamma)
        known[np.ix_(said, said)] = product(more, more.T)
        return known

    def shapes(self, context: Context) -> dict[str, tuple[int, ...]]:
        """The estimate, and what excited it."""
        k = self.regressor.size
        return {"theta": (k,), "samples": (1,), "gram": (k, k)}

    def init(self, context: Context) -> ControllerState:
        """The estimate at its start, and nothing seen yet."""
        state = super().init(context)
        state["theta"] = self.start()
        return state

    def weights(self, state: ControllerState) -> dict[str, Array]:
        """The estimate, (k,)."""
        return {"theta": state["theta"]}

    def features(self, law: Law, state: ControllerState) -> Array | None:
        """Y, (p, k)."""
        learner: Adaptation = law.learner
        return learner.known.Y

    def findings(self, state: ControllerState) -> list[str]:
        """Says when the run did not excite all that matters: then the estimate tracks, but is no knowledge."""
        gram, unit = state["gram"], self.unit
        if not self.learning or not np.isfinite(gram).all() or state["samples"][0] == 0:
            return []
        values = np.linalg.eigvalsh(unit.T @ gram @ unit)
        excited, known = int(np.sum(values > EXCITED * values[-1])), unit.shape[1]
        if excited == known:
            return []
        verdict = "not excited: " if 2 * excited < known else ""
        return [f"{self.name}: {verdict}the motion excited {excited} of {known} combinations of parameters that matter"]

    @cached_property
    def _start(self) -> Array:
        """The parameters of `start`, (k,), computed once: a prior looks at many positions."""
        first, own = self.regressor.inertial, self.settings
        prior = prior_of(
            self.regressor, gains_of(self.regressor, self.feedback), own.mass, own.size, self.bearable(own.slowest)
        )
        if not self.informed or self.nominal is None:
            return prior
        theta = np.maximum(self.nominal, 0.0)
        pairs = zip(pseudo_inertias(self.nominal[:first]), pseudo_inertias(prior[:first]), strict=True)
        theta[:first] = np.concatenate([vector_of(lifted(P, G)) for P, G in pairs])
        return theta

    def most(self) -> Array:
        """Largest ratios of the bodies' estimates to their start, (bodies,)."""
        own = self.settings
        if self.informed:
            return np.full(len(self.regressor.bodies), float(own.bounds))
        share, felt = self._prior
        room = self.bearable(own.slowest_learned) * gains_of(self.regressor, self.feedback)
        bearable = np.divide(room, felt, out=np.full_like(felt, np.inf), where=felt > 0).min(axis=1)
        return np.maximum(1.0, np.minimum(np.minimum(own.bounds, own.heaviest / share), bearable))

    @cached_property
    def _prior(self) -> tuple[Array, Array]:
        """Of every body of the prior: by how much it was made lighter (bodies,), and the inertia it is (bodies, p)."""
        own, K = self.settings, gains_of(self.regressor, self.feedback)
        prior = balls(self.regressor, own.mass, own.size)
        share = lightness(self.regressor, prior, K, self.bearable(own.slowest))
        prior[: self.regressor.inertial] *= np.repeat(share, BODY)
        return share, inertia_of_bodies(self.regressor, prior)

    @cached_property
    def _haste(self) -> Array:
        """Factor on gamma with which a body that the loop made lighter takes steps as large, (bodies,)."""
        own = self.settings
        if self.informed or self.bears is None:
            return np.ones(len(self.regressor.bodies))
        prior, K = balls(self.regressor, own.mass, own.size), gains_of(self.regressor, self.feedback)
        return np.asarray((lightness(self.regressor, prior, K, own.slowest) / self._prior[0]) ** 2)

    def counts(self) -> tuple[int, int, int]:
        """How many parameters are rotors, viscous and dry friction."""
        count, base = len(self.regressor.joints), self.regressor.massless.base
        return count, base + count, self.regressor.size - self.regressor.inertial - 2 * count - base

    @cached_property
    def unit(self) -> Array:
        """The combinations of theta that matter, each of the size that random motion excites alike, (k, known)."""
        return self.regressor.unit()
