"""What learners know after an ordinary motion: frozen on faster ones never trained on. Controllers are arguments."""

import sys
from dataclasses import replace

import numpy as np

from mmnn_pin import load_experiment
from mmnn_pin.control import Torque
from mmnn_pin.proof.fvu import fvu

EIGHT = "{{type='eight', length={}, width={}, period={}, ramp=1.0}}"
MOTIONS = {  # base, periods of the arm's joints [s], duration [s]
    "training": (EIGHT.format(1.5, 0.75, 12.0), (4.0, 3.0), 48.0),
    "eight3": (EIGHT.format(1.5, 0.75, 9.23), (3.08, 2.31), 18.5),
    "eight2": (EIGHT.format(0.9, 0.45, 9.23), (3.08, 2.31), 18.5),
    "circle": ("{type='circle', radius=0.7, speed=0.5, ramp=1.0}", (1.8, 1.3), 12.0),
}
NOISE = ["sensor.noise=1e-4", "sensor.pose_noise=[1e-4,1e-4,1e-4]", "sensor.velocity_noise=2e-3"]
COMMON = ["friction.coulomb=0.5", "time.plant_step=0.002", "time.integrator=implicit_friction", "robust.base=0.0"]


def loop(name, motion, said):
    """The closed loop of a controller on a motion."""
    base, periods, duration = MOTIONS[motion]
    arm = [f"{{type='sine', amplitude=0.785, period={period}, phase=1.5708}}" for period in periods]
    said = [f"reference.base={base}", f"reference.arm=[{','.join(arm)}]", f"time.duration={duration}", *said]
    experiment = load_experiment("chapter4", [*COMMON, "robust.arm=0.0", *said])
    robot = experiment.load_robot()
    return experiment.loop(robot, experiment.controller(name, robot=robot))


def frozen_fvu(learned, memory, rows, layout):
    """FVU of a learner that no longer learns, mean of the components."""
    row, told = layout.new_row(), np.zeros((len(rows), layout.dof))
    still = (
        replace(learned.controller, learning=False) if hasattr(learned.controller, "learning") else learned.controller
    )
    torque = Torque(still, learned.wiring(), row, learned.robot, memory.snapshot())
    for k, row[:] in enumerate(rows):
        row[layout.where("psi_hat")] = 0.0
        torque.step(k * learned.timing.control_period)
        told[k] = torque.psi_hat
    return fvu(rows[250:, layout.where("psi")], told[250:]).mean()


def errors(run):
    """RMS errors after 2 s: x, y [mm], phi, joints [mrad]."""
    both = np.hstack((run["true_pose_error"], run["true_e"]))[run.time > min(2.0, run.time[-1] / 2)]
    return 1e3 * np.sqrt(np.mean(both**2, axis=0))


if __name__ == "__main__":
    names, said = [a for a in sys.argv[1:] if "=" not in a], [a for a in sys.argv[1:] if "=" in a]
    truth = {m: loop("computed_torque", m, []).run() for m in MOTIONS if m != "training"}
    for name in names or ["adaptive", "adaptive_composite"]:
        learned = loop(name, "training", NOISE + said)
        run = learned.run()
        late = run.time > 0.5
        memory, layout = learned.controller.init(learned.wiring()), learned.robot.layout
        memory.values[:] = run.final["memory"]
        online = fvu(run["psi"][late], run["psi_hat"][late]).mean()
        rows = {m: np.hstack([np.reshape(r[n], (len(r), -1)) for n in r]) for m, r in truth.items()}
        frozen = [frozen_fvu(learned, memory, rows[m], layout) for m in truth]
        print(f"{name:20} {errors(run).round(3)} online {online:.5f} frozen", *(f"{f:.5f}" for f in frozen))
        print(f"{'':20} {run.outcome.message}")
