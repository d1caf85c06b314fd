"""Is the PD loop alone stable when it is sampled? Judged before a run, on the linearised, held loop.

Linearised about the reference, with the torque held over a control period h: deviations
`d = [ex, ey, ephi; e; nu]` obey `d_next = (Phi + Gamma K) d`. A spectral radius above 1 means that the samples come
too slowly for the gains, whatever a network adds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from ..errors import ConfigError
from ..model.base import BY_SIZE
from ..model.robot import Robot
from ..signals import Array

TOLERANCE = 1e-9
LARGEST = 700.0  # exponents up to here have an exponential


@dataclass(frozen=True)
class SampledLoop:
    """Verdict on the sampled PD loop.

    Attributes:
        radius: Spectral radius of one control period; up to 1 is stable (exactly 1: something is not stabilised, such
            as the lateral error at vr = 0).
        gain_limits: (p,) gain on each velocity alone at which `nu_next = (Phi_ii - Gamma_ii k) nu` reaches -1, where
            without friction `Phi_ii = 1` and `Gamma_ii = h (M^-1)_ii`.
    """

    radius: float
    gain_limits: Array

    @property
    def stable(self) -> bool:
        """Whether no deviation grows."""
        return self.radius <= 1.0 + TOLERANCE


def sampled_loop(
    M: Array, gains: Array, v_ref: Array, base_gains: Array, K: Array, h: float, friction: Array | None = None
) -> SampledLoop:
    """Spectral radius of the held PD loop at one mass matrix and reference velocity.

    Args:
        M: (p, p) reduced mass matrix.
        gains: (p,) gain on `[z; r]`.
        v_ref: (nb,) reference velocity, (vr, wr) or (vxr, vyr, wr).
        base_gains: (3,) kx, ky, kth; of a holonomic base kx, ky, kphi.
        K: (n,) gain of the filtered arm error [1/s].
        h: Control period [s].
        friction: Viscous friction on nu, (p,) or a matrix (p, p); None for none.
    """
    held = held_loop(M, v_ref, base_gains, K, h, friction)
    if held is None:
        return SampledLoop(np.inf, 2.0 / (h * np.diag(np.linalg.inv(M))))
    radius = float(np.abs(np.linalg.eigvals(held.closed(gains))).max())
    nu = slice(len(held.state) - len(M), len(held.state))
    limits = (1.0 + np.diag(held.state)[nu]) / np.diag(held.torque[nu])
    return SampledLoop(radius, limits)


@dataclass(frozen=True, eq=False)
class HeldLoop:
    """One control period of the linearised loop: `d_next = state d + torque tau`, and `s = errors d`.

    Attributes:
        state: (k, k).
        torque: (k, p): what a torque held over the period does.
        errors: (p, k): `[z; r]` of a deviation.
    """

    state: Array
    torque: Array
    errors: Array

    def closed(self, gains: Array) -> Array:
        """(k, k) with the torque `gains s`, gains (p,)."""
        return self.state + self.torque @ (gains[:, None] * self.errors)


def held_loop(
    M: Array, v_ref: Array, base_gains: Array, K: Array, h: float, friction: Array | None = None
) -> HeldLoop | None:
    """The linearised loop over one period, arguments as in `sampled_loop`; None where it moves too fast to compute."""
    p, nb = len(M), len(v_ref)
    poses, n = (3 if nb else 0), len(M) - len(v_ref)
    size = poses + n + p
    A, B, errors = np.zeros((size, size)), np.zeros((size, p)), np.zeros((p, size))
    nu = slice(poses + n, size)
    M_inv = np.linalg.inv(M)
    B[nu] = M_inv
    of_base = slice(poses + n, poses + n + nb)
    A[:poses, :poses], A[:poses, of_base], errors[:nb, :poses] = BY_SIZE[nb].linear_errors(v_ref, base_gains)
    A[poses : poses + n, poses + n + nb :] = -np.eye(n)
    errors[nb:, poses : poses + n] = np.diag(K)
    errors[:, nu] = -np.eye(p)
    if not (np.isfinite(A).all() and np.linalg.norm(A, 1) * h < LARGEST):
        return None
    if friction is not None:  # it damps: however large, its exponential is small
        A[nu, nu] = -M_inv @ (np.diag(friction) if np.ndim(friction) == 1 else friction)
    held = expm(np.block([[A, B], [np.zeros((p, size + p))]]) * h)
    return HeldLoop(held[:size, :size], held[:size, size:], errors)


def viscous_friction(robot: Robot) -> Array:
    """Viscous friction of a robot's joints and base on nu, (p, p); Coulomb friction has none once it slides."""
    return robot.T.T @ (robot.damping[:, None] * robot.T) + np.diag(robot.viscous)


def require_stable(verdict: SampledLoop, gains: Array, names: tuple[str, ...], h: float) -> None:
    """Refuse gains that make the sampled PD loop unstable.

    Raises:
        ConfigError: With the spectral radius and the gains that are too high.
    """
    if verdict.stable:
        return
    over = [
        f"{name}: {gain:.4g} (limit alone {limit:.4g})"
        for name, gain, limit in zip(names, gains, verdict.gain_limits, strict=True)
        if gain > 0.5 * limit
    ]
    raise ConfigError(
        f"the sampled PD loop is unstable: spectral radius {verdict.radius:.4g} > 1, the torque held for {h:g} s",
        why="gains near or above their limit, 2 / (h (M^-1)_ii) without friction: "
        + ("; ".join(over) or "none, the kinematic gains"),
        fix="lower the gains, or shorten the control or sensor period",
        key="feedback",
    )
