"""What is told of how a robot was understood: findings with stable codes, beside those of the audit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from mmnn_pin.model.arm import Arm

from ..urdf.finding import AuditError, one_line
from ..urdf.parsing import Finding, Joint
from ..urdf.shapes import AtRest
from .base import Base
from .evidence import Evidence
from .wheels import HUB, Candidate

LARGE = 2.0  # [m]; no wheel of a robot is larger
SAME_RADIUS = 0.01  # radii that differ by more than this fraction are told
OFF_FLOOR = 0.02  # wheels further than this fraction of their radius from the footprint are told

# Severity by code; docs/urdf-audit.md tells each with its reason.
CODES = {
    # refused, with the candidates or the machine's name
    "base-undecided": "error",
    "base-unsupported": "error",
    "robot": "error",
    # the base
    "base-evidence": "note",
    "base-roller": "warning",
    "base-omni": "note",
    "base-pushed": "warning",
    "base-sides": "warning",
    "base-radius": "warning",
    "base-hub-height": "warning",
    "base-size": "strict",
    "base-floor": "warning",
    "base-welded": "warning",
    # the arm and the rest
    "arm-locked": "note",
    "welded": "warning",
    "pinocchio": "warning",
    "overrides": "note",
}


def remark(rest: AtRest, code: str, line: int, element: str, what: str, why: str = "", fix: str = "") -> Finding:
    """A finding about what was understood, of a code in `CODES`."""
    severity = "warning" if CODES[code] == "strict" else CODES[code]
    return Finding(severity, code, str(rest.document.path), line, element, what, why, fix)


def settled(audited: Sequence[Finding], findings: Sequence[Finding], strict: bool) -> tuple[Finding, ...]:
    """The audit's findings and those of the understanding, if strictness makes an error of none.

    Raises:
        AuditError: It does.
    """
    told = [replace(f, severity="error" if strict and CODES[f.code] == "strict" else f.severity) for f in findings]
    if any(f.severity == "error" for f in told):
        raise AuditError([*audited, *told])
    return (*audited, *told)


def remarks(rest: AtRest, base: Base, wheels: Sequence[Candidate]) -> list[Finding]:
    """Warnings about radii that are odd, differ or are not measured, and a floor that is not the root's.

    Args:
        rest: The robot at rest.
        base: Its base.
        wheels: Its drive wheels, and maybe others.
    """
    found = []
    blind = [c for c in wheels if c.shape == HUB and c.joint.name in [w.joint for w in base.wheels]]
    if blind:
        told = ", ".join(f"'{c.joint.name}' {c.radius:.4g} m" for c in blind)
        text, why = f"radii assumed from the height of the hubs above the floor: {told}", "no shape of them can be read"
        fix = "--radius, or --package-dir where their meshes are"
        found.append(remark(rest, "base-hub-height", blind[0].joint.line, "base", text, why, fix))
    sides = [side if side in w.joint.lower() else "" for w, side in zip(base.wheels, ("right", "left"), strict=False)]
    if base.kind == "differential_drive" and all(sides):
        text = f"'{base.wheels[0].joint}' is on the left: does the robot drive along -x?"
        line = rest.document.joints[base.wheels[0].joint].line
        why, fix = "names decide nothing: forward is the rolling direction nearer the root link's x", "check it"
        found.append(remark(rest, "base-sides", line, "base", text, why, fix))
    large = [w for w in base.wheels if w.radius > LARGE]
    if large:
        line, text = (
            rest.document.joints[large[0].joint].line,
            f"wheel '{large[0].joint}' has a radius of {large[0].radius:.4g} m",
        )
        why = "is its mesh in millimetres? taken as it is"
        found.append(remark(rest, "base-size", line, "base", text, why, "give the mesh a scale of 0.001"))
    radii = [wheel.radius for wheel in base.wheels]
    if radii and max(radii) - min(radii) > SAME_RADIUS * max(radii):
        line = rest.document.joints[base.wheels[0].joint].line
        told = ", ".join(f"'{w.joint}' {w.radius:.4g} m" for w in base.wheels)
        text, why = f"the wheels' radii differ: {told}", "they are used as they are"
        found.append(remark(rest, "base-radius", line, "base", text, why, "--radius if they should be alike"))
    if base.wheels and rest.is_footprint and abs(base.floor) > OFF_FLOOR * max(radii):
        where = "below" if base.floor < 0 else "above"
        line = rest.document.joints[base.wheels[0].joint].line
        text = f"the wheels touch the ground {abs(base.floor):.3g} m {where} the root link '{rest.document.root_link}'"
        found.append(remark(rest, "base-floor", line, "base", text, "the floor is taken where the wheels are"))
    return found


def welded_note(rest: AtRest, welded: Sequence[Joint]) -> list[Finding]:
    """Wheels beside the drive wheels that are welded on."""
    if not welded:
        return []
    text = f"wheels on the floor are welded on: {', '.join(joint.name for joint in welded)}"
    why, fix = "taken as sliding without friction", "make their joints continuous if they turn"
    return [remark(rest, "base-welded", welded[0].line, "base", text, why, fix)]


def evidence_note(rest: AtRest, cited: list[Evidence]) -> Finding:
    """What made four parallel wheels mecanum wheels."""
    texts = list(dict.fromkeys(piece.text for piece in cited))
    more = f" and {len(texts) - 4} more" if len(texts) > 4 else ""
    return remark(rest, "base-evidence", cited[0].line, "base", f"taken as holonomic: {'; '.join(texts[:4])}{more}")


def arm_notes(rest: AtRest, arm: Arm) -> list[Finding]:
    """What was locked without being asked to, one note per reason."""
    notes = []
    for reason in dict.fromkeys(arm.reasons.values()):
        names = [name for name, why in arm.reasons.items() if why == reason]
        if "short branch" in reason:
            text = f"locked: {', '.join(names)}"
            line = rest.document.joints[names[0]].line
            notes.append(remark(rest, "arm-locked", line, "arm", text, reason, "--free JOINT moves one, all all"))
    return notes


def weld_notes(rest: AtRest, names: Sequence[str]) -> list[Finding]:
    """Planar and floating joints that were welded."""
    why, fix = "the loader places the robot in the world itself", "none needed, unless it should move in the arm"
    text = "a planar or floating joint is taken as fixed"
    lines = {name: rest.document.joints[name].line for name in names}
    return [remark(rest, "welded", lines[n], f"joint '{n}'", text, why, fix) for n in names]


def printed_notes(rest: AtRest, printed: str) -> list[Finding]:
    """What Pinocchio's parser printed about a file that it accepts."""
    return [remark(rest, "pinocchio", 1, "", f"Pinocchio's parser says: {one_line(printed)}")] if printed else []
