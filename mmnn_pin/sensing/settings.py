"""A robot's sensors, as settings, and as a list of effects for one robot and one run."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Literal

import numpy as np

from ..elementary import exp
from ..elementary.matrices import pseudo_inverse
from ..elementary.normals import standard_normal
from ..errors import ConfigError
from ..model.base.rolling import new_maps
from ..model.robot import Robot
from ..settings import Settings, one_or_each, require_gain
from ..signals import Array, Dimensions, IntArray
from .effects import (
    CLOCK,
    COLUMNS,
    ESTIMATE,
    READING,
    Encoders,
    MessageLine,
    Noise,
    Rates,
    Reading,
    Sensors,
    SteeredRows,
    Velocities,
    WheelOdometry,
)

LARGEST_NOISE = 4.0  # standard deviations


class Sensor(Settings, frozen=True):
    """Encoders, derivative, odometry, noise and the line to the controller; exact by default.

    Args:
        side: Where the encoders are: on the "joint", or on the "motor", which backlash separates from it.
        resolution: Step of the arm's encoders, one number or one per joint [rad or m].
        wheel_resolution: Step of the wheels' encoders [rad].
        steering_resolution: Step of the encoders on steering, casters and hitches [rad].
        offset: Zero error of the arm's encoders, one number or one per joint [rad or m].
        steering_offset: Zero error of the encoders on steering, casters and hitches, one number or one per joint [rad].
        velocity: "true"; "difference" of readings, as in the thesis's experiment; "filtered" derivative
            `s wc / (s + wc)` (backward Euler); a tracking "observer" with both poles at wc; or "model", an observer
            with three poles at wc that expects the acceleration of torque and Psi_hat (`loop.hardware.Expected`) and
            estimates angles, too. All but "true" take the base's velocity from its wheels, and from what they steer by.
        bandwidth: wc of the filter and of the observers [rad/s].
        pose: "true", or "odometry": integrated from the wheels' encoders, so that it drifts when they slip.
        noise: Standard deviation of the arm's encoders [rad or m]. No noise is larger than `LARGEST_NOISE` deviations.
        wheel_noise: Standard deviation of the wheels' encoders [rad].
        steering_noise: Standard deviation of encoders on steering, casters and hitches [rad].
        velocity_noise: Standard deviation of the velocities that are sent, one number or one per velocity [m/s, rad/s].
        pose_noise: Standard deviation of the pose that is sent (x, y, phi) [m, m, rad].
        base_period: Time between new poses and velocities of the base, in whole measurements; 0 for every one [s].
        base_delay: How much later the base's pose and velocity come than the rest, in whole measurements [s].
        delay: Delay of messages, in measurements.
        jitter: Largest further delay, in measurements; every whole number up to it is equally likely.
        loss: Probability that a message is lost; the controller keeps what it had.

    Raises:
        ConfigError: A number is out of its range, with the key path.
    """

    side: Literal["joint", "motor"] = "joint"
    resolution: float | tuple[float, ...] = 0.0
    wheel_resolution: float = 0.0
    steering_resolution: float = 0.0
    offset: float | tuple[float, ...] = 0.0
    steering_offset: float | tuple[float, ...] = 0.0
    velocity: Literal["true", "difference", "filtered", "observer", "model"] = "true"
    bandwidth: float = 100.0
    pose: Literal["true", "odometry"] = "true"
    noise: float = 0.0
    wheel_noise: float = 0.0
    steering_noise: float = 0.0
    velocity_noise: float | tuple[float, ...] = 0.0
    pose_noise: tuple[float, float, float] = (0.0, 0.0, 0.0)
    base_period: float = 0.0
    base_delay: float = 0.0
    delay: int = 0
    jitter: int = 0
    loss: float = 0.0

    def __post_init__(self) -> None:
        for name in self.__struct_fields__:
            if name.endswith(("resolution", "noise", "base_period", "base_delay")):
                require_gain(getattr(self, name), f"sensor.{name}")
            elif name.endswith("offset") and not np.all(np.isfinite(getattr(self, name))):
                what = f"{getattr(self, name)} is not finite"
                raise ConfigError(what, fix="use finite numbers", key=f"sensor.{name}")
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

    def smoothing(self, period: float) -> float:
        """By how much the velocities' filter is late, to an integral of them: it is stable up to the rate 1 / this.

        That holds for loops slower than the filter. The observer on a model knows the torque but not why an integral
        changes it; 1.1 is the most it needs whatever the bandwidth of the loop.

        Args:
            period: Between two measurements [s].
        """
        poles = {"filtered": 1.0, "observer": 2.0, "model": 1.1}
        return period / 2 if self.velocity == "difference" else poles.get(self.velocity, 0.0) / self.bandwidth

    def line(self, period: float) -> float:
        """How long a message is under way on the line, at its longest [s]; arguments as of `smoothing`."""
        return (self.delay + self.jitter) * period + self.base_age(period)

    def base_age(self, period: float) -> float:
        """How old pose and velocity of the base become before there are new ones [s]; likewise."""
        return (self._every(period) - 1 + self._base_late(period)) * period

    def _every(self, period: float) -> int:
        return max(1, math.ceil(self.base_period / period - 1e-9))

    def _base_late(self, period: float) -> int:
        return math.ceil(self.base_delay / period - 1e-9)

    def on(
        self,
        robot: Robot,
        period: float,
        count: int,
        rng: np.random.Generator,
        faults: Array | None = None,
        state: Array | None = None,
    ) -> Sensors:
        """The sensors of one robot for one run.

        Args:
            robot: The robot.
            period: Time between two measurements [s].
            count: How many measurements there will be.
            rng: For noise, jitter and losses; a shorter run draws the first numbers of a longer one.
            faults: (count, 2) further delay of every message in measurements, negative for a lost one, and an offset on
                all its numbers; None for none.
            state: Of the sensors, from `init`; None for a new one.

        Raises:
            ConfigError: Not one number per joint, or wheels to be measured on a robot that has none.
        """
        layout, period = robot.dimensions, float(period)
        faults = np.zeros((count, 2)) if faults is None else faults
        state = self.init(robot, period, faults) if state is None else state
        places, n, p, K = self._encoders(robot), layout.arm, layout.dof, layout.shape
        nw, rows = len(places), np.ascontiguousarray(robot.T_at(robot.rest)[places, : layout.base])
        W = pseudo_inverse(rows) if nw else np.zeros((layout.base, 0))
        angles, rates, poses, uniforms = drawn(rng, count, (nw + n, p, layout.pose))
        size = message_size(layout)
        expected, biased = self._modelled(robot)
        ends = np.cumsum([CLOCK, COLUMNS * (nw + n), layout.pose, size, expected, biased])
        clock, joints, pose, received, acceleration, bias, slots = np.split(state, ends)
        joints, message = joints.reshape(-1, COLUMNS), np.zeros(size)
        wire = Reading(np.zeros(layout.full), np.zeros(p), clock, joints, message, received, acceleration, bias, K)
        spread = np.array(one_or_each(self.velocity_noise, p, "velocity", "sensor.velocity_noise"))
        path = np.zeros((3, nw))
        if nw and not K:
            path[robot.base.columns] = W
        steered = steered_rows(robot, np.array(places, np.int64), rows, W, path) if K else ()
        effects = (
            Encoders(
                np.array([*places, *robot.arm_index], np.int64),
                self._per_encoder(robot, nw, "resolution"),
                self._per_encoder(robot, nw, "offset"),
                self._per_encoder(robot, nw, "noise"),
                angles,
            ),
            *steered,
            Rates(self.velocity in ("observer", "model"), period, *self.derivative(period), rows),
            Velocities(self.velocity == "true", W, ESTIMATE if self.velocity == "model" else READING),
            WheelOdometry(self.pose == "odometry", path, pose),
            Noise(spread, np.array(self.pose_noise[: layout.pose], float), rates, poses),
            MessageLine(
                self.delay,
                self.jitter,
                float(self.loss),
                uniforms,
                faults,
                layout.pose + layout.base,
                self._every(period),
                self._base_late(period),
                slots.reshape(-1, size),
            ),
        )
        return Sensors(period, wire, effects)

    def init(self, robot: Robot, period: float, faults: Array | None = None) -> Array:
        """State before the first measurement: clock, encoders, odometry, what was received, the line."""
        layout = robot.dimensions
        size = message_size(layout)
        latest = 0 if faults is None else int(max(faults[:, 0].max(initial=0.0), 0.0))
        depth = self.delay + self.jitter + 1 + latest + self._base_late(period)
        encoders = COLUMNS * (len(self._encoders(robot)) + layout.arm)
        return np.zeros(CLOCK + encoders + layout.pose + sum(self._modelled(robot)) + (depth + 1) * size)

    def _modelled(self, robot: Robot) -> tuple[int, int]:
        """Sizes of the acceleration that the observer on a model is told, and of what it learns of it."""
        if self.velocity != "model":
            return 0, 0
        return robot.dimensions.dof, len(self._encoders(robot)) + robot.dimensions.arm

    def _encoders(self, robot: Robot) -> list[int]:
        """Places of the base's encoders in the position: on its wheels, then on its pivots.

        Raises:
            ConfigError: They are to be read, and there are none.
        """
        if not robot.dimensions.base:
            return []
        wheels = [robot.position_names.index(wheel.joint) for wheel in robot.base.wheels]
        if not wheels and (self.velocity != "true" or self.pose != "true"):
            key = "sensor.velocity" if self.velocity != "true" else "sensor.pose"
            fix = "use 'true'"
            raise ConfigError(f"'{robot.name}' has no wheels with encoders", why="forces drive it", fix=fix, key=key)
        return [*wheels, *map(int, robot.shape_index)]

    def derivative(self, period: float) -> tuple[float, float, float]:
        """Coefficients of the rates, see `Rates`: of a filter, or alpha, beta / period, gamma / period^2."""
        if self.velocity == "filtered":
            return self.bandwidth * period / (1.0 + self.bandwidth * period), 0.0, 0.0
        pole = exp(-self.bandwidth * period)
        left = 1.0 - pole
        if self.velocity == "observer":
            return 1.0 - pole * pole, left * left / period, 0.0
        if self.velocity == "model":
            beta = 1.5 * left * left * (1.0 + pole) / period
            return 1.0 - pole * pole * pole, beta, left * left * left / (period * period)
        return 1.0, 0.0, 0.0

    def _per_encoder(self, robot: Robot, count: int, name: str) -> Array:
        """One number per encoder: of the `count` of the base the wheels' first, then the pivots', then the arm's."""
        pivots, joints = robot.dimensions.shape, robot.dimensions.arm
        steering = one_or_each(getattr(self, f"steering_{name}"), pivots, "steering joint", f"sensor.steering_{name}")
        arm = one_or_each(getattr(self, name), joints, "joint", f"sensor.{name}")
        return np.concatenate((np.full(count - pivots, getattr(self, f"wheel_{name}", 0.0)), steering, arm))


def message_size(layout: Dimensions) -> int:
    """Numbers in a message: pose, base velocity, q, qdot, angles of the pivots."""
    return layout.pose + layout.base + 2 * layout.arm + layout.shape


def steered_rows(robot: Robot, places: IntArray, rolls: Array, W: Array, path: Array) -> tuple[SteeredRows]:
    """The effect that keeps the rows (of `Rates`, `Velocities` and `WheelOdometry`) of a base that steers true."""
    d, rolling = robot.dimensions, robot.rolling
    assert rolling is not None
    scratch = robot.rest.copy(), np.zeros(d.dof), np.zeros((2, d.base, d.base)), np.zeros_like(rolls)
    return (SteeredRows(rolling, new_maps(rolling, robot.template), places, *scratch, rolls, W, path),)


def drawn(rng: np.random.Generator, count: int, sizes: tuple[int, ...]) -> tuple[Array, ...]:
    """Random numbers of `count` measurements: normal ones, (count, size) of every size, and two uniform, (count, 2).

    Of 16,000 normal numbers one is beyond `LARGEST_NOISE`, and becomes that: proofs count with bounded noise.
    """
    normal, uniform = rng.spawn(2)
    bounded = np.clip(standard_normal(normal, (count, sum(sizes))), -LARGEST_NOISE, LARGEST_NOISE)
    parts = np.split(bounded, np.cumsum(sizes)[:-1], axis=1)
    return *(np.ascontiguousarray(part) for part in parts), uniform.random((count, 2))


@lru_cache(maxsize=100)
def _exact(bandwidth: float, side: Literal["joint", "motor"]) -> Sensor:
    return Sensor(bandwidth=bandwidth, side=side)
