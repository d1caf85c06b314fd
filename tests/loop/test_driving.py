"""DeadReckoning against a fine integration; a paced loop on a clock of its own that ends in a stop."""

from __future__ import annotations

import numpy as np
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from mmnn_pin import PD, DeadReckoning, Measurement, Stepper, StepperSettings, drive, load, stepper_on
from mmnn_pin.safety import Safety


@given(st.lists(st.tuples(*[st.floats(-2.0, 2.0)] * 3), min_size=1, max_size=4))
@settings(max_examples=10, phases=(Phase.explicit, Phase.generate))
def test_odometry_is_the_integral_of_velocities_that_stand(velocities):
    odometry, pose = DeadReckoning(), np.zeros(3)
    for v in velocities:

        def rate(_, y, v=v):
            c, s = np.cos(y[2]), np.sin(y[2])
            return [c * v[0] - s * v[1], s * v[0] + c * v[1], v[2]]

        pose = solve_ivp(rate, (0.0, 0.3), pose, rtol=1e-9, atol=1e-10).y[:, -1]
        np.testing.assert_allclose(odometry.move(np.array(v), 0.3), pose, atol=1e-7)


class Silent:
    """A robot that says something once, and keeps what it is sent."""

    def __init__(self, first):
        self.first, self.sent = first, []

    def read(self):
        first, self.first = self.first, None
        return first

    def write(self, command):
        self.sent.append(command.motor_effort.copy())


def test_a_paced_loop_ends_when_a_stop_has_ended():
    robot, now, slept = load("two_axis_arm"), [0.0], []

    def sleep(seconds):
        slept.append(seconds)
        now[0] += seconds

    driver = Silent(Measurement(np.zeros(0), np.zeros(0), np.zeros(2), np.zeros(2)))
    with Stepper(robot, PD(), StepperSettings(safety=Safety(timeout=0.05), period=0.01)) as stepper:
        run = drive(stepper, driver, 30.0, lambda t: None, clock=lambda: now[0], sleep=sleep)
    assert run.outcome.status == "tripped" and len(driver.sent) == len(run) < 3000
    np.testing.assert_allclose(slept, 0.01)


def test_a_stepper_on_hardware_has_all_that_follows_from_it():
    robot = load("so101")
    with stepper_on(robot, "feetech-sts3215", "learned", seed=3) as stepper:
        assert stepper.period == 0.02 and stepper.latency == 0.01 and stepper.setup.seed == 3
        assert stepper.setup.servo.stiffness == 17.8 and set(stepper.kinds) == {"position"}
        assert stepper.setup.controller.name == "learned"
