"""Logs with damages at random: is a result ever outside its band without a finding?

    export OPENBLAS_NUM_THREADS=1                                   # small matrices: threads only wait for each other
    python -m research.studies.damaged_logs --logs 1000             # two damages in every other log
    python -m research.studies.damaged_logs --logs 20 --seed 7 --show

Every log is a new motion of a robot whose masses, friction, radii and track are drawn anew; its efforts are Pinocchio's
inverse dynamics, its wheels' path is integrated, noise and steps of encoders are added. A damage of a random kind and
size follows, or two. A log ends in one of these:

    refused     the physics contradicts it, or the fit is no better than the URDF: nothing is written
    warned      a warning stands beside the result; `off` counts those of them with a number outside its band
    right       no warning, and friction, base parameters, radii and track are within four standard deviations
    wrong       no warning, and one of them is not: there must be none. That something was mended is no excuse
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pinocchio as pin

from mmnn_pin import identify, load
from mmnn_pin.deploy.identify.identification import Identification
from mmnn_pin.deploy.identify.log import Log
from mmnn_pin.errors import InputError
from mmnn_pin.model.robot import Robot
from mmnn_pin.model.tree.body import parameters
from mmnn_pin.signals import Array

ROBOTS = ("two_axis_arm", "platform_arm")
RATE, DURATION, NOISE, ENCODER = 100.0, 20.0, 0.01, 2 * np.pi / 16384
FREQUENCIES = 2 * np.pi * np.array([0.11, 0.23, 0.37, 0.53])
SIGMAS = 4.0  # standard deviations that count as a band here, of some forty numbers a log
Damage = Callable[[Log, Robot, np.random.Generator], Log]


# -- sound logs --------------------------------------------------------------------------------------------------------


@cache
def loaded(name: str) -> Robot:
    """A robot of the package."""
    return load(name)


def drawn(robot: Robot, rng: np.random.Generator) -> tuple[Robot, Array]:
    """A robot as its file does not have it, with friction; and radii left and right and track [m]."""
    masses = {name: float(rng.uniform(0.75, 1.3)) for name in robot.joint_names}
    true = robot.with_masses(masses)
    moving = np.abs(robot.T).max(axis=1) > 0
    moving[: 3 if robot.dimensions.base else 0] = False
    viscous, coulomb = (rng.uniform(*of, moving.size) * moving for of in ((0.2, 0.8), (0.1, 0.5)))
    true = replace(true, damping=viscous, coulomb=coulomb)
    if not robot.base.wheels:
        return true, np.zeros(3)
    radius = np.mean([wheel.radius for wheel in robot.base.wheels])
    return true, np.array([radius, radius, robot.base.track]) * rng.uniform(0.97, 1.03, 3)


def sines(
    t: Array, frequencies: Array, n: int, rng: np.random.Generator, largest: float, part: int
) -> tuple[Array, Array, Array]:
    """Coordinates, rates and accelerations (N, n): sums of sines.

    Args:
        t: (N,) times [s].
        frequencies: About those of the sines, of no common measure [rad/s].
        n: How many coordinates.
        rng: Draws frequencies, rates and phases.
        largest: Rate of a sine, `part` times [rad/s].
        part: Of how many sines a rate is made.
    """
    x, v, a = np.zeros((3, len(t), n))
    for j in range(n):
        for w in frequencies * rng.uniform(0.9, 1.1, len(frequencies)):
            size, phase = rng.uniform(0.3, largest) / w / part, rng.uniform(0, 2 * np.pi)
            x[:, j] += size * np.sin(w * t + phase)
            v[:, j] += size * w * np.cos(w * t + phase)
            a[:, j] -= size * w * w * np.sin(w * t + phase)
    return x, v, a


def motion(robot: Robot, rng: np.random.Generator) -> tuple[Array, Array, Array, Array]:
    """Times (N,), and coordinates, rates and accelerations of nu (N, p)."""
    t = np.arange(0.0, DURATION, 1 / RATE)
    return t, *sines(t, FREQUENCIES, robot.dimensions.dof, rng, 0.7, 2)


def efforts(robot: Robot, x: Array, v: Array, a: Array) -> Array:
    """Efforts of the motors (N, m): Pinocchio's inverse dynamics and friction of the joints, dry as tanh."""
    model, data, T = robot.model, robot.model.createData(), np.array(robot.T)
    offset, arm = robot.arm_map()
    found = np.zeros_like(v)
    for i in range(len(x)):
        q, rate = robot.configuration(offset + arm @ x[i, robot.dimensions.base :]), T @ v[i]
        full = pin.rnea(model, data, q, rate, T @ a[i])
        found[i] = T.T @ (full + robot.damping * rate + robot.coulomb * np.tanh(rate / 0.01))
    return found @ np.linalg.pinv(robot.E).T


def sound_log(robot: Robot, true: Robot, wheels: Array, rng: np.random.Generator) -> Log:
    """The log of a motion, with noise and steps of encoders, and a reference of the base."""
    t, x, v, a = motion(robot, rng)
    u, nb = efforts(true, x, v, a), robot.dimensions.base
    u += NOISE * np.sqrt((u**2).mean(axis=0)) * rng.standard_normal(u.shape)
    position = {name: x[:, nb + i] for i, name in enumerate(robot.joint_names)}
    velocity = {name: v[:, nb + i] + 2e-3 * rng.standard_normal(len(t)) for i, name in enumerate(robot.joint_names)}
    reference: dict[str, Array] = {}
    if nb:
        for wheel in robot.base.wheels:
            row = robot.full_velocity_names.index(wheel.joint)
            position[wheel.joint] = x[:, :nb] @ robot.T[row, :nb]
        sides = [next(w for w in robot.base.wheels if (w.y > 0) == left) for left in (True, False)]
        turned = np.column_stack([w.sign * position[w.joint] for w in sides]) * wheels[:2]
        phi = (turned[:, 1] - turned[:, 0]) / wheels[2]
        way = np.diff(turned.mean(axis=1))
        middle = (phi[1:] + phi[:-1]) / 2
        at = np.cumsum(np.column_stack((way * np.cos(middle), way * np.sin(middle))), axis=0)
        pose = np.column_stack((np.vstack((np.zeros(2), at)), phi)) + 1e-3 * rng.standard_normal((len(t), 3))
        reference = dict(zip(("x", "y", "phi"), pose.T, strict=True))
    position = {name: ENCODER * np.round(values / ENCODER) for name, values in position.items()}
    effort = dict(zip(robot.actuator_names, u.T, strict=True))
    return Log.of(t, position, effort, velocity, reference=reference, name="drawn")


# -- damages -----------------------------------------------------------------------------------------------------------


def some(log: Log, kinds: Sequence[str], rng: np.random.Generator) -> str:
    """A signal of some kinds that moves."""
    names = [name for name, values in log.signals.items() if name.startswith(tuple(kinds)) and np.ptp(values) > 0]
    return str(rng.choice(names))


def changed(log: Log, signals: dict[str, Array]) -> Log:
    """A log with other numbers in some signals."""
    return log.with_signals(log.signals | signals)


def delayed(values: Array, time: Array, late: float) -> Array:
    """A signal so much later."""
    return np.interp(time - late, time, values)


def time_unit(log: Log, robot: Robot, rng: np.random.Generator) -> Log:
    """Times in ms, us or ns, from anywhere."""
    return log.with_signals(log.signals, (log.time + rng.uniform(0, 100)) * rng.choice([1e3, 1e6, 1e9]))


def degrees(log: Log, robot: Robot, rng: np.random.Generator) -> Log:
    """A position, or all, in degrees."""
    names = [name for name in log.signals if name.startswith("position.")]
    chosen = names if rng.random() < 0.5 else [str(rng.choice(names))]
    return changed(log, {name: np.rad2deg(log.signals[name]) for name in chosen})


def millimetres(log: Log, robot: Robot, rng: np.random.Generator) -> Log:
    """The reference in mm or cm, or its heading in degrees."""
    if not log.reference:
        return degrees(log, robot, rng)
    if rng.random() < 0.4:
        return changed(log, {"reference.phi": np.rad2deg(log.reference["reference.phi"])})
    factor = rng.choice([1e3, 1e2])
    return changed(log, {name: factor * log.reference[name] for name in ("reference.x", "reference.y")})


def sign(log: Log, robot: Robot, rng: np.random.Generator) -> Log:
    """A position, a rate or an effort with the other sign."""
    name = some(log, ("position.", "velocity.", "effort."), rng)
    return changed(log, {name: -log.signals[name]})


def exchange(log: Log, robot: Robot, rng: np.random.Generator) -> Log:
    """Two positions, rates or efforts exchanged."""
    kind = str(rng.choice(["position.", "velocity.", "effort."]))
    a, b = rng.choice([name for name in log.signals if name.startswith(kind)], 2, replace=False)
    return changed(log, {a: log.signals[b], b: log.signals[a]})


def seam(log: Log, robot: Robot, rng: np.random.Generator) -> Log:
    """An encoder that turns over, at a random place of a turn."""
    name = some(log, ("position.",), rng)
    turn, at = 2 * np.pi, rng.uniform(-np.pi, np.pi)
    return changed(log, {name: (log.signals[name] - at) % turn + at})


def late(log: Log, robot: Robot, rng: np.random.Generator) -> Log:
    """Efforts, rates or the reference late or early."""
    kind = str(rng.choice(["effort.", "velocity.", "reference."]))
    by = rng.uniform(0.01, 0.2) * (1 if rng.random() < 0.7 else -1)
    return changed(log, {n: delayed(v, log.time, by) for n, v in log.signals.items() if n.startswith(kind)})


def stairs(log: Log, robot: Robot, rng: np.random.Generator) -> Log:
    """Signals of a kind held for some rows."""
    kind, rows = str(rng.choice(["position.", "effort."])), int(rng.integers(2, 9))
    held = (np.arange(len(log.time)) // rows) * rows
    return changed(log, {n: v[held] for n, v in log.signals.items() if n.startswith(kind)})


def clipping(log: Log, robot: Robot, rng: np.random.Generator) -> Log:
    """An effort that saturates."""
    name = some(log, ("effort.",), rng)
    most = rng.uniform(0.5, 0.9) * np.abs(log.signals[name]).max()
    return changed(log, {name: np.clip(log.signals[name], -most, most)})


def rolled(log: Log, robot: Robot, rng: np.random.Generator) -> Log:
    """A counter of times that rolls over."""
    turn = 2.0**16 * rng.choice([1e-6, 1e-3]) if rng.random() < 0.5 else 2.0**32 * 1e-9
    return log.with_signals(log.signals, (log.time + rng.uniform(0, turn)) % turn)


def two_in_one(log: Log, robot: Robot, rng: np.random.Generator) -> Log:
    """Two recordings one after the other, with times that begin anew, or go on."""
    n = len(log.time)
    cut = int(rng.integers(n // 3, 2 * n // 3))
    skip = int(rng.integers(200, 800))
    rows = np.concatenate((np.arange(cut), np.arange(min(cut + skip, n - 500), n)))
    time = np.arange(len(rows)) / RATE
    if rng.random() < 0.5:
        time[cut:] -= time[cut]
    return log.with_signals({name: values[rows] for name, values in log.signals.items()}, time)


def gaps(log: Log, robot: Robot, rng: np.random.Generator) -> Log:
    """Rows that are missing, single ones and stretches."""
    keep = rng.random(len(log.time)) > rng.uniform(0.0, 0.3)
    for _ in range(int(rng.integers(1, 4))):
        at = int(rng.integers(0, len(log.time) - 200))
        keep[at : at + int(rng.integers(20, 200))] = False
    return log.rows(np.flatnonzero(keep))


def mounting(log: Log, robot: Robot, rng: np.random.Generator) -> Log:
    """A reference of a marker somewhere on the base, in a world turned anyhow."""
    if not log.reference:
        return gaps(log, robot, rng)
    x, y, phi = (log.reference[f"reference.{n}"] for n in ("x", "y", "phi"))
    a, b, turn, world = rng.uniform(-0.3, 0.3), rng.uniform(-0.3, 0.3), rng.uniform(-3, 3), rng.uniform(-3, 3)
    x, y = x + a * np.cos(phi) - b * np.sin(phi), y + a * np.sin(phi) + b * np.cos(phi)
    c, s = np.cos(world), np.sin(world)
    made = {"x": c * x - s * y, "y": s * x + c * y, "phi": (phi + turn + world + np.pi) % (2 * np.pi) - np.pi}
    return changed(log, {f"reference.{n}": values for n, values in made.items()})


def holes(log: Log, robot: Robot, rng: np.random.Generator) -> Log:
    """Numbers that are none, in a signal, or in one that nobody needs."""
    name = some(log, ("position.", "velocity.", "effort."), rng)
    values = np.where(rng.random(len(log.time)) < rng.choice([0.01, 0.3, 1.0]), np.nan, log.signals[name])
    return changed(log, {name: values})


def at_rest(log: Log, robot: Robot, rng: np.random.Generator) -> Log:
    """Wheels that stand still, as where their encoders were not connected."""
    wheels = [f"position.{wheel.joint}" for wheel in robot.base.wheels]
    return changed(log, {name: np.zeros(len(log.time)) for name in wheels}) if wheels else sign(log, robot, rng)


DAMAGES: tuple[Damage, ...] = (
    time_unit, degrees, millimetres, sign, exchange, seam, late, stairs, clipping, rolled, two_in_one, gaps, mounting,
    holes, at_rest,
)  # fmt: skip


# -- how a log ends ----------------------------------------------------------------------------------------------------


def outside(found: Identification, true: Robot, wheels: Array) -> list[str]:
    """Numbers that are further from the truth than `SIGMAS`."""
    labels, seen = found.unknowns.labels, []
    theta = np.concatenate((parameters(true), np.zeros(found.unknowns.size - found.unknowns.regressor.size)))
    C, covariance = found.fit.base.combination, found.consistent.covariance
    sd = np.sqrt(np.maximum(np.diag(C @ covariance @ C.T), 0.0))
    size = np.abs(C) @ np.abs(theta)
    off = np.abs(C @ (found.theta - theta)) > SIGMAS * sd + 1e-3 * size + 1e-6
    seen += [found.fit.base.name(int(i), labels) for i in np.flatnonzero(off)]
    if found.wheels is not None:
        away = np.abs(found.wheels.value - wheels) > SIGMAS * found.wheels.sd + 1e-5
        seen += ["wheels"] if away.any() else []
    return seen


def ended(seed: int, damages: int) -> tuple[str, str, str]:
    """How a log of a seed with so many damages ends, which they were, and what was told."""
    rng = np.random.default_rng(seed)
    robot = loaded(str(rng.choice(ROBOTS)))
    true, wheels = drawn(robot, rng)
    log = sound_log(robot, true, wheels, rng)
    chosen = [DAMAGES[i] for i in rng.choice(len(DAMAGES), damages, replace=False)]
    for damage in chosen:
        log = damage(log, robot, rng)
    kinds = f"{robot.name}: {', '.join(one.__name__ for one in chosen)}"
    try:
        found = identify(robot, log)
    except InputError as error:
        return "refused", kinds, str(error)
    if not found.better:
        return "refused", kinds, "no better than the URDF"
    wrong = outside(found, true, wheels)
    off, told = f"off: {', '.join(wrong)}" if wrong else "", found.warnings or tuple(map(str, found.findings))
    end = ("off" if wrong else "warned") if found.warnings else ("wrong" if wrong else "right")
    return end, kinds, "; ".join(part for part in (off, *told) if part)


def main(args: Sequence[str] | None = None) -> int:
    """The counts; the exit status is 1 where a log is wrong."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--logs", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--show", action="store_true", help="every log, with what was told")
    how = parser.parse_args(args)
    counts: Counter[str] = Counter()
    for k in range(how.logs):
        end, kinds, told = ended(how.seed + k, 1 + k % 2)
        counts[end] += 1
        if how.show or end == "wrong":
            print(f"{how.seed + k} {end}: {kinds}: {told}", flush=True)
    counts["warned"] += counts["off"]
    shown = ", ".join(f"{name} {counts[name]}" for name in ("refused", "warned", "right", "wrong"))
    print(f"{shown} of {how.logs} logs; {counts['off']} of those warned of are off")
    return int(counts["wrong"] > 0)


if __name__ == "__main__":
    raise SystemExit(main())
