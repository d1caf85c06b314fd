"""What the certificate says of arms with many joints: `python -m research.studies.certified_arms`.

A line at 0.3 m/s with every joint of the arm swinging, exact poses, no network, PD whose gains are a bandwidth times
the effective inertia of each velocity, a control period as long as the hold permits (`h mu` = 0.1); where there is
gravity also with it added at the measured joints. The table has the first bandwidth with a region, and at it, or at the
last, the energy E* above which the energy of the errors falls, beside what samples say of it, and how far M may be off
its middle in a box of postures, relative.
`platform_panda` is chapter 4's platform with a Panda of 7 joints in place of its arm.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import numpy as np
from lxml import etree

from mmnn_pin import Line, Sine, Trajectory
from mmnn_pin.kinematic import Kinematic
from mmnn_pin.lab.show.table import Column, Row, Table, row_of, terminal_text
from mmnn_pin.model import Robot, load
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.model.robots import find
from mmnn_pin.signals import Layout
from research.proof.certificate import Certificate, Constant, certify
from research.proof.certified_loop import CertifiedLoop
from research.proof.cover import Along

ROBOTS = ("platform_arm", "platform_panda", "tiago_no_hand")
BANDWIDTHS = tuple(np.geomspace(100.0, 1e6, 17).tolist())  # [1/s]
HELD = 0.1  # h mu
READY = {"platform_panda": (0.0, -0.79, 0.0, -2.36, 0.0, 1.57, 0.79)}  # around which joints swing, else their middles


@dataclass(frozen=True)
class Found:
    """What one robot gets."""

    bandwidth: float  # of the gains [1/s]
    period: float  # control period [s]
    certificate: Certificate  # its certificate
    seconds: float  # what it took, all bandwidths together

    @property
    def constants(self) -> dict[str, Constant]:
        """The constants that are bounded, by name."""
        return {one.name: one for one in self.certificate.constants if one.sampled is not None}

    @property
    def verdict(self) -> str:
        """That it holds, or the first condition that fails."""
        failed = [one for one in self.certificate.conditions if not one.holds]
        return (
            f"{failed[0].name}: {failed[0].value:.2g} is not {failed[0].need} {failed[0].limit:.2g}"
            if failed
            else "holds"
        )


def platform_panda() -> Robot:
    """Chapter 4's platform with a Panda on its deck, without meshes."""
    platform, panda = (etree.parse(str(find(name))).getroot() for name in ("platform_arm", "panda"))
    for part in [one for one in platform if str(one.get("name", "")).startswith("arm_")]:
        platform.remove(part)
    for part in panda.iterfind("*"):
        if part.tag in ("link", "joint"):
            for shape in part.findall("visual") + part.findall("collision"):
                part.remove(shape)
            platform.append(part)
    mount = etree.SubElement(platform, "joint", name="panda_mount", type="fixed")
    etree.SubElement(mount, "parent", link="base_link")
    etree.SubElement(mount, "child", link="panda_link0")
    etree.SubElement(mount, "origin", xyz="0.12 0 0.26")
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "platform_panda.urdf"
        etree.ElementTree(platform).write(str(file))
        return load(file)


def robot_of(name: str) -> Robot:
    """A robot by name."""
    return platform_panda() if name == "platform_panda" else load(name)


def loop_of(robot: Robot, swing: float, middle: Sequence[float] | None = None, weighs: bool = False) -> CertifiedLoop:
    """The loop along a line, every joint swinging by `swing` [rad or m], with gains that are still to be chosen."""
    layout, n, at = Layout.of(robot.dimensions), robot.dimensions.arm, robot.arm_index
    if middle is None:
        limited = np.isfinite(robot.lower[at]) & np.isfinite(robot.upper[at])
        halves = np.where(limited, robot.lower[at] + robot.upper[at], 0.0) / 2
        middle = np.where(limited, halves, robot.rest[at]).tolist()
    path = Trajectory(Line(speed=0.3), tuple(Sine(amplitude=swing, period=6.0, offset=float(m)) for m in middle or ()))
    parts = np.split(path.table(np.arange(601) * 0.01, layout), np.cumsum([3, 2, 2, n, n]), axis=1)
    pose, v, a, q, qdot, qddot = parts
    kinematic = Kinematic(kx=1.0, ky=8.0, kth=2 * 8**0.5, K=3.0)
    along, none = Along(v, a, q, qdot, qddot, pose), np.zeros(n + 2)
    return CertifiedLoop(robot, kinematic, along, 1e-3, np.ones(n + 2), None, none, weighs=weighs)


def study(robot: Robot, swing: float, middle: Sequence[float] | None = None, weighs: bool = False) -> Found:
    """The first bandwidth with a region, or the last."""
    begun, loop = perf_counter(), loop_of(robot, swing, middle, weighs)
    cover = loop.cover(0.0)
    inertia = 1 / np.einsum("nii->ni", np.linalg.inv(cover.postures.M)).mean(axis=0)
    for bandwidth in BANDWIDTHS:
        gain = bandwidth * inertia
        tuned = loop.tuned(gain=gain, period=HELD / cover.fastest(gain))
        certificate = certify(tuned)
        if certificate.holds:
            break
    return Found(bandwidth, tuned.period, certificate, perf_counter() - begun)


def row(name: str, found: Found) -> Row:
    """One line of the table."""
    level, box = found.constants["E*"], found.certificate.region.box
    cover = found.certificate.boxes.cover(box)
    joints = 1e3 * (found.certificate.bound if found.certificate.holds else found.certificate.region).joints.max(
        initial=0.0
    )
    cells = (found.bandwidth, 1e6 * found.period, level.value, level.sampled, box.energy, cover.mass_off.max(), joints)
    return row_of(name, *(f"{value:.2g}" for value in cells), f"{found.seconds:.0f}", found.verdict)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    words = (__doc__ or "").splitlines()[0]
    parser = argparse.ArgumentParser(prog="python -m research.studies.certified_arms", description=words)
    parser.add_argument("robots", nargs="*", default=ROBOTS, help="names or URDF files, or platform_panda")
    parser.add_argument("--swing", type=float, default=0.1, help="amplitude of every joint [rad or m]")
    parser.add_argument("--frictionless", action="store_true", help="without the friction of the URDF")
    given, rows = parser.parse_args(arguments), []
    for name in given.robots:
        robot = robot_of(name)
        robot = robot.without_friction() if given.frictionless else robot
        weighs = Dynamics(robot).feels_gravity
        for own in (False, True)[: 1 + weighs]:
            found = study(robot, given.swing, READY.get(name), own)
            rows.append(row(f"{name}, {'pd_gravity' if own else 'pd'}", found))
    heads = ["bandwidth\n1/s", "period\nus", "E*\nJ", "sampled\nJ", "region\nJ", "M off", "joints\nmrad", "took\ns"]
    columns = (Column(text=True), *map(Column, heads), Column("verdict", text=True))
    print(terminal_text([Table("arms", columns, tuple(rows))], False, 140))


if __name__ == "__main__":
    main()
