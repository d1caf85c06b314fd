"""What linear learners know after a motion: frozen weights on motions that they have not seen, beside the oracle."""

from dataclasses import dataclass, replace
from time import process_time

import numpy as np

from mmnn_pin import PD, Circle, ComputedTorque, Eight, Hold, Loop, Sensor, Sine, Timing, Trajectory, load_experiment
from mmnn_pin.reference.arm import JointProfile, JointSamples

FRICTION = ("friction.base=[30.0,5.0]", "friction.arm=0.5", "friction.coulomb=0.5")
experiment = load_experiment("track", ["feedback.scaling=none", "feedback.base=500.0", "feedback.arm=30.0", *FRICTION])
robot = experiment.load_robot()
gains, NOISE = experiment.feedback, Sensor(noise=1e-4, velocity_noise=2e-3, pose_noise=(1e-4, 1e-4, 1e-4))
NAMES = ("kalman_regressor", "kalman_bilinear", "kalman_features", "kalman_residual")


@dataclass(frozen=True)
class Shaken(JointProfile):
    """A swing with a small fast sine on top."""

    swing: Sine
    shake: Sine

    def sample(self, t):
        """See `JointProfile.sample`."""
        one, two = self.swing.sample(t), self.shake.sample(t)
        return JointSamples(one.q + two.q, one.qdot + two.qdot, one.qddot + two.qddot)


def swing(first, second):
    """Both joints by 45 degrees, with these periods [s]."""
    return Sine(0.785, first), Sine(0.785, second, 0.0, np.pi / 2)


def loop(controller, motion, duration, sensor=NOISE, seed=11):
    """A closed loop on the thesis robot with friction."""
    timing = Timing(duration=duration, control_period=0.002, plant_step=0.002, integrator="implicit_friction")
    return Loop(robot, Trajectory(*motion), controller, timing=timing, sensor=sensor, seed=seed, weights_interval=1.0)


def unexplained(run):
    """Fraction of the variance of Psi that Psi_hat leaves, mean of the components, without the first half second."""
    psi, said = np.asarray(run["psi"])[250:], np.asarray(run["psi_hat"])[250:]
    return (((psi - said) ** 2).sum(axis=0) / ((psi - psi.mean(axis=0)) ** 2).sum(axis=0)).mean()


def rms(run, after):
    """RMS of x, y, phi, q1, q2 after some time [s]."""
    errors = np.hstack((run["true_pose_error"], run["true_e"]))[np.asarray(run.time) >= after]
    return np.sqrt((errors**2).mean(axis=0))


def step_time(controller, motion):
    """Processor time of a sample of 12 s with this controller, beyond that of PD, best of three [us]."""
    times = {}
    for which in (PD(gains), controller):
        closed, best = loop(which, motion, 12.0), np.inf
        for _ in range(3):
            engine, began = closed.engine_at(), process_time()
            for k in range(0, 6000, 50):
                engine.advance(k, k + 50)
            best = min(best, process_time() - began)
        times[which.name] = best
    return (times[controller.name] - times["pd"]) / 6000 * 1e6


EIGHT = Eight(length=1.5, width=0.75, period=12.0, ramp=1.0)
TRAINING = {
    "eight": (EIGHT, swing(4.2, 2.9)),
    "eight, shaken": (
        EIGHT,
        tuple(Shaken(s, Sine(0.1, p, 0.0, 1.0)) for s, p in zip(swing(4.2, 2.9), (1.3, 0.8), strict=True)),
    ),
    "circle, arm still": (Circle(radius=1.0, speed=0.4, ramp=1.0), (Hold(0.4), Hold(-0.6))),
}
HELD_OUT = {
    "eight": (Eight(length=1.6, width=0.7, period=9.2, ramp=1.0), swing(3.3, 2.2)),
    "tight eight": (Eight(length=0.9, width=0.5, period=5.8, ramp=1.0), swing(3.0, 2.4)),
    "circle": (Circle(radius=0.7, speed=0.5, ramp=1.0), swing(2.6, 2.1)),
}

if __name__ == "__main__":
    for where, motion in TRAINING.items():
        oracle = rms(loop(ComputedTorque(gains), motion, 48.0).run(), 24.0)
        for name in NAMES:
            controller = experiment.controller(name, robot=robot)
            training = loop(controller, motion, 48.0)
            learned = training.run()
            memory = controller.init(training.wiring())
            memory.values[:] = learned.final["memory"]
            frozen, known = replace(controller, learning=False), []
            for other in HELD_OUT.values():
                known.append(unexplained(loop(frozen, other, 12.0, sensor=Sensor()).run(memory=memory)))
            ratio = (rms(learned, 24.0) / oracle).max()
            told = "not excited" if "not excited" in learned.outcome.message else ""
            numbers = "  ".join(f"{held} {value:.5f}" for held, value in zip(HELD_OUT, known, strict=True))
            print(f"{where:18}{name:17} error {ratio:.2f} x oracle   FVU frozen: {numbers}   {told}")
    for name in NAMES:
        print(f"{name:17} {step_time(experiment.controller(name, robot=robot), TRAINING['eight']):.0f} us a sample")
