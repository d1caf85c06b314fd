"""What a learner knows of a load that its robot picked up: mass and centre, and which of them the run determined.

The load is what the torques after it was picked up have beyond what the learner knew just before:
`y = Y theta + Y_b p + noise`, p the load's mass and first moments (`deploy.identify.payload`), with theta as the
learner believes it: its estimate and covariance, which count for less where they do not explain the motion. A learner
with a regressor but without a covariance does not know how sure it is of the robot: what it would say of a load has no
interval, and was seen to be wrong by half. So nothing counts as determined.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mmnn_pin.deploy.identify.payload import CarriedLoad, payload
from mmnn_pin.deploy.identify.reading import from_recording
from mmnn_pin.deploy.identify.report import links_of
from mmnn_pin.errors import InputError, RecordingError
from mmnn_pin.lab.psi.learner import LearnerStepper
from mmnn_pin.lab.psi.subject import Subject
from mmnn_pin.model.robot import Robot
from mmnn_pin.model.structure import bodies_of
from mmnn_pin.model.tree.tree import carriers
from mmnn_pin.settings import finite
from mmnn_pin.signals import Array

SHORTEST = 2.0  # time with the load from which it is looked for [s]
TOLD = 0.5  # standard deviation of a mass, over it, from which the run did not determine it
APART = 0.1  # standard deviation of a centre from which the run did not determine it [m]


@dataclass(frozen=True, eq=False)
class Carried:
    """The load that a run's learner makes out."""

    pick: float  # when it is picked up [s]
    seconds: float  # how long the learner feels it [s]
    mass: float  # the truth [kg]
    centre: Array  # (3,) the truth, in the link's frame [m]
    found: CarriedLoad | None  # what the learner makes of it; None where nothing is determined
    why: str = ""  # why nothing is determined

    @property
    def determined(self) -> tuple[bool, tuple[bool, ...]]:
        """Whether the run determined the mass, and the coordinates of the centre."""
        if self.found is None:
            return False, (False,) * 3
        mass = bool(self.found.mass_sd < TOLD * self.found.mass)
        return mass, tuple(bool(mass and sd < APART) for sd in self.found.centre_sd)

    def to_dict(self) -> dict[str, Any]:
        """Estimates with standard deviations, null for what the run did not determine, and the truth."""
        mass, centre = self.determined
        table: dict[str, Any] = {"pick": self.pick, "seconds": self.seconds, "why": self.why or None}
        table |= {"true_mass": self.mass, "true_com": self.centre.tolist(), "mass": None, "com": [None] * 3}
        if self.found is not None:
            pairs = zip(self.found.centre, self.found.centre_sd, centre, strict=True)
            points = [{"value": float(x), "sd": finite(sd)} if there else None for x, sd, there in pairs]
            table |= {"link": self.found.link, "com": points}
            table["mass"] = {"value": self.found.mass, "sd": finite(self.found.mass_sd)} if mass else None
        return table

    def __str__(self) -> str:
        mass, centre = self.determined
        true = f"truth {self.mass:.3g} kg at ({', '.join(f'{1e3 * x:.0f}' for x in self.centre)}) mm"
        if self.found is None:
            return f"load picked up at {self.pick:g} s: not determined: {self.why} ({true})"
        none = "not determined"
        told = f"{self.found.mass:.3g} ± {1.96 * self.found.mass_sd:.2g} kg" if mass else f"mass {none}"
        pairs = zip(self.found.centre, self.found.centre_sd, centre, strict=True)
        at = ", ".join(f"{1e3 * x:.0f} ± {1.96e3 * sd:.0f}" if there else none for x, sd, there in pairs)
        return f"load picked up at {self.pick:g} s: {told} at ({at}) mm (1.96 sd; {true})"


def carried(subject: Subject) -> Carried | None:
    """What a run's learner knows of the load that was picked up; None without one, or without a regressor.

    Raises:
        RecordingError: The recording does not hold its learner.
    """
    hardware, learner = subject.hardware, subject.learner
    load = hardware.load
    time = subject.signal("time")[:, 0]
    if load is None or learner is None or not hasattr(learner.controller, "knowledge") or hardware.pick >= time[-1]:
        return None
    before = LearnerStepper(learner, learner.start.snapshot())
    for row in subject.rows[time < hardware.pick]:
        before.step(row)
    knowledge = learner.controller.knowledge(before.state)
    if knowledge is None:
        return None
    theta, covariance = knowledge
    joint = load.joint or (subject.robot.joint_names[-1] if subject.robot.joint_names else "root")
    centre, end = in_link(subject.robot, joint, np.array(load.at)), min(hardware.drop, time[-1])
    found, why = None, ""
    try:
        if end - hardware.pick < SHORTEST:
            raise RecordingError("too short", why=f"{end - hardware.pick:.2g} s with it, {SHORTEST:g} s are needed")
        if covariance is None:
            why = "it does not know how sure it is of the robot"
            raise RecordingError("no covariance", why=why)
        log = from_recording(subject.recording, subject.robot)
        log = log.rows((log.time >= hardware.pick) & (log.time < end))
        found = payload(subject.robot, log, joint, believed=(theta, covariance))
    except InputError as error:
        why = ", ".join(part for part in (error.what, error.why) if part)
    return Carried(hardware.pick, end - hardware.pick, load.mass, centre, found, why)


def in_link(robot: Robot, joint: str, point: Array) -> Array:
    """A point (3,) of a joint's frame in that of the first link that it carries [m]."""
    carried_by = carriers(robot.model, np.array(robot.T), robot.neutral_position())
    own = carried_by[bodies_of(robot.model).index(joint)][1]
    first = links_of(robot).get(joint, [("", own)])[0][1]
    frame = np.linalg.inv(first) @ own
    return np.asarray(frame[:3, :3] @ point + frame[:3, 3])
