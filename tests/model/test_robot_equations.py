"""What a robot answers at a configuration, held against Pinocchio and against differences of what it answered."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mmnn_pin import load
from mmnn_pin.errors import ConfigError, UnknownName
from mmnn_pin.model import bundled
from mmnn_pin.model.robot import Robot

ROBOTS = ("platform_arm", "two_axis_arm", "tiago")
STEP = 1e-6
seeds = st.integers(0, 2**32 - 1)


@cache
def robot(name: str) -> Robot:
    return load(name)


def moved(r: Robot, q: np.ndarray, nu: np.ndarray, t: float) -> np.ndarray:
    """The q after a time t at a constant nu, to second order: base velocities are in the control frame."""
    d, out = r.dimensions, q.astype(float).copy()
    if d.base:
        sideways = nu[1] if d.base == 3 else 0.0
        phi = q[2] + nu[d.base - 1] * t / 2
        c, s = np.cos(phi), np.sin(phi)
        out[:3] += t * np.array([c * nu[0] - s * sideways, s * nu[0] + c * sideways, nu[d.base - 1]])
    out[d.pose :] += t * nu[d.base :]
    return out


@pytest.mark.parametrize("name", ROBOTS)
@settings(max_examples=10, deadline=None)
@given(seed=seeds)
def test_terms_are_those_of_the_full_model_reduced(name: str, seed: int) -> None:
    r, rng = robot(name), np.random.default_rng(seed)
    q, p = r.random(rng), r.dimensions.dof
    nu, nu_ref, nudot = rng.normal(size=(3, p))
    at, data, T = r.configuration(r.position(q)), r.model.createData(), r.T
    M = T.T @ pin.crba(r.model, data, at) @ T
    np.testing.assert_allclose(r.mass_matrix(q), M, atol=1e-9)
    np.testing.assert_allclose(r.gravity(q), T.T @ pin.rnea(r.model, data, at, 0 * T[:, 0], 0 * T[:, 0]), atol=1e-8)
    # with nu_ref = nu Psi is inverse dynamics
    torque = T.T @ pin.rnea(r.model, data, at, T @ nu, T @ nudot) + r.friction(nu)
    np.testing.assert_allclose(r.psi(q, nu, nu, nudot), torque, atol=1e-8)
    rest = r.psi(q, nu, nu_ref, nudot) - r.psi(q, nu, 0 * nu_ref, nudot)
    np.testing.assert_allclose(r.coriolis(q, nu) @ nu_ref, rest, atol=1e-8)


@pytest.mark.parametrize("name", ROBOTS)
@settings(max_examples=5, deadline=None)
@given(seed=seeds)
def test_the_mass_matrix_changes_as_the_coriolis_matrix_says(name: str, seed: int) -> None:
    """Property 2, by differences along a motion of q itself."""
    r, rng = robot(name), np.random.default_rng(seed)
    q, nu = r.random(rng), rng.normal(size=r.dimensions.dof)
    rate = (r.mass_matrix(moved(r, q, nu, STEP)) - r.mass_matrix(moved(r, q, nu, -STEP))) / (2 * STEP)
    C = r.coriolis(q, nu)
    np.testing.assert_allclose(rate, C + C.T, atol=1e-5 * max(1.0, abs(C).max()))


@pytest.mark.parametrize(("name", "frame"), [("platform_arm", "arm_tip"), ("two_axis_arm", "arm_2_joint"),
                                             ("tiago", "arm_tool_link"), ("tiago", "wheel_left_link")])  # fmt: skip
@settings(max_examples=8, deadline=None)
@given(seed=seeds)
def test_the_jacobian_is_the_derivative_of_the_placement(name: str, frame: str, seed: int) -> None:
    r, rng = robot(name), np.random.default_rng(seed)
    q, nu = r.random(rng), rng.normal(size=r.dimensions.dof)
    linear = slice(0, 3 if "wheel" in frame else 6)  # a wheel spins about its axle, which no q says
    before, after = (r.placement(frame, moved(r, q, nu, t)) for t in (-STEP, STEP))
    rate = (after - before) / (2 * STEP)
    spin = rate[:3, :3] @ r.placement(frame, q)[:3, :3].T
    twist = np.array([*rate[:3, 3], spin[2, 1], spin[0, 2], spin[1, 0]])
    J = r.jacobian(frame, q)
    np.testing.assert_allclose((J @ nu)[linear], twist[linear], atol=2e-6 * max(1.0, abs(J).max()))
    np.testing.assert_allclose(J, r.jacobian(frame, q, reduced=False) @ r.T, atol=1e-12)


@pytest.mark.parametrize("name", ROBOTS)
def test_the_unreduced_jacobian_is_pinocchios(name: str) -> None:
    r = robot(name)
    q = r.random(3)
    at, data, frame = r.configuration(r.position(q)), r.model.createData(), r.model.frames[r.model.nframes - 1].name
    pin.computeJointJacobians(r.model, data, at)
    pin.updateFramePlacements(r.model, data)
    wanted = pin.getFrameJacobian(r.model, data, r.model.getFrameId(frame), pin.LOCAL_WORLD_ALIGNED)
    np.testing.assert_allclose(r.jacobian(frame, q, reduced=False), wanted, atol=1e-12)


@pytest.mark.parametrize("name", ROBOTS)
def test_q_is_the_pose_and_the_arm(name: str) -> None:
    r = robot(name)
    q = r.random(0)
    assert q.size == len(r.q_names) == r.dimensions.pose + r.dimensions.arm
    position = dict(zip(r.position_names, r.position(q), strict=True))
    assert [position[label] for label in r.q_names] == q.tolist()
    np.testing.assert_array_equal(r.position(r.neutral()), r.neutral_position())
    np.testing.assert_array_equal(r.random(7), r.random(np.random.default_rng(7)))


@settings(max_examples=20, deadline=None)
@given(seed=seeds)
def test_a_random_q_is_within_the_limits(seed: int) -> None:
    r = robot("tiago")
    q, arm = r.random(seed)[3:], r.arm_index
    assert (r.lower[arm] <= q).all() and (q <= r.upper[arm]).all()


@pytest.mark.parametrize("wrong", [[1.0, 2.0], np.zeros((5, 1)), 3.0, "q", [0, 0, 0, 0, np.nan], None])
def test_another_length_is_refused_with_what_was_expected(wrong: object) -> None:
    r = robot("platform_arm")
    for ask in (r.mass_matrix, r.gravity, lambda q: r.coriolis(q, np.zeros(4)), lambda q: r.jacobian("arm_tip", q)):
        with pytest.raises(ConfigError, match="give x, y, phi, arm_1_joint, arm_2_joint") as refused:
            ask(wrong)  # type: ignore[arg-type]
        assert refused.value.key == "q"
    with pytest.raises(ConfigError, match="give v, w, arm_1_joint, arm_2_joint") as refused:
        r.psi(r.neutral(), wrong, np.zeros(4), np.zeros(4))  # type: ignore[arg-type]
    assert refused.value.key == "nu"


def test_a_frame_that_is_not_there_is_named() -> None:
    with pytest.raises(UnknownName, match="did you mean 'arm_tip'"):
        robot("platform_arm").jacobian("arm_tp", robot("platform_arm").neutral())
    r = robot("tiago")
    with pytest.raises(UnknownName, match=r"root_joint, .* and \d+ more$") as refused:
        r.jacobian("nothing like it", r.neutral())
    assert len(refused.value.available) > 100 and str(refused.value).count(",") < 60


def test_a_robot_shows_itself_in_a_line_and_escapes_what_a_file_says(tmp_path: Path) -> None:
    r = robot("tiago")
    assert len(repr(r)) < 100 and "tiago" in repr(r) and "differential drive" in repr(r)
    text = bundled()["two_axis_arm"].read_text().replace("arm_1_joint", "&lt;script&gt;")
    (tmp_path / "hostile.urdf").write_text(text)
    shown = load(tmp_path / "hostile.urdf")._repr_html_()
    assert "<script>" not in shown and "<td>&lt;script&gt;</td>" in shown
