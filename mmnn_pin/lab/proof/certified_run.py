"""A run beside its certificate: what is guaranteed, what was reached, the rates, the thesis's own bounds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ...disturbance.settings import MOST
from ...errors import ConfigError, InputError, UnknownName
from ...signals import Array
from .boxes import Box
from .certificate import Certificate, certify
from .certified_loop import CertifiedLoop, certified_loop, push_bound
from .printed import Printed, printed
from .proof import Proof, sentence
from .rate import Rate, rate_of
from .reached import Reached, reached, sizes_of


@dataclass(frozen=True, eq=False)
class CertifiedRun:
    """What can be told of one run.

    Attributes:
        certificate: What is guaranteed; None where the theorem does not apply.
        reached: What the run reached of it.
        rate: The condition on the learning rates; None without a learner.
        printed: The thesis's own bounds by network; empty where there are none.
        missing: What is left out, and why.
    """

    certificate: Certificate | None
    reached: Reached | None
    rate: Rate | None
    printed: dict[int, Printed]
    missing: dict[str, str]

    @property
    def holds(self) -> bool:
        """False only where a run left a region that is certified."""
        run = self.reached
        return self.certificate is None or run is None or not (self.certificate.holds and run.covered) or run.stays


def certified_run(
    proof: Proof, region: Mapping[str, float] | None = None, disturbance: Mapping[str, float] | None = None
) -> CertifiedRun:
    """Everything that can be told; what cannot is None, and `missing` says why.

    Args:
        proof: The run.
        region: Sizes `pose` [m], `arm` and `energy` [J] of the region to certify; None for the largest that is found.
        disturbance: Largest external force by velocity [N, N m], beside the pushes of the run.

    Raises:
        UnknownName: A size or a velocity that does not exist.
        ConfigError: A size that is missing or not positive, or a force that is negative or too large.
    """
    subject, missing = proof.subject, {}
    wanted, force = box_of(region, subject.layout.arm), forces(disturbance, subject.robot.velocity_names)
    certificate = run = rate = None
    bounds: dict[int, Printed] = {}
    try:
        loop = with_forces(certified_loop(subject), force)
        sizes = sizes_of(subject, loop)
        certificate = certify(loop, wanted, sizes.start)
        run = reached(subject, certificate, sizes)
    except InputError as error:
        missing["certificate"] = sentence(error)
    try:
        rate = rate_of(subject)
        if proof.has("ideal") and subject.networks is not None and isinstance(proof.ideal, dict):
            bounds = printed(subject, subject.networks, proof.ideal, push_bound(subject) + force)
    except InputError as error:
        missing["rate"] = sentence(error)
    return CertifiedRun(certificate, run, rate, bounds, missing)


def with_forces(loop: CertifiedLoop, force: Array) -> CertifiedLoop:
    """A loop with external forces of at most (p,) more [N, N m]."""
    return loop.disturbed(loop.disturbance + force) if force.any() else loop


def box_of(region: Mapping[str, float] | None, joints: int) -> Box | None:
    """The box that was asked for; errors as in `certified_run`."""
    if not region:
        return None
    needed = ("pose", "arm", "energy") if joints else ("pose", "energy")
    for name, size in region.items():
        if name not in needed:
            raise UnknownName("size of a region", name, needed, key="region")
        if not (np.isfinite(size) and size > 0):
            raise ConfigError(f"{name} = {size}", fix="use a finite number > 0", key="region")
    if missing := [name for name in needed if name not in region]:
        raise ConfigError(f"no {' and no '.join(missing)}", fix=f"give {', '.join(needed)}", key="region")
    return Box(region["pose"], region.get("arm", 0.0), region["energy"])


def forces(disturbance: Mapping[str, float] | None, names: Sequence[str]) -> Array:
    """(p,) forces by the names of their velocities; errors as in `certified_run`."""
    found = np.zeros(len(names))
    for name, force in (disturbance or {}).items():
        if name not in names:
            raise UnknownName("velocity", name, names, key="disturbance")
        if not 0 <= force <= MOST:
            raise ConfigError(f"{name} = {force}", fix=f"use a number from 0 to {MOST:.0e}", key="disturbance")
        found[list(names).index(name)] = force
    return found
