"""One proof per recording: figures and pages that show parts of it share what was computed."""

from __future__ import annotations

from collections.abc import Mapping
from weakref import WeakKeyDictionary

from ....errors import InputError
from ....recording.recording import Recording
from ...proof.proof import Proof

BUDGET = 5_000  # evaluations of the dynamics for one of several runs: a fraction of a second
PROOFS: WeakKeyDictionary[Recording, Proof] = WeakKeyDictionary()


def keep(proof: Proof) -> None:
    """Remember a proof for the figures of its recording."""
    PROOFS[proof.subject.recording] = proof


def proof_of(recording: Recording) -> Proof:
    """The proof of a recording; errors as of `Proof`."""
    if recording not in PROOFS:
        PROOFS[recording] = Proof(recording, budget=BUDGET)
    return PROOFS[recording]


def proofs_with(recordings: Mapping[str, Recording], part: str) -> tuple[dict[str, Proof], list[str]]:
    """The proofs that have a part, by name, and why the others have none."""
    found, reasons = {}, []
    for name, recording in recordings.items():
        if not len(recording):
            continue
        try:
            proof = proof_of(recording)
            getattr(proof, part)
            found[name] = proof
        except InputError as error:
            reasons.append(f"{name}: {' '.join(str(error).split())}")
    return found, reasons
