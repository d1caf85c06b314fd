"""What the property checks found, as a table and for JSON."""

from __future__ import annotations

import math
from typing import Any

from ...model.checks.nonholonomy import RANK_TOLERANCE, Closure
from ...model.checks.properties import Report

SAMPLING = "positions uniform within limits (else +-pi, +-1 m), velocities standard normal; an estimate from inside"


def to_dict(report: Report) -> dict[str, Any]:
    """The report as the command line's JSON object; what is not finite is null."""
    tested, b = report.nonholonomic, report.bounds
    return {
        "robot": report.robot,
        "samples": report.samples,
        "seed": report.seed,
        "ok": report.passed,
        "properties": {
            name: {"worst": number(p.worst), "tolerance": p.tolerance, "pass": p.passed, "means": p.means}
            for name, p in report.properties.items()
        },
        "skipped": dict(report.skipped),
        "bounds": {"M_min": number(b.M_min), "M_max": number(b.M_max), "C_b": number(b.C_b), "sampling": SAMPLING},
        "nonholonomic": {
            "distribution": tested.pose.distribution if tested.pose else 0,
            "closure": tested.pose.closure if tested.pose else 0,
            "verdict": tested.verdict,
            "growth": list(tested.pose.growth) if tested.pose else [],
            "with_wheel_angles": None if tested.with_wheels is None else closure(tested.with_wheels),
            "rank_tolerance": RANK_TOLERANCE,
        },
    }


def closure(found: Closure) -> dict[str, Any]:
    """A closure for JSON."""
    return {
        "coordinates": found.coordinates,
        "distribution": found.distribution,
        "closure": found.closure,
        "growth": list(found.growth),
    }


def number(value: float) -> float | None:
    """Number for JSON: nothing where it is not finite."""
    return float(value) if math.isfinite(value) else None


def properties_text(report: Report) -> str:
    """The report for a terminal: one line per property, the bounds, the Frobenius test."""
    width = max(map(len, report.properties))
    lines = [f"robot {report.robot}: {report.samples} random states, seed {report.seed}", ""]
    lines.append(f"{'property':<{width}}  {'worst':>9}  {'allowed':>9}")
    for name, p in report.properties.items():
        allowed = f"{'>' if p.at_least else '<='} {p.tolerance:.0e}"
        lines.append(f"{name:<{width}}  {p.worst:>9.1e}  {allowed:>9}  {'ok  ' if p.passed else 'FAIL'}  {p.means}")
    lines += [f"{name:<{width}}  skipped: {why}" for name, why in report.skipped.items()]
    b = report.bounds
    lines += ["", f"reduced M: {b.M_min:.4g} I <= M <= {b.M_max:.4g} I (SI units);  ||C|| <= {b.C_b:.4g} ||nu||"]
    lines += [f"  sampling: {SAMPLING}", "", f"base: {report.nonholonomic.verdict}"]
    for where, found in (("pose", report.nonholonomic.pose), ("pose and wheels", report.nonholonomic.with_wheels)):
        if found is not None:
            ranks = " -> ".join(map(str, found.growth))
            lines.append(f"  {where}: rank {ranks} of {found.coordinates} by Lie brackets")
    failed = [name for name, p in report.properties.items() if not p.passed]
    lines += ["", f"FAILED: {', '.join(failed)}" if failed else "all properties hold"]
    return "\n".join(lines)
