"""Simulated motions whose truth is known: joints on sums of sines, efforts by Pinocchio, noise where it is wanted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import scipy

from mmnn_pin.deploy.identify.log import Log
from mmnn_pin.model.robot import Robot
from mmnn_pin.signals import Array

RATE = 100.0


def sines(
    robot: Robot, duration: float = 20.0, rate: float = RATE, seed: int = 0, speed: float = 1.0, ahead: float = 0.0
) -> tuple[Array, Array, Array, Array]:
    """Times (N,), and coordinates, rates and accelerations of nu (N, p): four sines of incommensurable frequencies.

    With a speed ahead the base has that, too, and all begins at rest, in a second.
    """
    rng, p = np.random.default_rng(seed), robot.dimensions.dof
    t = np.arange(0.0, duration, 1 / rate)
    frequency = 2 * np.pi * np.array([0.11, 0.23, 0.37, 0.53])
    x, v, a = np.zeros((3, len(t), p))
    for j in range(p):
        for w in frequency * rng.uniform(0.9, 1.1, 4):
            size, phase = speed * rng.uniform(0.3, 0.7) / w / 2, rng.uniform(0, 2 * np.pi)
            x[:, j] += size * np.sin(w * t + phase)
            v[:, j] += size * w * np.cos(w * t + phase)
            a[:, j] -= size * w * w * np.sin(w * t + phase)
    if not ahead:
        return t, x, v, a
    x[:, 0] += ahead * t
    v[:, 0] += ahead
    u = np.minimum(t, 1.0)
    s, ds, dds = t - u + u**3 - u**4 / 2, 3 * u**2 - 2 * u**3, 6 * u * (1 - u)
    x, v, a = (scipy.interpolate.make_interp_spline(t, part, 5)(s) for part in (x, v, a))
    return t, x, v * ds[:, None], a * ds[:, None] ** 2 + v * dds[:, None]


def efforts(robot: Robot, x: Array, v: Array, a: Array, rotors: Array | float = 0.0) -> Array:
    """Generalized forces (N, p) by Pinocchio's inverse dynamics, and friction of the joints, dry as tanh."""
    model, data, T = robot.model, robot.model.createData(), np.array(robot.T)
    offset, arm = robot.arm_map()
    nb, found = robot.dimensions.base, np.zeros_like(v)
    armature = np.array(model.armature)
    armature[robot.arm_index] += rotors
    for i in range(len(x)):
        position = offset + arm @ x[i, nb:]
        q, rate = robot.configuration(position), T @ v[i]
        full = pin.rnea(model, data, q, rate, T @ a[i]) - np.array(model.armature) * (
            T @ a[i]
        )  # rnea has no armature? see below
        full = full + armature * (T @ a[i])
        full += robot.damping * rate + robot.coulomb * np.tanh(rate / 0.01)
        found[i] = T.T @ full
    return found


def simulated(
    robot: Robot,
    duration: float = 20.0,
    noise: float = 0.0,
    seed: int = 0,
    rotors: Array | float = 0.0,
    speed: float = 1.0,
    ahead: float = 0.0,
) -> Log:
    """A log of the joints' and wheels' positions and of all motors' torques.

    Args:
        robot: The true one.
        duration: [s].
        noise: Standard deviation of the torques' noise, relative to each one's RMS.
        seed: Of motion and noise.
        rotors: Of the arm's joints [kg m^2].
        speed: Of all velocities, relative.
        ahead: The base's mean speed, see `sines`.
    """
    t, x, v, a = sines(robot, duration, seed=seed, speed=speed, ahead=ahead)
    tau = efforts(robot, x, v, a, rotors)
    u = tau @ np.linalg.pinv(robot.E).T
    u += noise * np.sqrt((u**2).mean(axis=0)) * np.random.default_rng(seed + 1000).standard_normal(u.shape)
    nb = robot.dimensions.base
    position = {name: x[:, nb + i] for i, name in enumerate(robot.joint_names)}
    rows = [robot.full_velocity_names.index(wheel.joint) for wheel in robot.base.wheels]
    position |= {w.joint: x[:, :nb] @ robot.T[row, :nb] for w, row in zip(robot.base.wheels, rows, strict=True)}
    velocity = {name: v[:, nb + i] for i, name in enumerate(robot.joint_names)}
    effort = {name: u[:, i] for i, name in enumerate(robot.actuator_names)}
    return replace(Log.of(t, position, effort, velocity), name="simulated")


def rubbing(robot: Robot, viscous: float = 2.0, coulomb: float = 1.0) -> Robot:
    """The same robot with friction in all its moving joints, growing along the arm."""
    moving = robot.T.any(axis=1)
    moving[: 3 if robot.dimensions.base else 0] = False
    grow = np.cumsum(moving) * moving
    dry = np.where(moving, coulomb * grow / grow.max(), robot.coulomb)  # a base that scrubs does so all the same
    return replace(robot, damping=viscous * grow / grow.max(), coulomb=dry)
