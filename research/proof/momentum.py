"""What drives the pose of the base in the mean, inside of a box that no motion leaves: theory.md, section 5.

One energy allows the heavy base as much of it as the light joints need, so that |z| may be large. But it cannot stay:
with `k s = u - d/dt (M s)`, u all forces but the feedback, and `C' s` of M's change, the pose moved by `(M s)_i / k_i`
is driven by `u_i / k_i` in place of z_i.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mmnn_pin.signals import Array

from .cover import Cover
from .motion_bound import Drive, Forces, Gains
from .postures import norm


@dataclass(frozen=True, eq=False)
class Momentum:
    """Of the base, forward and yaw, at most."""

    drive: Array  # (2,) `u_i / k_i` [m/s, rad/s]
    moved: Array  # (2,) `(M s)_i / k_i` [m, rad]

    @classmethod
    def of(cls, cover: Cover, added: Drive, energy: float, gains: Gains, s: Array) -> Momentum | None:
        """In a box of energies, with |s_i| up to s (p,); None where forces have no bound."""
        forces = Forces.of(cover, added, energy, gains)
        if not (
            np.isfinite(gains.upper).all() and np.isfinite(forces.amounts).all() and np.isfinite(forces.slack).all()
        ):
            return None
        L, back, low, base = cover.L, cover.L_inv.swapaxes(1, 2), cover.low, slice(0, 2)
        own, vary, k = cover.postures.coriolis, cover.postures.coriolis_off, gains.lower[base]
        speed = np.abs(cover.nu) + cover.nu_off + added.nu + s
        size = np.sqrt(2 * energy / low)  # of L' s
        # how far s is from that of the sample in force
        rows, feed = back[:, base], gains.upper * s
        length = np.linalg.norm(rows, axis=2)
        turned = np.einsum("nqjk,nj,k->nq", np.abs(np.einsum("nqi,nijk->nqjk", rows, cover.coriolis)), speed, s)
        gyration = (np.linalg.norm(cover.coriolis, axis=1) + vary).swapaxes(1, 2) @ speed[..., None]
        fed = np.linalg.norm(cover.L_inv * feed, axis=1).sum(axis=1)
        wide = alike(cover, added, forces, s) + (gyration[..., 0] @ s) + fed
        rate = along(rows, cover, added, forces, s) + turned + np.abs(rows @ cover.L_inv) @ feed
        rate += length * ((cover.mass_off * wide + np.einsum("njk,nj,k->n", vary, speed, s)) / low)[:, None]
        # forces on the base, what its own feedback lags behind, and C' s
        push = along(L[:, base], cover, added, forces, s) + gains.upper[base] * gains.oldest * rate
        push += (gains.upper - gains.lower)[base] * s[base]
        push += np.einsum("nkji,nj,k->ni", np.abs(own[..., base]), speed, s)
        push += size[:, None] * np.einsum("nji,nj->ni", vary[..., base], speed)
        most = np.einsum("nii->ni", cover.postures.M)[:, base] * cover.high[:, None]
        return cls((push / k).max(axis=0), (np.sqrt(2 * energy * most) / k).max(axis=0))


def along(rows: Array, cover: Cover, added: Drive, forces: Forces, s: Array) -> Array:
    """(N, q) largest of rows (N, q, p) times all normalised forces but the feedback and `C(nu) s`, in the box."""
    length, Lt = np.linalg.norm(rows, axis=2), cover.L.swapaxes(1, 2)
    found = (
        np.abs(np.einsum("nqi,ni->nq", rows, forces.still + forces.moved)) + np.abs(rows @ forces.ways) @ forces.amounts
    )
    found += length * (forces.slack + forces.jolt)[:, None]
    if forces.arm.shape[2]:
        found += forces.arm_size * np.linalg.norm(rows @ forces.arm, axis=2)
        found += length * (cover.mass_off * forces.arm_size * norm(forces.arm))[:, None]
    # of s: C(s) nu_ref, friction, M Az s
    about, fed = np.abs(cover.nu) + cover.nu_off + added.nu, (np.abs(added.middle) + added.half) @ s
    found += np.einsum("nqjk,j,nk->nq", np.abs(np.einsum("nqi,nijk->nqjk", rows, cover.coriolis)), s, about)
    found += length * np.einsum("njk,j,nk->n", cover.postures.coriolis_off, s, about)[:, None]
    found += np.abs(rows @ cover.L_inv @ cover.viscous) @ s + np.abs(rows @ Lt) @ fed
    return np.asarray(found + length * (cover.mass_off * (np.linalg.norm(Lt, axis=1) @ fed))[:, None])


def alike(cover: Cover, added: Drive, forces: Forces, s: Array) -> Array:
    """(N,) largest length of the same forces."""
    Lt, about = cover.L.swapaxes(1, 2), np.abs(cover.nu) + cover.nu_off + added.nu
    fed = (np.abs(added.middle) + added.half) @ s
    found = np.linalg.norm(forces.still + forces.moved, axis=1) + np.linalg.norm(forces.ways, axis=1) @ forces.amounts
    found += forces.slack + forces.jolt
    if forces.arm.shape[2]:
        found += cover.high * forces.arm_size * norm(forces.arm)
    turned = np.linalg.norm(cover.coriolis, axis=1) + cover.postures.coriolis_off
    found += np.einsum("njk,j,nk->n", turned, s, about) + np.linalg.norm(cover.L_inv @ cover.viscous, axis=1) @ s
    return np.asarray(found + cover.high * (np.linalg.norm(Lt, axis=1) @ fed))
