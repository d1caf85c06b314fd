"""The shipped robots: every number of Tables 4.1 and 4.2 is derived back from the models that Pinocchio builds."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np
import pinocchio as pin
import pytest
from places import ROOT

URDF = ROOT / "urdf"
B, R, MC, MW, IC, IW, IM = 0.171, 0.075, 94.0, 5.0, 6.609, 0.010, 0.135  # Table 4.1
LENGTH, MASS, CENTRE, INERTIA = 0.4, 4.0, 0.2, 0.0533  # Table 4.2, both links
WHEELS, LINKS = ("wheel_left_joint", "wheel_right_joint"), ("arm_1_joint", "arm_2_joint")


def floating() -> pin.Model:
    return pin.buildModelFromUrdf(str(URDF / "platform_arm.urdf"), pin.JointModelPlanar())


def bench() -> pin.Model:
    return pin.buildModelFromUrdf(str(URDF / "two_axis_arm.urdf"))


def inertia(model: pin.Model, joint: str) -> pin.Inertia:
    return model.inertias[model.getJointId(joint)]


def placement(model: pin.Model, joint: str) -> pin.SE3:
    return model.jointPlacements[model.getJointId(joint)]


def bend(model: pin.Model, q: np.ndarray, angles: np.ndarray) -> None:
    """Set the angles of the two arm joints."""
    for link, angle in zip(LINKS, angles, strict=True):
        q[model.idx_qs[model.getJointId(link)]] = angle


def geometry(file: str, kind: pin.GeometryType) -> tuple[pin.GeometryModel, pin.GeometryData]:
    """Shapes of a robot, placed in the world at its neutral configuration."""
    path = str(URDF / file)
    model = floating() if file.startswith("platform") else bench()
    shapes = pin.buildGeomFromUrdf(model, path, kind)
    data = pin.GeometryData(shapes)
    pin.updateGeometryPlacements(model, model.createData(), shapes, data, pin.neutral(model))
    return shapes, data


def test_platform_of_table_4_1() -> None:
    body = inertia(floating(), "root_joint")
    assert body.mass == pytest.approx(MC)
    assert body.lever[:2] == pytest.approx([0, 0])  # on the vertical through Po
    about_po = body.matrix()[5, 5]  # moment about the root's z axis, through the foot of Po
    assert about_po == pytest.approx(IC)


@pytest.mark.parametrize(("wheel", "y"), list(zip(WHEELS, (B, -B), strict=True)))
def test_wheel_of_table_4_1(wheel: str, y: float) -> None:
    model = floating()
    assert placement(model, wheel).translation == pytest.approx([0, y, R])  # so the axle is r above the floor
    body = inertia(model, wheel)
    assert body.mass == pytest.approx(MW)
    axis = np.array([0.0, 1.0, 0.0])
    tensor = body.matrix()[3:, 3:]
    assert axis @ tensor @ axis == pytest.approx(IW)
    for angle in np.linspace(0, np.pi, 5):  # every diameter
        across = np.array([np.cos(angle), 0, np.sin(angle)])
        assert across @ tensor @ across == pytest.approx(IM)


def test_wheels_have_the_radius_of_table_4_1_and_stand_on_the_floor() -> None:
    for kind in (pin.GeometryType.VISUAL, pin.GeometryType.COLLISION):
        shapes, data = geometry("platform_arm.urdf", kind)
        cylinders = [
            (data.oMg[i], shape.geometry)
            for i, shape in enumerate(shapes.geometryObjects)
            if shape.name.startswith("wheel_") and hasattr(shape.geometry, "halfLength")
        ]
        assert max(cylinder.radius for _, cylinder in cylinders) == pytest.approx(R)
        for where, _ in cylinders:
            assert where.translation[2] == pytest.approx(R)
            assert abs(where.rotation[1, 2]) == pytest.approx(1)  # the cylinder lies along the axle


def test_a_positive_turn_of_the_wheels_rolls_forward() -> None:
    model = floating()
    data = model.createData()
    v = np.zeros(model.nv)
    v[0] = 1.0
    for wheel in WHEELS:
        v[model.idx_vs[model.getJointId(wheel)]] = 1 / R
    pin.forwardKinematics(model, data, pin.neutral(model), v)
    for wheel in WHEELS:
        joint = model.getJointId(wheel)
        at_floor = pin.SE3(np.eye(3), np.array([0, 0, -R]))
        assert at_floor.actInv(data.v[joint]).linear == pytest.approx([0, 0, 0])


def test_arm_of_table_4_2() -> None:
    model = floating()
    tip = model.frames[model.getFrameId("arm_tip")]
    lengths = [placement(model, LINKS[1]).translation[0], tip.placement.translation[0]]
    assert lengths == pytest.approx([LENGTH, LENGTH])
    for link in LINKS:
        body = inertia(model, link)
        assert body.mass == pytest.approx(MASS)
        assert body.lever[:2] == pytest.approx([CENTRE, 0])
        assert body.inertia[2, 2] == pytest.approx(INERTIA)
    assert placement(model, LINKS[0]).translation[:2] == pytest.approx([0.12, 0])  # assumed


def test_rolling_platform_has_the_lumped_inertia() -> None:
    """`T' M T` against the sums made by hand; the arm is added by the parallel-axis theorem, stretched ahead."""
    model = floating()
    T = np.zeros((model.nv, 2))
    T[0, 0] = T[2, 1] = 1
    for wheel, y in zip(WHEELS, (B, -B), strict=True):
        T[model.idx_vs[model.getJointId(wheel)]] = [1 / R, -y / R]
    M = T.T @ pin.crba(model, model.createData(), pin.neutral(model)) @ T
    arm = [0.12 + CENTRE, 0.12 + LENGTH + CENTRE]
    mass = MC + 2 * MW + 2 * IW / R**2 + 2 * MASS
    turn = IC + 2 * MW * B**2 + 2 * IM + 2 * IW * B**2 / R**2 + sum(INERTIA + MASS * x**2 for x in arm)
    np.testing.assert_allclose(M, np.diag([mass, turn]), atol=1e-12)


@pytest.mark.parametrize("model", [floating(), bench()], ids=["platform_arm", "two_axis_arm"])
def test_every_moving_body_could_exist(model: pin.Model) -> None:
    for body in list(model.inertias)[1:]:
        moments = np.linalg.eigvalsh(body.inertia)
        assert body.mass > 0
        assert moments[0] > 0
        assert moments[2] <= moments[0] + moments[1]  # triangle inequality


@pytest.mark.parametrize("model", [floating(), bench()], ids=["platform_arm", "two_axis_arm"])
def test_gravity_does_no_work_on_a_planar_arm(model: pin.Model) -> None:
    rng = np.random.default_rng(1)
    for _ in range(20):
        q = pin.neutral(model)
        bend(model, q, rng.uniform(-2, 2, 2))
        assert pin.computeGeneralizedGravity(model, model.createData(), q) == pytest.approx(0, abs=1e-12)


def test_bench_arm_has_two_vertical_axes_on_a_fixed_base() -> None:
    model = bench()
    assert model.nv == 2
    assert list(model.names)[1:] == list(LINKS)
    assert [model.joints[i].shortname() for i in (1, 2)] == ["JointModelRZ"] * 2
    centres = [inertia(model, link).lever[0] for link in LINKS]
    tip = model.frames[model.getFrameId("arm_tip")].placement
    lengths = [placement(model, LINKS[1]).translation[0], tip.translation[0]]
    assert centres == pytest.approx([lengths[0] / 2, lengths[1] / 2])


def lowest(shape: pin.GeometryObject, where: pin.SE3) -> float:
    """Height of a shape's lowest point [m]."""
    shape.geometry.computeLocalAABB()
    box = shape.geometry.aabb_local
    corners = np.array(np.meshgrid(*zip(box.min_, box.max_, strict=True))).reshape(3, -1)
    return float((where.rotation @ corners + where.translation[:, None])[2].min())


@pytest.mark.parametrize("kind", [pin.GeometryType.VISUAL, pin.GeometryType.COLLISION])
def test_only_wheels_and_casters_touch_the_floor(kind: pin.GeometryType) -> None:
    shapes, data = geometry("platform_arm.urdf", kind)
    height = {s.name: lowest(s, data.oMg[i]) for i, s in enumerate(shapes.geometryObjects)}
    on_floor = {name.rsplit("_", 1)[0] for name, z in height.items() if abs(z) < 1e-9}
    assert on_floor == {"wheel_left", "wheel_right", "caster_front", "caster_rear"}
    assert all(z > 0.02 for z in height.values() if abs(z) > 1e-9)


def test_no_part_cuts_into_another() -> None:
    """Arm over platform, link 2 over link 1, wheels beside the chassis: clear at any angle of the arm."""
    model = floating()
    shapes, data = geometry("platform_arm.urdf", pin.GeometryType.COLLISION)
    shapes.addAllCollisionPairs()
    data = pin.GeometryData(shapes)
    for angles in np.random.default_rng(2).uniform(-np.pi, np.pi, (30, 2)):
        q = pin.neutral(model)
        bend(model, q, angles)
        pin.updateGeometryPlacements(model, model.createData(), shapes, data, q)
        for i, pair in enumerate(shapes.collisionPairs):
            distance = pin.computeDistance(shapes, data, i).min_distance
            names = [shapes.geometryObjects[k].name for k in (pair.first, pair.second)]
            assert distance > -1e-6, names


@pytest.mark.parametrize("file", ["platform_arm.urdf", "two_axis_arm.urdf"])
def test_files_declare_limits_and_no_friction(file: str) -> None:
    root = ET.parse(URDF / file).getroot()
    moving = [joint for joint in root.iter("joint") if joint.get("type") != "fixed"]
    assert moving
    for joint in moving:
        limit = joint.find("limit")
        assert limit is not None
        assert float(limit.get("effort", 0)) > 0
        assert float(limit.get("velocity", 0)) > 0
    assert root.find(".//dynamics") is None  # an experiment declares friction
