"""A run beside its certificate: what is guaranteed, what was reached, the rates, the thesis's own bounds."""

from __future__ import annotations

from dataclasses import dataclass

from ..errors import InputError
from .certificate import Certificate, certify
from .certified_loop import certified_loop, push_bound
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


def certified_run(proof: Proof) -> CertifiedRun:
    """Everything that can be told; what cannot is None, and `missing` says why."""
    subject, missing = proof.subject, {}
    certificate = run = rate = None
    bounds: dict[int, Printed] = {}
    try:
        loop = certified_loop(subject)
        sizes = sizes_of(subject, loop)
        certificate = certify(loop, start=sizes.start)
        run = reached(subject, certificate, sizes)
    except InputError as error:
        missing["certificate"] = sentence(error)
    try:
        rate = rate_of(subject)
        if proof.has("ideal") and subject.networks is not None and isinstance(proof.ideal, dict):
            bounds = printed(subject, subject.networks, proof.ideal, push_bound(subject))
    except InputError as error:
        missing["rate"] = sentence(error)
    return CertifiedRun(certificate, run, rate, bounds, missing)
