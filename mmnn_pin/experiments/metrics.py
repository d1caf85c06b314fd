"""What a run is judged by: peak and RMS of every error, torque effort, learned share, effective gain."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..recording import Recording
from ..signals import Array

ERRORS = ("pose_error", "z", "e")


def metrics(recording: Recording, windows: Sequence[tuple[float, float]]) -> dict[str, float]:
    """Flat table of numbers in SI units, keyed `signal.label.statistic`.

    Statistics: `peak` (largest magnitude), `rms_a_b` over each window [a, b) that the run reached (nan otherwise);
    `effort` is the time integral of the squared motor torques [N^2 m^2 s]; `learned_share` the RMS of Psi_hat over the
    RMS of the applied torque (base and arm apart), `effective_gain` its mean.
    """
    time, result = recording.time, {}
    for name in ERRORS:
        if name not in recording:
            continue
        columns = as_columns(recording[name])
        for label, column in zip(recording.labels(name), columns.T, strict=True):
            result[f"{name}.{label}.peak"] = float(np.abs(column).max(initial=np.nan if not len(column) else 0.0))
            for start, end in windows:
                inside = (time >= start) & (time < end)
                result[f"{name}.{label}.rms_{start:g}_{end:g}"] = rms(column[inside])
    h = float(recording.meta["control_period"])
    result["effort"] = float(np.sum(as_columns(recording["motor_torque"]) ** 2) * h)
    for part, where in halves(recording).items():
        torque, psi_hat = (as_columns(recording[name])[:, where] for name in ("torque", "psi_hat"))
        total = rms(torque)
        result[f"learned_share.{part}"] = rms(psi_hat) / total if total > 0 else 0.0
        gain = as_columns(recording["effective_gain"])[:, where]
        result[f"effective_gain.{part}"] = float(gain.mean()) if gain.size else float("nan")
    if len(recording):
        result["energy_residual"] = float(np.abs(recording["energy_residual"]).max())
    return result


def halves(recording: Recording) -> dict[str, slice]:
    """Columns of the base and of the arm in signals of all p velocities."""
    base = len(recording.labels("z")) if "z" in recording else 0
    total = len(recording.labels("nu"))
    return {
        name: part for name, part in (("base", slice(0, base)), ("arm", slice(base, total))) if part.stop > part.start
    }


def as_columns(signal: Array) -> Array:
    """Signal as (N, size), also where a recording holds (N,)."""
    return signal if signal.ndim == 2 else signal[:, None]


def rms(values: Array) -> float:
    """Root of the mean square; nan for nothing."""
    return float(np.sqrt(np.mean(values**2))) if values.size else float("nan")
