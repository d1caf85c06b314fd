"""From chosen wheels to a base: its control frame, and the wheels placed in it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mmnn_pin.signals import Array

from ..urdf.shapes import AtRest
from .base import Base, Kind, Wheel
from .overrides import Overrides
from .wheels import Candidate, bare_swivels, parallel


def frame_of(rest: AtRest, drives: list[Candidate], wheels: list[Candidate], kind: Kind, said: Overrides) -> Base:
    """Control frame, wheels, casters and suspensions; forward is the rolling direction nearer the root's x."""
    alike = all(parallel(drives[0], c) for c in drives[1:])
    forward = rolling(drives[0]) if alike else np.array([1.0, 0.0])
    backward = forward[0] < -1e-6 or (abs(forward[0]) <= 1e-6 and forward[1] < 0)  # axle along x: y is as near
    forward = (-forward if backward else forward) + 0.0  # no -0
    left = np.array([-forward[1], forward[0]])
    middle = np.mean([c.centre[:2] for c in drives], axis=0)
    placed = [placed_wheel(c, c.centre[:2] - middle, forward, left, alike, said) for c in drives]
    in_rows = kind == "holonomic"
    placed.sort(key=lambda w: (-round(w.x, 6) * in_rows, -w.y))  # front to rear, left before right
    track = max(w.y for w in placed) - min(w.y for w in placed)
    if said.track is not None and track > 0:
        placed = [replace(w, y=w.y * said.track / track) for w in placed]
        track = said.track
    suspensions = [j.name for c in drives for j in rest.document.moving_ancestors(c.joint.child)[1:]]
    others = [c for c in wheels if c.joint not in [d.joint for d in drives]]
    casters = [j.name for c in others for j in rest.document.moving_ancestors(c.joint.child)]
    floor, radius = max(c.bottom for c in drives), max(c.radius for c in drives)
    casters += [joint.name for joint in bare_swivels(rest, floor, radius)]
    return Base(
        kind=kind,
        wheels=tuple(placed),
        track=track,
        frame=np.array([*middle, math.atan2(forward[1], forward[0])]),
        floor=float(np.mean([c.bottom for c in drives])),
        casters=in_order(rest, set(casters) - set(suspensions)),
        suspensions=in_order(rest, suspensions),
        parked=in_order(rest, [name for c in wheels for name in c.rollers]),
    )


def rolling(candidate: Candidate) -> Array:
    """(2,) direction that positive joint velocity rolls a wheel in."""
    return np.array([candidate.axis[1], -candidate.axis[0]]) / np.hypot(*candidate.axis[:2])


def placed_wheel(c: Candidate, at: Array, forward: Array, left: Array, alike: bool, said: Overrides) -> Wheel:
    """The wheel in the control frame; parallel wheels have a sign, others a heading of their own."""
    direction, radius = rolling(c), said.radius or c.radius
    sign = math.copysign(1.0, direction @ forward) if alike else 1.0
    heading = 0.0 if alike else math.atan2(direction @ left, direction @ forward)
    x = 0.0 if abs(at @ forward) < 1e-12 else float(at @ forward)
    return Wheel(c.joint.name, radius, sign, y=float(at @ left), x=x, heading=heading)


def in_order(rest: AtRest, names: Sequence[str] | set[str]) -> tuple[str, ...]:
    """Joints once each, in the order of the file."""
    return tuple(name for name in rest.document.joints if name in set(names))
