"""What the certificate says of arms with many joints: `python -m studies.certified_arms`.

A line at 0.3 m/s with every joint of the arm swinging, exact poses, no network, PD whose gains are a bandwidth times the
effective inertia of each velocity. For every bandwidth the control period is as long as the hold permits (h mu = 0.1).
The first bandwidth with a region counts; where none has one, the table says which condition fails at the best of them.
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
from mmnn_pin.errors import RecordingError
from mmnn_pin.kinematic import Kinematic
from mmnn_pin.lab.proof.certificate import Certificate, certify
from mmnn_pin.lab.proof.certified_loop import CertifiedLoop
from mmnn_pin.lab.proof.motion_bound import Along
from mmnn_pin.lab.show.table import Column, Table, number, row_of, terminal_text
from mmnn_pin.model import Robot, load
from mmnn_pin.model.robots import find
from mmnn_pin.signals import Layout

ROBOTS = ("platform_arm", "platform_panda", "tiago_no_hand")
BANDWIDTHS = (100.0, 300.0, 1000.0, 3000.0, 10000.0)  # [1/s]
HELD = 0.1  # h mu


@dataclass(frozen=True)
class Found:
    """What one robot gets at one bandwidth.

    Attributes:
        bandwidth: Of the gains [1/s].
        period: Control period [s].
        certificate: Its certificate; None where M is not bounded even in the smallest boxes, for the reason in `why`.
        why: That reason.
        seconds: What it took.
    """

    bandwidth: float
    period: float
    certificate: Certificate | None
    why: str
    seconds: float


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


def loop_of(robot: Robot, bandwidth: float, swing: float, friction: bool = True) -> CertifiedLoop:
    """PD along a line, every joint swinging by `swing` [rad or m] around the middle of its range, at most 1 off neutral."""
    robot = robot if friction else robot.without_friction()
    layout, n = Layout.of(robot.dimensions), robot.dimensions.arm
    at = robot.arm_index
    middle = np.clip((robot.lower[at] + robot.upper[at]) / 2, robot.rest[at] - 1, robot.rest[at] + 1)
    middle = np.where(np.isfinite(middle), middle, robot.rest[at])
    path = Trajectory(Line(speed=0.3), tuple(Sine(amplitude=swing, period=6.0, offset=float(m)) for m in middle))
    table = path.table(np.arange(601) * 0.01, layout)
    pose, v, a, q, qdot, qddot = np.split(table, np.cumsum([3, 2, 2, n, n]), axis=1)
    kinematic = Kinematic(kx=1.0, ky=8.0, kth=2 * 8**0.5, K=3.0)
    loop = CertifiedLoop(
        robot, kinematic, Along(v, a, q, qdot, qddot, pose), 1e-6, np.ones(n + 2), None, np.zeros(n + 2)
    )
    cover = loop.cover(0.0)
    gain = bandwidth / np.einsum("nii->ni", np.linalg.inv(cover.postures.M)).mean(axis=0)
    loop = CertifiedLoop(robot, kinematic, loop.along, HELD / cover.fastest(gain), gain, None, np.zeros(n + 2))
    return loop


def study(name: str, swing: float, friction: bool) -> Found:
    """The first bandwidth with a region, or the last."""
    robot, found = robot_of(name), None
    for bandwidth in BANDWIDTHS:
        begun = perf_counter()
        loop = loop_of(robot, bandwidth, swing, friction)
        try:
            certificate, why = certify(loop), ""
        except RecordingError as error:
            certificate, why = None, error.why or error.what
        found = Found(bandwidth, loop.period, certificate, why, perf_counter() - begun)
        if certificate is None or certificate.holds:
            break
    assert found is not None
    return found


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m studies.certified_arms", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("robots", nargs="*", default=ROBOTS, help="names or URDF files, or platform_panda")
    parser.add_argument("--swing", type=float, default=0.1, help="amplitude of every joint [rad or m]")
    parser.add_argument("--frictionless", action="store_true", help="without the friction of the URDF")
    given = parser.parse_args(arguments)
    for name in given.robots:
        found = study(name, given.swing, not given.frictionless)
        print(name, found.bandwidth, found.period, found.why, found.seconds)
        c = found.certificate
        if c is not None:
            print(c.holds, c.region.box, c.bound.box, c.bound.joints, c.bound.reach)
            for one in c.conditions:
                if not one.holds:
                    print(one)
            for one in c.constants:
                if one.sampled is not None:
                    print(one.name, one.value, one.sampled, one.loose)


if __name__ == "__main__":
    main()
