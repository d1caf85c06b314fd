"""Robots are understood from their geometry, and T, A and E say how they move.

The second answer is Pinocchio's own kinematics: whatever the loader concluded, the point of a wheel that touches the
floor must stand still there.
"""

from __future__ import annotations

import os
import pickle

import numpy as np
import pinocchio as pin
import pytest
from drives import (
    ARM,
    CYLINDER,
    LIMIT,
    SPHERE,
    UP,
    Drive,
    joint,
    link,
    moving,
    origin,
    random_state,
    robot_of,
    rotation,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from mmnn_pin.errors import ConfigError, RobotError, UnknownName
from mmnn_pin.model import Undecided, bundled, load

angles = st.floats(-3.1, 3.1)
rotations = st.builds(rotation, angles, st.floats(-1.5, 1.5), angles)
signs = st.sampled_from([1, -1])
drives = st.builds(
    Drive,
    frame=st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(-0.9, 0.9)),
    floor=st.floats(-0.5, 0.5),
    track=st.floats(0.2, 1.0),
    radii=st.tuples(st.floats(0.03, 0.15), st.floats(0.03, 0.15)),
    flips=st.tuples(signs, signs),
    frames=st.tuples(rotations, rotations),
    inset=st.floats(-0.05, 0.05),
    shape=st.sampled_from([CYLINDER, SPHERE]),
    names=st.sampled_from([("left", "right"), ("z", "a"), ("elbow_2", "arm")]),
)


# --- The wheels roll --------------------------------------------------------------------------------------------------


@settings(max_examples=60, deadline=None)
@given(drive=drives, seed=st.integers(0, 1000))
def test_contact_points_of_the_wheels_stand_still(drive, seed):
    robot = robot_of(drive.urdf(), forward="x")  # wheels askew whose rates point back are asked about
    position, nu = random_state(robot, seed)
    data = moving(robot, position, nu)
    for i, (name, centre) in enumerate(zip(drive.names, drive.centres(robot, data), strict=True)):
        frame = robot.model.getFrameId(f"{name}_link", pin.FrameType.BODY)
        velocity = pin.getFrameVelocity(robot.model, data, frame, pin.LOCAL_WORLD_ALIGNED)
        contact = centre - drive.radii[i] * UP - data.oMf[frame].translation
        assert np.abs(velocity.angular).max() > 1e-6
        np.testing.assert_allclose(velocity.linear + np.cross(velocity.angular, contact), 0, atol=1e-9)


@settings(max_examples=60, deadline=None)
@given(drive=drives)
def test_T_spans_exactly_what_A_permits(drive):
    robot = robot_of(drive.urdf(), forward="x")  # wheels askew whose rates point back are asked about
    nv, p = robot.T.shape
    assert np.abs(robot.A @ robot.T).max() < 1e-12
    assert np.linalg.matrix_rank(robot.A) == len(robot.A) == nv - p
    M = pin.crba(robot.model, robot.model.createData(), robot.configuration(robot.neutral_position()))
    M = np.triu(M) + np.triu(M, 1).T
    assert np.linalg.eigvalsh(robot.T.T @ M @ robot.T).min() > 0


@settings(max_examples=60, deadline=None)
@given(drive=drives, seed=st.integers(0, 1000))
def test_the_control_frame_is_on_the_floor_amid_the_axle_and_moves_with_v_and_w(drive, seed):
    robot = robot_of(drive.urdf(), forward="x")  # wheels askew whose rates point back are asked about
    np.testing.assert_allclose(robot.frame, drive.frame, atol=1e-9)
    assert robot.base.floor == pytest.approx(drive.floor, abs=1e-9)
    assert robot.base.track == pytest.approx(drive.track)
    assert [(w.joint, w.radius) for w in robot.base.wheels] == [*zip(drive.names, drive.radii, strict=True)]
    position, nu = random_state(robot, seed)
    data = moving(robot, position, nu)
    x, y, phi = position[:3]
    left, right = drive.centres(robot, data)
    np.testing.assert_allclose((left + right)[:2] / 2, [x, y], atol=1e-9)
    np.testing.assert_allclose((left - right)[:2], drive.track * np.array([-np.sin(phi), np.cos(phi)]), atol=1e-9)
    root = pin.getFrameVelocity(robot.model, data, robot.model.getFrameId("base"), pin.LOCAL_WORLD_ALIGNED)
    arm = np.array([x, y, 0]) - data.oMf[robot.model.getFrameId("base")].translation
    expected = [nu[0] * np.cos(phi), nu[0] * np.sin(phi), nu[1]]
    np.testing.assert_allclose((root.linear + np.cross(root.angular, arm))[:2], expected[:2], atol=1e-9)
    assert root.angular[2] == pytest.approx(expected[2])


def test_positive_turn_of_an_axis_to_the_left_drives_forward_and_of_one_to_the_right_backward():
    assert [w.sign for w in robot_of(Drive(flips=(1, -1)).urdf()).base.wheels] == [1, -1]
    assert [w.sign for w in robot_of(Drive(flips=(-1, 1)).urdf()).base.wheels] == [-1, 1]


def test_axle_ahead_of_the_root_swings_the_root_sideways():
    robot = robot_of(Drive(frame=(0.3, 0.0, 0.0)).urdf())
    np.testing.assert_allclose(robot.T[:3, :2], [[1, 0], [0, -0.3], [0, 1]], atol=1e-12)


@pytest.mark.parametrize("heading", [np.pi / 2, -np.pi / 2])
def test_forward_is_across_the_root_x_where_names_and_rates_say(heading):
    assert robot_of(Drive(frame=(0, 0, heading)).urdf()).frame[2] == pytest.approx(heading)


def test_wheels_weigh_in_the_reduced_mass_with_their_spin():
    robot = robot_of(Drive(track=0.5).urdf(more=""))
    M = pin.crba(robot.model, robot.model.createData(), robot.configuration(np.zeros(5)))
    M = robot.T.T @ (np.triu(M) + np.triu(M, 1).T) @ robot.T
    in_v = 20 + 2 * 1.5 + 2 * 0.02 / 0.1**2
    in_w = 0.8 + 2 * 1.5 * 0.25**2 + 2 * 0.02 + 2 * 0.02 * 0.25**2 / 0.1**2
    np.testing.assert_allclose(M, np.diag([in_v, in_w]), atol=1e-12)


@settings(max_examples=20, deadline=None)
@given(drive=drives)
def test_motor_power_is_generalized_power(drive):
    robot = robot_of(drive.urdf(), forward="x")  # wheels askew whose rates point back are asked about
    u, nu = np.random.default_rng(1).normal(size=(2, robot.dimensions.motors))
    rates = dict(zip(robot.full_velocity_names, robot.T @ nu, strict=True))
    assert nu @ robot.E @ u == pytest.approx(sum(rates[n] * ui for n, ui in zip(robot.actuator_names, u, strict=True)))
    assert robot.actuator_names == (*drive.names, "shoulder", "elbow")


def test_layout_names_and_limits():
    text = (
        Drive()
        .urdf()
        .replace('<axis xyz="0.0 0.0 1.0"/>', '<axis xyz="0 0 2"/><dynamics damping="0.3" friction="0.1"/>')
    )
    robot = robot_of(text)
    names = robot.full_velocity_names
    assert robot.velocity_names == ("v", "w", "shoulder", "elbow") and robot.joint_names == ("shoulder", "elbow")
    assert (robot.dimensions.base, robot.dimensions.arm, robot.dimensions.full, robot.dimensions.motors) == (2, 2, 7, 4)
    assert [robot.full_velocity_names[i] for i in np.flatnonzero(robot.damping)] == ["shoulder"]
    assert robot.damping.max() == 0.3 and robot.coulomb.max() == 0.1
    assert robot.effort_limits.tolist() == [np.inf, np.inf, np.inf, 9.0]
    assert robot.neutral_position()[names.index("elbow")] == 0.2 and robot.upper[names.index("elbow")] == 2
    assert {names[i] for i in np.flatnonzero(robot.is_continuous)} == {"root_w", "left", "right", "shoulder"}


def test_configuration_moves_as_pinocchio_integrates():
    robot = robot_of(Drive(frame=(0.3, -0.1, 0.4), flips=(1, -1)).urdf())
    position, nu = random_state(robot)
    dt = 1e-7
    rate = robot.T @ nu
    rate[:3] = nu[0] * np.cos(position[2]), nu[0] * np.sin(position[2]), nu[1]
    moved = pin.integrate(robot.model, robot.configuration(position), robot.T @ nu * dt)
    np.testing.assert_allclose(robot.configuration(position + rate * dt), moved, atol=1e-12)


# --- Wheels are found on geometry -------------------------------------------------------------------------------------


def test_hub_height_of_wheels_without_a_shape_is_asked_about_wheel_by_wheel_where_they_differ():
    drive = Drive(floor=0.05, radii=(0.1, 0.12), shape="")
    skid = link("skid", 0, 0, SPHERE.format(r=0.01), origin(p=(-0.2, 0, 0.06)))
    text = drive.urdf(ARM + skid + joint("weld", "fixed", "base", "skid", p=(0, 0, 0)))
    with pytest.raises(RobotError, match=r"--wheel-radii left=0.1 --wheel-radii right=0.12 if so"):
        robot_of(text)
    robot = robot_of(text, wheel_radii=("left=0.1", "right=0.12"))
    assert [w.radius for w in robot.base.wheels] == pytest.approx([0.1, 0.12])


@pytest.mark.parametrize("name", ["wheel.stl", "package://shop/wheel.stl", "../shop/wheel.stl"])
def test_radius_of_a_mesh_is_that_of_its_vertices(tmp_path, name):
    trimesh = pytest.importorskip("trimesh")
    (tmp_path / "shop").mkdir()
    trimesh.creation.cylinder(radius=80, height=30, sections=60).export(tmp_path / "shop" / "wheel.stl")
    drive = Drive(radii=(0.08, 0.08), shape=f'<mesh filename="{name}" scale="0.001 0.001 0.001"/>', tag="visual")
    robot = robot_of(drive.urdf(), tmp_path / "shop" / "r.urdf")
    assert [w.radius for w in robot.base.wheels] == pytest.approx([0.08, 0.08])


@pytest.mark.parametrize("name", ["http://127.0.0.1:9/w.stl", "missing.stl", "broken.ply", "../../outside.stl"])
def test_meshes_that_are_missing_remote_damaged_or_outside_are_not_needed(tmp_path, name):
    folder = tmp_path / "a" / "b"
    folder.mkdir(parents=True)
    (folder / "broken.ply").write_bytes(b"ply\nnothing\xff")
    trimesh = pytest.importorskip("trimesh")
    trimesh.creation.cylinder(radius=0.08, height=0.03).export(tmp_path / "outside.stl")
    skid = link("skid", 0, 0, SPHERE.format(r=0.01), origin(p=(-0.2, 0, 0.01)))
    drive = Drive(shape=f'<mesh filename="{name}"/>')
    text = drive.urdf(skid + joint("weld", "fixed", "base", "skid"))
    with pytest.raises(RobotError, match=r"--radius 0.1 if so"):
        robot_of(text, folder / "r.urdf")
    robot = robot_of(text, folder / "r.urdf", radius=0.1)
    assert [w.radius for w in robot.base.wheels] == pytest.approx([0.1, 0.1])


def test_a_mesh_that_is_not_round_is_no_wheel(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    trimesh.creation.box((0.2, 0.1, 0.03)).export(tmp_path / "box.stl")
    with pytest.raises(Undecided, match="not round about the axle"):
        robot_of(Drive(shape='<mesh filename="box.stl"/>').urdf(), tmp_path / "r.urdf")


def swivel(name: str, p, shape: str = CYLINDER, parent: str = "base") -> str:
    lying = origin(pin.rpy.rpyToMatrix(np.pi / 2, 0, 0))
    fork = link(f"{name}_fork") + joint(f"{name}_swivel", "continuous", parent, f"{name}_fork", p=p, axis=(0, 0, 1))
    wheel = link(f"{name}_link", shape=shape.format(r=0.03), at=lying)
    return fork + wheel + joint(f"{name}_roll", "continuous", f"{name}_fork", f"{name}_link", p=(-0.02, 0, 0.03))


def test_swivel_casters_are_locked():
    robot = robot_of(Drive().urdf(ARM + swivel("front", (0.2, 0, 0))))
    assert robot.base.casters == ("front_swivel", "front_roll")
    assert robot.joint_names == ("shoulder", "elbow")
    still = [robot.full_velocity_names.index(name) for name in robot.base.casters]
    assert not robot.T[still].any()
    assert np.abs(robot.A @ robot.T).max() < 1e-12
    assert np.linalg.matrix_rank(robot.A) == robot.model.nv - robot.dimensions.dof


def test_swivel_with_its_wheel_welded_on_is_a_caster_and_a_turntable_is_not():
    fork = link("fork", shape='<box size="0.02 0.02 0.1"/>', at=origin(p=(0, 0, 0.05)))
    fork += joint("turn", "continuous", "base", "fork", p=(0.2, 0, 0), axis=(0, 0, 1))
    assert robot_of(Drive().urdf(fork)).base.casters == ("turn",)
    raised = fork.replace('xyz="0.2 0.0 0.0"', 'xyz="0.2 0.0 0.3"')
    assert raised != fork and robot_of(Drive().urdf(raised)).joint_names == ("turn",)


def test_ball_on_a_continuous_joint_is_a_caster():
    ball = link("ball", shape=SPHERE.format(r=0.03)) + joint("roll", "continuous", "base", "ball", p=(-0.2, 0, 0.03))
    assert robot_of(Drive().urdf(ball)).base.casters == ("roll",)


def test_suspension_is_locked_where_it_rests():
    drive = Drive().urdf().replace('<parent link="base"/><child link="left_link"/>',
                                   '<parent link="strut"/><child link="left_link"/>')  # fmt: skip
    strut = link("strut") + joint("spring", "prismatic", "base", "strut", axis=(0, 0, 1), more=LIMIT.format(0, 0.01))
    robot = robot_of(drive.replace("</robot>", strut + "</robot>"))
    assert robot.base.suspensions == ("spring",) and "spring" not in robot.joint_names
    assert not robot.T[robot.full_velocity_names.index("spring")].any()


def four_wheels() -> str:
    text = Drive(frame=(0.2, 0, 0)).urdf(more="")[: -len("</robot>")]
    rear = Drive(frame=(-0.2, 0, 0), names=("left_rear", "right_rear")).urdf(more="")
    return text + rear[rear.index('<link name="left_rear') :]


def one_wheel() -> str:
    text = Drive().urdf(more="")
    return text.replace('"right" type="continuous"', '"right" type="fixed"')


@pytest.mark.parametrize(("text", "candidates"), [
    (four_wheels(), ["left", "right", "left_rear", "right_rear"]),
    (one_wheel(), ["left"]),
    (Drive().urdf(more="").replace('xyz="0.0 -0.2 0.1"', 'xyz="0.1 -0.2 0.1"'),
     ["left", "right"]),
])  # fmt: skip
def test_undecided_base_lists_its_candidates(text, candidates):
    with pytest.raises(Undecided, match="undecided") as error:
        robot_of(text)
    assert [c.split("'")[1] for c in error.value.candidates] == candidates
    assert all(name in str(error.value) for name in candidates)


def test_wheels_in_the_air_are_told_and_not_taken_for_an_arm():
    keel = link("keel", shape='<box size="0.1 0.1 0.4"/>') + joint("weld", "fixed", "base", "keel")
    with pytest.raises(Undecided, match=r"0\.2 m above the robot's lowest point"):
        robot_of(Drive().urdf(keel))


def test_what_carries_a_moving_body_is_no_wheel():
    crank = link("crank") + joint("pin", "continuous", "left_link", "crank", p=(0.05, 0, 0))
    with pytest.raises(Undecided) as error:
        robot_of(Drive().urdf(crank))
    assert [c.split("'")[1] for c in error.value.candidates] == ["right"]


def test_continuous_arm_joints_are_no_wheels():
    roll = link("hand", shape=CYLINDER.format(r=0.04), at=origin(pin.rpy.rpyToMatrix(np.pi / 2, 0, 0)))
    robot = robot_of(Drive().urdf(ARM + roll + joint("wrist", "continuous", "fore", "hand", p=(0.2, 0, 0))))
    assert robot.joint_names == ("shoulder", "elbow", "wrist")
    fixed = robot_of(f'<robot name="a">{link("base")}{ARM}{roll}{joint("wrist", "continuous", "fore", "hand")}</robot>')
    assert fixed.base.kind == "fixed"


# --- Fixed arms -------------------------------------------------------------------------------------------------------


def test_fixed_arm_has_no_base_and_no_constraints():
    robot = robot_of(f'<robot name="a">{link("base")}{ARM}</robot>')
    np.testing.assert_array_equal(robot.T, np.eye(2))
    np.testing.assert_array_equal(robot.E, np.eye(2))
    assert robot.A.shape == (0, 2) and robot.base.kind == "fixed" and robot.dimensions.pose == 0
    assert robot.full_velocity_names == robot.velocity_names == robot.actuator_names == ("shoulder", "elbow")
    np.testing.assert_allclose(robot.configuration([0.3, 0.7]), [np.cos(0.3), np.sin(0.3), 0.7])
    np.testing.assert_allclose(robot.model.gravity.linear, [0, 0, -9.81])


# --- Loading ----------------------------------------------------------------------------------------------------------


def test_bundled_robots_load_by_name_from_any_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert set(bundled()) >= {"platform_arm", "two_axis_arm"}
    platform, arm = load("platform_arm"), load("two_axis_arm")
    assert platform.base.kind == "differential_drive" and platform.dimensions.arm == 2 and platform.base.casters == ()
    assert [w.radius for w in platform.base.wheels] == [0.075, 0.075]
    assert platform.base.track == pytest.approx(2 * 0.171)
    assert arm.base.kind == "fixed" and arm.dimensions.arm == 2


def test_robots_load_by_path(tmp_path):
    file = tmp_path / "my robot.urdf"
    file.write_text(Drive().urdf())
    for given_path in (file, str(file)):
        robot = load(given_path)
        assert robot.name == "my robot" and robot.path == file
    (tmp_path / "bare").write_text(Drive().urdf())
    assert load(tmp_path / "bare").name == "bare"


def test_unknown_names_list_what_there_is_and_missing_paths_say_so(tmp_path):
    with pytest.raises(UnknownName, match=r"did you mean 'platform_arm'\?") as unknown:
        load("platfrom_arm")
    assert "two_axis_arm" in str(unknown.value)
    for missing in ("nothing.urdf", str(tmp_path / "nothing"), tmp_path / "x"):
        with pytest.raises(RobotError, match="no such file"):
            load(missing)


def test_declared_friction_makes_a_copy():
    robot = robot_of(Drive().urdf())
    rubbed = robot.with_friction([1, 2, 3, 4])
    assert rubbed.viscous.tolist() == [1, 2, 3, 4] and robot.viscous.tolist() == [0] * 4
    assert robot.with_friction(5).viscous.tolist() == [5] * 4
    for bad in ([1, 2], [-1, 0, 0, 0], [np.nan] * 4):
        with pytest.raises(ConfigError, match="v, w, shoulder, elbow"):
            robot.with_friction(bad)


def test_arrays_are_read_only_and_robots_travel_between_processes():
    robot = robot_of(Drive().urdf())
    with pytest.raises(ValueError, match="read-only"):
        robot.T[0, 0] = 2
    again = pickle.loads(pickle.dumps(robot))
    np.testing.assert_array_equal(again.T, robot.T)
    assert again.model == robot.model


def test_joints_may_have_the_names_that_pinocchio_uses_itself():
    text = Drive(names=("root_joint", "universe")).urdf()
    robot = robot_of(text)
    assert [w.joint for w in robot.base.wheels] == ["root_joint", "universe"]
    assert np.abs(robot.A @ robot.T).max() < 1e-12


@pytest.mark.parametrize("kind", ["floating", "planar"])
def test_planar_and_floating_joints_are_welded_with_a_warning(kind):
    free = joint("free", kind, "world", "base", p=(0, 0, 1))
    text = f'<robot name="a"><link name="world"/>{link("base")}{free}{ARM}</robot>'
    if kind == "planar":  # an arm on a stand does not move in the plane
        with pytest.raises(RobotError, match=r"undecided.*--base holonomic .*; --base fixed"):
            robot_of(text)
        assert robot_of(text, base="holonomic").base.kind == "holonomic"
    robot = robot_of(text, base="fixed" if kind == "planar" else None)
    assert robot.full_velocity_names == ("shoulder", "elbow") and robot.base.kind == "fixed"
    assert [(f.severity, f.element) for f in robot.findings if f.code == "welded"] == [("warning", "joint 'free'")]
    same = robot_of(text.replace(kind, "fixed"))
    M = [pin.crba(r.model, r.model.createData(), r.configuration([0.3, 0.4])) for r in (robot, same)]
    np.testing.assert_array_equal(*M)


def test_what_pinocchio_prints_is_in_the_error_and_not_on_the_terminal(capfd):
    text = Drive().urdf(ARM.replace("</joint>", '<safety_controller k_velocity="much"/></joint>', 1))
    with pytest.raises(RobotError, match="much"):
        robot_of(text)
    assert capfd.readouterr().err == ""
    os.write(2, b"back")
    assert capfd.readouterr().err == "back"


def test_singular_dynamics_are_refused():
    text = Drive().urdf().replace(link("fore", 1.0), link("fore", 1.0, -5.0))
    with pytest.raises(RobotError, match="not positive definite"):
        robot_of(text)
