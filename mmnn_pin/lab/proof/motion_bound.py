"""How the energy of the errors, `E = s' M s / 2`, may change inside of a box of errors (docs/theory.md, section 4).

    Edot <= -s' (share k + viscous - sym(M Az) + Coriolis) s + s' u + constant

u is what drives s: the reference's Psi, what the errors of pose and arm add to it, friction, the network (any output
within its bound) and the disturbance; `share` and `constant` are what the hold of the torque over a period takes.
With K the matrix in brackets, R = (K - rate M)^-1 and |u|_R = sqrt(u' R u)

    Edot <= -2 rate E + |u|_R^2 / 4 + constant        for every rate with K - rate M > 0

so that E falls while it is above `(|u|_R^2 / 4 + constant) / (2 rate)`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...signals import Array
from .motion_samples import MotionSamples
from .pose_bound import PoseBound, PoseSet

SPENT = (0.03, 0.1, 0.3)  # of the feedback, on what the hold lets pass
SHARES = np.array([0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.85])  # of the largest rate


@dataclass(frozen=True, eq=False)
class Gains:
    """What the controller does, in numbers.

    Attributes:
        lower: (p,) smallest gain on s [N s/m, N m s]: it dissipates.
        upper: (p,) largest gain on s: held, it overshoots.
        network: (p,) largest |Psi_hat| [N, N m].
        K: (n,) of the filtered arm error [1/s].
        disturbance: (p,) largest external force [N, N m].
        period: Control period [s].
    """

    lower: Array
    upper: Array
    network: Array
    K: Array
    disturbance: Array
    period: float


@dataclass(frozen=True, eq=False)
class Drive:
    """What the errors of a box do to the reference velocity and acceleration, at s = 0.

    Attributes:
        nu: (p,) largest difference between nu_ref and the reference's own velocity.
        nudot: (2,) the same of the base's part of nudot_ref.
        arm: Size b of the arm errors, `sqrt(e' N e)`, which add `-K^2 e` to the arm's part of nudot_ref.
        middle: (p, p) middle of `Az = d nudot_ref / d s` over the box.
        half: (p, p) half-widths of its entries.
    """

    nu: Array
    nudot: Array
    arm: float
    middle: Array
    half: Array


def drive(
    pose: PoseBound,
    reach: PoseSet,
    arm: float,
    joints: Array,
    K: Array,
    a_ref: Array,
    drift: tuple[float, float] = (0.0, 0.0),
) -> Drive:
    """For pose errors, a size of the arm errors and with it |e_i| up to joints (n,), and a reference that drifts."""
    away, turning = drift
    fastest, flat = pose.fastest, 1 - reach.cosine
    turn, side = fastest * reach.turn, fastest * reach.sine
    yaw, (v_dot, _) = pose.turning + turn, np.abs(a_ref).max(axis=0)
    forward = fastest * flat + pose.kx * reach.ex
    ex_dot, ey_dot = yaw * reach.ey + pose.kx * reach.ex, yaw * reach.ex + side
    v = v_dot * flat + side * turn + pose.kx * ex_dot
    w = pose.ky * (v_dot * reach.ey + fastest * ey_dot) + pose.kth * (v_dot * reach.sine + fastest * turn)
    v += pose.kx * away + side * turning
    w += fastest * (pose.ky * away + pose.kth * turning)
    nu = np.concatenate(([forward, turn], K * joints))
    return Drive(nu, np.array([v, w]), arm, *input_matrix(pose, reach, K))


def input_matrix(pose: PoseBound, reach: PoseSet, K: Array) -> tuple[Array, Array]:
    """Middle and half-width, (p, p) each, of `Az = d nudot_ref / d s`.

    Of the base `[[kx, -kx ey - vr sin ephi], [0, ky vr ex + kth vr cos ephi]]`, of the arm `diag(K)`.
    """
    p = 2 + len(K)
    middle, half = np.zeros((p, p)), np.zeros((p, p))
    middle[0, 0] = pose.kx
    middle[2:, 2:] = np.diag(K)
    half[0, 1] = pose.kx * reach.ey + pose.fastest * reach.sine
    low, high = pose.kth * pose.slowest * reach.cosine, pose.kth * pose.fastest
    middle[1, 1] = (low + high) / 2
    half[1, 1] = (high - low) / 2 + pose.ky * pose.fastest * reach.ex
    return middle, half


@dataclass(frozen=True, eq=False)
class MotionBound:
    """The energy of the errors in one box.

    Attributes:
        rate: Rate of decay used [1/s]; nan where there is none.
        level: Energy above which E falls [J]; inf where there is none.
        margin: Largest possible rate, `min of s' K s / s' M s` [1/s].
        unheld: The same for a torque that is not held; negative: the feedback is too weak for the kinematic gains.
        fastest: Largest eigenvalue of M^-1 k [1/s]; the period has to be below half its inverse.
        pushed: Largest `|d s / dt|` that is not the feedback's, in the norm of k [sqrt(W/s)].
    """

    rate: float
    level: float
    margin: float
    unheld: float
    fastest: float
    pushed: float


def motion_bound(samples: MotionSamples, added: Drive, energy: float, gains: Gains) -> MotionBound:
    """The energy of the errors in a box of pose errors, arm errors and energies up to `energy`."""
    forces = Forces.of(samples, added, gains)
    pushed, fastest = push(samples, added, forces, energy, gains), samples.fastest(gains.upper)
    held = fastest * gains.period
    grip = held / (1 - held) if held < 1 else np.inf
    delay = gains.period / (1 - held) * pushed if held < 1 else np.inf
    unheld = settle(samples, added, forces, gains, 1.0, np.inf)[2]
    best = MotionBound(np.nan, np.inf, -np.inf, unheld, fastest, pushed)
    for spent in SPENT:
        share = 1 - grip - spent
        constant = delay**2 / (4 * spent) if share > 0 else np.inf  # nothing is left of the feedback
        rate, level, margin = settle(samples, added, forces, gains, max(share, -1.0), constant)
        if level < best.level or (np.isinf(level) and np.isinf(best.level) and margin > best.margin):
            best = MotionBound(rate, level, margin, unheld, fastest, pushed)
    return best


@dataclass(frozen=True, eq=False)
class Forces:
    """What drives s in a box, apart from the accelerations that the errors add.

    Attributes:
        centre: (N, p) Psi along the reference without any error; what it is, not how large.
        around: (N, p) how far the rest may take it, per component: Coriolis and friction of the errors, dry friction,
            network, disturbance.
    """

    centre: Array
    around: Array

    @classmethod
    def of(cls, samples: MotionSamples, added: Drive, gains: Gains) -> Forces:
        """In one box."""
        nu, nudot, C = samples.along.nu, samples.along.nudot, np.abs(samples.coriolis)
        centre = np.einsum("nij,nj->ni", samples.M, nudot) + samples.gravity + nu @ samples.viscous.T
        centre += np.einsum("nijk,nj,nk->ni", samples.coriolis, nu, nu)
        speed = np.abs(nu)
        around = np.einsum("nijk,j,nk->ni", C, added.nu, speed) + np.einsum("nijk,nj,k->ni", C, speed, added.nu)
        around += np.einsum("nijk,j,k->ni", C, added.nu, added.nu) + np.abs(samples.viscous) @ added.nu
        return cls(centre, around + samples.dry + gains.network + gains.disturbance)


def settle(
    samples: MotionSamples, added: Drive, forces: Forces, gains: Gains, share: float, constant: float
) -> tuple[float, float, float]:
    """Rate, level and margin where `share` of the feedback is left by the hold, which adds `constant` [W]."""
    K, lost = dissipation(samples, added, share * gains.lower)
    L = samples.root_inverse
    margin = float((np.linalg.eigvalsh(L @ K @ L.swapaxes(1, 2))[:, 0] - lost).min())
    if not margin > 0 or not (np.isfinite(forces.around).all() and np.isfinite(constant)):
        return np.nan, np.inf, margin
    rates = margin * SHARES
    R = np.linalg.inv(K[None] - (rates[:, None] + lost)[..., None, None] * samples.M)  # (r, N, p, p)
    MRM = samples.M @ R @ samples.M
    size = np.sqrt(np.einsum("ni,rnij,nj->rn", forces.centre, R, forces.centre))
    size += np.sqrt(np.einsum("ni,rnij,nj->rn", forces.around, np.abs(R), forces.around))
    size += np.sqrt(np.einsum("i,rnij,j->rn", added.nudot, np.abs(MRM[..., :2, :2]), added.nudot))
    if len(gains.K):
        scaled = samples.arm_root * (gains.K**2)[:, None]  # K^2 e = scaled y, |y| <= b
        size += added.arm * np.sqrt(np.linalg.eigvalsh(scaled.T @ MRM[..., 2:, 2:] @ scaled)[..., -1])
    powers = (size**2).max(axis=1) / 4 + constant
    best = int(np.argmin(powers / rates))
    return float(rates[best]), float(powers[best] / (2 * rates[best])), margin


def push(samples: MotionSamples, added: Drive, forces: Forces, energy: float, gains: Gains) -> float:
    """Largest `|d s / dt|` in a box in the norm of the gains, without what the feedback does to it."""
    s, nu, C = np.sqrt(2 * energy * samples.lightest), np.abs(samples.along.nu) + added.nu, np.abs(samples.coriolis)
    if not (np.isfinite(forces.around).all() and np.isfinite(gains.upper).all()):
        return np.inf
    root = np.sqrt(gains.upper)
    centre = np.linalg.solve(samples.M, forces.centre[..., None])[..., 0]
    moved = forces.around + np.abs(samples.viscous) @ s
    moved += np.einsum("nijk,j,nk->ni", C, s, nu) + np.einsum("nijk,nj,k->ni", C, nu + s, s)
    around = (np.abs(samples.M_inverse) @ moved[..., None])[..., 0] + added.half @ s
    around[:, :2] += added.nudot
    size = np.linalg.norm(root * centre, axis=1) + np.linalg.norm(root * around, axis=1)
    own = (root[:, None] * added.middle) @ samples.root_inverse.swapaxes(1, 2)
    size += np.sqrt(2 * energy) * np.linalg.norm(own, ord=2, axis=(1, 2))
    if len(gains.K):
        size += added.arm * np.linalg.norm(root[2:, None] * (gains.K**2)[:, None] * samples.arm_root, ord=2)
    return float(size.max())


def dissipation(samples: MotionSamples, added: Drive, gain: Array) -> tuple[Array, Array]:
    """K (N, p, p) in the middle of the box, and the rates (N,) that the rest of the box may take from it, times M."""
    driven = np.einsum("nij,jk->nik", samples.M, added.middle)
    coriolis = np.einsum("nijk,nk->nij", samples.coriolis, samples.along.nu)  # s' C(q, s) nu as s' (.) s
    K = np.diag(gain) + samples.viscous - driven + coriolis
    lost = np.einsum("nik,ik->n", samples.shears, added.half) + samples.gyration @ added.nu
    return (K + K.swapaxes(1, 2)) / 2, lost
