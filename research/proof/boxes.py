"""Boxes of errors of a loop, and where in a box each error may stand still (docs/explanation/theory.md, section 5)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mmnn_pin.signals import Array

from .bounds import PoseSet, WeightsBound, weights_bound
from .certified_loop import CertifiedLoop, Condition, limits_in, limits_of_motors
from .cover import Cover
from .momentum import Momentum
from .motion_bound import Drive, Gains, MotionBound, drive, motion_bound

BoolArray = NDArray[np.bool_]
STRICT = 1.005  # a box is this much larger than the place where its error may stand still
STEPS = 200
SMALL = 1e-12  # of the region's energy: what is below is left to rounding
SETTLED = 1e-3
NEAR = 1.1  # times a box's pose errors: where those moved by the momentum of the base stay


class Boxes:
    """The boxes of one loop, for weights that are bounded as they are in the outermost one.

    Args:
        loop: The loop.
        outer: The outermost box; the weights' bounds are taken there.
        glance: Whether few postures are enough, for a first look.
    """

    def __init__(self, loop: CertifiedLoop, outer: Box, glance: bool = False) -> None:
        self.loop, self.outer, self.glance = loop, outer, glance

    def cover(self, box: Box) -> Cover:
        """Where the robot may be while its errors are in a box."""
        found = self.loop.cover(box.arm)
        return found.few if self.glance else found

    @cached_property
    def networks(self) -> dict[int, WeightsBound]:
        """Bounds on the weights of every network, (1 the base's, 2 the arm's)."""
        loop = self.loop
        if loop.learner is None:
            return {}
        s = self.measured(self.outer)
        x = loop.input_norm(self.drive(self.outer), self.outer.pose, self.joints(self.outer), s)
        return {i: weights_bound(loop.learner, i, s, x, loop.projection) for i, _ in loop.learner.networks}

    @cached_property
    def gains(self) -> Gains:
        """What the controller does inside of the outermost box."""
        loop, network = self.loop, np.zeros(self.loop.robot.dimensions.dof)
        (Kz, ZB), norm = loop.robust, np.zeros_like(network)
        for i, part in loop.learner.networks if loop.learner else ():
            network[part], norm[part] = self.networks[i].output, self.networks[i].norm
        upper = loop.gain + np.where(Kz > 0, Kz * (np.where(Kz > 0, norm, 0.0) + ZB), 0.0)
        force = loop.disturbance + np.where(loop.noise > 0, upper, 0.0) * loop.noise
        return Gains(loop.gain + Kz * ZB, upper, network, loop.K, force, loop.period, loop.late, loop.weighs)

    def velocity(self, box: Box) -> Array:
        """(p,) largest |s_i| in a box."""
        return np.asarray(np.sqrt(2 * box.energy * self.cover(box).lightest))

    def measured(self, box: Box) -> Array:
        """(p,) the same of s as the controller sees it."""
        return self.velocity(box) + self.loop.noise

    def joints(self, box: Box) -> Array:
        """(n,) largest |e_i| in a box."""
        return box.arm * self.loop.metric.reach

    def drive(self, box: Box) -> Drive:
        """What the errors of a box do to the reference velocity."""
        loop, reach = self.loop, self.loop.pose.reach(box.pose)
        return drive(loop.pose, reach, box.arm, self.joints(box), loop.K, loop.along.a_ref, loop.drift)

    def pose_stands(self, box: Box, energy: float | None = None) -> float:
        """Size below which the pose error may grow in a box [m], for energies up to one below the box's if given.

        inf where nothing holds it.
        """
        pose, (away, turning) = self.loop.pose, self.loop.drift
        decay = pose.decay(box.pose, float(self.velocity(box)[1]))
        G = np.array([1.0, pose.yaw_gain(pose.reach(box.pose).cosine)])
        driven = np.linalg.eigvalsh(G[:, None] * self.cover(box).M_inverse[:, :2, :2] * G).max()
        speed = np.sqrt(2 * (box.energy if energy is None else energy) * driven) + away + G[1] * turning
        return float(speed / decay) if decay > 0 else np.inf

    def pose_carried(self, box: Box, energy: float) -> float:
        """Size that the pose error of motions in a box falls below [m], by the momentum of the base; inf for none.

        Args:
            box: The box.
            energy: Of the errors in velocity from some time on [J].
        """
        pose, cover, (away, turning) = self.loop.pose, self.cover(box), self.loop.drift
        s, wide = np.sqrt(2 * energy * cover.lightest), NEAR * box.pose
        found = Momentum.of(cover, self.drive(box), energy, self.gains, s)
        if found is None or not wide < pose.largest:
            return np.inf
        reach, decay, (x, phi) = pose.reach(wide), pose.decay(wide, float(s[1])), found.moved
        G = pose.yaw_gain(reach.cosine)
        shift = x + G * phi
        if not (decay > 0 and box.pose + shift <= wide):
            return np.inf
        w = pose.turning + pose.fastest * reach.turn + s[1]
        driven = np.hypot(found.drive[0] + pose.kx * x, G * (found.drive[1] + pose.fastest * pose.kth * phi))
        return float((driven + w * x + pose.fastest * phi + away + G * turning) / decay + shift)

    def arm_stands(self, box: Box) -> float:
        """The same of the arm errors' size; inf where M has no bound for it, or without decay."""
        if not len(self.loop.K):
            return 0.0
        cover = self.cover(box)
        if box.arm > cover.size or not self.loop.arm_decay > 0:
            return np.inf
        return float(np.sqrt(2 * box.energy) * cover.arm_gain / self.loop.arm_decay)

    def faces(self, box: Box) -> Faces:
        """Judge a box within the outermost one."""
        pose = self.loop.pose
        reach, s = pose.reach(box.pose), self.velocity(box)
        return Faces(
            box=box,
            reach=reach,
            decay=pose.decay(box.pose, float(s[1])),
            yaw_gain=pose.yaw_gain(reach.cosine),
            joints=self.joints(box),
            velocity=s,
            motion=motion_bound(self.cover(box), self.drive(box), box.energy, self.gains),
            pose=self.pose_stands(box),
            arm=self.arm_stands(box),
            limits=self.limits(box),
        )

    def limits(self, box: Box) -> list[Condition]:
        """What may be reached in a box of the limits of motors and supervisor."""
        loop, s = self.loop, self.measured(box)
        held = self.gains.network + (self.cover(box).weight if loop.weighs else 0.0)
        bounded = np.nan_to_num(self.gains.upper * s + held, posinf=1e300)  # 0 times inf is not 0
        result = limits_of_motors(loop.motors, torque := np.abs(np.linalg.inv(loop.robot.E)) @ bounded)
        if (its := loop.supervisor) is None:
            return result
        return result + limits_in(its, loop.signal_bounds(self.drive(box), box.pose, self.joints(box), s), torque)

    def inner(self, faces: Faces) -> Box:
        """The next smaller box: the energy first, then what it drives."""
        box, level = faces.box, faces.motion.level
        energy = min(box.energy, STRICT * level)
        share = float(np.sqrt(energy / box.energy))
        pose = min(box.pose, STRICT * self.pose_stands(box, energy), STRICT * self.pose_carried(box, energy))
        return Box(pose, min(box.arm, STRICT * share * faces.arm), energy)

    def descend(self) -> list[Faces]:
        """From the outermost box, if it is invariant, to the one that every motion from there ends up in."""
        result = [self.faces(self.outer)]
        while result[0].invariant and len(result) < STEPS and result[-1].box.energy > SMALL * self.outer.energy:
            faces = self.faces(self.inner(result[-1]))
            result.append(faces)
            if not faces.box.below(result[-2].box):
                break
        return result


@dataclass(frozen=True, eq=False)
class Box:
    """Errors of at most this."""

    pose: float  # size of the pose error, see `pose_bound` [m]
    arm: float  # size of the arm errors, see `ArmMetric`
    energy: float  # s' M s / 2 [J]

    def within(self, other: Box) -> bool:
        """Whether all of it is in another box."""
        return self.pose <= other.pose and self.arm <= other.arm and self.energy <= other.energy

    def below(self, other: Box) -> bool:
        """Whether it is smaller than another one that it is in, in a measure that counts."""
        pairs = ((self.pose, other.pose), (self.arm, other.arm), (self.energy, other.energy))
        return any(own < (1 - SETTLED) * its for own, its in pairs)

    def holds(self, pose: Array, arm: Array, energy: Array) -> BoolArray:
        """Which of k states are inside; (k,) each."""
        return (pose <= self.pose) & (arm <= self.arm) & (energy <= self.energy)


@dataclass(frozen=True, eq=False)
class Faces:
    """Where each error may stand still, the others anywhere in a box: it falls from there up to the box's face."""

    box: Box  # the box
    reach: PoseSet  # its pose errors
    decay: float  # rate at which the pose error decays in it [1/s]
    yaw_gain: float  # g [m]
    joints: Array  # (n,) largest |e_i| in it [rad or m]
    velocity: Array  # (p,) largest |s_i| in it
    motion: MotionBound  # the energy in it
    pose: float  # size below which the pose error may grow [m]; inf where nothing holds it
    arm: float  # the same of the arm errors
    limits: list[Condition]  # what may be reached in it of the limits of motors and supervisor

    @property
    def invariant(self) -> bool:
        """Whether no motion leaves the box, no motor saturates and no supervisor steps in."""
        inside = self.pose < self.box.pose and self.motion.level < self.box.energy
        inside = inside and all(limit.holds for limit in self.limits)
        return bool(inside and (self.arm < self.box.arm or not len(self.joints)))

    def to_dict(self, names: Sequence[str]) -> dict[str, Any]:
        """The box in the units of its errors, for JSON, with the names of the velocities."""
        return {
            "pose_size": self.box.pose,
            "arm_size": self.box.arm,
            "energy": self.box.energy,
            "ex": self.reach.ex,
            "ey": self.reach.ey,
            "ephi": self.reach.heading,
            "e": {name: float(value) for name, value in zip(names[2:], self.joints, strict=True)},
            "s": {name: float(value) for name, value in zip(names, self.velocity, strict=True)},
        }
