"""`identify`: recorded motion in, parameters out, judged on motion that the fit never saw.

1. Logs are made sound (`quality`), then equations (`equations`); the last third of each log is held out.
2. A joint whose effort the rigid body explains no better than friction alone, on blocks left out, does not follow it: a
   sensor in another unit, a spring, a dead zone. Its rows are dropped, and it is named.
3. The rest is fitted twice: base parameters by weighted least squares, with standard deviations, and all parameters by
   the consistent programme, from the URDF.
4. Held-out errors of the fit, the URDF, friction alone and least squares are compared, joint by joint.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import ConfigError, RecordingError, UnknownName
from ...model.regressor import Regressor
from ...model.robot import Robot
from ...settings.arguments import checked
from ...shown import AsText, shown
from ...signals import Array
from ...torque.prior import DOUBT
from .constants import constants_of
from .doctor import ExaminedLog, all_findings, examined, require_no_contradiction
from .equations import (
    Bools,
    Equations,
    Unknowns,
    chosen_cutoff,
    coordinates,
    equations,
    measured_rows,
    require_identifiable,
    still_speeds,
)
from .least_squares import WeightedFit, base_parameters, weighted_fit
from .log import Log, LogFinding
from .mends import mended, mends_of, require_signals, told_delays
from .odometry import Wheels, has_reference, wheel_findings
from .programme import BLOCKS, Blocks, Consistent, Prior, compressed, consistent_fit
from .quality import sound
from .reading import MotionSource, logs_of
from .rotors import RotorChoice, rotors_of

HELD_OUT = 1 / 3  # of each log
FIXED = 1e8  # strength of the prior of what may not leave it
FEWEST = 40  # equations of a joint
WORSE = 1.03  # error over that of friction alone from which a joint does not follow the rigid body
POOR = 0.6  # error from which nothing is explained
HALF, FAIR = 0.5, 0.15  # errors that are never believed, and that always are
FAR = 2.0  # between them: error over that of least squares from which no body explains an effort
ABOVE = 1.001  # times a motor's limit: more is not rounding
BADLY = 0.05  # error below which no joint fits badly
APART = 4.0  # error over the median of the other joints that is told
MODELS = ("identified", "urdf", "friction", "least_squares", "urdf_file")


@dataclass(frozen=True, eq=False, repr=False)
class Identification(AsText):
    """The result of an identification; `print` shows it joint by joint.

    Attributes:
        robot: The robot as its URDF has it.
        logs: The logs, sound, with their notes.
        unknowns: What was fitted.
        training: Equations of the fit.
        held_out: Equations that it never saw.
        fit: Base parameters with standard deviations.
        consistent: All parameters, physically possible.
        prior: Of the programme.
        follows: (r,) whether a row was fitted.
        why: For the other rows, by name, why not.
        friction: (r, k) friction alone and a constant, fitted to every row.
        notes: What there is to say beside the logs' own notes.
        beyond: Efforts above their motors' limits, a line for each.
        examined: What the doctor saw of the logs, with delays.
        rotors: Why a joint has a rotor or none, by name.
        wheels: Radii and track, where a log has a reference pose; None without.
    """

    robot: Robot
    logs: tuple[Log, ...]
    unknowns: Unknowns
    training: Equations
    held_out: Equations
    fit: WeightedFit
    consistent: Consistent
    prior: Prior
    follows: Bools
    why: dict[str, str]
    friction: Array
    notes: tuple[str, ...]
    wheels: Wheels | None = None
    beyond: tuple[str, ...] = ()
    examined: tuple[ExaminedLog, ...] = ()
    rotors: dict[str, str] = field(default_factory=dict)

    def __repr__(self) -> str:
        ours, file = 100 * self.error("identified"), 100 * self.error("urdf")
        return f"<Identification: {self.robot.name}, held-out torque error {ours:.3g} %, with its URDF {file:.3g} %>"

    def __str__(self) -> str:
        return str(shown(self, "text"))

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings of the doctor, of efforts above their limits and of joints that fit badly."""
        errors = {model: self.errors(model) for model in ("identified", "least_squares", "urdf")}
        seen = (str(one) for one in self.findings if one.grade == "warned")
        return (*seen, *self.beyond, *misfits(self.names, errors, self.follows))

    @property
    def timing(self) -> dict[str, dict[str, float]]:
        """Delays and lags of joints, see `ExaminedLog.timing`, of the log that says the most of each."""
        found: dict[str, dict[str, float]] = {}
        for one in self.examined:
            for name, numbers in one.timing.items():
                known = found.get(name, {})
                sds = [key for key in numbers if key.endswith("_sd") and numbers[key] < known.get(key, np.inf)]
                better = {key for sd in sds for key in (sd, sd.removesuffix("_sd"))}
                found[name] = known | {key: value for key, value in numbers.items() if key in better}
        return found

    @property
    def findings(self) -> list[LogFinding]:
        """The doctor's findings, worst first."""
        return all_findings(self.logs)

    def to_dict(self) -> dict[str, Any]:
        """All numbers, for JSON: joints, base parameters, bodies, friction."""
        found: dict[str, Any] = shown(self, "report")
        return found

    def save(self, out: str | Path, *, force: bool = False) -> dict[str, Path]:
        """Write the corrected URDF and what belongs to it; all files or none.

        Args:
            out: A folder, or the name of the URDF.
            force: Replace existing files.

        Raises:
            RecordingError: A file exists or cannot be written.
        """
        files: dict[str, Path] = shown(self, "files", out, force)
        return files

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the r rows."""
        return self.unknowns.names

    @property
    def theta(self) -> Array:
        """All parameters, (k,)."""
        return self.consistent.theta

    @cached_property
    def in_urdf(self) -> Array:
        """The parameters that a URDF can hold, (k,): without rotors, constants and Stribeck friction."""
        theta = self.theta.copy()
        theta[self.unknowns.columns("rotor", "offset", "stribeck")] = 0.0
        return theta

    def predicted(self, model: str, of: Equations) -> Array:
        """Efforts that a model of `MODELS` predicts, (M, r)."""
        alone = np.einsum("mrk,rk->mr", of.Y, self.friction)
        if model == "friction":
            return alone
        if model == "least_squares":
            made = of.Y @ self.fit.theta(self.unknowns.size)
            return np.where(self.follows, made, alone)
        theta = {"identified": self.theta, "urdf": self.unknowns.prior, "urdf_file": self.in_urdf}[model]
        made = of.Y @ theta
        return np.where(self.follows, made, alone) if model == "identified" else made

    def errors(self, model: str) -> Array:
        """Held-out error of every row, (r,): RMS of measured minus predicted over RMS of measured; nan if it stands."""
        return relative(self.held_out, self.predicted(model, self.held_out))

    def error(self, model: str, rows: Bools | None = None) -> float:
        """Held-out error of some rows together, by default of all that follow."""
        kept = self.held_out.only(self.follows if rows is None else rows)
        return float(relative(kept, self.predicted(model, self.held_out), None))

    @property
    def moving(self) -> Bools:
        """Rows that move in the motion held out, (r,)."""
        return np.asarray(self.held_out.use.sum(axis=0) >= FEWEST // 4)

    @property
    def plausible(self) -> bool:
        """Whether a robot that can be explains the efforts, about as well as any numbers do: else units are wrong."""
        ours, any_numbers = self.error("identified"), self.error("least_squares")
        return ours < HALF and ours < max(FAIR, FAR * any_numbers)

    @property
    def better(self) -> bool:
        """Whether the fit predicts better than the URDF and than friction alone, in a URDF too, and is plausible."""
        ours, before = self.error("identified"), self.error("urdf")
        return bool(ours < before and ours < self.error("friction") and self.plausible and self.helps_in_urdf)

    @property
    def helps_in_urdf(self) -> bool:
        """Whether what a URDF can hold of it, without rotors, constants and Stribeck friction, predicts better, too."""
        return self.error("urdf_file") < self.error("urdf")


def relative(of: Equations, predicted: Array, axis: int | None = 0) -> Array:
    """RMS of measured minus predicted over RMS of measured; nan where nothing counts.

    Args:
        of: The measured efforts.
        predicted: (M, r).
        axis: 0 for every row by itself, (r,); None for all rows together.
    """
    error, size = (np.where(of.use, part, 0.0) for part in (of.y - predicted, of.y))
    square = (size**2).sum(axis=axis)
    return np.where(square > 0, np.sqrt((error**2).sum(axis=axis) / np.where(square > 0, square, 1.0)), np.nan)


@checked
def identify(  # noqa: PLR0913 - options, by keyword alone
    robot: Robot,
    logs: MotionSource | Sequence[MotionSource],
    *,
    held_out: MotionSource | Sequence[MotionSource] = (),
    cutoff: float | None = None,
    stribeck: float | None = None,
    torque_constants: Mapping[str, float | None] | None = None,
    mend: Mapping[str, str] | Sequence[tuple[str, str]] = (),
    weight: float | None = None,
    rotors: RotorChoice = "auto",
    progress: Callable[[str, float], None] | None = None,
) -> Identification:
    """Inertias and friction of a robot from recorded motion.

    Args:
        robot: As its URDF has it: where the fit starts, and what stays where the motion does not determine it.
        logs: Recorded motions: logs, recordings, or files (CSV, bags, recordings).
        held_out: Motions to judge on; without any the last third of every log is held out.
        cutoff: Of the low-pass on positions and efforts [Hz]; by default ten times the motion's own frequencies.
        stribeck: Velocity of Stribeck friction [rad/s or m/s]; by default there is none.
        torque_constants: Torque per unit of a recorded effort, by motor; 1 for those not named. None finds it from
            motors with known constants that feel the same bodies.
        mend: What mends the logs, signal to how, as the doctor advises it (`mmnn_pin.deploy.identify.mends`).
        weight: Of the URDF in the consistent fit; by default chosen on blocks left out, at least that of the bands.
        rotors: Inertias of motors beyond the URDF's: `"no"`, `"yes"` for all joints, or `"auto"`, where the data ask.
        progress: Called now and then with what is being done and the fraction of it.

    Raises:
        RobotError: Its base steers.
        RecordingError: A log that cannot be used, or contradicts the physics.
        UnknownName: A torque constant of no motor.
        ConfigError: A number that cannot be.
        SolverError: The programme has no solution.

    `notes` has a constant that is found, with its standard deviation, which those of the fit do not contain.

    >>> robot = load("two_axis_arm")
    >>> path = Trajectory.of(robot, arm={"arm_1_joint": Sine(0.8, 1.7), "arm_2_joint": Sine(0.9, 1.1)})
    >>> run = Loop(robot.with_masses({"arm_2_joint": 1.3}), path, PD(), timing=Timing(duration=4.0)).run()
    >>> found = identify(robot, run)
    >>> found.better
    True
    """
    require_identifiable(robot)
    given, judged = logs_of(logs, robot), logs_of(held_out, robot)
    require_settings(cutoff, stribeck, weight)
    tell, constants, count = progress or (lambda what, fraction: None), torque_constants or {}, len(given)
    seen, wheels = examine(robot, [*given, *judged], torque_constants=constants, mend=mend, progress=tell)
    every = [one.log for one in seen]
    require_no_contradiction(every)
    given, judged = every[:count], every[count:]
    unknowns = Unknowns(robot, Regressor.of(robot), measured_rows(robot, every), stribeck)
    cutoff = chosen_cutoff(every, robot) if cutoff is None else cutoff
    still = still_speeds(every, unknowns, cutoff)
    tell("making equations", 0.0)
    training, test = divided([equations(log, unknowns, cutoff, still) for log in given])
    if judged:
        training = Equations.stacked([training, test])
        test = Equations.stacked([equations(log, unknowns, cutoff, still) for log in judged])
    wanted = [name for name, value in constants.items() if value is None]
    notes: tuple[str, ...] = ()
    if wanted:
        training, test, notes = with_constants(training, test, unknowns, wanted)
    found = fitted(robot, every, unknowns, training, test, weight, rotors, tell)
    beyond = tuple(beyond_limits(every, robot, wanted))
    found = replace(found, notes=(*notes, *found.notes), beyond=beyond, examined=tuple(seen), wheels=wheels)
    return found


def examine(
    robot: Robot,
    logs: MotionSource | Sequence[MotionSource],
    *,
    torque_constants: Mapping[str, float | None] | None = None,
    mend: Mapping[str, str] | Sequence[tuple[str, str]] = (),
    progress: Callable[[str, float], None] | None = None,
) -> tuple[list[ExaminedLog], Wheels | None]:
    """The doctor's look at logs, and wheels where they have a reference: what `identify` does first of all.

    Args:
        robot: As its URDF has it.
        logs: Recorded motions, as of `identify`.
        torque_constants: As of `identify`.
        mend: As of `identify`.
        progress: As of `identify`.

    Raises:
        InputError: A log that cannot be read, a mend of no signal, a torque constant of no motor.
    """
    constants, tell = torque_constants or {}, progress or (lambda what, fraction: None)
    pairs, found, given = tuple(mend.items() if isinstance(mend, Mapping) else mend), [], logs_of(logs, robot)
    require_signals(given, pairs)
    for i, log in enumerate(given):
        tell("looking at the logs", i / len(given))
        own = mends_of(log, pairs)
        made = sound(mended(scaled(log, robot, constants), own), robot, [signal for signal, _ in own])
        seen = examined(made, robot, None not in constants.values())
        found.append(replace(seen, told=told_delays(own, robot.actuator_names)))
    every, wheels = with_wheels(robot, [one.log for one in found])
    if len(every) > 1:
        every = [log.by_name() for log in every]
    return [replace(one, log=log) for one, log in zip(found, every, strict=True)], wheels


def with_wheels(robot: Robot, logs: list[Log]) -> tuple[list[Log], Wheels | None]:
    """The logs with what their wheels and references say, each by itself and all together; and the wheels."""
    driven = [i for i, log in enumerate(logs) if has_reference(log, robot)]
    if any(x.grade == "refused" for i in driven for x in logs[i].findings):
        return logs, None  # first things first
    if len(driven) > 1:
        for i in driven:
            _, seen = wheel_findings(robot, [logs[i]])
            logs[i] = logs[i].with_findings(*(x for x in seen if x.grade == "refused" and x.mends))
        if any(x.grade == "refused" for i in driven for x in logs[i].findings):
            return logs, None
    if not driven:
        return logs, None
    wheels, seen = wheel_findings(robot, [logs[i] for i in driven])
    logs[driven[0]] = logs[driven[0]].with_findings(*seen)
    return logs, wheels


def fitted(
    robot: Robot,
    logs: Sequence[Log],
    unknowns: Unknowns,
    training: Equations,
    test: Equations,
    weight: float | None,
    rotors: RotorChoice,
    tell: Callable[[str, float], None],
) -> Identification:
    """The fit to some equations, judged on others; see `identify`."""
    prior, friction = Prior.of(unknowns, training), friction_alone(training, unknowns)
    follows, why = following(training, unknowns, prior, friction, tell)
    moves = np.ptp(np.concatenate([coordinates(log, robot)[0] for log in logs]), axis=0) > 1e-3
    training, mixed = training.only(follows).told_apart(unknowns)
    tell("fitting base parameters", 0.0)
    fit = weighted_fit(training, base_parameters(unknowns, follows, moves))
    tell("fitting all parameters", 0.0)
    R, z = compressed(training, prior, follows, fit)
    allowed, about = rotors_of(R, z, prior, fit.inflation, rotors)
    prior = prior.of_any_size(unknowns.columns("rotor")[allowed[unknowns.columns("rotor")]])
    strength, chosen = np.where(allowed, prior.strength, FIXED), weight
    if chosen is None:
        chosen, _ = Blocks.of(training, prior, fit.weights).chosen(follows, fit.deviation, strength)
        chosen = max(chosen, fit.inflation / DOUBT**2)  # no body is believed to be further from the URDF than bands say
    consistent = consistent_fit(R, z, prior, chosen, fit.inflation, allowed)
    notes = missing_notes(logs, robot)
    if mixed:
        notes.append(f"only sums are told, for joints never turn back or turn alike: {', '.join(mixed)}")
    return Identification(
        robot, tuple(logs), unknowns, training, test, fit, consistent, prior, follows, why, friction, tuple(notes),
        rotors=about,
    )  # fmt: skip


def require_settings(cutoff: float | None, stribeck: float | None, weight: float | None) -> None:
    """Refuse numbers that cannot be.

    Raises:
        ConfigError: With the option.
    """
    for name, value in (("cutoff", cutoff), ("stribeck", stribeck), ("weight", weight)):
        if value is not None and not (np.isfinite(value) and value > 0):
            raise ConfigError(f"{value}", fix="give a finite number > 0", key=f"--{name}")


def with_constants(
    training: Equations, test: Equations, unknowns: Unknowns, wanted: Sequence[str]
) -> tuple[Equations, Equations, tuple[str, ...]]:
    """The equations with torques in the place of efforts whose constants are not known, and what these are.

    Raises:
        ConfigError: One of a motor that is not alone with a joint, or no motor's is known.
        RecordingError: The motion does not tell one.
    """
    for name in wanted:
        if name not in unknowns.names:
            why, fix = "only those of motors are found that drive one joint", "give a number"
            raise ConfigError(f"no torque constant of '{name}'", why=why, fix=fix, key="--torque-constant")
    counts, every = np.asarray(training.use.sum(axis=0) >= FEWEST), np.ones(unknowns.robot.dimensions.dof, bool)
    rows, base = [unknowns.names.index(name) for name in wanted], base_parameters(unknowns, counts, every)
    found = constants_of(training.only(counts), base, rows, unknowns.names)
    pairs = zip(wanted, found.value, found.sd, strict=True)
    notes = tuple(f"torque constant of {name}: {value:.4g}, sd {sd:.2g}" for name, value, sd in pairs)
    return found.applied(training), found.applied(test), notes


def scaled(log: Log, robot: Robot, constants: Mapping[str, float | None]) -> Log:
    """The log with efforts in N m and N.

    Raises:
        UnknownName: A constant of no motor.
        ConfigError: A constant that is 0 or not finite.
    """
    for name, value in constants.items():
        if name not in robot.actuator_names:
            raise UnknownName("motor", name, robot.actuator_names, key="--torque-constant")
        if value is not None and not (np.isfinite(value) and value != 0):
            raise ConfigError(f"{name}={value}", fix="give a finite number that is not 0", key="--torque-constant")
    if not constants:
        return log
    signals = log.signals
    for name, value in constants.items():
        if value is not None and f"effort.{name}" in signals:
            signals[f"effort.{name}"] = signals[f"effort.{name}"] * value
    return log.with_signals(signals)


def divided(parts: Sequence[Equations]) -> tuple[Equations, Equations]:
    """The first two thirds of every motion, and the last one; what the filter mixes of both is in neither."""
    first, last = [], []
    for part in parts:
        end = part.time[0] + (1 - HELD_OUT) * (part.time[-1] - part.time[0])
        first.append(part.rows(part.time < end - 0.5 / part.cutoff))
        last.append(part.rows(part.time > end + 0.5 / part.cutoff))
    return Equations.stacked(first), Equations.stacked(last)


def friction_alone(of: Equations, unknowns: Unknowns) -> Array:
    """Viscous and dry friction and a constant fitted to every row by itself, (r, k)."""
    theta = np.zeros((len(unknowns.rows), unknowns.size))
    for i in range(len(unknowns.rows)):
        use, columns = of.use[:, i], friction_columns(unknowns, i)
        if np.count_nonzero(use) >= FEWEST:
            theta[i, columns] = np.linalg.lstsq(of.Y[use, i][:, columns], of.y[use, i], rcond=None)[0]
    return theta


def friction_columns(unknowns: Unknowns, i: int) -> Array:
    """Places of the friction of the joints that row i moves, and of its constant."""
    names = [unknowns.regressor.joints[j] for j in np.flatnonzero(unknowns.joint_rows[:, unknowns.rows[i]])]
    wanted = {f"{name}.{kind}" for name in names for kind in ("viscous", "coulomb", "stribeck")}
    wanted.add(f"{unknowns.names[i]}.offset")
    return np.array([j for j, label in enumerate(unknowns.labels) if label in wanted])


# -- which joints follow the rigid body --------------------------------------------------------------------------------


def following(
    training: Equations, unknowns: Unknowns, prior: Prior, friction: Array, tell: Callable[[str, float], None]
) -> tuple[Bools, dict[str, str]]:
    """Rows that the rigid body explains better than friction alone, and why the others do not.

    Raises:
        RecordingError: No row is left.
    """
    counts, why = training.use.sum(axis=0), {}
    follows = counts >= FEWEST
    for i in np.flatnonzero(~follows):
        why[unknowns.names[i]] = "it hardly moves"
    if not follows.any():
        raise RecordingError(
            "too still or too short a motion",
            why=f"no joint moves in {FEWEST} of the {len(training.use)} rows that it gives after filtering",
            fix="record a longer motion of all joints, see `mmnn excite`",
        )
    blocks = Blocks.of(training, prior)
    alone = friction_left_out(training, unknowns)
    deviation = np.sqrt(np.maximum(alone / np.maximum(counts, 1), 1e-18))
    while True:
        for part in range(3):
            tell("looking for joints that follow the rigid body", part / 3)
            _, errors = blocks.chosen(follows, deviation, prior.strength)
            deviation = np.where(follows, np.sqrt(np.maximum(errors / np.maximum(counts, 1), 1e-18)), deviation)
        size = np.maximum(blocks.square.sum(axis=0), 1e-300)
        ours, theirs = np.sqrt(errors / size), np.sqrt(alone / size)
        badness = np.where(follows, np.maximum(ours / np.maximum(theirs, 1e-12) / WORSE, ours / POOR), 0.0)
        worst = int(np.argmax(badness))
        if badness[worst] <= 1:
            return follows, why
        follows[worst] = False
        why[unknowns.names[worst]] = (
            f"its effort does not follow the rigid body: error {100 * ours[worst]:.0f} %, {100 * theirs[worst]:.0f} % "
            "by friction alone (another unit, a spring, a dead zone?)"
        )
        deviation = np.sqrt(np.maximum(alone / np.maximum(counts, 1), 1e-18))
        if not follows.any():
            fix = "check units and names of the efforts, see the notes"
            raise RecordingError(
                "no effort follows the rigid body", why="; ".join(f"{n}: {w}" for n, w in why.items()), fix=fix
            )


def friction_left_out(of: Equations, unknowns: Unknowns) -> Array:
    """Squared errors of friction alone on blocks that it was not fitted to, (r,)."""
    block = np.arange(len(of)) * BLOCKS // len(of)
    errors = np.zeros(len(unknowns.rows))
    for i in range(len(unknowns.rows)):
        columns = friction_columns(unknowns, i)
        for n in range(BLOCKS):
            rest, this = of.use[:, i] & (block != n), of.use[:, i] & (block == n)
            if not this.any():
                continue
            X, y = of.Y[rest, i][:, columns], of.y[rest, i]
            x = np.linalg.lstsq(X, y, rcond=None)[0]
            errors[i] += float(((of.y[this, i] - of.Y[this, i][:, columns] @ x) ** 2).sum())
    return errors


# -- doubts -----------------------------------------------------------------------------------------------------------


def beyond_limits(logs: Sequence[Log], robot: Robot, unknown: Collection[str]) -> Iterator[str]:
    """Efforts above the URDF's limit of their motor, a line for each, with how many samples.

    Args:
        logs: Motions, efforts in N m and N.
        robot: Whose limits count.
        unknown: Motors whose torque constant is not known yet.
    """
    limits = dict(zip(robot.actuator_names, robot.effort_limits, strict=True))
    for name, limit in limits.items():
        given = [log.effort[name] for log in logs if name in log.effort and name not in unknown]
        sizes = np.abs(np.concatenate(given)) if given else np.zeros(0)
        if count := int(np.count_nonzero(sizes > ABOVE * limit)):
            yield (
                f"effort.{name} is above the URDF's limit of {limit:g} in {count} of {sizes.size} samples, at most "
                f"{sizes.max():.4g}: another unit, a torque constant (--torque-constant {name}=K), or a wrong limit"
            )


def misfits(names: Sequence[str], errors: Mapping[str, Array], follows: Bools) -> Iterator[str]:
    """Joints that were fitted, and whose held-out error is far above least squares' or that of the other joints.

    Args:
        names: Of the r efforts.
        errors: Held-out errors (r,) of `identified`, `least_squares` and `urdf`; nan for one that stands.
        follows: (r,) whether an effort was fitted, of bool.
    """
    ours, theirs = errors["identified"], errors["least_squares"]
    for i in map(int, np.flatnonzero(follows & (ours > BADLY))):
        others = ours[follows & np.isfinite(ours) & (np.arange(len(names)) != i)]
        usual = float(np.median(others)) if others.size else np.inf
        here = f"{names[i]} fits badly: held-out error {100 * ours[i]:.3g} %"
        if ours[i] > FAR * theirs[i]:
            yield (
                f"{here}, {100 * theirs[i]:.3g} % by least squares without regard to masses: no body that can be "
                "explains its effort; check its sign, unit, gear and torque constant"
            )
        elif ours[i] > APART * usual:
            fix = "check its unit and torque constant, or its friction (--stribeck)"
            if errors["urdf"][i] < ours[i]:
                fix = f"by the URDF {100 * errors['urdf'][i]:.3g} %, so the motion tells too little of it (mmnn excite)"
            yield f"{here}, the other joints' median {100 * usual:.3g} %: {fix}"


def missing_notes(logs: Sequence[Log], robot: Robot) -> list[str]:
    """Notes on joints that the logs do not have and that are taken as still, and on locked ones that move."""
    found = []
    for log in logs:
        _, missing = coordinates(log, robot)
        if missing:
            found.append(f"{log.name}: not in the log, taken as still: {', '.join(missing)}")
        frozen = [name for name in log.position if name not in robot.joint_names and name in robot.arm.locked]
        moved = [name for name in frozen if np.ptp(log.position[name]) > 0.02]
        if moved:
            found.append(f"{log.name}: locked in the model, but they move: {', '.join(moved)}: --free JOINT frees one")
    return found
