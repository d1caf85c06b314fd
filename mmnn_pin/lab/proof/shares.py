"""Where the torque of a run came from: feedback, network, robust term."""

from __future__ import annotations

import numpy as np

from ...signals import Array

PARTS = ("feedback", "network", "robust")


def parts(torque: Array, psi_hat: Array, robust: Array) -> dict[str, Array]:
    """The torque taken apart, (N, p) each: `tau = feedback + network + robust` (3.39)."""
    return {"feedback": torque - psi_hat - robust, "network": psi_hat, "robust": robust}


def shares(torque: Array, psi_hat: Array, robust: Array) -> dict[str, Array]:
    """Share of every part in the torque, (p,) each: `sum part tau / sum tau^2`; they add up to 1.

    A part that works against the others has a share below 0. NaN where there is no torque.

    Args:
        torque: (N, p) applied torque [N, N m].
        psi_hat: (N, p) of it the network's.
        robust: (N, p) of it the robust term's.
    """
    total = (torque**2).sum(axis=0)
    return {name: _ratio((part * torque).sum(axis=0), total) for name, part in parts(torque, psi_hat, robust).items()}


def sizes(torque: Array, psi_hat: Array, robust: Array) -> dict[str, Array]:
    """RMS of every part over RMS of the torque, (p,) each; the network's is its learned share."""
    total = (torque**2).sum(axis=0)
    found = parts(torque, psi_hat, robust)
    return {name: np.sqrt(_ratio((part**2).sum(axis=0), total)) for name, part in found.items()}


def _ratio(value: Array, total: Array) -> Array:
    return np.where(total > 0, value / np.where(total > 0, total, 1.0), np.nan)
