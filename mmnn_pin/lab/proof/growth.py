"""When and why a Lyapunov function grows: which term is the largest where it does, and the spans of most growth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .lyapunov import Lyapunov

SPANS = 3


@dataclass(frozen=True)
class Span:
    """A stretch of time in which V grows without a break.

    Attributes:
        start: [s].
        end: [s].
        rise: By how much V grows.
        why: Term with the largest positive sum over it.
    """

    start: float
    end: float
    rise: float
    why: str


@dataclass(frozen=True)
class Growth:
    """When and why V grows.

    Attributes:
        samples: Share of the control periods in which it does.
        rise: Sum of its growth.
        fall: Sum of its decrease, a number >= 0.
        why: Term to the share of the growing periods in which it is the largest, largest first.
        work: Term to its sum over the run: what it adds to V.
        spans: Those of most growth, largest first.
    """

    samples: float
    rise: float
    fall: float
    why: dict[str, float]
    work: dict[str, float]
    spans: tuple[Span, ...]


def growth(v: Lyapunov) -> Growth:
    """When and why V grows along a run; over the samples that were looked at, each standing for those it skips."""
    stride = (v.time[1] - v.time[0]) if len(v.time) > 1 else v.period
    change, names = v.measured * stride, list(v.terms)
    table = np.array([v.terms[name] for name in names]) * stride
    grows = change > 0
    largest = table[:, grows].argmax(axis=0)
    counts = {name: float((largest == i).mean()) for i, name in enumerate(names)} if grows.any() else {}
    why = {name: share for name, share in sorted(counts.items(), key=lambda item: -item[1]) if share}
    edges = np.flatnonzero(np.diff(np.concatenate(([0], grows.astype(int), [0]))))
    found = [
        Span(
            float(v.time[a]),
            float(v.time[b - 1] + stride),
            float(change[a:b].sum()),
            names[int(table[:, a:b].sum(axis=1).argmax())],
        )
        for a, b in zip(edges[::2], edges[1::2], strict=True)
    ]
    return Growth(
        samples=float(grows.mean()),
        rise=float(change[grows].sum()),
        fall=float(-change[~grows].sum()),
        why=why,
        work=dict(zip(names, table.sum(axis=1).tolist(), strict=True)),
        spans=tuple(sorted(found, key=lambda span: -span.rise)[:SPANS]),
    )
