"""One control sample of every compiled controller: what is learned, and the torque, within what the motors can give.

    estimate(row, at, learner, state)       Psi_hat and its learning: the code of the learner's own module
    step(row, at, numbers, state, limits, ahead)
                                            tau = (K + Kz (|Z| + ZB)) s + Psi_hat    (3.39), (3.50),   s = [z; r]
    settle(row, at, learner, state)         the torque that is held from here on, to be looked back at
    doubt(learner, state, S)                covariance of Psi_hat of the last sample

The ordinary loop, the compiled loop and the batch call these. They read and write the row of signals `row`, in
which signal i begins at `at[i]`; `state` is the controller's flat array. A law is its `LawNumbers`, and what it learns
with: a named tuple whose type has its code in `KERNELS`, or None. The thesis's networks stand in `step` themselves, so
that its controllers share one compiled loop.

Motor limits are the last stage before the torque. The feedback `k s` comes first. Robust term and Psi_hat, which go
with the weights, take of every motor's torque limit what it leaves, in this order. So no motor is asked for more than
its limit unless the feedback alone asks for it, and what is added to the feedback is bounded, whatever the weights are.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ..by_address import by_address
from ..compiled import by_type, compiled, copy_to, entry, internal, linked
from ..elementary import cos_sin
from ..elementary.matrices import pseudo_inverse
from ..parts import Matrix, Vector, layout_of, view, views
from ..signals import INDEX, Array, IntArray
from .one_layer import ONE_LAYER, one_layer_answer, one_layer_output, one_layer_update
from .two_layer import TWO_LAYER, hidden_input, project, two_layer_answer, two_layer_output, two_layer_update

Z, R, PSI_HAT, ROBUST = INDEX["z"], INDEX["r"], INDEX["psi_hat"], INDEX["robust"]
PSI_APPLIED = INDEX["psi_applied"]
EFFECTIVE_GAIN, TORQUE, WEIGHT_NORM = INDEX["effective_gain"], INDEX["torque"], INDEX["weight_norm"]

CONSTANT_GAIN, SCHEDULED_GAIN = 0, 1  # kinds of law, beside those of the networks
COSINE, SINE = 1.0, 2.0
ROUNDING = 1e-12  # part of a limit that is left for rounding, so that no sum is beyond it


class LawNumbers(NamedTuple):
    """The numbers of a law, as compiled code sees them; a law without networks has the gains alone."""

    kind: Vector  # (1,) `CONSTANT_GAIN`, `SCHEDULED_GAIN`, or that of a network
    learning: Vector  # (1,) 0 keeps the networks' weights
    # (1,) 1 for the order of Appendix B: weights move first, with the hidden outputs of the last call
    update_first: Vector
    adds_model: Vector  # (1,) 1 where psi_hat holds the Psi of a model, to which the networks add
    dt: Vector  # (1,) what rates are multiplied with: 1 for rates per sample, the control period for rates per second
    share: Vector  # (1,) largest answer of the networks' update to s, as a share of the feedback K s; inf for any
    gains: Matrix  # (5, p) or (1, p): K, Kz, what the networks' s and torque are multiplied with, and the largest gain
    networks: Matrix  # (2, 6) of base and arm: rate of W, rate of V or width, leakage, ZB, bounds on |W| and |V|
    # (2, nx) scale and offset of the inputs, (2, 0) for inputs as they are; (3, nx) where some are a `COSINE` or a
    # `SINE`, others 0
    inputs: Matrix


class Packed(NamedTuple):
    """`LawNumbers` as flat arrays, which cost less to hand over from Python."""

    sizes: IntArray  # where the parts of `settings` stand, and where those of the state do
    settings: Array  # `LawNumbers`
    rows: IntArray  # (nx,) where the inputs of networks stand in a row


@by_address
class Ahead(NamedTuple):
    """Where the torque acts, ahead of its sample (`loop.lead`)."""

    time: float  # how far, for the velocity that waits longest [s]
    age: float  # of a measurement when it is used [s]
    h: float  # control period [s]
    share: Array  # (p,) how far for every velocity, over `time`
    row: Array  # (width,) the row of signals there, with Psi_hat
    law: Packed  # the numbers of the law with its weights held


class Networks(NamedTuple):
    """State of the networks: input, weights, and of the last call hidden outputs, net inputs and error."""

    x: Vector
    W1: Matrix
    V1: Matrix
    sigma1: Vector
    net1: Vector
    s1: Vector
    W2: Matrix
    V2: Matrix
    sigma2: Vector
    net2: Vector
    s2: Vector


class NetworkState(NamedTuple):
    """State of one network: weights, and of the last call hidden outputs, net inputs and error."""

    W: Array
    V: Array
    sigma: Array
    net: Array
    s: Array


class Schedule(NamedTuple):
    """State of a PD with a gain for every sample: the sample, and the gains."""

    counter: Vector
    gains: Matrix


@compiled
def nobody_knows(learner: Any, state: Array, S: Array) -> None:
    """`doubt` of a learner without a covariance."""
    S[0, 0] = -1.0


class Kernels(NamedTuple):
    """The compiled code of what a law learns with; arguments as of `estimate`, and as of `doubt`."""

    estimate: Callable[..., None]
    settle: Callable[..., None]
    doubt: Callable[..., None] = nobody_knows


KERNELS: dict[type, Kernels] = {}  # every module of a learner enters its own
numbers_of, networks_of, schedule_of = views(LawNumbers), views(Networks), views(Schedule)
STATE = layout_of(LawNumbers, {}).size  # where in `Packed.sizes` the layout of the state begins


def packed(
    kind: int, gains: Array, layout: IntArray | None = None, rows: IntArray | None = None, **more: Any
) -> Packed:
    """The numbers of a law.

    Args:
        kind: Which law.
        gains: (5, p) or (1, p), as in `LawNumbers`.
        layout: Of `Networks` or `Schedule` in the state; None where the law itself remembers nothing.
        rows: (nx,) where the inputs of networks stand in a row.
        more: Other parts of `LawNumbers`; zeros, or nothing, unless given.
    """
    absent: dict[str, Any] = dict.fromkeys(("learning", "update_first", "adds_model", "dt", "share"), 0.0)
    absent |= dict.fromkeys(("networks", "inputs"), np.zeros((2, 0)))
    parts = {name: np.atleast_1d(np.asarray(part, float)) for name, part in (absent | more).items()}
    parts |= {"kind": np.full(1, float(kind)), "gains": gains}
    sizes = layout_of(LawNumbers, {name: part.shape for name, part in parts.items()})
    sizes = np.concatenate((sizes, np.zeros(0, np.int64) if layout is None else layout))
    settings = np.concatenate([part.ravel() for part in parts.values()])
    return Packed(sizes, settings, np.zeros(0, np.int64) if rows is None else rows.astype(np.int64))


def constant_gain(K: Array) -> Packed:
    """The numbers of `tau = K s + Psi_hat` with K (p,)."""
    return packed(CONSTANT_GAIN, K[None])


def estimate(row: Array, at: IntArray, learner: Any, state: Array) -> None:
    """Write Psi_hat, gain and norms of the weights of a sample, and learn from it.

    Args:
        row: (width,) row of signals.
        at: Offsets of the signals.
        learner: What the law learns with.
        state: (size,) the controller's state, updated in place.
    """
    KERNELS[type(learner)].estimate(row, at, learner, state)


def settle(row: Array, at: IntArray, learner: Any, state: Array) -> None:
    """Keep the torque in the row, which is held from here on; arguments as of `estimate`."""
    KERNELS[type(learner)].settle(row, at, learner, state)


def doubt(learner: Any, state: Array, S: Array) -> None:
    """Write the covariance of Psi_hat of the last sample into S (p, p); a negative first entry where nobody knows.

    Args:
        learner: What the law learns with.
        state: (size,) the controller's state.
        S: (p, p) covariance [N, N m], squared.
    """
    KERNELS[type(learner)].doubt(learner, state, S)


by_type(estimate, "learner", lambda kind: KERNELS[kind].estimate)
by_type(settle, "learner", lambda kind: KERNELS[kind].settle)
by_type(doubt, "learner", lambda kind: KERNELS[kind].doubt)


@compiled
def nothing_to_keep(row: Array, at: IntArray, learner: Any, state: Array) -> None:
    """`settle` of a learner that never looks back."""


@linked
def step(row: Array, at: IntArray, law: Packed, state: Array, limits: MotorLimits | None, ahead: Ahead | None) -> None:
    """Torque of one sample, and the update of the networks' weights.

    Args:
        row: (width,) row of signals. psi_hat holds what a learner or a model has written there; psi_hat, psi_applied,
            robust, effective_gain, torque and the norms of the networks' weights are written.
        at: Offsets of the signals.
        law: The numbers of the law.
        state: The controller's state, updated in place.
        limits: What robust term and Psi_hat are kept within; None for nothing, and then nothing is compiled for it.
        ahead: Where Psi_hat leads, with its row; None where it does not, likewise.
    """
    find_gain(row, at, law, state)
    gain, psi_hat = view(row, at, EFFECTIVE_GAIN), view(row, at, PSI_HAT)
    robust, torque = view(row, at, ROBUST), view(row, at, TORQUE)
    n = numbers_of(law.settings, law.sizes)
    K, kind = n.gains[0], int(n.kind[0])
    z, r = view(row, at, Z), view(row, at, R)
    for i in range(torque.size):
        s = z[i] if i < z.size else r[i - z.size]
        torque[i] = gain[i] * s
        if kind >= TWO_LAYER:
            robust[i] = (gain[i] - K[i]) * s
    if limits is not None and kind >= TWO_LAYER:
        soften(gain, K, robust, torque, limits)
    if ahead is not None:
        applied = view(row, at, PSI_APPLIED)
        lead(psi_hat, view(ahead.row, at, PSI_HAT), ahead.share, applied)
        if limits is not None:
            limit(applied, torque, limits)
            limit(psi_hat, torque, limits)
        for i in range(torque.size):
            torque[i] += applied[i]
    else:
        if limits is not None:
            limit(psi_hat, torque, limits)
        for i in range(torque.size):
            torque[i] += psi_hat[i]


@internal
def find_gain(row: Array, at: IntArray, law: Packed, state: Array) -> None:
    """The effective gain of a sample; of a law with networks their outputs and updates, too, as of `step`."""
    gain, psi_hat, torque = view(row, at, EFFECTIVE_GAIN), view(row, at, PSI_HAT), view(row, at, TORQUE)
    n = numbers_of(law.settings, law.sizes)
    kind, adds_model = int(n.kind[0]), n.adds_model[0] == 1.0
    if kind == CONSTANT_GAIN:
        copy_to(n.gains[0], gain)
    elif kind == SCHEDULED_GAIN:
        o = schedule_of(state, law.sizes[STATE:])
        copy_to(o.gains[min(int(o.counter[0]), len(o.gains) - 1)], gain)
        o.counter[0] += 1.0
    else:
        if adds_model:
            copy_to(psi_hat, torque)
        networks(row, at, law, state)
        for i in range(torque.size if adds_model else 0):
            psi_hat[i] += torque[i]


@compiled
def lead(psi_hat: Array, later: Array, share: Array, applied: Array) -> None:
    """Psi_hat as of the time in which the torque acts, from that of the sample and one later, into applied (p,)."""
    for i in range(applied.size):
        applied[i] = psi_hat[i] + share[i] * (later[i] - psi_hat[i])


@internal
def networks(row: Array, at: IntArray, law: Packed, state: Array) -> None:
    """Outputs, effective gain and updates of the base's and the arm's network."""
    n, o = numbers_of(law.settings, law.sizes), networks_of(state, law.sizes[STATE:])
    rows, first = law.rows, 0
    gain = view(row, at, EFFECTIVE_GAIN)
    K, Kz, of_s, of_torque, most = n.gains[0], n.gains[1], n.gains[2], n.gains[3], n.gains[4]
    for i in range(o.x.size):
        o.x[i] = row[rows[i]]
        if n.inputs.shape[1] > 0:
            o.x[i] = input_of(o.x[i], n.inputs, i)
    for which in range(2):
        error = view(row, at, Z) if which == 0 else view(row, at, R)
        if error.size == 0:
            continue
        W, V = (o.W1, o.V1) if which == 0 else (o.W2, o.V2)
        sigma, net, s = (o.sigma1, o.net1, o.s1) if which == 0 else (o.sigma2, o.net2, o.s2)
        for i in range(error.size):
            s[i] = of_s[first + i] * error[i]
        psi_hat, feedback = view(row, at, PSI_HAT)[first : first + error.size], 0.0
        for i in range(error.size):  # in the units of the network's own s and output
            feedback += K[first + i] * error[i] * error[i] * of_s[first] / of_torque[first]
        norm = network(n, n.networks[which], NetworkState(W, V, sigma, net, s), o.x, psi_hat, feedback)
        row[at[WEIGHT_NORM] + which] = norm
        for i in range(first, first + error.size):
            row[at[PSI_HAT] + i] *= of_torque[i]
            gain[i] = min(K[i] + Kz[i] * (norm + n.networks[which, 3]), most[i])
        first += error.size


@compiled
def input_of(value: float, inputs: Array, i: int) -> float:
    """Input i of networks from a signal; `inputs` as of `LawNumbers`."""
    if inputs.shape[0] > 2 and inputs[2, i] != 0.0:
        c, s = cos_sin(value)
        value = c if inputs[2, i] == COSINE else s
    return inputs[0, i] * value + inputs[1, i]


@internal
def network(n: LawNumbers, rates: Array, o: NetworkState, x: Array, psi_hat: Array, feedback: float) -> float:
    """Output and update of one network; returns the norm of its weights, taken with the output.

    The torque of a sample uses the weights from before it, unless the update comes first. `feedback` is `s' K s`, in
    the units of the network, of which the update answers a share at most.
    """
    kind, learning, first = int(n.kind[0]), n.learning[0] == 1.0, n.update_first[0] == 1.0
    if first and learning:
        if kind == TWO_LAYER:
            hidden_input(o.V, x, o.net)
        update(n, rates, o, x, feedback)
    if kind == ONE_LAYER:
        norm = one_layer_output(o.W, o.V, rates[1], x, o.sigma, psi_hat)
    else:
        norm = two_layer_output(o.W, o.V, x, o.net, o.sigma, psi_hat)
    if learning and not first:
        update(n, rates, o, x, feedback)
    return norm


@internal
def update(n: LawNumbers, rates: Array, o: NetworkState, x: Array, feedback: float) -> None:
    """Update of one network's weights, which end within their bounds; the centres V of a one-layer network stay."""
    dt, one = n.dt[0], int(n.kind[0]) == ONE_LAYER
    if n.share[0] < math.inf:
        answer = (
            one_layer_answer(o.sigma, o.s, rates[0]) if one else two_layer_answer(o.W, x, o.net, o.sigma, o.s, rates)
        )
        if dt * answer > n.share[0] * feedback:
            dt = n.share[0] * feedback / answer
    if one:
        one_layer_update(o.W, o.sigma, o.s, rates[0], rates[2], dt)
    else:
        two_layer_update(o.W, o.V, x, o.net, o.sigma, o.s, rates, dt)
        project(o.V, rates[5])
    project(o.W, rates[4])


@by_address
class MotorLimits(NamedTuple):
    """Limits of a robot's motors, and room to work in."""

    E: Array  # (p, motors) torque on nu from motor torques [1; of wheels 1/m and 1]
    E_inv: Array  # (motors, p) motor torques from torque on nu
    effort: Array  # (motors,) largest torques of the motors [N m or N], inf for no limit
    motors: Array  # (motors,) room to work in
    asked: Array  # (p,) written: Psi_hat as it was before it was limited [N, N m]


def motor_limits(E: Array, effort: Array) -> MotorLimits | None:
    """Limits of motors with E (p, motors) and largest torques (motors,); None where no motor has one."""
    if not np.isfinite(effort).any():
        return None
    E = np.ascontiguousarray(E, dtype=float)
    E_inv = pseudo_inverse(E)
    return MotorLimits(E, E_inv, (1.0 - ROUNDING) * effort, np.zeros(effort.size), np.zeros(len(E)))


@compiled
def turn_limits(limits: MotorLimits, E: Array, E_inv: Array) -> None:
    """Follow a base that steers, in place, as an integrator has the same arrays: E (p, motors) and its inverse."""
    for i in range(E.shape[0]):
        copy_to(E[i], limits.E[i])
    for j in range(E_inv.shape[0]):
        copy_to(E_inv[j], limits.E_inv[j])


@internal
def soften(gain: Array, k: Array, robust: Array, feedback: Array, limits: MotorLimits) -> None:
    """Lower the robust term (p,) to the share that k s leaves of the motors' limits; gain and feedback are the sums."""
    fixed = limits.asked
    for i in range(robust.size):
        fixed[i] = feedback[i] - robust[i]
    share = share_left(fixed, robust, limits)
    for i in range(robust.size if share < 1.0 else 0):
        gain[i] = k[i] + share * (gain[i] - k[i])
        robust[i] *= share
        feedback[i] = fixed[i] + robust[i]


@compiled
def share_left(feedback: Array, more: Array, limits: MotorLimits) -> float:
    """Largest share, from 0 to 1, of `more` (p,) that a feedback (p,) leaves room for on every motor [N, N m]."""
    share = 1.0
    for j in range(limits.motors.size):
        u, fed, top = entry(limits.E_inv, j, more), entry(limits.E_inv, j, feedback), limits.effort[j]
        left = max(0.0, top - fed if u > 0.0 else top + fed)
        if abs(u) > left:
            share = min(share, left / abs(u))
    return share if not math.isnan(share) else 0.0


@internal
def limit(psi_hat: Array, feedback: Array, limits: MotorLimits) -> None:
    """Clip psi_hat, motor by motor, to what the feedback leaves of the limits.

    Args:
        psi_hat: (p,) changed where it asks for too much; one that is no number stays, and the guard sees it [N, N m].
        feedback: (p,) the rest of the torque on nu [N, N m].
        limits: Of the motors.
    """
    motors, clipped = limits.motors, False
    copy_to(psi_hat, limits.asked)
    for j in range(motors.size):
        u, fed, top = entry(limits.E_inv, j, psi_hat), entry(limits.E_inv, j, feedback), limits.effort[j]
        low, high = -min(top, max(0.0, top + fed)), min(top, max(0.0, top - fed))
        if math.isnan(u):
            return
        motors[j] = min(max(u, low), high)
        clipped = clipped or motors[j] != u
    for i in range(psi_hat.size if clipped else 0):
        psi_hat[i] = entry(limits.E, i, motors)
