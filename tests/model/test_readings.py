"""Robots of drawn structure: what is understood of them is true, marked as a doubt, or asked with the truth offered."""

from __future__ import annotations

import random
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from drawn import KINDS_MADE, Made, Pick, made_by, polar, shuffled
from hypothesis import given, settings
from hypothesis import strategies as st

from mmnn_pin.errors import InputError
from mmnn_pin.model.base import KINDS
from mmnn_pin.model.base.overrides import ARMS, FORWARD, Overrides
from mmnn_pin.model.base.steered import SteeredBase
from mmnn_pin.model.base.understanding import Roles, understand
from mmnn_pin.model.urdf.reading import parse

LISTS = ("wheels", "steer", "hitch")
OPTION = re.compile(r"--(base|wheels|radius|steer|hitch|lock|free|forward) ([\w.,-]*\w)")


# -- what is understood ------------------------------------------------------------------------------------------------


def outcome(text: str, said: Mapping[str, Any]) -> Roles | InputError:
    """What is understood, or the one error that the loader may raise."""
    try:
        return understand(parse(text.encode(), "made.urdf"), Overrides(**said))
    except InputError as error:
        assert "\n" not in str(error)
        return error


def is_true(found: Roles | InputError, made: Made) -> bool:
    return base_is_true(found, made) and {*found.arm.joints} - made.drums == made.arm


def base_is_true(found: Roles | InputError, made: Made) -> bool:
    if isinstance(found, InputError) or found.base.kind != made.kind:
        return False
    base, pivots = found.base, frozenset[str]()
    if isinstance(base, SteeredBase):
        pivots = frozenset(p.joint for p in base.pivots)
    way = made.forward is None or float(np.dot(polar(1.0, base.frame[2]), made.forward)) > 0.999
    return way and frozenset(w.joint for w in base.wheels) == made.wheels and pivots == made.pivots


def ways(found: Roles | InputError, made: Made) -> Iterator[dict[str, Any]]:
    """The options of every command that is printed: in an error, or in warnings."""
    told = [] if isinstance(found, InputError) else [*found.findings, *found.notes]
    fixes = [found.fix] if isinstance(found, InputError) else [f.fix for f in told if f.severity == "warning"]
    for way in re.split(r"; |, or | or | if |, and ", " or ".join(f or "" for f in fixes)):
        said = dict[str, Any]()
        for key, value in OPTION.findall(way.replace("METRES", repr(made.radius))):
            many = key in (*LISTS, "lock", "free")
            said[key] = (*said.get(key, ()), *value.split(",")) if many else float(value) if key == "radius" else value
        if said:
            yield said


def leads(found: Roles | InputError, made: Made, said: Mapping[str, Any], steps: int = 3) -> str:
    """How the truth is told: `right`, `offered` after some printed options, or empty."""
    if is_true(found, made):
        return "right"
    for more in ways(found, made) if steps else ():
        kept = {key: tuple(dict.fromkeys((*said.get(key, ()), *more.get(key, ())))) for key in ("free", "lock")}
        both = {**said, **more, **kept}
        if both != said and leads(outcome(made.text, both), made, both, steps - 1):
            return "offered"
    return ""


def facts(found: Roles | InputError) -> tuple[object, ...]:
    """What must not depend on the order of a file."""
    if isinstance(found, InputError):
        names = sorted({*re.findall(r"'(\w+)'", found.what or "")})
        return type(found), names, sorted(re.findall(r"--[a-z-]+", found.fix or ""))
    base = found.base
    wheels = sorted((w.joint, round(w.radius, 9), w.sign) for w in base.wheels)
    frame = tuple(np.round(np.append(base.frame[:2], polar(1.0, base.frame[2])), 6) + 0.0)
    codes = sorted(f.code for f in (*found.findings, *found.notes))
    return base.kind, wheels, frame, sorted(found.arm.joints), sorted(found.arm.locked), codes


def statements(made: Made, pick: Pick) -> dict[str, Any]:
    """Something that a user says, right or wrong."""
    joints = re.findall(r'<joint name="([^"]*)" type="(?!fixed)', made.text)
    key = pick(("base", "wheels", "steer", "forward", "arm", "both"))
    if key == "both":
        return {"base": pick(tuple(KINDS)), "forward": pick(tuple(FORWARD))}
    if key == "base":
        return {"base": pick(tuple(KINDS))}
    if key == "wheels":
        return {"wheels": tuple(random.Random(pick(range(999))).sample(sorted(made.wheels), 2))}
    if key == "steer":
        return {"steer": (pick(sorted(made.pivots) or joints),)}
    return {key: pick(tuple(FORWARD) if key == "forward" else ARMS)}


def built_as_said(found: Roles, said: Mapping[str, Any]) -> bool:
    """Whether a robot is what the user says."""
    base, truth = found.base, [said.get("base") in (None, found.base.kind)]
    if "wheels" in said:
        placed = {w.joint: w for w in base.wheels}
        truth += [{*said["wheels"]} == {*placed}]
        truth += [base.kind != "differential_drive" or placed[said["wheels"][0]].y > 0]
    if "steer" in said:
        pivots = base.pivots if isinstance(base, SteeredBase) else ()
        truth += [said["steer"][0] in [p.joint for p in pivots if p.role != "passive"]]
    if "forward" in said:
        truth += [float(np.dot(polar(1.0, base.frame[2]), FORWARD[said["forward"]])) > 0.1]
    return all(truth)


# -- promises ----------------------------------------------------------------------------------------------------------

DRAWN = settings(max_examples=150, deadline=None)


@st.composite
def robots(draw: st.DrawFn, kinds: Sequence[str] = KINDS_MADE) -> Made:
    """Robots as drawn."""
    return made_by(lambda some: draw(st.sampled_from(some)), kinds)


@given(robots())
@DRAWN
def test_what_is_accepted_is_true_or_a_doubt_and_what_is_asked_offers_the_truth(made):
    found = outcome(made.text, {})
    assert leads(found, made, {}), found if isinstance(found, InputError) else (found.base, found.arm, made)


@given(robots(), st.integers(0, 99))
@DRAWN
def test_the_order_of_a_file_changes_nothing(made, seed):
    assert facts(outcome(made.text, {})) == facts(outcome(shuffled(made, seed).text, {}))


@given(robots())
@DRAWN
def test_every_option_that_is_printed_does_what_it_says(made):
    for said in ways(outcome(made.text, {}), made):
        found = outcome(made.text, said)
        if isinstance(found, InputError):  # a radius leads to the next question, with its options
            assert "radius" in said and list(ways(found, made)), found
        else:
            assert built_as_said(found, said), said


@given(robots(), st.data())
@DRAWN
def test_what_a_user_says_is_built_or_refused_by_one_error(made, data):
    said = statements(made, lambda some: data.draw(st.sampled_from(some)))
    found = outcome(made.text, said)
    assert isinstance(found, InputError) or built_as_said(found, said), (said, found)
