"""How the energy of errors, `E = s' M s / 2`, may change in a box of errors (docs/explanation/theory.md, section 4).

    Edot <= -s' (share k + viscous - sym(M Az) + Coriolis) s + s' u + constant

u is what drives s: the reference's Psi, what the errors of pose and arm add to it, friction, the network (any output
within its bound) and the disturbance; `share` and `constant` are what the hold of the torque over a period takes.
With K the matrix in brackets, R = (K - rate M)^-1 and |u|_R = sqrt(u' R u)

    Edot <= -2 rate E + |u|_R^2 / 4 + constant        for every rate with K - rate M > 0

so that E falls while it is above `(|u|_R^2 / 4 + constant) / (2 rate)`.

Mass, Coriolis and gravity terms are those of the robot *sampled* along its reference, the arm's configuration off it by
an offset in a box, the corners first. What follows from them holds for these configurations, not for all between.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product

import numpy as np

from ...loop.before_run import viscous_friction
from ...model.dynamics import Dynamics
from ...model.robot import Robot
from ...signals import Array, IntArray
from .bounds import PoseBound, PoseSet

SAMPLES = 240
SPENT = (0.03, 0.1, 0.3)  # of the feedback, on what the hold lets pass
BACK = 4  # samples that late commands are followed back
SHARES = np.array([0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.85])  # of the largest rate


@dataclass(frozen=True, eq=False)
class MotionBound:
    """The energy of the errors in one box.

    Attributes:
        rate: Rate of decay used [1/s]; nan where there is none.
        level: Energy above which E falls [J]; inf where there is none.
        margin: Largest possible rate, `min of s' K s / s' M s` [1/s].
        unheld: The same for a torque that is not held; negative: the feedback is too weak for the kinematic gains.
        fastest: Largest eigenvalue of M^-1 k [1/s]; the period has to be below half its inverse, or the oldest sample
            in force, where commands are late, below its inverse.
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
    unheld = settle(samples, added, forces, gains, 1.0, np.inf)[2]
    best = MotionBound(np.nan, np.inf, -np.inf, unheld, fastest, pushed)
    for (grip, delay), spent in product(stale(gains, fastest, pushed, energy), SPENT):
        share = 1 - grip - spent
        constant = delay**2 / (4 * spent) if share > 0 else np.inf  # nothing is left of the feedback
        rate, level, margin = settle(samples, added, forces, gains, max(share, -1.0), constant)
        if level < best.level or (np.isinf(level) and np.isinf(best.level) and margin > best.margin):
            best = MotionBound(rate, level, margin, unheld, fastest, pushed)
    return best


def stale(gains: Gains, fastest: float, pushed: float, energy: float) -> list[tuple[float, float]]:
    """Pairs (grip, rest), each with `|s - s_in_force| <= grip |s| + rest` in the norm of the gains.

    Where commands are late, samples are followed back one after the other, and of the last one it is only known that it
    was in the box, whose energy is at most `energy`.
    """
    held = fastest * gains.oldest
    if not np.isfinite(held * pushed):
        return [(np.inf, np.inf)]
    if not gains.late > 0:
        return [(held / (1 - held), gains.period / (1 - held) * pushed)] if held < 1 else [(np.inf, np.inf)]
    result = []
    for last in range(BACK):
        grip, rest = 0.0, np.sqrt(2 * energy * fastest)  # of the sample: |s_i| <= grip |s| + rest
        for n in range(last + 1, 1, -1):
            grip, rest = 1 + n * held * grip, n * (held * rest + gains.oldest * pushed)
        result.append((held * grip, held * rest + gains.oldest * pushed))
    return result


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
    K = np.diag(gain) + samples.viscous - driven + np.einsum("nijk,nk->nij", samples.coriolis, samples.along.nu)
    lost = np.einsum("nik,ik->n", samples.shears, added.half) + samples.gyration @ added.nu
    return (K + K.swapaxes(1, 2)) / 2, lost


@dataclass(frozen=True, eq=False)
class Gains:
    """What the controller does, in numbers.

    Attributes:
        lower: (p,) smallest gain on s [N s/m, N m s]: it dissipates.
        upper: (p,) largest gain on s: held, it overshoots.
        network: (p,) largest |Psi_hat| [N, N m].
        K: (n,) of the filtered arm error [1/s].
        disturbance: (p,) largest external force, noise times the gains included [N, N m].
        period: Control period [s].
        late: Largest time from a sample to when its command is in force [s].
    """

    lower: Array
    upper: Array
    network: Array
    K: Array
    disturbance: Array
    period: float
    late: float = 0.0

    @property
    def oldest(self) -> float:
        """Largest age of the sample whose command is in force [s]."""
        return self.period + self.late


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
    return Drive(np.concatenate(([forward, turn], K * joints)), np.array([v, w]), arm, *input_matrix(pose, reach, K))


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
class Along:
    """A reference at N instants.

    Attributes:
        v_ref: (N, 2) vr, wr [m/s, rad/s].
        a_ref: (N, 2) their derivatives.
        q_ref: (N, n) [rad or m].
        qdot_ref: (N, n).
        qddot_ref: (N, n).
        pose_ref: (N, 3) [m, m, rad].
    """

    v_ref: Array
    a_ref: Array
    q_ref: Array
    qdot_ref: Array
    qddot_ref: Array
    pose_ref: Array

    def at(self, places: IntArray) -> Along:
        """The reference at some of the instants."""
        return Along(*(getattr(self, name)[places] for name in self.__dataclass_fields__))

    @property
    def nu(self) -> Array:
        """Velocities without any error, (N, p)."""
        return np.concatenate((self.v_ref, self.qdot_ref), axis=1)

    @property
    def nudot(self) -> Array:
        """Accelerations without any error, (N, p)."""
        return np.concatenate((self.a_ref, self.qddot_ref), axis=1)


@dataclass(frozen=True, eq=False)
class MotionSamples:
    """Terms of the reduced dynamics at N instants of a reference.

    Args:
        along: The reference there.
        q: (N, n) the arm's configurations, off the reference by up to `spread` [rad or m].
        M: (N, p, p) mass matrices.
        coriolis: (N, p, p, p): `C(q, nu)_ik = sum_j coriolis_ijk nu_j`.
        gravity: (N, p).
        viscous: (p, p) viscous friction on nu, positive semi-definite.
        dry: (p,) largest dry friction on nu.
        spread: (n,) half-width of the box of the arm's offsets from the reference [rad or m].
        decoupled: Whether the size of arm errors counts every joint by itself, see `arm_metric`.
    """

    along: Along
    q: Array
    M: Array
    coriolis: Array
    gravity: Array
    viscous: Array
    dry: Array
    spread: Array
    decoupled: bool = False
    root_inverse: Array = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "root_inverse", np.linalg.inv(np.linalg.cholesky(self.M)))

    def thinned(self, step: int) -> MotionSamples:
        """Every step-th sample."""
        keep = np.arange(0, len(self.M), step)
        M, C, gravity = self.M[keep], self.coriolis[keep], self.gravity[keep]
        return replace(self, along=self.along.at(keep), q=self.q[keep], M=M, coriolis=C, gravity=gravity)

    @cached_property
    def M_inverse(self) -> Array:
        """(N, p, p)."""
        return np.asarray(np.linalg.inv(self.M))

    @cached_property
    def lightest(self) -> Array:
        """(p,) largest `(M^-1)_ii`: an energy E of the errors allows `|s_i| <= sqrt(2 E (M^-1)_ii)`."""
        return np.asarray(np.einsum("nii->ni", self.M_inverse).max(axis=0))

    def fastest(self, gain: Array) -> float:
        """Largest eigenvalue of `M^-1 diag(gain)` [1/s]; inf for gains (p,) without bound."""
        if not np.isfinite(gain).all():
            return np.inf
        L = self.root_inverse
        return float(np.linalg.eigvalsh(L * gain @ L.swapaxes(1, 2)).max())

    @cached_property
    def arm_metric(self) -> Array:
        """N (n, n): the size of an arm error e is `sqrt(e' N e)`.

        The arm's inertia with the base free; `decoupled` the inverse of what is on the diagonal of its inverse.
        """
        mean = self.M_inverse[:, 2:, 2:].mean(axis=0)
        return np.diag(1 / np.diag(mean)) if self.decoupled else np.asarray(np.linalg.inv(mean))

    @cached_property
    def arm_root(self) -> Array:
        """(n, n): `e = arm_root y` with |y| the size of e."""
        return np.linalg.inv(np.linalg.cholesky(self.arm_metric)).T

    @cached_property
    def joint_reach(self) -> Array:
        """(n,) largest |e_i| for a size of 1."""
        return np.linalg.norm(self.arm_root, axis=1)

    @cached_property
    def arm_gain(self) -> float:
        """Largest `|r|_N / sqrt(s' M s)`."""
        if not self.M.shape[1] > 2:
            return 0.0
        root = np.linalg.cholesky(self.arm_metric)
        return float(np.sqrt(np.linalg.eigvalsh(root.T @ self.M_inverse[:, 2:, 2:] @ root).max()))

    def arm_decay(self, K: Array) -> float:
        """Rate at which the size of the arm errors decays for r = 0 [1/s]: of `e' N e`, with edot = r - K e, K (n,)."""
        N = self.arm_metric
        if not len(N):
            return np.inf
        L, NK = np.linalg.inv(np.linalg.cholesky(N)), N * K
        return float(np.linalg.eigvalsh(L @ (NK + NK.T) @ L.T / 2)[0])

    @cached_property
    def gyration(self) -> Array:
        """(N, p) rates: `|s' C(q, s) e_k| <= gyration_k s' M s`."""
        return self.rate(self.coriolis.transpose(0, 3, 1, 2))

    @cached_property
    def shears(self) -> Array:
        """(N, p, p) rates: `|s' M E_ik s| <= shears_ik s' M s`, E_ik the matrix with a single 1."""
        p = self.M.shape[1]
        return self.rate(np.einsum("nij,ujk->nuik", self.M, np.eye(p * p).reshape(p * p, p, p))).reshape(-1, p, p)

    def rate(self, X: Array) -> Array:
        """Largest `|s' X s| / s' M s` of matrices (N, k, p, p); (N, k) [1/s]."""
        L = self.root_inverse[:, None]
        return np.asarray(np.abs(np.linalg.eigvalsh(L @ ((X + X.swapaxes(2, 3)) / 2) @ L.swapaxes(2, 3))).max(axis=-1))


def sample(robot: Robot, along: Along, spread: Array, seed: int = 0, samples: int = SAMPLES) -> MotionSamples:
    """Terms along a whole reference (T instants), `samples` of them, the arm spread around it."""
    rng, n, dynamics = np.random.default_rng(seed), robot.dimensions.arm, Dynamics(robot)
    places = np.unique(np.linspace(0, len(along.v_ref) - 1, samples).astype(int))
    places = np.resize(places, samples)  # a short reference is sampled again with other offsets
    offsets = rng.uniform(-1, 1, (samples, n))
    offsets[: samples * 3 // 4] = np.where(offsets[: samples * 3 // 4] < 0, -1.0, 1.0)
    offsets[::4] = 0.0
    rng.shuffle(offsets)
    here, p = along.at(places), robot.dimensions.dof
    M, C, g = np.zeros((samples, p, p)), np.zeros((samples, p, p, p)), np.zeros((samples, p))
    position = robot.neutral_position()
    for k in range(samples):
        position[robot.arm_index] = here.q_ref[k] + offsets[k] * spread
        placed = robot.follow(position)
        M[k], g[k] = dynamics.mass_matrix(placed), dynamics.gravity(placed)
        for j, unit in enumerate(np.eye(p)):
            C[k, :, j, :] = dynamics.coriolis_matrix(placed, unit)
    dry = np.abs(robot.T).T @ robot.dry[:, :2].sum(axis=1)
    return MotionSamples(here, here.q_ref + offsets * spread, M, C, g, viscous_friction(robot), dry, spread)
