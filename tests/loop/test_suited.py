"""Gains and references that suit a robot: they bear the delay that they have to, and no motor is asked for too much."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from builders import trajectory
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import linalg

from mmnn_pin import PD, Feedback, Loop, Sine, Stepper, StepperSettings, Timing, Trajectory, load
from mmnn_pin.actuator import Actuator
from mmnn_pin.errors import ConfigError
from mmnn_pin.kinematic import Kinematic
from mmnn_pin.lab.experiments.config import load_experiment
from mmnn_pin.lab.experiments.experiment import made_for
from mmnn_pin.loop.before_run import Start
from mmnn_pin.loop.latency import Latency
from mmnn_pin.loop.suited import MARGIN, SLOWEST, LoopToSuit, MotorLoad, effective_inertia, fit, followable, timing_for
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.model.robot import Robot
from mmnn_pin.model.robots import extra
from mmnn_pin.signals import Setpoint
from mmnn_pin.torque.classical import PID
from mmnn_pin.torque.controller import BANDWIDTHS, TorqueController
from mmnn_pin.torque.model_based import ComputedTorque
from mmnn_pin.torque.neural import Neural, Robust


class PDAlone(TorqueController):
    """PD in plain Python."""

    name = "own"

    def init(self, context):
        return self.feedback.vector(context.layout)

    def step(self, time, reference, measurement, command, state):
        return state * np.concatenate((command.z, command.r))


ROBOTS = ["platform_arm", "two_axis_arm", *(name for name in ("tiago_no_hand", "so101", "kinova") if name in extra())]
H = 0.002


def loop_of(robot: Robot, controller, **more) -> Loop:
    timing = Timing(duration=0.2, control_period=H)
    kinematic = Kinematic(kx=3.0, ky=16.0, kth=8.0, K=7.0, holonomic=(3.0, 3.0, 3.0))
    return Loop(robot, trajectory(robot), controller, **({"timing": timing, "kinematic": kinematic} | more))


@pytest.mark.parametrize("name", ROBOTS)
def test_default_gains_bear_three_milliseconds_at_500_hertz(name: str) -> None:
    """Along a reference, which the rule has not seen; whatever the controller, and in a stepper."""
    robot = load(name)
    for controller in (PD(), ComputedTorque(), Neural(), PID()):
        loop = loop_of(robot, controller)
        assert loop.delay_margin() >= MARGIN, (name, controller.name)
        loop.require_stable_gains()
    assert Stepper(robot, PD(), StepperSettings(period=H)).delay_margin() >= MARGIN


def test_a_delay_that_is_known_lowers_the_gains_until_it_is_borne() -> None:
    robot = load("platform_arm")
    prompt, late = (loop_of(robot, PD(), latency=Latency(command=delay)) for delay in (0.0, 0.016))
    assert late.delay_margin() >= 0.016 + MARGIN > prompt.delay_margin()
    with pytest.raises(ConfigError, match="does not bear a latency of 16 ms"):
        replace(late, controller=prompt.controller).require_stable_gains()
    stepper = Stepper(robot, PD(), StepperSettings(period=H, latency=0.016))
    assert stepper.delay_margin() >= 0.016 + MARGIN
    lagging = loop_of(robot, PD(), actuator=Actuator(lag=0.1))
    assert lagging.delay_margin() >= MARGIN > replace(prompt, actuator=Actuator(lag=0.1)).delay_margin()


@pytest.mark.parametrize("period", [0.001, 0.01, 0.05])
def test_a_slow_loop_has_lower_gains(period: float) -> None:
    robot = load("two_axis_arm")
    timing = Timing(duration=1.0, control_period=period, plant_step=0.001)
    loop = loop_of(robot, PD(), timing=timing)
    assert loop.delay_margin() >= MARGIN
    assert (fit(robot, Feedback(), LoopToSuit(loop.kinematic, period)).share == 1.0) == (period < 0.05)


def test_gains_follow_the_inertia() -> None:
    """A thousandth of the mass, a thousandth of the gain; the bandwidth stays."""
    robots = [load("platform_arm").with_masses(factor) for factor in (1.0, 1e-3)]
    gains = [loop_of(robot, PD()).controller.feedback.vector(robot.dimensions) for robot in robots]
    np.testing.assert_allclose(gains[0], 1e3 * gains[1], rtol=1e-9)


def test_every_velocity_has_its_bandwidth_where_its_inertia_is_least() -> None:
    """`k (M^-1)_ii` at random places, by Pinocchio: the bandwidth or less, and the bandwidth at the worst of them."""
    robot, rng = load("two_axis_arm"), np.random.default_rng(1)
    k, dynamics = loop_of(robot, PD()).controller.feedback.vector(robot.dimensions), Dynamics(robot)
    at = [robot.neutral_position() + rng.uniform(-np.pi, np.pi, 2) for _ in range(200)]
    felt = np.array([k * np.diag(np.linalg.inv(dynamics.mass_matrix(position))) for position in at]).max(axis=0)
    assert (felt < 1.3 * BANDWIDTHS[1]).all() and (felt > 0.9 * BANDWIDTHS[1]).all()


def test_gains_that_are_given_stay() -> None:
    robot = load("two_axis_arm")
    given = PD(Feedback(1.0, 2.0))
    assert loop_of(robot, given).controller is given
    assert loop_of(robot, PD(Feedback(arm=(1.0, 2.0)))).controller.feedback.vector(robot.dimensions).tolist() == [1, 2]
    mobile = load("platform_arm")
    half = loop_of(mobile, PD(Feedback(arm=3.0))).controller.feedback.vector(mobile.dimensions)
    assert (half[2:] == 3.0).all() and (half[:2] > 100.0).all()
    own = Robust(7.0, 3.0)
    assert loop_of(robot, Neural(robust=own)).controller.robust == own
    bandwidths = loop_of(robot, Neural(robust=None)).controller
    assert bandwidths.robust is None and np.array(bandwidths.inertia).shape == (2,)
    with pytest.raises(ConfigError, match="no gains"):
        Feedback(1.0).vector(robot.dimensions)


def test_a_plain_class_of_ones_own_gets_gains_and_keeps_itself_as_it_was() -> None:
    class Own(PDAlone):
        def __init__(self) -> None:
            self.feedback = Feedback()

    own, robot = Own(), load("so101" if "so101" in extra() else "two_axis_arm")
    made = loop_of(robot, own).controller
    assert made.feedback == loop_of(robot, PD()).controller.feedback and made.feedback.complete(robot.dimensions)
    assert isinstance(made, Own) and own.feedback == Feedback()


def test_a_gain_that_is_too_much_leaves_the_others_as_they_are() -> None:
    """Else a sweep of the arm's gain would be one of the base's: it fell to a hundredth to save what nothing saves."""
    robot = load("platform_arm")
    alone = loop_of(robot, PD()).controller.feedback.vector(robot.dimensions)
    beside = loop_of(robot, PD(Feedback(arm=1e3))).controller.feedback.vector(robot.dimensions)
    np.testing.assert_array_equal(beside[:2], alone[:2])
    assert (beside[2:] == 1e3).all()


def test_an_experiment_has_the_gains_of_a_loop() -> None:
    experiment, robot = load_experiment("track"), load("platform_arm")
    made = experiment.controller("pd", robot=robot).feedback
    loop = experiment.loop(robot, PD())
    assert loop.controller.feedback == made
    held = [loop.start.state(robot, row)[0] for row in loop.table()[::500]]
    bandwidths = made.vector(robot.dimensions) / effective_inertia(robot, held, H)
    assert (bandwidths < 1.05 * np.repeat(BANDWIDTHS, 2)).all()


def test_a_slow_reference_is_the_same_motion() -> None:
    robot = load("platform_arm")
    fast, t = trajectory(robot), np.linspace(0.0, 2.0, 2001)
    slow = replace(fast, slowness=2.5)
    rows = Setpoint.side_by_side(fast.table(t, robot.dimensions), robot.dimensions)
    slowed = Setpoint.side_by_side(slow.table(2.5 * t, robot.dimensions), robot.dimensions)
    for name, rate in (("pose", "velocity"), ("q", "qdot")):
        np.testing.assert_allclose(getattr(slowed, name), getattr(rows, name), atol=1e-12)
        np.testing.assert_allclose(2.5 * getattr(slowed, rate), getattr(rows, rate), atol=1e-12)
    np.testing.assert_allclose(np.gradient(slowed.q, 2.5 * t, axis=0)[1:-1], slowed.qdot[1:-1], atol=1e-4)
    np.testing.assert_allclose(np.gradient(slowed.qdot, 2.5 * t, axis=0)[1:-1], slowed.qddot[1:-1], atol=1e-4)
    single = Setpoint.side_by_side(np.zeros(fast.table([0.0], robot.dimensions).shape[1]), robot.dimensions)
    slow.write(2.5 * t[700], None, single)  # type: ignore[arg-type]
    np.testing.assert_allclose(single.acceleration, slowed.acceleration[700], atol=1e-12)


def needed(robot: Robot, reference) -> float:
    """Largest torque over its limit, the reference followed exactly: Pinocchio's inverse dynamics of its samples."""
    t = np.linspace(0.0, 10.0 * reference.slowness, 377)
    rows = Setpoint.side_by_side(reference.table(t, robot.dimensions), robot.dimensions)
    dynamics, found = Dynamics(robot), 0.0
    for i in range(len(t)):
        position = robot.neutral_position()
        position[robot.arm_index] = rows.q[i]
        nu = np.concatenate((rows.velocity[i], rows.qdot[i]))
        psi = dynamics.psi(robot.follow(position), nu, nu, np.concatenate((rows.acceleration[i], rows.qddot[i])))
        found = max(found, (abs(np.linalg.pinv(robot.E) @ psi) / robot.effort_limits).max())
    return found


@pytest.mark.parametrize("weaker", [1.0, 100.0])
def test_a_reference_is_slow_enough_for_weak_motors_and_no_slower(weaker: float) -> None:
    robot = load("platform_arm")
    robot = replace(robot, effort_limits=robot.effort_limits / weaker)
    found = followable(robot, lambda limits: trajectory(robot), 10.0, 0.5)
    assert needed(robot, found) <= 0.51
    assert found.slowness == 1.0 or needed(robot, replace(found, slowness=found.slowness / 1.25)) > 0.49
    assert (found.slowness > 1.0) == (weaker == 100.0)


@pytest.mark.skipif("so101" not in extra(), reason="example-robot-data is not installed")
def test_an_arm_too_weak_for_the_middle_of_its_range_swings_about_another_posture() -> None:
    robot = load("so101")
    experiment = load_experiment("track", ["robot=so101"])
    still = needed(robot, replace(experiment.trajectory_of(robot), slowness=SLOWEST))
    weak = replace(robot, effort_limits=robot.effort_limits * still / 0.9)  # the middle takes 0.9 of its motors
    moved, middle = experiment.trajectory_of(weak), experiment.trajectory_of(robot)
    assert needed(weak, replace(moved, slowness=SLOWEST)) < 0.75 < needed(weak, replace(middle, slowness=SLOWEST))
    q = np.array([profile.sample(np.linspace(0, 10, 50) * moved.slowness).q for profile in moved.arm])
    assert (q.min(axis=1) >= robot.lower[robot.arm_index]).all()
    assert (q.max(axis=1) <= robot.upper[robot.arm_index]).all()
    assert MotorLoad(weak).along(moved, 10.0).max() < 1.0


@pytest.mark.skipif("so101" not in extra(), reason="example-robot-data is not installed")
def test_an_arm_too_weak_for_the_ends_of_its_swing_swings_less_far() -> None:
    robot = load("so101", free=("gripper",))
    experiment = load_experiment("track", ["robot=so101", 'overrides.free=["gripper"]'])
    still = needed(robot, replace(experiment.trajectory_of(robot), slowness=SLOWEST))
    weak = replace(robot, effort_limits=robot.effort_limits * still / 1.04)  # no posture of the whole swing helps
    swings = [
        max(np.ptp(p.sample(np.linspace(0, 6, 50)).q) for p in experiment.trajectory_of(r).arm) for r in (robot, weak)
    ]
    assert swings[1] < 0.9 * swings[0]
    assert needed(weak, replace(experiment.trajectory_of(weak), slowness=SLOWEST)) < 0.76


@pytest.mark.skipif("so101" not in extra(), reason="example-robot-data is not installed")
def test_a_hopeless_search_ends_early_with_the_answer_of_the_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    robot, looked, whole, of = load("so101"), [], MotorLoad.along, Start.state
    weak = replace(robot, effort_limits=1e-3 * robot.effort_limits)  # no posture helps
    monkeypatch.setattr(Start, "state", lambda *given: (looked.append(1), of(*given))[1])
    found, few = load_experiment("track", ["robot=so101"]).trajectory_of(weak), len(looked)
    monkeypatch.setattr(
        MotorLoad, "along", lambda self, reference, duration, enough=0.0: whole(self, reference, duration)
    )
    made_for.cache_clear()
    assert load_experiment("track", ["robot=so101"]).trajectory_of(weak) == found
    assert len(looked) - few > 1.5 * few


def test_track_keeps_the_limits_of_the_motors_unless_it_is_told_not_to() -> None:
    assert load_experiment("track").actuator.torque_limit == "urdf"
    assert load_experiment("track", ["actuator.torque_limit=none"]).actuator.perfect


def test_gravity_and_an_integral_feed_no_rates_back() -> None:
    """Their Psi_hat does not answer to nudot_ref: what is inside it for a model takes nothing from their margin."""
    experiment, robot = load_experiment("track"), load("platform_arm")
    margin = {
        name: experiment.loop(robot, experiment.controller(name, robot=robot)).delay_margin()
        for name in ("pd", "pd_gravity", "pid", "computed_torque")
    }
    assert margin["pd_gravity"] == margin["pid"] == margin["pd"] > margin["computed_torque"]


# -- the integrator that is not given ---------------------------------------------------------------------------------


@given(viscous=st.lists(st.floats(0.0, 1e3), min_size=2, max_size=2))
@settings(max_examples=50, deadline=None)
def test_only_friction_that_rk4_may_not_bear_gets_another_integrator(viscous: list[float]) -> None:
    """The fastest decay by scipy, from Pinocchio's mass matrix."""
    robot = load("two_axis_arm").with_joint_friction(viscous=viscous)
    timing = timing_for(robot, Timing())
    rate = float(linalg.eigh(np.diag(viscous), robot.mass_matrix(robot.neutral()), eigvals_only=True)[-1])
    if rate * timing.plant_step > 2.785:
        assert timing.integrator == "implicit_friction"
    elif 2 * rate * timing.plant_step < 2.78:  # the trace is at most two times the largest
        assert timing.integrator == "rk4"
    assert timing_for(robot, Timing(integrator="stick")).integrator == "stick"


def test_a_robot_with_stiff_friction_is_not_lost_by_default() -> None:
    """With rk4 it is, although nothing drives it away."""
    robot = load("two_axis_arm").with_joint_friction(viscous=500.0)
    still = Trajectory.of(robot, arm={"arm_1_joint": Sine(0.2, period=1.0)})
    times = {"": "completed", "rk4": "diverged"}
    for integrator, status in times.items():
        timing = Timing(duration=0.1, **({"integrator": integrator} if integrator else {}))
        run = Loop(robot, still, PD(Feedback(0.0, 5.0)), timing=timing, check_gains=False).run()
        assert run.outcome.status == status
