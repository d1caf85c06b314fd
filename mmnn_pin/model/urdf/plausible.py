"""Sizes and angles that are possible but hardly meant: millimetres, degrees."""

from __future__ import annotations

import math
from collections.abc import Iterator

from lxml import etree

from .finding import Finding, finding
from .reading import Own, largest, number

LONG = 10.0  # [m]; no joint of a robot for a laboratory is further from the next, no part of it larger
FULL_TURN = 2 * math.pi + 0.01  # [rad]
TWO_TURNS, DEGREES = 4 * math.pi, 720.0  # a limit between the two is suspect; beyond it is meant as none
LENGTHS = {"origin": "xyz", "cylinder": "length", "sphere": "radius", "box": "size"}


def millimetres(own: Own) -> Iterator[Finding]:
    """Lengths of more than `LONG`: one finding for the whole file, at the first of them."""
    long: list[tuple[etree._Element, str]] = []
    for tag, key in LENGTHS.items():
        long += [(e, key) for e in own[tag] if largest(e.get(key)) > LONG]
    if long:
        element, key = min(long, key=lambda place: place[0].sourceline)
        more = f" (and {len(long) - 1} more)" if len(long) > 1 else ""
        what = f"{key} of <{element.tag}> is '{element.get(key)}' m{more}"
        yield finding("millimetres", element, what, "is the file in millimetres? taken as metres", "give metres")


def degrees(own: Own) -> Iterator[Finding]:
    """Limits and roll, pitch, yaw that look like degrees: of limits each, of angles one finding for the file."""
    for limit in own["limit"]:
        most = max(abs(number(limit, key, 0.0)) for key in ("lower", "upper"))
        if limit.getparent().get("type") == "revolute" and TWO_TURNS < most <= DEGREES:
            what = f"limit of {most:g} rad is {most / (2 * math.pi):.3g} turns"
            yield finding("limit-degrees", limit, what, "is it in degrees? taken as radians", "give radians")
    turned = [o for o in own["origin"] if largest(o.get("rpy")) > FULL_TURN]
    if turned:
        first = min(turned, key=lambda origin: origin.sourceline)
        more = f" (and so in {len(turned) - 1} more)" if len(turned) > 1 else ""
        what = f"rpy '{first.get('rpy')}' is more than a full turn{more}"
        yield finding("rpy-degrees", first, what, "is it in degrees? taken as radians", "give radians")
