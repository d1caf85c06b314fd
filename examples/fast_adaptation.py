"""Following Psi without knowing it: an integrator of the error, which sees no input, beside the two-layer network."""

import numpy as np

from mmnn_pin import TorqueController, load_experiment
from mmnn_pin.lab.psi.held_out import START
from mmnn_pin.lab.psi.psi import fvu


class PI(TorqueController):
    """`tau = k s + I`, `I += ki s`: what the network would be if all its units had the constant output 1/2."""

    name = "pi"

    def __init__(self, k, ki):
        self.k, self.ki = k, ki

    def init(self, context):
        """The integral."""
        return np.zeros(context.layout.dof)

    def step(self, time, reference, measurement, command, state):
        """Torque of one control sample; the integral moves on after it, as the network's weights do."""
        s = np.concatenate((command.z, command.r))
        torque = self.k * s + state
        state += self.ki * s
        return torque


if __name__ == "__main__":
    experiment = load_experiment("track")
    robot = experiment.load_robot()
    learner, sizes = experiment.controller("two_layer", robot=robot), robot.dimensions
    (seen, given), F = learner.network_scales(sizes), np.repeat(learner.network.F, (sizes.base, sizes.arm))
    k, ki = learner.feedback_gain(sizes), F * seen * given * learner.network.hidden / 4
    network, integrator = (experiment.loop(robot, controller).run() for controller in (learner, PI(k, ki)))
    integral = integrator["torque"] - k * np.hstack((integrator["z"], integrator["r"]))
    for name, run, said in (("two_layer", network, network["psi_hat"]), ("integrator", integrator, integral)):
        found = fvu(run["psi"][run.time >= START], said[run.time >= START])
        print(f"{name:10} FVU online: " + ", ".join(f"{value:.4f}" for value in found))
