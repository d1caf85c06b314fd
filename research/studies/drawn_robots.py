"""Robots at random, identified from their own motion: do the stated bands of 95 % hold?

    export OPENBLAS_NUM_THREADS=1
    python -m research.studies.drawn_robots --draws 500

Every draw is another URDF: an arm of one to three joints with axes, lengths and bodies at random, fixed or on a
differential drive. The robot itself has other masses (by a factor of 0.75 to 1.3 each), centres (1 cm), friction that
the file lacks, and in every other draw rotors in its arm. A log of 15 s moves the arm, the base, or both; efforts are
Pinocchio's inverse dynamics with 1 % of noise, positions have the steps of encoders. Printed is the share of numbers
within their bands of 95 %, of all draws together: base parameters of least squares and of the fit that is written, the
mass of the whole, and efforts on another motion of the same joints, whose band is that of the covariance.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mmnn_pin import identify, load
from mmnn_pin.deploy.identify.equations import Equations, equations, still_speeds
from mmnn_pin.deploy.identify.identification import Identification
from mmnn_pin.deploy.identify.log import Log
from mmnn_pin.deploy.identify.report import total_of
from mmnn_pin.errors import MmnnError
from mmnn_pin.model.robot import Robot
from mmnn_pin.model.tree.body import parameters
from mmnn_pin.signals import Array

from .damaged_logs import ENCODER, NOISE, efforts, motion

KINDS = ("fixed", "arm", "base", "whole")  # a fixed arm, or what moves of a mobile one
WHEELS = ("left_wheel_joint", "right_wheel_joint")
BAND = 1.96
Bodies = dict[str, tuple[float, Array, Array]]  # mass, centre, inertia about it by link


def drawn_bodies(rng: np.random.Generator, arms: int, mobile: bool) -> Bodies:
    """Bodies that can be, of eight particles each."""
    sizes = {f"link_{i}": (rng.uniform(0.5, 4.0), 0.15) for i in range(arms)}
    if mobile:
        sizes |= {"base": (rng.uniform(8.0, 30.0), 0.3), "left": (0.8, 0.05), "right": (0.8, 0.05)}
    found: Bodies = {}
    for name, (mass, size) in sizes.items():
        wheel = name in ("left", "right")
        points = size * rng.uniform(-1, 1, (8, 3))
        centre = np.zeros(3) if wheel else points.mean(axis=0) + np.array([size, 0, 0]) * (name != "base")
        spread = (points - points.mean(axis=0)).T @ (points - points.mean(axis=0)) * mass / 8
        inertia = np.trace(spread) * np.eye(3) - spread
        found[name] = mass, centre, np.diag([1.0, 1.6, 1.0]) * mass * 0.0016 if wheel else inertia
    return found


def urdf_of(bodies: Bodies, joints: Sequence[tuple[Array, float]]) -> str:
    """A URDF of bodies; joints of the arm by axis and distance from the one before."""

    def link(name: str) -> str:
        mass, c, inertia = bodies[name]
        entries = " ".join(f'i{"xyz"[i]}{"xyz"[j]}="{inertia[i, j]:.17g}"' for i in range(3) for j in range(i, 3))
        at = f'<origin xyz="{c[0]:.17g} {c[1]:.17g} {c[2]:.17g}"/>'
        return f'<link name="{name}"><inertial>{at}<mass value="{mass:.17g}"/><inertia {entries}/></inertial></link>'

    def joint(name: str, kind: str, parent: str, child: str, at: str, axis: str) -> str:
        limits = '<limit lower="-2.6" upper="2.6" effort="300" velocity="5"/>'
        ends = f'<parent link="{parent}"/><child link="{child}"/><origin xyz="{at}"/><axis xyz="{axis}"/>'
        return f'<joint name="{name}" type="{kind}">{ends}{limits}</joint>'

    text = "".join(map(link, bodies))
    if "left" in bodies:
        for side, y in (("left", 0.2), ("right", -0.2)):
            wheel = f'<collision><origin rpy="{np.pi / 2} 0 0"/><geometry><cylinder radius="0.08" length="0.03"/>'
            shape = f'<link name="{side}">{wheel}</geometry></collision>'
            text = text.replace(f'<link name="{side}">', shape)
            text += joint(f"{side}_wheel_joint", "continuous", "base", side, f"0 {y} 0.08", "0 1 0")
    else:
        text += '<link name="base"/>'
    before = "base"
    for i, (axis, length) in enumerate(joints):
        height = 0.3 if i == 0 else 0.0
        axes = " ".join(repr(float(one)) for one in axis)
        text += joint(f"joint_{i}", "revolute", before, f"link_{i}", f"{length if i else 0.05!r} 0 {height}", axes)
        before = f"link_{i}"
    return f'<robot name="drawn">{text}</robot>'


def drawn_robots(rng: np.random.Generator, kind: str, folder: Path) -> tuple[Robot, Robot, float]:
    """A robot as its file has it, as it is, and its mass that moves [kg]."""
    arms = int(rng.integers(1, 4 if kind == "fixed" else 3))
    bodies = drawn_bodies(rng, arms, kind != "fixed")
    joints = [(np.roll([0.0, 0.0, 1.0], rng.integers(3)), float(rng.uniform(0.15, 0.4))) for _ in range(arms)]
    (folder / "file.urdf").write_text(urdf_of(bodies, joints))
    other: Bodies = {}
    for name, (mass, centre, inertia) in bodies.items():
        factor, shift = rng.uniform(0.75, 1.3), rng.uniform(-0.01, 0.01, 3) * (name not in ("left", "right"))
        other[name] = mass * factor, centre + shift, inertia * factor
    (folder / "robot.urdf").write_text(urdf_of(other, joints))
    told: dict[str, Any] = {"base": "differential_drive", "wheels": WHEELS} if kind != "fixed" else {"base": "fixed"}
    told |= {"free": ["all"]}  # two joints may be a head: a loader asks
    robot, true = (load(folder / f"{name}.urdf", **told) for name in ("file", "robot"))
    moving = np.abs(true.T).max(axis=1) > 0
    moving[: 3 if true.dimensions.base else 0] = False
    viscous, coulomb = (rng.uniform(*of, moving.size) * moving for of in ((0.2, 0.8), (0.1, 0.5)))
    true = replace(true, damping=viscous, coulomb=coulomb)
    if rng.random() < 0.5:
        true = true.with_armature(rng.uniform(0.1, 0.5, arms).tolist())
    return robot, true, sum(mass for mass, _, _ in other.values())


def log_of(true: Robot, kind: str, rng: np.random.Generator, noise: float = NOISE) -> Log:
    """The log of a motion: what moves has positions, and only its motors have efforts."""
    t, x, v, a = motion(true, rng)
    nb = true.dimensions.base
    still = {"arm": slice(0, nb), "base": slice(nb, None)}.get(kind, slice(0, 0))
    for part in (x, v, a):
        part[:, still] = 0.0
    u = efforts(true, x, v, a)
    u += noise * np.sqrt((u**2).mean(axis=0)) * rng.standard_normal(u.shape)
    position = {name: x[:, nb + i] for i, name in enumerate(true.joint_names)} if kind != "base" else {}
    for wheel in true.base.wheels if kind != "arm" else ():
        position[wheel.joint] = x[:, :nb] @ true.T[true.full_velocity_names.index(wheel.joint), :nb]
    if noise:
        position = {name: ENCODER * np.round(values / ENCODER) for name, values in position.items()}
    effort = {name: u[:, i] for i, name in enumerate(true.actuator_names) if name in position}
    return Log.of(t, position, effort, name="drawn")


def shares(found: Identification, true: Robot, mass: float, of: Equations) -> dict[str, Array]:
    """Whether numbers are within their bands, by kind."""
    theta = np.concatenate((parameters(true), np.zeros(found.unknowns.size - found.unknowns.regressor.size)))
    C, covariance = found.fit.base.combination, found.consistent.covariance
    sd = np.sqrt(np.maximum(np.diag(C @ covariance @ C.T), 0.0))
    size = 1e-6 * (np.abs(C) @ np.abs(theta)) + 1e-9
    total = total_of(found)
    error = of.y - of.Y @ found.theta
    spread = np.sqrt(np.maximum(np.einsum("mrk,kl,mrl->mr", of.Y, covariance, of.Y), 0.0))
    return {
        "least squares": np.abs(found.fit.value - C @ theta) < BAND * found.fit.sd + size,
        "written": np.abs(C @ (found.theta - theta)) < BAND * sd + size,
        "mass of the whole": np.array([abs(total["mass"] - mass) < BAND * total["mass_sd"] + 1e-6 * mass]),
        "efforts on another motion": (np.abs(error) < BAND * spread + 1e-6)[of.use & found.follows],
    }


def one(seed: int) -> tuple[str, dict[str, Array]]:
    """A draw: its kind, and its numbers within their bands; none where nothing is written."""
    rng, kind = np.random.default_rng(seed), KINDS[seed % len(KINDS)]
    with tempfile.TemporaryDirectory() as folder:
        robot, true, mass = drawn_robots(rng, kind, Path(folder))
        found = identify(robot, log_of(true, kind, rng))
    log, unknowns, cutoff = log_of(true, kind, rng, 0.0), found.unknowns, found.training.cutoff
    fresh = equations(log, unknowns, cutoff, still_speeds([log], unknowns, cutoff))
    return kind, shares(found, true, mass, fresh)


def main(args: Sequence[str] | None = None) -> int:
    """The table; the exit status is 1 where a share is below 95 %."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    how = parser.parse_args(args)
    table: dict[str, dict[str, list[Array]]] = defaultdict(lambda: defaultdict(list))
    refused = 0
    for seed in range(how.seed, how.seed + how.draws):
        try:
            kind, found = one(seed)
        except MmnnError as error:
            refused += 1
            print(f"{seed}: {str(error).splitlines()[0]}", flush=True)
            continue
        for name, inside in found.items():
            table[kind][name].append(inside)
            table["all"][name].append(inside)
    least = 1.0
    for kind in (*KINDS, "all"):
        means = {name: float(np.concatenate(parts).mean()) for name, parts in table[kind].items()}
        least = min([least, *means.values()])
        print(f"{kind:6s}", ", ".join(f"{name} {100 * share:.1f} %" for name, share in means.items()))
    print(f"{how.draws} draws, {refused} refused")
    return int(least < 0.95)


if __name__ == "__main__":
    raise SystemExit(main())
