"""Fraction of variance unexplained, what a run's Psi_hat is judged by."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from ...signals import Array

START = 0.5  # [s] of a run that do not count: the transient
FLAT = 1e-9  # spread of Psi, relative to its size, below which it has no variance to explain


def fvu(psi: Array, psi_hat: Array) -> Array:
    """Fraction of variance unexplained of every component, `sum (Psi - Psi_hat)^2 / sum (Psi - mean Psi)^2`, (p,).

    0 is perfect; the best constant has 1; saying nothing at all has `1 + mean(Psi)^2 / var(Psi)`; there is no upper
    bound. NaN where Psi does not vary, or without samples.

    Args:
        psi: (N, p) the truth [N, N m].
        psi_hat: (N, p) what is said of it.
    """
    if not len(psi):
        return np.full(psi.shape[1], np.nan)
    error = ((psi - psi_hat) ** 2).sum(axis=0)
    variance = ((psi - psi.mean(axis=0)) ** 2).sum(axis=0)
    flat = variance <= len(psi) * (FLAT * np.abs(psi).max(axis=0)) ** 2
    return np.where(flat, np.nan, error / np.where(flat, 1.0, variance))


def windows(time: Array, count: int) -> Array:
    """Edges (count + 1,) of equal windows from `START` to the end of a run [s]; empty for a run that ends before."""
    period = time[1] - time[0]
    end = time[-1] + period
    return np.linspace(START, end, count + 1) if end > START + period else np.zeros(0)


def error_in(edges: Array, time: Array, psi: Array, psi_hat: Array) -> Array:
    """Mean squared error in every window over the variance of Psi in all of them together, (count, p).

    Unlike `fvu_in` it does not explode where Psi hardly varies; the mean over equal windows is the FVU of the whole.
    """
    places = np.searchsorted(time, edges - 1e-9)
    whole = slice(places[0], places[-1])
    variance = fvu(psi[whole], psi[whole] + 1.0)  # 1 / variance, NaN where Psi does not vary
    return np.array([((psi[a:b] - psi_hat[a:b]) ** 2).mean(axis=0) * variance for a, b in pairwise(places)])


def fvu_in(edges: Array, time: Array, psi: Array, psi_hat: Array) -> Array:
    """FVU in every window [a, b), (count, p); see `fvu`."""
    places = np.searchsorted(time, edges - 1e-9)
    return np.array([fvu(psi[a:b], psi_hat[a:b]) for a, b in pairwise(places)])


def worst(values: Array) -> float:
    """The worst component, which counts; NaN where none has a number."""
    return float(np.nanmax(values)) if np.isfinite(values).any() else float("nan")
