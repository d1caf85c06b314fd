"""TIAGo's hand draws a line and a circle in the world, base and arm together. `mmnn replay hand.h5` shows it."""

from mmnn_pin import Loop, Timing, load
from mmnn_pin.kinematic import Kinematic
from mmnn_pin.reference.hand import HandCircle, HandLine, Pieces, WholeBody, plan
from mmnn_pin.torque.model_based import ComputedTorque

if __name__ == "__main__":
    robot = load("tiago")
    timing = Timing(duration=8.0, control_period=0.002, plant_step=0.002, integrator="implicit_friction")
    path = Pieces((HandLine((0.5, 0.0, 0.0), speed=0.2), HandCircle(0.1, speed=0.2)))
    motion = plan(WholeBody(robot, period=0.002), [path], timing.duration)
    loop = Loop(robot, motion.trajectory, ComputedTorque(), Kinematic(3.0, 16.0, 8.0, 7.0), timing)
    run = loop.run("hand.h5", force=True)
    print(f"{run.outcome.status}; the reference's hand is at most {1e3 * motion.gap.max():.2g} mm from its path")
