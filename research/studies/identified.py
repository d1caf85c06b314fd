"""What an identified model and its covariance are worth to learners: `python -m research.studies.identified [FOLDER]`.

The maker's URDF has masses 30 % too small and no friction. The robot moves as `mmnn excite` says of that URDF, under PD
and with noisy sensors; `mmnn identify` corrects the URDF from the recording. Then controllers drive the experiment
`track`, each starting from nothing, from the maker's URDF, or from what was identified; `nominal` learns nothing.

Errors are those of the whole run, the start included, and of its first second. Frozen is the FVU of the parameters at
the end on another motion, the worst component: what the controller knows then.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from lxml import etree

from mmnn_pin import Loop, Timing, Trajectory, identify, load, load_experiment
from mmnn_pin.deploy.identify.corrected import write
from mmnn_pin.deploy.identify.excitation import ExcitationLimits, excite
from mmnn_pin.lab.experiments.runner import run_experiment
from mmnn_pin.lab.psi.subject import Subject
from mmnn_pin.lab.show.table import Cell, Column, Table, number, row_of, terminal_text
from mmnn_pin.model.regressor import Regressor
from mmnn_pin.model.robot import Robot
from mmnn_pin.model.tree.body import parameters
from mmnn_pin.recording.recording import Recording, as_columns
from mmnn_pin.sensing import Sensor
from mmnn_pin.signals import Array
from mmnn_pin.torque.controller import Feedback
from mmnn_pin.torque.model_based import PD

SHARE = 0.7  # of the true masses, in the maker's URDF
TRUTH = ("friction.base=[20.0, 4.0]", "friction.arm=0.5", "friction.coulomb=0.4")
NOISY = Sensor(noise=2e-5, velocity_noise=2e-4, pose_noise=(2e-5, 2e-5, 2e-5))
PERIOD = 0.001
ORDER = ("nominal", "adaptive", "adaptive_composite", "concurrent", "kalman_regressor")
LEARNERS = ORDER[1:4]  # that also begin with parameters alone


@dataclass(frozen=True)
class Files:
    """The maker's URDF, the motion, its recording, and what was identified from it."""

    maker: Path
    motion: Path
    run: Path
    urdf: Path
    report: Path


def lighter(robot: Robot, out: Path) -> Path:
    """The URDF of a robot with all masses too small by `SHARE`."""
    root = etree.fromstring(robot.path.read_bytes())
    for element in (*root.iter("mass"), *root.iter("inertia")):
        for name, value in element.attrib.items():
            element.set(name, f"{SHARE * float(value):.12g}")
    out.write_bytes(etree.tostring(root))
    return out


def recorded(true: Robot, motion: Path, out: Path) -> Recording:
    """The run of the true robot along a table of `mmnn excite`, under PD and with noisy sensors."""
    trajectory = Trajectory.from_csv(true, motion)
    timing = Timing(trajectory.duration, PERIOD, plant_step=PERIOD, integrator="implicit_friction")
    return Loop(true, trajectory, PD(Feedback(800.0, 60.0)), timing=timing, sensor=NOISY).run(out, force=True)


def prepared(true: Robot, folder: Path, seconds: float) -> Files:
    """All files of the study; `seconds` are those of the search for the motion."""
    maker = lighter(load("platform_arm"), folder / "maker.urdf")
    motion = excite(load(maker), ExcitationLimits(duration=40.0, seconds=seconds)).save(folder / "motion.csv")
    run = folder / "motion.h5"
    found = identify(load(maker), recorded(true, motion, run))
    files = write(found, folder / "identified", force=True)
    print(f"held-out torque error: {found.error('identified'):.2%}, the maker's URDF {found.error('urdf'):.1%}")
    return Files(maker, motion, run, files["urdf"], files["json"])


def cases(files: Files) -> Iterator[tuple[str, str, tuple[str, ...]]]:
    """Controller, what it starts from, and the settings that say so."""
    for start, urdf in (("the maker's URDF", files.maker), ("identified", files.urdf)):
        model = (f"nominal.robot='{urdf}'", "nominal.masses=1.0", "nominal.friction=true")
        yield "nominal", start, model
        for learner in LEARNERS:
            key = "adaptive" if learner.startswith("adaptive") else learner
            yield learner, start, (*model, f"{key}.initial='nominal'")
    sure = "identified, with its covariance"
    for learner in LEARNERS:
        key = "adaptive" if learner.startswith("adaptive") else learner
        yield learner, sure, (f"{key}.start='{files.report}'",)
    yield "kalman_regressor", "nothing", ()
    yield "kalman_regressor", sure, (f"kalman.regressor.start='{files.report}'",)


def at_the_end(recording: Recording, controller: str, urdf: Path) -> Array:
    """Parameters (k,) that a controller ends with."""
    if controller == "nominal":
        return parameters(load(urdf))
    if controller == "concurrent":
        learner = Subject.of(recording).learner
        assert learner is not None
        return np.asarray(learner.controller.theta(learner.end))
    return np.ravel(recording.weights["W" if controller.startswith("kalman") else "theta"][-1])


def frozen(true: Robot, theta: Array) -> float:
    """FVU of parameters (k,) on a motion that nothing was trained on, the worst component."""
    motion = excite(true, ExcitationLimits(duration=20.0, seconds=0.0, seed=7))
    forces = Regressor.of(true).along(motion.position, motion.nu, motion.nudot)
    psi, psi_hat = forces @ parameters(true), forces @ theta
    return float((((psi - psi_hat) ** 2).sum(axis=0) / ((psi - psi.mean(axis=0)) ** 2).sum(axis=0)).max())


def main(arguments: Sequence[str] | None = None) -> None:
    """Parse the command line, run, print."""
    parser = argparse.ArgumentParser(prog="python -m research.studies.identified", description=__doc__)
    parser.add_argument("folder", nargs="?", type=Path, help="for the files; else they are deleted")
    parser.add_argument("--duration", type=float, default=10.0, help="of a run [s]")
    parser.add_argument("--seconds", type=float, default=10.0, help="of the search for the motion [s]")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.folder or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        base = (*TRUTH, f"time.duration={options.duration}", f"windows=[[0.0, {options.duration}]]", "plots=[]")
        true, rows = load_experiment("track", base).load_robot(), []
        files = prepared(true, folder, options.seconds)
        for controller, start, settings in sorted(cases(files), key=lambda case: ORDER.index(case[0])):
            experiment = load_experiment("track", [*base, f"controllers=['{controller}']", *settings])
            run = run_experiment(experiment, "track").recordings[controller]
            pose = np.linalg.norm(run["true_pose_error"][:, :2], axis=1)
            joints, first = np.linalg.norm(as_columns(run["true_e"]), axis=1), run.time < 1.0
            errors = [1e3 * np.sqrt(np.mean(part**2)) for part in (pose, joints, pose[first], joints[first])]
            theta = at_the_end(run, controller, files.maker if start.startswith("the") else files.urdf)
            rows.append(row_of(controller, Cell(start), *map(number, errors), f"{frozen(true, theta):.2g}"))
    names = ("base\nmm", "arm\nmrad", "base, 1st s\nmm", "arm, 1st s\nmrad", "frozen\nFVU")
    heads = (Column("controller", text=True), Column("starts from", text=True), *map(Column, names))
    print(terminal_text([Table("", heads, tuple(rows))], False, 120))


if __name__ == "__main__":
    main()
