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
from dataclasses import dataclass
from itertools import product

import numpy as np

from mmnn_pin.signals import Array

from .bounds import PoseBound, PoseSet
from .cover import Cover
from .postures import norm

SPENT = (0.03, 0.1, 0.3)  # of the feedback, on what the hold lets pass
BACK = 4  # samples that late commands are followed back
SHARES = np.array([0.05, 0.15, 0.3, 0.4, 0.5, 0.6, 0.75])  # of the largest rate


@dataclass(frozen=True, eq=False)
class MotionBound:
    """The energy of the errors in one box."""

    rate: float  # rate of decay used [1/s]; nan where there is none
    level: float  # energy above which E falls [J]; inf where there is none
    margin: float  # largest possible rate, `min of s' K s / s' M s` [1/s]
    unheld: float  # the same for a torque that is not held; negative: the feedback is too weak for the kinematic gains
    # largest eigenvalue of M^-1 k [1/s]; the period has to be below half its inverse, or the oldest sample in force,
    # where commands are late, below its inverse
    fastest: float
    pushed: float  # largest `|d s / dt|` that is not the feedback's, in the norm of k [sqrt(W/s)]


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
    """The quadratic form in s but for the feedback, normalised."""

    K: Array  # (N, p, p) of `viscous - sym(M Az) + sym(C(., nu_ref))` in the middle of the box
    lost: Array  # (N,) what it may have less elsewhere

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
