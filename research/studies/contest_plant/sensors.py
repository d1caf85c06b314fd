"""What the sensors of the platform tell: the truth with white noise, or the steps of encoders."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from research.contest.task import Task

from .plant import NU, POSE, TURNED, Array, Body, Q, to_motors


@dataclass
class Sensors:
    """The sensors of one run.

    Attributes:
        spread: (9,) standard deviations of the noise, as `read` has them.
        steps: (4,) of the encoders of wheels and joints, 0 for none [rad].
        period: Between two readings [s]; velocities are differences of what encoders read, 0 for the true ones.
        velocities: (4, 4) nu from the rates of the encoders.
        rng: For the noise.
        last: (4,) what the encoders read last.
    """

    spread: Array
    steps: Array
    period: float
    velocities: Array
    rng: np.random.Generator
    last: Array | None = None

    @classmethod
    def of(cls, task: Task, body: Body, noise: float, rng: np.random.Generator) -> Sensors:
        """Those of a task, with so many times its noise, of a body as told; an observer is the controller's."""
        sensor, h = task.experiment.sensor, task.experiment.time.control_period
        rates = np.ones(4) * sensor.velocity_noise
        spread = noise * np.array([*sensor.pose_noise, *rates[:2], sensor.noise, sensor.noise, *rates[2:]], float)
        steps = np.array([sensor.wheel_resolution] * 2 + [sensor.resolution] * 2, float)
        period = 0.0 if sensor.velocity == "true" else h
        return cls(spread, steps, period, np.asarray(np.linalg.inv(to_motors(body)), float), rng)

    def read(self, state: Array) -> Array:
        """Pose, base velocity, angles and rates of the joints (9,) of a plant's state, with noise."""
        angles = np.concatenate((state[TURNED : TURNED + 2], state[Q : Q + 2]))
        wide = self.steps > 0.0
        angles[wide] = self.steps[wide] * np.round(angles[wide] / self.steps[wide])
        nu = state[NU : NU + 4]
        if self.period > 0.0:
            nu = self.velocities @ (angles - (angles if self.last is None else self.last)) / self.period
            self.last = angles
        told = np.concatenate((state[POSE : POSE + 3], nu[:2], angles[2:], nu[2:]))
        return told + self.spread * self.rng.standard_normal(9)
