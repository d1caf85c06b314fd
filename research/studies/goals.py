"""Errors of the hand behind servos: our commands beside the plain goals that users send, on equal hardware.

    python -m research.studies.goals ROBOT=HARDWARE [ROBOT=HARDWARE ...] [--mass 0.2]

    goals at 30 Hz      the reference as goal positions, and its twist to the base, 30 times a second
    goals at 100 Hz     the same as a joint trajectory controller interpolates a planner's trajectory
    ours                `Stepper`'s law at the profile's own rate, feedback alone

The hand is three points 0.1 m from the origin of the last joint, along its axes; errors are RMS after the first quarter
of a swing of 8 s, base included. `--mass` puts a load on the last joint that nobody is told of.
"""

from __future__ import annotations

import argparse

import numpy as np
import pinocchio as pin

from mmnn_pin import load_experiment, run_experiment
from mmnn_pin.model.robot import Robot
from mmnn_pin.recording.recording import Recording, recorded_robot
from mmnn_pin.signals import Array

SECONDS, SKIPPED, EVERY = 8.0, 0.25, 5
REACH = 0.1  # of the points from the last joint [m]
GOALS = [
    "kinematic.K=1e-6",
    "servo.gain=0.0",
    "servo.rate=0.0",
    "servo.bandwidth=1000.0",
]  # what is sent is the reference
CASES = {
    "goals at 30 Hz": [*GOALS, "hardware.rate=30.0"],
    "goals at 100 Hz": [*GOALS, "hardware.rate=100.0"],
    "ours": [],
}


def points(robot: Robot, position: Array) -> Array:
    """The points of the hand at a position (nv,), (3, 3) [m]."""
    model = robot.model
    data, last = model.createData(), model.getJointId(robot.joint_names[-1])
    pin.forwardKinematics(model, data, robot.configuration(robot.follow(position.copy())))
    return np.asarray(data.oMi[last].translation + REACH * data.oMi[last].rotation.T)


def hand_error(run: Recording) -> float:
    """RMS error of the hand against where the reference has it [m]."""
    robot, start, squares = recorded_robot(run), int(SKIPPED * len(run)), []
    for k in range(start, len(run), EVERY):
        true, wanted = run["position"][k].copy(), run["position"][k].copy()
        wanted[robot.arm_index] = run["q_ref"][k]
        if robot.dimensions.base:
            wanted[:3] = run["pose_ref"][k]
        squares.append(np.sum((points(robot, true) - points(robot, wanted)) ** 2, axis=1).mean())
    return float(np.sqrt(np.mean(squares)))


def errors(robot: str, hardware: str, mass: float = 0.0, seconds: float = SECONDS) -> dict[str, float]:
    """Case to the error of the hand [m]; errors as of `load_experiment` and `run_experiment`."""
    changes = [
        f'robot="{robot}"',
        f'hardware.profile="{hardware}"',
        'controllers=["pd"]',
        "plots=[]",
        f"time.duration={seconds}",
    ]
    if mass:
        changes.append(f'disturbances=[{{type="payload", mass={mass}, start=0.0}}]')
    found = {}
    for name, more in CASES.items():
        found[name] = hand_error(run_experiment(load_experiment("track", [*changes, *more]), "track")["pd"])
    return found


def main() -> None:
    """Print a line per robot."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pairs", nargs="+", metavar="ROBOT=HARDWARE")
    parser.add_argument("--mass", type=float, default=0.0, help="of a load on the last joint [kg]")
    options = parser.parse_args()
    for pair in options.pairs:
        robot, _, hardware = pair.rpartition("=")
        found = errors(robot, hardware, options.mass)
        words = ", ".join(f"{name} {1e3 * error:.2f} mm" for name, error in found.items())
        best = min(error for name, error in found.items() if name != "ours")
        print(
            f"{robot.rpartition('/')[2]} on {hardware}: {words}: {best / found['ours']:.1f} times smaller", flush=True
        )


if __name__ == "__main__":
    main()
