"""What predicts the torques of a motion from other motions: the package's learners, and what they add to a model.

**As on the robot**: a learner goes once along the motions to learn on, as if it had driven the robot: what it measures
is the motion, what it sent is the measured torque, and its tracking errors are zero. A two-layer network learns from
nothing but these errors: it gets those that its feedback would have needed, `K s = tau - Psi_hat`. K is a joint's
largest torque at an error of 1 rad/s: bandwidths times inertias would be gains of another robot, as URDFs lack rotors.
Then the weights are held, and Psi_hat is evaluated along the other motions. Settings are the shipped ones; `patient`
forgets nothing (drift 0), and learns nothing while the robot stands still.

**At once**: ridge regression on what the identified model leaves. Features are a joint's own, or random ones of all
joints; their number is fixed, the weight of the ridge is what does best on logs (or fifths of a log) left out of those
to learn on, and so is, for `chosen`, which features a joint gets, if any.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mmnn_pin import load_experiment
from mmnn_pin.deploy.identify.identification import Identification
from mmnn_pin.lab.psi.learner import Learner, LearnerStepper, frozen_psi_hat
from mmnn_pin.loop.controller import context_of
from mmnn_pin.model.robot import Robot
from mmnn_pin.signals import Array, IntArray, Layout
from mmnn_pin.torque.controller import Context, ControllerState

from .motion import APART, Motion, Stretch

NOTHING = (
    "kalman_regressor",
    "kalman_friction",
    "kalman_bilinear",
    "kalman_features",
    "two_layer",
)
SURE = ("kalman_regressor", "kalman_friction")  # that can begin with parameters and their covariance
RESIDUAL = ("kalman_residual", "two_layer_residual")  # on a nominal model
BY_ERROR = ("two_layer", "two_layer_residual")  # that learn from tracking errors alone
STILL = 0.02  # largest velocity of a joint below which the robot stands still [rad/s]
ERROR = 1.0  # that is answered with a motor's largest torque [rad/s]
SPEEDS = (0.01, 0.03, 0.1, 0.3, 1.0)  # over which friction turns [rad/s or m/s]
TURNS = SPEEDS[1]
RANDOM, SPREAD = 200, 0.5  # random functions, and their weights on inputs
FAST = 3.0  # acceleration that counts as an input of one [rad/s^2]
RIDGES = np.geomspace(1e-6, 1e2, 17)  # over the number of equations
BLOCKS = 5  # of a log, where there are too few to leave out whole ones
FEW = 3


# -- as on the robot ---------------------------------------------------------------------------------------------------


def gains(robot: Robot) -> Array:
    """What a joint's motor can give, at an error of `ERROR`, (p,) [N m s]."""
    return np.asarray(np.abs(robot.E) @ robot.effort_limits / ERROR)


@dataclass(frozen=True)
class Rival:
    """A learner, and what it begins with."""

    title: str  # in tables
    name: str  # of the controller
    settings: tuple[str, ...] = ()  # what is not as shipped
    patient: bool = False  # whether it does not learn while the robot stands still


def rivals(files: Mapping[str, Path]) -> Iterator[Rival]:
    """All of them; files are those that `mmnn identify` writes."""
    model = (f"nominal.robot='{files['urdf']}'", "nominal.masses=1.0", "nominal.friction=true")
    begun = {name: (f"{name.replace('_', '.')}.start='{files['json']}'",) for name in SURE}
    some = [Rival(name, name) for name in NOTHING]
    some += [Rival(f"{name} from identified", name, start) for name, start in begun.items()]
    some += [Rival(f"{name} on identified", name, model) for name in RESIDUAL]
    for one in some:
        yield one
        if one.name.startswith("kalman"):
            keeps = (*one.settings, f"{one.name.replace('_', '.')}.drift=0.0")
            yield Rival(f"{one.title}, patient", one.name, keeps, patient=True)


def new_learner(rival: Rival, found: Identification, period: float) -> Learner:
    """A learner for a robot and gains, ahead of its first sample."""
    robot = found.robot
    experiment = load_experiment("track", [f"feedback.arm={gains(robot).tolist()}", *rival.settings])
    controller: Any = experiment.controller(rival.name, robot=robot)
    context = context_of(controller, robot, Context(Layout.of(robot.dimensions), period, 1))
    return Learner(controller, context, start := controller.init(context), start, 0.0, robot)


def taught(learner: Learner, stretches: Sequence[Stretch], rival: Rival) -> ControllerState:
    """The state of a learner, given at its start, that went along stretches once."""
    state, layout, start = learner.start.snapshot(), learner.context.layout, 0.0
    stepper, asked = LearnerStepper(learner, state), LearnerStepper(learner, state, learning=False)
    torque, r = layout.where("torque"), layout.where("r")
    K = learner.controller.feedback_gain(layout)
    for stretch in stretches:
        moves = np.abs(stretch.nu).max(axis=1) > STILL
        for row in stretch.rows(layout, start)[moves if rival.patient else ...]:
            if rival.name in BY_ERROR:
                asked.step(row)
                row[r] = (row[torque] - asked.known) / K
            stepper.step(row)
        start += float(stretch.time[-1] - stretch.time[0]) + APART
    return state


def along(learner: Learner, state: ControllerState) -> Callable[[Stretch], Array]:
    """What held weights say along a stretch, (N, p)."""
    return lambda stretch: frozen_psi_hat(learner, state, stretch.rows(learner.context.layout, 0.0))


# -- at once -----------------------------------------------------------------------------------------------------------


def modelled(found: Identification, stretch: Stretch) -> Array:
    """Torques of the identified model along a stretch, (N, r)."""
    Y = found.unknowns.matrix(stretch.q, stretch.nu, stretch.nudot)
    return np.where(found.follows, Y @ found.theta, np.einsum("mrk,rk->mr", Y, found.friction))


def friction(found: Identification, stretch: Stretch) -> Array:
    """Of every joint a constant, its velocity, and dry friction that turns over several speeds, (N, r, k)."""
    nu = stretch.nu
    return np.stack((np.ones_like(nu), nu, *(np.tanh(nu / speed) for speed in SPEEDS)), axis=-1)


def load(found: Identification, stretch: Stretch) -> Array:
    """Friction, and what grows with the torque through the gear (Hamon, Gautier, Garrec 2010, IROS), (N, r, k)."""
    said, sign = modelled(found, stretch), np.tanh(stretch.nu / TURNS)
    return np.concatenate((friction(found, stretch), np.stack((said, np.abs(said) * sign), axis=-1)), axis=-1)


def place(found: Identification, stretch: Stretch) -> Array:
    """The same, and what repeats once and twice a turn of the joint, at rest and with its direction, (N, r, k)."""
    waves = [wave(n * stretch.q) for n in (1, 2) for wave in (np.cos, np.sin)]
    sign = np.tanh(stretch.nu / TURNS)
    return np.concatenate(
        (load(found, stretch), np.stack([*waves, *(wave * sign for wave in waves)], axis=-1)), axis=-1
    )


def anything(found: Identification, stretch: Stretch) -> Array:
    """Random functions of positions, velocities and accelerations of all joints, for each the same, (N, r, k)."""
    rng = np.random.default_rng(0)
    x = np.hstack((stretch.q, stretch.nu, stretch.nudot / FAST, np.tanh(stretch.nu / TURNS)))
    made = np.tanh(x @ rng.normal(0.0, SPREAD, (x.shape[1], RANDOM)) + rng.uniform(-1.0, 1.0, RANDOM))
    phi = np.hstack((np.ones((len(x), 1)), x, made))
    return np.broadcast_to(phi[:, None], (len(x), stretch.nu.shape[1], phi.shape[1]))


LOAD = "friction by load"
FEATURES = {"friction": friction, LOAD: load, f"{LOAD} and place": place, "random features": anything}


@dataclass(frozen=True, eq=False)
class Residual:
    """Weights of one joint for scaled features, and what they leave on blocks left out."""

    w: Array  # (k,) weights of the features
    left: float  # sum of squares on blocks that the weights were not fitted on


def ridge(Phi: Array, y: Array, block: IntArray) -> Residual:
    """Ridge regression, its weight the best one on blocks left out.

    Args:
        Phi: (M, k).
        y: (M,).
        block: (M,) number of the block of every row.
    """
    scale = np.sqrt((Phi**2).mean(axis=0)) + 1e-12
    A, left = Phi / scale, np.zeros(len(RIDGES))
    G, g = A.T @ A, A.T @ y
    for number in np.unique(block):
        out = block == number
        w = solved(G - A[out].T @ A[out], g - A[out].T @ y[out], len(y) - int(out.sum()))
        left += ((y[out] - w @ A[out].T) ** 2).sum(axis=1)
    best = int(np.argmin(left))
    return Residual(solved(G, g, len(y))[best] / scale, float(left[best]))


def solved(G: Array, g: Array, rows: int) -> Array:
    """Weights (ridges, k) for every weight of the ridge, of the normal equations `G w = g` of some rows."""
    values, V = np.linalg.eigh(G)
    values, turned = np.maximum(values, 0.0), V.T @ g
    return np.stack([V @ (turned / (values + weight * rows)) for weight in RIDGES])


def blocks(motion: Motion) -> IntArray:
    """Number of the block of every equation: its stretch, or a fifth of it where there are few, (M,)."""
    parts = [len(rows) for rows in motion.equations]
    if len(parts) >= FEW:
        return np.repeat(np.arange(len(parts)), parts)
    return np.concatenate([BLOCKS * i + np.arange(n) * BLOCKS // n for i, n in enumerate(parts)])


def residuals(found: Identification, learned: Motion, judged: Motion) -> tuple[dict[str, Array], list[str]]:
    """Predictions of the judged motion by kind of features, (M, r) each, and what was chosen for every joint."""
    training, block = learned.stacked, blocks(learned)
    rest = training.y - found.predicted("identified", training)
    base = found.predicted("identified", judged.stacked)
    made = {f"identified + {kind}": base.copy() for kind in FEATURES}
    best, chosen = [""] * base.shape[1], base.copy()
    least = [float((rest[training.use[:, i], i] ** 2).sum()) for i in range(base.shape[1])]
    for kind, features in FEATURES.items():
        Phi, there = (motion.filtered(lambda s: features(found, s)) for motion in (learned, judged))  # noqa: B023
        for i in range(base.shape[1]):
            use = training.use[:, i]
            one = ridge(Phi[use, i], rest[use, i], block[use])
            added = there[:, i] @ one.w
            made[f"identified + {kind}"][:, i] += added
            if one.left < least[i]:
                least[i], best[i] = one.left, kind
                chosen[:, i] = base[:, i] + added
    return made | {"identified + chosen": chosen}, best
