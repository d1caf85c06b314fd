"""Skid-steer bases: the virtual axle, what turning takes, where they turn about, and that they really slip."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from drives import ARM, CYLINDER, LYING_CYLINDER, joint, link, moving, random_state, robot_of
from hypothesis import given, settings
from hypothesis import strategies as st
from test_base import four
from test_base import wheel as wheel_at
from test_wild import codes

from mmnn_pin.errors import ConfigError
from mmnn_pin.model.base.base import Wheel
from mmnn_pin.model.base.report import Undecided
from mmnn_pin.model.base.skid_steer import GRAVITY, loads, rotation_centre, turning_friction, turning_track
from mmnn_pin.model.checks.properties import check
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.model.regressor import Regressor
from mmnn_pin.model.tree.body import parameters
from mmnn_pin.plant.contact.plant import ContactPlant
from mmnn_pin.torque.adaptive import Adaptive
from mmnn_pin.torque.controller import Feedback
from mmnn_pin.torque.prior import scales

RADIUS = 0.15


def rover(rows=(0.25, -0.25), y: float = 0.3, mass: float = 40.0, ahead: float = 0.0, more: str = ARM) -> str:
    """Wheels of 0.15 m in two columns, at these x; its weight lies so far ahead of their middle."""
    box = '<box size="0.5 0.3 0.1"/>'
    text = link("base", mass, 2.0, box, f'<origin xyz="{ahead} 0 0.25"/>').replace(
        "<inertial>", f'<inertial><origin xyz="{ahead} 0 0.25"/>', 1
    )
    for i, x in enumerate(rows):
        for side, sign in (("l", 1), ("r", -1)):
            name = f"{side}{i}"
            text += link(f"{name}_link", 1.0, 0.01, CYLINDER.format(r=RADIUS), LYING_CYLINDER)
            text += joint(name, "continuous", "base", f"{name}_link", p=(x, sign * y, RADIUS))
    return f'<robot name="rover">{text}{more}</robot>'


wheelbases = st.floats(0.1, 0.6)
widths = st.floats(0.1, 0.6)


@pytest.mark.parametrize("rows", [(0.25, -0.25), (0.4, 0.0, -0.4), (0.3, -0.1)])
def test_the_middle_does_not_slip_sideways_and_the_sides_turn_alike(rows):
    robot = robot_of(rover(rows), base="skid_steer", track=0.9)
    assert robot.velocity_names[:2] == ("v", "w") and robot.base.track == 0.9
    assert robot.base.frame == pytest.approx([np.mean(rows), 0, 0])
    assert np.abs(robot.A @ robot.T).max() < 1e-12 and np.linalg.matrix_rank(robot.A) == len(robot.A)
    assert len(robot.A) == robot.dimensions.full - robot.dimensions.dof
    position, _ = random_state(robot)
    v, w = 0.7, -0.4
    nu = np.zeros(robot.dimensions.dof)
    nu[:2] = v, w
    rates = dict(zip(robot.full_velocity_names, robot.T @ nu, strict=True))
    for wheel in robot.base.wheels:  # a side rolls as if it were at half the effective track
        assert rates[wheel.joint] * RADIUS == pytest.approx(v - math.copysign(0.45, wheel.y) * w)
    data = moving(robot, position, nu)
    spin = data.oMi[1].rotation @ data.v[1].angular
    middle = data.oMi[1].act(np.array([np.mean(rows), 0.0, 0.0]))
    speed = data.oMi[1].rotation @ data.v[1].linear + np.cross(spin, middle - data.oMi[1].translation)
    assert data.oMi[1].rotation.T @ speed == pytest.approx([v, 0, 0], abs=1e-12)


@given(wheelbases, widths, st.floats(0.5, 2.0), st.floats(0.1, 1.5), st.floats(-0.08, 0.08))
@settings(max_examples=25, deadline=None)
def test_turning_friction_is_the_power_of_what_slides(length, width, wider, mu, ahead):
    track = 2 * width * wider
    robot = robot_of(
        rover((length / 2, -length / 2), width, ahead=ahead, more=""), base="skid_steer", track=track, mu=mu
    )
    w, mass, power = 0.5, 44.0, 0.0
    front = mass * GRAVITY / 2 * (1 + 40 / 44 * ahead / (length / 2))  # two axles: by the lever
    for x, load in ((length / 2, front), (-length / 2, mass * GRAVITY - front)):
        sliding = np.hypot(x * w, (track / 2 - width) * w)  # of the contact point, sideways and along
        power += mu * max(load, 0.0) * sliding
    assert Dynamics(robot).friction(np.array([0.0, w]))[1] * w == pytest.approx(power, rel=1e-6)
    assert Dynamics(robot).friction(np.array([0.3, 0.0])) == pytest.approx([0, 0])


@given(st.just(2), st.floats(0.1, 0.5), st.floats(0.1, 0.5), st.floats(-0.2, 0.2), st.floats(-0.1, 0.1))
@settings(max_examples=60, deadline=None)
def test_loads_hold_the_weight_and_side_forces_cancel_at_the_centre_of_rotation(rows, length, width, ahead, aside):
    places = np.linspace(-length, length, rows)
    wheels = [Wheel(f"{x}{y}", RADIUS, 1.0, y=y, x=float(x)) for x in places for y in (width, -width)]
    centre = np.array([ahead * length, aside * width])
    load = loads(wheels, 30.0, centre)
    assert (load > 0).all()
    assert load.sum() == pytest.approx(30 * GRAVITY)
    assert load @ [w.x for w in wheels] == pytest.approx(30 * GRAVITY * centre[0], abs=1e-9)
    assert load @ [w.y for w in wheels] == pytest.approx(30 * GRAVITY * centre[1], abs=1e-9)
    at = rotation_centre(wheels, load)
    across = np.array([w.x - at for w in wheels])
    along = np.array([w.x**2 / width for w in wheels])
    assert load @ (across / np.hypot(across, along + 1e-9)) == pytest.approx(0, abs=1e-5 * load.sum())
    assert abs(at) <= length
    assert abs(centre[0]) < 1e-6 or (at > 0) == (centre[0] > 0)
    assert turning_friction(wheels, 2 * width, load, 0.7) == pytest.approx(
        0.7 * load @ np.abs([w.x for w in wheels])
    )  # no wheel slides along itself


def steady_turn(robot) -> tuple[float, float]:
    """Torque on w that holds a turn on the spot on the contact plant, and the effective track that the wheels show."""
    plant = ContactPlant(robot, 0.002)
    plant.start(robot.neutral_position(), np.zeros(robot.dimensions.dof))
    right = next(w for w in robot.base.wheels if w.y < 0)
    at, tau, torques, tracks = robot.full_velocity_names.index(right.joint), np.zeros(2), [], []
    for k in range(2500):
        rim = right.sign * right.radius * plant.velocity[at]
        tau[1] = robot.base.turning + 400 * (0.4 - 2 * rim / robot.base.track)  # at the limit any yaw rate would do
        plant.step(tau)
        if k > 1500:
            torques.append(tau[1])
            tracks.append(2 * rim / plant.nu[1])
    assert plant.nu[1] > 0.3 and plant.findings()
    return float(np.mean(torques)), float(np.mean(tracks))


def test_it_slips_on_the_contact_plant_as_the_closed_form_says():
    pytest.importorskip("mujoco")
    heavy = {f'{axis}="0.01"': f'{axis}="1.0"' for axis in ("ixx", "iyy", "izz")}  # wheels that do not chatter
    text = rover((0.2, -0.2), 0.3, more="")
    for light, weight in heavy.items():
        text = text.replace(light, weight)
    track = turning_track(robot_of(text, base="skid_steer").base.wheels)
    assert track == pytest.approx(2 * (0.3 + 0.2**2 / 0.3))
    robot = robot_of(text, base="skid_steer", track=track, mu=1.0)
    torque, seen = steady_turn(robot)
    assert torque == pytest.approx(robot.base.turning, rel=0.02)
    assert seen == pytest.approx(track, rel=0.1)
    plant = ContactPlant(robot, 0.002)
    plant.start(robot.neutral_position(), np.zeros(2))
    for _ in range(100):
        plant.step(np.array([0.0, 0.95 * robot.base.turning]))
    assert abs(plant.nu[1]) < 1e-4  # below what the sliding takes it stands


def test_the_wheels_of_a_side_turn_alike_on_the_contact_plant_however_they_are_loaded():
    pytest.importorskip("mujoco")
    text = rover((0.25, -0.25), ahead=0.15, more="")
    text = re.sub(r'(<joint name="l1".*?<axis xyz=")[^"]*', r"\g<1>0 -1 0", text)  # turns the other way round
    robot = robot_of(text, base="skid_steer", track=0.9, mu=1.0)
    signs = [wheel.sign for wheel in robot.base.wheels]
    assert sorted(signs) == [-1, 1, 1, 1]
    plant = ContactPlant(robot, 0.002)
    plant.start(robot.neutral_position(), np.zeros(2))
    for _ in range(300):
        plant.step(np.array([20.0, 1.3 * robot.base.turning]))
    rates = dict(zip(robot.full_velocity_names, plant.velocity, strict=True))
    rims = {w.joint: w.sign * w.radius * rates[w.joint] for w in robot.base.wheels}
    assert max(map(abs, rims.values())) > 0.1 and max(plant.traction) > 0.99  # it slides
    for side in "lr":
        assert rims[f"{side}0"] == pytest.approx(rims[f"{side}1"], rel=1e-3)


def test_what_is_told_of_it():
    robot = robot_of(rover(ahead=0.05), base="skid_steer")
    told = [f for f in robot.findings if f.code == "base-skid"]
    assert "taken as the geometric one" in told[0].message and "0.6 m" in told[0].message
    assert f"{turning_track(robot.base.wheels):.3g} m" in told[0].why and "--track" in told[0].fix
    assert "ahead of its middle" in told[1].message and "sideways" in told[1].why
    robot = robot_of(rover(more=""), base="skid_steer", track=0.8, mu=0.5)
    [told] = [f for f in robot.findings if f.code == "base-skid"]
    assert "taken as" not in told.message and "mu 0.5" in told.message
    assert robot.base.turning == pytest.approx(0.5 * 44 * GRAVITY * math.hypot(0.25, 0.1))


def test_widths_of_wheels_that_stand_on_several_are_told():
    text = rover(more="")
    robot = robot_of(re.sub(r'(<joint name="[lr]0".*?xyz="[^ ]+ )(-?)0\.3', r"\g<1>\g<2>0.25", text), base="skid_steer")
    assert robot.base.track == pytest.approx(0.55)
    assert "from 0.5 m to 0.6 m" in codes(robot)["base-joints"]
    assert "base-joints" not in codes(robot_of(text, base="skid_steer"))


def test_the_properties_hold():
    assert check(robot_of(rover((0.3, 0.0, -0.3)), base="skid_steer", track=0.7), samples=5).passed


@pytest.mark.parametrize(("rows", "said", "words"), [
    ((0.3,), {"base": "skid_steer", "wheels": ("l0", "r0")}, "2 wheel"),
    ((0.3, 0.1), {"base": "skid_steer", "wheels": ("l0", "r0", "l1")}, "3 wheel"),
    ((0.3, 0.1), {"base": "holonomic", "mu": 0.5}, "a mu for a base 'holonomic'"),
    ((0.3, 0.1), {"base": "skid_steer", "mu": 0.0}, "cannot be a friction coefficient"),
])  # fmt: skip
def test_what_does_not_suit_it_is_refused(rows, said, words):
    with pytest.raises(ConfigError, match=words):
        robot_of(rover(rows), **said)


def test_a_front_pair_gets_a_warning_and_the_better_command():
    robot = robot_of(rover(), wheels=("l0", "r0"))
    told = next(f for f in robot.findings if f.code == "base-pair")
    assert "l1, r1" in told.message and told.fix == "--base skid_steer without --wheels"
    assert robot_of(rover(), base="skid_steer").base.kind == "skid_steer"


def test_more_wheels_than_three_per_side_are_tracks():
    assert robot_of(rover((0.4, 0.2, -0.2, -0.4))).base.kind == "tracked"
    assert robot_of(rover((0.4, 0.2, -0.2, -0.4)), base="holonomic").base.pushes  # belts have no rollers
    with pytest.raises(Undecided, match="--base tracked if belts run over them"):
        robot_of(rover().replace("l0_link", "track_left_link"))


def test_a_name_that_steers_is_never_a_skid_steer_by_guess():
    with pytest.raises(Undecided, match="'ackermann' among its names: does it steer"):
        robot_of(rover().replace('name="rover"', 'name="ackermann"'))
    robot = robot_of(rover().replace('name="rover"', 'name="skid_steer"'))
    told = next(f for f in robot.findings if f.code == "base-evidence")
    assert robot.base.kind == "skid_steer" and "the robot is called 'skid'" in told.message
    assert robot_of(rover(), base="holonomic").base.kind == "holonomic"  # as it says
    assert "the robot is called 'rover'" in str(robot_of(rover()).findings)


def test_its_turning_friction_is_a_linear_parameter():
    robot = robot_of(rover(ahead=0.05), base="skid_steer", track=0.8, mu=0.7)
    regressor, theta, dynamics = Regressor.of(robot), parameters(robot), Dynamics(robot)
    assert regressor.labels[-1] == "w.coulomb" and theta[-1] == robot.base.turning and regressor.size == theta.size
    rng = np.random.default_rng(1)
    for _ in range(5):
        position, _ = random_state(robot, int(rng.integers(99)))
        nu, nu_ref, nudot_ref = rng.standard_normal((3, robot.dimensions.dof))
        psi = dynamics.mass_matrix(position) @ nudot_ref + dynamics.coriolis_matrix(position, nu) @ nu_ref
        psi = psi + dynamics.gravity(position) + dynamics.friction(nu)
        np.testing.assert_allclose(regressor.matrix(position, nu, nu_ref, nudot_ref) @ theta, psi, atol=1e-9)
    K = np.arange(1.0, 1.0 + robot.dimensions.dof)
    felt = scales(regressor, K)
    assert felt.size == regressor.size - regressor.inertial and felt[-1] == K[1]  # the gain of the yaw rate
    assert sum(Adaptive(regressor=regressor, feedback=Feedback(1.0, 1.0)).counts()) == felt.size
    plain = Regressor.of(robot_of(rover(), base="holonomic"))
    assert "w.coulomb" not in plain.labels


def test_a_wheel_in_the_middle_is_on_no_side():
    drums = "".join(wheel_at(name, (x, 0.0, 0.1)) for name, x in (("front", 0.5), ("rear", -0.5)))
    with pytest.raises(
        ConfigError, match=r"on the left fl, rl; on the right fr, rr; in the middle front, rear"
    ) as error:
        robot_of(four(more=drums), base="skid_steer")
    (names,) = re.findall(r"--wheels (\S+) where these drive", error.value.fix)
    assert robot_of(four(more=drums), base="skid_steer", wheels=tuple(names.split(","))).base.kind == "skid_steer"
    assert turning_track((Wheel("front", 0.1, 1.0, y=0.0, x=0.5),)) == math.inf
    away = four(more=drums).replace('"0.5 0.0 0.1"', '"0.5 1e-17 0.1"').replace('"-0.5 0.0 0.1"', '"-0.5 -1e-17 0.1"')
    with pytest.raises(ConfigError, match="in the middle front, rear"):  # by rounding alone they are on either side
        robot_of(away, base="skid_steer")
