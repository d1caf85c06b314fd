"""A learning law of your own: composite least squares on the filtered torque, with the regressor, in plain numpy.

mmnn run track --controller examples/own_law.py:LeastSquares --controller adaptive --controller pd
python -m research.prove runs/track/LeastSquares.h5 --law examples/own_law.py
"""

import numpy as np

from mmnn_pin import LearningLaw
from mmnn_pin.torque.controller import ControllerState


class LeastSquares(LearningLaw):
    """Learns the masses, `Psi_hat = Y theta`, from s and filtered torque (Slotine and Li 1989, Automatica 25(4))."""

    pole: float = 5.0  # of the low-pass [1/s]
    noise: float = 1e-3  # of the velocities [m/s, rad/s], as torque through the feedback
    prior: float = 30.0  # how far theta may be from 0 [kg, kg m, kg m^2, ...]

    knows_motion = True  # asks for the regressor Y
    learned = ("theta",)  # the weights among the parts of the state

    def init(self, context):
        """Everything from zero; P, the covariance of theta, as large as the prior says."""
        n, p, k = context.layout.arm, context.layout.dof, context.regressor.size
        state = ControllerState.of(theta=(k,), P=(k, k), Y=(p, k), torque=(p,), R=(p,), last=(n + p,))
        state["P"] = self.prior**2 * np.eye(k)
        state["R"] = (self.noise * self.feedback.vector(context.layout)) ** 2 / (self.pole * context.control_period)
        return state

    def features(self, sample, state):
        """What the weights are multiplied with; the monitors look at its excitation."""
        return sample.regressor

    def gain(self, state):
        """Gamma of `theta' = Gamma Y' s + ...`: the Lyapunov monitor weighs the error of theta with it."""
        return state["P"]

    def estimate(self, sample, state):
        """Psi_hat of this sample."""
        return sample.regressor @ state["theta"]

    def learn(self, sample, state):
        """From the tracking error, then from the torque of the period that has just ended."""
        theta, P, n = state["theta"], state["P"], sample.q.size
        theta += sample.period * P @ (sample.regressor.T @ sample.s)
        point, before = np.concatenate((sample.q, sample.nu)), state["last"].copy()
        state["last"] = point
        if sample.first:
            return
        mean, rate = (point + before) / 2, (point - before) / sample.period
        fresh = 1 - np.exp(-self.pole * sample.period)
        state["Y"] += fresh * (sample.regressor_at(mean[:n], mean[n:], mean[n:], rate[n:]) - state["Y"])
        state["torque"] += fresh * (sample.sent - state["torque"])
        Y, seen = state["Y"], P @ state["Y"].T
        gain = np.linalg.solve(Y @ seen + np.diag(state["R"]), seen.T).T
        theta += gain @ (state["torque"] - Y @ theta)
        rest = np.eye(theta.size) - gain @ Y
        state["P"] = rest @ P @ rest.T + (gain * state["R"]) @ gain.T  # Joseph's form: positive in spite of rounding
