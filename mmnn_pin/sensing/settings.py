"""What a robot's sensors do to the truth, as settings, and as numbers for one robot and one run."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np

from ..errors import ConfigError
from ..model.robot import Robot
from ..settings import Settings, one_or_each, require_gain
from ..signals import Array, IntArray
from .encoders import DEPTH, DIFFERENCE, FILTERED, OBSERVER, STATES, TRUE, VELOCITIES, noise_columns


class Sensor(Settings, frozen=True):
    """Encoders, derivative, odometry, noise and the line to the controller; exact by default.

    Args:
        side: Where the encoders are: on the "joint", or on the "motor", which backlash separates from it.
        resolution: Step of the arm's encoders, one number or one per joint [rad or m].
        wheel_resolution: Step of the wheels' encoders [rad].
        offset: Zero error of the arm's encoders, one number or one per joint [rad or m].
        velocity: "true"; "difference" of readings, as in the thesis's experiment; "filtered" derivative
            `s wc / (s + wc)` (backward Euler); or a tracking "observer" with both poles at wc. All but "true" take the
            base's velocity from its wheels.
        bandwidth: wc of the filter and of the observer [rad/s].
        pose: "true", or "odometry": integrated from the wheels' encoders, so that it drifts when they slip.
        noise: Standard deviation of the arm's encoders [rad or m].
        wheel_noise: Of the wheels' encoders [rad].
        velocity_noise: Of the velocities as they are sent, one number or one per velocity [m/s, rad/s].
        pose_noise: Of the pose as it is sent (x, y, phi) [m, m, rad].
        delay: Measurements by which the line is late.
        jitter: Largest further delay; every message is late by a whole number of them, equally likely.
        loss: Probability that a message is lost; the controller keeps what it had.

    Raises:
        ConfigError: A number is out of its range, with the key path.
    """

    side: Literal["joint", "motor"] = "joint"
    resolution: float | tuple[float, ...] = 0.0
    wheel_resolution: float = 0.0
    offset: float | tuple[float, ...] = 0.0
    velocity: Literal["true", "difference", "filtered", "observer"] = "true"
    bandwidth: float = 100.0
    pose: Literal["true", "odometry"] = "true"
    noise: float = 0.0
    wheel_noise: float = 0.0
    velocity_noise: float | tuple[float, ...] = 0.0
    pose_noise: tuple[float, float, float] = (0.0, 0.0, 0.0)
    delay: int = 0
    jitter: int = 0
    loss: float = 0.0

    def __post_init__(self) -> None:
        for name in ("resolution", "wheel_resolution", "noise", "wheel_noise", "velocity_noise", "pose_noise"):
            require_gain(getattr(self, name), f"sensor.{name}")
        if not np.all(np.isfinite(self.offset)):
            raise ConfigError(f"{self.offset} is not finite", fix="use finite numbers", key="sensor.offset")
        if not (math.isfinite(self.bandwidth) and self.bandwidth > 0):
            raise ConfigError(f"{self.bandwidth} rad/s", fix="use a finite number > 0", key="sensor.bandwidth")
        for name in ("delay", "jitter"):
            if not 0 <= getattr(self, name) <= 10_000:
                fix = "use a whole number of measurements from 0 to 10000"
                raise ConfigError(f"{getattr(self, name)}", fix=fix, key=f"sensor.{name}")
        if not 0 <= self.loss < 1:
            raise ConfigError(f"probability {self.loss}", fix="use a number from 0 to below 1", key="sensor.loss")

    @property
    def exact(self) -> bool:
        """Whether the controller gets the true state at once."""
        return self == _exact(self.bandwidth, self.side)

    def on(self, robot: Robot, period: float) -> Sensing:
        """The sensors of one robot.

        Args:
            robot: The robot.
            period: Time between two measurements [s].

        Raises:
            ConfigError: Not one number per joint, or wheels to be measured on a robot that has none.
        """
        layout = robot.layout
        wheels = [robot.position_names.index(wheel.joint) for wheel in robot.base.wheels] if layout.base else []
        if layout.base and not wheels and (self.velocity != "true" or self.pose != "true"):
            key = "sensor.velocity" if self.velocity != "true" else "sensor.pose"
            fix = "use 'true'"
            raise ConfigError(f"'{robot.name}' has no wheels with encoders", why="forces drive it", fix=fix, key=key)
        W = np.linalg.pinv(robot.T[wheels, : layout.base]) if wheels else np.zeros((layout.base, 0))
        parts = [
            [VELOCITIES[self.velocity], self.pose == "odometry", period, *self._derivative(period)],
            [self.delay, self.jitter, self.loss, self.delay + self.jitter + 1],
            *(self._encoders(name, len(wheels), layout.arm) for name in ("resolution", "offset", "noise")),
            one_or_each(self.velocity_noise, layout.dof, "velocity", "sensor.velocity_noise"),
            self.pose_noise if layout.base else (),
        ]
        return Sensing(
            encoders=np.array([*wheels, *robot.arm_index], np.int64),
            W=np.ascontiguousarray(W),
            numbers=np.concatenate([np.asarray(part, float) for part in parts]),
            pose=layout.pose,
            velocities=layout.dof,
            message=layout.pose + layout.base + 2 * layout.arm,
        )

    def _derivative(self, period: float) -> tuple[float, float]:
        """Coefficients of the derivative: of a first-order filter, or alpha and beta / period of the observer."""
        mode = VELOCITIES[self.velocity]
        if mode == FILTERED:
            return self.bandwidth * period / (1.0 + self.bandwidth * period), 0.0
        if mode == OBSERVER:
            pole = math.exp(-self.bandwidth * period)
            return 1.0 - pole**2, (1.0 - pole) ** 2 / period
        return float(mode in (TRUE, DIFFERENCE)), 0.0

    def _encoders(self, name: str, wheels: int, joints: int) -> Array:
        """One number per encoder: the wheels', then the arm's."""
        of_wheels = {"resolution": self.wheel_resolution, "offset": 0.0, "noise": self.wheel_noise}[name]
        of_joints = one_or_each(getattr(self, name), joints, "joint", f"sensor.{name}")
        return np.concatenate((np.full(wheels, of_wheels), of_joints))


@lru_cache(maxsize=100)
def _exact(bandwidth: float, side: Literal["joint", "motor"]) -> Sensor:
    return Sensor(bandwidth=bandwidth, side=side)


@dataclass(frozen=True, eq=False)
class Sensing:
    """The sensors of one robot as arrays; arguments of `encoders.measure`.

    Attributes:
        encoders: (nw + n,) places in the position: wheels, then arm joints.
        W: (nb, nw) base velocity from the rates of the wheels.
        numbers: Settings in the order given in `encoders`.
        pose: Number of pose coordinates.
        velocities: Number of velocities that are sent.
        message: Size of a measurement.
    """

    encoders: IntArray
    W: Array
    numbers: Array
    pose: int
    velocities: int
    message: int

    def init(self) -> Array:
        """Memory before the first measurement."""
        depth = int(self.numbers[DEPTH])
        return np.zeros(STATES + 4 * self.encoders.size + self.pose + (depth + 1) * self.message)

    def noise(self, count: int, rng: np.random.Generator) -> Array:
        """Random numbers for `count` measurements, (count, columns); those of fewer are the first of them.

        The last two columns are zero: no message later than its line makes it, none corrupted.
        """
        columns = noise_columns(self.encoders.size, self.velocities, self.pose)
        normal, uniform = rng.spawn(2)
        normals, uniforms = normal.standard_normal((count, columns - 4)), uniform.random((count, 2))
        return np.hstack((normals, uniforms, np.zeros((count, 2))))
