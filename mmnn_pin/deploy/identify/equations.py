"""A motion as equations: `F Y(F q, ...) theta = F F tau`, one low-pass F without phase for both sides.

Positions and efforts are low-passed at the cutoff (Butterworth of order 4, forth and back), positions differentiated
by a quintic spline, the regressor is evaluated along them, and both sides are low-passed once more and thinned
(Gautier 1997, ICRA: parallel filtering). What is linear in the motion is filtered alike on both sides: no bias. Dry
friction is a step where a joint turns back: it is filtered as the effort is, twice, and ahead of all thinning.

Where a joint stands still its dry friction is any force below the largest one: its row does not count there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from ...errors import RecordingError, RobotError
from ...model.reduction import COULOMB_SPEED
from ...model.regressor import Regressor
from ...model.robot import Robot
from ...model.tree.body import parameters
from ...signals import Array
from .log import Log
from .quality import Bools, saturated
from .times import spans

ORDER = 4  # of the Butterworth low-pass
FINE, KEPT = 10.0, 2.5  # rows per second over the cutoff: of the regressor, of the equations
# Cutoff over the frequency below which 99 % of a velocity's power lie: of the median, of the fastest joint.
BAND, SPAN = 10.0, 4.0
LEAST, MOST = 4.0, 20.0  # cutoff [Hz]
SLOW = 0.03  # share of a joint's fast speed below which it counts as still
PLACES, SAME = 20, 1e-6  # postures at which gravity is looked at; its change that counts as none
MOVING = 0.9  # share of a filtered row's time in which its joints have to move
SHARED = 0.01  # share of a parameter in what is not told, from which it is named
TINY = 1e-12  # length of a column and effort of a row under which they are none
FORMULA = 0.03  # relative error of the formulas of friction, among others where the filter lets in a standstill


@dataclass(frozen=True, eq=False)
class Unknowns:
    """The fitted parameters: those of the regressor, a constant per effort, and Stribeck friction where asked for."""

    robot: Robot  # the robot as its URDF has it
    regressor: Regressor  # its regressor, k0 parameters
    rows: tuple[int, ...]  # the r rows of nu whose efforts are measured
    stribeck: float | None = None  # velocity of the Stribeck effect [rad/s or m/s]; None without

    @cached_property
    def labels(self) -> tuple[str, ...]:
        """Names of the k parameters."""
        more = tuple(f"{joint}.stribeck" for joint in self.regressor.joints) if self.stribeck else ()
        return (*self.regressor.labels, *(f"{name}.offset" for name in self.names), *more)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the r rows."""
        return tuple(self.robot.velocity_names[i] for i in self.rows)

    @property
    def size(self) -> int:
        """Number of parameters k."""
        return len(self.labels)

    @cached_property
    def prior(self) -> Array:
        """The parameters of the URDF, (k,)."""
        return np.concatenate((parameters(self.robot), np.zeros(self.size - self.regressor.size)))

    def columns(self, *kinds: str) -> NDArray[np.int64]:
        """Places of the parameters of some kinds, such as `rotor`, `viscous`, `coulomb`, `offset`, `stribeck`."""
        return np.array([i for i, name in enumerate(self.labels) if name.rpartition(".")[2] in kinds], dtype=np.int64)

    @cached_property
    def of_base(self) -> NDArray[np.int64]:
        """Viscous friction of the base's velocities, which is not fitted: that of the wheels says the same."""
        places = self.columns("viscous")
        return places[[self.labels[i].rpartition(".")[0] not in self.regressor.joints for i in places]]

    @cached_property
    def weighed(self) -> Bools:
        """Rows that feel the same weight wherever the robot stands, (r,), as a lift does.

        They have no constant of their own: it would say what the weight says, which a URDF can hold.
        """
        rng = np.random.default_rng(0)
        felt = np.array([self.robot.gravity(self.robot.random(rng)) for _ in range(PLACES)])[:, list(self.rows)]
        size = np.abs(felt).max(axis=0)
        return np.asarray((size > 0) & (np.ptp(felt, axis=0) < SAME * size))

    @cached_property
    def joint_rows(self) -> Array:
        """(joints, p) rows of T of the regressor's joints."""
        return np.array(self.regressor.massless.joints)

    @cached_property
    def dry_rows(self) -> Array:
        """(d, p) rows of T that dry friction goes by, d: of all joints, and of the turning of a base that scrubs."""
        p, nb = self.robot.dimensions.dof, self.robot.dimensions.base
        return np.vstack((self.joint_rows, np.eye(p)[nb - 1 : nb] if self.robot.base.scrubs else np.zeros((0, p))))

    def rubbing(self, nu: Array) -> Array:
        """Dry friction over its largest one, then what Stribeck adds to that of joints, (N, d) or (N, d + joints)."""
        speed = nu @ self.dry_rows.T
        sign = np.tanh(speed / COULOMB_SPEED)
        if not self.stribeck:
            return sign
        joints = slice(len(self.joint_rows))
        return np.hstack((sign, sign[:, joints] * np.exp(-((speed[:, joints] / self.stribeck) ** 2))))

    def matrix(self, q: Array, nu: Array, nudot: Array, rubbing: Array | None = None) -> Array:
        """Columns of all parameters along a motion, (N, r, k).

        Args:
            q: (N, n) the arm's joints.
            nu: (N, p) velocities.
            nudot: (N, p) their time derivative.
            rubbing: Dry friction, filtered; by default that of nu.
        """
        Y = np.zeros((len(q), len(self.rows), self.size))
        first, rows = self.regressor.size, list(self.rows)
        Y[:, :, :first] = self.regressor.along(q, nu, nudot)[:, rows]
        for i in range(len(rows)):
            Y[:, i, first + i] = not self.weighed[i]
        dry = self.rubbing(nu) if rubbing is None else rubbing
        lever = np.vstack((self.dry_rows, self.joint_rows)).T[rows][:, : dry.shape[1]]
        columns = self.columns("coulomb", "stribeck")
        Y[:, :, columns] = dry[:, None, :] * lever[None]
        Y[:, :, self.of_base] = 0.0
        return Y


@dataclass(frozen=True, eq=False)
class Equations:
    """Equations `Y theta = y` of a motion, M times r of them."""

    time: Array  # (M,) [s]
    Y: Array  # (M, r, k)
    y: Array  # (M, r) measured efforts as generalized forces [N, N m]
    use: Bools  # (M, r) whether a row counts: its joints move, its motors are not saturated
    speed: Array  # (M, r) velocities of the rows [m/s, rad/s]
    run: NDArray[np.int64]  # (M,) number of the stretch without gaps
    cutoff: float  # of the filter [Hz]

    def __len__(self) -> int:
        return len(self.time)

    def rows(self, keep: Bools) -> Equations:
        """Some of the equations."""
        names = ("time", "Y", "y", "use", "speed", "run")
        return replace(self, **{name: getattr(self, name)[keep] for name in names})

    def only(self, rows: Bools) -> Equations:
        """The equations, of which only some rows (r,) count."""
        return replace(self, use=self.use & rows)

    def told_apart(self, unknowns: Unknowns) -> tuple[Equations, list[str]]:
        """The equations without what they say of friction and constants below the error of friction's formulas.

        Second, labels of the parameters of which they tell only sums then.

        Of joints that never turn back, dry friction and a constant have one effect, but for what the filter lets in of
        the start: their sum is told, and no part of it. Columns over their lengths, rows over their efforts, have a
        singular value below `FORMULA` along such a direction, and lose it.
        """
        columns = unknowns.columns("viscous", "coulomb", "stribeck", "offset")
        weight = self.use / np.maximum(np.sqrt((self.y**2).mean(axis=0)), TINY)
        X = (self.Y[:, :, columns] * weight[:, :, None]).reshape(-1, len(columns))
        size = np.maximum(np.linalg.norm(X, axis=0), TINY)
        values, vectors = np.linalg.eigh((X / size).T @ (X / size))
        lost = vectors[:, values < FORMULA**2]
        Y = self.Y.copy()
        Y[:, :, columns] -= ((Y[:, :, columns] / size) @ lost) @ (lost.T * size)
        mixed = ((lost**2).sum(axis=1) > SHARED) & (size > TINY)
        return replace(self, Y=Y), [unknowns.labels[i] for i in columns[mixed]]

    @classmethod
    def stacked(cls, parts: Sequence[Equations]) -> Equations:
        """Several motions as one."""
        first, runs = parts[0], 0
        numbered = []
        for part in parts:
            numbered.append(part.run + runs)
            runs += int(part.run.max()) + 1
        join = {
            name: np.concatenate([getattr(part, name) for part in parts]) for name in ("time", "Y", "y", "use", "speed")
        }
        return cls(**join, run=np.concatenate(numbered), cutoff=first.cutoff)


def require_identifiable(robot: Robot) -> None:
    """Refuse a robot whose base steers (`RobotError`)."""
    if robot.steers:
        why = f"its base of kind '{robot.base.kind}' steers, and the equations here are those of a constant T"
        raise RobotError(f"'{robot.name}' cannot be identified", why=why, fix="its arm alone can: --base fixed")


def measured_rows(robot: Robot, logs: Sequence[Log]) -> tuple[int, ...]:
    """Rows of nu all of whose motors are measured in every log.

    Raises:
        RecordingError: None.
    """
    there = np.array([all(name in log.effort for log in logs) for name in robot.actuator_names])
    used = robot.E != 0
    rows = tuple(int(i) for i in range(len(used)) if used[i].any() and there[used[i]].all())
    if not rows:
        fix = f"record the efforts of {', '.join(robot.actuator_names)}"
        raise RecordingError("no joint's effort is measured in all logs", fix=fix, file=logs[0].name)
    return rows


# -- from a log to coordinates -----------------------------------------------------------------------------------------


def coordinates(log: Log, robot: Robot) -> tuple[Array, tuple[str, ...]]:
    """Integrals of nu along a log, (N, p): way and turning of the base, joints of the arm; and what is missing.

    The base's are those of its wheels where their positions are measured, else the integrals of its velocities; what is
    not measured stands still.
    """
    nb, n = robot.dimensions.base, len(log.time)
    x, missing = np.zeros((n, robot.dimensions.dof)), []
    wheels = [wheel.joint for wheel in robot.base.wheels]
    if wheels and all(name in log.position for name in wheels):
        rows = robot.T[[robot.full_velocity_names.index(name) for name in wheels], :nb]
        turned = np.column_stack([log.position[name] - log.position[name][0] for name in wheels])
        x[:, :nb] = turned @ np.linalg.pinv(rows).T
    elif nb:
        for i, name in enumerate(robot.velocity_names[:nb]):
            if f"base.{name}" in log.base:
                v = log.base[f"base.{name}"]
                x[1:, i] = np.cumsum(0.5 * (v[1:] + v[:-1]) * np.diff(log.time))
        if not any(f"base.{name}" in log.base for name in robot.velocity_names[:nb]):
            missing.append("the base")
    for i, name in enumerate(robot.joint_names):
        if name in log.position:
            x[:, nb + i] = log.position[name]
        else:
            x[:, nb + i] = robot.rest[robot.full_velocity_names.index(name)]
            missing.append(name)
    return x, tuple(missing)


def efforts(log: Log, robot: Robot, rows: Sequence[int]) -> tuple[Array, Bools]:
    """Generalized forces `E u` of the measured rows, (N, r), and where a motor of a row is saturated, (N, r)."""
    size = len(log.time), len(robot.actuator_names)
    u, full = np.zeros(size), np.zeros(size, bool)
    for j, name in enumerate(robot.actuator_names):
        if name in log.effort:
            u[:, j], full[:, j] = log.effort[name], saturated(log.effort[name])
    E = robot.E[list(rows)]
    return u @ E.T, (full.astype(float) @ (E != 0).T.astype(float)) > 0


# -- filtering ---------------------------------------------------------------------------------------------------------


def chosen_cutoff(logs: Sequence[Log], robot: Robot) -> float:
    """A cutoff far above the motion's own frequencies [Hz], below which 99 % of the power of a joint's velocity lie.

    Noise of the positions, white, is taken from the upper half of their spectra and does not count.
    """
    found, rates = [], []
    for log in map(longest, logs):
        period = float(np.median(np.diff(log.time)))
        x, rate = evenly(log.time, coordinates(log, robot)[0], np.arange(log.time[0], log.time[-1], period)), 1 / period
        rates.append(rate)
        for column in x.T:
            if np.ptp(column) < 1e-3:
                continue
            f, power = scipy.signal.welch(np.diff(column) * rate, rate, nperseg=min(len(column) - 1, round(20 * rate)))
            of_noise = np.median(power[len(f) // 2 :] / (4 * np.sin(np.pi * f[len(f) // 2 :] / rate) ** 2 + 1e-12))
            noise = of_noise * 4 * np.sin(np.pi * f / rate) ** 2
            loud = power > 10 * noise
            end = int(np.argmin(loud[1:])) + 1 if not loud[1:].all() else len(f)
            total = np.cumsum(power[:end])
            if end > 1 and total[-1] > 0:
                found.append(float(f[int(np.searchsorted(total, 0.99 * total[-1]))]))
    wanted = max(BAND * float(np.median(found)), SPAN * max(found), LEAST) if found else LEAST
    return float(min(wanted, MOST, 0.3 * min(rates)))


def longest(log: Log) -> Log:
    """The longest part of a log without gaps."""
    return log.rows(max(spans(log.time), key=lambda one: one.stop - one.start))


def low_pass(x: Array, cutoff: float, rate: float) -> Array:
    """Low-pass without phase along the first axis, with the ends mirrored."""
    pad = min(len(x) - 1, math.ceil(2 * rate / cutoff))
    return np.asarray(scipy.signal.sosfiltfilt(butterworth(cutoff, rate), x, axis=0, padlen=pad))


@cache
def butterworth(cutoff: float, rate: float) -> Array:
    """Sections of the low-pass of a cutoff, for rows per second [Hz]."""
    return np.asarray(scipy.signal.butter(ORDER, cutoff, fs=rate, output="sos"))


def still_speeds(logs: Sequence[Log], unknowns: Unknowns, cutoff: float) -> Array:
    """Speed of every joint of the regressor below which it counts as still, (joints,)."""
    fastest = np.zeros(len(unknowns.joint_rows))
    for log in map(longest, logs):
        x, _ = coordinates(log, unknowns.robot)
        rate = 1.0 / float(np.median(np.diff(log.time)))
        v = low_pass(np.gradient(x, log.time, axis=0), cutoff, rate) @ unknowns.joint_rows.T
        fastest = np.maximum(fastest, np.percentile(np.abs(v), 98, axis=0))
    return np.maximum(2 * COULOMB_SPEED, SLOW * fastest)


def equations(log: Log, unknowns: Unknowns, cutoff: float, still: Array) -> Equations:
    """The equations of a log.

    Args:
        log: A sound one.
        unknowns: What is fitted.
        cutoff: Of the low-pass [Hz].
        still: (joints,) from `still_speeds`.

    Raises:
        RecordingError: No stretch without gaps is long enough for the filter.
    """
    parts = [of_stretch(part, unknowns, cutoff, still) for part in stretches_of(log, cutoff)]
    if not parts:
        why = f"a low-pass at {cutoff:.3g} Hz needs {6 / cutoff:.3g} s without gaps"
        raise RecordingError("too short a motion", why=why, fix="record a minute, or raise --cutoff", file=log.name)
    return Equations.stacked(parts)


def stretches_of(log: Log, cutoff: float) -> list[Log]:
    """Parts of a log without gaps that are long enough for a low-pass [Hz]."""
    parts = [log.rows(where) for where in spans(log.time)]
    return [part for part in parts if len(part.time) > 30 and part.time[-1] - part.time[0] > 6 / cutoff]


def of_stretch(log: Log, unknowns: Unknowns, cutoff: float, still: Array) -> Equations:
    """The equations of a log without gaps."""
    robot, period = unknowns.robot, float(np.median(np.diff(log.time)))
    time = np.arange(log.time[0] + log.effort_delay, log.time[-1], period)
    rate = 1.0 / period
    x, _ = coordinates(log, robot)
    tau, full = efforts(log, robot, unknowns.rows)
    x = low_pass(evenly(log.time, x, time), cutoff, rate)
    tau = low_pass(evenly(log.time + log.effort_delay, tau, time), cutoff, rate)
    cut = evenly(log.time + log.effort_delay, full.astype(float), time)
    stride = max(1, int(rate / (FINE * cutoff)))
    fine, spline = time[::stride], scipy.interpolate.make_interp_spline(time, x, 5)
    nu, nudot = spline(fine, 1), spline(fine, 2)
    dry = low_pass(unknowns.rubbing(spline(time, 1)), cutoff, rate)[::stride]
    Y = unknowns.matrix(x[::stride, robot.dimensions.base :], nu, nudot, dry)
    rate /= stride
    apart = np.abs(nu @ unknowns.joint_rows.T) < still
    rests = (apart.astype(float) @ np.abs(unknowns.joint_rows[:, list(unknowns.rows)])) > 0
    idle = rests | (cut[::stride] > 0)
    keep = slice(None, None, max(1, int(rate / (KEPT * cutoff))))
    inside = (fine[keep] > fine[0] + 1 / cutoff) & (fine[keep] < fine[-1] - 1 / cutoff)
    filtered = [low_pass(part, cutoff, rate)[keep][inside] for part in (Y, tau[::stride], 1.0 - idle, nu)]
    return Equations(
        time=fine[keep][inside],
        Y=filtered[0],
        y=filtered[1],
        use=filtered[2] > MOVING,
        speed=filtered[3][:, list(unknowns.rows)],
        run=np.zeros(int(inside.sum()), dtype=np.int64),
        cutoff=cutoff,
    )


def evenly(time: Array, values: Array, even: Array) -> Array:
    """Columns (N, c) at even times; a cubic spline where these are others."""
    if len(time) == len(even) and np.abs(time - even).max() < 1e-6 * (time[1] - time[0]):
        return values
    if values.dtype == float and len(time) > 4:
        return np.asarray(scipy.interpolate.make_interp_spline(time, values, 3)(np.clip(even, time[0], time[-1])))
    return np.column_stack([np.interp(even, time, column) for column in values.T])
