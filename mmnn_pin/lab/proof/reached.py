"""What a run reached, beside what is certified of it: the size of its errors at every sample, and its weights."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...signals import Array
from .boxes import BoolArray, Box
from .certificate import Certificate
from .certified_loop import CertifiedLoop
from .errors import motion_energy
from .subject import Subject


@dataclass(frozen=True, eq=False)
class Sizes:
    """The errors of a run as boxes measure them, (N,) each.

    Attributes:
        time: [s].
        pose: Size of the pose error [m].
        arm: Size of the arm errors.
        energy: s' M s / 2 [J].
    """

    time: Array
    pose: Array
    arm: Array
    energy: Array

    @property
    def start(self) -> Box:
        """The smallest box around the first sample."""
        return Box(float(self.pose[0]), float(self.arm[0]), float(self.energy[0]))

    def inside(self, box: Box) -> BoolArray:
        """Which samples are in a box, (N,) bool."""
        return box.holds(self.pose, self.arm, self.energy)


def sizes_of(subject: Subject, loop: CertifiedLoop) -> Sizes:
    """The sizes along a run."""
    rows, where = subject.truth(subject.rows), subject.layout.where
    e = rows[:, where("e")]
    arm = np.sqrt(np.maximum(np.einsum("ni,ij,nj->n", e, loop.samples.arm_metric, e), 0.0))
    pose = loop.pose.size(rows[:, where("pose_error")])
    return Sizes(subject.signal("time")[:, 0], pose, arm, motion_energy(subject, rows))


@dataclass(frozen=True, eq=False)
class Reached:
    """A run against its certificate.

    Attributes:
        starts: Whether it starts in the region.
        enters: When it is first inside of the region [s]; nan if never.
        stays: Whether it never leaves the region once inside; where it is `covered`, False is a violation.
        covered: Whether its recorded weights keep within their bounds: a run that starts outside of the region may
            carry larger ones into it, and then nothing is guaranteed.
        settles: When it is inside of the bound for good [s]; nan if never (the run may have been too short).
        largest: Largest errors once inside of the region.
        last: Largest errors over the last half of the run.
        weights: Network to largest norm of W and V that were recorded.
    """

    starts: bool
    enters: float
    stays: bool
    covered: bool
    settles: float
    largest: Box
    last: Box
    weights: dict[int, tuple[float, float]]


def reached(subject: Subject, certificate: Certificate, sizes: Sizes) -> Reached:
    """What a run reached of what is certified."""
    inside, settled = sizes.inside(certificate.region.box), sizes.inside(certificate.bound.box)
    first = int(np.argmax(inside)) if inside.any() else len(inside)
    out = np.flatnonzero(~settled)
    after = 0 if not len(out) else int(out[-1]) + 1
    nan, times, half = float("nan"), sizes.time, len(sizes.time) // 2
    names = ("pose", "arm", "energy")
    largest = [float(getattr(sizes, name)[first:].max(initial=0.0)) for name in names]
    last = [float(getattr(sizes, name)[half:].max()) for name in names]
    weights = subject.recording.weights
    networks = certificate.boxes.networks
    found = {i: (largest_norm(weights.get(f"W{i}")), largest_norm(weights.get(f"V{i}"))) for i in networks}
    return Reached(
        starts=bool(inside[0]),
        enters=float(times[first]) if first < len(times) else nan,
        stays=bool(inside[first:].all()),
        covered=all(
            W <= (1 + 1e-9) * networks[i].W and (V <= (1 + 1e-9) * networks[i].V or not networks[i].V)
            for i, (W, V) in found.items()
        ),
        settles=float(times[after]) if after < len(times) else nan,
        largest=Box(*largest),
        last=Box(*last),
        weights=found,
    )


def largest_norm(snapshots: Array | None) -> float:
    """Largest norm of weights (k, ...) that were recorded; 0 without any."""
    return 0.0 if snapshots is None else float(np.sqrt((snapshots**2).sum(axis=(1, 2))).max(initial=0.0))
