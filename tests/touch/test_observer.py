"""External torque: the formulas against Pinocchio and differences, what is felt of pushes, and how often in vain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from builders import loop, thesis_robot
from numba import config
from robots import feedback, mobile_arm
from scipy.stats import chi2

from mmnn_pin import PD, Feedback, Stepper, Timing, Trajectory, load, load_experiment
from mmnn_pin.actuator import Actuator
from mmnn_pin.disturbance import Push
from mmnn_pin.errors import ConfigError, UnknownName
from mmnn_pin.loop.batch import simulate_many
from mmnn_pin.loop.latency import Latency
from mmnn_pin.loop.new_hardware import new_hardware
from mmnn_pin.model.reduction import position_rate
from mmnn_pin.model.tree.body import parameters
from mmnn_pin.model.tree.twin import Twin
from mmnn_pin.safety import Safety
from mmnn_pin.signals import Measurement, Setpoint
from mmnn_pin.torque.model_based import ComputedTorque
from mmnn_pin.touch import Touch, feel, remember
from mmnn_pin.touch.observer import BOTH, COUNT, ELAPSED, FORGETS, TIME, find_wrench, fit_load, is_load, judge

SOFT = Feedback(100.0, (5.0, 1.0))
SLOW = bool(config.DISABLE_JIT)
ROBOTS = {
    "thesis": thesis_robot,
    "mobile": lambda: mobile_arm(4),
    "car": lambda: load("car_arm"),
    "fixed": lambda: load("two_axis_arm"),
}


def touching(controller=None, *, robot=None, touch=None, duration=0.6, **more):
    """A loop that feels external torque."""
    robot = robot or thesis_robot()
    more = {"nominal": robot} | more
    return loop(controller or ComputedTorque(SOFT), robot=robot, touch=touch or Touch(), duration=duration, **more)


def observer_of(made):
    """The observer of a loop, a row for it, and where signals stand in that."""
    plan = made.plan()
    at_rest = made.robot.neutral_position(), np.zeros(made.robot.dimensions.dof)
    hardware = new_hardware(made, at_rest, made.state_from(), None, plan.steering)
    return hardware.touch, plan.layout.new_row(), plan.layout


def somewhere(made, seed=1):
    """The observer of a loop after a first measurement of a random state, and its row."""
    observer, row, layout = observer_of(made)
    rng = np.random.default_rng(seed)
    for name in ("pose", "velocity", "q", "qdot"):
        part = row[layout.where(name)]
        part[:] = rng.uniform(-1.0, 1.0, part.size)
    row[layout.where("shape")] = 0.3
    feel(row, layout.offsets, 0.0, observer)
    return observer, row, layout


@pytest.fixture(scope="module", params=ROBOTS)
def felt(request):
    robot = ROBOTS[request.param]()
    return robot, somewhere(touching(PD(), robot=robot, trajectory=Trajectory.of(robot)))[0]


def test_momentum_and_bias_are_those_of_the_reduced_dynamics(felt):
    """`C' nu = Mdot nu - C nu`, with Mdot by differences along the motion, on bases that roll, steer or stand."""
    robot, observer = felt
    d, twin, step = robot.dimensions, Twin(robot), 1e-6
    position, nu, rate = observer.position, observer.nu, np.zeros(robot.dimensions.full)

    def mass(place):
        twin.refresh(place, nu)
        return twin.M.copy()

    twin.refresh(position, nu)
    eta = twin.maps.eta if d.shape else np.zeros(0)
    position_rate(position, nu, twin.v.copy(), d.base, d.sideways, eta, rate)
    Mdot = (mass(position + step * rate) - mass(position - step * rate)) / (2 * step)
    twin.refresh(position, nu)
    np.testing.assert_allclose(observer.state.momentum, twin.M @ nu, atol=1e-12)
    scale = np.abs(twin.h).max()
    np.testing.assert_allclose(observer.state.bias, Mdot @ nu - twin.h, atol=1e-7 * scale)


def test_jacobian_of_the_hand_is_pinocchios(felt):
    robot, observer = felt
    at, place = robot.configuration(observer.position), robot.model.getFrameId(robot.hands[0])
    full = pin.computeFrameJacobian(robot.model, robot.model.createData(), at, place, pin.LOCAL_WORLD_ALIGNED)
    np.testing.assert_allclose(observer.J, full @ robot.T_at(observer.position), atol=1e-12)


def test_the_wrench_is_least_squares_in_the_band_and_says_what_no_joint_feels():
    """Dense linear algebra by numpy; the planar robot feels two forces and a moment."""
    observer, row, layout = somewhere(touching(PD()))
    observer.state.residual[:] = wanted = observer.J.T @ np.array([20.0, -10.0, 0.0, 0.0, 0.0, 3.0])
    seen, wrench = row[layout.where("wrench_seen")], row[layout.where("external_wrench")]
    row[layout.where("external_torque")] = wanted
    find_wrench(row, layout.offsets, observer)
    S, J = observer.S, observer.J
    prior = np.diag([1e-6] * 3 + [1 / 9e4] * 3)
    information = J @ np.linalg.solve(S, J.T)
    expected = np.linalg.solve(information + prior, J @ np.linalg.solve(S, wanted))
    np.testing.assert_allclose(wrench, expected, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(seen, np.diag(np.linalg.solve(information + prior, information)), atol=1e-9)
    assert np.all(seen[[2, 3, 4]] < 1e-9) and np.all(seen[[0, 1, 5]] > 0.5)


@pytest.mark.parametrize("name", ["plain", "latency", "lag", "supervised", "heading"])
def test_a_push_is_felt_with_the_time_constant_of_the_observer(name):
    """`r = force (1 - exp(-bandwidth t))`, whatever the robot does and however the torque comes to its motors."""
    force, start, made = 3.0, 0.1, touching(duration=0.1 + (0.02 if SLOW else 0.1))
    more = {
        "plain": {},
        "latency": {"latency": Latency(command=0.004)},
        "lag": {"actuator": Actuator(lag=0.01), "timing": Timing(duration=made.timing.duration, plant_step=1e-4)},
        "supervised": {"safety": Safety(torque=(20.0, 20.0, 0.3, 0.3), torque_time=9.0)},
        "heading": {},
    }[name]
    on = "w" if name == "heading" else "arm_2_joint"
    start = 0.02 if SLOW else start
    run = replace(made, disturbances=(Push(on=on, force=force, start=start),), check_gains=False, **more).run()
    i = list(made.robot.velocity_names).index(on)
    t = run["time"]
    expected = np.zeros((len(t), made.layout.dof))
    expected[:, i] = np.where(t > start, force * (1.0 - np.exp(-50.0 * (t - start))), 0.0)
    np.testing.assert_allclose(run["external_torque"], expected, atol=0.02 * force)
    if name == "supervised":
        assert (run["safety"] == 1.0).any()  # the torques were clipped indeed


def who_knows(true, controller):
    """A learner that has learned the parameters of a robot and is sure of them."""
    theta = parameters(true)
    return replace(controller, before=(theta, 1e-12 * np.eye(theta.size)), learning=False)


@pytest.mark.skipif(SLOW, reason="hundreds of runs")
@pytest.mark.parametrize("knows", [False, True], ids=["file", "learner"])
def test_the_threshold_is_a_rate_of_false_alarms(knows):
    """Robots with masses as wrong as the settings say feel contact in about as many samples as these ask for.

    Where a learner knows Psi they feel it in no more: M and C of the error remain as wrong as the file.
    """
    robot, rate = load("two_axis_arm"), 0.1
    rng, loops = np.random.default_rng(7), []
    controller = ComputedTorque(feedback(robot, 0.002))
    learner = load_experiment("track", [f"robot={robot.name}"]).loop(robot, "kalman_regressor").controller
    touch = Touch(false_alarms=rate, masses=0.1, friction=0.0, torque=0.0, unknown=1e-4, clear=0.0)
    for _ in range(300):
        true = robot.with_masses({name: 1.0 + 0.1 * float(rng.standard_normal()) for name in robot.joint_names})
        law = who_knows(true, learner) if knows else controller
        loops.append(touching(law, robot=true, touch=touch, duration=0.3, nominal=robot, check_gains=False))
    runs = simulate_many(loops, keep=True, workers=2)
    seen = [one.recording for one in runs]  # a last body that is too heavy is felt as a load
    felt = np.mean([np.maximum(one["contact"], one["load"] > 0.0)[75:].mean() for one in seen])
    above = felt - rate
    assert (above if knows else abs(above)) < 3.0 * np.sqrt(rate * (1.0 - rate) / len(runs)), felt


def test_what_psi_hat_replaces_goes_out_of_the_doubt_and_friction_of_what_stands_stays():
    """Numpy's squares of parts less their share; what a body adds to Psi is Psi of a heavier one less Psi."""
    robot = thesis_robot()
    observer, row, layout = somewhere(touching(PD(), touch=Touch(masses=0.2), robot=robot))
    observer = observer._replace(numbers=observer.numbers._replace(model=BOTH))
    s, rng, p = observer.state, np.random.default_rng(3), layout.dof
    row[layout.where("nu_ref")], row[layout.where("nudot_ref")] = rng.normal(size=(2, p))
    remember(row, layout.offsets, np.zeros(p), True, observer)
    heavier = robot.with_masses({robot.joint_names[0]: 1.2})
    psi = np.zeros((2, p))
    for each, out in zip((robot, heavier), psi, strict=True):
        twin = Twin(each)
        twin.refresh(observer.position, observer.nu)
        twin.refresh_psi(row[layout.where("nu_ref")], row[layout.where("nudot_ref")], out)
    assert any(np.allclose(each, psi[1] - psi[0], rtol=1e-9, atol=1e-12) for each in s.asked)
    for each in (s.parts, s.spared):
        each[:] = rng.normal(size=each.shape)
    known = observer.known
    observer.dry[:] = 2.0
    own, s.noise[:], s.driven[:] = rng.uniform(0.1, 3.0, p), 0.0, 0.0
    s.learned[:] = np.diag(own)
    judge(row, layout.offsets, observer)
    whole = np.diag(s.parts.T @ s.parts)
    share = whole / (whole + own)
    left = s.parts - share * s.spared
    slides = np.abs(np.tanh(known.joints @ observer.nu / known.coulomb_speed))
    stands = (observer.dry * (1.0 - slides))[:, None] * known.joints
    expected = left.T @ left + np.diag(share**2 * own + observer.floor**2) + stands.T @ stands
    np.testing.assert_allclose(observer.S, expected, rtol=1e-9)


def weighed(observer, mass, centre, noise=0.0, samples=40):
    """Samples of what a load brings in random postures, into the fit; whether it is one, and all that was told."""
    rng, s, p, told = np.random.default_rng(4), observer.state, observer.nu.size, []
    s.fit[:], s.clock[ELAPSED] = 0.0, 0.01
    for _ in range(samples):
        s.brings[:] = rng.normal(size=(4, p))
        raw = s.brings.T @ (mass * np.array([1.0, *centre])) + noise * rng.normal(size=p)
        told.append((s.brings.copy(), raw))
        fit_load(raw, np.zeros(p), observer)
    return is_load(observer), told


def test_a_load_is_the_least_squares_of_what_is_felt_fading_in_the_metric_of_the_band():
    """The closed form by numpy of all samples at once: `(sum k Y S^-1 Y')^-1 sum k Y S^-1 r`."""
    observer = somewhere(touching(PD(), robot=load("platform_arm"), trajectory=Trajectory.of(load("platform_arm"))))[0]
    observer.felt[:] = 1.0
    found, told = weighed(observer, 0.4, (0.1, -0.05, 0.02), noise=0.02)
    keep = np.exp(-0.01 / FORGETS) ** np.arange(len(told))[::-1]
    inverse = np.linalg.inv(observer.S)
    A = sum(k * Y @ inverse @ Y.T for k, (Y, _) in zip(keep, told, strict=True))
    b = sum(k * Y @ inverse @ r for k, (Y, r) in zip(keep, told, strict=True))
    assert found
    np.testing.assert_allclose(observer.state.load, np.linalg.solve(A, b), rtol=1e-5)
    np.testing.assert_allclose(observer.state.load[0], 0.4, rtol=0.1)


def test_a_load_weighs_something_no_more_than_the_arm_and_lies_within_reach():
    observer = somewhere(touching(PD()))[0]
    heaviest = observer.numbers.heaviest
    assert heaviest == pytest.approx(load_mass(thesis_robot()))
    for mass, centre, wanted in (
        (0.99 * heaviest, (0.1, 0.0, 0.0), True),
        (1.01 * heaviest, (0.1, 0.0, 0.0), False),
        (-0.1, (0.1, 0.0, 0.0), False),
        (0.5 * heaviest, (0.49, 0.0, 0.0), True),
        (0.5 * heaviest, (0.51, 0.0, 0.0), False),
    ):
        assert weighed(observer, mass, centre)[0] == wanted, (mass, centre)


def load_mass(robot):
    """What the bodies of the arm weigh, by Pinocchio [kg]."""
    names = list(robot.model.names)
    return sum(robot.model.inertias[names.index(name)].mass for name in robot.joint_names)


def test_a_second_contact_while_the_first_is_felt_is_felt_beside_it_and_is_no_new_one():
    """Two pushes that overlap: both forces are told, there is one contact, and what was learned goes back once."""
    first, second = (
        Push(on="arm_1_joint", force=3.0, start=0.02),
        Push(on="arm_2_joint", force=-2.0, start=0.1, end=0.16),
    )
    touch = Touch(bandwidth=500.0, masses=0.0, friction=0.0, torque=0.0, unknown=1e-3, clear=0.02)
    run = touching(touch=touch, disturbances=(first, second), duration=0.2, check_gains=False).run()
    felt, t = np.ravel(run["contact"]) > 0.0, run["time"]
    assert felt[t > 0.03].all() and not felt[t < 0.019].any()
    both = (t > 0.13) & (t < 0.159)
    np.testing.assert_allclose(run["external_torque"][both], np.tile([0.0, 0.0, 3.0, -2.0], (both.sum(), 1)), atol=0.02)
    alone = t > 0.19
    np.testing.assert_allclose(run["external_torque"][alone, 2:], np.tile([3.0, 0.0], (alone.sum(), 1)), atol=0.02)


def test_alarms_are_a_quantile_of_chi_squared():
    assert observer_of(touching(touch=Touch(false_alarms=0.01)))[0].numbers.threshold == pytest.approx(
        chi2.isf(0.01, 4)
    )


def test_both_engines_and_a_stepper_feel_the_same():
    push = Push(on="arm_1_joint", force=30.0, start=0.05, end=0.12)
    made = touching(duration=0.02 if SLOW else 0.2, disturbances=(push,))
    runs = [replace(made, engine=engine).run() for engine in ("compiled", "ordinary")]
    for signal in ("external_torque", "external_band", "external_wrench", "wrench_seen", "contact"):
        np.testing.assert_array_equal(runs[0][signal], runs[1][signal])


def test_a_stepper_tells_what_it_feels():
    """Fed with a run's measurements it sends its torques and feels its pushes."""
    made = touching(duration=0.02 if SLOW else 0.2, safety=Safety(), disturbances=(Push(on="arm_1_joint", force=9.0),))
    run, layout = made.run(), made.layout
    with Stepper.of(made) as stepper:
        for k, time in enumerate(run["time"]):
            seen = Measurement(*(run[name][k] for name in ("pose", "velocity", "q", "qdot")))
            asked = Setpoint(
                *(run[f"{name}_ref"][k] for name in ("pose", "velocity", "acceleration", "q", "qdot", "qddot"))
            )
            stepper.step(time, seen, asked)
            np.testing.assert_allclose(stepper.external_torque, run["external_torque"][k], atol=1e-6)
        assert stepper.is_touched == bool(run["contact"][-1]) and stepper.external_wrench.shape == (6,)
    assert layout.touch == 1


def test_a_run_resumes_with_what_was_felt():
    whole = touching(duration=0.02 if SLOW else 0.2, disturbances=(Push(on="arm_1_joint", force=9.0),))
    half = 0.01 if SLOW else 0.1
    begun = replace(whole, timing=Timing(duration=half)).run()
    resumed = whole.run(
        state=begun.final.get("state"),
        plant_state=(begun.final["position"], begun.final["nu"]),
        hardware_state=begun.final["hardware_state"],
        first=round(half / whole.timing.control_period),
    )
    straight = whole.run()
    np.testing.assert_array_equal(resumed["external_torque"], straight["external_torque"][-len(resumed["time"]) :])


def test_what_pushed_and_is_gone_is_let_go_slowly():
    """Beside PD's own torque what was felt last, less what is felt, fades as `settle` says; nothing while pushed."""
    touch = Touch(bandwidth=500.0, masses=0.0, friction=0.0, torque=0.0, unknown=1e-3, clear=0.0, settle=0.05)
    push = Push(on="arm_1_joint", force=8.0, start=0.012, end=0.03)
    run = touching(PD(SOFT), touch=touch, disturbances=(push,), duration=0.2, check_gains=False).run()
    s = np.hstack((run["z"], run["r"]))
    beside, felt = run["torque"] - np.array([100.0, 100.0, 5.0, 1.0]) * s, np.ravel(run["contact"])
    last = int(np.flatnonzero(felt)[-1])
    stood, after = run["external_torque"][last], run["time"] - run["time"][last]
    share = np.exp(-after[last + 1 :, None] / 0.025)
    expected, fading = share * (stood - run["external_torque"][last + 1 :]), share[:, 0] > 0.02
    assert stood[2] > 0.1 and not np.any(np.abs(beside[: last + 1]) > 1e-9)
    np.testing.assert_allclose(beside[last + 1 :][fading], expected[fading], atol=1e-9)
    assert fading.any() and not np.any(np.abs(beside[-1]) > 1e-9)


def test_a_measurement_that_is_none_begins_anew():
    observer, row, layout = somewhere(touching(PD()))
    row[layout.where("q")] = np.nan
    feel(row, layout.offsets, 0.002, observer)
    assert observer.state.clock[COUNT] == 0.0
    row[layout.where("q")] = 0.1
    feel(row, layout.offsets, 0.004, observer)
    assert (
        observer.state.clock[COUNT] == 1.0 and not observer.state.residual.any() and observer.state.clock[TIME] == 0.004
    )


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"bandwidth": -1.0}, "touch.bandwidth"),
        ({"false_alarms": 1.5}, "share below 1"),
        ({"masses": float("nan")}, "touch.masses"),
    ],
)
def test_numbers_out_of_range_are_one_line(given, words):
    with pytest.raises(ConfigError, match=words):
        Touch(**given)


def test_a_hand_that_cannot_feel_is_one_line():
    with pytest.raises(UnknownName, match="link or joint 'paw'"):
        touching(touch=Touch(hand="paw")).run()
    robot = load("two_axis_arm")
    with pytest.raises(ConfigError, match="stands still"):
        loop(PD(Feedback(0.0, 1.0)), robot=robot, touch=Touch(hand=robot.model.frames[1].name)).run()
    with pytest.raises(ConfigError, match="Psi_hat of the controller"):
        touching(PD(), touch=Touch(model="learner")).run()
