"""Linear learners with a covariance: a regressor, or random features, with or without a nominal model in front.

`torque.linear` has the law. A learner is told K, where its joints end and what their motors can give; the one with a
regressor how the robot moves; the one with a nominal model also the numbers of that. Their settings are
`[kalman.regressor]` of an experiment for `kalman_regressor`, and so on.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar, Self

import msgspec
import numpy as np

from ..elementary.matrices import product
from ..elementary.normals import standard_normal
from ..errors import ConfigError
from ..model.regressor import Regressor
from ..parts import layout_of
from ..settings.arguments import require_types
from ..signals import Array, Layout
from .controller import (
    Bears,
    CompiledController,
    Context,
    ControllerSettings,
    ControllerState,
    Feedback,
    Law,
    MachineLimits,
    Told,
    borne,
    read_facts,
)
from .correction import Corrected, Correction, new_correction
from .factored import NEGLIGIBLE, factors, left
from .filtered import new_filter, parts
from .friction_features import columns, friction, shipped
from .kalman_settings import (
    SETTINGS,
    KalmanBilinearSettings,
    KalmanFeaturesSettings,
    KalmanFrictionSettings,
    KalmanRegressorSettings,
    KalmanSettings,
    RandomFeatures,
)
from .law import constant_gain
from .linear import Linear, Parts
from .prior import identified, within_prior
from .random_features import BILINEAR, GENERIC, Movement, Random, at_rest, fill, new_random, paired, size

CORRECTS = 0.5  # part of the fastest answer that the loop bears which a correction takes
SHARE = 0.2  # largest answer of one update to s, as a share of the feedback
SAMPLES = 300  # of random motion
CONFIRMED = 25.0  # times `Context.unseen` that the low-pass of `kalman_friction` lasts, at least


@dataclass(frozen=True, eq=False)
class Kalman(CompiledController):
    """`tau = Psi_0 + Phi W + K s`, W by a Kalman filter on filtered torque; see `torque.linear` for what holds.

    Args:
        settings: One of `SETTINGS`. machine: What it is told of the robot. feedback: K. regressor: How the robot moves;
        for `KalmanRegressorSettings` and `KalmanResidualSettings`. theta0: (k0,) parameters of a nominal robot in the
        order of that regressor; for `KalmanResidualSettings`. learning: Off keeps the weights as they are. before:
        Parameters (k,) that it begins with and their covariance (k, k), of which it takes no more than its prior.
        bears: As of `CompiledController`.

    Raises:
        ConfigError: What the settings need is missing, or theta0 is not of the regressor.
    """

    settings: KalmanSettings
    machine: MachineLimits
    feedback: Feedback = field(default_factory=Feedback)
    regressor: Regressor | None = None
    theta0: Array | None = None
    learning: bool = True
    before: tuple[Array, Array] | None = None
    bears: Bears | None = None

    within_limits: ClassVar[bool] = True

    def __post_init__(self) -> None:
        require_types(self)
        key = self.settings.section
        if self.settings.needs_regressor and self.regressor is None:
            raise ConfigError(f"{key} without a regressor", fix="give Regressor.of(robot)", key=key)
        if self.settings.needs_nominal:
            k0 = self.regressor.size if self.regressor else 0
            if self.theta0 is None or self.theta0.shape != (k0,) or not np.isfinite(self.theta0).all():
                raise ConfigError("no nominal parameters", fix=f"give {k0} finite ones", key=f"{key}.nominal")

    @classmethod
    def build(cls, given: ControllerSettings) -> Self:
        """With what its settings need to be told of the robot."""
        own, told = given.settings, given.told
        motion = told.motion if own.needs_regressor else None
        theta0 = told.parameters if own.needs_nominal else None
        file = own.start if isinstance(own, KalmanRegressorSettings) else ""
        before = identified(file, told.motion.labels, f"{own.section}.start") if file else None
        return cls(own, told.machine, given.feedback, motion, theta0, given.learning, before)

    @classmethod
    def from_facts(cls, name: str, facts: dict[str, Any], told: Told) -> Self | None:
        """From gains, settings, and what it was told of a nominal robot."""
        if not facts:
            return None
        settings: KalmanSettings = msgspec.convert(facts["settings"], SETTINGS[name])
        motion = told.motion if settings.needs_regressor else None
        theta0 = np.array(facts["theta0"]) if "theta0" in facts else None
        made = read_facts(cls, facts, "feedback", "learning", *borne(facts))
        before = tuple(np.array(each, float) for each in facts["before"]) if "before" in facts else None
        return cls(settings, told.machine, regressor=motion, theta0=theta0, before=before, **made)  # type: ignore[arg-type]

    @property
    def name(self) -> str:  # type: ignore[override]
        """Name in experiments, tables and recordings."""
        return self.settings.section.replace(".", "_")

    @property
    def drawn(self) -> RandomFeatures | None:
        """Settings of the random features; None with a regressor."""
        return self.settings if isinstance(self.settings, RandomFeatures) else None

    @property
    def shape(self) -> tuple[int, int, int]:
        """Rows of Phi, its columns k, columns of W."""
        p, random = len(self.machine.velocities), self.random()
        if random is None:
            assert self.regressor is not None
            return p, self.regressor.size + p * self.beside, 1
        return 1, size(random.kind, p, random.number), p

    @property
    def beside(self) -> int:
        """Columns of Phi beside the regressor, per velocity."""
        return len(shipped()[1]) + 1 if isinstance(self.settings, KalmanFrictionSettings) else 0

    @property
    def notes(self) -> list[str]:
        """How many weights there are."""
        _, k, m = self.shape
        per = f"{k} features, {m} weights each" if m > 1 else f"{k} parameters"
        return [f"{self.name}: {per}"]

    def random(self) -> Random | None:
        """Numbers of the random features, with room of their own to work in; None with a regressor."""
        own, p, n = self.drawn, len(self.machine.velocities), self.machine.lower.size
        if own is None:
            return None
        generic = isinstance(own, KalmanFeaturesSettings)
        kind = GENERIC if generic else BILINEAR
        pairs = paired(kind, p, own.hidden, own.largest if isinstance(own, KalmanBilinearSettings) else own.hidden)
        scale = np.ones(n + 2 * len(self.machine.stops))
        if isinstance(own, KalmanFeaturesSettings):
            scale = np.concatenate((scale, np.full(2 * p, 1 / own.speed), np.full(p, 1 / own.acceleration)))
        return new_random(kind, p, pairs, float(own.eps), np.mean(self.machine.ranges, axis=0), scale)

    def law(self, context: Context) -> Law:
        """The numbers of the law, with room of its own to work in.

        Raises:
            ConfigError: A gain of 0: noise and prior are measured by the gains.
        """
        K, h, own = self.positive_gains(context.layout), float(context.control_period), self.settings
        (rows, k, m), every = self.shape, max(1, round(own.interval / h))
        linear = Linear(
            known=None if self.regressor is None else self.regressor.workspace(),
            random=self.random(),
            friction=friction() if self.beside else None,
            correction=self.correction(context),
            filter=new_filter(context, self.pole(context), own.state_pole),
            gain=K,
            learning=self.learning,
            every=every,
            interval=every * h,
            noise=float(own.noise * own.noise),
            answer=own.tracking / (own.prior * own.prior) * (K if m > 1 else np.array([1 / K.max()])),
            share=min(SHARE, every * self.answer(context)),
            drift=float(own.drift),
            change=float(own.change) if isinstance(own, KalmanFrictionSettings) else 0.0,
            alarm=float(own.alarm),
            carrying=np.arange(0) if self.regressor is None or self.drawn else self.regressor.carrying,
            radius=own.bound * np.sqrt(k) * (K if m > 1 else np.ones(1)),
            theta0=np.zeros(0) if self.theta0 is None else self.theta0.copy(),
            Phi=np.zeros((rows, k)),
            psi0=np.zeros(K.size),
            work=np.zeros((4, k)),
            layout=layout_of(Parts, self.shapes(context)),
        )
        return Law(constant_gain(K), linear)

    def pole(self, context: Context) -> float:
        """Of the low-pass on features and filtered torque [1/s]; see `KalmanFrictionSettings`."""
        own = self.settings
        if isinstance(own, KalmanFrictionSettings) and context.unseen > 0.0:
            return min(own.pole, 1.0 / (CONFIRMED * context.unseen))
        return own.pole

    def correction(self, context: Context) -> Correction | None:
        """The correction by the tracking error, with room of its own to work in; None without one."""
        own = self.settings
        if not isinstance(own, KalmanFrictionSettings) or own.correction == 0.0:
            return None
        K, c = self.feedback.vector(context.layout), own.correction
        c = CORRECTS * self.answer(context) / context.control_period if c is None else c
        return new_correction(context, K, self.typical(), c, own.leakage, own.desired)

    def shapes(self, context: Context) -> dict[str, tuple[int, ...]]:
        """Weights and covariance, what the filter remembers, what was drawn."""
        (rows, k, m), random, p = self.shape, self.random(), len(self.machine.velocities)
        drawn = (0, 0) if random is None else (random.units, random.inputs)
        moved = (2, rows * (self.beside - 1)) if self.beside else (0, 0)
        own = {"W": (m, k), "U": (k, k), "D": (k,), "prior": (k,), "counts": (7,), "expected": (rows,), "level": (p,)}
        sizes = (k, 1, p, p) if self.beside else (0, 0, 0, 0)
        corrected = {name: (size,) for name, size in zip(Corrected._fields, sizes, strict=True)}
        return {**own, **parts(context, rows, k), "a": drawn, "b": drawn[:1], "moved": moved, **corrected}

    def init(self, context: Context) -> ControllerState:
        """No weights yet, the prior, and the random functions, drawn from the run's seed."""
        (_, k, m), random, state = self.shape, self.random(), super().init(context)
        if self.drawn is not None:
            state["a"] = self.drawn.weights * standard_normal(context.rng, state["a"].shape)
            state["b"] = context.rng.uniform(-1.0, 1.0, state["b"].shape)
        Phi, K = self.typical(state), self.feedback.vector(context.layout)
        scaled = Phi / K[:, None] if m == 1 else Phi
        square = (scaled**2).mean(axis=(0, 1))
        matters = square > NEGLIGIBLE * square.max()
        share = matters.astype(float)
        if random is not None and self.drawn is not None:
            share[: random.t.size] *= self.drawn.linear
            share[random.t.size + random.number :] *= self.drawn.linear
        share /= share.sum()
        if isinstance(self.settings, KalmanFrictionSettings):
            own, p, d = self.settings, len(K), self.beside - 1
            share[-p * self.beside :] = (own.friction / own.prior) ** 2 / d
            share[-p:] = (own.constant / own.prior) ** 2
        if random is not None and self.drawn is not None:
            rest = at_rest(random, k)
            wide = self.drawn.gravity * self.machine.strength(K) / self.settings.prior
            share[rest] *= max(1.0, wide * wide / share[rest].sum())
        state["prior"] = self.settings.prior * self.settings.prior * share / np.where(matters, square, 1.0)
        state["D"] = state["prior"]
        if self.before is not None:
            self._begin(state, *self.before)
        return state

    def _begin(self, state: ControllerState, theta: Array, covariance: Array) -> None:
        """Begin with parameters and covariance; what that says nothing of keeps the prior, which bounds the rest."""
        state["W"][0, : theta.size] = theta
        covariance = np.pad(covariance, (0, state["D"].size - theta.size))
        state["U"], state["D"] = factors(within_prior(covariance, state["prior"]))

    def typical(self, state: ControllerState | None = None, seed: int = 0) -> Array:
        """Features of random motion at 1 m/s, 1 rad/s, 1 m/s^2, 1 rad/s^2, (samples, rows, k)."""
        rng, random, p = np.random.default_rng(seed), self.random(), len(self.machine.velocities)
        (lower, upper), n = self.machine.ranges, self.machine.lower.size
        Phi, learned = np.zeros((SAMPLES, *self.shape[:2])), friction()
        for one in Phi:
            q, (nu, nu_ref, nudot_ref) = rng.uniform(lower, upper), standard_normal(rng, (3, p))
            if random is not None and state is not None:
                shape = self.machine.typical_shape(rng)
                movement = Movement(np.zeros(0), q, nu[: p - n], nu[p - n :], nu_ref, nudot_ref, shape)
                fill(random, state["a"], state["b"], movement, one[0])
            elif self.regressor is not None:
                known = self.regressor.massless
                position = self.regressor.turned(known.offset + product(known.arm, q), rng)
                one[:, : self.regressor.size] = self.regressor.matrix(position, nu, nu_ref, nudot_ref)
                if self.beside:
                    for i in range(p):
                        columns(learned, i, nu_ref[i], nudot_ref[i], one)
        return Phi

    def knowledge(self, state: ControllerState) -> tuple[Array, Array | None] | None:
        """With a regressor alone: the estimate (k,) and its covariance (k, k)."""
        if self.drawn is not None or self.beside:
            return None
        U = np.triu(state["U"].T, 1) + np.eye(state["D"].size)
        return state["W"][0].copy(), np.asarray((U * state["D"]) @ U.T)

    def weights(self, state: ControllerState) -> dict[str, Array]:
        """The weights, transposed, (m, k)."""
        return {"W": state["W"]}

    def facts(self) -> dict[str, Any]:
        """Gains and settings, and what it was told of a nominal robot."""
        own = super().facts()
        labels = {} if self.drawn or self.regressor is None else {"labels": list(self.regressor.labels)}
        before = {} if self.before is None else {"before": [each.tolist() for each in self.before]}
        return own | labels | before | ({} if self.theta0 is None else {"theta0": self.theta0.tolist()})

    def features(self, law: Law, state: ControllerState) -> Array | None:
        """Phi, (rows, k); while it learns, that of the last control period."""
        learner: Linear = law.learner
        return learner.Phi

    def unknown(self, state: ControllerState) -> Array:
        """Share of the prior variance of Psi that is left on random motion, (p,): 1 nothing learned, 0 all known.

        Of random features the larger share of two: of what is there at rest, whose prior is so much wider that it
        would hide the other, and of the rest.
        """
        Phi, (rows, k, _), random = self.typical(state), self.shape, self.random()
        rest = np.zeros(k, bool) if random is None else at_rest(random, k)
        groups = [~rest] if random is None else [~rest, rest]
        nothing, f = np.zeros((k, k)), np.zeros(k)

        def share(part: Array) -> float:
            return left(part, state["U"], state["D"], f) / left(part, nothing, state["prior"], f)

        per_row = [max(share(Phi[:, i] * group) for group in groups) for i in range(rows)]
        return np.broadcast_to(np.array(per_row), (len(self.machine.velocities),))

    def findings(self, state: ControllerState) -> list[str]:
        """Says when the run did not excite what the learner would have to know of other motions."""
        if not self.learning or not np.isfinite(state.values).all():
            return []
        unknown = self.unknown(state)
        worst = int(np.argmax(unknown))
        if unknown[worst] <= self.settings.excited:
            return []
        of = f" of {self.machine.velocities[worst]}" if self.shape[2] == 1 else ""
        return [
            f"{self.name}: not excited: {unknown[worst]:.0%} of what it did not know{of} is left, on random motion; "
            "what it learned tracks the motions of this run and is no knowledge of others"
        ]

    def prior_deviation(self, state: ControllerState) -> Array | None:
        """Standard deviations of the prior, (k, m), of weights that answer torques of the size of K."""
        m, n = len(self.machine.velocities), self.machine.lower.size
        return np.asarray(np.sqrt(state["prior"])[:, None] * self.feedback.vector(Layout(m - n, n, m, m)))

    def true_weights(self, theta: Array, start: ControllerState) -> Array | None:
        """Of all parameters that say the same Psi on every motion those nearest to the start, measured by the prior."""
        if self.regressor is None or self.drawn is not None or self.beside:
            return None
        matters, first = self.regressor.identifiable(), start["W"][0]
        spread = start["prior"][:, None] * matters
        return np.asarray(first + spread @ np.linalg.solve(matters.T @ spread, matters.T @ (theta - first)))
