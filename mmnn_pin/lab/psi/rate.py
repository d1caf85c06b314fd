"""May the learner learn this fast? A condition in discrete time on rates, sample time and gains.

One update changes the output by `Psi_hat <- Psi_hat + L s`, with the kernel of the network where it is

    L = F (sigma' (sigma - sigma' V'x)) I + G |x|^2 W' sigma'^2 W            (p, p), rates per sample

(a one-layer network: beta |phi|^2 I). Linearised about the reference, with the torque held over a period, deviations
and Psi_hat then follow a matrix (docs/explanation/theory.md, section 6); a spectral radius above 1 means that they
grow. For one velocity of inertia m alone it is stable if and only if `L < k` and `h (2 k - L) < 4 m` (updates after
the output). This speaks of small errors and an input that stands still; the leakage is left out.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import expit

from ...errors import RecordingError
from ...loop.before_run import viscous_friction
from ...loop.sampled import HeldLoop, Machinery, held_loop
from ...settings import finite
from ...signals import Array
from ...torque.controller import ControllerState
from .learner import NetworkLearner, put
from .subject import Subject

PLACES = 12
TOLERANCE = 1e-9
SCAN = np.geomspace(1e-2, 1e4, 61)  # factors on the rates
LARGEST = 1e100  # of an update per s, in SI units; a loop that has more is none


@dataclass(frozen=True, eq=False)
class Rate:
    """Verdict on the rates at some instants of a run."""

    time: Array  # (k,) the instants [s]
    radius: Array  # (k,) spectral radius of a control period with the learner
    without: Array  # (k,) the same without it
    share: Array  # (k, p) L_ii / k_i: below 1 for one velocity alone, updated after the output
    limit: Array  # (k,) factor on all rates beyond which it grows; inf beyond what was looked at
    leak: Array  # (2,) largest kappa F |s| per sample of the base's and the arm's network over the run; below 2

    @property
    def stable(self) -> bool:
        """Whether nothing grows at any of the instants, and the leakage shrinks the weights."""
        return bool(self.radius.max() <= 1 + TOLERANCE and self.leak.max() < 2)

    def to_dict(self) -> dict[str, Any]:
        """The worst over the run, for JSON."""
        return {
            "stable": self.stable,
            "spectral_radius": finite(self.radius.max()),
            "without_learner": finite(self.without.max()),
            "share_of_gain": [finite(value) for value in self.share.max(axis=0)],
            "factor_left": finite(self.limit.min()),
            "leak_per_sample": [finite(value) for value in self.leak],
        }


def rate_of(subject: Subject, places: int = PLACES) -> Rate:
    """The condition along a run, at the weights that it had.

    Raises:
        RecordingError: The controller has no networks.
    """
    learner = subject.networks
    if learner is None:
        raise RecordingError(
            "no condition on the rates",
            why=f"{subject.controller} is no learner of the thesis",
            file=subject.recording.path,
        )
    rows = learned_at(subject, learner, places)
    result = [judged(subject, learner, row, state) for row, state in rows]
    time = np.array([row[subject.layout.where("time")][0] for row, _ in rows])
    radii, without, share, limit = (np.array(column) for column in zip(*result, strict=True))
    return Rate(time, radii, without, share, limit, leakage(subject, learner))


def learned_at(subject: Subject, learner: NetworkLearner, places: int) -> list[tuple[Array, ControllerState]]:
    """Rows of a run at which its weights are recorded, with them."""
    snapshots, times = subject.recording.weights, subject.signal("time")[:, 0]
    if "time" not in snapshots or not len(snapshots["time"]):
        return [(subject.rows[0], learner.start), (subject.rows[-1], learner.end)]
    result = []
    for k in np.unique(np.linspace(0, len(snapshots["time"]) - 1, places).astype(int)):
        state = learner.start.snapshot()
        put(state, snapshots, k)
        row = min(int(np.searchsorted(times, snapshots["time"][k])), len(times) - 1)
        result.append((subject.rows[row], state))
    return result


def judged(
    subject: Subject, learner: NetworkLearner, row: Array, state: ControllerState
) -> tuple[float, float, Array, float]:
    """Radius with and without the learner, shares of the gain, factor left; at a row (width,) and its weights.

    Raises:
        RecordingError: Weights, inputs or gains that are too large to be those of a loop.
    """
    where, layout = subject.layout.where, subject.layout
    with np.errstate(over="ignore", invalid="ignore"):
        L = kernel(learner, row, state)
    if not (np.abs(L) < LARGEST).all() or not (np.abs(row[where("effective_gain")]) < LARGEST).all():
        why = "weights, inputs or gains are too large to be those of a loop"
        raise RecordingError("no condition on the rates", why=why, file=subject.recording.path)
    gain = np.array(row[where("effective_gain")])
    gain = np.where(gain > 0, gain, learner.own.feedback_gain(layout))
    M = subject.dynamics(float(row[where("time")][0])).mass_matrix(row[where("position")])
    held = held_loop(
        M,
        subject.robot.base.linear_errors(row[where("velocity_ref")], subject.kinematic.base_gains(layout)),
        subject.kinematic.arm_gains(layout),
        subject.timing.control_period,
        Machinery(viscous_friction(subject.robot)),
    )
    share = np.diag(L) / np.maximum(gain, 1e-300)
    if held is None:
        return np.inf, np.inf, share, 0.0
    first = learner.own.update == "before_output"
    without = float(np.abs(np.linalg.eigvals(held.closed(gain))).max())
    return radius(held, gain, L, first), without, share, factor(held, gain, L, first)


def kernel(learner: NetworkLearner, row: Array, state: ControllerState) -> Array:
    """L (p, p): what one update adds to Psi_hat per s, at a row (width,) and the weights of a state [N s/m, ...]."""
    controller, layout = learner.own, learner.context.layout
    x = controller.inputs.seen(row[controller.inputs.rows(layout)], layout)
    into, out = controller.network_scales(layout)
    result = np.zeros((layout.dof, layout.dof))
    if not controller.learning:
        return result
    per = 1.0 if controller.rates == "per_sample" else learner.context.control_period
    for i, part in learner.networks:
        W, V = state[f"W{i}"], state[f"V{i}"]
        rate, other, _ = controller.network.rates(i - 1, controller.leakage)
        if not controller.network.hidden_learns:
            phi = np.exp(-((x[:, None] - V) ** 2).sum(axis=0) / (2 * other**2))
            L = rate * (phi @ phi) * np.eye(W.shape[1])
        else:
            net = V.T @ x
            sigma = expit(net)
            slope = sigma * (1 - sigma)
            L = rate * (sigma @ (sigma - slope * net)) * np.eye(W.shape[1])
            L = L + other * (x @ x) * (W.T * slope**2) @ W
        result[part, part] = per * out[part, None] * L * into[part]
    return result


def radius(held: HeldLoop, gain: Array, L: Array, first: bool) -> float:
    """Spectral radius of a period with the learner: L (p, p), gain (p,); `first`: weights move before the output."""
    p = len(gain)
    closed = held.closed(gain)
    if first:
        closed = closed + held.torque @ L @ held.errors
    return float(np.abs(np.linalg.eigvals(np.block([[closed, held.torque], [L @ held.errors, np.eye(p)]]))).max())


def factor(held: HeldLoop, gain: Array, L: Array, first: bool) -> float:
    """Factor on L from which on deviations grow; inf where none of `SCAN` is too large, 0 where all are."""

    def grows(f: float) -> bool:
        return radius(held, gain, f * L, first) > 1 + TOLERANCE

    bad = next((i for i, f in enumerate(SCAN) if grows(f)), None)
    if bad is None:
        return np.inf
    if bad == 0:
        return 0.0
    low, high = SCAN[bad - 1], SCAN[bad]
    for _ in range(30):
        middle = np.sqrt(low * high)
        low, high = (low, middle) if grows(middle) else (middle, high)
    return float(low)


def leakage(subject: Subject, learner: NetworkLearner) -> Array:
    """Largest kappa F |s| per sample over a run, (2,) base and arm; of W and V the larger."""
    controller, layout = learner.own, subject.layout
    s, result = subject.s * controller.network_scales(layout)[0], np.zeros(2)
    per = learner.context.control_period if controller.rates == "per_second" else 1.0
    for i, part in learner.networks:
        rate, other, kappa = controller.network.rates(i - 1, controller.leakage)
        fastest = max(rate, other) if controller.network.hidden_learns else rate
        result[i - 1] = kappa * per * fastest * np.linalg.norm(s[:, part], axis=1).max()
    return result
