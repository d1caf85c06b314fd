"""A frame of the robot moved by its independent velocities nu, also where T turns with wheels that steer.

    twist = J nu,    J = J_b [V(theta) 0; 0 1],    acceleration = J nudot + bias,    bias = J_b' nu_b + J_b [V' u; 0]

`J_b` is the `Chain`'s, which a base's twist leads; V makes that twist of the base's own velocities u. Where T is
constant V is 1.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..by_address import by_address
from ..compiled import compiled, linked
from ..signals import Array, IntArray
from .base.rolling import Maps, Rolling, new_maps, roll
from .chain import Chain, chain_of, move
from .robot import Robot


@by_address
class Tip(NamedTuple):
    """A frame as nu moves it."""

    chain: Chain  # from the world to the frame
    rolling: Rolling | None  # a base that steers; None where T is constant
    maps: Maps  # its maps, written
    columns: IntArray  # (twist,) which of `(vx, vy, w)` the twist has
    nu: Array  # (m,) twist and arm rates, written
    J: Array  # (6, m) Jacobian for these, written


def tip_of(robot: Robot, frame: str) -> Tip:
    """A frame of a robot; errors as of `chain_of`."""
    chain = chain_of(robot, frame)
    m, columns = chain.T.shape[1], np.array(robot.base.columns if robot.dimensions.base else [], np.int64)
    maps = new_maps(robot.rolling, np.array(robot.template))
    return Tip(chain, robot.rolling, maps, columns, np.zeros(m), np.zeros((6, m)))


@linked
def move_tip(tip: Tip, position: Array, nu: Array, place: Array, twist: Array, bias: Array, J: Array) -> None:
    """Placement, twist, bias and Jacobian of a frame; arguments as of `chain.move`, all of nu (p,)."""
    by_nu(tip.rolling, tip, position, nu, place, twist, bias, J)


@compiled
def by_nu(
    rolling: Rolling | None, tip: Tip, position: Array, nu: Array, place: Array, twist: Array, bias: Array, J: Array
) -> None:
    """`move_tip`, compiled for a base that steers or for none."""
    if rolling is None:
        move(tip.chain, position, nu, place, twist, bias, J)
    else:
        maps, led = tip.maps, tip.columns.size
        nb = nu.size - tip.nu.size + led
        roll(rolling, position, nu, maps)
        for i in range(led):
            tip.nu[i] = maps.eta[tip.columns[i]]
        for i in range(led, tip.nu.size):
            tip.nu[i] = nu[nb + i - led]
        move(tip.chain, position, tip.nu, place, twist, bias, tip.J)
        for k in range(6):
            for j in range(nu.size):
                J[k, j] = 0.0 if j < nb else tip.J[k, led + j - nb]
            for i in range(led):
                for j in range(nb):
                    J[k, j] += tip.J[k, i] * maps.V[0, tip.columns[i], j]
                    bias[k] += tip.J[k, i] * maps.Vdot[0, tip.columns[i], j] * nu[j]


def jacobian_at(tip: Tip, position: Array) -> tuple[Array, Array]:
    """Placement (12,) and Jacobian (6, p) of a frame at a position (nv,) at rest."""
    p = tip.nu.size if tip.rolling is None else tip.maps.T.shape[1]
    place, J, two = np.zeros(12), np.zeros((6, p)), np.zeros((2, 6))
    move_tip(tip, position, np.zeros(p), place, two[0], two[1], J)
    return place, J
