"""Robots for tests, as URDF: a mobile base with a spatial arm that feels gravity, and the same arm on a table."""

from __future__ import annotations

import re

import numpy as np
from closed_form import inertial, joint

from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.model.loading import build
from mmnn_pin.model.robot import Robot
from mmnn_pin.model.urdf.reading import parse
from mmnn_pin.torque.controller import Feedback

AXLE, HALF_TRACK, RADIUS = 0.15, 0.25, 0.1


def robot_of(text: str) -> Robot:
    return build(parse(text.encode(), "robot.urdf"))


def place(xyz, rpy=(0.0, 0.0, 0.0)) -> str:
    return f'<origin xyz="{" ".join(map(str, xyz))}" rpy="{" ".join(map(str, rpy))}"/>'


def dynamics(damping: float, coulomb: float) -> str:
    return f'<dynamics damping="{damping}" friction="{coulomb}"/>'


def with_joint_friction(urdf: str, damping: float, coulomb: float) -> str:
    """URDF with this friction in every joint that moves."""
    return re.sub(
        r'(<joint [^>]*type="(?:continuous|revolute|prismatic)".*?)(</joint>)',
        lambda found: found[1] + dynamics(damping, coulomb) + found[2],
        urdf,
        flags=re.DOTALL,
    )


def arm(joints: int, seed: int, height: float, sliding: bool = True) -> str:
    """Chain of links on `base`: any axes, links that get lighter, friction; the third joint slides."""
    rng, text, parent = np.random.default_rng(seed), "", "base"
    for i in range(joints):
        mass, length = 4.0 * 0.75**i, rng.uniform(0.15, 0.35)
        moments = tuple((mass * length**2 * rng.uniform(0.1, 0.15, 3)).round(6).tolist())
        centre = place(rng.uniform(-0.1, 0.1, 3) + np.array([0, 0, length / 2]), rng.uniform(-1, 1, 3))
        text += f'<link name="link_{i}">{inertial(mass, moments, centre)}</link>'
        axis = rng.standard_normal(3)
        at = place((0.05, -0.02, height) if i == 0 else (0.02, 0.0, length), rng.uniform(-1, 1, 3))
        more = dynamics(0.05 * mass, 0.002 * mass) + '<limit lower="-9" upper="9" effort="99" velocity="9"/>'
        kind = "prismatic" if sliding and i == 2 else "continuous"
        words = " ".join(map(str, axis / np.linalg.norm(axis)))
        text += joint(f"joint_{i}", parent, f"link_{i}", at, words, more, kind)
        parent = f"link_{i}"
    return text


def mobile_arm(joints: int = 7, seed: int = 0, axle: float = AXLE) -> Robot:
    """Differential drive whose axle is ahead of the root link, with an arm of any axes, high above the floor."""
    text = f'<link name="base">{inertial(40.0, (1.0, 1.5, 2.0), place((0.05, 0.02, 0.2)))}</link>'
    for side, y in (("left", HALF_TRACK), ("right", -HALF_TRACK)):
        shape = f'<collision><origin rpy="{np.pi / 2} 0 0"/><geometry><cylinder radius="{RADIUS}" length="0.03"/>'
        text += f'<link name="{side}">{inertial(2.0, (0.005, 0.01, 0.005))}{shape}</geometry></collision></link>'
        text += joint(f"{side}_wheel", "base", side, place((axle, y, RADIUS)), "0 1 0", dynamics(0.02, 0.05))
    return robot_of(f'<robot name="mobile">{text}{arm(joints, seed, 3.0)}</robot>')


def fixed_arm(joints: int = 7, seed: int = 0) -> Robot:
    """Arm on a table."""
    return robot_of(f'<robot name="fixed"><link name="base"/>{arm(joints, seed, 0.1)}</robot>')


def feedback(robot: Robot, period: float, share: float = 0.1) -> Feedback:
    """Gains that are this share of where each velocity alone, sampled with this period, would be unstable."""
    model, rng = Dynamics(robot), np.random.default_rng(0)
    positions = [robot.neutral_position(), *rng.uniform(-1.5, 1.5, (10, robot.dimensions.full))]
    worst = np.max([np.diag(np.linalg.inv(model.mass_matrix(position))) for position in positions], axis=0)
    gains = (share * 2.0 / (period * worst)).tolist()
    nb = robot.dimensions.base
    return Feedback(base=tuple(gains[:nb]), arm=tuple(gains[nb:]))
