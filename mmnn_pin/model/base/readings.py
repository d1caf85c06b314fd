"""Readings of a base: what its wheels and pivots may be, the signs for each and against, and the one that is borne out.

A reading gives every wheel and every pivot a role, all together; its score is the sum of its signs (`model.signs`).
The best is taken where it beats the next by `MARGIN`. Else the loader asks, with the options that lead to the readings
in question, each tried before it is printed (`understanding`). That these wheels make no base is one, too: `NO_BASE`.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from ...errors import InputError
from ..signs import MARGIN, Sign, told_apart
from ..urdf.finding import Finding
from ..urdf.shapes import AtRest
from .evidence import Evidence
from .report import FORCES, PARKED, BaseReading, BaseResult, note, undecided, unmeasured
from .wheels import COAXIAL, MOST_PER_SIDE, SLOPPY, Candidate, across, coaxial, on_either_side, one_axle, parallel

NO_BASE = -4.0  # score of the reading that these wheels make no base
CLEAR, DOUBT = 9.0, 3.0  # a runner-up further behind is not told; a nearer one is told as a doubt
LARGE = 0.13  # [m] radius beyond which few wheels have rollers: 1 of 14 on public robots, of plain ones 9 of 22
SMALL = 0.6  # of the radius of wheels that drive: pairs of smaller ones stand in for casters
IN_ROW = 0.2  # wheels of a side may differ in place by this fraction of the width
ALIKE = 0.1  # radii that differ by less than this fraction are of wheels of one kind
ROLLING = ("skid_steer", "tracked")
TOLD_BY = {"skid_steer": "skid_steer", "tracked": "skid_steer", "holonomic": "holonomic"}  # meaning of evidence


@dataclass(frozen=True, eq=False)
class Proposal(BaseReading):
    """A reading that a base can be built by."""

    said: Mapping[str, Any]  # what a user says for it, keys of `Overrides`
    build: Callable[[], BaseResult]  # makes it; raises what `understanding` raises where it cannot be

    @property
    def stands(self) -> bool:
        """Whether it can be built."""
        with contextlib.suppress(InputError):
            return bool(self.build())
        return False

    @property
    def options(self) -> str:
        """Its statements as they stand on the command line."""
        texts = {key: value if isinstance(value, str) else ",".join(value) for key, value in self.said.items()}
        return " ".join(f"--{key.replace('_', '-')} {text}" for key, text in texts.items())


@dataclass(frozen=True, eq=False)
class Question:
    """The question that is asked where readings leave a doubt."""

    rest: AtRest  # the robot at rest
    wheels: Sequence[Candidate]  # what was found
    blind: Sequence[Candidate] = ()  # what may be wheels, too, and cannot be measured
    sure: bool = False  # whether the user says that one of the readings is right

    def best_of(self, readings: Sequence[Proposal]) -> BaseResult:
        """The base of the reading that is borne out.

        Raises:
            Undecided: Another one is borne out as well, or much speaks against it.
            RobotError, ConfigError: It cannot be built.
        """
        ordered = sorted(readings, key=lambda reading: -reading.score)
        best, others = ordered[0], ordered[1:]
        rivals = [reading for reading in others if best.score - reading.score < MARGIN and reading.stands]
        doubtful = best.score - NO_BASE < MARGIN and not self.sure
        if rivals:
            raise self.which([best, *rivals], [reading for reading in others if reading not in rivals])
        if doubtful:
            raise self.whether(best, others)
        found = best.build()
        return replace(found, findings=(*reading_note(self.rest, best, others), *found.findings))

    def which(self, rivals: Sequence[Proposal], others: Sequence[Proposal]) -> Exception:
        """The question which of some readings is meant."""
        told = [told_apart(one.signs, other.signs) for one in rivals for other in rivals if one is not other]
        texts = list(dict.fromkeys(text for texts in told for text in texts))
        kinds = dict.fromkeys(reading.kind.replace("_", " ") for reading in rivals)
        why = f"nothing in the file tells {' from '.join(kinds)}"
        if texts:
            why = f"the signs do not tell which: {'; '.join(texts)}"
        ways = [f"{r.options} {when(r, rivals)}".strip() for r in rivals]
        first = {reading.kind: reading for reading in reversed(others) if reading.kind.replace("_", " ") not in kinds}
        listed = [*rivals, *reversed(first.values())][:4]
        return undecided(self.rest, self.wheels, why, "; ".join([*ways, last_way([*rivals, *others])]), listed)

    def whether(self, best: Proposal, others: Sequence[Proposal]) -> Exception:
        """The question whether a reading is meant though much speaks against it."""
        listed = [best, *others][:4]
        if self.blind:
            return unmeasured(self.rest, [*self.wheels, *self.blind], listed)
        against = [sign.text for sign in best.signs if sign.weight < 0]
        ways = [f"{best.options} {when(best, [best])}"]
        if any("<mimic>" in text for text in against):
            ways.append("take out their <mimic> if they turn by themselves")
        return undecided(
            self.rest, self.wheels, "; ".join(against), "; ".join([*ways, last_way([best, *others])]), listed
        )


def last_way(readings: Sequence[Proposal]) -> str:
    """The way out that is always left: to park the base, or to drive it by forces where no wheels of it do that."""
    return PARKED if any(reading.kind == "holonomic" for reading in readings) else FORCES


def when(reading: Proposal, rivals: Sequence[Proposal]) -> str:
    """In which case a reading is the right one, in words."""
    mixed = {"skid_steer", "holonomic"} <= {r.kind for r in rivals}
    words = {
        "differential_drive": "if these two drive",
        "skid_steer": "for plain wheels" if mixed else "if it runs on these wheels",
        "holonomic": "for mecanum wheels",
        "tracked": "if belts run over them",
        "drive_trailer": "if it follows freely",
        "articulated": "if a motor turns it",
    }
    steer = {0: "", 1: "if it steers"}.get(len(reading.said.get("steer", ())), "if they steer")
    return words.get(reading.kind, steer)


def reading_note(rest: AtRest, best: Proposal, others: Sequence[Proposal]) -> list[Finding]:
    """The reading that was taken, its runner-up and what told them apart; a warning where that is little."""
    other = next((r for r in others if best.score - r.score < CLEAR and r.kind != best.kind), None)
    ordered = sorted((sign for sign in best.signs if sign.weight > 0), key=lambda sign: -sign.weight)
    apart = [*(sign.text for sign in ordered), *(told_apart(best.signs, other.signs) if other else [])]
    apart = list(dict.fromkeys(apart))[:3]
    if not apart:
        return []
    doubt = other is not None and best.score - other.score < DOUBT
    text = f"taken as {best.kind}{f', not {other.kind}' if other else ''}: {'; '.join(apart)}"
    fix = f"{other.options} for the other" if other and doubt else ""
    said = note(rest, "base-doubt" if doubt else "base-evidence", "", text, "", fix)
    lines = [sign.line for sign in best.signs if sign.text == apart[0] and sign.line]
    return [replace(said, line=lines[0]) if lines else said]


# -- wheels that do not steer ------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Drives:
    """Wheels that may drive a base that does not steer.

    Attributes:
        fixed: Wheels that hang on nothing that turns; or those that the user names.
        motors: Joints that the file drives, with where it says so.
        named: Whether the user names them.
        said: The kind that the user says, None where that is open.
        belts: Signs that it runs on tracks.
        words: Signs against all that does not steer.
        on_arms: Round bodies on arms, such as drums.
        drawn: Wheels that are drawn as cylinders and nothing else, on a robot that is mostly drawn so.
    """

    fixed: Sequence[Candidate]
    motors: Mapping[str, str]
    named: bool
    said: str | None
    belts: Sequence[Sign]
    words: Sequence[Sign]
    on_arms: frozenset[str]
    drawn: frozenset[str]

    def sets(self) -> list[list[Candidate]]:
        """Sets of wheels of which one drives: all, those that are no balls, those with motors, pairs on one axle."""
        if self.named:
            return [list(self.fixed)]
        sets = [list(self.fixed), [c for c in self.fixed if c.shape != "sphere"]]
        sets.append([c for c in self.fixed if c.joint.name in self.motors])
        on_body = [c for c in self.fixed if c.joint.name not in self.on_arms]
        sets += [on_body, *([o for o in on_body if alike(o, c)] for c in on_body)]
        sets += [list(pair) for pair in combinations(self.fixed, 2)]
        known = {frozenset(c.joint.name for c in some): some for some in reversed(sets) if len(some) > 1}
        return list(known.values())[::-1]

    def kinds(self, drives: Sequence[Candidate]) -> list[str]:
        """Kinds of base that some wheels can make by their places."""
        if len(drives) == 2:
            near = SLOPPY if self.named or len(self.fixed) == 2 else COAXIAL
            pair = ["differential_drive"] if coaxial(*drives, within=near) else []
            tracked = pair and (self.said == "tracked" or (self.belts and not self.named))
            return pair + (["tracked"] if tracked else [])
        if not all(parallel(drives[0], c) for c in drives[1:]):
            return ["holonomic"] if len(drives) >= 3 else []
        left, right = on_either_side(drives)
        even = 2 <= left == right == len(drives) / 2
        rollers = len(drives) == 4 and in_pairs(drives) and not one_axle(drives)
        kinds = ["holonomic"] if rollers or (self.named and len(drives) > 2) else []
        kinds += ["skid_steer"] if even and left <= MOST_PER_SIDE else []
        return kinds + (["tracked"] if even and not one_axle(drives) else [])

    def signs(self, kind: str, drives: Sequence[Candidate], pieces: Sequence[Evidence]) -> Iterator[Sign]:
        """Signs for wheels that drive, the others being free, and against that."""
        others = [c for c in self.fixed if c not in drives]
        yield from self.words
        yield from self.of_others(drives, others)
        yield from self.of_motors(kind, drives, others)
        yield from self.of_slaves(kind, drives)
        if not all(alike(drives[0], c) for c in drives[1:]):
            yield Sign("the wheels that drive differ in size", -2.0 if kind == "differential_drive" else -4.0)
        meaning = TOLD_BY.get(kind)
        for source in dict.fromkeys(piece.source for piece in pieces):
            cited = [p for p in pieces if p.source == source and p.meaning == meaning]
            if cited:
                more = f" and {len(cited) - 1} more" if len(cited) > 1 else ""
                yield Sign(f"{cited[0].text}{more}", cited[0].weight, cited[0].line, cited[0].wheel)
        level = all(parallel(drives[0], c) for c in drives[1:])
        if kind == "holonomic" and level and not any(p.meaning == "holonomic" for p in pieces):
            bare = self.drawn.issuperset(c.joint.name for c in drives)  # of such robots most have no rollers
            text = "nothing in the file speaks of rollers"
            yield Sign(f"{text}, and its wheels are drawn as cylinders" if bare else text, -2.3 if bare else -1.3)
        if kind == "holonomic" and level and drives[0].radius > LARGE:
            yield Sign(f"wheels of {drives[0].radius:.3g} m: those with rollers are mostly smaller", -1.0)
        if kind == "skid_steer" and one_axle(drives):
            yield Sign(f"{len(drives)} wheels on one axle: twin tyres whose sides turn alike", 1.0)
        if kind in ROLLING and not in_rows(drives):
            yield Sign("the wheels of a side do not stand in a row", -8.0)
        if kind == "tracked":
            yield from self.belts or [Sign("no belt is in the file", -5.0)]

    def of_others(self, drives: Sequence[Candidate], others: Sequence[Candidate]) -> Iterator[Sign]:
        """Signs of wheels that are left out: they cannot swivel, and have to slide where the base turns."""
        groups: dict[tuple[str, float], list[Candidate]] = {}
        balls = all(c.shape == "sphere" for c in drives)
        for c in (c for c in others if balls or c.shape != "sphere"):
            if c.joint.name in self.on_arms:
                groups.setdefault(("on arms, not on the floor", -0.5), []).append(c)
                continue
            beside = any(coaxial(c, o) for o in others) and c.joint.mimics is None
            if alike(c, drives[0]) or c.radius > drives[0].radius:
                why, weight = "wheels as large as those that drive, or larger, which would have to slide", -4.0
            elif beside and c.radius < SMALL * drives[0].radius:  # one alone may steer, and its pivot be left out
                why, weight = "pairs of small wheels, as casters are", -0.5
            else:
                why, weight = "wheels that cannot swivel and would have to slide", -2.5
            groups.setdefault((why, weight), []).append(c)
        for (why, weight), some in groups.items():
            yield about(some, why, weight * len(some))

    def of_motors(self, kind: str, drives: Sequence[Candidate], others: Sequence[Candidate]) -> Iterator[Sign]:
        """Signs of motors: what has one drives; of a base whose wheels skid, others may turn along."""
        rolling = [c for c in others if c.shape != "sphere" or all(d.shape == "sphere" for d in drives)]
        powered = [c for c in rolling if c.joint.name in self.motors and c.joint.name not in self.on_arms]
        idle = [c for c in drives if c.joint.name not in self.motors]
        if powered:
            yield about(powered, "with motors, and would not drive", -4.0 * len(powered))
        if idle and len(powered) + len(drives) > len(idle) and not self.named:
            yield about(idle, "without motors in the file", (-0.3 if kind in ROLLING else -1.8) * len(idle))
        if others and not idle and not powered:
            yield about(drives, f"alone with motors, by {self.motors[drives[0].joint.name]}", 4.0)

    def of_slaves(self, kind: str, drives: Sequence[Candidate]) -> Iterator[Sign]:
        """Signs of wheels that follow others: the sides of a base that skids turn alike, other wheels by themselves."""
        for c in (c for c in drives if c.joint.mimics is not None):
            text = f"wheel '{c.joint.name}' follows '{c.joint.mimics}' (<mimic>, line {c.joint.line})"
            right = kind in ROLLING and follows_on_its_side(c, drives)
            yield Sign(text, 2.0 if right else -8.0, c.joint.line, c.joint.name)


def follows_on_its_side(slave: Candidate, drives: Sequence[Candidate]) -> bool:
    """Whether a wheel follows one in front of or behind it, on the same side."""
    master = next((c for c in drives if c.joint.name == slave.joint.mimics), None)
    if master is None:
        return False
    between = slave.centre - master.centre
    return bool(abs(between @ master.axis) < master.radius < float((between @ between) ** 0.5))


def about(wheels: Sequence[Candidate], what: str, weight: float) -> Sign:
    """A sign of some wheels."""
    names = ", ".join(f"'{c.joint.name}'" for c in wheels)
    return Sign(f"{what}: {names}", weight, wheels[0].joint.line, wheels[0].joint.name)


def alike(a: Candidate, b: Candidate) -> bool:
    """Whether two wheels are of one size, as far as that is known."""
    return not abs(a.radius - b.radius) > ALIKE * b.radius


def in_rows(drives: Sequence[Candidate]) -> bool:
    """Whether the parallel wheels of each side stand about in a row."""
    places = across(drives)
    sides = [places[places > places.mean()], places[places < places.mean()]]
    return all(np.ptp(side) < IN_ROW * np.ptp(places) for side in sides if side.size)


def in_pairs(drives: Sequence[Candidate]) -> bool:
    """Whether wheels could be mecanum wheels or omni wheels: two and two on one line, or not all parallel."""
    level = all(parallel(drives[0], c) for c in drives[1:])
    return not level or all(any(coaxial(c, o) for o in drives if o is not c) for c in drives)
