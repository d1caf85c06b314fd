"""The certificate: what docs/theory.md guarantees for one robot, gains, reference and region, every constant a number.

A region of errors that no motion of the sampled loop leaves, and the smaller one that every motion from there ends up
in, for any weights that the update can reach and any disturbance within its bound. Where the region asked for cannot
be certified, the largest that can is looked for; where there is none, the conditions tell what fails and by how much.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from .boxes import STRICT, Box, Boxes, Faces
from .certified_loop import CertifiedLoop
from .learner import NAMES

ENERGIES = np.geomspace(1e-6, 30.0, 32)  # [J]
SIZES = np.array([0.01, 0.03, 0.07, 0.13, 0.2, 0.3, 0.42, 0.56, 0.72])  # of the largest size of the pose error
THIN = 8  # of the samples, every which is looked at in the search
ARMS = (1.0, 2.5)  # of the size that the energy drives the arm errors to


@dataclass(frozen=True)
class Constant:
    """A number of the certificate.

    Attributes:
        name: As in docs/theory.md.
        value: In SI units.
        unit: Its unit.
        source: "given" (robot, settings, reference), "computed" from others, or "sampled" (over configurations).
        words: What it is.
    """

    name: str
    value: float
    unit: str
    source: str
    words: str


@dataclass(frozen=True)
class Condition:
    """A condition of the theorem: `value < limit`, or `value > limit`.

    Attributes:
        name: Which.
        value: Left side.
        limit: Right side.
        words: What it says.
        need: "below" or "above".
    """

    name: str
    value: float
    limit: float
    words: str
    need: str = "below"

    @property
    def holds(self) -> bool:
        """Whether it is met; what is no number is not."""
        return bool(self.value > self.limit if self.need == "above" else self.value < self.limit)


@dataclass(frozen=True, eq=False)
class Certificate:
    """What is guaranteed.

    Attributes:
        boxes: The boxes of the loop.
        faces: From the region to the one that every motion from there ends up in; one if the region is not held.
        asked: Whether the region is one that was asked for; else it was looked for.
    """

    boxes: Boxes
    faces: list[Faces] = field(default_factory=list)
    asked: bool = False

    @property
    def holds(self) -> bool:
        """Whether a region is certified."""
        return self.region.held

    @property
    def region(self) -> Faces:
        """The region: no motion leaves it."""
        return self.faces[0]

    @property
    def bound(self) -> Faces:
        """The ultimate bound: every motion from the region enters it and stays."""
        return self.faces[-1]

    @property
    def conditions(self) -> list[Condition]:
        """The conditions of the theorem in the region."""
        return list(conditions(self.boxes, self.region))

    @property
    def constants(self) -> list[Constant]:
        """The constants of the theorem in the region."""
        return list(constants(self.boxes, self.region))


def certify(loop: CertifiedLoop, region: Box | None = None, start: Box | None = None) -> Certificate:
    """The certificate of a loop.

    Args:
        loop: The loop.
        region: Region to certify; None for the largest that can be, one around `start` if there is one.
        start: Errors that the region had better contain.
    """
    boxes = Boxes(loop, region) if region is not None else search(loop, start)
    return Certificate(boxes, boxes.descend(), region is not None)


def search(loop: CertifiedLoop, start: Box | None = None) -> Boxes:
    """The largest held box of a grid, those around the start first; where there is none, the one nearest to it.

    Boxes are looked at with few samples first, from the best on with all.
    """
    few = loop.samples.thinned(THIN)
    held, nearest, least = [], None, math.inf
    for box in candidates(loop):
        boxes = Boxes(loop, box, few)
        if not (boxes.pose_stands(box) < box.pose and boxes.arm_stands(box) <= box.arm):
            continue
        faces = boxes.faces(box)
        if faces.held:
            around = start is not None and start.within(box)
            held.append((around, math.log(box.pose * math.sqrt(box.energy) * (box.arm or 1.0)), box))
        elif (over := excess(faces)) < least:
            nearest, least = box, over
    for _, _, box in sorted(held, key=lambda one: one[:2], reverse=True):
        boxes = Boxes(loop, box)
        if boxes.faces(box).held:
            return boxes
    return Boxes(loop, nearest or Box(SIZES[0] * loop.pose.largest, 0.0, ENERGIES[0]))


def candidates(loop: CertifiedLoop) -> Iterator[Box]:
    """Boxes whose arm errors are those that the energy drives, or more."""
    for energy in ENERGIES:
        arm = math.sqrt(2 * energy) * loop.samples.arm_gain / loop.arm_decay if len(loop.K) else 0.0
        for share in SIZES:
            for more in ARMS if len(loop.K) else (1.0,):
                yield Box(float(share * loop.pose.largest), STRICT * more * arm, float(energy))


def excess(faces: Faces) -> float:
    """How far a box is from being held: the largest of its errors' standstills over their bounds; then the margin."""
    box, motion = faces.box, faces.motion
    if not motion.margin > 0:
        return 1e6 - motion.margin if np.isfinite(motion.margin) else 1e12
    return float(min(max(faces.pose / box.pose, motion.level / box.energy), 1e5))


def conditions(boxes: Boxes, faces: Faces) -> Iterator[Condition]:
    """See `Certificate.conditions`."""
    loop, motion, box = boxes.loop, faces.motion, faces.box
    yield Condition("speed", loop.pose.slowest, 0.0, "slowest speed of the reference [m/s]", "above")
    for i, network in boxes.networks.items():
        name = NAMES[i]
        if not network.projected:
            leak = max(network.leak, network.leak_V)
            yield Condition(f"leakage, {name}", leak, 2.0, "kappa F |s| per sample, also with G")
        yield Condition(f"weights, {name}", network.norm, math.inf, f"|Z| has a bound, by {network.why}")
    yield Condition("pose", faces.decay, 0.0, "decay of the pose error in the region [1/s]", "above")
    yield Condition("period", loop.period * motion.fastest, 0.5, "h times the largest eigenvalue of M^-1 k")
    words = "smallest s'Ks / s'Ms: feedback less kinematic gains and Coriolis [1/s]"
    yield Condition("feedback", motion.unheld, 0.0, words, "above")
    yield Condition(
        "feedback, held", motion.margin, 0.0, "the same less what the hold of the torque takes [1/s]", "above"
    )
    yield Condition("face, pose", faces.pose, box.pose, "where the pose error may stand still, within the region [m]")
    if len(faces.joints):
        yield Condition("decay, arm", loop.arm_decay, 0.0, "decay of the arm errors' size [1/s]", "above")
        yield Condition("face, arm", faces.arm, box.arm, "the same of the arm errors' size")
        share = float((faces.joints / loop.samples.spread).max())
        yield Condition("arm", share, 1.0 + 1e-12, "the region's arm errors over those that were sampled")
    yield Condition("face, energy", motion.level, box.energy, "the same of the energy of the errors [J]")
    for limit in faces.limits:
        yield Condition(limit.name, limit.value, limit.limit, limit.words)


def constants(boxes: Boxes, faces: Faces) -> Iterator[Constant]:
    """See `Certificate.constants`."""
    loop, motion, pose, gains = boxes.loop, faces.motion, boxes.loop.pose, boxes.gains
    yield Constant("h", loop.period, "s", "given", "control period")
    yield Constant("vmin", pose.slowest, "m/s", "given", "slowest reference")
    yield Constant("vmax", pose.fastest, "m/s", "given", "fastest reference")
    yield Constant("wmax", pose.turning, "rad/s", "given", "largest yaw rate of the reference")
    yield Constant("drift", loop.drift[0], "m/s", "given", "at which the reference's poses leave its velocities")
    yield Constant("drift, yaw", loop.drift[1], "rad/s", "given", "the same of its heading")
    yield Constant("eps", pose.eps, "", "computed", "weight of ey eta in Vk")
    yield Constant("lambda_a", faces.decay, "1/s", "computed", "decay of the pose error")
    yield Constant("g", faces.yaw_gain, "m", "computed", "how z2 drives the pose error, z1 counting as 1")
    yield Constant("ephi_max", faces.reach.heading, "rad", "computed", "largest heading error")
    if len(loop.K):
        yield Constant("lambda_b", loop.arm_decay, "1/s", "computed", "decay of the arm errors")
        yield Constant("gamma_b", loop.samples.arm_gain, "", "sampled", "how the energy drives the arm errors")
    names = loop.robot.velocity_names
    for name, low, high in zip(names, gains.lower, gains.upper, strict=True):
        yield Constant(f"k[{name}] from", float(low), "SI", "given", "gain on s: k + Kz ZB")
        yield Constant(f"k[{name}] to", float(high), "SI", "computed", "gain on s: k + Kz (|Z| + ZB)")
    for name, value in zip(names, gains.network, strict=True):
        yield Constant(f"Psi_hat[{name}]", float(value), "N, N m", "computed", "what the network may say at most")
    for name, value in zip(names, gains.disturbance, strict=True):
        yield Constant(f"d[{name}]", float(value), "N, N m", "given", "external force at most")
    for i, network in boxes.networks.items():
        yield Constant(f"|W| {NAMES[i]}", network.W, "", "computed", "bound on the output weights")
        yield Constant(f"|V| {NAMES[i]}", network.V, "", "computed", "bound on the hidden weights that learn")
    eigenvalues = np.linalg.eigvalsh(loop.samples.M)
    yield Constant("M_min", float(eigenvalues.min()), "SI", "sampled", "smallest eigenvalue of M")
    yield Constant("M_max", float(eigenvalues.max()), "SI", "sampled", "largest eigenvalue of M")
    yield Constant("mu", motion.fastest, "1/s", "sampled", "largest eigenvalue of M^-1 k")
    yield Constant("margin", motion.margin, "1/s", "sampled", "smallest s' K s / s' M s, hold included")
    yield Constant("lambda_E", motion.rate, "1/s", "sampled", "rate used for the energy of the errors")
    yield Constant("push", motion.pushed, "SI", "sampled", "largest |ds/dt| but for the feedback, in the norm of k")
