"""Settings of the linear learners, `[kalman.regressor]` of an experiment for `kalman_regressor`, and so on."""

from __future__ import annotations

from typing import ClassVar

from ..settings import Settings, require_at_most, require_numbers

MOST = 2000  # random features: the covariance holds their square


class Kalman(Settings, frozen=True):
    """How a linear learner learns; all numbers are measured by the feedback, so one set suits robots of any size.

    Args:
        noise: Standard deviation of what filtered torque says, divided by K [m/s, rad/s]: the velocity error that the
            feedback would need to hide it. Noise of the sensors and what the features cannot say.
        prior: Standard deviation of Psi before anything is learned, on random motion at 1 m/s and 1 rad/s, over K.
        drift: Part of the prior variance that comes back in a second [1/s], so that changes are learned. 0 never
            forgets; where nothing excites, the variance returns to the prior at most.
        tracking: How fast the weights answer the tracking error where nothing is known yet [1/s].
        bound: Largest weights, as root mean square in standard deviations of the prior.
        pole: Low-pass on features and filtered torque [1/s].
        state_pole: Low-pass on states and torque ahead of the features [1/s]; 0 for none.
        interval: Time from one update to the next [s], at least a control period.

    Raises:
        ConfigError: A number that is negative, not finite, huge or 0 where it must not be.
    """

    noise: float = 0.03
    prior: float = 1.0
    drift: float = 1e-4
    tracking: float = 1.0
    bound: float = 3.0
    pole: float = 5.0
    state_pole: float = 60.0
    interval: float = 0.01

    section: ClassVar[str] = ""
    excited: ClassVar[float] = 0.5  # share of the prior variance of Psi above which it says that it was not excited
    needs_regressor: ClassVar[bool] = False
    needs_nominal: ClassVar[bool] = False
    positive: ClassVar[tuple[str, ...]] = ("noise", "prior", "bound", "interval")

    def __post_init__(self) -> None:
        require_numbers(self, self.section, self.positive)


class KalmanRegressor(Kalman, frozen=True):
    """`kalman_regressor`: Phi is the regressor of a robot whose masses are not known; arguments as in `Kalman`.

    What it can say is true, so a wide prior costs nothing, and friction of small joints needs one.
    """

    noise: float = 0.1
    prior: float = 10.0

    section: ClassVar[str] = "kalman.regressor"
    excited: ClassVar[float] = 0.1  # the velocities share what is learned: a little excitation tells them much
    needs_regressor: ClassVar[bool] = True


class RandomFeatures(Kalman, frozen=True):
    """Random features, see `torque.features`.

    Args:
        hidden: Random functions, at least; 2000 at most.
        weights: Standard deviation of their weights on every input.
        linear: Ratio of the prior variances of features without and with a random function.
        gravity: Standard deviation of what is there at rest, a share of what the arm's motors can give (the median of
            the joints); at least what `prior` gives it. Gravity over K is g / (b l) for a link of length l that K gives
            the bandwidth b: some tens of a small arm's prior, and little of a geared arm's.
        eps: Speed over which dry friction turns [rad/s or m/s].
    """

    drift: float = 3e-5
    hidden: int = 25
    weights: float = 0.3
    linear: float = 10.0
    gravity: float = 0.2
    eps: float = 0.03

    positive: ClassVar[tuple[str, ...]] = (*Kalman.positive, "hidden", "linear", "eps")
    most: ClassVar[dict[str, int]] = {"hidden": MOST}

    def __post_init__(self) -> None:
        super().__post_init__()
        require_at_most(self, self.section, self.most)


class KalmanBilinear(RandomFeatures, frozen=True):
    """`kalman_bilinear`: random functions of the arm's joints times what is linear or bilinear.

    Args:
        largest: Most features with a random function, 2000 at most; a robot with many joints has fewer than `hidden`
            times its terms.
    """

    largest: int = 400

    section: ClassVar[str] = "kalman.bilinear"
    positive: ClassVar[tuple[str, ...]] = (*RandomFeatures.positive, "largest")
    most: ClassVar[dict[str, int]] = {"hidden": MOST, "largest": MOST}


class KalmanFeatures(RandomFeatures, frozen=True):
    """`kalman_features`: random functions of everything.

    Args:
        speed: What velocities are divided by ahead of them [m/s, rad/s].
        acceleration: What accelerations are divided by [m/s^2, rad/s^2].
    """

    hidden: int = 300
    weights: float = 0.5
    speed: float = 3.0
    acceleration: float = 20.0

    section: ClassVar[str] = "kalman.features"
    positive: ClassVar[tuple[str, ...]] = (*RandomFeatures.positive, "speed", "acceleration")


class KalmanResidual(KalmanBilinear, frozen=True):
    """`kalman_residual`: a nominal model (`[nominal]` in an experiment), and bilinear features for what it leaves."""

    section: ClassVar[str] = "kalman.residual"
    needs_regressor: ClassVar[bool] = True
    needs_nominal: ClassVar[bool] = True


class KalmanTables(Settings, frozen=True):
    """The linear learners of an experiment, one table each.

    Args:
        regressor: `kalman_regressor`.
        bilinear: `kalman_bilinear`.
        features: `kalman_features`.
        residual: `kalman_residual`.
    """

    regressor: KalmanRegressor = KalmanRegressor()
    bilinear: KalmanBilinear = KalmanBilinear()
    features: KalmanFeatures = KalmanFeatures()
    residual: KalmanResidual = KalmanResidual()
