"""The robots of the runs: what was understood, what the audit found, whether the proof's properties hold."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ....model.checks.properties import check_properties
from ....model.inspection import inspection_of
from ....recording.recording import Recording, recorded_robot
from ..inspection import arm, head, locked, wheels
from ..properties import properties_text

SAMPLES = 20  # random states of the property checks
SEED = 0


@dataclass(frozen=True)
class About:
    """A robot.

    Attributes:
        name: Its name.
        understood: Base, wheels, arm and what is locked, as text.
        findings: Those of the audit, with `severity` and `text`.
        checks: The property checks, as text.
        ok: Whether all properties hold.
    """

    name: str
    understood: str
    findings: tuple[dict[str, Any], ...]
    checks: str
    ok: bool

    @property
    def counts(self) -> str:
        """How many warnings and notes there are, in words."""
        numbers = {kind: sum(f["severity"] == kind for f in self.findings) for kind in ("error", "warning", "note")}
        told = [f"{n} {kind}{'s' * (n != 1)}" for kind, n in numbers.items() if n]
        return ", ".join(told) or "nothing to remark"


def robots_of(recordings: Mapping[str, Recording]) -> list[About]:
    """The different robots of some runs.

    Raises:
        InputError: The robot of a run cannot be built.
    """
    found: dict[str, About] = {}
    for recording in recordings.values():
        facts = (recording.meta.get(key) for key in ("urdf_sha256", "overrides", "mass_factors", "viscous"))
        key = repr(list(facts))
        if key not in found:
            found[key] = about(recording)
    return list(found.values())


def about(recording: Recording, samples: int = SAMPLES) -> About:
    """The robot of a run."""
    robot = recorded_robot(recording)
    told = inspection_of(robot) | {"file": robot.path.name, "sha256": recording.meta["urdf_sha256"]}
    parts = [head(told), wheels(told["base"]), arm(told["arm"]), locked(told["locked_at"])]
    report = check_properties(robot, samples, SEED)
    findings = tuple(f | {"text": f["text"].replace(str(robot.path), robot.path.name)} for f in told["findings"])
    understood = "\n\n".join(part for part in parts if part)
    return About(robot.name, understood, findings, properties_text(report), report.passed)
