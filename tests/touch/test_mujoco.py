"""What is felt of a wall that MuJoCo itself makes: its contact forces are the second answer, not a force of ours."""

from __future__ import annotations

import numpy as np
import pytest
from builders import loop, thesis_robot
from numba import config
from scipy.signal import lfilter

from mmnn_pin import Feedback, Timing, Trajectory
from mmnn_pin.loop.before_run import Start
from mmnn_pin.reference import Hold, Line
from mmnn_pin.reference.joint import MinimumJerk
from mmnn_pin.torque.model_based import ComputedTorque
from mmnn_pin.touch import Touch

mujoco = pytest.importorskip("mujoco")
from mmnn_pin.plant.contact import tree  # noqa: E402
from mmnn_pin.plant.contact.plant import ContactPlant  # noqa: E402

BALL = 0.02  # radius of the hand [m]


@pytest.fixture
def wall(monkeypatch):
    """A ball on the hand, a box before it in MuJoCo's tree, and the mean force on the ball before every sample."""
    steps, forces, contacts = [], [], tree.add_contacts
    observe, traction = ContactPlant.observe, ContactPlant._take_traction

    def with_wall(mj, spec, bodies, feet, robot, contact, dt):
        contacts(mj, spec, bodies, feet, robot, contact, dt)
        frame = robot.model.frames[robot.model.getFrameId(robot.hands[0])]
        more = {"contype": 0, "conaffinity": 0}
        sphere, box = mj.mjtGeom.mjGEOM_SPHERE, mj.mjtGeom.mjGEOM_BOX
        at = frame.placement.translation
        bodies[frame.parentJoint].add_geom(name="hand", type=sphere, size=[BALL, 0, 0], pos=at, **more)
        spec.worldbody.add_geom(name="wall", type=box, size=[0.2, 0.2, 0.2], pos=with_wall.centre, **more)
        pair = spec.add_pair(name="touch", geomname1="wall", geomname2="hand", condim=3)
        pair.solref, pair.friction = (0.01, 1.0), [0.3, 0.3, 1e-5, 1e-5, 1e-5]

    def of_a_step(plant):
        traction(plant)
        total, force = np.zeros(3), np.zeros(6)
        for i in range(plant.data.ncon):
            contact = plant.data.contact[i]
            names = [plant.model.geom(int(geom)).name for geom in contact.geom]
            if {*names} == {"wall", "hand"}:
                mujoco.mj_contactForce(plant.model, plant.data, i, force)
                total += (1.0 if names[1] == "hand" else -1.0) * contact.frame.reshape(3, 3).T @ force[:3]
        steps.append(total)

    def of_a_sample(plant, row, layout):
        observe(plant, row, layout)
        forces.append(np.mean(steps, axis=0) if steps else np.zeros(3))
        steps.clear()

    monkeypatch.setattr(tree, "add_contacts", with_wall)
    monkeypatch.setattr(ContactPlant, "observe", of_a_sample)
    monkeypatch.setattr(ContactPlant, "_take_traction", of_a_step)
    with_wall.forces = forces
    return with_wall


@pytest.mark.skipif(bool(config.DISABLE_JIT), reason="hundreds of samples")
def test_the_wrench_is_mujocos_contact_force(wall):
    """Pressed against a box and along it the hand feels MuJoCo's force, behind the observer's filter, with friction."""
    robot, bandwidth, h = thesis_robot(), 100.0, 0.002
    wall.centre = [0.35, 0.5453 + BALL + 0.01 + 0.2, 0.455]
    arm = {"arm_1_joint": MinimumJerk(0.4, 0.6, 0.6), "arm_2_joint": Hold(1.4)}
    made = loop(
        ComputedTorque(Feedback(100.0, (20.0, 10.0))), robot=robot, nominal=robot, touch=Touch(bandwidth=bandwidth),
        trajectory=Trajectory.of(robot, base=Line(speed=0.0), arm=arm), plant="contact", start=Start(),
        timing=Timing(duration=0.8, control_period=h, plant_step=0.001, integrator="implicit_friction"),
    )  # fmt: skip
    run = made.run()
    truth = np.array(wall.forces)[: len(run["time"])]
    gain = bandwidth * h
    filtered = lfilter([gain / (1.0 + gain)], [1.0, -1.0 / (1.0 + gain)], truth, axis=0)
    pressed = np.abs(truth[:, 1]) > 1.0
    assert pressed.mean() > 0.3 and np.abs(filtered[:, 1]).max() > 50.0
    np.testing.assert_allclose(run["external_wrench"][:, :2], filtered[:, :2], atol=0.2)
