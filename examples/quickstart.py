"""The platform with its two-link arm follows a line while the arm swings: what is usually tried, then learners."""

from mmnn_pin import Hold, Line, Sine, Trajectory, compare, load

if __name__ == "__main__":
    robot = load("platform_arm")  # or your own URDF
    reference = Trajectory(base=Line(speed=0.3), arm=[Sine(amplitude=0.8, period=4.0), Hold(0.8)])
    heavy = {"masses": 1.1, "friction.coulomb": 0.1}  # the true robot, beside its URDF
    names = ["pd_gravity", "pid", "feedforward", "two_layer", "learned"]
    runs = compare(robot, reference, names, duration=4.0, settings=heavy)
    for name, run in runs.items():
        errors = run.errors(start=1.0)
        x, joint = 1e3 * errors["x"].rms, 1e3 * errors["arm_1_joint"].rms
        print(f"{name:11}  x {x:.2f} mm   arm {joint:.2f} mrad")
