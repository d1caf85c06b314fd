"""Two bounds of the certificate that need no samples of the robot: on the pose error, and on a network's weights.

**The pose** (docs/explanation/theory.md, section 2): a strict Lyapunov function of Kanayama's loop, and how strongly
it holds the pose. With `eta = sin(ephi) / sqrt(ky)` [m] and a number `0 < eps < 1`

    Vk = (ex^2 + ey^2)/2 + (1 - cos ephi)/ky + eps ey eta
    Vkdot = -xi' Q xi + ex z1 + (eta + eps cos(ephi) ey) z2 / sqrt(ky),        xi = (ex, ey, eta)

where Q of `decay_matrix` is positive definite for `vr >= vmin > 0`, small eps and |ephi| < pi/2. What follows speaks of
the *size* `a = sqrt(2 Vk)` [m], along which `adot <= -decay(a) a + |(z1, g z2)|`, g of `yaw_gain`.

**The weights** (section 3), updated once per control period. With `y = kappa F |s|`, F per sample, one update of the
output weights is `W <- (1 - y) W + F phi s'`, where

    phi = sigma - sigma' V'x  in (0, 1) for every unit: `a -> sigma(a) - a sigma'(a)` rises from 0 to 1,

so that `|W| <= max(|W(0)|, c(y) sqrt(h)/kappa)` for ever, `c = 1` while y <= 1 and `y / (2 - y)` below 2; from y = 2 on
nothing holds it. A one-layer network has the Gaussians in (0, 1] for phi. The hidden weights follow, as
`|x (sigma'' W s)'| <= |x| |W| |s| / 4`.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from mmnn_pin.kinematic import Kinematic
from mmnn_pin.lab.psi.learner import NetworkLearner
from mmnn_pin.signals import Array

TRIED = np.linspace(0.02, 0.98, 49)  # eps


@dataclass(frozen=True)
class PoseSet:
    """What a size of the pose error allows, |ephi| < pi/2."""

    ex: float  # largest |ex| [m]
    ey: float  # largest |ey| [m]
    sine: float  # largest |sin ephi|
    cosine: float  # smallest cos ephi
    turn: float  # largest |ky ey + kth sin ephi| [1/m]: yaw rate over vr

    @property
    def heading(self) -> float:
        """Largest |ephi| [rad]."""
        return math.acos(self.cosine)


@dataclass(frozen=True)
class PoseBound:
    """The function for one set of gains and one reference."""

    kx: float  # gain [1/s], > 0
    ky: float  # gain [1/m^2], > 0
    kth: float  # gain [1/m], > 0
    slowest: float  # smallest vr [m/s], > 0
    fastest: float  # largest vr [m/s]
    turning: float  # largest |wr| [rad/s]
    eps: float  # weight of the term in ey eta, 0 < eps < 1

    @classmethod
    def of(cls, kinematic: Kinematic, v_ref: Array) -> PoseBound:
        """The one whose eps gives the smallest lateral error near the reference for a given z; v_ref (N, 2)."""
        speeds = float(v_ref[:, 0].min()), float(v_ref[:, 0].max()), float(np.abs(v_ref[:, 1]).max())
        tried = [cls(kinematic.kx, kinematic.ky, kinematic.kth, *speeds, float(eps)) for eps in TRIED]
        return max(tried, key=lambda bound: bound.decay(0.0, 0.0) * math.sqrt(1 - bound.eps**2))

    @property
    def largest(self) -> float:
        """Size at which a heading error of pi/2 can no longer be excluded [m]."""
        return math.sqrt((2 - self.eps**2) / self.ky)

    def reach(self, size: float) -> PoseSet:
        """The pose errors of a size below `largest`."""
        rest, square = 1 - self.eps**2, self.eps**2
        u = (math.sqrt(rest**2 + square * self.ky * size**2) - rest) / square  # 1 - cos ephi at most
        cosine = max(1 - u, 0.0)
        across = size / math.sqrt(rest)
        sine = min(math.sqrt(max(1 - cosine**2, 0.0)), math.sqrt(self.ky) * across)
        k1, k2 = self.ky, self.kth * math.sqrt(self.ky)
        return PoseSet(size, across, sine, cosine, size * math.sqrt((k1**2 - 2 * self.eps * k1 * k2 + k2**2) / rest))

    def metric(self, cosine: float) -> Array:
        """P with `2 Vk <= xi' P xi` where cos ephi >= cosine; for 1 it is `2 Vk >= xi' P xi`; (3, 3)."""
        return np.array([[1.0, 0, 0], [0, 1, self.eps], [0, self.eps, 2 / (1 + cosine)]])

    def decay_matrix(self, vr: float, w: float, cosine: float) -> Array:
        """Q (3, 3) at a reference speed, a yaw rate of the base and cos ephi."""
        lateral = self.eps * vr * math.sqrt(self.ky)
        cross = self.eps * vr * self.kth * cosine / 2
        turn = self.eps * w / 2
        return np.array([[self.kx, 0, turn], [0, lateral * cosine, cross], [turn, cross, vr * self.kth - lateral]])

    def decay(self, size: float, yaw_error: float) -> float:
        """Rate at which the pose error decays up to a size [1/s], for |z2| up to `yaw_error`; negative: it may grow.

        The smallest of `xi' Q xi / xi' P xi` over vr, w and cos ephi. Q is affine in each of them, its smallest
        eigenvalue relative to P concave, so that the corners of their intervals have the smallest.
        """
        reach = self.reach(size)
        if reach.cosine <= 0:
            return -math.inf
        w = self.turning + self.fastest * reach.turn + yaw_error
        L_inv = np.linalg.inv(np.linalg.cholesky(self.metric(reach.cosine)))
        corners = itertools.product((self.slowest, self.fastest), (-w, w), (reach.cosine, 1.0))
        Q = np.array([self.decay_matrix(*corner) for corner in corners])
        return float(np.linalg.eigvalsh(L_inv @ Q @ L_inv.T).min())

    def yaw_gain(self, cosine: float) -> float:
        """G [m]: how strongly z2 drives the size, with z1 counting as 1, where cos ephi >= cosine."""
        square = self.eps**2
        return math.sqrt((1 - square * (2 - cosine) * cosine) / (self.ky * (1 - square)))

    def size(self, error: Array) -> Array:
        """The size a of pose errors (k, 3), (k,) [m]."""
        ex, ey, ephi = error.T
        eta = np.sin(ephi) / math.sqrt(self.ky)
        return np.sqrt(2 * np.maximum((ex**2 + ey**2) / 2 + (1 - np.cos(ephi)) / self.ky + self.eps * ey * eta, 0.0))


@dataclass(frozen=True, eq=False)
class WeightsBound:
    """Bounds on one network's weights and output."""

    leak: float  # largest y = kappa F |s| per sample, of W
    leak_V: float  # the same of V, with G; 0 for a one-layer network
    W: float  # largest |W|_F; inf where there is no bound
    V: float  # largest |V|_F of hidden weights that learn; 0 where they are fixed
    output: Array  # (m,) largest |Psi_hat| [N, N m]
    why: str  # what holds the weights, in words
    projected: bool = False  # whether a projection does, whatever `leak` is

    @property
    def norm(self) -> float:
        """Largest |Z|_F of the weights that learn."""
        return math.hypot(self.W, self.V)


def weights_bound(learner: NetworkLearner, i: int, s: Array, x: float, projection: float | None = None) -> WeightsBound:
    """Bounds for the i-th network (1 the base's, 2 the arm's).

    Args:
        learner: The learner.
        i: Which network.
        s: (p,) largest |s_i| at any control sample.
        x: Largest norm of the networks' input; may be inf.
        projection: Largest norm that a supervisor scales every array of weights back to, None without one.
    """
    controller, layout = learner.own, learner.context.layout
    part = dict(learner.networks)[i]
    two_layer = controller.network.hidden_learns
    per = 1.0 if controller.rates == "per_sample" else learner.context.control_period
    rate, rate_V, kappa = controller.network.rates(i - 1, controller.leakage)
    scale_in, scale_out = (scale[part] for scale in controller.network_scales(layout))
    size = float(np.linalg.norm(scale_in * s[part]))
    hidden = math.sqrt(controller.network.hidden)
    W0, V0 = (float(np.linalg.norm(learner.start[f"{letter}{i}"])) for letter in "WV")
    if not controller.learning:
        return WeightsBound(0, 0, W0, V0 * two_layer, scale_out * W0 * hidden, "they are held fixed")
    leak, leak_V = kappa * per * rate * size, kappa * per * rate_V * size * two_layer
    W = max(W0, growth(leak) * hidden / kappa) if kappa > 0 else math.inf
    V = max(V0, growth(leak_V) * x * W / (4 * kappa)) if kappa > 0 else math.inf
    why = "e-modification" if kappa > 0 else "nothing: there is no leakage"
    radii = [min(radius, math.inf if projection is None else projection) for radius in controller.radii(layout)[i]]
    projected = math.isfinite(radii[0])
    if projected:
        W, V = min(W, max(W0, radii[0])), min(V, max(V0, radii[1]))
        why = f"{why}, projection" if kappa > 0 else "projection"
    return WeightsBound(leak, leak_V, W, V if two_layer else 0.0, scale_out * W * hidden, why, projected)


def growth(y: float) -> float:
    """C with `|W| <= c a / kappa` for updates `W <- (1 - y) W + (y/kappa) phi`, |phi| <= a; inf from y = 2 on."""
    if y <= 1:
        return 1.0
    return y / (2 - y) if y < 2 else math.inf
