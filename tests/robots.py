"""Robots for tests, as URDF: a mobile base with a spatial arm that feels gravity, and the same arm on a table."""

from __future__ import annotations

import re

import numpy as np
from closed_form import inertial, joint

from mmnn_pin.model.base.overrides import Overrides
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.model.loading import build
from mmnn_pin.model.robot import Robot
from mmnn_pin.model.urdf.reading import parse
from mmnn_pin.torque.controller import Feedback

AXLE, HALF_TRACK, RADIUS = 0.15, 0.25, 0.1


def robot_of(text: str) -> Robot:
    return build(parse(text.encode(), "robot.urdf"), Overrides(free=("all",)))  # all of their joints are the arm's


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


def tiny_arm(damping: float = 0.0, coulomb: float = 0.0) -> Robot:
    """A mobile base with seven joints, the last of 4e-6 kg m^2, all with limits."""
    text = f'<link name="base">{inertial(40.0, (1.0, 1.5, 2.0), place((0.0, 0.0, 0.2)))}</link>'
    for side, y in (("left", 0.25), ("right", -0.25)):
        shape = f'<collision><origin rpy="{np.pi / 2} 0 0"/><geometry><cylinder radius="0.1" length="0.03"/>'
        text += f'<link name="{side}">{inertial(2.0, (0.005, 0.01, 0.005))}{shape}</geometry></collision></link>'
        limit = '<limit effort="8" velocity="20"/>'
        text += joint(f"{side}_wheel", "base", side, place((0.0, y, 0.1)), "0 1 0", limit)
    masses = [(3.0, 0.02), (2.0, 0.01), (2.0, 0.01), (1.5, 5e-3), (1.0, 2e-3), (0.5, 5e-4), (0.02, 4e-6)]
    for i, (mass, moment) in enumerate(masses):
        text += f'<link name="link_{i}">{inertial(mass, (moment,) * 3, place((0, 0, 0.05 if i < 6 else 0.0)))}</link>'
        more = dynamics(damping, coulomb) + '<limit lower="-0.5" upper="1.5" effort="30" velocity="3"/>'
        at, axis = place((0, 0, 0.3 if i == 0 else 0.15)), "0 0 1" if i % 2 == 0 else "0 1 0"
        parent = f"link_{i - 1}" if i else "base"
        text += joint(f"joint_{i}", parent, f"link_{i}", at, axis, more, "revolute")
    return robot_of(f'<robot name="tiny">{text}</robot>')


def feedback(robot: Robot, period: float, share: float = 0.1) -> Feedback:
    """Gains that are this share of where each velocity alone, sampled with this period, would be unstable."""
    model, rng = Dynamics(robot), np.random.default_rng(0)
    positions = [robot.neutral_position(), *rng.uniform(-1.5, 1.5, (10, robot.dimensions.full))]
    worst = np.max([np.diag(np.linalg.inv(model.mass_matrix(position))) for position in positions], axis=0)
    gains = (share * 2.0 / (period * worst)).tolist()
    nb = robot.dimensions.base
    return Feedback(base=tuple(gains[:nb]), arm=tuple(gains[nb:]))
