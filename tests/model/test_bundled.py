"""The robots that come with the package: what their files say of themselves holds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from mmnn_pin import load
from mmnn_pin.model.robots import bundled
from mmnn_pin.model.urdf.document import Document
from mmnn_pin.model.urdf.reading import read
from mmnn_pin.model.urdf.shapes import AtRest, Shape

MADE = (  # in one style
    "car_arm",
    "casters_arm",
    "loader_arm",
    "swerve_arm",
    "tracked_arm",
    "tricycle_arm",
    "truck_trailer_arm",
)
BOXED = ("box", "cylinder")  # shapes of all solid parts


def moment(shape: Shape, mass: float, about: np.ndarray) -> np.ndarray:
    """(3, 3) inertia of a uniform box or cylinder about a point, in the root's axes, by Pinocchio."""
    if shape.kind == "box":
        own = pin.Inertia.FromBox(mass, *(2 * shape.half))
    else:
        own = pin.Inertia.FromCylinder(mass, shape.radius, 2 * shape.half[2])
    moved = own.se3Action(pin.SE3(shape.pose[:3, :3], shape.pose[:3, 3] - about))
    lever = pin.skew(moved.lever)
    return moved.inertia - mass * lever @ lever


def volume(shape: Shape) -> float:
    a, b, c = 2 * shape.half
    return a * b * c if shape.kind == "box" else np.pi * shape.radius**2 * c


def document_of(name: str) -> Document:
    return read(bundled()[name])


def test_there_is_a_robot_of_every_kind():
    assert list(bundled()) == sorted([*MADE, "platform_arm", "two_axis_arm"])


@pytest.mark.parametrize("name", MADE)
def test_inertias_are_those_of_the_shapes(name):
    """Centre and inertia of every link are those of its collision shapes, all of one density."""
    document = document_of(name)
    rest, heavy = AtRest(document), 0
    model = pin.buildModelFromXML(document.text, pin.JointModelFreeFlyer())
    for link in document.links:
        shapes, mass = list(rest.shapes(link, "collision")), rest.mass(link)
        if not mass:
            assert not shapes
            continue
        heavy += 1
        assert {shape.kind for shape in shapes} <= set(BOXED)
        share = np.array([volume(shape) for shape in shapes])
        centre = share @ [shape.pose[:3, 3] for shape in shapes] / share.sum()
        np.testing.assert_allclose(rest.centre(link), centre, atol=2e-6, err_msg=link)
        want = sum(moment(shape, mass * v / share.sum(), centre) for shape, v in zip(shapes, share, strict=True))
        stated = inertia(document, link)
        np.testing.assert_allclose(stated, want, atol=2e-5 * np.trace(want), err_msg=link)
    assert heavy == len(document.links) - 2  # but for base_footprint and arm_tip
    assert sum(model.inertias[i].mass for i in range(1, model.njoints)) == pytest.approx(
        sum(rest.mass(link) for link in document.links)
    )


def inertia(document: Document, link: str) -> np.ndarray:
    """(3, 3) as the file states it; its frame is along the root's at rest."""
    stated = document.links[link].find("inertial/inertia")
    upper = {key: float(stated.get(key)) for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")}
    xx, xy, xz, yy, yz, zz = upper.values()
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


@pytest.mark.parametrize("name", bundled())
def test_the_audit_finds_nothing(name):
    assert {finding.code for finding in document_of(name).findings} <= {"no-inertial"}  # of mere frames


@pytest.mark.parametrize("name", MADE)
def test_nothing_is_assumed_of_them(name):
    warned = [finding for finding in load(name).findings if finding.severity == "warning"]
    assert {finding.code for finding in warned} == {"no-inertial"}


@pytest.mark.parametrize("name", MADE)
def test_every_joint_says_what_limits_it_and_how_it_rubs(name):
    document = document_of(name)
    model = pin.buildModelFromXML(document.text)
    for joint in document.joints.values():
        if joint.moves:
            speed = model.upperVelocityLimit[model.joints[model.getJointId(joint.name)].idx_v]
            assert 0 < joint.effort < np.inf and 0 < speed < np.inf, joint.name
            assert joint.damping > 0 and joint.friction > 0, joint.name


@pytest.mark.parametrize("name", MADE)
def test_wheels_stand_on_the_floor_and_arms_clear_them(name):
    """The root link is on the floor; no posture within the limits brings the arm down to a wheel, nor to the body."""
    document = document_of(name)
    model = pin.buildModelFromXML(document.text)
    data, rng = model.createData(), np.random.default_rng(0)
    rest = AtRest(document)
    wheels = [link for link in document.links if link.endswith("_wheel")]
    arm = [link for link in document.links if link.startswith("arm_") and link != "arm_tip"]
    for link in wheels:
        assert min(shape.lowest for shape in rest.shapes(link, "collision")) == pytest.approx(0.0, abs=1e-9)
    top = max(2 * shape.radius for link in wheels for shape in rest.shapes(link, "collision"))
    own = {link: [(shape, model.getFrameId(link)) for shape in rest.shapes(link, "collision")] for link in arm[1:]}
    for _ in range(400):
        q = pin.neutral(model)
        for link in arm:
            j = model.joints[model.getJointId(f"{link}_joint")]
            ends = model.lowerPositionLimit[j.idx_q], model.upperPositionLimit[j.idx_q]
            q[j.idx_q] = rng.choice([*ends, rng.uniform(*ends)])
        pin.framesForwardKinematics(model, data, q)
        for link, shapes in own.items():
            for shape, frame in shapes:
                pose = data.oMf[frame].homogeneous @ np.linalg.inv(rest.placements[link]) @ shape.pose
                assert replace(shape, pose=pose).lowest > top, (link, q)


def test_belts_run_over_the_wheels_on_the_floor():
    """No other wheel turns: URDF has no belts that would turn them."""
    base = load("tracked_arm").base
    sides = [f"{side}_{place}" for side in ("left", "right") for place in ("sprocket", "idler")]
    assert base.kind == "tracked" and base.parked == tuple(f"{name}_joint" for name in sides)
    assert len(base.wheels) == 8 and base.track == pytest.approx(0.46)
