"""Concurrent learning of the parameters of a robot whose kinematics are known: knowledge that outlasts the excitation.

`torque.recall` has the law, `torque.history` the stack of equations that it learns from.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, Literal

import numpy as np

from ..errors import ConfigError
from ..model.regressor import Regressor
from ..settings import Settings, plain, require_at_most, require_numbers
from ..signals import Array, Layout
from . import law
from .adaptive_settings import Adapting
from .controller import CompiledController, Context, ControllerState, Feedback, Law
from .filtered import new_filter, parts
from .guess import gains_of, guess_of, scales, sizes_of
from .history import scratch, shapes
from .recall import History

SHARE = 0.2  # largest answer of a sample to s, as a share of the feedback
RADIUS = 10.0  # bound on w, as root mean square in standard deviations of the prior
MOST = 5000  # places of the stack
UNKNOWN = 0.1  # share of the prior variance of Psi left on random motion, above which a run did not excite
RANK = 1e-9  # relative size under which a singular value of stacked regressors counts as zero
FRICTION = 0.3  # size of friction, in c_j (see `Adapting`): small joints have little gain and much friction
SAMPLES = 300  # of random motion


class Concurrent(Settings, frozen=True):
    """How a concurrent learner learns.

    Args:
        entries: Places of the history stack, 5000 at most; each holds one equation per velocity.
        rate: How fast the estimate goes to what the stack says [1/s].
        tracking: How fast it follows the tracking error where nothing is known yet [1/J].
        noise: Standard deviation of an equation, divided by K: the velocity error that would hide it [m/s, rad/s].
        growth: Least gain of log det of the information for which an entry is replaced.
        lifetime: Of an entry [s]; 0 for ever. With one, what is not excited again is forgotten, and a robot that has
            changed is learned anew.
        pole: Of the low-pass of regressor and torque [1/s].
        every: Time between two candidates [s].
        spread: Standard deviation of the prior, in sizes of the guess; of friction in `FRICTION` c_j.
        initial: "guess" starts from balls without friction, "nominal" from a nominal robot (in an experiment the one
            of `[nominal]`).

    Raises:
        ConfigError: A number that is negative, not finite or 0 where it must not be.
    """

    entries: int = 60
    rate: float = 2.0
    tracking: float = 10.0
    noise: float = 0.005
    growth: float = 0.05
    lifetime: float = 0.0
    pole: float = 3.0
    every: float = 0.02
    spread: float = 1.0
    initial: Literal["guess", "nominal"] = "guess"

    def __post_init__(self) -> None:
        require_numbers(self, "concurrent", ("entries", "noise", "growth", "every", "spread"))
        require_at_most(self, "concurrent", {"entries": MOST})


@dataclass(frozen=True, eq=False)
class ConcurrentLearner(CompiledController):
    """`tau = Y theta_hat + K s`, theta_hat by concurrent learning; see `torque.recall` for what holds.

    Args:
        regressor: How the robot moves.
        feedback: K.
        settings: Stack, rates and start.
        nominal: (k0,) parameters to start from, needed for `initial = "nominal"`.
        learning: Off keeps the estimate.

    Raises:
        ConfigError: A start from nominal parameters without them, or with others than k0 finite ones.
    """

    regressor: Regressor
    feedback: Feedback = field(default_factory=Feedback)
    settings: Concurrent = field(default_factory=Concurrent)
    nominal: Array | None = None
    learning: bool = True
    name: str = "concurrent"

    within_limits: ClassVar[bool] = True

    def __post_init__(self) -> None:
        k, given = self.regressor.size, self.nominal
        if self.settings.initial == "nominal" and given is None:
            raise ConfigError(
                "no nominal parameters", fix="give them, or use initial = 'guess'", key="concurrent.initial"
            )
        if given is not None and (given.shape != (k,) or not np.isfinite(given).all()):
            raise ConfigError(f"{given.size} parameters", fix=f"give {k} finite ones", key="nominal")

    @property
    def notes(self) -> list[str]:
        """How many of the parameters matter."""
        return [f"{self.name}: {self.dimension} combinations of its {self.regressor.size} parameters matter"]

    @property
    def dimension(self) -> int:
        """Number of combinations that matter, k."""
        return self._typical[1].shape[1]

    def law(self, context: Context) -> Law:
        """The numbers of the law, with a memory of its own to work in.

        Raises:
            ConfigError: A gain of 0: noise is measured by the gains.
        """
        K, own, h = self._gains, self.settings, float(context.control_period)
        p, k = K.size, self.dimension
        history = History(
            known=self.regressor.workspace(),
            basis=self.basis,
            theta0=self.start(),
            filter=new_filter(context.layout, h, own.pole),
            gain=K,
            precision=1.0 / (own.noise * K),
            learning=self.learning,
            h=h,
            every=max(1, round(own.every / h)),
            rate=float(own.rate),
            tracking=float(own.tracking),
            share=SHARE,
            radius=RADIUS * float(np.sqrt(k)),
            growth=float(own.growth),
            lifetime=float(own.lifetime) if own.lifetime else np.inf,
            entries=own.entries,
            Phi=np.zeros((p, k)),
            psi0=np.zeros(p),
            y=np.zeros(p),
            gradient=np.zeros(k),
            target=np.zeros(k),
            scratch=scratch(p, k),
        )
        return Law(law.CONSTANT_GAIN, np.zeros(0, np.int64), K, history=history)

    def init(self, context: Context) -> ControllerState:
        """The estimate at its start, and an empty stack."""
        p, k = context.layout.dof, self.dimension
        stack = shapes(self.settings.entries, p, k)
        state = ControllerState.of(w=(k,), samples=(1,), **parts(context.layout, p, k), **stack)
        state["L"] = state["P"] = np.eye(k)
        state["born"] = -1.0
        return state

    @property
    def basis(self) -> Array:
        """`theta = theta_0 + basis w`, (k0, k): the directions that matter, of the size of the prior."""
        deviation, directions = self._typical
        return np.ascontiguousarray(deviation[:, None] * directions)

    @property
    def deviation(self) -> Array:
        """Standard deviations of the prior of theta, (k0,)."""
        return self._typical[0]

    def start(self) -> Array:
        """The parameters before anything is learned, (k0,)."""
        return self._start.copy()

    @cached_property
    def _start(self) -> Array:
        """The same, computed once: a guess looks at many positions."""
        if self.settings.initial == "nominal" and self.nominal is not None:
            return np.array(self.nominal)
        own = Adapting()
        return guess_of(self.regressor, self._gains, own.mass, own.size, own.slowest)

    def theta(self, state: ControllerState) -> Array:
        """The estimate as parameters of the robot, (k0,)."""
        return np.asarray(self.start() + self.basis @ state["w"])

    def feedback_gain(self, layout: Layout) -> Array:
        """K, (p,)."""
        return self.feedback.vector(layout)

    def weights(self, state: ControllerState) -> dict[str, Array]:
        """The estimate, (k,)."""
        return {"w": state["w"]}

    def facts(self) -> dict[str, Any]:
        """Gains, settings and start, with the names of the parameters."""
        own = {"feedback": plain(self.feedback), "settings": plain(self.settings), "learning": self.learning}
        return own | {"labels": list(self.regressor.labels), "start": self.start().tolist()}

    def features(self, law: Law, state: ControllerState) -> Array | None:
        """Phi, (p, k); while it learns, that of the last control period."""
        return None if law.history is None else law.history.Phi

    def unknown(self, state: ControllerState) -> Array:
        """Share of the prior variance of Psi that is left on random motion, (p,): 1 nothing learned, 0 all known."""
        Phi = self.random_motion() @ self.basis
        left = np.einsum("nij,jk,nik->i", Phi, state["P"], Phi)
        return np.asarray(left / np.einsum("nij,nij->i", Phi, Phi))

    def findings(self, state: ControllerState) -> list[str]:
        """Says when the run did not excite what the learner would have to know of other motions."""
        if not self.learning or not np.isfinite(state.values).all():
            return []
        unknown = float(self.unknown(state).max())
        if unknown <= UNKNOWN:
            return []
        return [
            f"{self.name}: not excited: {unknown:.0%} of what it did not know is left, on random motion; what it "
            "learned tracks the motions of this run and is no knowledge of others"
        ]

    def random_motion(self, seed: int = 0) -> Array:
        """Regressors of random motion of unit speed, (samples, p, k0)."""
        rng, p = np.random.default_rng(seed), self.regressor.massless.nu.size
        place = self.regressor.random_position
        return np.array([self.regressor.matrix(place(rng), *rng.standard_normal((3, p))) for _ in range(SAMPLES)])

    @cached_property
    def _typical(self) -> tuple[Array, Array]:
        """Standard deviations of the prior (k0,), and orthonormal directions of the scaled parameters that matter."""
        deviation = self.settings.spread * self._sizes()
        Y = self.random_motion().reshape(-1, self.regressor.size) * deviation
        _, singular, directions = np.linalg.svd(Y, full_matrices=False)
        return deviation, np.ascontiguousarray(directions[singular > RANK * singular[0]].T)

    def _sizes(self) -> Array:
        """Sizes of the parameters, (k0,): of the guess, and of friction some of the gain that the joint feels."""
        own = Adapting()
        inertial = sizes_of(self.regressor, self._gains, own.mass, own.size, own.slowest)
        return np.concatenate((inertial, FRICTION * scales(self.regressor, self._gains)))

    @property
    def _gains(self) -> Array:
        """K, (p,); errors as of `law`."""
        K = gains_of(self.regressor, self.feedback)
        if not (K > 0).all():
            raise ConfigError(f"gains {K.tolist()}", why=f"{self.name} needs all > 0", fix="raise them", key="feedback")
        return K
