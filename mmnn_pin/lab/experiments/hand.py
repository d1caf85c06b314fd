"""The hand of an experiment: the motion made of its table, and how far the true hand is from where it should be.

    total = kinematic + tracking + model

`kinematic`: the reference's hand, as the program has it, from the path. `tracking`: the hand as it is measured from the
reference's. `model`: the true hand from the measured one, which is what sensors and slip do.
"""

from __future__ import annotations

import dataclasses
from functools import lru_cache

import msgspec
import numpy as np

from ...model.chain import chain_of, poses, track
from ...model.robot import Robot, speed_limits
from ...recording.recording import Recording, as_columns, recorded_position
from ...reference.hand import HandMotion
from ...settings import Timing, finite
from ...signals import HAND, Array
from .references import HandTables

SETTLED = 1.0  # from when on the hand is judged [s]


@dataclasses.dataclass(frozen=True)
class Described:
    """A robot by what describes it: another one of the same file is the same, whatever its masses."""

    text: str
    robot: Robot = dataclasses.field(compare=False)


@lru_cache(maxsize=8)
def motion_of(tables: str, described: Described, timing: Timing) -> HandMotion:
    """The motion of a table as text (JSON); made once for all runs of a process."""
    return msgspec.json.decode(tables, type=HandTables).motion(described.robot, timing)


def hand_motion(tables: HandTables, robot: Robot, timing: Timing) -> HandMotion:
    """The motion of a table, made once; errors as of `HandTables.motion`."""
    described = Described(robot.urdf + repr(robot.overrides.stated()), robot)
    return motion_of(msgspec.json.encode(tables).decode(), described, timing)


# -- judged at the hand ------------------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class HandErrors:
    """Poses of a frame at every sample of a run, true, measured, of the reference and wanted, as the signal `hand`."""

    frame: str  # its name
    time: Array  # (N,) [s]
    wanted: Array  # (N, 7) position and quaternion
    reference: Array  # (N, 7) as the setpoints have it
    measured: Array  # (N, 7) as the sensors have it
    true: Array  # (N, 7)
    turned: bool  # whether its orientation was asked for

    def vectors(self) -> dict[str, Array]:
        """(N, 3) total error and its shares [m]."""
        there = {"total": self.true - self.wanted, "kinematic": self.reference - self.wanted}
        there |= {"tracking": self.measured - self.reference, "model": self.true - self.measured}
        return {name: places[:, :3] for name, places in there.items()}

    def distance(self) -> Array:
        """(N,) distance of the true hand from where it should be [m]."""
        return np.linalg.norm(self.vectors()["total"], axis=1)

    def angle(self) -> Array:
        """(N,) angle by which the true hand is turned from how it should be [rad]."""
        a, b = self.true[:, 3:], self.wanted[:, 3:]
        near = np.minimum(np.linalg.norm(a - b, axis=1), np.linalg.norm(a + b, axis=1))  # q and -q are the same
        return 4 * np.arcsin(np.minimum(near / 2, 1.0))

    def numbers(self) -> dict[str, float | None]:
        """RMS and peak after the first second, in thousandths."""
        kept = self.time >= SETTLED

        def rms(values: Array) -> float | None:
            return finite(1e3 * float(np.sqrt(np.mean(values[kept] ** 2)))) if kept.any() else None

        distance, angle = self.distance(), self.angle()
        peak = finite(1e3 * float(distance[kept].max())) if kept.any() else None
        found = {"position_rms_mm": rms(distance), "position_peak_mm": peak}
        found["orientation_rms_mrad"] = rms(angle) if self.turned else None
        shares = {name: np.linalg.norm(v, axis=1) for name, v in self.vectors().items() if name != "total"}
        return found | {f"{name}_rms_mm": rms(share) for name, share in shares.items()}


def hand_errors(recording: Recording, robot: Robot) -> list[HandErrors]:
    """Errors of a run at every frame that its reference took along a path; none where it took none.

    Args:
        recording: The run.
        robot: The robot that ran.
    """
    frames: dict[str, bool] = recording.meta.get("hands", {})
    if not frames or "hand" not in recording or "hand_ref" not in recording:
        return []
    measured = recorded_position(recording, robot).copy()
    reference = measured.copy()
    for table, pose, q in ((measured, "pose", "q"), (reference, "pose_ref", "q_ref")):
        if robot.dimensions.base and pose in recording:
            table[:, :3] = recording[pose]
        if q in recording:
            table[:, robot.arm_index] = as_columns(recording[q])
        robot.follow(table.T)
    found = []
    for i, (frame, turned) in enumerate(frames.items()):
        chain, own = chain_of(robot, frame), slice(len(HAND) * i, len(HAND) * (i + 1))
        wanted, true = recording["hand_ref"][:, own], recording["hand"][:, own]
        asked, seen = (poses(track(chain, table)) for table in (reference, measured))
        found.append(HandErrors(frame, recording.time, wanted, asked, seen, true, turned))
    return found


def peak_speeds(recording: Recording, robot: Robot) -> dict[str, float]:
    """Largest true speeds of wheels and joints in a run, of a base that steers those with motors [rad/s or m/s]."""
    nu = as_columns(recording["nu" if "nu" in recording else "nu_ref"])
    if robot.steers:
        rows = [robot.full_velocity_names.index(name) for name in robot.actuator_names]
        moved = zip(recorded_position(recording, robot), nu, strict=True)
        fastest = np.max([np.abs(robot.T_at(position)[rows] @ each) for position, each in moved], axis=0)
        return dict(zip(robot.actuator_names, fastest.tolist(), strict=True))
    nb, names = robot.dimensions.base, [*(wheel.joint for wheel in robot.base.wheels), *robot.joint_names]
    speeds = np.hstack((nu[:, :nb] @ robot.base.wheel_map.T, nu[:, nb:]))
    return {name: float(np.abs(each).max()) for name, each in zip(names, speeds.T, strict=True)}


def speed_limit(robot: Robot, joint: str) -> float:
    """The URDF's velocity limit of a joint, inf where it states none [rad/s or m/s]."""
    return dict(zip(robot.actuator_names, speed_limits(robot).tolist(), strict=True)).get(joint, np.inf)
