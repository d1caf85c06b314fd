"""What a robot does when it is pushed: it stops, gives way and goes back, or goes on; within its limits, always."""

from __future__ import annotations

import numpy as np
import pytest
from builders import loop, thesis_robot
from hypothesis import example, given, settings
from hypothesis import strategies as st

from mmnn_pin import Feedback, Timing, Trajectory
from mmnn_pin.disturbance import Push
from mmnn_pin.loop.before_run import Start
from mmnn_pin.safety import Safety
from mmnn_pin.torque.model_based import ComputedTorque
from mmnn_pin.touch import Touch

ROBOT, ENDS, END = thesis_robot(), 0.5, 4.5  # when the push is over, and the run [s]
STATED = Touch(masses=0.0, friction=0.0, torque=0.0, unknown=1e-3)


def pushed(contact, on, force):
    """A run that stands and is pushed for 0.3 s."""
    made = loop(
        ComputedTorque(Feedback(200.0, 20.0)), robot=ROBOT, nominal=ROBOT, touch=STATED, start=Start(),
        trajectory=Trajectory.of(ROBOT), timing=Timing(duration=END), safety=Safety(torque="urdf", contact=contact),
        disturbances=(Push(on=on, force=force, start=0.2, end=ENDS),),
    )  # fmt: skip
    return made.run()


@pytest.mark.compiled
@pytest.mark.parametrize("contact", ["stop", "comply", "go on"])
@settings(max_examples=3, derandomize=True, deadline=None)
@example(on="w", size=1.0, sign=1.0)  # the base's inertia pulls at the arm
@given(on=st.sampled_from(ROBOT.velocity_names), size=st.floats(0.1, 1.0), sign=st.sampled_from([-1.0, 1.0]))
def test_a_pushed_robot_stays_within_its_limits_and_rests_or_comes_back(contact, on, size, sign):
    force = sign * size * {"v": 60.0, "w": 30.0}.get(on, 2.0)
    run = pushed(contact, on, force)
    motors, felt = run["motor_torque"], np.ravel(run["contact"]) > 0.0
    assert np.all(np.abs(motors) <= ROBOT.effort_limits + 1e-9)
    assert felt.any() and run.time[felt][0] < 0.25  # it is felt within 50 ms
    if contact == "stop":
        assert run.outcome.status == "tripped" and np.abs(run["nu"][-1]).max() < 0.1
        return
    assert run.outcome.status == "completed" and np.abs(run["nu"][-1]).max() < 0.1
    assert np.abs(run["true_e"][-1]).max() < 0.02
    if contact == "comply":
        back = run.time > run.time[felt][-1]
        assert np.abs(run["nu"][back]).max() < 1.05 * STATED.back  # what turns with the base is not in its wish
        assert abs(run["pose"][-1, 2]) < 0.006 and np.abs(run["pose"][-1, :2]).max() < 0.01
