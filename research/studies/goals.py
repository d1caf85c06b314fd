"""Errors of the hand behind servos: our commands beside the plain goals that users send, on equal hardware.

    python -m research.studies.goals ROBOT=HARDWARE [ROBOT=HARDWARE ...] [--mass 0.15] [--controllers pd learned]

    goals at 30 Hz      the reference as goal positions, and its twist to the base, 30 times a second
    goals at 100 Hz     the same as a joint trajectory controller interpolates a planner's trajectory
    pd, ...             `Stepper`'s law at the profile's own rate, with a controller's torque through the servos

The hand is three points 0.1 m from the origin of the last joint, along its axes; errors are RMS over the second half
of 40 s of `track`, base included. `--mass` puts a load on the last joint that no model has; neither has one the
friction of a profile where the URDF states none.
"""

from __future__ import annotations

import argparse

import numpy as np
import pinocchio as pin

from mmnn_pin import load_experiment, run_experiment
from mmnn_pin.model.robot import Robot
from mmnn_pin.recording.recording import Recording, recorded_robot
from mmnn_pin.signals import Array

SECONDS, SKIPPED, EVERY = 40.0, 0.5, 5
REACH = 0.1  # of the points from the last joint [m]
GOALS = [
    "kinematic.K=1e-6",
    "servo.gain=0.0",
    "servo.rate=0.0",
    "servo.bandwidth=1000.0",
]  # what is sent is the reference
PLAIN = {"goals at 30 Hz": [*GOALS, "hardware.rate=30.0"], "goals at 100 Hz": [*GOALS, "hardware.rate=100.0"]}
OURS = ["pd", "pd_gravity", "feedforward", "two_layer", "adaptive", "learned"]


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


def errors(robot: str, hardware: str, controllers: list[str], mass: float = 0.0) -> dict[str, float]:
    """Case to the error of the hand [m]; errors as of `load_experiment` and `run_experiment`."""
    changes = [f'robot="{robot}"', f'hardware.profile="{hardware}"', "plots=[]", f"time.duration={SECONDS}"]
    if mass:
        changes.append(f'disturbances=[{{type="payload", mass={mass}, start=0.0}}]')
    found = {}
    for name, more in PLAIN.items():
        # A goal is the reference alone: nothing is sent through the servo's stiffness, here as none is known.
        goals = [*changes, *more, 'controllers=["pd"]', "feedback.base=1e-6", "feedback.arm=1e-6"]
        found[name] = hand_error(run_experiment(load_experiment("track", goals), "track")["pd"])
    runs = run_experiment(load_experiment("track", [*changes, f"controllers={controllers}"]), "track")
    return found | {name: hand_error(runs[name]) for name in controllers if name in runs}


def main() -> None:
    """Print a line per robot."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pairs", nargs="+", metavar="ROBOT=HARDWARE")
    parser.add_argument("--mass", type=float, default=0.0, help="of a load on the last joint [kg]")
    parser.add_argument("--controllers", nargs="+", default=OURS)
    options = parser.parse_args()
    for pair in options.pairs:
        robot, _, hardware = pair.rpartition("=")
        found = errors(robot, hardware, options.controllers, options.mass)
        words = ", ".join(f"{name} {1e3 * error:.2f}" for name, error in found.items())
        print(f"{robot.rpartition('/')[2]} on {hardware} with {options.mass:g} kg [mm]: {words}", flush=True)


if __name__ == "__main__":
    main()
