"""What `mmnn inspect` shows on a terminal: the base, its wheels, the arm, what is locked, and the findings."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

SHOWN = 12  # locked joints told one by one


def inspection_text(content: dict[str, Any]) -> str:
    """The tables, as text.

    Args:
        content: What `model.inspection.inspection_of` says.
    """
    parts = [head(content), wheels(content["base"]), arm(content["arm"]), locked(content["locked_at"])]
    told = [finding["text"] for finding in content["findings"]]
    parts.append("\n".join([f"findings ({len(told)})", *(f"  {text}" for text in told)]) if told else "no findings")
    return "\n\n".join(part for part in parts if part)


def refusal_text(content: dict[str, Any]) -> str:
    """What there is to say of a robot that was refused, beside the errors: what its base could be, and the rest.

    Args:
        content: What `model.inspection.refusal_of` says.
    """
    lines = []
    for candidate in (content["base"] or {}).get("candidates", ()):
        lines.append(f"candidate: {candidate['kind'].replace('_', ' ')}")
        lines += [f"  for: {text}" for text in candidate["for"]]
        lines += [f"  against: {text}" for text in candidate["against"]]
    lines += [f"wheel? {text}" for text in (content["base"] or {}).get("wheel_candidates", ())]
    lines += [finding["text"] for finding in content["findings"] if finding["severity"] != "error"]
    return "\n".join(lines)


def head(content: dict[str, Any]) -> str:
    """File, mass and base."""
    base = content["base"]
    lines = [("file", content["file"]), ("sha256", content["sha256"]), ("mass", f"{content['mass']:.4g} kg")]
    lines.append(("base", base["kind"].replace("_", " ")))
    if base["kind"] != "fixed":
        x, y, heading = base["frame"]
        frame = f"x {x:.4g} m, y {y:.4g} m, heading {math.degrees(heading):.4g} deg in the root link"
        lines += [("track", f"{base['track']:.4g} m"), ("control frame", frame)]
        lines.append(("floor", f"{base['floor']:.4g} m above the root link's origin"))
    for key in ("casters", "suspensions"):
        lines += [(key, ", ".join(base[key]))] if base[key] else []
    return "\n".join(f"{name:16}{value}" for name, value in lines)


def wheels(base: dict[str, Any]) -> str:
    """Drive wheels with radius, sign and place."""
    if not base["wheels"]:
        return ""
    rows = [("drive wheel", "radius [m]", "sign", "x [m]", "y [m]", "roller [deg]")]
    for wheel in base["wheels"]:
        roller = "-" if wheel["roller"] is None else f"{math.degrees(wheel['roller']):.4g}"
        numbers = (f"{wheel['radius']:.4g}", f"{wheel['sign']:+d}", f"{wheel['x']:.4g}", f"{wheel['y']:.4g}", roller)
        rows.append((wheel["joint"], *numbers))
    return table(rows)


def arm(content: dict[str, Any]) -> str:
    """Arm joints with limits, and what follows them."""
    if not content["joints"]:
        return "no arm"
    rows = [("arm joint", "lower", "upper", "effort")]
    for name in content["joints"]:
        limits = content["limits"][name]
        told = (limits[key] for key in ("lower", "upper", "effort"))
        rows.append((name, *("-" if limit is None else f"{limit:.4g}" for limit in told)))
    slaves = [
        f"{name} follows: {slave['multiplier']:.4g} {slave['master']} {slave['offset']:+.4g}"
        for name, slave in content["slaves"].items()
    ]
    return "\n".join([table(rows), "angles in rad, travels in m, efforts in N m or N; - for no limit", *slaves])


def locked(content: dict[str, Any]) -> str:
    """Joints that stand still, by reason."""
    return "\n\n".join(locked_for(content))


def locked_for(content: dict[str, Any]) -> Iterator[str]:
    """One table per reason; long ones are cut."""
    for why in dict.fromkeys(entry["why"] for entry in content.values()):
        names = {name: entry["position"] for name, entry in content.items() if entry["why"] == why}
        rows = [("locked joint", "at"), *((name, f"{at:.4g}") for name, at in list(names.items())[:SHOWN])]
        more = f"\nand {len(names) - SHOWN} more" if len(names) > SHOWN else ""
        yield f"{table(rows)}{more}\n{why}"


def table(rows: Sequence[Sequence[str]]) -> str:
    """Rows in columns, the first one to the left, the others to the right, a line under the heading."""
    rows = [[" ".join(cell.split()) for cell in row] for row in rows]  # a name may hold a line break
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = []
    for first, *others in rows:
        numbers = (cell.rjust(width) for cell, width in zip(others, widths[1:], strict=True))
        lines.append("  ".join([first.ljust(widths[0]), *numbers]))
    return "\n".join([lines[0], "-" * len(lines[0]), *lines[1:]])
