"""A recorded motion: time, joints, efforts, base; from arrays, or by `reading` and `bag` from files.

Names of signals: `time`, `position.JOINT`, `velocity.JOINT`, `effort.JOINT`, `command.JOINT`, `base.x` to `base.w`
(odometry), and `reference.x`, `reference.y`, `reference.phi` (a reference pose, as of a motion capture system).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import RecordingError
from ...model.robot import Robot
from ...signals import Array

BASE = tuple(f"base.{name}" for name in ("x", "y", "phi", "v", "vx", "vy", "w"))
REFERENCE = tuple(f"reference.{name}" for name in ("x", "y", "phi"))
Columns = Mapping[str, str]

LARGEST = 1e30  # in SI units, of anything; its square is a number


@dataclass(frozen=True)
class LogFinding:
    """A finding of the doctor in a log."""

    # `"refused"`: it contradicts the physics, and nothing is written; `"warned"`; `"mended"`
    grade: Literal["refused", "warned", "mended"]
    what: str  # what was seen, with its band
    why: str = ""  # how sure that is, and by what
    changes: str = ""  # what it would change
    # what mends it, see `mends`; empty where the user has to do it, as `fix` says
    mends: tuple[tuple[str, str], ...] = ()
    fix: str = ""  # in words, beside `mends`
    size: float = 0.0  # how bad it is among those of its grade

    @property
    def advice(self) -> str:
        """The options that mend it, and what else is to be done."""
        options = " ".join(f"--mend '{signal}={how}'" for signal, how in self.mends)
        return ", or ".join(part for part in (options, self.fix) if part)

    def __str__(self) -> str:
        head = self.what + (f" ({self.why})" if self.why else "")
        return ": ".join(part for part in (head, self.changes, self.advice) if part)

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {"grade": self.grade, "what": self.what, "why": self.why, "changes": self.changes, "fix": self.advice}


GRADES = ("refused", "warned", "mended")  # worst first


def worst_first(findings: Iterable[LogFinding]) -> list[LogFinding]:
    """Findings by grade and size, each once."""
    return sorted(dict.fromkeys(findings), key=lambda one: (GRADES.index(one.grade), -one.size))


@dataclass(frozen=True, eq=False)
class Log:
    """One recorded motion.

    Attributes:
        name: What it is called in messages.
        time: (N,) [s].
        position: (N,) of every measured joint [rad or m].
        velocity: Likewise [rad/s or m/s]; it is only compared with the positions, where there are some.
        effort: Likewise, of every measured motor [N m or N, or its current].
        command: Likewise, the effort that was asked of it; only its delay and lag are found.
        base: (N,) of `base.x` and so on, see `BASE` [m, rad, m/s, rad/s].
        reference: (N,) of `reference.x` and so on [m, rad].
        effort_delay: How much later than its time an effort acts [s].
        notes: Remarks on it.
        findings: What the doctor sees in it.
    """

    name: str
    time: Array
    position: dict[str, Array]
    velocity: dict[str, Array] = field(default_factory=dict)
    effort: dict[str, Array] = field(default_factory=dict)
    command: dict[str, Array] = field(default_factory=dict)
    base: dict[str, Array] = field(default_factory=dict)
    reference: dict[str, Array] = field(default_factory=dict)
    effort_delay: float = 0.0
    notes: tuple[str, ...] = ()
    findings: tuple[LogFinding, ...] = ()

    @classmethod
    def of(
        cls,
        time: ArrayLike,
        position: Mapping[str, ArrayLike],
        effort: Mapping[str, ArrayLike],
        velocity: Mapping[str, ArrayLike] | None = None,
        base: Mapping[str, ArrayLike] | None = None,
        reference: Mapping[str, ArrayLike] | None = None,
        name: str = "arrays",
    ) -> Log:
        """A log of arrays.

        Args:
            time: (N,) [s].
            position: (N,) by joint [rad or m].
            effort: (N,) by joint [N m or N].
            velocity: (N,) by joint [rad/s or m/s].
            base: (N,) by `x`, `y`, `phi`, `v`, `vx`, `vy`, `w` [m, rad, m/s, rad/s].
            reference: (N,) by `x`, `y`, `phi` [m, rad].
            name: What it is called in messages.

        Raises:
            RecordingError: Arrays of different lengths.
        """
        signals = {"time": np.asarray(time, float)}
        for kind, given in (
            ("position", position), ("velocity", velocity), ("effort", effort), ("base", base), ("reference", reference)
        ):  # fmt: skip
            signals |= {f"{kind}.{key}": np.asarray(values, float) for key, values in (given or {}).items()}
        return from_signals(name, signals)

    @property
    def signals(self) -> dict[str, Array]:
        """All signals but the time, by their full names."""
        found = {f"position.{name}": values for name, values in self.position.items()}
        found |= {f"velocity.{name}": values for name, values in self.velocity.items()}
        found |= {f"effort.{name}": values for name, values in self.effort.items()}
        found |= {f"command.{name}": values for name, values in self.command.items()}
        return found | self.base | self.reference

    def with_signals(self, signals: Mapping[str, Array], time: Array | None = None, *notes: str) -> Log:
        """The log with other numbers for its signals, and more notes."""
        made = from_signals(self.name, {"time": self.time if time is None else time, **signals})
        return replace(made, effort_delay=self.effort_delay, notes=(*self.notes, *notes), findings=self.findings)

    def with_findings(self, *findings: LogFinding) -> Log:
        """The log with more findings."""
        return replace(self, findings=(*self.findings, *findings))

    def by_name(self) -> Log:
        """The log with mends that name it, as one of several."""
        stem = Path(self.name).stem
        named = (replace(x, mends=tuple((f"{stem}:{a}", b) for a, b in x.mends)) for x in self.findings)
        return replace(self, findings=tuple(named))

    def rows(self, keep: NDArray[np.int64] | NDArray[np.bool_] | slice, *notes: str) -> Log:
        """Some rows of it, and more notes."""
        return self.with_signals({name: values[keep] for name, values in self.signals.items()}, self.time[keep], *notes)


def from_signals(name: str, signals: Mapping[str, Array]) -> Log:
    """A log of signals by their full names.

    Raises:
        RecordingError: Signals of another length than the time's, or with a number that nothing measures.
    """
    time = np.asarray(signals["time"], float)
    parts: dict[str, Any] = {key: {} for key in ("position", "velocity", "effort", "command", "base", "reference")}
    for signal, values in signals.items():
        if np.shape(values) != time.shape or time.ndim != 1:
            what = f"{signal} has shape {np.shape(values)}, the time {time.shape}"
            raise RecordingError(what, fix="give one number per time", file=name)
        if len(far := np.flatnonzero(np.abs(values) > LARGEST)):
            what = f"{signal} is {np.asarray(values)[far[0]]:g} in sample {far[0]}"
            raise RecordingError(what, why="nothing measures that", fix="leave the sample out", file=name)
        kind, _, rest = signal.partition(".")
        if kind in parts:
            parts[kind][signal if kind in ("base", "reference") else rest] = np.asarray(values, float)
    return Log(name, time, **parts)


def revolves(robot: Robot, joint: str) -> bool:
    """Whether a joint of the model turns, and does not slide."""
    return bool(robot.model.joints[robot.model.getJointId(joint)].shortname().startswith("JointModelR"))


def is_angle(signal: str, robot: Robot) -> bool:
    """Whether a signal is the position of something that turns."""
    kind, _, name = signal.partition(".")
    return name == "phi" or (kind == "position" and name in robot.full_velocity_names and revolves(robot, name))
