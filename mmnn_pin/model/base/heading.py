"""Which way a base drives forward: signs of a robot, each an arrow on the floor with a weight, and what the user says.

Parallel wheels roll in two directions; wheels whose axles cross, and swerve drives, have the four along x and y of the
root link. Each sign speaks for a direction by its weight times the cosine to it; the best is forward. The weights are
logarithms of how often a sign is right on public robots whose forward is known: x of the root link 176 to 1 (REP 103),
names of left and right wheels 121 to 5, front and rear 106 to 0, positive rates 116 to 3, sensors' view 69 to 5,
their place 67 to 16, the arm's 30 to 5, casters behind 5 to 1. What hangs together counts once, and less.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from ...elementary.matrices import product
from ...errors import ConfigError
from ...files import read_bytes
from ...signals import Array
from ..signs import Sign, score
from ..urdf.reading import MAX_BYTES
from ..urdf.shapes import HORIZONTAL, AtRest
from .evidence import mappings_of
from .machines import chain
from .overrides import FORWARD, Overrides
from .wheels import SLOPPY, TOUCHING, Candidate, coaxial, parallel, rolling

CONVENTION, SAID_SIDES, SIDES, ENDS, RATES, VIEW, PLACE, ARM, CASTERS = 4.5, 4.0, 3.0, 4.0, 1.5, 2.0, 0.7, 0.7, 0.7
# Weight of x in the place of CONVENTION where a drawing program wrote the file, whose axes are the drawing's, and where
# the wheels roll along neither x nor y.
DRAWN = 2.5
CROSSED = 3.0  # likewise where wheels roll in several directions: two of thirteen public robots drive along y
DRAWERS = re.compile(rb"solidworks|sw_urdf_exporter|fusion2urdf|onshape", re.IGNORECASE)  # at the head of their files
TURNS = "positive rates of the wheels"
HEAD = 2000  # bytes of that
TOWED, STEERED = 4.0, 2.0  # weights of trailers, which are behind, and of wheels that steer, which are mostly ahead
ALONG = 0.1  # least cosine of a direction to the axis that the user names
TOGETHER = 0.3  # what arrows must sum up to, by the sum of their lengths
LEFT = re.compile(
    r"left|lft|linke[rsn]?(?![a-z])|gauche|izquierd|sinistr|esquerd|hidari"
    r"|(?<![a-z])(?:l|[fmrb]l|l[fmrbhw]|izq|sx)(?![a-z])",
    re.IGNORECASE,
)
RIGHT = re.compile(
    r"(?<!b)(?<!up)right|rgt|rght|recht|droit|derech|destr|direit|migi"
    r"|(?<![a-z])(?:r|[fmrb]r|r[fmrbhw]|der|dx)(?![a-z])",
    re.IGNORECASE,
)
FRONT = re.compile(
    r"front|forward|vorn|vorder|avant|delant|anterior|(?<![a-z])(?:f|f[lr]|[lr]f|fwd)(?![a-z])", re.IGNORECASE
)
REAR = re.compile(
    r"rear|back(?!pack|plate|bone)|hint(?:en|er)|arri[eè]re|traser|posterior|(?<![a-z])(?:[rb][lr]|[lr][rb])(?![a-z])",
    re.IGNORECASE,
)
EYES = re.compile(r"cam(?![a-z])|camera|realsense|kinect|lidar|laser|scan(?:ner)?(?![a-z])", re.IGNORECASE)
NECK = 2  # joints above an eye, at most: those of a hand look anywhere


class Arrow(NamedTuple):
    """A sign of where forward is, in words: it speaks for a unit vector (2,) in the root link by a weight [nats]."""

    text: str
    towards: Array
    weight: float


def axis_name(direction: Array) -> str:
    """The axis of the root link that a direction (2,) is nearest to, as `--forward` has it."""
    along = int(abs(direction[1]) > abs(direction[0]) + 1e-6)
    return ("-" if direction[along] < 0 else "") + "xy"[along]


class Heading(NamedTuple):
    """The directions (2,) that a base may take as forward, the best first, their signs, and whether a user says it."""

    ways: list[Array]
    signs: list[list[Sign]]
    said: bool

    @property
    def forward(self) -> Array:
        """(2,) the best."""
        return self.ways[0]

    @property
    def margin(self) -> float:
        """How much better the best is than the second [nats]."""
        return score(self.signs[0]) - score(self.signs[1])


def heading(
    rest: AtRest,
    drives: Sequence[Candidate],
    overrides: Overrides,
    steered: Sequence[Array] = (),
    towed: Sequence[Array] = (),
    any_way: bool = False,
) -> Heading:
    """Where forward is by the wheels that drive, or hold the base, and by the user's `forward` or two `wheels`.

    The places (2,) of what steers beside a fixed axle and of trailers tell it, too; a base that moves any way has four.

    Raises:
        ConfigError: The wheels do not roll along the axis that the user names.
    """
    ways = ways_of(drives, any_way)
    found = list(arrows(rest, drives, overrides.controllers_file, any_way))
    middle = middle_of(drives)
    found += arrow("trailers behind", [middle - place for place in towed], TOWED)
    found += arrow("what steers ahead", [place - middle for place in steered], STEERED)
    signs = [
        [Sign(a.text, a.weight * cosine) for a in found if (cosine := float(product(a.towards, way))) > ALONG]
        for way in ways
    ]
    said = said_way(drives, overrides, ways)
    order = sorted(range(len(ways)), key=lambda i: (i != said, -score(signs[i])))  # equal ones as they are: x, then y
    return Heading([ways[i] for i in order], [signs[i] for i in order], said is not None)


def middle_of(drives: Sequence[Candidate]) -> Array:
    """(2,) the middle of wheels on the floor, that of the root link without any."""
    return np.asarray(np.mean([c.centre[:2] for c in drives], axis=0)) if drives else np.zeros(2)


def ways_of(drives: Sequence[Candidate], any_way: bool) -> list[Array]:
    """Directions (2,) that may be forward, the nearest to the root's x first, of those across it that along y."""
    if any_way or not all(parallel(drives[0], c) for c in drives[1:]):
        return [np.array(way) for way in ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))]
    way = rolling(drives[0])
    backward = way[0] < -1e-6 or (abs(way[0]) <= 1e-6 and way[1] < 0)
    way = (-way if backward else way) + 0.0  # no -0
    return [way, -way + 0.0]


def said_way(drives: Sequence[Candidate], overrides: Overrides, ways: Sequence[Array]) -> int | None:
    """Number of the direction that the user says; None where he says none; errors as of `heading`."""
    if overrides.forward is not None:
        cosines = [float(product(FORWARD[overrides.forward], way)) for way in ways]
        if max(cosines) > ALONG:
            return int(np.argmax(cosines))
        other = axis_name(ways[0]).removeprefix("-")
        why, fix = f"its wheels roll along {other}", f"--forward {other} or -{other}"
        raise ConfigError(f"{overrides.forward} cannot be forward", why=why, fix=fix, key="forward")
    names = [c.joint.name for c in drives]
    if len(drives) == 2 and {*names} == {*(overrides.wheels or ())}:
        left, right = (drives[names.index(name)] for name in overrides.wheels or ())
        to_left = (left.centre - right.centre)[:2]
        return int(np.argmax([float(product([-way[1], way[0]], to_left)) for way in ways]))
    return None


def left_first(rest: AtRest, wheels: Sequence[Candidate]) -> list[Candidate]:
    """Wheels as they are, but those on one axle together and the left one first, as `--wheels LEFT,RIGHT` has them."""
    rows = list[list[Candidate]]()
    for c in wheels:
        row = next((row for row in rows if coaxial(row[0], c, within=SLOPPY)), None)
        rows.append([c]) if row is None else row.append(c)
    if all(len(row) < 2 for row in rows) or not all(rest.is_horizontal(c.joint) for c in wheels):
        return list(wheels)
    x, y = heading(rest, wheels, Overrides()).forward
    return [c for row in rows for c in sorted(row, key=lambda c: float(y * c.centre[0] - x * c.centre[1]))]


# -- signs -------------------------------------------------------------------------------------------------------------


def arrow(text: str, vectors: Sequence[Array], weight: float, least: float = 1e-9) -> Iterator[Arrow]:
    """The sign that arrows (2,) make together; none where they contradict each other, or their sum is the least."""
    total = np.sum([*vectors, np.zeros(2)], axis=0)
    size, whole = float(np.linalg.norm(total)), sum(float(np.linalg.norm(v)) for v in vectors)
    if size > max(least, TOGETHER * whole):
        yield Arrow(text, total / size, weight)


def arrows(rest: AtRest, drives: Sequence[Candidate], controllers: str | None, any_way: bool) -> Iterator[Arrow]:
    """All signs of a robot where forward is; errors as of `heading`."""
    middle = middle_of(drives)
    least = min((c.radius for c in drives if not math.isnan(c.radius)), default=0.0) / 2
    near = [name for name in rest.document.links if len(rest.document.moving_ancestors(name)) <= 1]
    at = {name: rest.placements[name][:2, 3] - middle for name in near}
    ways = ways_of(drives, any_way)
    crossed, oblique = len(ways) > 2, min(abs(ways[0])) > HORIZONTAL
    weight = DRAWN if oblique or is_drawn(rest) else CROSSED if crossed else CONVENTION
    yield Arrow("x of the root link", np.array([1.0, 0.0]), weight)
    yield from sides(rest, drives, middle, controllers, at)
    ends = [(FRONT.search(name), REAR.search(name), place) for name, place in at.items()]
    ends += [(FRONT.search(c.joint.name), REAR.search(c.joint.name), c.centre[:2] - middle) for c in drives]
    yield from arrow("names of front and rear", [p if f else -p for f, r, p in ends if bool(f) != bool(r)], ENDS, least)
    if not crossed:
        yield from arrow(TURNS, [rolling(c) for c in drives], RATES)
    yield from eyes(rest, middle, least)
    if len(drives) == 2:
        yield from arrow("casters behind", [-(p - middle) for p in props(rest, drives)], CASTERS, least)
    yield from arrow("the arm's place", [p - middle for p in shoulders(rest, drives)], ARM, least)


def is_drawn(rest: AtRest) -> bool:
    """Whether a drawing program wrote the file, as it says at its head."""
    try:
        return bool(DRAWERS.search(read_bytes(rest.document.path, MAX_BYTES)[:HEAD]))
    except (OSError, ValueError):  # a robot of a recording, whose file is elsewhere
        return False


def sides(
    rest: AtRest, drives: Sequence[Candidate], middle: Array, controllers: str | None, at: dict[str, Array]
) -> Iterator[Arrow]:
    """Left and right, as controllers say it, else names of wheels, else those of other bodies."""
    places = {c.joint.name: c.centre[:2] - middle for c in drives}
    told = {name: side for name, side in told_sides(rest, controllers).items() if name in places}
    named = {c.joint.name: side_of(f"{c.joint.name} {c.joint.child}") for c in drives}
    others = {name: side_of(name) for name in at}
    for text, found, where, weight in (
        ("left and right of the controllers", told, places, SAID_SIDES),
        ("names of left and right wheels", named, places, SIDES),
        ("names of left and right", others, at, SIDES),
    ):
        to_left = [where[name] * side for name, side in found.items() if side]
        if signs := list(arrow(text, [np.array([v[1], -v[0]]) for v in to_left], weight)):
            yield from signs
            return


def side_of(name: str) -> int:
    """1 of a name for the left, -1 for the right, 0 of others."""
    return bool(LEFT.search(name)) - bool(RIGHT.search(name))


def told_sides(rest: AtRest, controllers: str | None) -> dict[str, int]:
    """Sides of joints as plugins and a controllers' file have them, 1 for left; errors as of `lines_of`."""
    found = dict[str, int]()
    for element in rest.document.root.iterfind("gazebo//*"):
        if "joint" in str(element.tag).lower() and (side := side_of(str(element.tag))):
            found |= dict.fromkeys((element.text or "").split(), side)
    for key, entry in (item for table in mappings_of(controllers).values() for item in table.items()):
        if "wheel" in key and (side := side_of(key)):
            found |= dict.fromkeys(entry.items, side)
    return found


def eyes(rest: AtRest, middle: Array, least: float) -> Iterator[Arrow]:
    """Where cameras and scanners of the body or of a head look, and where they are."""
    blocks = rest.document.root.iterchildren("gazebo")
    seen = {block.get("reference") for block in blocks if block.find("sensor") is not None}
    names = [n for n in rest.document.links if EYES.search(n) or n in seen]
    at = {n: rest.placements[n] for n in names if len(rest.document.moving_ancestors(n)) <= NECK}
    views = [pose[:2, 2 if "optical" in n.lower() else 0] for n, pose in at.items()]
    yield from arrow("where cameras and scanners look", views, VIEW, 0.5)
    yield from arrow("the place of cameras and scanners", [p[:2, 3] - middle for p in at.values()], PLACE, least)


def props(rest: AtRest, drives: Sequence[Candidate]) -> list[Array]:
    """Places (2,) of what else stands on the floor beside two wheels: balls, and wheels on swivels."""
    floor, radius = max(c.bottom for c in drives), max(c.radius for c in drives)
    own = {link for c in drives for link in rest.document.body(c.joint.child)}
    shapes = [s for link in rest.document.links if link not in own for s in rest.primitives[link] if s.rolls]
    return [s.pose[:2, 3] for s in shapes if abs(s.lowest - floor) <= TOUCHING * radius]


def shoulders(rest: AtRest, drives: Sequence[Candidate]) -> list[Array]:
    """Places (2,) of the first joints on the root's body of chains of three and more: an arm's."""
    used = {j.name for c in drives for j in rest.document.moving_ancestors(c.joint.child)}
    first = [j for j in rest.document.moving_children(rest.document.root_link) if j.name not in used]
    return [rest.hub(j)[:2] for j in first if len(chain(rest, j)) > NECK]
