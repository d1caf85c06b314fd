"""What an adaptive controller knows after a run: its last estimate held fixed, on motions that it has not seen."""

import numpy as np

from mmnn_pin import Circle, Eight, Feedback, Loop, Sine, Timing, Trajectory, load
from mmnn_pin.model.regressor import Regressor
from mmnn_pin.torque.adaptive import Adaptive
from mmnn_pin.torque.model_based import ComputedTorque


def loop(controller, base, periods, duration):
    """A closed loop on the thesis robot with friction."""
    motion = Trajectory(base, arm=[Sine(0.785, period, phase=np.pi / 2) for period in periods])
    return Loop(robot, motion, controller, timing=Timing(duration, 0.002, 0.002, integrator="implicit_friction"))


def unexplained(theta, run):
    """Fraction of the variance of Psi that a fixed theta leaves, per component."""
    motion = zip(run["position"], run["nu"], run["nu_ref"], run["nudot_ref"], strict=True)
    error = run["psi"] - np.array([regressor.matrix(*state) @ theta for state in motion])
    return np.sum(error[250:] ** 2, axis=0) / np.sum((run["psi"] - run["psi"].mean(0))[250:] ** 2, axis=0)


TRAINING = {
    "eight, arm swinging": (Eight(length=1.5, width=0.75, period=12.0, ramp=1.0), (4.0, 3.0)),
    "circle, arm slow": (Circle(radius=1.0, speed=0.4, ramp=1.0), (40.0, 40.0)),
}
HELD_OUT = {
    "eight": (Eight(length=1.5, width=0.75, period=9.2, ramp=1.0), (3.1, 2.3)),
    "circle": (Circle(radius=0.7, speed=0.5, ramp=1.0), (3.1, 2.3)),
}
if __name__ == "__main__":
    robot = load("platform_arm").with_friction((30.0, 5.0, 0.5, 0.5)).with_joint_friction(coulomb=0.5)
    regressor, gains = Regressor.of(robot), Feedback(500.0, 30.0)
    truth = {name: loop(ComputedTorque(gains), *motion, 10.0).run() for name, motion in HELD_OUT.items()}
    for name, motion in TRAINING.items():
        learned = loop(Adaptive(regressor, gains), *motion, 48.0).run()
        left = [f"{held} {unexplained(learned.weights['theta'][-1], run).mean():.4f}" for held, run in truth.items()]
        print(f"{name:20} FVU frozen, held out:", *left, learned.outcome.message)
