"""The doctor: what the physics says of a log before anything is fitted to it, and what is refused.

`sound` looks at every signal by itself. Here all of them together have to be a rigid body with friction,

    Y(q, nu, nudot) theta = effort,     bodies of positive mass near the URDF's, friction and rotors >= 0,

    cost = min over theta  sum_i |y_i - Y_i theta|^2 / (EXACT |y_i|)^2 M_i + |x|^2,     theta = centre + B x,

by bounded least squares on a thinned log. Where that fits badly, a damage of the log is looked for that explains it: a
sign, a unit, two joints exchanged, in positions or efforts, or two of these. One is told where the cost falls by
`BETTER` and more, and the error of every joint that it names by `HELPS`. Delays are those of `timing`, with bands.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import Any

import numpy as np
import scipy

from ...errors import RecordingError
from ...model.regressor import Regressor
from ...model.robot import Robot
from ...signals import Array
from .equations import (
    Bools,
    Equations,
    Unknowns,
    chosen_cutoff,
    coordinates,
    efforts,
    equations,
    evenly,
    low_pass,
    measured_rows,
    still_speeds,
    stretches_of,
)
from .log import Log, LogFinding, revolves, worst_first
from .mends import Mend, mended, words_of
from .programme import PLACES, Prior
from .timing import Delay, effort_delays, recorded_delays

EXACT = 0.05  # share of an effort's RMS that the rigid body need not explain
POOR = 0.25  # error of a row above which a damage is looked for
BETTER = 3.0  # times less than before that the cost is with a damage that is told
HELPS = 0.7  # times the cost before, under which a damage is kept in sight beside another
PARTS = 2  # damages at once that are looked for
SAMPLED = 400  # times of a log at which damages are tried
SHOWN, CALM = 1500, 60.0  # equations, and seconds, that are looked at
DIAGONAL = np.array([i == j for i, j in PLACES])
PERIODS = 0.2  # of the log's rows under which a delay is none
SEEN = 0.95  # error with a delay over that without, above which none is told
LATE = 0.75  # error with a delay over that without, from which the delay is refused


@dataclass(frozen=True, eq=False)
class ExaminedLog:
    """A log after the doctor saw it.

    Attributes:
        log: It, with its findings.
        efforts: Delay of every row's effort; None where none is seen.
        rates: Delay of every recorded rate.
        names: Of the rows.
        motors: Delay of every recorded effort behind its command.
        told: By how much the user mended efforts that were late, and the lag of their motors, by joint [s].
    """

    log: Log
    efforts: tuple[Delay | None, ...]
    rates: dict[str, Delay]
    names: tuple[str, ...]
    motors: dict[str, Delay]
    told: dict[str, tuple[float, float]] = field(default_factory=dict)

    @property
    def timing(self) -> dict[str, dict[str, float]]:
        """Command delay, motor lag, delay and lag of a joint's rate, with standard deviations [s]; what is clear.

        Delay and lag of a motor are those of its effort behind its command where both are recorded, else those with
        which an effort that is a command acts, as the user mended it.
        """
        found: dict[str, dict[str, float]] = {}
        rows = dict(zip(self.names, self.efforts, strict=True))
        for name, (late, after) in self.told.items():
            one = rows.get(name)
            sd = one.sd if one else 0.0
            if late <= 0:
                found[name] = {"command_delay": -late, "command_delay_sd": sd, "motor_lag": after, "motor_lag_sd": sd}
        for joints, delay, lag in (
            (self.motors, "command_delay", "motor_lag"),
            (self.rates, "velocity_delay", "velocity_lag"),
        ):
            for name, x in joints.items():
                if x.clear and x.error < LATE * x.error_before:
                    numbers = {delay: x.value, f"{delay}_sd": x.sd, lag: x.lag, f"{lag}_sd": x.lag_sd}
                    found[name] = found.get(name, {}) | numbers
        return found

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        pairs = zip(self.names, self.efforts, strict=True)
        return {
            "name": self.log.name,
            "notes": list(self.log.notes),
            "efforts": {name: None if one is None else one.to_dict() for name, one in pairs},
            "rates": {name: one.to_dict() for name, one in self.rates.items()},
            "motors": {name: one.to_dict() for name, one in self.motors.items()},
            "timing": self.timing,
        }


def examined(log: Log, robot: Robot, torques: bool = True) -> ExaminedLog:
    """A sound log with what the physics of the robot says of it.

    Args:
        log: From `sound`.
        robot: As its URDF has it.
        torques: Whether its efforts are torques; of currents only delays are looked at.
    """
    try:
        unknowns = Unknowns(robot, Regressor.of(robot), measured_rows(robot, [log]))
        cutoff = chosen_cutoff([log], robot)
        of = equations(log, unknowns, cutoff, still_speeds([log], unknowns, cutoff))
    except RecordingError:  # the fit says so
        return ExaminedLog(log, (), {}, (), {})
    delays = tuple(effort_delays(log, unknowns, of))
    rates, motors = recorded_delays(log, cutoff)
    found = [*(damages(log, robot, unknowns, of) if torques else ()), *late_rates(rates)]
    if not any(one.grade == "refused" for one in found):
        found += late_efforts(delays, unknowns, of, float(np.median(np.diff(log.time))))
    return ExaminedLog(log.with_findings(*found), delays, rates, unknowns.names, motors)


def require_no_contradiction(logs: Sequence[Log]) -> None:
    """Refuse logs that contradict the physics.

    Raises:
        RecordingError: With the worst finding.
    """
    found = [(log, one) for log in logs for one in log.findings if one.grade == "refused"]
    if not found:
        return
    log, worst = max(found, key=lambda pair: pair[1].size)
    more = len(found) - 1
    rest = f" (and {more} more: see --check)" if more else ""
    why = "; ".join(part for part in (worst.why, f"it changes {worst.changes}" if worst.changes else "") if part)
    raise RecordingError(worst.what, why=why, fix=worst.advice + rest, file=log.name)


# -- delays ------------------------------------------------------------------------------------------------------------


def late_rates(rates: dict[str, Delay]) -> Iterator[LogFinding]:
    """The finding of rates that come later than the positions: nothing depends on them here."""
    late = [
        f"{name} {in_ms(one)}"
        for name, one in rates.items()
        if one.clear and one.whole > 1e-3 and one.error < LATE * one.error_before
    ]
    if late:
        what, changes = f"velocities come after their positions: {', '.join(late)}", "positions are used"
        yield LogFinding("mended", what, "", f"{changes}; what a drive filters is a result")


def late_efforts(delays: Sequence[Delay | None], unknowns: Unknowns, of: Equations, period: float) -> list[LogFinding]:
    """The finding of efforts that are recorded at another time than the motion that they make: all rows, or some."""
    rows = [i for i, one in enumerate(delays) if one is not None and one.sd < 0.05 and abs(one.value) < 0.29]
    if not rows:
        return []
    values = np.array([delays[i].value for i in rows])  # type: ignore[union-attr]
    weights = np.array([delays[i].sd ** -2.0 for i in rows])  # type: ignore[union-attr]
    mean, sd = float(values @ weights / weights.sum()), float(weights.sum() ** -0.5)
    alike = bool((np.abs(values - mean) < 4 / np.sqrt(weights) + 2e-3).all())
    found = []
    for i, value in zip(rows, values, strict=True):
        one = delays[i]
        assert one is not None
        if abs(value) <= max(3 * one.sd, PERIODS * period) or one.error > SEEN * one.error_before:
            continue
        grade = "refused" if one.error < LATE * one.error_before else "warned"
        found.append((i, one, grade))
    if not found:
        return []
    serious = [(i, one) for i, one, grade in found if grade == "refused"]
    grade = "refused" if serious else "warned"
    worst, one = max(serious or [(i, one) for i, one, _ in found], key=lambda pair: 1 / max(pair[1].error, 1e-9))
    if alike and len(rows) > 1:
        mends: Mend = (("effort.*", f"late:{mean:.4g}"),)
        what = f"the efforts are {1e3 * abs(mean):.3g} ± {1.96e3 * sd:.2g} ms {word(mean)}"
    else:
        those = [(i, one) for i, one, _ in found]
        mends = tuple(m for i, one in those for m in delay_mends(unknowns, i, one))
        said = ", ".join(f"effort of {unknowns.names[i]} {in_ms(one)} {word(one.value)}" for i, one in those)
        what = f"recorded at another time than the motion: {said}"
    changes = f"{viscous(unknowns, of, worst, one)}the friction that is found"
    return [LogFinding(grade, what, left(one), changes, mends, "", 10 * one.error_before / max(one.error, 1e-9))]  # type: ignore[arg-type]


def delay_mends(unknowns: Unknowns, row: int, one: Delay) -> Mend:
    """The mends of the efforts of a row."""
    motors = np.array(unknowns.robot.actuator_names)[unknowns.robot.E[unknowns.rows[row]] != 0]
    found = [(f"effort.{name}", f"late:{one.value:.4g}") for name in motors]
    return (*found, *((f"effort.{name}", f"lag:{one.lag:.4g}") for name in motors if one.lag))


def in_ms(one: Delay) -> str:
    """A delay with its band, and its lag."""
    lag = f" and a lag of {1e3 * one.lag:.3g} ± {1.96e3 * one.lag_sd:.2g} ms" if one.lag else ""
    return f"{1e3 * abs(one.value):.3g} ± {1.96e3 * one.sd:.2g} ms{lag}"


def word(value: float) -> str:
    """Which of the two comes first."""
    return "late" if value > 0 else "early, as commands are"


def left(one: Delay) -> str:
    """The share that a delay leaves unexplained, and that without it."""
    return f"with it {100 * one.error:.2g} % is left unexplained, without {100 * one.error_before:.2g} %"


def viscous(unknowns: Unknowns, of: Equations, row: int, one: Delay) -> str:
    """The change that a delay makes to the viscous friction of a row's joint, about.

    The effort J a(t - d) has the part -d J a'(t), which grows with the speed where a motion swings.
    """
    names = [unknowns.regressor.joints[j] for j in np.flatnonzero(unknowns.joint_rows[:, unknowns.rows[row]])]
    use = of.use[:, row]
    X = of.Y[use, row]
    columns = [k for k, label in enumerate(unknowns.labels) if label in {f"{name}.viscous" for name in names}]
    if not columns or use.sum() < 50:
        return ""
    y = of.y[use, row]
    theta = np.linalg.lstsq(X, y, rcond=1e-6)[0]
    rate = np.gradient(y, of.time[use])
    then = np.linalg.lstsq(X, y + one.value * np.where(np.isfinite(rate), rate, 0.0), rcond=1e-6)[0]
    k = columns[0]
    return f"viscous friction of {names[0]}, {theta[k]:.3g} in place of about {then[k]:.3g}, "


# -- signs, units, exchanged joints ------------------------------------------------------------------------------------


def damages(log: Log, robot: Robot, unknowns: Unknowns, of: Equations) -> Iterator[LogFinding]:
    """The finding of a damage, or two at once, with which the log is that of the robot, where without it is not."""
    _, errors = cost(of, unknowns)
    if errors.max(initial=0.0) < POOR:
        return
    short = shortened(log)
    cutoff = of.cutoff

    def judged(mend: Mend) -> float:
        try:
            made = mended(short, mend)
            return cost(sampled(made, unknowns, cutoff), unknowns, np.asarray(errors > 0))[0]
        except (RecordingError, np.linalg.LinAlgError):
            return np.inf

    start, none = judged(()), tuple[tuple[str, str], ...]()
    found = [(none, start)]
    for _ in range(PARTS):
        chosen = found[-1][0]
        tried = {mend: judged((*chosen, *mend)) for mend in hypotheses(short, robot)}
        mend = min(tried, key=lambda one: tried[one])
        if not tried[mend] < HELPS * found[-1][1]:
            break
        found.append(((*chosen, *mend), tried[mend]))
    if len(found) > PARTS and found[-1][1] > found[-2][1] / BETTER and found[-2][1] < start / BETTER:
        found.pop()  # one explains it
    chosen, least = found[-1]
    if least > start / BETTER:
        return
    made = mended(short, chosen)
    _, after = cost(sampled(made, unknowns, cutoff), unknowns)
    accused = np.isin(unknowns.names, [signal.partition(".")[2] for signal, _ in chosen]) & (errors > 0)
    if (after > np.maximum(EXACT, HELPS * errors))[accused].any():
        return  # a joint that was explained as well before is not another one
    worst = int(np.argmax(errors))
    shares = f"{100 * errors[worst]:.0f} % is unexplained, with this mended {100 * after[worst]:.0f} %"
    why = f"of the effort of {unknowns.names[worst]} {shares}"
    what = ", ".join(words_of(chosen))
    yield LogFinding(
        "refused", what, why, "all that is found of these joints", chosen, "", 100 * start / max(least, 1e-9)
    )


def sampled(log: Log, unknowns: Unknowns, cutoff: float) -> Equations:
    """Equations at some times of a log, whose regressor is not filtered: far cheaper, and exact enough to choose by.

    Raises:
        RecordingError: No stretch without gaps is long enough.
    """
    parts = []
    for part in stretches_of(log, cutoff):
        period = float(np.median(np.diff(part.time)))
        time = np.arange(part.time[0], part.time[-1], period)
        x, tau = coordinates(part, unknowns.robot)[0], efforts(part, unknowns.robot, unknowns.rows)[0]
        x, tau = (low_pass(evenly(part.time, one, time), cutoff, 1 / period) for one in (x, tau))
        spline = scipy.interpolate.make_interp_spline(time, x, 5)
        at = np.arange(len(time) // 20, len(time) - len(time) // 20, max(1, len(log.time) // SAMPLED))
        nu, nudot = spline(time[at], 1), spline(time[at], 2)
        Y = unknowns.matrix(x[at, unknowns.robot.dimensions.base :], nu, nudot)
        speed = nu[:, list(unknowns.rows)]
        use = np.abs(speed) > 0.1 * np.abs(speed).max(axis=0)
        parts.append(Equations(time[at], Y, tau[at], use, speed, np.zeros(len(at), dtype=np.int64), cutoff))
    if not parts:
        raise RecordingError("too short a motion", file=log.name)
    return Equations.stacked(parts)


def shortened(log: Log) -> Log:
    """The middle of a long log."""
    last = log.time[-1]
    keep = np.abs(log.time - last / 2) <= CALM / 2
    return log.rows(keep) if last > CALM else log


def hypotheses(log: Log, robot: Robot) -> list[Mend]:
    """Damages of one kind each, as what would mend them."""
    wheels = [wheel.joint for wheel in robot.base.wheels if wheel.joint in log.position]
    joints = [name for name in robot.joint_names if name in log.position]
    motors = [name for name in robot.actuator_names if name in log.effort]
    moving = [name for name in (*wheels, *joints) if np.ptp(log.position[name]) > 1e-3]
    found: list[Mend] = [((f"effort.{name}", "negated"),) for name in motors]
    found += [((f"position.{name}", "negated"),) for name in moving]
    turning = [name for name in moving if revolves(robot, name)]
    found += [((f"position.{name}", "deg"),) for name in turning]
    if len(turning) > 1:
        found.append(tuple((f"position.{name}", "deg") for name in turning))
    both = [name for name in moving if name in motors]
    found += [((f"position.{name}", "negated"), (f"effort.{name}", "negated")) for name in both]
    for kinds, names in ((("effort",), motors), (("position",), moving), (("position", "effort"), both)):
        for a, b in combinations(names, 2):
            found.append(tuple((f"{kind}.{one}", f"{kind}.{two}") for kind in kinds for one, two in ((a, b), (b, a))))
    return found


def cost(of: Equations, unknowns: Unknowns, needed: Bools | None = None) -> tuple[float, Array]:
    """The module's cost over the number of equations, and the error of every row, (r,).

    Args:
        of: The equations.
        unknowns: What is fitted.
        needed: (r,) of bool, rows that have to be there: one that does not move is not explained.
    """
    prior = Prior.of(unknowns, of)
    every = max(1, len(of) // SHOWN)
    parts, right, rows = [], [], []
    for i in range(of.y.shape[1]):
        use = np.flatnonzero(of.use[:, i])[::every]
        y = of.y[use, i]
        size = np.sqrt((y**2).mean()) if len(use) > 20 else 0.0
        if size > 0:
            parts.append(of.Y[use, i] / (EXACT * size))
            right.append(y / (EXACT * size))
            rows.append(i)
    errors = np.zeros(of.y.shape[1])
    missing = 0 if needed is None else len(np.setdiff1d(np.flatnonzero(needed), rows)) / EXACT**2
    if not parts:
        return missing, errors
    Y, y = np.vstack(parts), np.concatenate(right)
    R = np.asarray(np.linalg.qr(np.column_stack((Y @ prior.B, y - Y @ prior.centre)), mode="r"))
    m = prior.B.shape[1]
    strength = np.sqrt(np.maximum(prior.strength, 1e-4))
    lower = np.concatenate((np.tile(np.where(DIAGONAL, -0.98, -np.inf), prior.bodies), prior.positive))
    lower = np.minimum(lower, -1e-9)
    A, b = np.vstack((R[:, :m], np.diag(strength))), np.concatenate((R[:, m], np.zeros(m)))
    x = scipy.optimize.lsq_linear(
        A, b, (lower, np.full(m, np.inf)), method="bvls" if m < 30 else "trf", lsmr_tol=None
    ).x
    theta = prior.theta(x)
    for i, part, one in zip(rows, parts, right, strict=True):
        errors[i] = np.sqrt(((one - part @ theta) ** 2).sum() / (one**2).sum())
    total = float(((y - Y @ theta) ** 2).sum() + (strength * x) @ (strength * x)) / len(y)
    return total + missing, errors


def all_findings(logs: Sequence[Log]) -> list[LogFinding]:
    """Findings of all logs, worst first."""
    return worst_first([one for log in logs for one in log.findings])
