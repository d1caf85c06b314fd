"""The platform with its two-link arm follows a line while the arm swings: feedback alone, then with networks."""

import numpy as np

from mmnn_pin import PD, Hold, Line, Loop, Neural, Sine, Trajectory, load

robot = load("platform_arm")
reference = Trajectory(base=Line(speed=0.3), arm=[Sine(amplitude=0.8, period=4.0), Hold(0.8)])
for controller in (PD(), Neural()):
    run = Loop(robot, reference, controller).run()
    late = run.time > 1.0
    x, arm = 1e3 * run["pose_error"][late, 0], 1e3 * run["e"][late, 0]
    print(f"{controller.name:9}  x {np.sqrt(np.mean(x**2)):.1f} mm   arm {np.sqrt(np.mean(arm**2)):.1f} mrad")
