"""Bases that steer, under their laws, from the formulas of docs/explanation/steered-bases.md: many motions at once.

Beside the package on purpose: what the theorems bound is integrated by other code than what is bounded.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from mmnn_pin.signals import Array

SQUARE = ((0.3, 0.2), (0.3, -0.2), (-0.3, 0.2), (-0.3, -0.2))  # modules of a swerve drive [m]
CAR_GAINS, SWERVE_GAINS = (1.5, 4.0, 3.0), (1.5, 1.5, 1.5)

Reference = Callable[[float], tuple[Array, Array]]


def gyration(pivots: tuple[tuple[float, float], ...]) -> float:
    """Radius of gyration of wheels about the control frame [m]."""
    return float(np.sqrt(np.mean(np.sum(np.square(pivots), axis=1))))


def rows_of(pivots: Array, headings: Array, length: float, trail: float = 0.0) -> Array:
    """(B, N, 3) rows across every wheel on (vx, vy, l w)."""
    c, s = np.cos(headings), np.sin(headings)
    lever = (pivots[:, 0] * c + pivots[:, 1] * s + trail) / length
    return np.stack((-s, c, lever), axis=2)


def spread_of(x: float, y: float, length: float) -> float:
    """c_A, the condition number of the map from (v, l w) to the velocity of the wheel's place."""
    return float(np.linalg.cond(np.array([[1.0, -y / length], [0.0, x / length]])))


def least_second_eigenvalue(pivots: Array, length: float, count: int = 20000) -> float:
    """The least second eigenvalue of `sum r r'` over all headings, by a search that goes on from the best of many."""
    rng = np.random.default_rng(0)

    def second(headings: Array) -> Array:
        rows = rows_of(pivots, headings, length)
        return np.asarray(np.linalg.eigvalsh(np.swapaxes(rows, 1, 2) @ rows)[:, 1], np.float64)

    headings = rng.uniform(0, np.pi, (count, len(pivots)))
    for width in (0.3, 0.1, 0.03, 0.01, 0.003):
        best = headings[np.argsort(second(headings))[: count // 100]]
        headings = np.vstack((best, np.repeat(best, 20, axis=0) + rng.normal(0, width, (20 * len(best), len(pivots)))))
    return float(second(headings).min())


def way_to(across: Array, ahead: Array) -> Array:
    """Chi, the angle from a wheel to the velocity asked of it, within a right angle."""
    return np.asarray(np.arctan2(np.where(ahead < 0, -across, across), np.abs(ahead)), np.float64)


def still(time: float) -> tuple[float, float]:
    """No velocity error at any time."""
    return 0.0, 0.0


@dataclass
class SteeredMotion:
    """Many motions at once of a base under its laws: errors (B, 3), headings (B, N), integrated together."""

    pivots: Array  # (N, 2) places of the wheels that steer [m]
    length: float  # l [m]
    gains: tuple[float, float, float]  # of the pose's law: Kanayama's of a car, else the holonomic one's
    rate: float  # K [1/s]
    car: bool  # whether an axle is fixed at the control frame
    reference: Reference  # (B, 3) reference velocities and their derivatives at a time
    slow: float = 0.0  # eps [m/s]
    limit: float = np.inf  # largest rate of a wheel [rad/s]
    trail: float = 0.0  # t, how far ahead of its axis the wheel of a car, or a loader's other axle, is [m]
    # whether a loader's waist turns as the velocity asked for has it, `-s / t`, not by the law that steers
    exact: bool = False
    # velocity errors (B,) of u and (B, N) of the wheels at a time
    z: Callable[[float], tuple[Array | float, Array | float]] = still
    wait: bool = False  # whether the base waits for its wheels
    turned: Array = field(default_factory=lambda: np.zeros(0))  # (k, B, N) rates of the wheels in the last run [rad/s]

    def asked(self, e: Array, v: Array) -> Array:
        """eta_c (B, 3) of the law of the pose, the thesis's (3.3) or the holonomic one."""
        (kx, ky, kth), c, s = self.gains, np.cos(e[:, 2]), np.sin(e[:, 2])
        if self.car:
            turn = v[:, 2] + v[:, 0] * ky * e[:, 1] + np.abs(v[:, 0]) * kth * s
            return np.stack((v[:, 0] * c + kx * e[:, 0], 0 * c, turn), axis=1)
        ahead, left = c * v[:, 0] - s * v[:, 1] + kx * e[:, 0], s * v[:, 0] + c * v[:, 1] + ky * e[:, 1]
        return np.stack((ahead, left, v[:, 2] + kth * s), axis=1)

    def direction(self, headings: Array) -> tuple[Array, Array]:
        """N (B, 3) on (vx, vy, l w), of either sign, and X (B, 3) there, 0 where all wheels steer."""
        rows = rows_of(self.pivots, headings, self.length, self.trail)
        if self.car:
            none = 0 * rows[:, 0, 0]
            n = np.stack((rows[:, 0, 2], none, -rows[:, 0, 0]), axis=1)
            size = np.hypot(n[:, :1], n[:, 2:])
            X = -self.trail * np.stack((rows[:, 0, 0], none, rows[:, 0, 2]), axis=1)
            return n / size, X / size**2
        n = np.linalg.eigh(np.swapaxes(rows, 1, 2) @ rows)[1][:, :, 0]
        return n, 0 * n

    def places(self, eta: Array, headings: Array) -> tuple[Array, Array]:
        """Across and along every wheel, (B, N)."""
        c, s = np.cos(headings), np.sin(headings)
        px, py = eta[:, :1] - self.pivots[:, 1] * eta[:, 2:], eta[:, 1:2] + self.pivots[:, 0] * eta[:, 2:]
        return c * py - s * px + self.trail * eta[:, 2:], c * px + s * py

    def angles(self, time: float, e: Array, headings: Array) -> Array:
        """Chi (B, N)."""
        across, ahead = self.places(self.asked(e, self.reference(time)[0]), headings)
        return way_to(across, ahead)

    def speeds(self, time: float, e: Array) -> Array:
        """|P| (B, N) of every wheel, as asked."""
        across, ahead = self.places(self.asked(e, self.reference(time)[0]), np.zeros((len(e), len(self.pivots))))
        return np.hypot(across, ahead)

    def rates(self, time: float, e: Array, headings: Array) -> tuple[Array, Array]:
        """Rates of the errors (B, 3) and of the headings (B, N)."""
        v, acceleration = self.reference(time)
        asked, scale = self.asked(e, v), np.array([1.0, 1.0, self.length])
        (n, X), (across, ahead) = self.direction(headings), self.places(asked, headings)
        u = np.sum(n * scale * asked, axis=1) - self.z(time)[0]
        if self.wait:
            u = u * np.min(ahead**2 / (across**2 + ahead**2), axis=1)
        eta = u[:, None] * n / scale
        ed = self.error_rates(e, v, eta)
        step = 1e-6
        later, before = (self.asked(e + k * step * ed, v + k * step * acceleration) for k in (1, -1))
        q, p = self.places((later - before) / (2 * step), headings)
        size2 = across**2 + ahead**2
        top = self.rate * way_to(across, ahead) * size2 + q * ahead - p * across
        turning = np.clip(top / (size2 + self.slow**2), -self.limit, self.limit)
        if self.exact:
            turning = -across / self.trail
        eta = (u[:, None] * n + X * turning[:, :1]) / scale
        return self.error_rates(e, v, eta), turning - self.z(time)[1]

    @staticmethod
    def error_rates(e: Array, v: Array, eta: Array) -> Array:
        """The error kinematics (3.2), with a velocity to the side."""
        c, s = np.cos(e[:, 2]), np.sin(e[:, 2])
        ahead = eta[:, 2] * e[:, 1] - eta[:, 0] + c * v[:, 0] - s * v[:, 1]
        left = -eta[:, 2] * e[:, 0] - eta[:, 1] + s * v[:, 0] + c * v[:, 1]
        return np.stack((ahead, left, v[:, 2] - eta[:, 2]), axis=1)

    def run(self, e: Array, headings: Array, seconds: float, dt: float = 0.004) -> tuple[Array, Array, Array]:
        """Times (k,), errors (k, B, 3), angles to the path (k, B, N)."""
        times: Array = np.linspace(0.0, round(seconds / dt) * dt, round(seconds / dt) + 1)
        errors, chis = [e], [self.angles(0.0, e, headings)]
        turned = []
        for time in times[:-1]:
            k1, before = self.rates(time, e, headings), headings
            k2 = self.rates(time + dt / 2, e + dt / 2 * k1[0], headings + dt / 2 * k1[1])
            k3 = self.rates(time + dt / 2, e + dt / 2 * k2[0], headings + dt / 2 * k2[1])
            k4 = self.rates(time + dt, e + dt * k3[0], headings + dt * k3[1])
            e = e + dt / 6 * (k1[0] + 2 * k2[0] + 2 * k3[0] + k4[0])
            headings = headings + dt / 6 * (k1[1] + 2 * k2[1] + 2 * k3[1] + k4[1])
            errors.append(e)
            chis.append(self.angles(time + dt, e, headings))
            turned.append((headings - before) / dt)
        self.turned = np.array(turned)
        return times, np.array(errors), np.array(chis)

    def begun(self, seed: int, count: int, e: float, chi: float) -> tuple[Array, Array]:
        """Random errors within e (count, 3), and headings within chi of what is asked there."""
        rng = np.random.default_rng(seed)
        errors = rng.uniform(-e, e, (count, 3))
        asked = self.asked(errors, self.reference(0.0)[0])
        ahead = asked[:, :1] - self.pivots[:, 1] * asked[:, 2:]
        left = asked[:, 1:2] + self.pivots[:, 0] * asked[:, 2:]
        return errors, np.arctan2(left, ahead) + rng.uniform(-chi, chi, ahead.shape)


class Constants(NamedTuple):
    """Of `adot <= -lambda a + m (B0 + B1 a) |sin chi|`."""

    m: float  # what a wheel off its path takes, in the size of the pose error
    B0: float  # largest reference velocity in the norm of W [m/s]
    B1: float  # what the pose's law adds per size of the error [1/s]
    ky: float  # weight of the heading in the size, 1 for the holonomic law

    def size(self, e: Array) -> Array:
        """The size a of pose errors (..., 3)."""
        return np.sqrt(e[..., 0] ** 2 + e[..., 1] ** 2 + 2 * (1 - np.cos(e[..., 2])) / self.ky)

    def reached(self, a: Array, chi: Array, rate: float) -> Array:
        """Theorem 1: what the size stays below, from sizes and largest angles at the start."""
        grown = (self.B0 + self.B1 * a) * np.exp(self.m * self.B1 * np.abs(chi) / rate)
        return (grown - self.B0) / self.B1

    def rate_for(self, a: float, chi: float, within: float) -> float:
        """The K with which the size stays below `within` [1/s]."""
        gained = np.log((self.B0 + self.B1 * within) / (self.B0 + self.B1 * a))
        return float(self.m * self.B1 * chi / gained)


def waves(seed: int, count: int, middle: Array, swing: Array) -> Reference:
    """References (count, 3) about a middle, at most swing beside it, with their derivatives."""
    rng = np.random.default_rng(seed)
    rate, phase = rng.uniform(0.5, 2.0, (count, 3)), rng.uniform(0, 6.28, (count, 3))
    return lambda time: (middle + swing * np.sin(rate * time + phase), swing * rate * np.cos(rate * time + phase))


def car(seed: int, count: int, way: float = 1.0, side: float = 0.0) -> tuple[SteeredMotion, Constants]:
    """A car of 0.65 m at 0.5 to 1 m/s on random curves, ahead or in reverse; `side` of the wheel that counts."""
    length, (kx, ky, kth) = 0.65, CAR_GAINS
    reference = waves(seed, count, np.array([way * 0.75, 0.0, 0.0]), np.array([0.25, 0.0, 0.4]))
    m = spread_of(length, side, length) * max(1.0, 1.0 / (length * np.sqrt(ky)))
    constants = Constants(m, float(np.hypot(1.0, 0.4 * length)), max(kx, length * np.sqrt(ky**2 + ky * kth**2)), ky)
    return SteeredMotion(np.array([[length, side]]), length, CAR_GAINS, 6.0, True, reference), constants


def swerve(seed: int, count: int) -> tuple[SteeredMotion, Constants]:
    """Four modules on a rectangle, at 0.6 to 1.1 m/s on random curves, turning."""
    pivots, length, (kx, ky, kphi) = np.array(SQUARE), gyration(SQUARE), SWERVE_GAINS
    reference = waves(seed, count, np.array([0.8, 0.2, 0.0]), np.array([0.2, 0.2, 0.4]))
    m = max(1.0, 1.0 / length) * np.sqrt(len(pivots) / least_second_eigenvalue(pivots, length))
    B0 = float(np.sqrt(1.0 + 0.4**2 + (0.4 * length) ** 2))
    constants = Constants(m, B0, max(kx, ky, length * kphi), 1.0)
    return SteeredMotion(pivots, length, SWERVE_GAINS, 6.0, False, reference), constants


CASES: dict[str, Callable[[int, int], tuple[SteeredMotion, Constants]]] = {
    "car": car,
    "reverse": lambda seed, count: car(seed, count, way=-1.0),
    "left wheel": lambda seed, count: car(seed, count, side=0.22),
    "swerve": swerve,
}


def hitch_on_circle(hitch: Array, curvature: float) -> float:
    """Angle of a trailer while the truck drives a circle: `sin gamma + curvature (h cos gamma + L) = 0`.

    Forward it settles there. In reverse it leaves it: on the truck's tightest circle its size is the largest angle from
    which backing still gets straight; beyond, the trailer folds up however the truck steers.

    Args:
        hitch: (2,) h, L [m].
        curvature: Of the path of the truck's axle, to the left [1/m].

    Returns:
        The angle [rad]; nan where the circle is too tight for it: forward the trailer goes on turning, in reverse a
        truck that can steer so gets it straight from every angle.
    """
    h, length = hitch
    with np.errstate(invalid="ignore"):
        sine = curvature * length / np.hypot(1.0, curvature * h)
        return float(-np.arctan(curvature * h) - np.arcsin(sine))


def backed(
    hitch: Array, most: float, gamma: Array, curvature: Callable[[float], Array], late: float = 0.0, v: float = -0.5
) -> Array:
    """Angles (k, B) of trailers backed for 20 s by a truck of a limited curvature.

    Both bodies are moved in the plane: the truck by its velocity, the trailer by the wheels on its axle, which do not
    slide; the angle is the difference of their headings.

    Args:
        hitch: (2,) h, L [m].
        most: Largest curvature of the truck [1/m].
        gamma: (B,) angles at the start [rad].
        curvature: (B,) what the trailer's law asks for at a time [1/m].
        late: How long the steering takes from stop to stop [s].
        v: Speed of the truck [m/s].
    """
    (h, length), dt = hitch, 0.002
    phi, psi, now, out = 0 * gamma, gamma.copy(), 0 * gamma, [gamma]
    for i in range(round(20 / dt)):
        at = psi - phi + np.arctan(curvature(i * dt) * length)
        target = np.where(np.abs(at) < np.pi / 2, np.clip(-np.tan(at) / h, -most, most), -np.sign(at) * most)
        now = target if late == 0 else now + np.clip(target - now, -2 * most * dt / late, 2 * most * dt / late)
        ahead = v * np.cos(phi) + h * v * now * np.sin(phi)  # of the hitch
        left = v * np.sin(phi) - h * v * now * np.cos(phi)
        psi = psi + dt * (np.cos(psi) * left - np.sin(psi) * ahead) / length
        phi = phi + dt * v * now
        out.append(psi - phi)
    return np.array(out)
