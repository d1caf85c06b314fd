"""The contact plant: MuJoCo's tree against Pinocchio's free-flyer, rolling against the ideal plant, and slipping."""

from __future__ import annotations

import json
import os
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
import pytest
from builders import THESIS
from drives import ARM, LIMIT, SPHERE, Drive, joint, link, origin, robot_of
from numba import config

from mmnn_pin.cli import main
from mmnn_pin.errors import ConfigError, RobotError, UnknownName
from mmnn_pin.lab.experiments.config import load_experiment
from mmnn_pin.lab.experiments.runner import run_experiment
from mmnn_pin.loop.before_run import Start
from mmnn_pin.loop.loop import Loop
from mmnn_pin.model import Robot, load
from mmnn_pin.model.base.holonomic import HolonomicBase
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.model.reduction import COULOMB_SPEED
from mmnn_pin.plant.contact.feet import Contact, Patch, feet_of
from mmnn_pin.plant.ideal import IdealPlant
from mmnn_pin.reference import Hold, Line, Sine, Trajectory
from mmnn_pin.settings import Timing
from mmnn_pin.torque.model_based import PD

mujoco = pytest.importorskip("mujoco")
from mmnn_pin.plant.contact.plant import ContactPlant  # noqa: E402

DATA = os.environ.get("EXAMPLE_ROBOT_DATA")
with_tiago = pytest.mark.skipif(DATA is None, reason="EXAMPLE_ROBOT_DATA is not set")
ROBOTS = ["platform_arm", pytest.param("tiago_no_hand", marks=with_tiago)]
PLAIN = bool(config.DISABLE_JIT)  # compiled code runs as plain Python: shorter horizons
DT = 0.001  # [s]
VISCOUS = (30.0, 5.0, 0.5, 0.7)
SKID = link("skid", 0, 0, SPHERE.format(r=0.02), origin(p=(0, 0, 0)))
REAR = SKID + joint("weld", "fixed", "base", "skid", p=(-0.2, 0, 0.02))
TROLLEY = Drive().urdf(ARM + REAR + (REAR.replace("skid", "bow").replace("weld", "stem").replace("-0.2", "0.4")))


def robot(name: str) -> Robot:
    if name == "platform_arm":
        return load(name).with_friction(VISCOUS)
    return load(name, lock=["torso_lift_joint"])


def bent(robot: Robot) -> np.ndarray:
    """A position off the origin with the arm bent, within its limits."""
    position, arm = robot.neutral_position(), robot.arm_index
    position[:3] = 0.3, -0.2, 0.5
    position[arm] = np.clip(0.3, robot.lower[arm] + 0.1, robot.upper[arm] - 0.1)
    return position


# -- the free tree ----------------------------------------------------------------------------------------------------


def free_flyer(robot: Robot) -> pin.Model:
    """Pinocchio's own model of the file on a free-flyer, with the locked joints taken out."""
    model = pin.buildModelFromXML(robot.urdf, pin.JointModelFreeFlyer())
    q = pin.neutral(model)
    for name, angle in robot.arm.locked.items():
        j = model.getJointId(name)
        q[model.idx_qs[j] : model.idx_qs[j] + model.nqs[j]] = (
            angle if model.nqs[j] == 1 else (np.cos(angle), np.sin(angle))
        )
    return pin.buildReducedModel(model, [model.getJointId(name) for name in robot.arm.locked], q)


def in_mujoco(plant: ContactPlant, model: pin.Model, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """M and bias force of MuJoCo's tree, in Pinocchio's coordinates: `v_mj = X v`, `X' (bias + M X [R (w x v); 0])`."""
    R = pin.Quaternion(q[6], q[3], q[4], q[5]).matrix()
    X, data = np.zeros((model.nv, model.nv)), plant.data
    X[:3, :3], X[3:6, 3:6] = R, np.eye(3)
    data.qpos[:7] = q[[0, 1, 2, 6, 3, 4, 5]]
    for j in range(2, model.njoints):
        its, at = plant.model.joint(model.names[j]), model.idx_qs[j]
        data.qpos[its.qposadr[0]] = q[at] if model.nqs[j] == 1 else np.arctan2(q[at + 1], q[at])
        X[its.dofadr[0], model.idx_vs[j]] = 1.0
    data.qvel[:] = X @ v
    mujoco.mj_forward(plant.model, data)
    M = np.zeros((model.nv, model.nv))
    unit = np.eye(model.nv)
    for i in range(model.nv):
        mujoco.mj_mulM(plant.model, data, M[i], unit[i])
    turning = np.concatenate((R @ np.cross(v[3:6], v[:3]), np.zeros(model.nv - 3)))
    return X.T @ M @ X, X.T @ (data.qfrc_bias + M @ turning)


TREES = [*ROBOTS, pytest.param("tiago", marks=with_tiago), "trolley", "heavy", "gripper"]


def any_robot(name: str) -> Robot:
    if name == "heavy":
        return load("platform_arm").with_masses({"root": 1.5, "arm_2_joint": 0.3})
    return {"trolley": robot_of(TROLLEY), "gripper": gripper()}.get(name) or robot(name)


@pytest.mark.parametrize("name", TREES)
def test_the_free_tree_is_pinocchios_free_flyer(name: str) -> None:
    this = any_robot(name)
    plant, model = ContactPlant(this, DT), free_flyer(this)
    if name == "heavy":
        for j in (1, model.getJointId("arm_2_joint")):
            factor, body = (1.5 if j == 1 else 0.3), model.inertias[j]
            model.inertias[j] = pin.Inertia(body.mass * factor, body.lever, body.inertia * factor)
    data, rng = model.createData(), np.random.default_rng(0)
    assert plant.model.nv == model.nv
    for _ in range(20):
        q = pin.randomConfiguration(model, np.full(model.nq, -2.0), np.full(model.nq, 2.0))
        v = 2 * rng.standard_normal(model.nv)
        M = np.array(pin.crba(model, data, q))
        M = np.triu(M) + np.triu(M, 1).T
        bias = pin.nonLinearEffects(model, data, q, v)
        ours, our_bias = in_mujoco(plant, model, q, v)
        np.testing.assert_allclose(ours, M, rtol=0, atol=1e-9 * np.abs(M).max())
        np.testing.assert_allclose(our_bias, bias, rtol=0, atol=1e-9 * np.abs(bias).max())


# -- rolling: the ideal plant is the second answer ---------------------------------------------------------------------


def response(plant: IdealPlant | ContactPlant, start: np.ndarray, hold: np.ndarray, M: np.ndarray) -> np.ndarray:
    """Mass matrix that answers to small torques over 20 ms, besides those that hold the robot, (p, p)."""
    p, steps = len(hold), 20

    def kicked(torque: np.ndarray) -> np.ndarray:
        plant.start(start, np.zeros(p))
        for _ in range(steps):
            plant.step(hold + torque)
            plant.refresh()
        return plant.nu.copy()

    columns = []
    for i, kick in enumerate(np.diag(0.01 * np.diag(M))):
        columns.append((kicked(kick) - kicked(-kick)) / (2 * kick[i] * steps * DT))
    return np.linalg.inv(np.array(columns).T)


@pytest.mark.parametrize("name", ROBOTS)
def test_effective_mass_matrix(name: str) -> None:
    this = replace(robot(name), damping=np.zeros(0), coulomb=np.zeros(0))
    still = np.zeros(this.dimensions.full)
    this = replace(this, damping=still, coulomb=still, viscous=np.zeros(this.dimensions.dof))
    ideal = IdealPlant(this, DT)
    M, hold = Dynamics(this).mass_matrix(bent(this)), Dynamics(this).gravity(bent(this))
    contact = ContactPlant(this, DT, "rk4")
    ours, expected = (response(plant, bent(this), hold, M) for plant in (contact, ideal))
    size = np.sqrt(np.diag(M))
    assert np.abs((ours - expected) / np.outer(size, size)).max() < 1e-4
    assert np.abs(expected / np.outer(size, size)).max() > 0.9 and contact.traction.max() < 1


@dataclass
class OpenLoop:
    """The same torques on both plants: their states, and the largest slip and traction of the contact plant."""

    positions: tuple[np.ndarray, np.ndarray]
    nus: tuple[np.ndarray, np.ndarray]
    slip: float
    traction: float
    contact: ContactPlant

    @property
    def pose(self) -> np.ndarray:
        """(3,) difference of the pose at the end."""
        return (self.positions[1] - self.positions[0])[-1, :3]

    @property
    def speed(self) -> np.ndarray:
        """(2,) RMS difference of the base velocities."""
        return np.sqrt(np.mean((self.nus[1] - self.nus[0])[:, :2] ** 2, axis=0))


def torques(this: Robot, ideal: IdealPlant, duration: float) -> Iterator[np.ndarray]:
    """Drives and turns the base, swings the arm against its gravity on the ideal plant."""
    p, heavy, dynamics = this.dimensions.dof, this.name == "platform_arm", Dynamics(this)
    for k in range(round(duration / DT)):
        t, tau = k * DT, np.zeros(p)
        tau[:2] = (
            (30 + 60 * np.sin(1.3 * t), 8 * np.cos(2 * t)) if heavy else (6 + 14 * np.sin(1.3 * t), 3 * np.cos(2 * t))
        )
        tau[2:] = np.array([4 * np.sin(3 * t), 2 * np.cos(4 * t)]) if heavy else 1.2 * np.sin(2 * t + np.arange(p - 2))
        yield tau + dynamics.gravity(ideal.position)


def open_loop(this: Robot, duration: float, step: float, method: str) -> OpenLoop:
    ideal = IdealPlant(this, DT, "rk4" if this.name == "platform_arm" else "implicit_friction")
    contact = ContactPlant(this, DT, method, Contact(step=step))
    states: list[tuple[np.ndarray, ...]] = []
    slip = 0.0
    for plant in (ideal, contact):
        plant.start(bent(this), np.zeros(this.dimensions.dof))
    for tau in torques(this, ideal, duration):
        for plant in (ideal, contact):
            plant.step(tau)
        ideal.refresh()
        states.append(tuple(a.copy() for plant in (ideal, contact) for a in (plant.position, plant.nu)))
        slip = max(slip, contact.speed.max())
    a, nu_a, b, nu_b = (np.array(column) for column in zip(*states, strict=True))
    return OpenLoop((a, b), (nu_a, nu_b), slip, float(contact.traction.max()), contact)


@pytest.mark.parametrize("name", ROBOTS)
def test_open_loop_stays_with_the_ideal_plant(name: str) -> None:
    run = open_loop(robot(name), 1.0 if PLAIN else 5.0, 0.0005, "implicit_friction")
    assert run.traction < 1 and run.contact.findings() == []
    assert np.hypot(*run.pose[:2]) < 2e-3 and abs(run.pose[2]) < 2e-3
    assert run.speed[0] < 0.5e-3 and run.speed[1] < 1e-3
    travel = np.linalg.norm(np.diff(run.positions[0][:, :2], axis=0), axis=1).sum()
    assert travel > (0.05 if PLAIN else 1.5)  # so that 2 mm are little
    if not PLAIN:
        assert np.abs(run.positions[0][-1] - run.positions[0][0])[robot(name).arm_index].max() > 0.3


def test_a_control_frame_off_the_root_and_wheels_that_turn_backward() -> None:
    feet = "".join(
        link(name, 0, 0, SPHERE.format(r=0.02)) + joint(f"{name}_weld", "fixed", "base", name, p=(x, y, -0.28))
        for name, x, y in (("bow", 0.5, 0.3), ("stern", -0.3, -0.2), ("port", -0.2, 0.4), ("starboard", 0.4, -0.4))
    )
    drive = Drive(frame=(0.1, 0.05, 0.7), floor=-0.3, flips=(1, -1), inset=0.02)
    this = robot_of(drive.urdf(ARM + feet)).with_friction((8.0, 2.0, 0.3, 0.3))
    plants = IdealPlant(this, DT), ContactPlant(this, DT, "rk4")
    for plant in plants:
        plant.start(bent(this), np.array([0.3, 0.8, 0.5, -0.5]))
        for k in range(200 if PLAIN else 1000):
            plant.step(np.array([3.0, 2.5 * np.cos(0.002 * k), 0.1, 0.0]))
            plant.refresh()
    assert np.ptp(plants[0].position[:2]) > 0.1 and plants[1].findings() == []
    np.testing.assert_allclose(plants[1].position, plants[0].position, atol=2e-3)
    np.testing.assert_allclose(plants[1].nu, plants[0].nu, atol=2e-3)


def test_the_error_halves_with_the_step() -> None:
    steps = (0.001, 0.0005, 0.00025)
    duration = 0.3 if PLAIN else 1.0
    poses = [open_loop(robot("platform_arm"), duration, step, "semi_implicit_euler").pose for step in steps]
    errors = [np.hypot(*pose[:2]) for pose in poses]
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.1)
    assert errors[1] / errors[2] == pytest.approx(2.0, rel=0.1)


@pytest.mark.parametrize("method", ["rk4", "semi_implicit_euler"])
def test_wheels_of_a_turning_base_do_not_creep_sideways(method: str) -> None:
    """MuJoCo alone leaves `Jdot v` out of what it asks of a contact: they creep by speed times yaw rate times step."""
    this = robot("platform_arm")
    plant = ContactPlant(this, DT, method, Contact(step=DT))
    plant.start(bent(this), np.array([0.8, 1.0, 0.0, 0.0]))
    for _ in range(50):
        plant.step(np.array([30.0 * 0.8, 5.0, 0.0, 0.0]))  # about what keeps it going
    v, w = plant.nu[:2]
    assert v * w > 0.4
    assert np.abs(plant.across @ plant.velocity).max() < 0.02 * DT * v * w


@pytest.mark.parametrize("radii", [1.0, 1.03, {"wheel_left_joint": 0.95, "wheel_right_joint": 1.04}])
def test_rolling_is_that_of_the_ideal_plant_to_second_order(radii: float | dict[str, float]) -> None:
    """Both by RK4 on the same torques; where wheels creep they are 0.6 mm apart."""
    this = robot("platform_arm").with_radii(radii)
    plants = IdealPlant(this, DT), ContactPlant(this, DT, "rk4", Contact(step=DT))
    for plant in plants:
        plant.start(bent(this), np.array([0.8, 1.0, 0.5, -0.5]))
        for k in range(100 if PLAIN else 1000):
            plant.step(np.array([20.0, 4.0 * np.cos(0.003 * k), 0.1, 0.0]))
            plant.refresh()
    apart = np.abs(plants[1].position - plants[0].position)
    assert apart[:3].max() < 2e-6 and apart.max() < 5e-5


@pytest.mark.parametrize("controller", ["two_layer", "pd"])
def test_closed_loop_on_the_thesis_robot(controller: str) -> None:
    settings = [f"time.duration={0.05 if PLAIN else 5.0}", f"controllers=['{controller}']"]
    runs = [
        run_experiment(load_experiment("chapter4", [*settings, f"plant='{plant}'"]), "x").recordings[controller]
        for plant in ("ideal", "contact")
    ]
    assert [run.outcome.status for run in runs] == ["completed", "completed"]
    apart = runs[1]["position"][:, :2] - runs[0]["position"][:, :2]
    assert np.linalg.norm(apart, axis=1).max() < 0.2e-3
    assert np.ptp(runs[0]["position"][:, 0]) > (0.001 if PLAIN else 1.4)


@with_tiago
def test_closed_loop_on_tiago() -> None:
    settings = ["robot='tiago_no_hand'", f"time.duration={0.02 if PLAIN else 2.0}", "controllers=['pd']"]
    runs = [
        run_experiment(load_experiment("track", [*settings, f"plant='{plant}'"]), "x").recordings["pd"]
        for plant in ("ideal", "contact")
    ]
    apart = runs[1]["position"][:, :2] - runs[0]["position"][:, :2]
    assert np.linalg.norm(apart, axis=1).max() < 0.2e-3
    assert runs[1]["traction"].max() < 1


def test_a_fixed_arm_is_the_ideal_one() -> None:
    this = load("two_axis_arm")
    this = replace(this, damping=np.array([0.1, 0.2]), coulomb=np.array([0.05, 0.03]))
    plants = IdealPlant(this, DT), ContactPlant(this, DT, "rk4", Contact(step=0.0001))
    for plant in plants:
        plant.start(np.array([0.3, -0.4]), np.array([2.0, -1.0]))
        for _ in range(50 if PLAIN else 500):
            plant.step(np.array([0.2, -0.1]))
            plant.refresh()
    np.testing.assert_allclose(plants[1].position, plants[0].position, atol=1e-4)
    np.testing.assert_allclose(plants[1].nu, plants[0].nu, atol=3e-4)
    assert plants[1].y[-1] == pytest.approx(plants[0].y[-1], abs=1e-4)
    assert plants[1].findings() == []


def coasting(this: Robot, method: str, plant: type = ContactPlant) -> np.ndarray:
    """Where a robot that is let go comes to, position and nu."""
    its = plant(this, DT, method)
    its.start(bent(this), np.array([0.6, -0.4, 1.0, -0.8]))
    for _ in range(30 if PLAIN else 300):
        its.step(np.zeros(4))
        its.refresh()
    return np.concatenate((its.position, its.nu))


@pytest.mark.parametrize("where", ["viscous", "damping", "coulomb"])
@pytest.mark.parametrize("method", ["rk4", "implicit_friction"])
def test_friction_brakes_as_on_the_ideal_plant(where: str, method: str) -> None:
    this = load("platform_arm")
    size = {"viscous": np.array([40.0, 3.0, 0.4, 0.3]), "damping": np.full(7, 0.2), "coulomb": np.full(7, 0.15)}[where]
    size[:3] *= where == "viscous"
    braked = replace(this, **{where: size})
    free, expected = coasting(this, method), coasting(braked, "rk4", IdealPlant)
    effect = np.abs(free - expected).max()
    np.testing.assert_allclose(coasting(braked, method), expected, rtol=0, atol=0.01 * effect)
    assert effect > (0.01 if PLAIN else 0.1)


# -- slipping ----------------------------------------------------------------------------------------------------------


def rolling(contact: Contact, torque: float, seconds: float = 0.3) -> ContactPlant:
    """The thesis robot, pushed forward by its wheels from rest."""
    plant = ContactPlant(load("platform_arm"), DT, "implicit_friction", contact)
    plant.start(plant.robot.neutral_position(), np.zeros(4))
    for _ in range(round(seconds / DT)):
        plant.step(np.array([torque, 0.0, 0.0, 0.0]))
    return plant


def wheel_load(plant: ContactPlant) -> float:
    """What both wheels carry in the last step [N]."""
    force, total = np.zeros(6), 0.0
    for i in range(plant.data.ncon):
        mujoco.mj_contactForce(plant.model, plant.data, i, force)
        total += force[0] * (int(plant.data.contact[i].geom2) in plant.wheel_of)
    return total


def test_traction_use_is_the_part_of_the_friction_cone() -> None:
    plants = [rolling(Contact(friction=mu, casters="soft"), 40.0) for mu in (0.8, 0.4)]
    assert plants[1].traction == pytest.approx(2 * plants[0].traction, rel=1e-3)
    ft = 0.4 * wheel_load(plants[1]) * plants[1].traction[0]  # both wheels alike
    spin = plants[1].velocity[plants[1].robot.full_velocity_names.index("wheel_left_joint")] * 0.075
    mass, inertia = 112.0, 0.010 / 0.075**2  # of all; of a wheel, at its rim
    assert plants[1].nu[0] == pytest.approx(spin, abs=1e-4)
    assert plants[1].nu[0] / 0.3 == pytest.approx(ft / mass, rel=0.02)
    assert plants[1].nu[0] / 0.3 == pytest.approx(40.0 / (mass + 2 * inertia), rel=0.02)


def test_on_ice_the_wheels_slide_and_push_with_mu_n() -> None:
    mu, seconds = 0.05, 0.6
    load_at_rest = wheel_load(rolling(Contact(friction=mu, casters="soft"), 0.0))
    plant = rolling(Contact(friction=mu, casters="soft"), 60.0, seconds)
    assert plant.traction.max() <= 1 + 1e-6 and plant.traction.min() > 0.999
    assert 112 * plant.nu[0] / seconds == pytest.approx(mu * load_at_rest, rel=0.06)
    assert plant.speed.min() > 0.5 and plant.residual[0] == pytest.approx(np.linalg.norm(plant.speed), rel=1e-2)
    (told,) = plant.findings()
    duration, first, fastest = (float(word) for word in re.findall(r"([\d.]+) (?:s\b|m/s)", told))
    assert duration == pytest.approx(seconds, abs=0.01) and first < 0.01 and fastest >= round(plant.speed.max(), 2)


def test_casters_decide_what_the_wheels_carry() -> None:
    share = {kind: wheel_load(rolling(Contact(casters=kind), 0.0)) / (112 * 9.81) for kind in ("rigid", "soft")}
    assert 0.3 < share["rigid"] < 0.5 < 0.8 < share["soft"] < 1.0


def test_a_patch_is_slippery_where_it_is() -> None:
    patch = Patch(0.001, x=(-1.0, 1.0), y=(0.0, 1.0))  # under the left wheel
    plant = rolling(Contact(patches=(patch,)), 60.0, 0.1)
    assert plant.speed[0] > 0.5 > 0.05 > plant.speed[1] and plant.nu[1] > 0
    plant = rolling(Contact(friction=0.001, patches=(Patch(1.0), Patch(0.5, x=(5.0, 6.0)))), 60.0, 0.1)
    assert plant.findings() == []
    floor = Contact(patches=(Patch(0.3), Patch(0.2, x=(0.0, 1.0)), Patch(0.1, y=(0.0, 1.0))))
    assert [floor.at(*place) for place in ((-1, -1), (0.5, -1), (0.5, 0.5), (-1, 2))] == [0.3, 0.2, 0.1, 0.3]


def loop(**more) -> Loop:
    reference = Trajectory(base=Line(speed=0.3), arm=[Sine(amplitude=0.8, period=4.0), Hold(0.8)])
    timing = Timing(duration=0.1 if PLAIN else 0.4)
    return Loop(robot("platform_arm"), reference, PD(THESIS), timing=timing, start=Start((-0.01, 0.0, 0.0)), **more)


def test_a_recording_knows_its_plant_and_what_the_wheels_did() -> None:
    run = loop(plant="contact").run()
    assert run.meta["plant"] == "contact" and run.meta["loop"] == "ordinary" and run.meta["contact"]["friction"] == 1.0
    assert run["slip"].shape == run["traction"].shape == (len(run), 2) and run["constraint_residual"].shape == (
        len(run),
    )
    assert run.labels("slip") == run.labels("traction") == ("wheel_left_joint", "wheel_right_joint")
    assert run.unit("slip") == run.unit("constraint_residual") == "m/s" and run.unit("traction") == ""
    assert 0 < run["slip"].max() < 1e-3 and 0.1 < run["traction"].max() <= 1 + 1e-6 and run.outcome.message == ""
    assert np.abs(run["energy_residual"]).max() < 0.02 * run["energy"].max()
    ideal = loop().run()
    assert ideal.meta["plant"] == "ideal" and ideal.meta["loop"] == "compiled" and "contact" not in ideal.meta
    assert not {"slip", "traction", "constraint_residual"} & set(ideal)


def test_a_run_that_slipped_says_so_and_lost_energy() -> None:
    run = loop(plant="contact", contact=Contact(friction=0.3, casters="soft")).run()
    assert "the wheels slipped for" in run.outcome.message and "wheel_" in run.outcome.message
    assert run.outcome.status == "completed" and run["slip"].max() > 0.05
    assert run["energy_residual"][-1] < 0 and run["traction"].max() == pytest.approx(1.0, abs=1e-6)


def test_the_same_run_gives_the_same_bits_and_resumes_near() -> None:
    first, second = loop(plant="contact").run(), loop(plant="contact").run()
    for name in first:
        np.testing.assert_array_equal(first[name], second[name])
    half = len(first) // 2
    state = first["position"][half], first["nu"][half]
    again = loop(plant="contact").run(first=half, plant_state=state)
    np.testing.assert_allclose(again["position"], first["position"][half:], atol=1e-5)


def test_a_base_that_falls_over_ends_the_run() -> None:
    crane = link("crane", 60.0) + joint("hook", "fixed", "base", "crane", p=(0.8, 0, 1.0))
    this = robot_of(Drive().urdf(ARM + REAR + crane))
    plant = ContactPlant(this, DT)
    plant.start(this.neutral_position(), np.zeros(this.dimensions.dof))
    for _ in range(2000):
        plant.step(np.zeros(this.dimensions.dof))
    assert not np.isfinite(plant.y).any() and "the base fell over at t = " in plant.findings()[-1]


# -- what it stands on -------------------------------------------------------------------------------------------------


def gripper() -> Robot:
    """A trolley whose arm carries a finger and one that mimics it."""
    fingers = link("left_finger", 0.2, 0.001) + link("right_finger", 0.2, 0.001)
    mimic = LIMIT.format(-1, 1) + '<mimic joint="finger" multiplier="-0.5" offset="0.1"/>'
    fingers += joint("finger", "revolute", "fore", "left_finger", p=(0.2, 0.05, 0), more=LIMIT.format(-1, 1))
    fingers += joint("follower", "revolute", "fore", "right_finger", p=(0.2, -0.05, 0), more=mimic)
    return robot_of(TROLLEY.replace("</robot>", fingers + "</robot>"), free=("all",))


def test_mimic_joints_follow() -> None:
    this = gripper()
    names = this.full_velocity_names
    finger, follower = names.index("finger"), names.index("follower")
    plants = IdealPlant(this, DT), ContactPlant(this, DT, "rk4")
    start, dynamics = this.follow(bent(this)), Dynamics(this)
    for plant in plants:
        plant.start(start, np.zeros(this.dimensions.dof))
        for _ in range(20 if PLAIN else 100):
            tau = dynamics.gravity(plant.position)
            tau[-1] += 0.01
            plant.step(tau)
            plant.refresh()
    contact = plants[1].position
    assert contact[follower] == pytest.approx(-0.5 * contact[finger] + 0.1, abs=1e-4)
    assert contact[finger] - start[finger] == pytest.approx(plants[0].position[finger] - start[finger], rel=0.02)
    assert contact[finger] - start[finger] > (1e-4 if PLAIN else 0.01)


@pytest.mark.parametrize(
    ("drive", "frame"),
    [
        (Drive(), (0.0, 0.0, 0.0)),
        (Drive(frame=(0.1, 0.05, 0.7), floor=-0.3), (0.1, 0.05, 0.7)),
        (Drive(inset=0.03, flips=(1, -1)), (0.0, 0.0, 0.0)),
    ],
)
def test_wheels_touch_where_the_base_has_them(drive: Drive, frame: tuple[float, float, float]) -> None:
    skid = SKID + joint("weld", "fixed", "base", "skid", p=(-0.3, 0.1, drive.floor + 0.025))
    this = robot_of(drive.urdf(ARM + skid))
    feet, model = feet_of(this), this.model
    data = model.createData()
    position = this.neutral_position()
    position[:3] = this.frame
    pin.forwardKinematics(model, data, this.configuration(position))
    c, s = np.cos(frame[2]), np.sin(frame[2])
    for foot, side in zip(feet.wheels, (0.2, -0.2), strict=True):
        expected = (frame[0] - s * side, frame[1] + c * side, drive.floor + 0.1)
        np.testing.assert_allclose(data.oMi[foot.joint].act(foot.centre), expected, atol=1e-9)
        assert foot.radius == 0.1
    (caster,) = feet.casters
    lowest = data.oMi[caster.joint].act(caster.centre) - [0, 0, caster.radius]
    np.testing.assert_allclose(lowest, (-0.3, 0.1, drive.floor), atol=1e-9)  # level with the wheels, 5 mm lower


def swivel(shape: str) -> str:
    fork = link("fork", 0.5) + joint("turn", "continuous", "base", "fork", p=(0.2, 0, 0.06), axis=(0, 0, 1))
    return fork + link("roller", 0.5, shape=shape) + joint("roll", "continuous", "fork", "roller", p=(-0.02, 0, -0.03))


@pytest.mark.parametrize("lock", [0.0, np.pi / 2])
def test_a_swivel_caster_stands_where_it_is_locked(lock: float) -> None:
    lying = origin(pin.rpy.rpyToMatrix(np.pi / 2, 0, 0))
    shape = f'<cylinder radius="0.03" length="0.01"/></geometry>{lying}<geometry><sphere radius="0.03"/>'
    this = robot_of(Drive().urdf(ARM + swivel(shape.partition("</geometry>")[0]).replace(
        "<collision>", f"<collision>{lying}")), lock=(f"turn={lock}",))  # fmt: skip
    (caster,) = feet_of(this).casters
    assert this.model.names[caster.joint] == "roll"
    data = this.model.createData()
    pin.forwardKinematics(this.model, data, this.configuration(this.neutral_position()))
    expected = (0.2 - 0.02 * np.cos(lock), -0.02 * np.sin(lock), 0.02)
    np.testing.assert_allclose(data.oMi[caster.joint].act(caster.centre), expected, atol=1e-9)


# -- bad input ---------------------------------------------------------------------------------------------------------


def test_a_base_on_two_wheels_is_refused() -> None:
    with pytest.raises(RobotError, match="nothing but the drive wheels of 'robot' touches the floor"):
        ContactPlant(robot_of(Drive().urdf()), DT)


def test_a_base_that_is_pushed_is_refused() -> None:
    this = robot_of(Drive().urdf(), base="differential_drive")
    with pytest.raises(RobotError, match="cannot carry the holonomic base"):
        feet_of(replace(this, base=HolonomicBase(frame=this.base.frame)))


@pytest.mark.parametrize(("direction", "force"), [(0, 160.0), (1, 160.0), (2, 60.0)])
def test_wheels_with_rollers_answer_as_they_do_on_the_ideal_plant(direction: int, force: float) -> None:
    """Inertia and dry friction of the wheels included; the second answer is the reduced dynamics."""
    this, velocities = load("tiago_pro"), []
    push = np.zeros(this.dimensions.dof)
    push[direction] = force
    soft = ContactPlant(this, DT, "euler", Contact(casters="soft"))
    for plant in (IdealPlant(this, DT, "implicit_friction"), soft):
        plant.start(this.neutral_position(), np.zeros(this.dimensions.dof))
        for _ in range(100):
            plant.step(push + this.gravity(this.neutral()))
            plant.refresh()
        velocities.append(plant.nu[:3].copy())
    ideal, contact = velocities
    assert abs(ideal[direction]) > 0.02
    np.testing.assert_allclose(contact, ideal, atol=0.005 * abs(ideal[direction]))


def test_friction_of_rollers_lets_no_base_tremble() -> None:
    """Two steps of the engine for one of the plant hid a base that swung to and fro between them."""
    this, steps = load("tiago_pro"), []
    plant = ContactPlant(this, 0.0005, "euler", Contact(casters="soft"))
    plant.start(this.neutral_position(), np.zeros(this.dimensions.dof))
    push = this.gravity(this.neutral())
    push[2] += 5.0
    for _ in range(100):
        plant.step(push)
        plant.refresh()
        steps.append(plant.nu[:3].copy())
    turning = np.array(steps)[50:, 2]
    assert np.abs(np.diff(turning)).max() < 1e-3 * np.abs(turning).max()
    wheels = this.T[[this.rows[wheel.joint] for wheel in this.base.wheels], :3]
    dry = np.abs(wheels[:, 2]) @ this.dry[[this.rows[wheel.joint] for wheel in this.base.wheels], 0]
    assert COULOMB_SPEED * np.arctanh(5.0 / dry) == pytest.approx(turning[-1] * np.abs(wheels[0, 2]), rel=0.05)


def test_an_inertia_that_no_body_can_have_is_refused() -> None:
    flat = '<inertial><mass value="2.0"/><inertia ixx="1.0" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>'
    text = TROLLEY.replace("</robot>", f'<link name="odd">{flat}</link></robot>')
    text = text.replace("</robot>", joint("wrist", "continuous", "fore", "odd", p=(0.1, 0, 0)) + "</robot>")
    with pytest.raises(RobotError, match="MuJoCo refuses 'robot'"):
        ContactPlant(robot_of(text), DT)


@pytest.mark.parametrize(
    ("make", "key"),
    [
        (lambda: Contact(friction=-0.1), "contact.friction"),
        (lambda: Contact(friction=float("nan")), "contact.friction"),
        (lambda: Contact(step=0.0), "contact.step"),
        (lambda: Contact(step=float("nan")), "contact.step"),
        (lambda: Patch(float("inf")), "contact.patches.friction"),
        (lambda: Patch(0.5, x=(1.0, 1.0)), "contact.patches.x"),
        (lambda: Patch(0.5, y=(0.0, float("inf"))), "contact.patches.y"),
    ],
)
def test_settings_out_of_range_name_their_key(make, key: str) -> None:
    with pytest.raises(ConfigError) as caught:
        make()
    assert caught.value.key == key


def test_the_compiled_engine_and_unknown_plants_are_refused() -> None:
    with pytest.raises(ConfigError, match="the contact plant cannot be compiled"):
        loop(plant="contact", engine="compiled").run()
    with pytest.raises(UnknownName, match="unknown plant 'contakt'"):
        loop(plant="contakt")


def test_without_mujoco_one_line_says_how_to_install_it(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    assert main(["run", "chapter4", "--plant", "contact", "--out", str(tmp_path / "runs")]) == 2
    (line,) = [text for text in capsys.readouterr().err.splitlines() if "error" in text]
    assert "MuJoCo is not installed" in line and "pip install 'mmnn_pin[contact]'" in line
    assert not (tmp_path / "runs").exists()


def test_an_unknown_plant_on_the_command_line(capsys) -> None:
    assert main(["run", "chapter4", "--plant", "contac"]) == 2
    assert "plant: error: unknown plant 'contac': did you mean 'contact'?" in capsys.readouterr().err


# -- experiments -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("experiment", ["chapter4", "track"])
def test_experiments_run_on_it_unchanged(experiment: str, tmp_path, capsys) -> None:
    arguments = ["--plant", "contact", "--out", str(tmp_path), "--set", f"time.duration={0.01 if PLAIN else 0.1}"]
    arguments += ["--set", "plots=['errors']"]
    assert main(["run", experiment, *arguments, "--json"]) == 0
    runs = json.loads(capsys.readouterr().out)["runs"]
    expected = load_experiment(experiment).controllers
    assert list(runs) == list(expected) and {run["outcome"] for run in runs.values()} == {"completed"}
    assert all(run["metrics"]["traction.wheel_left_joint.peak"] > 0 for run in runs.values())


@pytest.mark.skipif(PLAIN, reason="slow in plain Python")
def test_slip_shows_what_the_patch_does_to_the_controllers(tmp_path, capsys) -> None:
    assert main(["run", "slip", "--out", str(tmp_path), "--set", "time.duration=1.5", "--controller", "one_layer",
                 "--controller", "pd", "--details"]) == 0  # fmt: skip
    printed = capsys.readouterr().out
    rows = [line.split() for line in printed.splitlines()]
    slip = next(row for row in rows if row[:3] == ["slip", "[mm/s]", "wheel_left_joint"])
    assert all(float(value) > 100 for value in slip[-2:])
    time = next(row for row in rows if row[:3] == ["time", "slipping", "[s]"])
    assert all(float(value) > 0.1 for value in time[-2:])
    assert any(row[:3] == ["traction", "use", "wheel_left_joint"] for row in rows)
    assert "contact plant" in printed and printed.count("the wheels slipped for") == 2
