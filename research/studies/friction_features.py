"""Fit the features of `torque.friction_features` on random joints: `python -m research.studies.friction_features`.

Every joint has LuGre's friction (Canudas de Wit, Olsson, Astrom, Lischinsky 1995, IEEE TAC 40(3)) without its damping:
dry friction of 1, static friction of 1 to 2, Stribeck's speed and the way until it slides drawn over two and three
decades. It moves along a sum of one to three sines. What a joint's friction is, is said by a combination of its own of
viscous and dry friction, inertia, a constant, and the d features, by ridge regression; the features are moved down the
gradient of what that leaves, over all joints. By the envelope theorem the combination's own derivative drops out.

Judged on joints that were not fitted on: the combination from the first half of a motion, the FVU on the second.
`--write` replaces the weights that ship.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mmnn_pin.files import whole_file
from mmnn_pin.signals import Array, IntArray
from mmnn_pin.torque import friction_features
from mmnn_pin.torque.friction_features import ACCELERATIONS, SLOWEST, SPEEDS, WAYS

JOINTS, OTHERS = 240, 120  # that are fitted on, and judged on
STEP, BETWEEN, SETTLED = 0.004, 4, 250  # [s]; steps of friction in one; samples that are left out
DURATION = 10.0  # [s]
NOISE = (1e-3, 0.03)  # of what is taken for speed and acceleration
UNITS, FEATURES, RIDGE = 12, 4, 1e-3
BATCH, STEPS, RATE = 16, 3000, 0.02
DIGITS = 5
SEEDS = (1, 2, 3)  # of the joints, of the others, of the fit


class Joints(NamedTuple):
    """What joints did, and their friction."""

    u: Array  # (joints, samples, INPUTS) what the first layer sees
    known: Array  # (joints, samples, 4) speed, dry friction, acceleration, 1
    friction: Array  # (joints, samples) over the joint's dry friction

    def of(self, chosen: IntArray) -> Joints:
        """Some joints."""
        return Joints(*(part[chosen] for part in self))

    def part(self, samples: slice) -> Joints:
        """Some samples."""
        return Joints(*(part[:, samples] for part in self))


def main(arguments: Sequence[str] | None = None) -> None:
    """Parse the command line, fit, judge."""
    parser = argparse.ArgumentParser(prog="python -m research.studies.friction_features", description=__doc__)
    parser.add_argument("--steps", type=int, default=STEPS, help=f"of the fit ({STEPS})")
    parser.add_argument("--write", action="store_true", help="replace the weights that ship with the package")
    options = parser.parse_args(arguments)
    others = joints(OTHERS, SEEDS[1])
    found = fitted(joints(JOINTS, SEEDS[0]), options.steps)
    nothing = (np.zeros((UNITS, others.u.shape[-1])), found[1])
    for name, weights in (("without them", nothing), ("as shipped", friction_features.shipped()), ("fitted", found)):
        left = judged(weights, others)
        print(f"FVU of friction on {OTHERS} other joints, {name}: median {np.median(left):.4f}, mean {left.mean():.4f}")
    if options.write:
        place = Path(friction_features.__file__).with_name(friction_features.WEIGHTS)
        rows = {name: np.round(layer, DIGITS).tolist() for name, layer in zip(("W1", "W2"), found, strict=True)}
        with whole_file(place, "weights") as file:
            file.write_text(json.dumps(rows) + "\n", encoding="utf-8")
        print(f"wrote {place}")


def joints(count: int, seed: int) -> Joints:
    """Random joints along random motions."""
    rng = np.random.default_rng(seed)
    time = STEP * np.arange(round(DURATION / STEP))
    nu, a = np.zeros((2, count, time.size))
    for i in range(count):
        for _ in range(rng.integers(1, 4)):
            period, size = log_uniform(rng, 0.5, 8.0), log_uniform(rng, 0.02, 1.0)
            w, phase = 2 * np.pi / period, rng.uniform(0.0, 2 * np.pi)
            size *= min(1.0, float(period) / 3.0)
            nu[i] += size * w * np.cos(w * time + phase)
            a[i] -= size * w * w * np.sin(w * time + phase)
    static = rng.uniform(1.0, 2.0, count)
    stribeck, bristle = log_uniform(rng, 0.005, 0.2, count), log_uniform(rng, 1e-5, 2e-2, count)
    friction = lugre(nu, static, stribeck, bristle)[:, SETTLED:]
    nu, a = (
        part[:, SETTLED:] + noise * rng.standard_normal(friction.shape)
        for part, noise in zip((nu, a), NOISE, strict=True)
    )
    known = np.stack((nu, np.tanh(nu / SPEEDS[0]), a, np.ones_like(nu)), axis=-1)
    return Joints(inputs(nu, a), known, friction)


def log_uniform(rng: np.random.Generator, low: float, high: float, size: int | None = None) -> Array:
    """Numbers whose logarithms are evenly spread."""
    return np.asarray(np.exp(rng.uniform(np.log(low), np.log(high), size)))


def lugre(nu: Array, static: Array, stribeck: Array, bristle: Array) -> Array:
    """Friction of joints along speeds (joints, samples), dry friction 1; exact for a speed that stays for a part step.

    `z' = nu - |nu| z / (bristle g)`, `g = 1 + (static - 1) exp(-(nu / stribeck)^2)`, friction z / bristle.

    Args:
        nu: Speeds, a row per joint [rad/s].
        static: (joints,) static friction.
        stribeck: (joints,) speed over which it falls [rad/s].
        bristle: (joints,) way over which friction builds up [rad].
    """
    found, f = np.zeros_like(nu), np.zeros(len(nu))
    for k, speed in enumerate(nu.T):
        g = 1.0 + (static - 1.0) * np.exp(-((speed / stribeck) ** 2))
        keep, end = np.exp(-np.abs(speed) * STEP / BETWEEN / (bristle * g)), g * np.sign(speed)
        for _ in range(BETWEEN):
            f = end + (f - end) * keep
        found[:, k] = f
    return found


def inputs(nu: Array, a: Array) -> Array:
    """What the first layer sees, as `friction_features.inputs`, for many samples at once."""
    way = nu * np.abs(nu) / (2.0 * (np.abs(a) + SLOWEST))
    parts = ((nu, SPEEDS), (a, ACCELERATIONS), (way, WAYS))
    return np.concatenate([np.tanh(part[..., None] / scales) for part, scales in parts], axis=-1)


def combined(weights: tuple[Array, Array], some: Joints) -> tuple[Array, Array]:
    """Units (joints, samples, units), and all columns of the regression, those that are known first."""
    hidden = np.tanh(some.u @ weights[0].T)
    return hidden, np.concatenate((some.known, hidden @ weights[1].T), axis=-1)


def ridge(Phi: Array, friction: Array) -> Array:
    """Every joint's combination of the columns, (joints, columns)."""
    samples, columns = Phi.shape[1:]
    normal = np.einsum("rnm,rnk->rmk", Phi, Phi) / samples + RIDGE * np.eye(columns)
    return np.asarray(np.linalg.solve(normal, np.einsum("rnm,rn->rm", Phi, friction)[..., None] / samples)[..., 0])


def slope(weights: tuple[Array, Array], some: Joints) -> tuple[Array, Array]:
    """Gradient of the FVU that ridge regression leaves, mean over the joints."""
    hidden, Phi = combined(weights, some)
    w = ridge(Phi, some.friction)
    error = some.friction - np.einsum("rnm,rm->rn", Phi, w)
    scale = -2.0 / (error.size * some.friction.var(axis=1))
    features = scale[:, None, None] * error[..., None] * w[:, None, some.known.shape[-1] :]
    net = (features @ weights[1]) * (1.0 - hidden**2)
    return np.einsum("rnh,rni->hi", net, some.u), np.einsum("rnd,rnh->dh", features, hidden)


def fitted(some: Joints, steps: int) -> tuple[Array, Array]:
    """W1 and W2 by Adam (Kingma and Ba 2015, ICLR) on a few joints at a time."""
    rng = np.random.default_rng(SEEDS[2])
    weights = (rng.normal(0.0, 0.5, (UNITS, some.u.shape[-1])), rng.normal(0.0, 0.5, (FEATURES, UNITS)))
    mean, square = ([np.zeros_like(layer) for layer in weights] for _ in range(2))
    for k in range(steps):
        gradient = slope(weights, some.of(rng.choice(len(some.friction), BATCH, replace=False)))
        rate = RATE * (1.0 - k / steps)
        for layer, g, m, v in zip(weights, gradient, mean, square, strict=True):
            m += 0.1 * (g - m)
            v += 0.001 * (g * g - v)
            layer -= rate * m / (1 - 0.9 ** (k + 1)) / (np.sqrt(v / (1 - 0.999 ** (k + 1))) + 1e-8)
    return weights


def judged(weights: tuple[Array, Array], some: Joints) -> Array:
    """FVU of every joint's friction on the second half of its motion, its combination from the first, (joints,)."""
    half = some.friction.shape[1] // 2
    first, second = some.part(slice(half)), some.part(slice(half, None))
    w = ridge(combined(weights, first)[1], first.friction)
    error = second.friction - np.einsum("rnm,rm->rn", combined(weights, second)[1], w)
    return np.asarray((error**2).mean(axis=1) / second.friction.var(axis=1))


if __name__ == "__main__":
    main()
