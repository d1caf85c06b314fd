"""The compiled step of all torque controllers of this package.

One function for the ordinary loop, the compiled loop and the batch: it reads the row's command and writes psi_hat,
robust, effective_gain, weight_norm and torque. Each controller is a kind, integer sizes, float settings and a flat
memory.
"""

from __future__ import annotations

from ..compiled import compiled, copy_to
from ..signals import INDEX, Array, IntArray
from .motor_limits import MotorLimits, limit, share_left
from .network import (
    hidden_input,
    one_layer_output,
    one_layer_update,
    project,
    two_layer_output,
    two_layer_update,
)

Z, R, PSI_HAT, ROBUST = INDEX["z"], INDEX["r"], INDEX["psi_hat"], INDEX["robust"]
EFFECTIVE_GAIN, TORQUE, WEIGHT_NORM = INDEX["effective_gain"], INDEX["torque"], INDEX["weight_norm"]

CONSTANT_GAIN, SCHEDULED_GAIN, TWO_LAYER, ONE_LAYER = 0, 1, 2, 3  # kinds of law

# sizes of a network controller: nx, learning, order, hidden of the base network, of the arm network, whether the Psi of
# a model is added, nx rows of x
NX, LEARNING, ORDER, HIDDEN, MODEL, ROWS = 0, 1, 2, 3, 5, 6
OUTPUT_FIRST, UPDATE_FIRST = 0, 1
# settings of a network controller: dt, per network (rate of W, rate of V or width, leakage, ZB, bounds on |W| and |V|),
# k (p), Kz (p), what the networks' s and torque are multiplied with (p, p), scale of the input (nx), offset of it (nx)
DT, RATES, PER_NETWORK, GAINS = 0, 1, 6, 13


@compiled
def step(
    kind: int, row: Array, at: IntArray, sizes: IntArray, settings: Array, state: Array, limits: MotorLimits | None
) -> None:
    """Torque of one sample, `tau = (k + Kz (|Z| + ZB)) s + Psi_hat` (3.39), (3.50), and the update of the weights.

    Args:
        kind: Which law.
        row: (width,) row of signals; psi_hat holds the nominal model's Psi for laws that use a model.
        at: Offsets of the signals.
        sizes: int64 numbers of the law.
        settings: float64 numbers of the law.
        state: The controller's memory, updated in place.
        limits: What robust term and Psi_hat are kept within; None for nothing, and then nothing is compiled for it.
    """
    gain, psi_hat, robust, torque = (
        row[at[EFFECTIVE_GAIN] : at[EFFECTIVE_GAIN + 1]],
        row[at[PSI_HAT] : at[PSI_HAT + 1]],
        row[at[ROBUST] : at[ROBUST + 1]],
        row[at[TORQUE] : at[TORQUE + 1]],
    )
    if kind == CONSTANT_GAIN:
        copy_to(settings, gain)
    elif kind == SCHEDULED_GAIN:
        last = (state.size - 1) // gain.size - 1
        start = 1 + min(int(state[0]), last) * gain.size
        copy_to(state[start:], gain)
        state[0] += 1.0
    else:
        if sizes[MODEL] == 1:
            copy_to(psi_hat, torque)
        networks(kind, row, at, sizes, settings, state)
        for i in range(torque.size if sizes[MODEL] == 1 else 0):
            psi_hat[i] += torque[i]
    z, r = row[at[Z] : at[Z + 1]], row[at[R] : at[R + 1]]
    for i in range(torque.size):
        s = z[i] if i < z.size else r[i - z.size]
        torque[i] = gain[i] * s
        if kind >= TWO_LAYER:
            robust[i] = (gain[i] - settings[GAINS + i]) * s
    if limits is not None:
        if kind >= TWO_LAYER:
            soften(gain, settings[GAINS:], robust, torque, limits)
        limit(psi_hat, torque, limits)
    for i in range(torque.size):
        torque[i] += psi_hat[i]


@compiled
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
def networks(kind: int, row: Array, at: IntArray, sizes: IntArray, settings: Array, state: Array) -> None:
    """Outputs, effective gain and updates of the base's and the arm's network; arguments as in `step`."""
    nx, p = sizes[NX], row[at[PSI_HAT] : at[PSI_HAT + 1]].size
    x = state[:nx]
    scales, inputs = settings[GAINS + 2 * p :], settings[GAINS + 4 * p :]
    for i in range(nx):
        x[i] = inputs[i] * row[sizes[ROWS + i]] + inputs[nx + i]
    start, first = nx, 0
    for which in range(2):
        error = row[at[Z] : at[Z + 1]] if which == 0 else row[at[R] : at[R + 1]]
        if error.size == 0:
            continue
        h, m = sizes[HIDDEN + which], error.size
        rates = settings[RATES + which * PER_NETWORK : RATES + (which + 1) * PER_NETWORK]
        W = state[start : start + h * m].reshape((h, m))
        V = state[start + h * m : start + h * (m + nx)].reshape((nx, h))
        sigma = state[start + h * (m + nx) : start + h * (m + nx + 1)]
        net = state[start + h * (m + nx + 1) : start + h * (m + nx + 2)]
        s = state[start + h * (m + nx + 2) : start + h * (m + nx + 2) + m]
        start += h * (m + nx + 2) + m
        for i in range(m):
            s[i] = scales[first + i] * error[i]
        psi_hat = row[at[PSI_HAT] : at[PSI_HAT + 1]][first : first + m]
        norm = one_network(kind, sizes, settings[DT], rates, W, V, x, net, sigma, s, psi_hat)
        row[at[WEIGHT_NORM] : at[WEIGHT_NORM + 1]][which] = norm
        gain = row[at[EFFECTIVE_GAIN] : at[EFFECTIVE_GAIN + 1]]
        for i in range(first, first + m):
            row[at[PSI_HAT] + i] *= scales[p + i]
            gain[i] = settings[GAINS + i] + settings[GAINS + p + i] * (norm + rates[3])
        first += m


@compiled
def one_network(
    kind: int,
    sizes: IntArray,
    dt: float,
    rates: Array,
    W: Array,
    V: Array,
    x: Array,
    net: Array,
    sigma: Array,
    s: Array,
    psi_hat: Array,
) -> float:
    """Output and update of one network; returns the norm of its weights, taken with the output.

    With OUTPUT_FIRST the torque of a sample uses the weights from before it; UPDATE_FIRST is the order of Appendix B:
    the weights move first, with the hidden outputs of the previous call, then the output is computed.
    """
    if sizes[ORDER] == UPDATE_FIRST and sizes[LEARNING] == 1:
        if kind == TWO_LAYER:
            hidden_input(V, x, net)
        update(kind, dt, rates, W, V, x, net, sigma, s)
    if kind == ONE_LAYER:
        norm = one_layer_output(W, V, rates[1], x, sigma, psi_hat)
    else:
        norm = two_layer_output(W, V, x, net, sigma, psi_hat)
    if sizes[ORDER] == OUTPUT_FIRST and sizes[LEARNING] == 1:
        update(kind, dt, rates, W, V, x, net, sigma, s)
    return norm


@compiled
def update(
    kind: int, dt: float, rates: Array, W: Array, V: Array, x: Array, net: Array, sigma: Array, s: Array
) -> None:
    """Update of one network's weights, which end within their bounds; the centres V of a one-layer network stay."""
    if kind == ONE_LAYER:
        one_layer_update(W, sigma, s, rates[0], rates[2], dt)
    else:
        two_layer_update(W, V, x, net, sigma, s, rates[0], rates[1], rates[2], dt)
        project(V, rates[5])
    project(W, rates[4])
