"""The networks and their update laws; they know no robot.

Two-layer network of Lewis with e-modification (3.23)-(3.28), (3.48), (3.49), and the one-layer Gaussian network
of Lin and Goldenberg (reference [9] of the thesis; its law is not printed there and is reconstructed from the
names of its parameters). Weights are updated in place; `s` is the error that drives the learning (z or r).
"""

from __future__ import annotations

import math

import numpy as np

from ..compiled import compiled
from ..signals import Array


@compiled
def two_layer_output(W: Array, V: Array, x: Array, net: Array, sigma: Array, psi_hat: Array) -> float:
    """Output `Psi_hat = W' sigma(V' x)`, `sigma(a) = 1 / (1 + exp(-a))` (3.25).

    Args:
        W: (h, m) output weights.
        V: (nx, h) hidden weights.
        x: (nx,) input.
        net: (h,) written: `V' x`.
        sigma: (h,) written: hidden outputs.
        psi_hat: (m,) written.

    Returns:
        The norm of the weights, `(|W|_F^2 + |V|_F^2)^(1/2)`.
    """
    hidden_input(V, x, net)
    squares = sum_of_squares(V, sigma)
    for j in range(net.size):
        sigma[j] = 1.0 / (1.0 + np.exp(-net[j]))
    return math.sqrt(squares + weighted_sum(W, sigma, psi_hat))


@compiled
def hidden_input(V: Array, x: Array, net: Array) -> None:
    """`V' x` for V (nx, h), written to net (h,); two rows at a time, so that net is read and written half as often."""
    for j in range(net.size):
        net[j] = 0.0
    paired = x.size - x.size % 2
    for i in range(0, paired, 2):
        for j in range(net.size):
            net[j] += V[i, j] * x[i] + V[i + 1, j] * x[i + 1]
    for i in range(paired, x.size):
        for j in range(net.size):
            net[j] += V[i, j] * x[i]


@compiled
def sum_of_squares(V: Array, scratch: Array) -> float:
    """`|V|_F^2` for V (nx, h); one sum per column in scratch (h,): the processor works on several at a time."""
    for j in range(scratch.size):
        scratch[j] = 0.0
    paired = V.shape[0] - V.shape[0] % 2
    for i in range(0, paired, 2):
        for j in range(scratch.size):
            scratch[j] += V[i, j] * V[i, j] + V[i + 1, j] * V[i + 1, j]
    for i in range(paired, V.shape[0]):
        for j in range(scratch.size):
            scratch[j] += V[i, j] * V[i, j]
    total = 0.0
    for j in range(scratch.size):
        total += scratch[j]
    return total


@compiled
def weighted_sum(W: Array, sigma: Array, psi_hat: Array) -> float:
    """`W' sigma` for W (h, m), written to psi_hat (m,), and the sum of the squares of W."""
    squares = 0.0
    for i in range(psi_hat.size):
        total = 0.0
        for j in range(sigma.size):
            total += W[j, i] * sigma[j]
            squares += W[j, i] * W[j, i]
        psi_hat[i] = total
    return squares


@compiled
def two_layer_update(
    W: Array, V: Array, x: Array, net: Array, sigma: Array, s: Array, F: float, G: float, kappa: float, dt: float
) -> None:
    """One step of the update law (3.48), (3.49), both lines with the weights as they were before.

    `Wdot = F sigma s' - F sigma' V'x s' - kappa F |s| W`, `Vdot = G x (sigma'' W s)' - kappa G |s| V`, with
    `sigma' = diag(sigma) (I - diag(sigma))` and `sigma''` its transpose.

    Args:
        W: (h, m) updated.
        V: (nx, h) updated.
        x: (nx,) input.
        net: (h,) `V' x`.
        sigma: (h,) hidden outputs.
        s: (m,) error.
        F: Rate of W.
        G: Rate of V.
        kappa: Leakage (e-modification).
        dt: 1 for rates per sample (Appendix B), the control period for rates per second.
    """
    norm = 0.0
    for i in range(s.size):
        norm += s[i] * s[i]
    leak = kappa * math.sqrt(norm)
    keep_W, keep_V = 1.0 - dt * F * leak, 1.0 - dt * G * leak
    for j in range(sigma.size):
        slope = sigma[j] * (1.0 - sigma[j])
        gain, back = dt * F * (sigma[j] - slope * net[j]), 0.0
        for i in range(s.size):
            back += W[j, i] * s[i]
            W[j, i] = keep_W * W[j, i] + gain * s[i]
        net[j] = slope * back  # from here on sigma'' W s
    for i in range(x.size):
        gain = dt * G * x[i]
        for j in range(sigma.size):
            V[i, j] = keep_V * V[i, j] + gain * net[j]


@compiled
def one_layer_output(W: Array, centres: Array, width: float, x: Array, phi: Array, psi_hat: Array) -> float:
    """Output `Psi_hat = W' phi(x)`, `phi_j = exp(-|x - c_j|^2 / (2 width^2))`.

    Args:
        W: (h, m) output weights.
        centres: (nx, h) centres of the Gaussians, fixed.
        width: Their common width.
        x: (nx,) input.
        phi: (h,) written: activations.
        psi_hat: (m,) written.

    Returns:
        The norm of the weights, `|W|_F`.
    """
    phi[:] = 0.0
    for i in range(x.size):
        for j in range(phi.size):
            phi[j] += (x[i] - centres[i, j]) ** 2
    for j in range(phi.size):
        phi[j] = np.exp(-phi[j] / (2.0 * width * width))
    return math.sqrt(weighted_sum(W, phi, psi_hat))


@compiled
def one_layer_update(W: Array, phi: Array, s: Array, beta: float, mu: float, dt: float) -> None:
    """One step of `Wdot = beta phi s' - mu beta |s| W` (reconstructed); shapes as in `one_layer_output`."""
    norm = 0.0
    for i in range(s.size):
        norm += s[i] * s[i]
    leak = mu * math.sqrt(norm)
    for j in range(phi.size):
        for i in range(s.size):
            W[j, i] += dt * beta * (phi[j] * s[i] - leak * W[j, i])


@compiled
def project(A: Array, radius: float) -> None:
    """A onto the ball |A|_F <= radius, in place; inf leaves it as it is.

    The nearest point of a ball is not farther from any point within it, so with ideal weights there
    `tr(Wt' F^-1 Wt)` never grows by it (projection of adaptive control: Ioannou and Sun 1996, Robust Adaptive Control).
    """
    if radius < math.inf:
        square = 0.0
        for i in range(A.shape[0]):
            for j in range(A.shape[1]):
                square += A[i, j] * A[i, j]
        shrink(A, square, radius)


@compiled
def shrink(A: Array, square: float, radius: float) -> None:
    """A into a ball, given the square of its norm there; zero where that is no number."""
    if square <= radius * radius:
        return
    share = radius / math.sqrt(square) if math.isfinite(square) else 0.0
    for i in range(A.shape[0]):
        for j in range(A.shape[1]):
            A[i, j] = share * A[i, j] if share > 0.0 else 0.0


def numerical_rank(W: Array, tolerance: float = 1e-9) -> int:
    """Number of singular values above `tolerance` times the largest; 0 for a zero matrix.

    Weights that start from zero keep rank one for ever: all hidden units of the network stay equal.
    """
    singular = np.linalg.svd(np.asarray(W), compute_uv=False)
    return int(np.sum(singular > tolerance * singular[0])) if singular.size and singular[0] > 0 else 0
