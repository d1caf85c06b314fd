"""The results of a study's runs as arrays: outcomes, successes and metrics of every controller on equal draws.

Metrics are named by patterns; a run without a number counts as the worst.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from ...errors import InputError, StudyError, UnknownName
from ...model.robot import Robot
from ...settings import plain
from ...settings.arguments import shortly
from ...signals import ALONG, Array, IntArray
from .factors import Factor, draws_of, is_number
from .keys import near
from .settings import StudySettings
from .store import AGAIN, NAME, TrialResult, reading

DEFAULT = ("pose_error.[xy].peak", "pose_error.phi.peak", "e.*.peak", "effort")


@dataclass(frozen=True, eq=False)
class Results:
    """The results of a study so far."""

    path: Path  # their file
    name: str  # the study's name
    settings: StudySettings  # the study's settings
    planned: int  # number of its runs
    rows: Sequence[TrialResult] = field(repr=False)  # the runs that are done, failed ones left out
    failed: Sequence[TrialResult] = field(repr=False)  # rows that failed for a fault and will be run again
    patterns: tuple[str, ...]  # metrics to show
    units: Mapping[str, str]  # metric to its unit
    meta: Mapping[str, Any] = field(repr=False)  # all facts of the study
    _found: dict[tuple[str, str], Array] = field(default_factory=dict, init=False, repr=False)

    @cached_property
    def of(self) -> dict[str, list[TrialResult]]:
        """Rows of every controller, in the same order of draws and seeds."""
        table: dict[str, list[TrialResult]] = {name: [] for name in self.meta["controllers"]}
        for row in self.rows:
            table[row.controller].append(row)
        return table

    @property
    def controllers(self) -> list[str]:
        """Controllers that have rows."""
        return [name for name, rows in self.of.items() if rows]

    @property
    def factors(self) -> dict[str, Factor]:
        """Factors that a user can do something about: all but the seed."""
        return {n: f for n, f in self.settings.factors.items() if f.paths(n) != ("seed",)}

    def outcomes(self, controller: str) -> Counter[str]:
        """How many runs ended how."""
        return Counter(row.status for row in self.of[controller])

    def metric(self, controller: str, pattern: str) -> Array:
        """A metric of every run of a controller, (n,); inf for a run that did not complete, whatever it had so far.

        NaN for a completed run without a number, such as the RMS of a window that no run reaches.
        """
        if (controller, pattern) not in self._found:
            rows = self.of[controller]
            values = np.array([worth(row.status, row.metrics, pattern) for row in rows])
            self._found[controller, pattern] = np.where(
                np.isinf(values) & [row.completed for row in rows], math.nan, values
            )
        return self._found[controller, pattern].copy()

    def succeeded(self, controller: str) -> NDArray[np.bool_]:
        """Which runs of a controller are a success, (n,)."""
        bounds = self.settings.success.at_most.items()
        good = (row.completed and all(value_of(row.metrics, n) <= b for n, b in bounds) for row in self.of[controller])
        return np.fromiter(good, bool)

    def values(self, controller: str, factor: str) -> list[Any]:
        """Value of a factor in every run of a controller."""
        return [row.parameters[factor] for row in self.of[controller]]

    def draws(self, controller: str) -> IntArray:
        """Number of the draw of every run of a controller, (n,): what is drawn is equal there.

        Where nothing is drawn, runs of one seed share that.
        """
        return draws_of(self.settings.factors, [(row.parameters, row.seed) for row in self.of[controller]])

    def groups(self, controller: str, factor: str) -> IntArray:
        """Number of the group of every run of a controller, (n,), of runs with one value of a factor and one draw."""
        pairs = zip(self.draws(controller), self.values(controller, factor), strict=True)
        keys = [f"{draw} {value!r}" for draw, value in pairs]
        return np.asarray(np.unique(keys, return_inverse=True)[1], np.int64)

    def paired(self, one: str, other: str) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Places of the runs of two controllers that both have, draw by draw."""
        places = {(row.point, row.seed): i for i, row in enumerate(self.of[other])}
        both = [(i, places[key]) for i, row in enumerate(self.of[one]) if (key := (row.point, row.seed)) in places]
        pairs = np.array(both, np.intp).reshape(-1, 2)
        return pairs[:, 0], pairs[:, 1]

    def unit(self, pattern: str) -> str:
        """Unit of a metric, such as `rad`; `rad or m` of a pattern that mixes them; empty for a pure number."""
        units = {unit for name, unit in self.units.items() if fnmatchcase(name, pattern)}
        return " or ".join(sorted(units, key=lambda unit: (not unit.startswith("rad"), unit))) if all(units) else ""


def worth(status: str, metrics: Mapping[str, float], pattern: str) -> float:
    """A metric of a run, inf where it did not complete."""
    return value_of(metrics, pattern) if status == "completed" else math.inf


def load_results(path: Path) -> Results:
    """Results of a study's file, or of the folder that holds one.

    Raises:
        StudyError: There is none, it is of another version, or has no rows yet.
    """
    path = path / NAME if path.is_dir() else path
    store = reading(path)
    meta, rows = store.facts, store.results
    if not rows:
        raise StudyError("holds no rows yet", fix="let `mmnn study` run for a while", file=path)
    try:
        settings = msgspec.convert(meta["settings"], StudySettings)
    except (msgspec.ValidationError, InputError) as error:
        why = " ".join(str(error).removeprefix("error: ").split())
        raise StudyError("its settings cannot be read", why=why, fix=AGAIN, file=path) from error
    for row in rows:
        require_of(row, settings, meta["controllers"], path)
    return Results(
        path=path,
        name=meta["name"],
        settings=settings,
        planned=meta["rows"],
        rows=[row for row in rows if row.status != "failed"],
        failed=[row for row in rows if row.status == "failed"],
        patterns=tuple(meta["metrics"]),
        units=meta["units"],
        meta=meta,
    )


def require_of(row: TrialResult, settings: StudySettings, controllers: Sequence[str], path: Path) -> None:
    """Refuse a row that is none of the study's (`StudyError`)."""
    why = (
        f"its controller {shortly(row.controller)} is none of the study's" if row.controller not in controllers else ""
    )
    for name, factor in settings.factors.items():
        value = row.parameters.get(name)
        if name not in row.parameters or (factor.numeric and not (is_number(value) and math.isfinite(value or 0))):
            why = why or f"its {name} is {shortly(value)}"
        elif (listed := factor.grid or factor.choice) and value not in [plain(one) for one in listed]:
            why = why or f"its {name} is {shortly(value)}, which is none of the study's"
    if why:
        raise StudyError(f"row {row.id} cannot be read", why=why, fix=AGAIN, file=path)


def value_of(metrics: Mapping[str, float], pattern: str) -> float:
    """The largest metric that a pattern names; inf where one is no number, nan where there is none."""
    found = [metrics[name] for name in named(tuple(metrics), pattern)]
    if not found:
        return math.nan
    return max(math.inf if math.isnan(value) else value for value in found)


@lru_cache(maxsize=256)
def named(names: tuple[str, ...], pattern: str) -> tuple[str, ...]:
    """Names that a pattern names; remembered, as all rows of a study have the same."""
    return tuple(name for name in names if fnmatchcase(name, pattern))


def require_patterns(patterns: Iterable[str], names: Iterable[str], key: str) -> None:
    """Refuse patterns that name no metric.

    Args:
        patterns: Names, in which `*` and `[xy]` are as in a shell.
        names: Metrics that there are.
        key: Where the patterns were given.

    Raises:
        UnknownName: With the statistics that these signals have, or the names that are near.
    """
    known = list(names)
    for pattern in patterns:
        if not any(fnmatchcase(name, pattern) for name in known):
            signals, _ = parted(pattern)
            ends = dict.fromkeys(parted(name)[1] for name in known if fnmatchcase(parted(name)[0], signals))
            raise UnknownName("metric", pattern, [f"{signals}.{end}" for end in ends] or near(pattern, known), key=key)


def parted(name: str) -> tuple[str, str]:
    """`signal.label` and the statistic, whose window may have points: `e.arm_1_joint` and `rms_0_0.5`."""
    found = re.fullmatch(r"(.*)\.([a-z].*)", name)
    return (found[1], found[2]) if found else (name, "")


def units_of(names: Iterable[str], robot: Robot) -> dict[str, str]:
    """Unit of every metric of a robot; empty for a pure number."""
    joints = {name: robot.model.joints[robot.model.getJointId(name)] for name in robot.joint_names}
    slides = {name for name, joint in joints.items() if joint.shortname().startswith("JointModelP")}
    return {name: unit_of(name, slides) for name in names}


def unit_of(name: str, slides: set[str]) -> str:
    """Unit of one metric.

    Args:
        name: `signal.label.statistic`.
        slides: Arm joints that slide.
    """
    signal, _, label = parted(name)[0].partition(".")
    units = {"effort": "N²m²s", "slip": "m/s", "constraint_residual": "m/s", "energy_residual": "J"}
    units |= {"pose_error": "rad" if label == "phi" else "m", "z": "m/s" if label in ALONG else "rad/s"}
    return (units | {"e": "m" if label in slides else "rad"}).get(signal, "")
