"""The thesis's controller as one would write it in numpy, for the loops of the peers; it shares no code with mmnn_pin.

Kanayama's command (3.3), filtered arm error (3.11), two-layer networks with both layers learning (3.48), (3.49) and the
robust term (3.50). The arrays come from `workload.peer_work`.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
LATERAL = 2e4  # [N s/m] damping that stands in for wheels that do not slip


class Controller:
    """One run's controller; its weights move at every call.

    Args:
        work: Reference, gains and initial weights.
    """

    def __init__(self, work: Mapping[str, Array]) -> None:
        self.work = dict(work)
        self.nets = [(self.work[f"W{i}"].copy(), self.work[f"V{i}"].copy()) for i in (1, 2)]

    def torque(self, i: int, pose: Array, q: Array, nu: Array) -> Array:
        """Generalized torque (p,) of control sample i at a pose (3,), joints (n,), velocity (p,)."""
        g, (kx, ky, kth) = self.work, self.work["kanayama"]
        nb, v, qdot = 2, nu[:2], nu[2:]
        (vr, wr), a = g["velocity_ref"][i], g["acceleration_ref"][i]
        c, s = np.cos(pose[2]), np.sin(pose[2])
        error = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ (g["pose_ref"][i] - pose)
        error[2] = np.pi - (np.pi - error[2]) % (2 * np.pi)
        c, s = np.cos(error[2]), np.sin(error[2])
        rate = np.array([v[1] * error[1] - v[0] + vr * c, vr * s - v[1] * error[0], wr - v[1]])
        alpha = np.array([vr * c + kx * error[0], wr + vr * ky * error[1] + abs(vr) * kth * s])
        swing = kth * (np.copysign(1.0, vr) * a[0] * s + abs(vr) * c * rate[2])
        along = a[0] * c - vr * s * rate[2] + kx * rate[0]
        alphadot = np.array([along, a[1] + ky * (a[0] * error[1] + vr * rate[1]) + swing])
        e, edot = g["q_ref"][i] - q, g["qdot_ref"][i] - qdot
        z, r = alpha - v, edot + g["K"] * e
        command = (
            g["pose_ref"][i],
            alpha,
            alphadot,
            error,
            z,
            e,
            r,
            g["q_ref"][i],
            g["qdot_ref"][i],
            g["qddot_ref"][i],
        )
        x, both = np.concatenate(command), np.concatenate((z, r))
        psi_hat, norm = np.zeros(both.size), np.zeros(both.size)
        for j, part in ((0, slice(0, nb)), (1, slice(nb, None))):
            psi_hat[part], norm[part] = self.learn(j, x, both[part])
        ZB = np.repeat(g["ZB"], (nb, q.size))
        return (g["k"] + g["Kz"] * (norm + ZB)) * both + psi_hat

    def learn(self, j: int, x: Array, s: Array) -> tuple[Array, float]:
        """Output of network j and the norm of its weights; then its weights take one step."""
        W, V = self.nets[j]
        F, G, kappa = self.work["F"][j], self.work["G"][j], self.work["kappa"]
        net = V.T @ x
        sigma = 1.0 / (1.0 + np.exp(-net))
        slope, leak = sigma * (1.0 - sigma), kappa * np.linalg.norm(s)
        output, norm = W.T @ sigma, np.sqrt(np.sum(W**2) + np.sum(V**2))
        back = slope * (W @ s)
        W += F * (np.outer(sigma - slope * net, s) - leak * W)
        V += G * (np.outer(x, back) - leak * V)
        return output, float(norm)


class PlanarLoop:
    """The controller around planar_arm, whose coordinates are (x, y, phi, arm): lateral slip is damped, not excluded.

    Args:
        work: Reference, gains and initial weights.
    """

    def __init__(self, work: Mapping[str, Array]) -> None:
        self.controller, self.viscous = Controller(work), np.asarray(work["viscous"])
        self.samples = len(work["pose_ref"])
        self.start = np.concatenate((work["pose"][0], work["q"][0]))

    def force(self, i: int, position: Array, velocity: Array) -> Array:
        """Forces on (x, y, phi, arm) of control sample i."""
        c, s = np.cos(position[2]), np.sin(position[2])
        forward, lateral = c * velocity[0] + s * velocity[1], c * velocity[1] - s * velocity[0]
        nu = np.concatenate(([forward], velocity[2:]))
        tau = self.controller.torque(i, position[:3], position[3:], nu) - self.viscous * nu
        side = -LATERAL * lateral
        return np.concatenate(([c * tau[0] - s * side, s * tau[0] + c * side], tau[1:]))
