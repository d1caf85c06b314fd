"""How the energy of errors, `E = s' M s / 2`, may change in a box of errors (docs/explanation/theory.md, section 4).

    Edot <= -s' (share k + viscous - sym(M Az) + Coriolis) s + s' u + constant

u is what drives s: the reference's Psi, what the errors of pose and arm add to it, friction, the network (any output
within its bound) and the disturbance; `share` and `constant` are what the hold of the torque over a period takes.
With K the matrix in brackets, R = (K - rate M)^-1 and |u|_R = sqrt(u' R u)

    Edot <= -2 rate E + |u|_R^2 / 4 + constant        for every rate with K - rate M > 0

so that E falls while it is above `(|u|_R^2 / 4 + constant) / (2 rate)`.

Mass, Coriolis and gravity terms are those of a *cover*: boxes of joint positions that together hold all that the arm
may reach while its errors are within theirs, over stretches of the reference that together are all of it. In each the
terms are known in the middle and bounded elsewhere (`postures`), in coordinates in which M of the middle, `M0 = L L'`,
is the identity: `x = L' s`, forces `L^-1 u`. Vectors of which only amounts are known add up at the signs that are worst
for the metric at hand; all else that a place of the box may have otherwise than its middle adds by its length.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise, product

import numpy as np

from ...loop.before_run import viscous_friction
from ...model.dynamics import Dynamics
from ...model.robot import Robot
from ...signals import Array
from .bounds import PoseBound, PoseSet
from .postures import Bodies, Postures, norm

STRETCHES = 120  # of the reference, at most
EFFORT, FEWEST = 20000, 160  # boxes of a cover times p^2; boxes of any cover
FEW = 50  # boxes for a first look
BENT = 0.03  # of M, up to which a box is not cut in two
METRICS = 60  # instants of the reference, in which a metric of arm errors is looked for
SPENT = (0.03, 0.1, 0.3)  # of the feedback, on what the hold lets pass
BACK = 4  # samples that late commands are followed back
SHARES = np.array([0.05, 0.15, 0.3, 0.4, 0.5, 0.6, 0.75])  # of the largest rate


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


def motion_bound(cover: Cover, added: Drive, energy: float, gains: Gains) -> MotionBound:
    """The energy of the errors in a box of pose errors, arm errors and energies up to `energy`."""
    forces, feed = Forces.of(cover, added, energy, gains), Feed.of(cover, added)
    pushed, fastest = push(cover, added, forces, energy, gains), cover.fastest(gains.upper)
    unheld = settle(cover, feed, forces, gains, 1.0, np.inf)[2]
    best = MotionBound(np.nan, np.inf, -np.inf, unheld, fastest, pushed)
    for (grip, delay), spent in product(stale(gains, fastest, pushed, energy), SPENT):
        share = 1 - grip - spent
        constant = delay**2 / (4 * spent) if share > 0 else np.inf  # nothing is left of the feedback
        rate, level, margin = settle(cover, feed, forces, gains, max(share, -1.0), constant)
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
    """What drives s in a box, normalised: `L^-1 u` is a centre, ways with amounts and any sign, and a rest's length.

    Attributes:
        still: (N, p) Psi along the reference without any error and without M nudot.
        moved: (N, p) M nudot along the reference.
        ways: (N, p, 3 p) what an error of nu_ref does to Coriolis terms and friction; a force on a velocity; an
            acceleration of nu_ref.
        amounts: (3 p,) how much of each: errors of nu_ref; dry friction, network and disturbance; accelerations.
        slack: (N,) the rest but for accelerations.
        jolt: (N,) the rest of accelerations: `(M - M0) nudot` and how the reference's varies.
        arm: (N, p, n) M times the accelerations that arm errors of size 1 add.
        arm_size: Size of the arm errors.
    """

    still: Array
    moved: Array
    ways: Array
    amounts: Array
    slack: Array
    jolt: Array
    arm: Array
    arm_size: float

    @classmethod
    def of(cls, cover: Cover, added: Drive, energy: float, gains: Gains) -> Forces:
        """In one box, energies up to `energy`."""
        L, L_inv, off, own = cover.L, cover.L_inv, cover.postures, cover.coriolis
        nu, about = cover.nu, cover.nu_off
        speed, Lt = np.abs(nu) + about, L.swapaxes(1, 2)
        pulled = np.einsum("nijk,nk->nij", own, nu)
        turned = np.einsum("nijk,nj->nik", own, nu) + L_inv @ cover.viscous
        still, slack = (turned @ nu[..., None])[..., 0], off.gravity_off
        if gains.weighs:
            slack = cover.old_gravity(added.nu, energy, gains.oldest)
        else:
            still = still + (L_inv @ off.gravity[..., None])[..., 0]
        p, a = nu.shape[1], added.nu
        by_error = pulled + turned
        ways = np.concatenate((by_error, L_inv, Lt), axis=2)
        nudot = np.zeros(p)
        nudot[:2] = added.nudot
        amounts = np.concatenate((a, cover.dry + gains.network + gains.disturbance, nudot))
        length = np.linalg.norm(own, axis=1)
        slack = slack + np.einsum("njk,nj,nk->n", off.coriolis_off, speed + a, speed + a)
        slack += np.einsum("njk,nj,nk->n", length, about + a, about + a)
        slack += np.einsum("nk,nk->n", np.linalg.norm(by_error, axis=1), about)
        accelerations = np.einsum("nij,nj->ni", Lt, cover.nudot)
        heavy = np.linalg.norm(Lt, axis=1)
        jolt = cover.mass_off * (np.linalg.norm(accelerations, axis=1) + heavy @ nudot)
        jolt += cover.high * np.einsum("ni,ni->n", heavy, cover.nudot_off)
        arm = Lt[:, :, p - len(gains.K) :] @ (gains.K[:, None] ** 2 * cover.metric.root)
        return cls(still, accelerations, ways, amounts, slack, jolt, arm, added.arm)

    def size(self, cover: Cover, V: Array, weights: Array) -> Array:
        """(..., N) largest `|u|_R`, normalised, for `R = V diag(weights) V'`; V (N, p, p), weights (..., N, p)."""
        widest = np.sqrt(weights.max(axis=-1))
        Vt = V.swapaxes(1, 2)
        centre = np.einsum("nij,nj->ni", Vt, self.still + self.moved)
        size = np.sqrt((weights * centre**2).sum(axis=-1))
        size = size + spread(Vt @ self.ways, weights, self.amounts)
        if self.arm.shape[2]:
            arm = Vt @ self.arm
            size += self.arm_size * np.sqrt(
                np.linalg.eigvalsh(np.einsum("nia,...ni,nib->...nab", arm, weights, arm))[..., -1]
            )
            size += widest * cover.mass_off * self.arm_size * norm(self.arm)
        return np.asarray(size + widest * (self.slack + self.jolt))


def spread(ways: Array, weights: Array, amounts: Array) -> Array:
    """(..., N) largest `|sum a_k ways_k|`, `|a_k| <= amounts_k`, where squares of entries (N, p) count with weights."""
    acting = amounts > 0
    weighed = ways[:, :, acting] * amounts[acting] * np.sqrt(weights)[..., None]
    return np.asarray(np.sqrt(np.abs(weighed.swapaxes(-1, -2) @ weighed).sum(axis=(-1, -2))))


def settle(
    cover: Cover, feed: Feed, forces: Forces, gains: Gains, share: float, constant: float
) -> tuple[float, float, float]:
    """Rate, level and margin where `share` of the feedback is left by the hold, which adds `constant` [W]."""
    held = cover.L_inv * (share * gains.lower) @ cover.L_inv.swapaxes(1, 2)
    values, V = np.linalg.eigh(feed.K + held)
    values = values - feed.lost[:, None]
    least = values[:, 0]
    margin = float((least / np.where(least > 0, cover.high, cover.low)).min())
    if not margin > 0 or not (
        np.isfinite(forces.amounts).all() and np.isfinite(forces.slack).all() and np.isfinite(constant)
    ):
        return np.nan, np.inf, margin
    rates = margin * SHARES
    weights = 1 / (values - (rates[:, None] * cover.high)[..., None])  # (r, N, p)
    powers = (forces.size(cover, V, weights) ** 2).max(axis=1) / 4 + constant
    best = int(np.argmin(powers / rates))
    return float(rates[best]), float(powers[best] / (2 * rates[best])), margin


def drivers(cover: Cover, added: Drive, energy: float, gains: Gains, names: Sequence[str]) -> dict[str, float]:
    """What drives s in a box of errors, the most first: shares of the sum of their sizes in the metric of the feedback.

    Args:
        cover: Where the robot may be.
        added: What the errors do to the reference velocity.
        energy: Of the errors in velocity at most [J].
        gains: What the controller does.
        names: (p,) of the velocities.
    """
    forces, feed, p = Forces.of(cover, added, energy, gains), Feed.of(cover, added), len(names)
    held = cover.L_inv * gains.lower @ cover.L_inv.swapaxes(1, 2)
    values, V = np.linalg.eigh(feed.K + held)
    weights = 1 / np.maximum(values - feed.lost[:, None], 1e-3 * values[:, -1:])
    k = int(np.argmax(forces.size(cover, V, weights)))
    Vt, weights = V[k].T, weights[k]
    widest = float(np.sqrt(weights.max()))

    def size(force: Array) -> float:
        return float(np.sqrt(weights @ (Vt @ force) ** 2))

    weight = cover.L_inv[k] @ cover.postures.gravity[k] * (not gains.weighs)
    ways = np.array([size(way) for way in forces.ways[k].T]) * forces.amounts
    found = {"gravity": size(weight), "the reference's own motion": size(forces.still[k] + forces.moved[k] - weight)}
    shares = ways[p : 2 * p] / np.maximum(forces.amounts[p : 2 * p], 1e-300)
    given = {"dry friction": cover.dry, "the network": gains.network, "force or noise": gains.disturbance}
    for what, amounts in given.items():
        found |= {f"{what} on {name}": float(one) for name, one in zip(names, shares * amounts, strict=True)}
    arm = forces.arm_size * np.linalg.norm(np.sqrt(weights)[:, None] * (Vt @ forces.arm[k])) if len(gains.K) else 0.0
    found["errors of pose and arm"] = float(ways[:p].sum() + ways[2 * p :].sum() + arm)
    found["what terms may be off in a box of postures"] = widest * float(forces.slack[k] + forces.jolt[k])
    total = max(sum(found.values()), 1e-300)
    return {what: found[what] / total for what in sorted(found, key=lambda one: -found[one]) if found[what] > 0}


def push(cover: Cover, added: Drive, forces: Forces, energy: float, gains: Gains) -> float:
    """Largest `|d s / dt|` in a box in the norm of the gains, without what the feedback does to it."""
    if not (np.isfinite(forces.amounts).all() and np.isfinite(gains.upper).all()):
        return np.inf
    own, L_inv, off, low = cover.coriolis, cover.L_inv, cover.postures, cover.low
    p = len(added.nu)
    values, V = np.linalg.eigh(L_inv * gains.upper @ L_inv.swapaxes(1, 2))
    fastest, Vt, one = np.sqrt(values[:, -1]), V.swapaxes(1, 2), np.ones_like(values)
    size = np.sqrt(2 * energy / low)  # of s: |L' s|
    # forces, through M^-1 = L^-T (I + ...) L^-1
    force = slice(0, 2 * p)
    direct = np.sqrt((values * (Vt @ forces.still[..., None])[..., 0] ** 2).sum(axis=1))
    direct += spread(Vt @ forces.ways[:, :, force], values, forces.amounts[force])
    rest = np.linalg.norm(forces.still, axis=1) + spread(forces.ways[:, :, force], one, forces.amounts[force])
    # of s: C(s) nu_ref, C(nu_ref) s, C(s) s, friction
    by = L_inv.swapaxes(1, 2)
    nu, wide = cover.nu, cover.nu_off + added.nu
    turned = np.einsum("nijk,nk->nij", own, nu) + np.einsum("nijk,nj->nik", own, nu) + L_inv @ cover.viscous
    turned = turned @ by
    direct += size * norm(np.sqrt(values)[..., None] * (Vt @ turned))
    rest = cover.mass_off / low * (rest + size * norm(turned))
    sides = norm(np.einsum("nijk,njl->nkil", own, by)) + norm(np.einsum("nijk,nkl->njil", own, by))
    far = np.abs(L_inv)
    more = np.linalg.norm(far @ off.coriolis_off, axis=1) + np.linalg.norm(
        far @ off.coriolis_off.swapaxes(1, 2), axis=1
    )
    bent = np.einsum("nk,nk->n", sides, wide) + np.einsum("nk,nk->n", more, np.abs(nu) + wide)
    s = size[:, None] * np.linalg.norm(L_inv, axis=1)
    both = np.linalg.norm(own, axis=1) + off.coriolis_off
    bent = size * bent + np.einsum("njk,nj,nk->n", both, s, s) + forces.slack
    total = direct + fastest * (rest + bent / low)
    # accelerations of nu_ref
    root = np.sqrt(gains.upper)
    nudot = np.zeros(p)
    nudot[:2] = added.nudot
    total += np.linalg.norm(root * cover.nudot, axis=1)
    total += np.linalg.norm(root * (cover.nudot_off + nudot + s @ added.half.T), axis=1)
    total += size * norm((root[:, None] * added.middle) @ by)
    if len(gains.K):
        total += added.arm * np.linalg.norm(root[2:, None] * (gains.K**2)[:, None] * cover.metric.root, ord=2)
    return float(total.max())


@dataclass(frozen=True, eq=False)
class Feed:
    """The quadratic form in s but for the feedback, normalised.

    Attributes:
        K: (N, p, p) of `viscous - sym(M Az) + sym(C(., nu_ref))` in the middle of the box.
        lost: (N,) what it may have less elsewhere.
    """

    K: Array
    lost: Array

    @classmethod
    def of(cls, cover: Cover, added: Drive) -> Feed:
        """In one box."""
        Lt, L_inv, off, own = cover.L.swapaxes(1, 2), cover.L_inv, cover.postures, cover.coriolis
        by = L_inv.swapaxes(1, 2)
        driven = Lt @ added.middle @ by
        K = L_inv @ cover.viscous @ by - driven + np.einsum("nijk,nk->nij", own, cover.nu) @ by
        turned = np.einsum("nijk,njl->nkil", own, by)
        gyration = norm((turned + turned.swapaxes(2, 3)) / 2) + off.gyration_off
        lost = np.einsum("nk,nk->n", gyration, cover.nu_off + added.nu)
        lost += np.einsum("nk,nk->n", off.gyration_off, np.abs(cover.nu)) + cover.mass_off * norm(driven)
        # s' M E_ik s = (a_i x) (b_k x) for M0, a_i and b_k columns of L' and L^-1
        a, b = np.linalg.norm(Lt, axis=1), np.linalg.norm(L_inv, axis=1)
        shears = np.abs(np.eye(len(added.nu))) / 2 + (0.5 + cover.mass_off)[:, None, None] * a[:, :, None] * b[:, None]
        lost += np.einsum("nik,ik->n", shears, added.half)
        return cls((K + K.swapaxes(1, 2)) / 2, lost)


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
        weighs: Whether it adds the gravity at the joints of the sample.
    """

    lower: Array
    upper: Array
    network: Array
    K: Array
    disturbance: Array
    period: float
    late: float = 0.0
    weighs: bool = False

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

    @property
    def nu(self) -> Array:
        """Velocities without any error, (N, p)."""
        return np.concatenate((self.v_ref, self.qdot_ref), axis=1)

    @property
    def nudot(self) -> Array:
        """Accelerations without any error, (N, p)."""
        return np.concatenate((self.a_ref, self.qddot_ref), axis=1)

    def stretches(self, most: int) -> tuple[tuple[Array, Array], ...]:
        """Middles and half-widths of q_ref, nu and nudot over stretches that together are all of it; (K, .) each.

        Between two instants a signal goes from one value to the other, and beyond them by at most half their distance.
        """
        edges = np.unique(np.linspace(0, len(self.v_ref) - 1, most + 1).astype(int))
        edges = edges if len(edges) > 1 else np.array([0, 0])
        result = []
        for signal in (self.q_ref, self.nu, self.nudot):
            low, high = (np.empty((len(edges) - 1, signal.shape[1])) for _ in range(2))
            for k, (a, b) in enumerate(pairwise(edges)):
                part = signal[a : b + 1]
                beyond = np.abs(np.diff(part, axis=0)).max(axis=0, initial=0.0) / 2
                low[k], high[k] = part.min(axis=0) - beyond, part.max(axis=0) + beyond
            result.append(((low + high) / 2, (high - low) / 2))
        return tuple(result)


@dataclass(frozen=True, eq=False)
class ArmMetric:
    """N (n, n): the size of an arm error e is `sqrt(e' N e)`. Any does that is positive definite.

    Attributes:
        N: The arm's inertia with the base free, or one that counts every joint by itself.
    """

    N: Array

    @classmethod
    def best(cls, robot: Robot, along: Along, K: Array) -> ArmMetric:
        """The one whose errors a given energy drives less far: the inertia; or, for gains K (n,) that differ, diagonal.

        Both are means along the reference, the second the inverse of what is on the diagonal of the inverse.
        """
        dynamics, position = Dynamics(robot), robot.neutral_position()
        inverses = []
        for k in np.linspace(0, len(along.v_ref) - 1, METRICS).astype(int):
            position[robot.arm_index] = along.q_ref[k]
            inverses.append(np.linalg.inv(dynamics.mass_matrix(robot.follow(position)))[2:, 2:])
        mean = np.mean(inverses, axis=0)
        coupled, single = cls(np.linalg.inv(mean)), cls(np.diag(1 / np.diag(mean)))
        if not len(mean) or not np.ptp(K):
            return coupled
        return max((coupled, single), key=lambda one: one.decay(K) / one.driven(np.array(inverses)))

    @cached_property
    def root(self) -> Array:
        """(n, n): `e = root y` with |y| the size of e."""
        return np.linalg.inv(np.linalg.cholesky(self.N)).T

    @cached_property
    def reach(self) -> Array:
        """(n,) largest |e_i| for a size of 1."""
        return np.linalg.norm(self.root, axis=1)

    def driven(self, inverses: Array) -> float:
        """Largest `|r|_N / sqrt(s' M s)` for the arm's parts (N, n, n) of `M^-1`."""
        if not len(self.N):
            return 0.0
        L = np.linalg.cholesky(self.N)
        return float(np.sqrt(np.linalg.eigvalsh(L.T @ inverses @ L).max()))

    def decay(self, K: Array) -> float:
        """Rate at which the size of the arm errors decays for r = 0 [1/s]: of `e' N e`, with edot = r - K e, K (n,)."""
        if not len(self.N):
            return np.inf
        L, NK = np.linalg.inv(np.linalg.cholesky(self.N)), self.N * K
        return float(np.linalg.eigvalsh(L @ (NK + NK.T) @ L.T / 2)[0])


@dataclass(frozen=True, eq=False)
class Cover:
    """Terms of the reduced dynamics wherever the robot may be, in N boxes.

    Args:
        nu: (N, p) velocities without any error in the middle of each box's stretch of the reference.
        nu_off: (N, p) how far off they may be.
        nudot: (N, p) accelerations without any error.
        nudot_off: (N, p) how far off they may be.
        postures: Terms over the boxes; all `mass_off` below 1.
        viscous: (p, p) viscous friction on nu, positive semi-definite.
        dry: (p,) largest dry friction on nu.
        metric: Of the arm errors.
        size: Of the arm errors up to which the boxes hold all.
        beyond: How far joints beside their places there are in the boxes, too [rad or m].
    """

    nu: Array
    nu_off: Array
    nudot: Array
    nudot_off: Array
    postures: Postures
    viscous: Array
    dry: Array
    metric: ArmMetric
    size: float
    beyond: float = 0.0

    @classmethod
    def of(
        cls, robot: Robot, bodies: Bodies, along: Along, metric: ArmMetric, size: float, beyond: float = 0.0
    ) -> Cover:
        """The cover of a whole reference with arm errors of up to a size; boxes in which M bends are cut in two."""
        dry = np.abs(robot.T).T @ robot.dry[:, :2].sum(axis=1)
        (q, q_off), (nu, nu_off), (nudot, nudot_off) = along.stretches(STRETCHES)
        q_off = q_off + size * metric.reach + beyond
        most = max(EFFORT // nu.shape[1] ** 2, FEWEST)
        owner, found = np.arange(len(q)), bodies.over(q, q_off)
        while len(owner) < most and (bent := found.mass_off > BENT).any() and q.shape[1]:
            worst = np.argsort(-found.mass_off)[: min(int(bent.sum()), most - len(owner))]
            kept = np.setdiff1d(np.arange(len(owner)), worst)
            middle, half, at = found.q[worst], found.half[worst].copy(), found.bend[worst].argmax(axis=1)
            rows = np.arange(len(worst))
            half[rows, at] /= 2
            step = np.zeros_like(half)
            step[rows, at] = half[rows, at]
            cut = bodies.over(np.concatenate((middle - step, middle + step)), np.concatenate((half, half)))
            owner = np.concatenate((owner[kept], owner[worst], owner[worst]))
            found = found.at(kept).joined(cut)
        nu, nu_off, nudot, nudot_off = (part[owner] for part in (nu, nu_off, nudot, nudot_off))
        friction = viscous_friction(robot)
        return cls(nu, nu_off, nudot, nudot_off, found, friction, dry, metric, size, beyond)

    @cached_property
    def few(self) -> Cover:
        """Some of the boxes: for a first look, no bound."""
        some = slice(None, None, max(len(self.nu) // FEW, 1))
        return self.at(some, self.postures.at(some))

    def sampled(self, bodies: Bodies, seed: int = 0) -> Cover:
        """A random corner or place of each box alone, in the middle of its stretch: how loose bounds are, no bound."""
        rng, here = np.random.default_rng(seed), self.postures
        place = rng.uniform(-1, 1, here.q.shape)
        place[::2] = np.sign(place[::2])
        still = bodies.over(here.q + place * here.half, np.zeros_like(here.q))
        found = self.at(slice(None), still)
        return replace(found, nu_off=0 * self.nu_off, nudot_off=0 * self.nudot_off)

    def at(self, places: slice, postures: Postures) -> Cover:
        """Stretches at some places, with other terms."""
        nu, nu_off, nudot, nudot_off = (one[places] for one in (self.nu, self.nu_off, self.nudot, self.nudot_off))
        return replace(self, nu=nu, nu_off=nu_off, nudot=nudot, nudot_off=nudot_off, postures=postures)

    @property
    def mass_off(self) -> Array:
        """(N,) `(1 - mass_off) M0 <= M <= (1 + mass_off) M0`."""
        return self.postures.mass_off

    @property
    def low(self) -> Array:
        """(N,) M is at least so much of M0."""
        return 1 - self.mass_off

    @property
    def high(self) -> Array:
        """(N,) M is at most so much of M0."""
        return 1 + self.mass_off

    @cached_property
    def L(self) -> Array:
        """(N, p, p) `M0 = L L'`."""
        return np.asarray(np.linalg.cholesky(self.postures.M))

    @cached_property
    def L_inv(self) -> Array:
        """(N, p, p)."""
        return np.asarray(np.linalg.inv(self.L))

    @cached_property
    def coriolis(self) -> Array:
        """(N, p, p, p) `L^-1 C0`, see `Postures.coriolis`."""
        return np.einsum("nai,nijk->najk", self.L_inv, self.postures.coriolis)

    @cached_property
    def M_inverse(self) -> Array:
        """(N, p, p): no `M^-1` is larger."""
        return np.asarray(self.L_inv.swapaxes(1, 2) @ self.L_inv / self.low[:, None, None])

    @cached_property
    def lightest(self) -> Array:
        """(p,) largest `(M^-1)_ii`: an energy E of the errors allows `|s_i| <= sqrt(2 E (M^-1)_ii)`."""
        return np.asarray(np.einsum("nii->ni", self.M_inverse).max(axis=0))

    def fastest(self, gain: Array) -> float:
        """Largest eigenvalue of `M^-1 diag(gain)` [1/s]; inf for gains (p,) without bound."""
        if not np.isfinite(gain).all():
            return np.inf
        L = self.L_inv
        return float((np.linalg.eigvalsh(L * gain @ L.swapaxes(1, 2))[:, -1] / self.low).max())

    @cached_property
    def arm_gain(self) -> float:
        """Largest `|r|_N / sqrt(s' M s)`."""
        return self.metric.driven(self.M_inverse[:, 2:, 2:])

    def old_gravity(self, error: Array, energy: float, age: float) -> Array:
        """(N,) how far gravity may be from that of an age ago [s], normalised; inf where that may be outside of a box.

        Args:
            error: (p,) of nu_ref at most.
            energy: Of the errors in velocity at most [J].
            age: In seconds.
        """
        speed = np.abs(self.nu) + self.nu_off + error + np.sqrt(2 * energy * self.lightest)
        moved = age * speed[:, 2:]
        slope = self.postures.gravity_slope
        return np.where((moved <= self.beyond).all(axis=1), np.einsum("nk,nk->n", slope, moved), np.inf)

    @cached_property
    def weight(self) -> Array:
        """(p,) largest gravity [N, N m]."""
        rows = np.linalg.norm(self.L, axis=2) * self.postures.gravity_off[:, None]
        return np.asarray((np.abs(self.postures.gravity) + rows).max(axis=0))

    @cached_property
    def eigenvalues(self) -> tuple[float, float]:
        """Smallest and largest eigenvalue of M."""
        values = np.linalg.eigvalsh(self.postures.M)
        return float((values[:, 0] * self.low).min()), float((values[:, -1] * self.high).max())
