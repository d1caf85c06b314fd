"""The same rig again and again, and one number of it moved at a time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from mmnn_pin.signals import Array

from .compare import MEASURES, NAMES, Row, compare
from .rigs import Values, chapter5, robot_of, with_rig

OFFSET = np.radians(0.1)  # largest difference of the start from the reference between two repeats [rad]
# Numbers that are moved, from the calibrated rig: factors for friction and resolution, values for the others.
MOVED: dict[str, tuple[str, tuple[float, ...]]] = {
    "friction": ("dry friction, times the calibrated", (0.1, 0.3, 0.6, 1.0, 1.4)),
    "gap": ("backlash [mrad]", (0.0, 0.002, 0.005, 0.01, 0.02)),
    "resolution": ("step of the encoders [mrad]", (1e-4, 3e-4, 1e-3, 2e-3, 5e-3)),
    "rate": ("sample rate [Hz]", (125.0, 200.0, 400.0, 1000.0)),
}
SCALE = {"gap": 1e3, "resolution": 1e3}  # for the figure


def moved(values: Values, name: str, value: float) -> dict[str, Any]:
    """The calibrated numbers with one of them moved."""
    v = dict(values)
    if name == "friction":
        return v | {f"coulomb_{j}": value * v[f"coulomb_{j}"] for j in (1, 2)}
    return v | ({"period": 1.0 / value} if name == "rate" else {name: value})


def repeats(values: Values, count: int, stream: int) -> list[Row]:
    """Runs that differ in nothing but a start up to 0.1 deg beside the reference and the draw of random weights."""
    experiments = []
    for i in range(count):
        rng = np.random.default_rng([stream, i])
        again = {"offset": tuple(rng.uniform(-OFFSET, OFFSET, 2).tolist()), "seed": int(rng.integers(2**31))}
        experiments.append(with_rig(chapter5(), {**values, **again}))
    return compare([(e, robot_of(e)) for e in experiments], gains=False)


def column(rows: Sequence[Mapping[str, Any]], name: str, measure: str) -> Array:
    """Errors of a controller [deg], inf where it was lost."""
    return np.array([float(row[f"{name}.{measure}"]) for row in rows])


def spread(values: Array) -> dict[str, Any]:
    """Median and the middle 90 %; None for infinity."""
    found = [float(np.quantile(values, q, method="inverted_cdf")) for q in (0.5, 0.05, 0.95)]
    median, low, high = (x if np.isfinite(x) else None for x in found)
    return {"median": median, "middle_90": [low, high]}


def told(rows: Sequence[Row]) -> dict[str, Any]:
    """Spread of every controller's errors and of their ratios to one_layer, over the repeats of a rig."""
    found: dict[str, Any] = {"repeats": len(rows), "errors": {}, "ratios": {}}
    for measure in MEASURES:
        one = column(rows, "one_layer", measure)
        found["errors"][measure] = {name: spread(column(rows, name, measure)) for name in NAMES}
        with np.errstate(all="ignore"):
            ratios = {name: column(rows, name, measure) / one for name in NAMES if name != "one_layer"}
        found["ratios"][measure] = {
            name: {**spread(np.nan_to_num(x, nan=np.inf)), "below_1": float(np.mean(x < 1))}
            for name, x in ratios.items()
        }
    return found


def repeatability(rigs: Sequence[Values], count: int, say: Callable[[str], None]) -> list[dict[str, Any]]:
    """The calibrated rigs, each repeated."""
    found = [told(repeats(values, count, 51)) for values in rigs]
    say(f"{len(rigs)} rigs, {count} runs of each")
    return found


def sweep(values: Values, count: int, say: Callable[[str], None]) -> dict[str, list[dict[str, Any]]]:
    """Every number of `MOVED` alone, from the calibrated rig, with repeats at each of its values."""
    found = {
        name: [{"value": value, **told(repeats(moved(values, name, value), count, 52))} for value in tried]
        for name, (_, tried) in MOVED.items()
    }
    say("one number at a time")
    return found
