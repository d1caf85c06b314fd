"""A torque controller of your own, in plain Python: PD with an integral of the error, beside PD alone."""

import numpy as np

from mmnn_pin import PD, Feedback, Hold, Line, Loop, Sine, Timing, TorqueController, Trajectory, load
from mmnn_pin.loop.before_run import Start


class PID(TorqueController):
    """`tau = k (s + ki * integral of s)`, `s = [z; r]`."""

    name = "pid"

    def __init__(self, feedback, ki):
        self.feedback, self.ki = feedback, ki

    def init(self, context):
        """State of a new run: gains and period of this robot, and the integral."""
        integral = np.zeros(context.layout.dof)
        return {"k": self.feedback.vector(context.layout), "h": context.control_period, "integral": integral}

    def step(self, time, reference, measurement, command, state):
        """Torque of one control sample."""
        s = np.concatenate((command.z, command.r))
        state["integral"] += state["h"] * s
        return state["k"] * (s + self.ki * state["integral"])


if __name__ == "__main__":
    robot = load("platform_arm").with_friction([30.0, 5.0, 0.5, 0.5])  # [N s/m, N m s, N m s, N m s]
    trajectory = Trajectory(Line(speed=0.3), (Sine(amplitude=0.8, period=4.0), Hold(0.8)))
    feedback = Feedback(base=500.0, arm=30.0)
    for controller in (PD(feedback), PID(feedback, ki=4.0)):
        run = Loop(robot, trajectory, controller, timing=Timing(duration=2.0), start=Start(moving=True)).run()
        x, y, _ = 1e3 * np.sqrt(np.mean(run["pose_error"] ** 2, axis=0))
        arm = np.degrees(np.sqrt(np.mean(run["e"] ** 2, axis=0)))
        print(f"{controller.name:4} rms: x {x:.3f} mm, y {y:.3f} mm, joints {arm[0]:.3f} deg, {arm[1]:.3f} deg")
