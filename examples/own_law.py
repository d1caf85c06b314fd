"""A learning law of your own: composite least squares on the filtered torque, with the regressor, in plain numpy.

mmnn run track --controller examples/own_law.py:LeastSquares --controller adaptive --controller pd
mmnn prove runs/track/LeastSquares.h5 --law examples/own_law.py
"""

import numpy as np

from mmnn_pin import LearningLaw, Memory


class LeastSquares(LearningLaw):
    """Learns the masses, `Psi_hat = Y theta`, from s and filtered torque (Slotine and Li 1989, Automatica 25(4))."""

    pole: float = 5.0  # of the low-pass [1/s]
    noise: float = 1e-3  # of the velocities [m/s, rad/s], as torque through the feedback
    prior: float = 30.0  # how far theta may be from 0 [kg, kg m, kg m^2, ...]

    knows_motion = True  # asks for the regressor Y
    learned = ("theta",)  # the weights among the parts of the memory

    def init(self, wiring):
        """Everything from zero; P, the covariance of theta, as large as the prior says."""
        n, p, k = wiring.layout.arm, wiring.layout.dof, wiring.regressor.size
        memory = Memory.of(theta=(k,), P=(k, k), Y=(p, k), torque=(p,), R=(p,), last=(n + p,))
        memory["P"] = self.prior**2 * np.eye(k)
        memory["R"] = (self.noise * self.feedback.vector(wiring.layout)) ** 2 / (self.pole * wiring.control_period)
        return memory

    def features(self, now, memory):
        """What the weights are multiplied with; the monitors look at its excitation."""
        return now.regressor

    def gain(self, memory):
        """Gamma of `theta' = Gamma Y' s + ...`: the Lyapunov monitor weighs the error of theta with it."""
        return memory["P"]

    def estimate(self, now, memory):
        """Psi_hat of this sample."""
        return now.regressor @ memory["theta"]

    def learn(self, now, memory):
        """From the tracking error, then from the torque of the period that has just ended."""
        theta, P, n = memory["theta"], memory["P"], now.q.size
        theta += now.period * P @ (now.regressor.T @ now.s)
        state, before = np.concatenate((now.q, now.nu)), memory["last"].copy()
        memory["last"] = state
        if now.first:
            return
        mean, rate = (state + before) / 2, (state - before) / now.period
        fresh = 1 - np.exp(-self.pole * now.period)
        memory["Y"] += fresh * (now.regressor_at(mean[:n], mean[n:], mean[n:], rate[n:]) - memory["Y"])
        memory["torque"] += fresh * (now.sent - memory["torque"])
        Y, seen = memory["Y"], P @ memory["Y"].T
        gain = np.linalg.solve(Y @ seen + np.diag(memory["R"]), seen.T).T
        theta += gain @ (memory["torque"] - Y @ theta)
        rest = np.eye(theta.size) - gain @ Y
        memory["P"] = rest @ P @ rest.T + (gain * memory["R"]) @ gain.T  # Joseph's form: positive in spite of rounding
