"""Identification on recorded motion of real robots: held-out torque error of ours, least squares, friction alone, URDF.

    python benchmarks/identification.py tiago FIGAROH_PLUS        # thanhndv212/figaroh-plus, Apache-2.0
    python benchmarks/identification.py ur10 INVERSE_DYNAMICS     # unisa-acg/inverse-dynamics-solver, BSD-3
    python benchmarks/identification.py panda INVERSE_DYNAMICS
    python benchmarks/identification.py ur10e CALIBRATION         # shamilmamedov/dynamic_calibration; a known load too
    python benchmarks/identification.py kuka FLOBAROID            # kjyv/FloBaRoID, LGPL-3; see below
    python benchmarks/identification.py other --robot R LOG...    # any log, read as it is
    python benchmarks/identification.py coverage --robot panda    # do intervals cover the truth, in simulation?
    python benchmarks/identification.py payload --draws 100       # and those of what a hand carries?
    python benchmarks/identification.py excite --robot tiago      # what the motion found in 60 s determines

The path is a clone of the repository that the data lies in; nothing of it is kept here. FloBaRoID's measurements of a
KUKA LWR4+ lie in its history: `git checkout e6c077e -- data/KUKA/HW` in the clone. `--figaroh PYTHON` names the
interpreter of an environment with `pip install figaroh==1.0.2`: its least squares, weighted least squares and fit of
possible bodies then stand beside ours, on the same equations, over the joints that we identify.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mmnn_pin import identify, load
from mmnn_pin.deploy.identify.equations import (
    FINE,
    KEPT,
    Equations,
    Unknowns,
    chosen_cutoff,
    equations,
    low_pass,
    still_speeds,
)
from mmnn_pin.deploy.identify.excitation import RATE, ExcitationLimits, ExcitationSearch, ExcitingMotion, excite
from mmnn_pin.deploy.identify.identification import MODELS, Identification, scaled
from mmnn_pin.deploy.identify.least_squares import base_parameters, weighted_fit
from mmnn_pin.deploy.identify.log import Log
from mmnn_pin.deploy.identify.payload import doubts, numbers_of, payload
from mmnn_pin.deploy.identify.programme import Blocks, Prior, compressed, consistent_fit
from mmnn_pin.deploy.identify.reading import read_logs
from mmnn_pin.model.regressor import Regressor
from mmnn_pin.model.robot import Robot
from mmnn_pin.signals import Array
from mmnn_pin.torque.pseudo_inertia import BODY
from research.studies.real_data.sources import UR10E, columns_of_ur10e

# Gear ratio times motor constant [N m / A], of the data's own script (examples/tiago/identification.py).
TIAGO = {"arm_1_joint": 13.6, "arm_2_joint": 13.6, "arm_3_joint": -8.7, "arm_4_joint": -8.7}
TIAGO |= {f"arm_{i}_joint": -336 * 0.0613 for i in (5, 6, 7)}
FIGAROH = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")  # its names, in its order
CARRYING = [(off, rubs, twice) for off, rubs in ((0.0, 0), (0.01, 0), (0.1, 0), (0.1, 1)) for twice in (0, 1)]
TRIANGLE = np.triu_indices(3)
CASES: dict[str, dict[str, Any]] = {
    "tiago": {
        "robot": "examples/tiago/urdf/tiago_48_schunk.urdf",
        "logs": [
            f"examples/tiago/data/identification/dynamic/tiago_{k}.csv" for k in ("position", "velocity", "effort")
        ],
        "constants": TIAGO,
        "mend": {"effort.torso_lift_joint": "dropped"},  # without the weight, and in a unit of its own
    },
    "ur10": {"robot": "ur10", "logs": ["ur10_inverse_dynamics_solver/bagfiles/ur10_exciting_trajectory.db3"]},
    "panda": {
        "robot": "panda",
        "logs": ["franka_inria_inverse_dynamics_solver/bagfiles/panda_exciting_trajectory.db3"],
        "columns": {f"joint.panda_joint{i}": f"fer_joint{i}" for i in range(1, 8)},
    },
    "ur10e": {
        "robot": "URe/urdf/ur10e.urdf",
        "logs": ["ur-20_02_10-30sec_12harm", "ur-20_02_12-40sec_12harm", "ur-20_02_06-20sec_10harm"],
        "held_out": ["ur-20_02_12-50sec_12harm"],
        "empty": ["ur-20_02_19_14harm50sec"],
        "loaded": ["ur-20_02_19_14harm50secLoad"],
        "load": 2.805,  # kg, of estimate_drive_gains.m
        "constants": UR10E,
    },
    "kuka": {
        "robot": "model/kuka_lwr4.urdf",
        "logs": ["measurements_1", "measurements_2"],
        "held_out": ["measurements_3"],
    },
}


def eight_with_sines(search: ExcitationSearch, duration: float) -> ExcitingMotion:
    """The motion that an excitation is compared with: an eight of the base, a sine of every joint.

    It lasts as long, and is scaled alike into the limits of speed and position. It need not keep those of torque, nor
    its links apart, so it may be more than the robot can do.
    """
    nb, t = search.unknowns.robot.dimensions.base, np.linspace(0.0, duration, round(duration * RATE))
    p = len(search.speed)
    w = 2 * np.pi / duration * np.concatenate(([4, 2][:nb], 3 + np.arange(p - nb)))
    v, dv, x = (np.zeros((len(t), p)) for _ in range(3))
    for j in range(p):
        v[:, j], dv[:, j], x[:, j] = np.cos(w[j] * t), -w[j] * np.sin(w[j] * t), np.sin(w[j] * t) / w[j]
    size = 1 / search.speed
    size[nb:] = np.maximum(size[nb:], np.ptp(x[:, nb:], axis=0) / (search.high - search.low))
    x, v, dv = x / size, v / size, dv / size
    if nb:
        v[:, 0] = search.speed[0] * (0.8 + 0.2 * np.cos(2 * w[1] * t))  # slower in the turns
        dv[:, 0] = -0.4 * search.speed[0] * w[1] * np.sin(2 * w[1] * t)
    x[:, nb:] += (search.high + search.low) / 2
    return search.judged(t, x, v, dv)


def by_figaroh(found: Identification, python: str) -> dict[str, float]:
    """Held-out errors of figaroh's least squares, weighted ones and possible bodies, on the same equations.

    Args:
        found: Ours.
        python: The interpreter that has figaroh.
    """
    rows, test = found.training.only(found.follows), found.held_out.only(found.follows)
    labels = found.unknowns.labels
    to_ours = np.eye(len(labels))  # from its inertias Ixx Ixy Iyy Ixz Iyz Izz about the joint to our second moments
    half = np.array([[-1, 0, 1, 0, 0, 1], [0, -2, 0, 0, 0, 0], [0, 0, 0, -2, 0, 0], [1, 0, -1, 0, 0, 1],
                     [0, 0, 0, 0, -2, 0], [1, 0, 1, 0, 0, -1]]) / 2  # fmt: skip
    names = list(labels)
    for b, body in enumerate(found.unknowns.regressor.bodies):
        at = BODY * b
        to_ours[at + 4 : at + BODY, at + 4 : at + BODY] = half
        names[at : at + BODY] = [f"{key}_{body}" for key in FIGAROH]
    joint, of_test = np.nonzero(rows.use.T)[0], test.use.T
    with tempfile.TemporaryDirectory() as folder:
        np.savez(
            file := Path(folder) / "equations.npz", W=rows.Y.swapaxes(0, 1)[rows.use.T] @ to_ours,
            tau=rows.y.T[rows.use.T], joint=np.unique(joint, return_inverse=True)[1], names=names,
            test=test.Y.swapaxes(0, 1)[of_test] @ to_ours, joints=found.unknowns.regressor.bodies,
            prior=np.linalg.solve(to_ours, found.unknowns.prior),
        )  # fmt: skip
        command = [python, str(Path(__file__).with_name("by_figaroh.py")), str(file)]
        answer = json.loads(
            subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout.splitlines()[-1]
        )
    y = test.y.T[of_test]
    names = [name for name in ("ols", "wls", "physical") if name in answer]
    return {f"figaroh_{name}": float(np.linalg.norm(y - answer[name]) / np.linalg.norm(y)) for name in names}


def of_ur10e(folder: Path, names: list[str], robot: Robot) -> list[Log]:
    """Logs of its tables."""
    return [columns_of_ur10e(folder / "dataset_ur10e/identification_data" / f"{name}.csv", robot) for name in names]


def of_kuka(folder: Path, names: list[str], robot: Robot) -> list[Log]:
    """Logs of its arrays: joints of one measurement side by side, in the URDF's order."""
    found = []
    for name in names:
        table = np.load(folder / "data/KUKA/HW" / f"{name}.npz")
        parts = (
            dict(zip(robot.joint_names, table[key].T, strict=True)) for key in ("positions", "torques", "velocities")
        )
        found.append(Log.of(table["times"], *parts, name=name))
    return found


def known_load(folder: Path, case: dict[str, Any], robot: Robot) -> dict[str, Any]:
    """The mass that is found of a load whose mass is known; the same motion with and without it."""
    with_load, empty = (
        [scaled(log, robot, case["constants"]) for log in of_ur10e(folder, case[name], robot)]
        for name in ("loaded", "empty")
    )
    found = payload(robot, with_load, without=empty)
    return {"truth": case["load"], "mass": found.mass, "interval": 1.96 * found.mass_sd}


def report(found: Identification, python: str | None = None) -> dict[str, Any]:
    """Errors of all models, over what was identified and over all that moves, and joint by joint."""
    models = [*MODELS]
    table: dict[str, Any] = {
        "cutoff_hz": found.training.cutoff,
        "equations": [len(found.training), len(found.held_out)],
        "follow": [name for name, follows in zip(found.names, found.follows, strict=True) if follows],
        "identified": {model: found.error(model) for model in models},
        "all_moving": {model: found.error(model, found.moving) for model in models},
        "joints": {
            name: {model: float(found.errors(model)[i]) for model in models} for i, name in enumerate(found.names)
        },
    }
    if python is not None:
        table["identified"] |= by_figaroh(found, python)
    return table


# -- what a motion determines ------------------------------------------------------------------------------------------


def excitation(robot: Robot, seconds: float) -> dict[str, Any]:
    """The motion that is found against an eight with sines: as long, scaled alike, judged alike.

    Worst standard deviations are over the base parameters' sizes. The eight leaves some of them undetermined, so they
    are compared over those that it determines.
    """
    limits = ExcitationLimits(seconds=seconds)
    found = excite(robot, limits)
    search = ExcitationSearch.of(robot, limits)
    eight = eight_with_sines(search, float(found.time[-1]))
    there, table = np.isfinite(eight.sd), {"duration": float(found.time[-1]), "tried": found.tried}
    names = [found.base.name(i, search.unknowns.labels, 2) for i in range(len(there))]
    for name, one in (("excite", found), ("eight", eight)):
        both = np.where(there, one.relative, 0.0)
        forces = search.unknowns.matrix(one.position[::5], one.nu[::5], one.nudot[::5]) @ search.unknowns.prior
        table[name] = {
            "determined": int(np.isfinite(one.sd).sum()), "within_10_percent": int((one.relative < 0.1).sum()),
            "worst": float(one.relative.max()), "worst_of_both": float(both.max()), "which": names[both.argmax()],
            "median": float(np.median(one.relative)), "largest_torque": float((np.abs(forces) / search.torque).max()),
        }  # fmt: skip
    return table | {"parameters": len(there)}


# -- do intervals cover the truth? -------------------------------------------------------------------------------------


def simulated(robot: Robot, seed: int = 0) -> tuple[Unknowns, Array, Log]:
    """A robot unlike its URDF, its parameters (k,), and a minute of its motion as `excite` says, without noise.

    Every body is heavier or lighter by up to 30 %, and joints have friction.
    """
    rng, unknowns = (
        np.random.default_rng(seed),
        Unknowns(robot, Regressor.of(robot), tuple(range(robot.dimensions.dof))),
    )
    motion, theta = excite(robot, ExcitationLimits(duration=60.0, seconds=0.0, seed=seed)), unknowns.prior.copy()
    bodies = unknowns.regressor.inertial // BODY
    theta[: BODY * bodies] *= np.repeat(rng.uniform(0.7, 1.3, bodies), BODY)
    alone = unknowns.matrix(motion.position, motion.nu, motion.nudot)
    size = (alone @ theta).std(axis=0)
    for kind, share in (("viscous", 0.1), ("coulomb", 0.2)):
        theta[unknowns.columns(kind)[-len(unknowns.regressor.joints) :]] = (
            share * size[-len(unknowns.regressor.joints) :]
        )
    u = alone @ theta @ np.linalg.pinv(robot.E).T
    position = {name: motion.position[:, i] for i, name in enumerate(robot.joint_names)}
    effort = {name: u[:, i] for i, name in enumerate(robot.actuator_names)}
    return unknowns, theta, Log.of(motion.time, position, effort)


def noises(log: Log, rows: Equations, size: Array, seed: int, number: int) -> Iterator[Array]:
    """White noise of every effort, of a size (r,), as it comes through the filters of `equations`, (M, r) each."""
    rate, rng = 1.0 / float(np.median(np.diff(log.time))), np.random.default_rng(seed)
    even = np.arange(log.time[0], log.time[-1], 1.0 / rate)
    first = max(1, int(rate / (FINE * rows.cutoff)))
    second = max(1, int(rate / first / (KEPT * rows.cutoff)))
    kept = np.searchsorted(even[::first][::second], rows.time - 1e-6)
    for _ in range(number):
        n = low_pass(size * rng.standard_normal((len(even), len(size))), rows.cutoff, rate)
        yield low_pass(n[::first], rows.cutoff, rate / first)[::second][kept]


def coverage(robot: Robot, draws: int, noise: float = 0.2, seed: int = 1) -> dict[str, Any]:
    """How often intervals of 95 % cover the truth, of both fits, over draws of the torques' noise on one motion.

    Args:
        robot: A fixed arm.
        draws: How many; a tenth of them also for the consistent fit.
        noise: Of every torque, of its standard deviation.
        seed: Of the noise.
    """
    unknowns, theta, log = simulated(robot)
    cutoff = chosen_cutoff([log], robot)
    rows = equations(log, unknowns, cutoff, still_speeds([log], unknowns, cutoff))
    every = np.ones(len(unknowns.rows), bool)
    base, prior = base_parameters(unknowns, every, every), Prior.of(unknowns, rows)
    C, size = base.combination, noise * np.column_stack(list(log.effort.values())).std(axis=0)
    found: dict[str, list[Array]] = {name: [] for name in ("value", "sd", "consistent", "consistent_sd")}
    blocks = Blocks.of(rows, prior)
    for n, one in enumerate(noises(log, rows, size, seed, draws)):
        noisy = replace(rows, y=rows.y + one)
        fit = weighted_fit(noisy, base)
        found["value"].append(fit.value)
        found["sd"].append(fit.sd)
        if n % 10 == 0:
            weight, _ = blocks.chosen(every, fit.deviation, prior.strength)
            consistent = consistent_fit(*compressed(noisy, prior, every, fit), prior, weight, fit.inflation)
            found["consistent"].append(C @ consistent.theta)
            found["consistent_sd"].append(np.sqrt(np.diag(C @ consistent.covariance @ C.T)))
    value, sd, ours, ours_sd = (np.array(part) for part in found.values())
    truth = C @ theta
    covered, ratio = (np.abs(value - truth) < 1.96 * sd).mean(axis=0), sd.mean(axis=0) / value.std(axis=0)
    both = (np.abs(ours - truth) < 1.96 * ours_sd).mean(axis=0)
    parts = {"covered": covered, "sd_over_scatter": ratio, "consistent_covered": both}
    spread = {name: [float(f(part)) for f in (np.mean, np.min, np.max)] for name, part in parts.items()}
    worst = int(np.argmax(np.abs(covered - 0.95)))
    return spread | {
        "parameters": len(truth), "draws": draws, "equations": len(rows), "worst": base.name(worst, unknowns.labels),
        "of_worst": [float(covered[worst]), float(ratio[worst])],
    }  # fmt: skip


def payload_coverage(robot: Robot, draws: int, seed: int = 1) -> Iterator[dict[str, Any]]:
    """How often intervals of 95 % cover a load's mass and centre, for URDFs that are exact or wrong.

    The motion lasts 12 s, the load is 1 kg at (20, -30, 120) mm of the last joint, the noise 2 % of each torque. In
    every draw each body is heavier or lighter than its URDF by a normal number; where there is friction, the URDF has
    none.

    Args:
        robot: A fixed arm.
        draws: How many.
        seed: Of the noise and of the robots.
    """
    unknowns = Unknowns(robot, Regressor.of(robot), tuple(range(robot.dimensions.dof)))
    motion, at = excite(robot, ExcitationLimits(duration=12.0, seconds=0.0, seed=seed)), np.array([0.02, -0.03, 0.12])
    u = unknowns.matrix(motion.position, motion.nu, motion.nudot) @ unknowns.prior @ np.linalg.pinv(robot.E).T
    position = {name: motion.position[:, i] for i, name in enumerate(robot.joint_names)}
    log = Log.of(motion.time, position, {name: u[:, i] for i, name in enumerate(robot.actuator_names)})
    cutoff, size = chosen_cutoff([log], robot), u.std(axis=0)
    rows = equations(log, unknowns, cutoff, still_speeds([log], unknowns, cutoff))
    body, inertial = len(unknowns.regressor.bodies) - 1, unknowns.regressor.inertial
    of_load = rows.Y[:, :, BODY * body : BODY * (body + 1)] @ np.concatenate(([1.0], at, np.outer(at, at)[TRIANGLE]))
    for wrong, rubs, twice in CARRYING:
        rng, noise = np.random.default_rng(seed), noises(log, rows, 0.02 * size, seed, 2 * draws)
        both, found = Equations.stacked([rows] * (1 + twice)), []
        for _ in range(draws):
            theta = unknowns.prior.copy()
            theta[:inertial] *= np.repeat(1 + wrong * rng.standard_normal(inertial // BODY), BODY)
            for kind, share in (("viscous", 0.1), ("coulomb", 0.2)):
                theta[unknowns.columns(kind)] += share * rubs * size
            with_load, empty = (rows.Y @ theta + next(noise) for _ in range(2))
            y = np.concatenate([with_load + of_load, empty][: 1 + twice])
            drawn, carries = replace(both, y=y), np.arange(len(y)) < len(rows)
            load = numbers_of(drawn, carries, doubts(unknowns, drawn), body)
            slope = np.column_stack((-load.value[1:] / load.value[0], np.eye(3))) / load.value[0]
            sd = np.sqrt([load.covariance[0, 0], *np.diag(slope @ load.covariance @ slope.T)])
            found.append(
                (load.value[0] - 1.0, *(load.value[1:] / load.value[0] - at), *np.where(load.seen, sd, np.nan))
            )
        error, sd = np.split(np.array(found), 2, axis=1)
        yield {
            "urdf_off": wrong, "friction_missing": rubs, "motion_without_load": twice, "draws": draws,
            "covered": np.where(np.isnan(sd), np.nan, np.abs(error) < 1.96 * sd).mean(axis=0).round(3).tolist(),
            "rms_error": np.sqrt((error**2).mean(axis=0)).round(5).tolist(),
            "median_sd": np.median(sd, axis=0).round(5).tolist(),
        }  # fmt: skip


def main() -> None:
    """Print the errors as a table, or as JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("case", choices=[*CASES, "other", "coverage", "payload", "excite"])
    parser.add_argument("paths", nargs="*", type=Path)
    parser.add_argument("--draws", type=int, default=500)
    parser.add_argument("--seed", type=int, default=1, help="of the noise")
    parser.add_argument("--seconds", type=float, default=60.0, help="of wall time, of the search of excite")
    parser.add_argument("--robot")
    parser.add_argument("--cutoff", type=float)
    parser.add_argument("--figaroh", metavar="PYTHON", help="an interpreter that has figaroh 1.0.2")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    if given.case == "payload":
        for table in payload_coverage(load(given.robot or "panda"), given.draws, given.seed):
            print(json.dumps(table), flush=True)
        return
    if given.case in ("coverage", "excite"):
        before = time.process_time()
        if given.case == "coverage":
            table = coverage(load(given.robot or "panda"), given.draws, seed=given.seed)
        else:
            table = excitation(load(given.robot or "tiago"), given.seconds)
        print(json.dumps(table | {"processor_seconds": time.process_time() - before}, indent=1))
        return
    case = CASES.get(given.case, {"robot": given.robot, "logs": given.paths})
    folder = given.paths[0] if given.case in CASES else Path()
    name = folder / case["robot"] if "/" in case["robot"] and given.case in CASES else case["robot"]
    robot = load(name)
    if "held_out" in case:
        read = of_kuka if given.case == "kuka" else of_ur10e
        logs, judged = (read(folder, case[part], robot) for part in ("logs", "held_out"))
    else:
        logs, judged = read_logs([folder / log for log in case["logs"]], robot, case.get("columns")), []
    settings = {"held_out": judged, "cutoff": given.cutoff, "torque_constants": case.get("constants")}
    settings["mend"] = case.get("mend", {})
    identify(robot, logs, **settings)  # compiles
    before = time.process_time()
    found = identify(robot, logs, **settings)
    seconds = time.process_time() - before
    table = report(found, given.figaroh) | {"seconds": seconds, "rows": [len(log.time) for log in logs]}
    if "load" in case:
        table["load_kg"] = known_load(folder, case, robot)
    total = found.to_dict()["total"]
    table["total_kg"] = {"mass": total["mass"], "interval": 1.96 * total["mass_sd"], "urdf": total["urdf_mass"]}
    table["peak_mb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    if given.json:
        print(json.dumps(table))
        return
    title = f"{given.case}: {table['rows']} rows, low-pass {table['cutoff_hz']:.3g} Hz"
    print(f"{title}, {table['seconds']:.2f} s of processor time")
    models = list(table["identified"])
    print(f"{'':22s}" + "".join(f"{model:>18s}" for model in models))
    for title, errors in (("identified joints", table["identified"]), ("all that move", table["all_moving"])):
        print(f"{title:22s}" + "".join(f"{100 * errors.get(model, np.nan):17.1f}%" for model in models))
    for joint, errors in table["joints"].items():
        mark = "" if joint in table["follow"] else "  not identified"
        print(f"{joint:22s}" + "".join(f"{100 * errors.get(model, np.nan):17.1f}%" for model in models) + mark)
    print(
        "links that move: {mass:.1f} +- {interval:.1f} kg (95 %), in the URDF {urdf:.1f} kg".format(**table["total_kg"])
    )
    if "load_kg" in table:
        print("load: {mass:.3f} +- {interval:.3f} kg (95 %), weighed {truth} kg".format(**table["load_kg"]))


if __name__ == "__main__":
    main()
