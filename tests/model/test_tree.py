"""The flattened tree against Pinocchio's full matrices, and against finite differences of its own mass matrix."""

from __future__ import annotations

import os
import sysconfig
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mmnn_pin.errors import RobotError
from mmnn_pin.model.tree import tree as tree_module
from mmnn_pin.model.tree.dynamics import potential_energy, psi, psi_again, terms
from mmnn_pin.model.tree.motion import BASE, NUMBER, new_scratch
from mmnn_pin.model.tree.tree import flatten, residual, verify

RELATIVE = 1e-11
seeds = st.integers(0, 2**32 - 1)


def random_joint(rng):
    axis = rng.standard_normal(3)
    axis /= np.linalg.norm(axis)
    aligned = [getattr(pin, f"JointModel{kind}{letter}")() for kind in ("R", "RUB", "P") for letter in "XYZ"]
    return [*aligned, pin.JointModelRevoluteUnaligned(axis), pin.JointModelPrismaticUnaligned(axis)][rng.integers(11)]


def body(mass, centre, inertia=(0.01, 0.01, 0.01)):
    return pin.Inertia(mass, np.array(centre), np.diag(inertia))


def random_model(rng, joints, mobile):
    """Tree with random branches; joint 1 is the planar root of a mobile one.

    Joints come depth first, as from a URDF: `pin.crba` is wrong for others.
    """
    model = pin.Model()
    if mobile:
        model.addJoint(0, pin.JointModelPlanar(), pin.SE3.Random(), "root")
        model.appendBodyToJoint(1, pin.Inertia.Random(), pin.SE3.Identity())
    for k in range(joints):
        path = [model.njoints - 1]
        while path[-1] > mobile:
            path.append(model.parents[path[-1]])
        parent = int(rng.choice(path))
        joint = model.addJoint(parent, random_joint(rng), pin.SE3.Random(), f"joint{k}")
        model.appendBodyToJoint(joint, pin.Inertia.Random(), pin.SE3.Random())
    model.armature = rng.uniform(0, 0.3, model.nv)
    return model


def random_map(rng, model, mobile):
    """T with rows of a base, of wheels, of mimic joints, of zeros and of joints of their own."""
    base = int(rng.integers(2, 4)) if mobile else 0
    rows = [np.eye(3)[[0, 2] if base == 2 else [0, 1, 2]].T[k] for k in range(3)] if mobile else []
    rows, columns = [np.pad(row, (0, model.nv)) for row in rows], base
    for k in range(len(rows), model.nv):
        row, what = np.zeros(base + model.nv), rng.integers(4)
        if columns == 0 or what == 0:
            row[columns], columns = 1.0, columns + 1
        elif what == 1:
            row[rng.integers(columns)] = rng.uniform(-2, 2)  # mimic
        elif what == 2 and mobile:
            row[:base] = rng.uniform(-5, 5, base)  # wheel
        elif k == model.nv - 1:
            row = rng.standard_normal(row.shape) * (np.arange(len(row)) < columns)
        rows.append(row)
    return np.array(rows)[:, :columns]


def random_robot(seed, joints, mobile):
    """Model, T, control frame, resting position and a random position."""
    rng = np.random.default_rng(seed)
    pin.seed(seed % 2**31)
    model = random_model(rng, joints, mobile)
    T = random_map(rng, model, mobile)
    rest, position = rng.uniform(-2, 2, (2, model.nv))
    stands = ~T.any(axis=1)
    stands[: 3 * mobile] = False
    position[stands] = rest[stands]
    return rng, model, T, tuple(rng.uniform(-1, 1, 3)) if mobile else (0.0, 0.0, 0.0), rest, position


def pinocchio_q(model, position, frame):
    """Pinocchio's q: the pose of the root is that of the control frame times the inverse of its place in the root."""
    q = []
    for joint in list(model.joints)[1:]:
        at = position[joint.idx_v]
        if joint.nv == 3:
            x, y, phi = position[:3]
            control = pin.SE3(pin.utils.rotate("z", phi), np.array([x, y, 0.0]))
            root = control * pin.SE3(pin.utils.rotate("z", frame[2]), np.array([*frame[:2], 0.0])).inverse()
            q += [*root.translation[:2], *root.rotation[:2, 0]]
        else:
            q += [np.cos(at), np.sin(at)] if joint.nq == 2 else [at]
    return np.array(q)


def compiled_answers(tree, position, nu, nu_ref, nudot_ref):
    p, scratch = len(nu), new_scratch(tree)
    M, h, psi_fused, psi_alone = np.full((p, p), np.nan), np.full(p, np.nan), np.full(p, np.nan), np.full(p, np.nan)
    psi(tree, position, nu, nu_ref, nudot_ref, scratch, psi_alone)
    terms(tree, position, nu, scratch, M, h)
    psi_again(tree, position, nu_ref, nudot_ref, scratch, psi_fused)
    return M, h, psi_fused, psi_alone, potential_energy(tree, position, scratch)


def assert_close(ours, theirs, scale):
    assert np.abs(ours - theirs).max() <= RELATIVE * scale


@settings(max_examples=60, deadline=None)
@given(seeds, st.integers(1, 9), st.booleans(), st.booleans())
def test_random_trees_give_what_pinocchio_gives(seed, joints, mobile, tilted):
    rng, model, T, frame, rest, position = random_robot(seed, joints, mobile)
    if tilted:
        model.gravity.linear = rng.standard_normal(3) * 5
    tree = flatten(model, T, rest, frame, samples=0)
    nu, nu_ref, nudot_ref = rng.standard_normal((3, T.shape[1]))
    M, h, psi_fused, psi_alone, energy = compiled_answers(tree, position, nu, nu_ref, nudot_ref)

    data, q = model.createData(), pinocchio_q(model, position, frame)
    M_pin = T.T @ pin.crba(model, data, q) @ T
    h_pin = T.T @ pin.nonLinearEffects(model, data, q, T @ nu)
    g = pin.computeGeneralizedGravity(model, data, q)
    C = pin.computeCoriolisMatrix(model, data, q, T @ nu)
    psi_pin = M_pin @ nudot_ref + T.T @ (C @ (T @ nu_ref) + g)
    scale = np.abs(M_pin).max() * (1 + np.abs(T @ nu).max()) * (1 + np.abs(T @ nu_ref).max()) + np.abs(h_pin).max()
    assert_close(M, M_pin, np.abs(M_pin).max())
    assert_close(h, h_pin, scale)
    assert_close(psi_fused, psi_pin, scale)
    assert_close(psi_alone, psi_pin, scale)
    assert_close(energy, pin.computePotentialEnergy(model, data, q), 10 * sum(i.mass for i in model.inertias) * 10)


@settings(max_examples=20, deadline=None)
@given(seeds, st.integers(1, 6), st.booleans())
def test_the_check_passes_what_is_right(seed, joints, mobile):
    _, model, T, frame, rest, _ = random_robot(seed, joints, mobile)
    tree = flatten(model, T, rest, frame, samples=2, seed=seed)
    assert residual(tree, model, T, rest, 2).max() < RELATIVE


@settings(max_examples=20, deadline=None)
@given(seeds, st.integers(2, 6), st.booleans())
def test_the_coriolis_terms_belong_to_the_mass_matrix(seed, joints, mobile):
    """`x' Mdot x = 2 x' C x`, by central differences; Pinocchio is not asked."""
    rng, model, T, _, rest, position = random_robot(seed, joints, mobile)
    model.gravity.linear = np.zeros(3)
    tree = flatten(model, T, rest, samples=0)
    nu, x = rng.standard_normal((2, T.shape[1]))
    rates = T @ nu
    if mobile:  # M does not depend on the pose
        rates[:3] = 0.0

    def mass(step):
        return compiled_answers(tree, position + step * rates, nu, x, 0 * x)[0]

    Cx = compiled_answers(tree, position, nu, x, 0 * x)[2]
    eps = 1e-4 / (1 + np.abs(rates).max())
    slope = (8 * (mass(eps) - mass(-eps)) - (mass(2 * eps) - mass(-2 * eps))) / (12 * eps)
    size = np.abs(mass(0)).max() * np.abs(x).max() ** 2 * (1 + np.abs(rates).max()) * len(x)
    assert x @ slope @ x == pytest.approx(2 * x @ Cx, abs=1e-7 * size)


def wheeled(wheel):
    """Base with two wheels and one arm joint, nu = (v, w, q); the wheels' bodies are given."""
    model = pin.Model()
    model.addJoint(0, pin.JointModelPlanar(), pin.SE3.Identity(), "root")
    model.appendBodyToJoint(1, body(20, (0.1, 0, 0.2), (1, 1, 2)), pin.SE3.Identity())
    for name, y in (("left", 0.2), ("right", -0.2)):
        joint = model.addJoint(1, pin.JointModelRUBY(), pin.SE3(np.eye(3), np.array([0, y, 0.1])), name)
        model.appendBodyToJoint(joint, wheel, pin.SE3.Identity())
    joint = model.addJoint(1, pin.JointModelRZ(), pin.SE3(np.eye(3), np.array([0.1, 0, 0.3])), "arm")
    model.appendBodyToJoint(joint, body(2, (0.3, 0, 0)), pin.SE3.Identity())
    T = np.array([[1, 0, 0], [0, 0, 0], [0, 1, 0], [10, -2, 0], [10, 2, 0], [0, 0, 1]], dtype=float)
    return model, T


@pytest.mark.parametrize(
    ("wheel", "moving"),
    [
        (body(3, (0, 0.02, 0), (0.02, 0.03, 0.02)), 1),
        (body(3, (0.01, 0.02, 0), (0.02, 0.03, 0.02)), 3),
        (body(3, (0, 0.02, 0), (0.02, 0.03, 0.021)), 3),
    ],
)
def test_only_wheels_alike_all_around_cost_nothing(wheel, moving):
    model, T = wheeled(wheel)
    tree = flatten(model, T)
    assert len(tree.links) == BASE.w + 1 + moving
    assert residual(tree, model, T, np.zeros(model.nv)).max() < RELATIVE


@given(seeds)
@settings(max_examples=10, deadline=None)
def test_a_body_alike_all_around_its_axis_costs_nothing_at_any_tilt(seed):
    rng = np.random.default_rng(seed)
    pin.seed(seed % 2**31)
    model, T = wheeled(body(3, (0, 0.02, 0), (0.02, 0.03, 0.02)))
    placement = pin.SE3.Random()
    placement.rotation = pin.utils.rotate("x", rng.choice([0, np.pi / 2, np.pi]))  # exact enough to stay alike
    model.addJoint(1, pin.JointModelRUBZ(), placement, "top")
    model.appendBodyToJoint(5, body(1, (0, 0, 0.3), (0.2, 0.2, 0.1)), pin.SE3.Identity())
    T = np.vstack((T, [0.5, 2.0, -1.0]))
    tree = flatten(model, T)
    assert len(tree.links) == BASE.w + 2
    assert residual(tree, model, T, np.zeros(model.nv)).max() < RELATIVE


def test_joints_that_stand_still_cost_nothing_and_stand_where_they_are_told():
    model, T = wheeled(body(3, (0, 0.02, 0), (0.02, 0.03, 0.02)))
    T = T[:, :2]
    at_rest, bent = (flatten(model, T, [0, 0, 0, 0, 0, q]) for q in (0.0, 1.0))
    assert len(at_rest.links) == BASE.w + 1
    zero = np.zeros(model.nv), np.zeros(2), np.zeros(2), np.zeros(2)
    assert np.abs(compiled_answers(at_rest, *zero)[0] - compiled_answers(bent, *zero)[0]).max() > 1e-3


@pytest.mark.parametrize("name", ["left", "right", "arm"])
def test_a_wrong_tree_is_refused_by_the_name_of_the_joint(name):
    model, T = wheeled(body(3, (0.01, 0.02, 0), (0.02, 0.03, 0.02)))
    model.armature = np.zeros(model.nv)
    T = np.delete(np.eye(model.nv), 1, axis=1)  # every joint on its own
    tree = flatten(model, T)
    numbers = tree.numbers.copy()
    numbers[BASE.w + model.getJointId(name) - 1, NUMBER.second : NUMBER.second + 6] *= 1 + 1e-7
    with pytest.raises(RobotError, match=f"differ from Pinocchio's at joint '{name}'"):
        verify(tree._replace(numbers=numbers), model, T, np.zeros(model.nv))


def test_a_robot_of_which_only_masses_are_new_is_compared_too(monkeypatch):
    model, T = wheeled(body(3, (0.01, 0.02, 0), (0.02, 0.03, 0.02)))
    flatten(model, T)
    asked = []
    monkeypatch.setattr(tree_module, "residual", lambda *given: asked.append(given[4]) or residual(*given))
    model.inertias[4] = model.inertias[4] + model.inertias[4]
    flatten(model, T)
    model.jointPlacements[4] = model.jointPlacements[4] * pin.SE3.Random()  # hangs together otherwise
    flatten(model, T)
    assert asked == [5, 5]
    usual = tree_module.moments_of
    monkeypatch.setattr(tree_module, "moments_of", lambda inertia: usual(inertia) * (1 + 1e-6))
    with pytest.raises(RobotError, match="differ from Pinocchio's"):
        flatten(model, T)


def test_not_a_number_in_a_tree_is_refused():
    model, T = wheeled(body(3, (0, 0, 0)))
    tree = flatten(model, T)
    with pytest.raises(RobotError, match="inf"):
        verify(tree._replace(rotors=tree.rotors * np.nan), model, T, np.zeros(model.nv))


TWO_JOINTS = """<robot name="two"><link name="a"/>
<link name="b"><inertial><mass value="1"/>
<inertia ixx="1" iyy="2" izz="2.5" ixy="0.1" ixz="0" iyz="0"/></inertial></link>
<link name="c"><inertial><origin xyz="0.1 0.2 0.3"/><mass value="2"/>
<inertia ixx="1" iyy="2" izz="2.5" ixy="0.1" ixz="0" iyz="0"/></inertial></link>
<joint name="first" type="continuous"><parent link="a"/><child link="b"/><axis xyz="1 2 3"/></joint>
<joint name="odd" type="continuous"><origin xyz="0.3 0 0"/><parent link="b"/><child link="c"/><axis xyz="3 -1 2"/>
<mimic joint="first" multiplier="2"/></joint></robot>"""


def test_continuous_joints_about_any_axis_and_mimic_rows():
    model, T = pin.buildModelFromXML(TWO_JOINTS), np.array([[1.0], [2.0]])
    assert {joint.shortname() for joint in list(model.joints)[1:]} == {"JointModelRevoluteUnboundedUnaligned"}
    assert residual(flatten(model, T), model, T, np.zeros(2)).max() < RELATIVE


def test_mimic_joints_inside_pinocchio_are_refused():
    model = pin.buildModelFromXML(TWO_JOINTS, True)
    with pytest.raises(RobotError, match="joint 'odd' of type JointModelMimic"):
        flatten(model, np.eye(model.nv))


@pytest.mark.parametrize(
    "joint",
    [
        pin.JointModelSpherical(),
        pin.JointModelFreeFlyer(),
        pin.JointModelComposite(pin.JointModelRX()),
        pin.JointModelHelicalUnaligned(np.array([0.0, 0.0, 1.0]), 0.1),
    ],
    ids=lambda joint: joint.shortname(),
)
def test_joints_without_a_place_in_a_tree_are_refused_by_name_and_type(joint):
    model = pin.Model()
    model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "first")
    model.addJoint(1, joint, pin.SE3.Identity(), "odd")
    with pytest.raises(RobotError, match=f"joint 'odd' of type {joint.shortname()}"):
        flatten(model, np.eye(model.nv))


def test_a_planar_joint_is_a_root_or_refused():
    model = pin.Model()
    model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "first")
    model.addJoint(1, pin.JointModelPlanar(), pin.SE3.Identity(), "odd")
    with pytest.raises(RobotError, match="joint 'odd' of type JointModelPlanar"):
        flatten(model, np.eye(4))


def test_a_joint_beside_the_planar_root_is_refused():
    model, _ = wheeled(body(3, (0, 0, 0)))
    model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "lamp")
    with pytest.raises(RobotError, match="'lamp' stands in the world"):
        flatten(model, np.eye(model.nv))


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_inertias_that_are_not_finite_are_refused_by_joint(value):
    model, T = wheeled(body(3, (0, 0, 0)))
    model.inertias[4] = pin.Inertia(value, np.zeros(3), np.eye(3))
    with pytest.raises(RobotError, match="joint 'arm' is not finite"):
        flatten(model, T)


def test_arrays_of_wrong_shape_or_not_finite_are_refused():
    model, T = wheeled(body(3, (0, 0, 0)))
    for wrong in (T[:-1], T[:, 0], np.float64(1)):
        with pytest.raises(RobotError, match="T has shape"):
            flatten(model, wrong)
    with pytest.raises(RobotError, match="T has an entry that is not finite"):
        flatten(model, T * np.nan)
    with pytest.raises(RobotError, match="position_rest has shape"):
        flatten(model, T, np.zeros(2))


def example_robots():
    """URDF files of example-robot-data, from `$EXAMPLE_ROBOT_DATA` or where its wheel puts them; none if absent."""
    wheel = Path(sysconfig.get_paths()["purelib"]) / "cmeel.prefix/share/example-robot-data/robots"
    return sorted(Path(os.environ.get("EXAMPLE_ROBOT_DATA", wheel)).rglob("*.urdf"))


@pytest.mark.skipif(not example_robots(), reason="example-robot-data is not installed")
@pytest.mark.parametrize("path", example_robots(), ids=lambda path: path.stem)
@pytest.mark.parametrize("root", [None, pin.JointModelPlanar()], ids=["fixed", "planar"])
def test_every_example_robot_is_flattened(path, root):
    try:
        model = pin.buildModelFromUrdf(str(path), *([] if root is None else [root]))
    except ValueError:
        pytest.skip("Pinocchio does not read it")
    if model.nv == 0:
        pytest.skip("nothing moves")
    T, rest = np.eye(model.nv), np.zeros(model.nv)
    assert residual(flatten(model, T, samples=1), model, T, rest, 2).max() < RELATIVE
