"""A differential-drive platform with a two-joint arm in the plane, written from its URDF without the package's model.

Every body has a velocity that is linear in nu = (v, w, q1', q2'), in the frame of the base, so that Kane's equations
give

    sum m J' (J nudot + Jdot nu + w x J nu) + I theta' theta nudot = (forces of the motors and of friction).

Wheels roll without slip; a load is a point on the second link. Gears may have a gap between rotor and joint, motors a
lag and a ripple. Dry friction is smooth, sticks (set-valued, solved at every step), or is LuGre's (Canudas de Wit,
Olsson, Astrom, Lischinsky 1995, IEEE TAC 40(3)). Steps are of the midpoint rule, dry impulses at their ends.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
URDF = Path(__file__).parents[3] / "urdf" / "platform_arm.urdf"
STEP = 1e-4  # [s]
SMOOTH, STICK, LUGRE = 0, 1, 2
LAWS = {"smooth": SMOOTH, "stick": STICK, "lugre": LUGRE}
SMOOTH_SPEED = 0.01  # of the smooth law's tanh [rad/s]
BRISTLES = 3000.0, 2.0  # stiffness [N m/rad] and damping [N m s/rad] of LuGre's
SWEEPS = 30  # of the solution for what sticks
POSE, NU, Q, BRISTLE, ROTOR, AHEAD, LAGGED, TURNED, STATES = 0, 3, 7, 9, 11, 13, 15, 19, 21


class Body(NamedTuple):
    """The platform: masses [kg], inertias about the vertical [kg m^2], lengths [m].

    Attributes:
        base: Mass, inertia.
        wheel: Mass, inertia about a diameter, about the axle, radius, half the track.
        arm: (2, 3) of both links: mass, inertia, distance of the centre of mass.
        mount: Distance of the first joint from the middle of the axle.
        length: Of the first link.
        limits: (4,) largest torques of the motors [N m].
    """

    base: Array
    wheel: Array
    arm: Array
    mount: float
    length: float
    limits: Array


class World(NamedTuple):
    """What the plant adds to rigid bodies.

    Attributes:
        law: Of the dry friction of the joints: `SMOOTH`, `STICK` or `LUGRE`.
        viscous: (4,) on nu [N s/m, N m s].
        dry: Coulomb's level, static over Coulomb's, Stribeck's velocity [N m, -, rad/s].
        rolling: Dry resistance of each wheel, which sticks [N m].
        gap: Of the joints' gears [rad]; rotor's inertia, stiffness and damping of the flanks.
        lag: Of the motors [s].
        ripple: Share of a torque that comes and goes six times a turn.
        gain: (4,) torque that a motor gives over that which it is asked.
        limited: Whether motors give no more than their limits.
        load: Point mass on the second link: mass, distance from its joint, from when, until when.
    """

    law: int
    viscous: Array
    dry: Array
    rolling: float
    gap: Array
    lag: float
    ripple: float
    gain: Array
    limited: bool
    load: Array


def read(masses: float = 1.0, lengths: float = 1.0, radii: float = 1.0) -> Body:
    """The platform as its URDF says: masses and inertias but the wheels', lengths of the arm, radii, times factors."""
    root = ET.parse(URDF).getroot()
    link = {one.attrib["name"]: one.find("inertial") for one in root.iter("link")}
    joint = {one.attrib["name"]: one for one in root.iter("joint")}

    def mass(name: str) -> float:
        return float(link[name].find("mass").attrib["value"])  # type: ignore[union-attr]

    def inertia(name: str, axis: str) -> float:
        return float(link[name].find("inertia").attrib[axis])  # type: ignore[union-attr]

    def place(element: ET.Element | None) -> list[float]:
        return [float(value) for value in element.find("origin").attrib["xyz"].split()]  # type: ignore[union-attr]

    names = "wheel_left_joint", "wheel_right_joint", "arm_1_joint", "arm_2_joint"
    limits = [float(joint[name].find("limit").attrib["effort"]) for name in names]  # type: ignore[union-attr]
    radius, half_track = place(joint["base_joint"])[2], place(joint["wheel_left_joint"])[1]
    wheel = [mass("wheel_left"), inertia("wheel_left", "izz"), inertia("wheel_left", "iyy"), radii * radius, half_track]
    links = "arm_1", "arm_2"
    arm = [[masses * mass(name), masses * inertia(name, "izz"), lengths * place(link[name])[0]] for name in links]
    base = np.array([masses * mass("base_link"), masses * inertia("base_link", "izz")])
    mount, length = (lengths * place(joint[name])[0] for name in names[2:])
    return Body(base, np.array(wheel), np.array(arm), mount, length, np.array(limits))


@njit
def equations(body: Body, load: float, at: float, nu: Array, q: Array, M: Array, bias: Array) -> None:
    """Mass matrix (4, 4) and `sum m J' (Jdot nu + w x J nu)` (4,) with a point mass on the second link.

    Args:
        body: The platform.
        load: The point mass [kg].
        at: Its distance from the second joint [m].
        nu: (4,) velocities.
        q: (2,) joints.
        M: Mass matrix, written.
        bias: Written.
    """
    M[:] = 0.0
    bias[:] = 0.0
    m_w, diameter, axle, r, b = body.wheel
    rolls = m_w + axle / (r * r)
    v, w = nu[0], nu[1]
    # base and wheels have their centres of mass on the axle: what turning asks of them is lateral, and rolling bears it
    M[0, 0] = body.base[0] + 2.0 * rolls
    M[1, 1] = body.base[1] + 2.0 * (diameter + b * b * rolls)
    c1, s1, c12, s12 = math.cos(q[0]), math.sin(q[0]), math.cos(q[0] + q[1]), math.sin(q[0] + q[1])
    for i in range(3):  # first link, second link, load
        mass, inertia = (body.arm[i, 0], body.arm[i, 1]) if i < 2 else (load, 0.0)
        first = body.arm[0, 2] if i == 0 else body.length  # along the first link
        second = 0.0 if i == 0 else body.arm[1, 2] if i == 1 else at  # along the second
        x1, y1, x2, y2 = first * c1, first * s1, second * c12, second * s12
        x, y = body.mount + x1 + x2, y1 + y2
        w1, w2 = nu[2], nu[2] + nu[3]  # of the links, seen from the base
        Jx, Jy = (1.0, -y, -y1 - y2, -y2), (0.0, x, x1 + x2, x2)
        turn = (0.0, 1.0, 1.0, 0.0 if i == 0 else 1.0)
        dx, dy = -y1 * w1 - y2 * w2, x1 * w1 + x2 * w2  # velocity seen from the base
        ax = -w * dy - x1 * w1 * w1 - x2 * w2 * w2 - w * (w * x + dy)
        ay = w * dx - y1 * w1 * w1 - y2 * w2 * w2 + w * (v - w * y + dx)
        for j in range(4):
            bias[j] += mass * (Jx[j] * ax + Jy[j] * ay)
            for k in range(4):
                M[j, k] += mass * (Jx[j] * Jx[k] + Jy[j] * Jy[k]) + inertia * turn[j] * turn[k]


@njit
def solve(M: Array, x: Array) -> None:
    """Solution of `M x' = x` in place of x (4,), M (4, 4) positive definite and lost."""
    for i in range(4):
        for j in range(i + 1, 4):
            share = M[j, i] / M[i, i]
            x[j] -= share * x[i]
            for k in range(i, 4):
                M[j, k] -= share * M[i, k]
    for i in range(3, -1, -1):
        for k in range(i + 1, 4):
            x[i] -= M[i, k] * x[k]
        x[i] /= M[i, i]


@njit
def level(speed: float, dry: Array) -> float:
    """Largest dry friction at a speed [N m]."""
    return float(dry[0] * (1.0 + (dry[1] - 1.0) * math.exp(-((speed / dry[2]) ** 2))))


@njit
def advance(body: Body, world: World, state: Array, command: Array, time: float, steps: int, dt: float) -> None:
    """Move the state (`STATES`,) on under a held command (4,) of the motors, wheels first.

    Args:
        body: The platform.
        world: The rest.
        state: Pose, nu, q, bristles, rotors' speeds, rotors ahead of their joints, lagged torques, turns of the wheels.
        command: [N m].
        time: Now [s].
        steps: How many.
        dt: Of each [s].
    """
    M, u, force, dry = np.zeros((4, 4)), np.zeros(4), np.zeros(4), np.zeros(4)
    middle, half = np.zeros(4), np.zeros(4)
    nu, q = state[NU:Q], state[Q:BRISTLE]
    T = to_motors(body)
    for k in range(steps):
        now = time + k * dt
        mass = world.load[0] if world.load[2] <= now + 1e-9 < world.load[3] else 0.0
        for j in range(4):
            angle = state[TURNED + j] if j < 2 else q[j - 2]
            u[j] = motor(body, world, state, j, command[j], angle, dt)
        for j in range(2):
            if world.gap[0] > 0.0:
                u[2 + j] = flank(world.gap, state, j, u[2 + j], nu[2 + j], dt)
            dry[2 + j] = bristle(world.dry, state, j, nu[2 + j], dt) if world.law == LUGRE else 0.0
        middle[:] = nu
        half[:2] = q
        for share in (0.5, 1.0):
            accelerate(body, world, mass, T, u, dry, middle, half[:2], M, force)
            middle[:] = nu + share * dt * force
            half[:2] = q + 0.5 * dt * nu[2:]
        if world.law == STICK or world.rolling > 0.0:
            equations(body, mass, world.load[1], nu, half[:2], M, force)
            stick(world, M, T, nu, middle, dt)
        half[:] = 0.5 * (nu + middle)
        nu[:] = middle
        q += dt * half[2:]
        for j in range(2):
            state[TURNED + j] += dt * (T[j, 0] * half[0] + T[j, 1] * half[1])
        heading = state[2] + 0.5 * dt * half[1]
        state[0] += dt * half[0] * math.cos(heading)
        state[1] += dt * half[0] * math.sin(heading)
        state[2] += dt * half[1]


@njit
def to_motors(body: Body) -> Array:
    """Speeds of the motors by nu, (4, 4)."""
    r, b = body.wheel[3], body.wheel[4]
    T = np.eye(4)
    T[0, 0], T[0, 1], T[1, 0], T[1, 1] = 1.0 / r, -b / r, 1.0 / r, b / r
    return T


@njit
def motor(body: Body, world: World, state: Array, j: int, u: float, angle: float, dt: float) -> float:
    """Torque that motor j gives for a command u, its rotor at an angle [N m]."""
    u *= world.gain[j]
    if world.limited:
        u = min(max(u, -body.limits[j]), body.limits[j])
    if world.lag > 0.0:
        state[LAGGED + j] += (1.0 - math.exp(-dt / world.lag)) * (u - state[LAGGED + j])
        u = state[LAGGED + j]
    return u * (1.0 + world.ripple * math.sin(6.0 * angle))


@njit
def accelerate(
    body: Body, world: World, mass: float, T: Array, u: Array, dry: Array, nu: Array, q: Array, M: Array, found: Array
) -> None:
    """Acceleration (4,) under torques u of the motors and a dry friction (4,), into `found`; M is scratch."""
    equations(body, mass, world.load[1], nu, q, M, found)
    for j in range(4):
        found[j] = -found[j] - world.viscous[j] * nu[j] - dry[j]
        for i in range(4):
            found[j] += T[i, j] * u[i]
        if j >= 2 and world.law == SMOOTH:
            found[j] -= level(nu[j], world.dry) * math.tanh(nu[j] / SMOOTH_SPEED)
    solve(M, found)


@njit
def bristle(dry: Array, state: Array, j: int, speed: float, dt: float) -> float:
    """LuGre's friction of joint j, whose bristle moves on by `z' = v - k |v| z / level`, implicit in z [N m]."""
    before, most = state[BRISTLE + j], level(speed, dry)
    after = before + dt * speed
    if most > 0.0:
        after /= 1.0 + dt * BRISTLES[0] * abs(speed) / most
    state[BRISTLE + j] = after
    return float(BRISTLES[0] * after + BRISTLES[1] * (after - before) / dt)


@njit
def stick(world: World, M: Array, T: Array, nu: Array, free: Array, dt: float) -> None:
    """Change velocities (4,) by dry impulses: each holds what it can, and opposes what it cannot (Gauss-Seidel)."""
    answer = np.linalg.solve(M, T.T)  # of nu to an impulse at a motor
    speeds, before, impulse = T @ free, T @ nu, np.zeros(4)
    G = T @ answer
    most = np.zeros(4)
    for j in range(4):
        if j < 2:
            most[j] = dt * world.rolling
        elif world.law == STICK:
            most[j] = dt * level(before[j], world.dry)
    for _ in range(SWEEPS):
        for j in range(4):
            wanted = min(max(impulse[j] - speeds[j] / G[j, j], -most[j]), most[j])
            change = wanted - impulse[j]
            impulse[j] = wanted
            for i in range(4):
                speeds[i] += G[i, j] * change
    free += answer @ impulse


@njit
def flank(gap: Array, state: Array, j: int, u: float, joint: float, dt: float) -> float:
    """Torque that a flank gives to joint j, whose rotor moves on under a torque u [N m]."""
    half, ahead = 0.5 * gap[0], state[AHEAD + j]
    over = ahead - half if ahead > half else ahead + half if ahead < -half else 0.0
    push = gap[2] * over + gap[3] * (state[ROTOR + j] - joint) if over != 0.0 else 0.0
    if push * over <= 0.0:
        push = 0.0
    state[ROTOR + j] += dt * (u - push) / gap[1]
    state[AHEAD + j] += dt * (state[ROTOR + j] - joint)
    return push


def inverse(body: Body, world: World, load: float, nu: Array, nudot: Array, q: Array) -> Array:
    """Generalized torque (4,) that a motion needs, with dry friction as the smooth law has it [N, N m]."""
    M, bias, T = np.zeros((4, 4)), np.zeros(4), to_motors(body)
    equations(body, load, world.load[1], nu, q, M, bias)
    speeds = T @ nu
    most = np.array([world.rolling, world.rolling, level(nu[2], world.dry), level(nu[3], world.dry)])
    return M @ nudot + bias + world.viscous * nu + T.T @ (most * np.tanh(speeds / SMOOTH_SPEED))
