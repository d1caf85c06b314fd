"""A motion that identifies best: Fourier series of the joints and the base within limits, of largest information.

Joint j moves as `q_j = q_j0 + s_j sum_l a_l sin(l w t) / (l w) + b_l (1 - cos(l w t)) / (l w)` (Swevers, Ganseman,
Tukel, De Schutter, Van Brussel 1997, IEEE T-RA 13(5)), at rest at start and end: `sum a_l = 0`, `sum l b_l = 0`.
Base velocities are the same series. Every candidate is scaled into the limits of position and speed, drawn together
where spheres along the links touch, a motor could not hold its joint up or the robot's shapes come near an obstacle,
and slowed until the URDF's torques are within theirs; what is still refused says why. Of the others, the one is
looked for with the most information `A = sum Y_b' Y_b / s^2` in the base parameters over their sizes, `log det A / b
- log tr A^-1`: both the volume of what stays unknown and its worst side; by steps that are kept when they help.
"""

from __future__ import annotations

import time as clock
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ...errors import ConfigError
from ...files import whole_file
from ...model.regressor import Regressor
from ...model.robot import Robot, speed_limits
from ...model.tree.body import parameters
from ...signals import Array
from ...torque.pseudo_inertia import BODY
from .clearance import Obstacle, clearances, to_obstacles
from .equations import Unknowns, require_identifiable
from .least_squares import BaseParameters, base_parameters, inverted
from .programme import mass_matrix

HARMONICS, FASTEST = (1, 2, 3, 5, 8, 13, 21, 34), 1.0  # of the duration; largest frequency [Hz]
SHRUNK = (1.0, 0.75, 0.55, 0.4, 0.3, 0.2)  # parts of a motion that are tried where links touch or weigh too much
SAMPLES = 150  # of a candidate
RATE = 100.0  # rows per second that are written and that a log is thought to have
COARSE = 2  # samples of a candidate of which obstacles are looked at in one
LOOKED = 40  # positions at which links are looked at
THINNED = 5  # rows of which one is looked at when a motion is judged
NEARER = (0.5, 0.25, 0.12, 0.06)  # of the range, in which a safe position is looked for
SLOWED = 0.8 ** np.arange(10)  # speeds that are tried where torques are too large
BEFORE = 1e-6  # information on a parameter over its size before any motion: what none shows leads the search nowhere
STUCK = 1e-3  # range of a joint under which it does not move [rad or m]
TRIED = 400  # candidates, of which none is a motion
SLOWER = 10  # times that a motion is made slower at most, once it is found
FAST = 1.5  # speed where the URDF states none [rad/s or m/s]
REACH = np.pi  # of a joint without limits, either way [rad]
BASE_SPEED, BASE_TURN = 0.4, 0.8  # of a base [m/s, rad/s]
NOISE = 0.02  # of a torque, of its limit; of its RMS where the URDF states none
FORCE, ROTOR = 0.01, 0.1  # size of friction, of a motor's limit; of a rotor, of the inertia that its joint feels
SHARE = 0.8  # of a limit that is used
TOUCHING = 1e-3  # distance to an obstacle that is none [m]
NEAR = 0.9  # of the distance at which links were found, for the spheres that are advised
SHORT = {
    "links": "for links that touch",
    "obstacles": "for obstacles",
    "hold": "for the arm's weight",
    "move": "for torque",
    "unseen": "for parameters that they do not tell apart",
}

MotionSamples = tuple[Array, Array, Array, Array]  # times (N,), integrals of nu, nu, nudot, (N, p) each


@dataclass(frozen=True)
class ExcitationLimits:
    """Limits of a motion that identifies.

    Raises:
        ConfigError: A number that cannot be.
    """

    duration: float = 40.0  # [s]
    space: float = 1.0  # half the side of the square that the base stays in [m]
    share: float = SHARE  # of the limits of position, speed and torque that is used
    clearance: float = 0.06  # radius of the spheres along the links, distance to obstacles [m]; 0: no look at links
    seconds: float = 20.0  # time to look for it [s]
    seed: int = 0  # of the search
    obstacles: tuple[Obstacle, ...] = ()

    def __post_init__(self) -> None:
        for name, least in (("duration", 5.0), ("space", 0.0), ("share", 0.0), ("clearance", 0.0), ("seconds", 0.0)):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= least) or (name == "share" and not 0 < value <= 1):
                fix = "give a share up to 1" if name == "share" else f"give a finite number from {least:g}"
                raise ConfigError(f"{value}", fix=fix, key=f"--{name}")


@dataclass(frozen=True)
class RefusedCandidate:
    """Why a candidate is no motion."""

    # `"links"` touch, `"obstacles"` are near, motors cannot `"hold"` up or `"move"` a joint, parameters stay `"unseen"`
    what: Literal["links", "obstacles", "hold", "move", "unseen"]
    size: float  # least distance of links, or largest torque, over what is allowed; 0 of parameters
    names: tuple[str, ...] = ()  # the velocity whose torque is the largest; the parameters


@dataclass(frozen=True, eq=False)
class ExcitingMotion:
    """A motion and what it would determine."""

    robot: Robot  # the robot
    time: Array  # (N,) [s], at `RATE`
    position: Array  # (N, n) joints [rad or m]
    nu: Array  # (N, p) velocities
    nudot: Array  # (N, p) accelerations
    pose: Array  # (N, 3) of the base, from the origin; (N, 0) for a fixed arm
    base: BaseParameters  # the base parameters
    sd: Array  # (b,) their predicted standard deviations
    scale: Array  # (b,) size that the URDF's robot has there
    condition: float  # of the weighted regressor
    tried: int  # candidates that were looked at
    nearest: float = np.inf  # least distance to an obstacle [m]; inf without any

    @property
    def relative(self) -> Array:
        """Predicted standard deviations over the URDF's own size, (b,)."""
        return np.asarray(self.sd / self.scale)

    @property
    def floor(self) -> tuple[Array, Array]:
        """Smallest and largest x and y of the base's control frame, (2,) each [m]; (0,) for a fixed arm."""
        return self.pose[:, :2].min(axis=0), self.pose[:, :2].max(axis=0)

    def columns(self) -> dict[str, Array]:
        """Columns of its table: a reference of the base `t, x, y, phi, v, w`, and all signals by their full names."""
        nb, found = self.robot.dimensions.base, {"t": self.time}
        if nb:
            found |= {name: self.pose[:, i] for i, name in enumerate(("x", "y", "phi"))}
            found |= {name: self.nu[:, i] for i, name in enumerate(self.robot.velocity_names[:nb])}
        for i, joint in enumerate(self.robot.joint_names):
            found[f"position.{joint}"] = self.position[:, i]
            found[f"velocity.{joint}"] = self.nu[:, nb + i]
            found[f"acceleration.{joint}"] = self.nudot[:, nb + i]
        return found

    def save(self, path: str | Path, force: bool = True) -> Path:
        """Write the table as CSV, whole or not at all.

        Args:
            path: The file.
            force: Whether it may replace another one.

        Raises:
            RecordingError: A place that cannot be written, or a file that is there.
        """
        columns = self.columns()
        rows = np.column_stack(list(columns.values()))
        with whole_file(Path(path), "motion", force) as part:
            np.savetxt(part, rows, "%.10g", ",", header=",".join(columns), comments="")
        return Path(path)

    def to_dict(self) -> dict[str, Any]:
        """Standard deviations of the base parameters, worst first, for JSON."""
        labels = Unknowns(self.robot, Regressor.of(self.robot), tuple(range(self.nu.shape[1]))).labels
        order = np.argsort(-self.relative)
        return {
            "robot": self.robot.name,
            "duration": float(self.time[-1]),
            "condition": self.condition,
            "tried": self.tried,
            "worst_relative_sd": float(self.relative.max()),
            "floor": [[float(low), float(high)] for low, high in zip(*self.floor, strict=True)],
            "nearest_obstacle": self.nearest if np.isfinite(self.nearest) else None,
            "base_parameters": [
                {"combination": self.base.name(i, labels), "sd": float(self.sd[i]), "size": float(self.scale[i])}
                for i in order
            ],
        }


# -- the search --------------------------------------------------------------------------------------------------------


def excite(robot: Robot, limits: ExcitationLimits | None = None) -> ExcitingMotion:
    """The most informative motion found.

    Args:
        robot: As its URDF has it.
        limits: What the motion may do.

    Raises:
        RobotError: Its base steers.
        ConfigError: No motion is within the limits; with what most candidates were refused for.
    """
    require_identifiable(robot)
    limits = limits or ExcitationLimits()
    search = ExcitationSearch.of(robot, limits)
    rng, end = np.random.default_rng(limits.seed), clock.monotonic() + limits.seconds
    best, value, step, tried = search.start(rng), -np.inf, 0.5, 0
    refused: list[RefusedCandidate] = []
    while value == -np.inf or tried < 40 or clock.monotonic() < end:
        fresh = value == -np.inf
        if fresh:
            candidate = search.start(rng)
        else:
            candidate = best + step * rng.standard_normal(best.shape) * (rng.random(best.shape) < 0.2)
        found = search.information(candidate)
        if limits.obstacles and not isinstance(found, RefusedCandidate) and found > value:
            fine = search.motion(candidate, 2 + round(limits.duration * RATE))  # between samples it may be too near
            found = fine if isinstance(fine, RefusedCandidate) else found
        tried += 1
        if isinstance(found, RefusedCandidate):
            refused.append(found)
        elif found > value:
            best, value, step = candidate, found, min(1.0, 1.3 * step)
        if not fresh and best is not candidate:
            step = max(0.02, 0.97 * step)
        if fresh and len(refused) >= TRIED:
            raise search.none_found(refused)
    return search.described(best, tried)


@dataclass(frozen=True, eq=False)
class ExcitationSearch:
    """The search for a motion: the unknowns, the limits, and the noise that candidates are judged by."""

    unknowns: Unknowns  # all parameters, every row of nu measured
    base: BaseParameters  # their base parameters
    limits: ExcitationLimits  # what a motion may do
    speed: Array  # (p,) largest velocities
    low: Array  # (n,) and high: (n,) ends of the joints that may be used
    high: Array
    torque: Array  # (p,) largest generalized forces, inf for none
    noise: Array  # (p,) of the torques
    # distance of every pair of links over that allowed, of a position (n,); inf without pairs
    apart: Callable[[Array], float]
    # least distance to obstacles over that allowed, of positions (N, n) and poses (N, 3); inf without any
    near: Callable[[Array, Array], float]
    safe: Array  # (n,) a position with room around it where motors hold the arm up; motions shrink towards it

    @classmethod
    def of(cls, robot: Robot, limits: ExcitationLimits) -> ExcitationSearch:
        """The search for one robot."""
        p, n, nb = robot.dimensions.dof, robot.dimensions.arm, robot.dimensions.base
        unknowns = Unknowns(robot, Regressor.of(robot), tuple(range(p)))
        speed = np.full(p, FAST)
        of_motor = dict(zip(robot.actuator_names, speed_limits(robot), strict=True))
        for i, name in enumerate(robot.joint_names):
            stated = of_motor.get(name, np.inf)
            speed[nb + i] = stated if np.isfinite(stated) else FAST
        speed[:nb] = [BASE_TURN if name == "w" else BASE_SPEED for name in robot.velocity_names[:nb]]
        rest = robot.rest[robot.arm_index]
        low = np.maximum(robot.lower[robot.arm_index], rest - REACH)
        high = np.minimum(robot.upper[robot.arm_index], rest + REACH)
        half = limits.share * (high - low) / 2
        of_rows = np.where(robot.E != 0, robot.effort_limits, 0.0)  # a motor without a limit bounds no row but its own
        limit = np.sum(np.abs(robot.E) * of_rows, axis=1)
        noise = np.where(np.isfinite(limit), NOISE * limit, 1.0)
        middle = (high + low) / 2
        moves = np.ones(p, bool)
        base = base_parameters(unknowns, moves, moves)
        apart = clearances(robot, limits.clearance) if n and limits.clearance > 0 else lambda q: np.inf
        places = [middle, np.clip(rest, middle - half, middle + half)]
        low, high = middle - half, middle + half
        near, speed, torque = from_obstacles(robot, limits), limits.share * speed, limits.share * limit
        made = cls(unknowns, base, limits, speed, low, high, torque, noise, apart, near, middle)
        made = replace(made, safe=made.roomiest(places, np.random.default_rng(limits.seed)))
        if near(made.safe[None], made.start_pose) <= 1:
            every = "; ".join(map(str, limits.obstacles))
            why = f"it stands nearer than {limits.clearance:g} m to one of {every}, however its arm is held"
            raise ConfigError("no motion found", why=why, fix="move the obstacle away", key="--obstacle")
        return made

    @property
    def start_pose(self) -> Array:
        """The base at the start, (1, 3); (1, 0) of a fixed arm."""
        return np.zeros((1, self.unknowns.robot.dimensions.pose))

    def roomiest(self, places: Sequence[Array], rng: np.random.Generator) -> Array:
        """A position (n,) with room between its links where motors hold the arm up, of some and of random ones.

        It is looked for everywhere first, then ever nearer to the best.
        """

        def room(found: Sequence[Array] | Array) -> tuple[float, Array]:
            held = self.weight(np.array(found)).max(axis=1)
            every = [
                min(self.apart(q), 1 / one, self.near(q[None], self.start_pose))
                for q, one in zip(found, held, strict=True)
            ]
            return max(every), found[int(np.argmax(every))]

        half = (self.high - self.low) / 2
        most, best = room([*places, *rng.uniform(self.low, self.high, (300, len(half)))])
        for near in NEARER if most < np.inf else ():
            at = np.clip(best + near * half * rng.uniform(-1, 1, (60, len(half))), self.low, self.high)
            most, best = max((most, best), room(at), key=lambda one: one[0])
        return best

    def weight(self, q: Array) -> Array:
        """Torque that holds the arm up over what is allowed, at positions (N, n), (N, p); above 0."""
        still = np.zeros((len(q), len(self.torque)))
        forces = np.abs(self.unknowns.regressor.along(q, still, still) @ parameters(self.unknowns.robot))
        return np.asarray(np.maximum(forces / self.torque, 1e-12))

    def start(self, rng: np.random.Generator) -> Array:
        """A random candidate, (p, 2 harmonics + 1): coefficients, and where a joint's range is used."""
        return rng.standard_normal((len(self.speed), 2 * len(self.harmonics) + 1))

    def motion(self, candidate: Array, samples: int) -> MotionSamples | RefusedCandidate:
        """Times, integrals of nu, nu and nudot of a candidate within limits of position and speed, its links apart."""
        T = self.limits.duration
        t = np.linspace(0.0, T, samples)
        w, order, count = 2 * np.pi / T, self.harmonics, len(self.harmonics)
        a, b = candidate[:, :count].copy(), candidate[:, count:-1].copy()
        a -= a.mean(axis=1, keepdims=True)
        b -= (b @ order)[:, None] * order / float(order @ order)
        wave = order * w
        s, c = np.sin(np.outer(t, wave)), np.cos(np.outer(t, wave))
        x = (s / wave) @ a.T + ((1 - c) / wave) @ b.T
        v, dv = c @ a.T + s @ b.T, -(s * wave) @ a.T + (c * wave) @ b.T
        nb = self.unknowns.robot.dimensions.base
        size = np.abs(v).max(axis=0) / self.speed
        size[nb:] = np.maximum(size[nb:], np.ptp(x[:, nb:], axis=0) / np.maximum(self.high - self.low, 1e-12))
        x, v, dv = (part / np.maximum(size, 1e-12) for part in (x, v, dv))
        where = 1 / (1 + np.exp(-candidate[nb:, -1]))
        room = (self.high - self.low) - np.ptp(x[:, nb:], axis=0)
        x[:, nb:] += self.low + where * room - x[:, nb:].min(axis=0)
        if nb:
            pose = driven(t, v[:, :nb], self.unknowns.robot)
            scale = min(1.0, self.limits.space / max(float(np.abs(pose[:, :2] - pose[:1, :2]).max()), 1e-12))
            forward = [i for i, name in enumerate(self.unknowns.robot.velocity_names[:nb]) if name != "w"]
            for part in (x, v, dv):
                part[:, forward] *= scale
        arm, ground, last = 0, 0, len(SHRUNK) - 1
        while True:
            made = self.drawn_together((t, x, v, dv), SHRUNK[arm], SHRUNK[ground])
            found = self.refused(made)
            if found is None:
                return made
            if found.what == "obstacles" and nb and ground < last:
                ground += 1
            elif arm < last:
                arm += 1
            else:
                return found

    def drawn_together(self, motion: MotionSamples, arm: float, ground: float) -> MotionSamples:
        """Parts of a motion: of the joints about the safe position, and of the base's velocities."""
        t, x, v, dv = motion
        nb = self.unknowns.robot.dimensions.base
        shares = np.where(np.arange(x.shape[1]) < nb, ground, arm)
        safe = np.concatenate((np.zeros(nb), self.safe))
        return t, safe + shares * (x - safe), shares * v, shares * dv

    def refused(self, motion: MotionSamples) -> RefusedCandidate | None:
        """Why a motion within limits of position and speed may not be: links, weight, obstacles; None where it may."""
        t, x, v, _ = motion
        nb = self.unknowns.robot.dimensions.base
        places = x[:: max(1, len(t) // LOOKED), nb:]
        if ((load := self.weight(places)) >= 1).any():
            return self.overloaded("hold", load)
        if any(self.apart(q) <= 1 for q in places):
            return RefusedCandidate("links", min(map(self.apart, places)))
        step = COARSE if len(t) <= SAMPLES else THINNED
        if (nearest := self.near(x[::step, nb:], self.driven(t, v)[::step])) <= 1:
            return RefusedCandidate("obstacles", nearest)
        return None

    def driven(self, t: Array, v: Array) -> Array:
        """Poses (N, 3) of the base from the origin along nu (N, p); (N, 0) of a fixed arm."""
        robot = self.unknowns.robot
        return driven(t, v[:, : robot.dimensions.base], robot) if robot.dimensions.base else np.zeros((len(t), 0))

    def overloaded(self, what: Literal["hold", "move"], load: Array) -> RefusedCandidate:
        """A refusal of torques over what is allowed, (N, p), with the velocity that asks for the most."""
        name = self.unknowns.robot.velocity_names[int(load.max(axis=0).argmax())]
        return RefusedCandidate(what, float(load.max()), (name,))

    def none_found(self, refused: Sequence[RefusedCandidate]) -> ConfigError:
        """The error that says what most candidates were refused for, at least one, and what to change."""
        robot, still = self.unknowns.robot, self.high - self.low < STUCK
        stuck = [name for name, one in zip(robot.joint_names, still, strict=True) if one]
        counts = Counter(one.what for one in refused)
        worst, count = counts.most_common(1)[0]
        those = [one for one in refused if one.what == worst]
        names = [name for name, _ in Counter(name for one in those for name in one.names).most_common(4)]
        least, most = min(one.size for one in those), max(one.size for one in those)
        torque = f"at least {least:.3g} times {self.limits.share:g} of the limit, most often at {', '.join(names[:2])}"
        if worst == "links":
            radius = NEAR * most * self.limits.clearance
            why, key = f"links that are no neighbours come closer than {2 * self.limits.clearance:g} m", "--clearance"
            fix = f"give a smaller one: {radius:.2g} leaves room" if most > 0.1 else "give 0: no look at links"
        elif worst == "obstacles":
            why, key = f"the robot comes nearer than {self.limits.clearance:g} m to an obstacle", "--obstacle"
            fix = "move it away" + (", or give a smaller --space" if robot.dimensions.base else "")
        elif worst == "hold":
            why, key = f"the arm's weight alone asks motors for {torque}", "--share"
            fix = f"give a larger --share, or mend the URDF's masses or effort limits of {names[0]}"
        elif worst == "move":
            why, key = f"even {SLOWED[-1] ** -1:.2g} times as slow they ask motors for {torque}", "--share"
            fix = "give a larger --share or a longer --duration, or mend the URDF's friction or effort limits"
        elif stuck:
            why, key = f"{', '.join(stuck)} cannot move", "--lock"
            fix = " ".join(f"--lock {name}" for name in stuck)
        elif robot.dimensions.base and self.limits.space == 0:
            why, key, fix = "the base has no room", "--space", "give more than 0, or --base fixed"
        else:
            why, key = f"they do not tell {', '.join(names)} from others", "--duration"
            fix = "give a longer --duration or a larger --share"
        more = "".join(f", {number} {SHORT[kind]}" for kind, number in counts.most_common()[1:])
        why = f"{count} of {len(refused)} candidates are refused: {why}{more}"
        return ConfigError("no motion found", why=why, fix=fix, key=key)

    def regressor(self, motion: MotionSamples) -> tuple[Array, float] | RefusedCandidate:
        """Y_b (N, p, b) along a motion slowed into the torque limits, and the factor of its speed."""
        _, x, v, dv = motion
        nb = self.unknowns.robot.dimensions.base
        for slow in SLOWED:
            Y = self.unknowns.matrix(x[:, nb:], slow * v, slow * slow * dv)
            load = np.abs(Y @ self.unknowns.prior) / self.torque
            if load.max() <= 1:
                return Y[:, :, self.base.independent], float(slow)
        return self.overloaded("move", load)

    def information(self, candidate: Array) -> float | RefusedCandidate:
        """The information of a candidate, see the module; or why it may not be, or does not tell everything."""
        motion = self.motion(candidate, SAMPLES)
        found = motion if isinstance(motion, RefusedCandidate) else self.regressor(motion)
        if isinstance(found, RefusedCandidate):
            return found
        Y, _ = found
        X = (Y * self.scale / self.noise[:, None]).reshape(-1, Y.shape[2])
        A = X.T @ X
        _, seen, _ = inverted(A)
        if not seen.all():
            names = (self.unknowns.labels[i] for i in self.base.independent[~seen])
            return RefusedCandidate("unseen", 0.0, tuple(names))
        values = np.linalg.eigvalsh(A) + BEFORE
        return float(np.log(values).mean() - np.log((1 / values).sum()))

    @cached_property
    def harmonics(self) -> Array:
        """Of the duration, the slow ones that show gravity and the fast ones that show inertia."""
        return np.array([one for one in HARMONICS if one <= max(5.0, FASTEST * self.limits.duration)])

    @cached_property
    def scale(self) -> Array:
        """Size of every base parameter, (b,): of its parts, each counted as positive.

        Bodies are those of the URDF; friction and constants a share of what each joint's own motors can do, as the URDF
        is silent on them.
        """
        unknowns, first = self.unknowns, self.unknowns.regressor.inertial
        size, lever = np.abs(unknowns.prior), 0.1
        powers = lever ** np.array([0, 1, 1, 1, 2, 2, 2, 2, 2, 2])
        size[:first] = np.maximum(size[:first], (size[:first:BODY, None] * powers).ravel())
        force, part = FORCE * self.noise / NOISE, np.abs(unknowns.joint_rows)
        part = part / np.maximum((part**2).sum(axis=1, keepdims=True), 1e-12)
        inertia = ROTOR * np.abs(np.diag(mass_matrix(unknowns)))
        for kind, of in (("coulomb", force), ("viscous", force / self.speed), ("rotor", inertia)):
            places = [unknowns.labels.index(f"{joint}.{kind}") for joint in unknowns.regressor.joints]
            size[places] = np.maximum(size[places], part @ of)
        size[unknowns.columns("offset")] = force
        return np.asarray(np.abs(self.base.combination) @ size)

    def described(self, candidate: Array, tried: int) -> ExcitingMotion:
        """The motion of a candidate at full rate, and what it would determine."""
        coarse = self.motion(candidate, SAMPLES)
        assert not isinstance(coarse, RefusedCandidate)
        found, nb = self.regressor(coarse), self.unknowns.robot.dimensions.base
        assert not isinstance(found, RefusedCandidate)
        slow = found[1]
        for _ in range(SLOWER):  # between samples torques may be larger
            fine = self.motion(candidate, 2 + round(self.limits.duration * RATE / max(slow, 1e-3)))
            if isinstance(fine, RefusedCandidate):  # between samples links may come closer
                raise self.none_found([fine])
            t, x, v, dv = fine[0] / slow, fine[1], slow * fine[2], slow * slow * fine[3]
            forces = self.unknowns.matrix(x[::THINNED, nb:], v[::THINNED], dv[::THINNED]) @ self.unknowns.prior
            if (np.abs(forces) <= self.torque).all():
                break
            slow *= 0.97
        nearest = self.near(x[:, nb:], self.driven(t, v)) * max(self.limits.clearance, TOUCHING)
        return replace(self.judged(t, x, v, dv, tried), nearest=nearest)

    def judged(self, t: Array, x: Array, v: Array, dv: Array, tried: int = 0) -> ExcitingMotion:
        """A motion (N, p) with the standard deviations that it would give under the assumed noise."""
        nb, robot = self.unknowns.robot.dimensions.base, self.unknowns.robot
        Y = self.unknowns.matrix(x[::THINNED, nb:], v[::THINNED], dv[::THINNED])[:, :, self.base.independent]
        X = np.sqrt(THINNED) * (Y / self.noise[:, None]).reshape(-1, Y.shape[2])
        inverse, seen, condition = inverted(X.T @ X)
        sd = np.where(seen, np.sqrt(np.maximum(np.diag(inverse), 0.0)), np.inf)
        return ExcitingMotion(
            robot, t, x[:, nb:], v, dv, self.driven(t, v), self.base, sd, self.scale, condition, tried
        )


def from_obstacles(robot: Robot, limits: ExcitationLimits) -> Callable[[Array, Array], float]:
    """Least distance of positions (N, n) and poses (N, 3) to obstacles over that allowed, or the first below 1."""
    if not limits.obstacles:
        return lambda places, poses: np.inf
    allowed = max(limits.clearance, TOUCHING)
    distances = to_obstacles(robot, limits.obstacles, limits.clearance)

    def near(places: Array, poses: Array) -> float:
        least = np.inf
        for i in sorted(range(len(places)), key=lambda i: i % 8):  # all over the motion: what is too near is soon seen
            least = min(least, float(distances(places[i], poses[i]).min()) / allowed)
            if least <= 1:
                break
        return least

    return near


def driven(t: Array, v: Array, robot: Robot) -> Array:
    """Poses (N, 3) of a base from the origin along its velocities (N, nb)."""
    step = np.diff(t)[:, None]
    names = robot.velocity_names[: robot.dimensions.base]
    parts = {name: v[:, i] for i, name in enumerate(names)}
    vx, vy, w = parts.get("v", parts.get("vx")), parts.get("vy", np.zeros(len(t))), parts["w"]
    assert vx is not None

    def integral(rate: Array) -> Array:
        return np.concatenate(([0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * step[:, 0])))

    phi = integral(w)
    c, s = np.cos(phi), np.sin(phi)
    return np.column_stack((integral(c * vx - s * vy), integral(s * vx + c * vy), phi))
