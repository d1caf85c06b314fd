"""A guided trailer: its axle follows the reference, and the truck moves as that asks.

A hitch is h behind the truck's axle, the trailer's axle L behind the hitch, and the trailer stands at gamma to the
truck, to the left. Its axle does not slide, so that its velocities are those of the truck times

    J(gamma) = [cos gamma, -h sin gamma; -sin gamma / L, -h cos gamma / L],      det J = -h / L at every gamma

A hitch off the axle is thus left by the same way: the trailer's axle is driven by the law of a differential drive, and
J^-1 turns its command into the truck's (M. Michalek, M. Kielczewski, T. Jedwabny, J. Intell. Robot. Syst. 77, 2015,
call it a cascade). Then `gammadot = (v sin gamma + w (h + L cos gamma)) / h`, (v, w) the trailer's: the angle settles
in reverse with h > 0 (forward with h < 0) and folds up the other way. A hitch on the axle (h = 0) has no J^-1.

A chain of trailers is `towed` along the chain, the law of the last one, and `towing` back.
"""

from __future__ import annotations

from ...compiled import compiled
from ...elementary import cos_sin
from ...signals import Array


@compiled
def trailer_pose(hitch: Array, gamma: float, pose: Array, trailer: Array) -> None:
    """Pose of a trailer's axle from that of the axle that pulls it.

    Args:
        hitch: (2,) h, how far the hitch is behind the truck's axle, and L, from there to the trailer's [m].
        gamma: The trailer's heading less the truck's [rad].
        pose: (3,) of the truck's axle [m, m, rad].
        trailer: (3,) written: of the trailer's [m, m, rad].
    """
    (c, s), (ct, st) = cos_sin(pose[2]), cos_sin(pose[2] + gamma)
    trailer[0] = pose[0] - hitch[0] * c - hitch[1] * ct
    trailer[1] = pose[1] - hitch[0] * s - hitch[1] * st
    trailer[2] = pose[2] + gamma


@compiled
def towed(hitch: Array, gamma: float, velocity: Array, trailer: Array) -> None:
    """Velocity of a trailer's axle from that of the axle that pulls it, `J(gamma) (v, w)`.

    Args:
        hitch: (2,) h, L [m].
        gamma: The trailer's heading less the truck's [rad].
        velocity: (2,) the truck's (v, w) [m/s, rad/s].
        trailer: (2,) written: the trailer's [m/s, rad/s].
    """
    (c, s), v, w = cos_sin(gamma), velocity[0], velocity[1]
    trailer[0] = c * v - hitch[0] * s * w
    trailer[1] = -(s * v + hitch[0] * c * w) / hitch[1]


@compiled
def towing(hitch: Array, gamma: float, velocity: Array, alpha: Array, alphadot: Array) -> None:
    """The truck's command that moves a trailer as its own command asks, `J(gamma)^-1 alpha`, and its derivative.

    `J^-1 = [cos gamma, -L sin gamma; -sin gamma / h, -L cos gamma / h]`, and gamma turns as the trailer really moves.

    Args:
        hitch: (2,) h, not 0, and L [m].
        gamma: The trailer's heading less the truck's [rad].
        velocity: (2,) the trailer's measured (v, w) [m/s, rad/s].
        alpha: (2,) the trailer's command [m/s, rad/s], in its place the truck's.
        alphadot: (2,) its derivative [m/s^2, rad/s^2], in its place the truck's.
    """
    (c, s), h, L = cos_sin(gamma), hitch[0], hitch[1]
    turning = velocity[1] + (s * velocity[0] + L * c * velocity[1]) / h
    v, w, vdot, wdot = alpha[0], alpha[1], alphadot[0], alphadot[1]
    alpha[0], alpha[1] = c * v - L * s * w, -(s * v + L * c * w) / h
    alphadot[0] = c * vdot - L * s * wdot - turning * (s * v + L * c * w)
    alphadot[1] = -(s * vdot + L * c * wdot + turning * (c * v - L * s * w)) / h
