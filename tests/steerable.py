"""Bases that steer, made by hand: what loaders find in files comes elsewhere."""

from __future__ import annotations

import math

from mmnn_pin.model.base.base import Wheel
from mmnn_pin.model.base.rolling import Pivot
from mmnn_pin.model.base.steered import Articulated, CarLike, CarWithTrailer, Casters, SteeredBase, Swerve, Tricycle

SIDES = ((1.0, "left"), (-1.0, "right"))


def axle(half: float = 0.25, radius: float = 0.15) -> tuple[Wheel, ...]:
    """Two wheels on the control frame's axle."""
    return tuple(Wheel(f"rear_{side}", radius, 1.0, s * half) for s, side in SIDES)


def car(length: float = 0.65, half: float = 0.22, stop: float = 0.7, rate: float = 2.5, sign: float = 1.0) -> CarLike:
    """A car whose left wheel is the master."""
    pivots = [
        Pivot(f"{side}_steer", role, length, s * half, sign=sign, lower=-stop, upper=stop, rate=rate, motor=s > 0)
        for (s, side), role in zip(SIDES, ("master", "follower"), strict=True)
    ]
    wheels = tuple(Wheel(f"front_{side}", 0.15, 1.0, 0.0, pivot=k, driven=False) for k, (_, side) in enumerate(SIDES))
    return CarLike(wheels=(*axle(), *wheels), pivots=tuple(pivots), length=length)


def tricycle(length: float = 1.2, stop: float = 1.3, rate: float = 2.0) -> Tricycle:
    """A tricycle: one wheel steers."""
    steer = Pivot("steer", "master", length, 0.0, lower=-stop, upper=stop, rate=rate, motor=True)
    return Tricycle(wheels=(*axle(), Wheel("front", 0.15, 1.0, 0.0, pivot=0)), pivots=(steer,), length=length)


def loader(front: float = 0.8, rear: float = 0.7, stop: float = 0.8, rate: float = 1.0) -> Articulated:
    """A loader, its waist behind the front axle."""
    waist = Pivot(
        "waist", "master", -front, 0.0, lower=-stop, upper=stop, rate=rate, motor=True, wheel=(-rear, 0.0, 0.0)
    )
    back = tuple(Wheel(f"back_{side}", 0.15, 1.0, s * 0.4, x=-rear, pivot=0) for s, side in SIDES)
    return Articulated(wheels=(*axle(0.4), *back), pivots=(waist,), length=front + rear)


def truck(trailers: int = 1, hitch: float = -0.12, length: float = 0.7) -> CarWithTrailer:
    """A truck with trailers hitched behind its axle."""
    pivots = [Pivot("steer", "master", 0.65, 0.0, lower=-0.7, upper=0.7, rate=3.0, motor=True)]
    for i in range(trailers):
        x = hitch if i == 0 else -length + hitch
        pivots.append(Pivot(f"hitch_{i}", "passive", x, 0.0, parent=i if i else -1, wheel=(-length, 0.0, 0.0)))
    wheels = (*axle(), Wheel("front", 0.15, 1.0, 0.0, pivot=0, driven=False))
    return CarWithTrailer(wheels=wheels, pivots=tuple(pivots), length=0.65)


def swerve(stop: float = math.inf, rate: float = 6.0) -> Swerve:
    """Four wheels that steer and drive."""
    places = ((0.3, 0.22), (0.3, -0.22), (-0.3, 0.22), (-0.3, -0.22))
    pivots = tuple(
        Pivot(f"steer_{i}", "master", x, y, lower=-stop, upper=stop, rate=rate, motor=True)
        for i, (x, y) in enumerate(places)
    )
    wheels = tuple(Wheel(f"drive_{i}", 0.1, 1.0, 0.0, pivot=i) for i in range(4))
    return Swerve(wheels=wheels, pivots=pivots, length=math.hypot(0.3, 0.22))


def casters(trail: float = 0.06, rate: float = math.inf) -> Casters:
    """Four powered casters."""
    places = ((0.3, 0.22), (0.3, -0.22), (-0.3, 0.22), (-0.3, -0.22))
    pivots = tuple(
        Pivot(f"swivel_{i}", "passive", x, y, rate=rate, motor=True, wheel=(-trail, 0.0, 0.0))
        for i, (x, y) in enumerate(places)
    )
    wheels = tuple(Wheel(f"drive_{i}", 0.1, 1.0, 0.0, x=-trail, pivot=i) for i in range(4))
    return Casters(wheels=wheels, pivots=pivots, length=0.37)


ON_AXLE = (car, tricycle, loader)
ALL: tuple[SteeredBase, ...] = (car(), tricycle(), loader(), truck(), swerve(), casters())
