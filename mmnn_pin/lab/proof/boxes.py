"""Nested boxes of errors that a loop does not leave, down to the one that it ends up in (docs/theory.md, section 5).

A box bounds the size of the pose error, every arm error, and the energy of the errors in velocity. It is *held* when on
each of its faces that error falls. From a held box every motion enters the next smaller one of `descend` and stays
there: the sublevel sets of a Lyapunov function of the kind max(error over its bound). The last one contains all places
where that function may grow.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ...signals import Array
from .certified_loop import CertifiedLoop
from .inputs_bound import input_norm, signal_bounds
from .motion_bound import Drive, Gains, MotionBound, drive, motion_bound
from .motion_samples import MotionSamples
from .pose_bound import PoseSet
from .supervised import Limit, limits_in
from .weights_bound import WeightsBound, weights_bound

BoolArray = NDArray[np.bool_]
STRICT = 1.02  # a box is this much larger than the place where its error may stand still
STEPS = 200
SMALL = 1e-12  # of the region's energy: what is below is left to rounding
SETTLED = 1e-3


@dataclass(frozen=True, eq=False)
class Box:
    """Errors of at most this.

    Attributes:
        pose: Size of the pose error, see `pose_bound` [m].
        arm: Size of the arm errors, see `MotionSamples.arm_metric`.
        energy: s' M s / 2 [J].
    """

    pose: float
    arm: float
    energy: float

    def within(self, other: Box) -> bool:
        """Whether all of it is in another box."""
        return self.pose <= other.pose and self.arm <= other.arm and self.energy <= other.energy

    def holds(self, pose: Array, arm: Array, energy: Array) -> BoolArray:
        """Which of k states are inside; (k,) each."""
        return (pose <= self.pose) & (arm <= self.arm) & (energy <= self.energy)


@dataclass(frozen=True, eq=False)
class Faces:
    """Where each error may stand still, the others anywhere in a box: it falls from there up to the box's face.

    Attributes:
        box: The box.
        reach: Its pose errors.
        decay: Rate at which the pose error decays in it [1/s].
        yaw_gain: g [m].
        joints: (n,) largest |e_i| in it [rad or m].
        velocity: (p,) largest |s_i| in it.
        motion: The energy in it.
        pose: Size below which the pose error may grow [m]; inf where nothing holds it.
        arm: The same of the arm errors.
        limits: What may be reached in it of the supervisor's limits.
    """

    box: Box
    reach: PoseSet
    decay: float
    yaw_gain: float
    joints: Array
    velocity: Array
    motion: MotionBound
    pose: float
    arm: float
    limits: list[Limit]

    @property
    def held(self) -> bool:
        """Whether no motion leaves the box, and no supervisor steps in."""
        inside = self.pose < self.box.pose and self.motion.level < self.box.energy
        inside = inside and all(limit.value < limit.limit for limit in self.limits)
        return bool(inside and (self.arm < self.box.arm or not len(self.joints)))


class Boxes:
    """The boxes of one loop, for weights that are bounded as they are in the outermost one.

    Args:
        loop: The loop.
        outer: The outermost box; the weights' bounds are taken there.
        samples: The robot along the reference; all samples if None.
    """

    def __init__(self, loop: CertifiedLoop, outer: Box, samples: MotionSamples | None = None) -> None:
        self.loop, self.outer, self.samples = loop, outer, samples or loop.samples

    @cached_property
    def networks(self) -> dict[int, WeightsBound]:
        """Bounds on the weights of every network, (1 the base's, 2 the arm's)."""
        loop = self.loop
        if loop.learner is None:
            return {}
        s = self.velocity(self.outer)
        x = input_norm(loop, self.drive(self.outer), self.outer.pose, self.joints(self.outer), s)
        found = ((i, weights_bound(loop.learner, i, s, x, loop.projection)) for i, _ in loop.learner.networks)
        return dict(found)

    @cached_property
    def gains(self) -> Gains:
        """What the controller does inside of the outermost box."""
        loop, network = self.loop, np.zeros(self.loop.robot.layout.dof)
        (Kz, ZB), norm = loop.robust, np.zeros_like(network)
        for i, part in loop.learner.networks if loop.learner else ():
            network[part], norm[part] = self.networks[i].output, self.networks[i].norm
        upper = loop.gain + np.where(Kz > 0, Kz * (np.where(Kz > 0, norm, 0.0) + ZB), 0.0)
        return Gains(loop.gain + Kz * ZB, upper, network, loop.K, loop.disturbance, loop.period)

    def velocity(self, box: Box) -> Array:
        """(p,) largest |s_i| in a box."""
        return np.asarray(np.sqrt(2 * box.energy * self.samples.lightest))

    def joints(self, box: Box) -> Array:
        """(n,) largest |e_i| in a box."""
        return box.arm * self.samples.joint_reach

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
        driven = np.linalg.eigvalsh(G[:, None] * self.samples.M_inverse[:, :2, :2] * G).max()
        speed = np.sqrt(2 * (box.energy if energy is None else energy) * driven) + away + G[1] * turning
        return float(speed / decay) if decay > 0 else np.inf

    def arm_stands(self, box: Box) -> float:
        """The same of the arm errors' size; inf for configurations that were not looked at, or without decay."""
        if not len(self.loop.K):
            return 0.0
        if (self.joints(box) > self.samples.spread).any() or not self.loop.arm_decay > 0:
            return np.inf
        return float(np.sqrt(2 * box.energy) * self.samples.arm_gain / self.loop.arm_decay)

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
            motion=motion_bound(self.samples, self.drive(box), box.energy, self.gains),
            pose=self.pose_stands(box),
            arm=self.arm_stands(box),
            limits=self.limits(box),
        )

    def limits(self, box: Box) -> list[Limit]:
        """What may be reached in a box of the supervisor's limits."""
        if self.loop.supervisor is None:
            return []
        s = self.velocity(box)
        bounds = signal_bounds(self.loop, self.drive(box), box.pose, self.joints(box), s)
        return limits_in(self.loop.supervisor, bounds, self.gains.upper * s + self.gains.network)

    def inner(self, faces: Faces) -> Box:
        """The next smaller box: the energy first, then what it drives."""
        box, level = faces.box, faces.motion.level
        energy = min(box.energy, STRICT * level)
        share = float(np.sqrt(energy / box.energy))
        pose = min(box.pose, STRICT * self.pose_stands(box, energy))
        return Box(pose, min(box.arm, STRICT * share * faces.arm), energy)

    def descend(self) -> list[Faces]:
        """From the outermost box, if it is held, to the one that every motion from there ends up in."""
        found = [self.faces(self.outer)]
        while found[0].held and len(found) < STEPS and found[-1].box.energy > SMALL * self.outer.energy:
            faces = self.faces(self.inner(found[-1]))
            found.append(faces)
            if faces.box.energy > (1 - SETTLED) * found[-2].box.energy:
                break
        return found
