"""Linear learners with a covariance: a regressor, or random features, with or without a nominal model in front.

`torque.linear` has the law, `torque.features` the features. A learner is told K, where its joints end and what their
motors can give; the one with a regressor how the robot moves; the one with a nominal model also the numbers of that.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ..errors import ConfigError
from ..model.regressor import Regressor
from ..settings import plain
from ..signals import Array, Layout
from . import law
from .controller import CompiledController, Context, ControllerState, Feedback, Law
from .features import BILINEAR, GENERIC, Random, fill, paired, size, terms
from .filtered import new_filter, parts
from .kalman_settings import Kalman, KalmanBilinear, KalmanFeatures, RandomFeatures
from .least_squares import left
from .linear import Linear

SHARE = 0.2  # largest answer of one update to s, as a share of the feedback
SAMPLES = 300  # of random motion
NEGLIGIBLE = 1e-24  # mean square of a feature, relative to the largest, below which it has no weight


@dataclass(frozen=True, eq=False)
class Machine:
    """What a learner is told of its robot.

    Attributes:
        velocities: (p,) names of the velocities.
        lower, upper: (n,) limits of the arm's joints [rad or m], infinite for none.
        effort: (n,) largest torques of its motors at the joints [N m or N], inf where one of the robot's has no limit.
    """

    velocities: tuple[str, ...]
    lower: Array
    upper: Array
    effort: Array

    @property
    def ranges(self) -> tuple[Array, Array]:
        """Lower and upper ends of the arm's motion, (n,) each; half a turn either way where there are no limits."""
        whole = np.isfinite(self.upper - self.lower)
        return np.where(whole, self.lower, -np.pi), np.where(whole, self.upper, np.pi)

    def strength(self, K: Array) -> float:
        """What the motors of the arm can give over its gains, the median of the joints [rad/s]; 0 without limits."""
        n = self.effort.size
        return float(np.median(self.effort / K[K.size - n :])) if n and np.isfinite(self.effort).all() else 0.0


@dataclass(frozen=True, eq=False)
class KalmanLearner(CompiledController):
    """`tau = Psi_0 + Phi W + K s`, W by a Kalman filter on filtered torque; see `torque.linear` for what holds.

    Args:
        settings: `KalmanRegressor`, `KalmanBilinear`, `KalmanFeatures` or `KalmanResidual`.
        machine: What it is told of the robot.
        feedback: K.
        regressor: How the robot moves; for `KalmanRegressor` and `KalmanResidual`.
        theta0: (k0,) parameters of a nominal robot in the order of that regressor; for `KalmanResidual`.
        learning: Off keeps the weights as they are.

    Raises:
        ConfigError: What the settings need is missing, or theta0 is not of the regressor.
    """

    settings: Kalman
    machine: Machine
    feedback: Feedback = field(default_factory=Feedback)
    regressor: Regressor | None = None
    theta0: Array | None = None
    learning: bool = True

    within_limits: ClassVar[bool] = True

    def __post_init__(self) -> None:
        key = self.settings.section
        if self.settings.needs_regressor and self.regressor is None:
            raise ConfigError(f"{key} without a regressor", fix="give Regressor.of(robot)", key=key)
        if self.settings.needs_nominal:
            k0 = self.regressor.size if self.regressor else 0
            if self.theta0 is None or self.theta0.shape != (k0,) or not np.isfinite(self.theta0).all():
                raise ConfigError("no nominal parameters", fix=f"give {k0} finite ones", key=f"{key}.nominal")

    @property
    def name(self) -> str:  # type: ignore[override]
        """What it is called in experiments."""
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
            return p, self.regressor.size, 1
        return 1, size(random.kind, p, random.number), p

    @property
    def notes(self) -> list[str]:
        """How many weights there are."""
        _, k, m = self.shape
        per = f"{k} features, {m} weights each" if m > 1 else f"{k} parameters"
        return [f"{self.name}: {per}"]

    def random(self) -> Random | None:
        """Numbers of the random features, with a memory of their own to work in; None with a regressor."""
        own, p, n = self.drawn, len(self.machine.velocities), self.machine.lower.size
        if own is None:
            return None
        generic = isinstance(own, KalmanFeatures)
        kind = GENERIC if generic else BILINEAR
        pairs = paired(kind, p, own.hidden, own.largest if isinstance(own, KalmanBilinear) else own.hidden)
        units = int(pairs[:, 0].max()) + 1
        scale = np.ones(n)
        if isinstance(own, KalmanFeatures):
            scale = np.concatenate((scale, np.full(2 * p, 1 / own.speed), np.full(p, 1 / own.acceleration)))
        return Random(
            kind=kind,
            number=len(pairs),
            units=units,
            pairs=pairs,
            inputs=scale.size,
            eps=float(own.eps),
            centre=np.mean(self.machine.ranges, axis=0),
            scale=scale,
            x=np.zeros(scale.size),
            g=np.zeros(units),
            t=np.zeros(terms(kind, p)),
        )

    def law(self, context: Context) -> Law:
        """The numbers of the law, with a memory of its own to work in.

        Raises:
            ConfigError: A gain of 0: noise and prior are measured by the gains.
        """
        K, h, own = self.feedback.vector(context.layout), float(context.control_period), self.settings
        if not (K > 0).all():
            raise ConfigError(f"gains {K.tolist()}", why=f"{self.name} needs all > 0", fix="raise them", key="feedback")
        rows, k, m = self.shape
        every = max(1, round(own.interval / h))
        linear = Linear(
            known=None if self.regressor is None else self.regressor.workspace(),
            random=self.random(),
            filter=new_filter(context.layout, h, own.pole, own.state_pole),
            gain=K,
            learning=self.learning,
            every=every,
            interval=every * h,
            noise=float(own.noise) ** 2,
            answer=own.tracking / own.prior**2 * (K if m > 1 else np.array([1 / K.max()])),
            share=SHARE,
            drift=float(own.drift) * every * h,
            radius=own.bound * np.sqrt(k) * (K if m > 1 else np.ones(1)),
            theta0=np.zeros(0) if self.theta0 is None else self.theta0.copy(),
            Phi=np.zeros((rows, k)),
            psi0=np.zeros(K.size),
            work=np.zeros((4, k)),
        )
        return Law(law.CONSTANT_GAIN, np.zeros(0, np.int64), K, linear=linear)

    def init(self, context: Context) -> ControllerState:
        """No weights yet, the prior, and the random functions, drawn from the run's seed."""
        (rows, k, m), random = self.shape, self.random()
        shapes = {"W": (m, k), "U": (k, k), "D": (k,), "prior": (k,), "counts": (2,)}
        state = ControllerState.of(
            **shapes,
            **parts(context.layout, rows, k),
            a=(0 if random is None else random.units, 0 if random is None else random.inputs),
            b=(0 if random is None else random.units,),
        )
        if self.drawn is not None:
            state["a"] = self.drawn.weights * context.rng.standard_normal(state["a"].shape)
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
        if random is not None and self.drawn is not None:
            rest = at_rest(random, k)
            wide = (self.drawn.gravity * self.machine.strength(K) / self.settings.prior) ** 2
            share[rest] *= max(1.0, wide / share[rest].sum())
        state["prior"] = self.settings.prior**2 * share / np.where(matters, square, 1.0)
        state["D"] = state["prior"]
        return state

    def typical(self, state: ControllerState, seed: int = 0) -> Array:
        """Features of random motion at 1 m/s, 1 rad/s, 1 m/s^2, 1 rad/s^2, (samples, rows, k)."""
        rng, random, p = np.random.default_rng(seed), self.random(), len(self.machine.velocities)
        (lower, upper), n = self.machine.ranges, self.machine.lower.size
        rows, k, _ = self.shape
        Phi = np.zeros((SAMPLES, rows, k))
        drawn = np.concatenate((state["a"].ravel(), state["b"]))
        for one in Phi:
            q, (nu, nu_ref, nudot_ref) = rng.uniform(lower, upper), rng.standard_normal((3, p))
            if random is not None:
                fill(random, drawn, q, nu[: p - n], nu[p - n :], nu_ref, nudot_ref, one[0])
            elif self.regressor is not None:
                known = self.regressor.massless
                position = known.offset + known.arm @ q
                one[:] = self.regressor.matrix(position, nu, nu_ref, nudot_ref)
        return Phi

    def feedback_gain(self, layout: Layout) -> Array:
        """K, (p,)."""
        return self.feedback.vector(layout)

    def weights(self, state: ControllerState) -> dict[str, Array]:
        """The weights, transposed, (m, k)."""
        return {"W": state["W"]}

    def facts(self) -> dict[str, Any]:
        """Gains and settings, and what it was told of a nominal robot."""
        own = {"feedback": plain(self.feedback), "settings": plain(self.settings), "learning": self.learning}
        labels = {} if self.drawn or self.regressor is None else {"labels": list(self.regressor.labels)}
        return own | labels | ({} if self.theta0 is None else {"theta0": self.theta0.tolist()})

    def features(self, law: Law, state: ControllerState) -> Array | None:
        """Phi, (rows, k); while it learns, that of the last control period."""
        return None if law.linear is None else law.linear.Phi

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


def at_rest(random: Random, k: int) -> NDArray[np.bool_]:
    """Which of k random features are there when nothing moves: the constant, and random functions that stand alone."""
    last, rest = random.t.size - 1, np.zeros(k, bool)
    rest[last] = True
    rest[last + 1 : last + 1 + random.number] = np.isin(random.pairs[:, 1], (-1, last))
    return rest
