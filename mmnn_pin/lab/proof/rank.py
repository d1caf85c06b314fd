"""How many of a network's units count: effective ranks, and how well its activations were excited."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...signals import Array


def effective_rank(matrix: Array) -> float:
    """Effective rank after Roy and Vetterli (2007): the exponential of the entropy of the singular values.

    From 1 for a matrix of rank one to n for n equal singular values; 0 for a zero matrix.
    """
    singular = np.linalg.svd(matrix, compute_uv=False)
    if not singular.size or singular[0] == 0:
        return 0.0
    share = singular / singular.sum()
    share = share[share > 0]
    return float(np.exp(-(share * np.log(share)).sum()))


@dataclass(frozen=True, eq=False)
class Excitation:
    """How well the activations of one network were excited.

    Attributes:
        smallest: Smallest eigenvalue of the Gram matrix `mean sigma sigma'`: weights along its direction leave no trace
            in the output, however long one learns.
        largest: Its largest eigenvalue.
        directions: Eigenvalues above a share of the largest: directions in which weights can be told from one another.
        units: Number of units.
        rank: Effective rank of the activations (N, h).
        singular: Their singular values, largest first.
        visible: Share of the largest eigenvalue above which a direction counts.
    """

    smallest: float
    largest: float
    directions: int
    units: int
    rank: float
    singular: Array
    visible: float


def excitation(activations: Array, visible: float = 1e-6) -> Excitation:
    """Excitation of activations (N, h) over the visited set."""
    singular = np.linalg.svd(activations, compute_uv=False)
    values = np.pad(singular, (0, activations.shape[1] - len(singular))) ** 2 / len(activations)
    return Excitation(
        smallest=float(values[-1]),
        largest=float(values[0]),
        directions=int((values > visible * values[0]).sum()),
        units=len(values),
        rank=effective_rank(activations),
        singular=np.asarray(singular, float),
        visible=visible,
    )
