"""What the rows of all rigs say: who is best, by how much, and how that depends on the rig."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from mmnn_pin.lab.experiments.thesis import mean_ratio, thesis_ratios
from mmnn_pin.signals import Array
from research.studies.crossed import middle, share

from .compare import CONDITIONS, LEARNERS, MEASURES, NAMES, Row, column

TWO, ONE = "two_layer_zero", "one_layer"
USABLE = 3.0  # largest error of PD on a rig that one would use [deg]
Chosen = Callable[[Mapping[str, Any]], bool]


def between(name: str, low: float, high: float) -> Chosen:
    """Rigs whose number lies in [low, high)."""
    return lambda row: bool(low <= row[name] < high)


def equal(name: str, value: object) -> Chosen:
    """Rigs with this value."""
    return lambda row: bool(row[name] == value)


# Classes of rigs: heading, then label to which rigs.
CLASSES: dict[str, dict[str, Chosen]] = {
    "all": {"all rigs": lambda row: True},
    "dry friction": {
        "1 to 2.5 N m": between("coulomb", 1.0, 2.5),
        "2.5 to 6 N m": between("coulomb", 2.5, 6.0),
        "6 to 15 N m": between("coulomb", 6.0, 16.0),
    },
    "backlash": {
        "none": equal("gap", 0.0),
        "1 to 4.5 mrad": between("gap", 1e-4, 4.5e-3),
        "4.5 to 20 mrad": between("gap", 4.5e-3, 1.0),
    },
    "encoder step": {
        "0.1 to 0.4 mrad": between("resolution", 0.0, 4e-4),
        "0.4 to 1.4 mrad": between("resolution", 4e-4, 1.4e-3),
        "1.4 to 5 mrad": between("resolution", 1.4e-3, 1.0),
    },
    "sample rate": {f"{1 / h:.0f} Hz": equal("period", h) for h in (0.008, 0.005, 0.0025, 0.001)},
    "PD": {
        "never 3 deg off": lambda row: bool(row["pd.largest"] < USABLE),
        "worse": lambda row: not row["pd.largest"] < USABLE,
    },
    "encoders": {"on the joint": equal("side", "joint"), "on the motor": equal("side", "motor")},
    "networks": {
        "in degrees throughout": equal("unit", "degrees"),
        "degrees at the input only": equal("unit", "radians"),
    },
}


def verdict(rows: Sequence[Row]) -> dict[str, Any]:
    """Condition to heading to class to numbers, for JSON."""
    found: dict[str, Any] = {}
    for condition in CONDITIONS:
        mine = [row for row in rows if row["condition"] == condition]
        found[condition] = {
            heading: {label: of_class([row for row in mine if chosen(row)]) for label, chosen in classes.items()}
            for heading, classes in CLASSES.items()
        }
    return found


def of_class(rows: Sequence[Row]) -> dict[str, Any]:
    """Numbers of one class of rigs."""
    found: dict[str, Any] = {"rigs": len(rows)}
    found["lost"] = {name: sum(bool(row[f"{name}.lost"]) for row in rows) for name in NAMES}
    found["beyond"] = {name: sum(bool(row[f"{name}.beyond"]) for row in rows) for name in NAMES}
    return found | {measure: of_measure(rows, measure) for measure in MEASURES}


def over(ratios: Array) -> dict[str, Any]:
    """Median of ratios (rigs,) with its interval; what both lost is left out."""
    return middle(ratios.reshape(1, 1, -1))


def of_measure(rows: Sequence[Row], measure: str) -> dict[str, Any]:
    """Who wins by the largest or by the RMS error, and by how much; every rig is a draw of its own."""
    counted = np.ones(len(rows), bool)
    every = np.array([column(rows, name, measure) for name in NAMES]).reshape(len(NAMES), len(rows))
    errors = dict(zip(NAMES, every, strict=True))
    two, one = errors[TWO], errors[ONE]
    thesis = mean_ratio(thesis_ratios())
    with np.errstate(all="ignore"):
        ratio = two / one
        gains = {name: column(rows, f"gain_of_{name}", measure) for name in LEARNERS}
        return {
            "two_layer_wins": share(two < one, counted),
            "ratio": over(ratio),
            "near": share((ratio >= thesis) & (ratio <= 1 / thesis), counted),
            "beyond_thesis": share(ratio < thesis, counted),
            "best": {
                name: float(np.mean(every[:-1].argmin(axis=0) == i)) if len(rows) else None
                for i, name in enumerate(NAMES[:-1])  # the integral is no rival, it explains one
            },
            "to_pd": {name: over(errors[name] / errors["pd"]) for name in LEARNERS},
            "learning": {name: over(errors[name] / gains[name]) for name in LEARNERS},
            "random_to_zero": over(errors["two_layer_random"] / two),
            "to_integral": over(two / errors["integral"]),
            "integral_best": share(errors["integral"] < every[:-1].min(axis=0), counted),
            "random_to_integral": over(errors["two_layer_random"] / errors["integral"]),
        }
