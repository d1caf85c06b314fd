"""Settings of `torque.kalman`: `[kalman.regressor]` of an experiment are those of `kalman_regressor`, and so on."""

from __future__ import annotations

from typing import ClassVar

from ..errors import ConfigError
from ..settings import Settings, require_at_most, require_numbers

MOST = 2000  # random features: the covariance holds their square


class KalmanSettings(Settings, frozen=True):
    """How a linear learner learns; all numbers are measured by the feedback, so one set suits robots of any size.

    Args:
        noise: Standard deviation of the errors of filtered torque, divided by K [m/s, rad/s]: noise of the sensors, and
            what the features lack.
        prior: Standard deviation of Psi before anything is learned, on random motion at 1 m/s and 1 rad/s, over K.
        drift: Part of the prior variance that comes back in a second [1/s], so that changes are learned, up to the
            prior's. 0 never forgets.
        tracking: How fast the weights answer the tracking error where nothing is known yet [1/s].
        bound: Largest weights, as root mean square in standard deviations of the prior.
        pole: Low-pass on features and filtered torque [1/s].
        state_pole: Low-pass on states and torque ahead of the features [1/s]; 0 for none.
        interval: Time from one update to the next [s], at least a control period; just after an alarm that is it.
        alarm: The robot counts as changed where the square of the errors is this many times that of the last seconds;
            its load is then learned anew. 0 for never.

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
    alarm: float = 0.0

    section: ClassVar[str] = ""
    excited: ClassVar[float] = 0.5  # share of the prior variance of Psi above which it says that it was not excited
    needs_regressor: ClassVar[bool] = False
    needs_nominal: ClassVar[bool] = False
    positive: ClassVar[tuple[str, ...]] = ("noise", "prior", "bound", "interval")

    def __post_init__(self) -> None:
        require_numbers(self, self.section, self.positive)


class KalmanRegressorSettings(KalmanSettings, frozen=True):
    """`kalman_regressor`: Phi is the regressor of a robot whose masses are not known; arguments as in `KalmanSettings`.

    What it can say is true, so a wide prior costs nothing, and friction of small joints needs one.

    Args:
        start: A file `NAME.identified.json` of `mmnn identify`: it begins with the parameters found there, as sure as
            their covariance says; empty for nothing known.
    """

    noise: float = 0.1
    prior: float = 10.0
    start: str = ""

    section: ClassVar[str] = "kalman.regressor"
    excited: ClassVar[float] = 0.1  # the velocities share what is learned: a little excitation tells them much
    needs_regressor: ClassVar[bool] = True


class KalmanFrictionSettings(KalmanRegressorSettings, frozen=True):
    """`kalman_friction`: the regressor, friction features learned offline, a constant per velocity, and a correction.

    Velocities that are predicted, or observed on the learner's own estimate, say for `Context.unseen` what it believes
    already. Its low-pass lasts at least 25 times that, `latency.margin` included, whatever `pole` says.

    Args:
        friction: Standard deviation of what the features say before anything is learned, over K [m/s, rad/s].
        constant: Standard deviation of the constants, likewise.
        change: Part of a constant's prior variance that comes back in a second [1/s].
        correction: c of `torque.correction`, how fast it answers the tracking error, over K [1/s]; 0 for none, None for
            half of what the loop bears (`loop.rates.borne`).
        leakage: How fast the correction is forgotten [1/s], just after a change of the robot at a quarter of it; it
            adds `correction / leakage` times K at low frequencies.
        desired: Part of the features that is taken at the reference's motion, the rest at the measured one; 0 to 1.
    """

    noise: float = 0.2
    pole: float = 7.0
    state_pole: float = 100.0
    friction: float = 0.2
    constant: float = 0.03
    change: float = 0.1
    alarm: float = 3.0
    correction: float | None = None
    leakage: float = 20.0
    desired: float = 0.5

    section: ClassVar[str] = "kalman.friction"
    positive: ClassVar[tuple[str, ...]] = (
        *KalmanRegressorSettings.positive,
        "friction",
        "constant",
        "change",
        "leakage",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.desired > 1.0:
            raise ConfigError(
                f"a part of {self.desired:g}", fix="use a number from 0 to 1", key=f"{self.section}.desired"
            )


class RandomFeatures(KalmanSettings, frozen=True):
    """Random features, see `torque.random_features`.

    Args:
        hidden: Random functions, at least; 2000 at most.
        weights: Standard deviation of their weights on every input.
        linear: Ratio of the prior variances of features without and with a random function.
        gravity: Standard deviation of Psi at rest, as a share of the arm's motor limits (the median of the joints); at
            least that of `prior`. Gravity over K is g / (b l) for a link of length l that K gives the bandwidth b: some
            tens of a small arm's prior, and little of a geared arm's.
        eps: Speed over which dry friction turns [rad/s or m/s].
    """

    drift: float = 3e-5
    hidden: int = 25
    weights: float = 0.3
    linear: float = 10.0
    gravity: float = 0.2
    eps: float = 0.03

    positive: ClassVar[tuple[str, ...]] = (*KalmanSettings.positive, "hidden", "linear", "eps")
    most: ClassVar[dict[str, int]] = {"hidden": MOST}

    def __post_init__(self) -> None:
        super().__post_init__()
        require_at_most(self, self.section, self.most)


class KalmanBilinearSettings(RandomFeatures, frozen=True):
    """`kalman_bilinear`: random functions of the arm's joints times what is linear or bilinear.

    Args:
        largest: Most features with a random function, 2000 at most; a robot with many joints has fewer than `hidden`
            times its terms.
    """

    largest: int = 400

    section: ClassVar[str] = "kalman.bilinear"
    positive: ClassVar[tuple[str, ...]] = (*RandomFeatures.positive, "largest")
    most: ClassVar[dict[str, int]] = {"hidden": MOST, "largest": MOST}


class KalmanFeaturesSettings(RandomFeatures, frozen=True):
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


class KalmanResidualSettings(KalmanBilinearSettings, frozen=True):
    """`kalman_residual`: a nominal model (`[nominal]` in an experiment), and bilinear features for what it leaves."""

    section: ClassVar[str] = "kalman.residual"
    needs_regressor: ClassVar[bool] = True
    needs_nominal: ClassVar[bool] = True


KINDS = (KalmanRegressorSettings, KalmanFrictionSettings, KalmanBilinearSettings, KalmanFeaturesSettings)
SETTINGS = {f"kalman_{kind.section.partition('.')[2]}": kind for kind in (*KINDS, KalmanResidualSettings)}
