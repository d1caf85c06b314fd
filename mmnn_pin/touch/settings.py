"""Settings of the observer of external torque: the table `[touch]` of an experiment."""

from __future__ import annotations

from typing import Literal

from ..errors import ConfigError
from ..settings import Settings, require_numbers

MAY_BE_ZERO = ("masses", "friction", "torque", "clear", "settle", "yields")


class Touch(Settings, frozen=True):
    """The observer of external torque: which model it has, how fast it is, and what of it is in doubt.

    Standard deviations of the model make the band: contact is felt where the external torque is so far outside that
    the model's own errors bring it there once in `1 / false_alarms` samples.

    Args:
        hand: Link or joint at whose origin the wrench is given; empty for the hand of the arm.
        model: "urdf" takes the robot's file. "learner" takes Psi_hat of the controller, and only the inertia that
            resists the tracking error from the file. "both" weighs the two by their covariances; a learner without a
            covariance then has no weight.
        bandwidth: Bandwidth of the observer [1/s].
        false_alarms: Share of the samples in which a robot that nothing touches feels contact.
        masses: Standard deviation of a body's masses and inertias, relative.
        friction: Standard deviation of the model's friction, relative.
        torque: Standard deviation of the motors' torque, relative.
        unknown: Standard deviation of what no model has, over the feedback gains [m/s, rad/s].
        clear: How long nothing may be felt before a contact is over [s].
        settle: How long a frozen learner waits after a contact until the robot is back on its reference; the torque
            that replaces the contact's fades with half of it [s].
        yields: Share of the feedback that damps a robot which gives way (`safety.contact = "comply"`).
        back: Largest velocity at which a robot that gave way goes back [m/s, rad/s].
        learning: How a learner treats contact: "frozen" does not learn until `settle` after it, "deadzone" does not
            learn in samples that feel it, "on" always learns.

    Raises:
        ConfigError: A number out of range.

    >>> Touch(bandwidth=80.0).false_alarms
    0.001
    """

    hand: str = ""
    model: Literal["urdf", "learner", "both"] = "both"
    bandwidth: float = 50.0
    false_alarms: float = 1e-3
    masses: float = 0.1
    friction: float = 0.3
    torque: float = 0.03
    unknown: float = 0.02
    clear: float = 0.2
    settle: float = 1.5
    yields: float = 0.1
    back: float = 0.2
    learning: Literal["frozen", "deadzone", "on"] = "frozen"

    def __post_init__(self) -> None:
        require_numbers(self, "touch", set(self.__struct_fields__) - set(MAY_BE_ZERO))
        if not self.false_alarms < 1.0:
            raise ConfigError(f"{self.false_alarms}", fix="use a share below 1", key="touch.false_alarms")
