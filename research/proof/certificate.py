"""The certificate: what docs/explanation/theory.md guarantees for one robot, gains, reference and region, in numbers.

A box bounds the size of the pose error, every arm error, and the energy of the errors in velocity. It is *invariant*
when on each of its faces that error falls: no motion of the sampled loop leaves it, for any weights that the update can
reach and any disturbance within its bound (section 5). From an invariant box every motion enters the next smaller one
of `Boxes.descend` and stays there: the sublevel sets of a Lyapunov function of the kind max(error over its bound). The
last one contains all places where that function may grow: the ultimate bound.

Where the region asked for cannot be certified, the conditions tell what fails and by how much; where none is asked for,
the largest that can be is searched for.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from functools import partial
from itertools import chain
from typing import Any

import numpy as np

from mmnn_pin.lab.psi.learner import NAMES
from mmnn_pin.settings import finite

from .boxes import STRICT, Box, Boxes, Faces
from .certified_loop import CertifiedLoop, Condition
from .cover import Cover
from .motion_bound import MotionBound, drivers, motion_bound

Row = tuple[str, float, str, str, str]  # the first fields of a Constant
ENERGIES = np.geomspace(1e-6, 30.0, 64)  # [J]
SIZES = np.array(
    [0.01, 0.03, 0.06, 0.09, 0.13, 0.17, 0.2, 0.25, 0.3, 0.36, 0.42, 0.5, 0.6, 0.72]
)  # of the largest size

ARMS = (1.0, 1.2, 2.5)  # of the size that the energy drives the arm errors to
NAMED = 3  # of what drives the energy most
REMEDIES = {  # by how the name of a condition begins
    "speed": "a reference that never stands still",
    "leakage": "a smaller F or G, or less leakage",
    "weights": "leakage (kappa > 0), or a projection of the weights",
    "period": "a shorter control period, or weaker feedback of the lightest joint",
    "feedback, held": "a shorter control period",
    "feedback": "stronger feedback, or a smaller kx and K",
    "decay, arm": "gains K that differ less",
    "arm": "a larger K, or stronger feedback",
    "face, arm": "a larger K, or stronger feedback",
    "face, pose": "larger kx, ky and kth, or stronger feedback",
    "pose": "a smaller region, or a faster reference",
    "face, energy": "stronger feedback at a shorter period, or less of what drives it",
    "motors": "stronger motors, or a smaller region",
    "supervisor": "wider limits, or a smaller region",
}


@dataclass(frozen=True, eq=False)
class Certificate:
    """What is guaranteed."""

    boxes: Boxes  # the boxes of the loop
    # from the region to the one that every motion from there ends up in; one if the region is not invariant
    faces: list[Faces] = field(default_factory=list)
    asked: bool = False  # whether the region is one that was asked for; else it was looked for

    @property
    def holds(self) -> bool:
        """Whether a region is certified."""
        return self.region.invariant

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

    @property
    def remedy(self) -> str:
        """What to change so that the first condition that fails does not; empty where all hold."""
        failed = next((one.name for one in self.conditions if not one.holds), None)
        if failed is None:
            return ""
        what = next((words for start, words in REMEDIES.items() if failed.startswith(start)), "a smaller region")
        if failed != "face, energy":
            return what
        loop, boxes, box = self.boxes.loop, self.boxes, self.region.box
        cover, names = boxes.cover(box), loop.robot.velocity_names
        shares = list(drivers(cover, boxes.drive(box), box.energy, boxes.gains, names).items())[:NAMED]
        return f"{what}; what drives it most: {', '.join(f'{name} ({share:.0%})' for name, share in shares)}"

    def to_dict(self) -> dict[str, Any]:
        """Whether it holds, conditions, constants, region and bound, for JSON."""
        names = self.boxes.loop.robot.velocity_names
        return {
            "holds": self.holds,
            "region_asked_for": self.asked,
            "remedy": self.remedy,
            "conditions": [
                asdict(c) | {"limit": finite(c.limit), "value": finite(c.value), "holds": c.holds}
                for c in self.conditions
            ],
            "constants": [
                asdict(c) | {"value": finite(c.value), "sampled": None if c.sampled is None else finite(c.sampled)}
                for c in self.constants
            ],
            "region": self.region.to_dict(names) if self.holds else None,
            "bound": self.bound.to_dict(names) if self.holds else None,
        }


def certify(loop: CertifiedLoop, region: Box | None = None, start: Box | None = None) -> Certificate:
    """The certificate of a loop.

    Args:
        loop: The loop.
        region: Region to certify; None for the largest that can be, one around `start` if there is one.
        start: Errors that the region had better contain.
    """
    boxes = Boxes(loop, region) if region is not None else search(loop, start)
    return Certificate(boxes, boxes.descend(), region is not None)


def conditions(boxes: Boxes, faces: Faces) -> Iterator[Condition]:
    """See `Certificate.conditions`."""
    loop, motion, box = boxes.loop, faces.motion, faces.box
    yield Condition("speed", loop.pose.slowest, 0.0, "slowest speed of the reference [m/s]", "above")
    for i, network in boxes.networks.items():
        if not network.projected:
            leak = max(network.leak, network.leak_V)
            yield Condition(f"leakage, {NAMES[i]}", leak, 2.0, "kappa F |s| per sample, also with G")
        yield Condition(f"weights, {NAMES[i]}", network.norm, math.inf, f"|Z| has a bound, by {network.why}")
    period = Condition("period", loop.period * motion.fastest, 0.5, "h times the largest eigenvalue of M^-1 k")
    if loop.late > 0:
        words = "h + delay times the largest eigenvalue of M^-1 k"
        period = Condition("period, delay", boxes.gains.oldest * motion.fastest, 1.0, words)
    feedback = "smallest s'Ks / s'Ms: feedback less kinematic gains and Coriolis [1/s]"
    less = "the same less what the hold of the torque takes [1/s]"
    stands = "where the pose error may stand still, within the region [m]"
    wide = box.arm / loop.widest.size if len(faces.joints) else 0.0
    arm = (
        Condition("decay, arm", loop.arm_decay, 0.0, "decay of the arm errors' size [1/s]", "above"),
        Condition("face, arm", faces.arm, box.arm, "the same of the arm errors' size"),
        Condition("arm", wide, 1.0 + 1e-12, "arm errors over those that M is bounded for"),
    )
    yield from (
        Condition("pose", faces.decay, 0.0, "decay of the pose error in the region [1/s]", "above"),
        period,
        Condition("feedback", motion.unheld, 0.0, feedback, "above"),
        Condition("feedback, held", motion.margin, 0.0, less, "above"),
        Condition("face, pose", faces.pose, box.pose, stands),
        *(arm if len(faces.joints) else ()),
        Condition("face, energy", motion.level, box.energy, "the same of the energy of the errors [J]"),
        *faces.limits,
    )


@dataclass(frozen=True)
class Constant:
    """A number of the certificate."""

    name: str  # as in docs/explanation/theory.md
    value: float  # in SI units
    unit: str  # its unit
    source: str  # "given" by robot, settings, reference; "computed" from others; or "bounded" over all configurations
    words: str  # what it is
    # what is bounded, the worst of one configuration in every box: no part of the proof; None for others
    sampled: float | None = None

    @property
    def loose(self) -> float | None:
        """How many times the sampled value the bound is away from 0, or the other way round; None without one."""
        if self.sampled is None or not self.sampled * self.value > 0:
            return None
        return max(self.value / self.sampled, self.sampled / self.value)


def constants(boxes: Boxes, faces: Faces) -> Iterator[Constant]:
    """See `Certificate.constants`."""
    loop, cover = boxes.loop, boxes.cover(faces.box)
    sampled = cover.sampled(loop.bodies)
    there = motion_bound(sampled, boxes.drive(faces.box), faces.box.energy, boxes.gains)
    for name, value, unit, source, words in chain(error_constants(loop, faces), controller_constants(boxes)):
        yield Constant(name, float(value), unit, source, words)
    pairs = zip(dynamic_constants(loop, cover, faces.motion), dynamic_constants(loop, sampled, there), strict=True)
    for (name, value, unit, source, words), (_, other, *_) in pairs:
        yield Constant(name, float(value), unit, source, words, float(other))


def error_constants(loop: CertifiedLoop, faces: Faces) -> list[Row]:
    """Of the reference, the pose and the arm: fields of `Constant`."""
    pose = loop.pose
    arm = [("lambda_b", loop.arm_decay, "1/s", "computed", "decay of the arm errors")]
    return [
        ("h", loop.period, "s", "given", "control period"),
        ("delay", loop.late, "s", "given", "from a sample to when its command is in force, at most"),
        ("vmin", pose.slowest, "m/s", "given", "slowest reference"),
        ("vmax", pose.fastest, "m/s", "given", "fastest reference"),
        ("wmax", pose.turning, "rad/s", "given", "largest yaw rate of the reference"),
        ("drift", loop.drift[0], "m/s", "given", "at which the reference's poses leave its velocities"),
        ("drift, yaw", loop.drift[1], "rad/s", "given", "the same of its heading"),
        ("eps", pose.eps, "", "computed", "weight of ey eta in Vk"),
        ("lambda_a", faces.decay, "1/s", "computed", "decay of the pose error"),
        ("g", faces.yaw_gain, "m", "computed", "how z2 drives the pose error, z1 counting as 1"),
        ("ephi_max", faces.reach.heading, "rad", "computed", "largest heading error"),
        *(arm if len(loop.K) else ()),
    ]


def controller_constants(boxes: Boxes) -> Iterator[Row]:
    """Of the controller and the disturbance, by velocity and by network."""
    gains, names = boxes.gains, boxes.loop.robot.velocity_names
    for name, low, high in zip(names, gains.lower, gains.upper, strict=True):
        yield f"k[{name}] from", low, "SI", "given", "gain on s: k + Kz ZB"
        yield f"k[{name}] to", high, "SI", "computed", "gain on s: k + Kz (|Z| + ZB)"
    for name, value in zip(names, gains.network, strict=True):
        yield f"Psi_hat[{name}]", value, "N, N m", "computed", "what the network may say at most"
    for name, value in zip(names, boxes.loop.disturbance, strict=True):
        yield f"d[{name}]", value, "N, N m", "given", "external force at most"
    for name, value in zip(names, boxes.loop.noise, strict=True):
        if value > 0:
            yield f"n[{name}]", value, "m/s, rad/s", "given", "noise of the measured velocity at most"
    for i, bound in boxes.networks.items():
        yield f"|W| {NAMES[i]}", bound.W, "", "computed", "bound on the output weights"
        yield f"|V| {NAMES[i]}", bound.V, "", "computed", "bound on the hidden weights that learn"


def dynamic_constants(loop: CertifiedLoop, cover: Cover, motion: MotionBound) -> list[Row]:
    """Of the robot's dynamics and of the energy of the errors."""
    least, most = cover.eigenvalues
    arm = [("gamma_b", cover.arm_gain, "", "bounded", "how the energy drives the arm errors")]
    return [
        ("M_min", least, "SI", "bounded", "smallest eigenvalue of M"),
        ("M_max", most, "SI", "bounded", "largest eigenvalue of M"),
        *(arm if len(loop.K) else ()),
        ("mu", motion.fastest, "1/s", "bounded", "largest eigenvalue of M^-1 k"),
        ("margin", motion.margin, "1/s", "bounded", "smallest s' K s / s' M s, hold included"),
        ("lambda_E", motion.rate, "1/s", "bounded", "rate used for the energy of the errors"),
        ("E*", motion.level, "J", "bounded", "energy above which it falls"),
        ("push", motion.pushed, "SI", "bounded", "largest |ds/dt| but for the feedback, in the norm of k"),
    ]


def search(loop: CertifiedLoop, start: Box | None = None) -> Boxes:
    """The largest invariant box of a grid, those around the start first; where there is none, the one nearest to it.

    Boxes are looked at in few postures first, from the best on in all.
    """
    invariant, nearest, least = list[tuple[bool, float, Box]](), None, math.inf
    for some in chain.from_iterable(map(partial(held, loop), ENERGIES)):
        for box in some:
            faces = Boxes(loop, box, glance=True).faces(box)
            if not faces.invariant:
                if (over := excess(faces)) < least:
                    nearest, least = box, over
                break  # a larger pose error drives the energy more
            around = start is not None and start.within(box)
            invariant.append((around, math.log(box.pose * math.sqrt(box.energy) * (box.arm or 1.0)), box))
    for _, _, box in sorted(invariant, key=lambda one: one[:2], reverse=True):
        boxes = Boxes(loop, box)
        if boxes.faces(box).invariant:
            return boxes
    return Boxes(loop, nearest or Box(SIZES[0] * loop.pose.largest, 0.0, ENERGIES[0]))


def held(loop: CertifiedLoop, energy: float) -> Iterator[Iterator[Box]]:
    """Boxes of an energy that hold the errors which it drives: for every size of the arm's, by the pose's."""
    arm = 0.0
    for _ in range(3 * bool(len(loop.K))):  # the gain is that of a cover that holds the arm errors
        arm = math.sqrt(2 * energy) * loop.cover(STRICT * arm).arm_gain / loop.arm_decay
    for more in ARMS if len(loop.K) else (1.0,):
        some = [Box(float(share * loop.pose.largest), STRICT * more * arm, float(energy)) for share in SIZES]
        if Boxes(loop, some[0], glance=True).arm_stands(some[0]) <= some[0].arm:
            yield (box for box in some if Boxes(loop, box, glance=True).pose_stands(box) < box.pose)


def excess(faces: Faces) -> float:
    """How far a box is from being invariant: the largest of its standstills over its bounds; then the margin."""
    box, motion = faces.box, faces.motion
    if not motion.margin > 0:
        return 1e6 - motion.margin if np.isfinite(motion.margin) else 1e12
    return float(min(max(faces.pose / box.pose, motion.level / box.energy), 1e5))
