"""The findings of the audit about a file: `file:line: severity: element: what: why: fix [code]`, one line each."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from lxml import etree

from mmnn_pin.errors import FEW, RobotError, few, printable, short

# Severity by code; docs/reference/urdf-audit.md gives the reason of each. `strict`: a warning, with --strict an error.
CODES = {
    # the file
    "file": "error",
    "not-xml": "error",
    "truncated": "error",
    "encoding": "error",
    "doctype": "error",
    "not-urdf": "error",
    "xacro": "error",
    "expanded": "note",
    "color": "warning",
    "xacro-package": "warning",
    "xacro-prefix": "warning",
    "namespace": "warning",
    "version": "error",
    "too-many": "error",
    # tags
    "misspelt-tag": "error",
    "misspelt-shape": "warning",
    "misspelt-attribute": "error",
    "misplaced-tag": "warning",
    "repeated-tag": "warning",
    "duplicate-material": "error",
    # numbers
    "number": "error",
    "vector-length": "error",
    "missing-value": "error",
    "transposed-inertia": "warning",
    "negative-size": "error",
    "zero-size": "warning",
    "no-shape": "warning",
    # names and tree
    "empty-name": "error",
    "duplicate-name": "error",
    "no-links": "error",
    "missing-link": "error",
    "two-parents": "error",
    "two-roots": "error",
    "loop": "error",
    "gazebo-loop": "warning",
    # joints
    "joint-type": "error",
    "zero-axis": "error",
    "axis-not-unit": "warning",
    "no-axis": "note",
    "no-limit": "error",
    "limit-order": "error",
    "limit-negative": "warning",
    "limit-empty": "warning",
    "limit-huge": "warning",
    "zero-effort": "warning",
    "zero-velocity": "note",
    "no-effort": "warning",
    "negative-friction": "error",
    "mimic-ghost": "error",
    "mimic-self": "error",
    "mimic-circle": "error",
    # bodies
    "negative-mass": "error",
    "zero-mass": "error",
    "tiny-mass": "error",
    "inertia-not-positive": "error",
    "zero-inertia": "error",
    "inertia-triangle": "strict",
    "no-inertial": "warning",
    # plausibility
    "millimetres": "strict",
    "limit-degrees": "strict",
    "rpy-degrees": "strict",
    "odd-mass": "strict",
    "odd-inertia": "strict",
    # meshes
    "mesh-scale": "warning",
    "mesh-missing": "warning",
    "mesh-remote": "warning",
    "mesh-corrupt": "warning",
    "mesh-outside": "warning",
}


@dataclass(frozen=True)
class Finding:
    """One thing to know about a file."""

    severity: str  # `error`, `warning` or `note`
    code: str  # stable name of the check, a key of `CODES`
    file: str  # the file
    line: int  # line in the file, counted from 1
    element: str  # link, joint or tag it is about, in words; empty for the file as a whole
    message: str  # what is wrong
    why: str = ""  # what it would lead to, or what was assumed
    fix: str = ""  # what to do
    joint: str = ""  # the joint that it matters to; where that joint stands still, an error is a warning

    @property
    def what(self) -> str:
        """Element and message."""
        return f"{self.element}: {self.message}" if self.element else self.message

    def __str__(self) -> str:
        text = ": ".join(part for part in (self.what, self.why, self.fix) if part)
        return f"{self.file}:{self.line}: {self.severity}: {text} [{self.code}]"


def finding(
    code: str,
    at: etree._Element | int,
    message: str,
    why: str = "",
    fix: str = "",
    of: str | None = None,
    joint: str | None = None,
) -> Finding:
    """A finding of a check; the file is filled in at the end.

    Args:
        code: A key of `CODES`.
        at: The element it is about, or a line.
        message: What is wrong.
        why: What it would lead to, or what was assumed.
        fix: What to do.
        of: What it is about, in words; from the element when None.
        joint: The joint that it matters to, None for all.
    """
    severity = "warning" if CODES[code] == "strict" else CODES[code]
    line, about = (at, "") if isinstance(at, int) else (at.sourceline, label(at))
    about, message = (short(printable(text)) for text in (about if of is None else of, message))
    return Finding(severity, code, "", line, about, message, why, fix, joint or "")


def settle(findings: Sequence[Finding], path: Path, strict: bool) -> tuple[Finding, ...]:
    """Findings in the order of the file, with its name; strictness makes errors of implausible things."""
    placed = [
        replace(f, file=str(path), severity="error" if strict and CODES[f.code] == "strict" else f.severity)
        for f in findings
    ]
    return tuple(sorted(placed, key=lambda f: f.line))


def excused(
    findings: Sequence[Finding],
    still: Iterable[str],
    arm: Iterable[str] = (),
    alone: bool = False,
    rolls: Iterable[str] = (),
) -> tuple[Finding, ...]:
    """Findings where what only matters to joints that stand still is a warning.

    Args:
        findings: All of them.
        still: Joints that stand still.
        arm: Joints that could.
        alone: Whether nothing else moves.
        rolls: Joints that turn only as the base drives, whose inertia may be 0: the base has some.

    Raises:
        AuditError: An error is left.
    """
    standing, lockable, rolling = set(still), set(arm), set(rolls)

    def judge(f: Finding) -> Finding:
        if f.code == "zero-inertia" and f.joint in rolling:
            return replace(f, severity="warning", why="taken as it is: it turns only as the base drives")
        if f.severity != "error" or f.joint not in standing | lockable:
            return f
        if f.joint in standing:
            return replace(f, severity="warning", why="taken as it is: the joint stands still")
        return replace(f, fix=f"{f.fix}, or --lock {f.joint}")

    judged = gathered(tuple(map(judge, findings)), None if alone else lockable)
    if any(f.severity == "error" for f in judged):
        raise AuditError(judged)
    return judged


def gathered(findings: tuple[Finding, ...], lockable: set[str] | None) -> tuple[Finding, ...]:
    """Findings with the errors about bodies without mass in one, where there are several.

    Args:
        findings: All of them, in the order of the file.
        lockable: Joints that could stand still while others move; None for all.
    """
    empty = [f for f in findings if f.code == "zero-mass" and f.severity == "error"]
    if len(empty) < 2:
        return findings
    joints = [f.joint for f in empty]
    those = few([f"'{name}'" for name in joints])
    what = f"each of {len(joints)} bodies that joints move has no mass, nor has what hangs on it: those of {those}"
    fix = "give each an <inertial>, or make the joints fixed"
    if lockable is not None and lockable.issuperset(joints):
        many = len(joints) > FEW
        fix += ", or --lock JOINT each" if many else ", or " + " ".join(f"--lock {name}" for name in joints)
    gathered_one = replace(empty[0], element="", message=what, fix=fix, joint="")
    return tuple(gathered_one if f is empty[0] else f for f in findings if f not in empty[1:])


class AuditError(RobotError):
    """A URDF that the audit refuses.

    Args:
        findings: Everything found; what, why, fix, file and line are those of the first error.

    Attributes:
        findings: Everything found.
    """

    def __init__(self, findings: Sequence[Finding]) -> None:
        self.findings = tuple(findings)
        first = self.errors[0]
        super().__init__(first.what, why=first.why, fix=first.fix, file=Path(first.file), line=first.line)

    @property
    def errors(self) -> list[Finding]:
        """The errors among the findings."""
        return [f for f in self.findings if f.severity == "error"]

    def __str__(self) -> str:
        others = [f for f in self.findings if f.severity != "error"]
        return "\n".join(str(f) for f in [*self.errors, *others])


def label(element: etree._Element) -> str:
    """The link, joint or other child of the root that an element belongs to, in words."""
    parent = element.getparent()
    while parent is not None and parent.getparent() is not None:
        element, parent = parent, parent.getparent()
    name = element.get("name")
    return f"<{element.tag}>" if name is None else f"{element.tag} '{name}'"
