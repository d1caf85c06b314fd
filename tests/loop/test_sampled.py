"""The verdict on the sampled PD loop, against simulation of the held loop: linear here, nonlinear in the run."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from robots import fixed_arm
from scipy.signal import cont2discrete

from mmnn_pin.errors import ConfigError
from mmnn_pin.kinematic import Kinematic
from mmnn_pin.loop import sampled
from mmnn_pin.loop.before_run import Start
from mmnn_pin.loop.latency import Latency
from mmnn_pin.loop.loop import Loop
from mmnn_pin.loop.sampled import HeldLoop, Machinery, SampledLoop, sampled_loop
from mmnn_pin.loop.sight import VelocityFilter
from mmnn_pin.loop.stable_gains import require_stable
from mmnn_pin.loop.stepper import Stepper, StepperSettings
from mmnn_pin.loop.suited import LoopToSuit, suited
from mmnn_pin.model import Robot, load
from mmnn_pin.model.base.base import Fixed, LinearErrors
from mmnn_pin.model.base.differential import DifferentialDrive
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.reference import Hold, Line, Trajectory
from mmnn_pin.sensing import Sensor
from mmnn_pin.settings import Timing
from mmnn_pin.signals import Array
from mmnn_pin.torque.controller import Feedback
from mmnn_pin.torque.model_based import PD, ComputedTorque

STILL = Fixed.linear_errors(np.zeros(0), np.zeros(0))
PLAIN = os.environ.get("NUMBA_DISABLE_JIT") == "1"  # plain Python: short runs only


def held_loop(
    M: Array, gains: Array, v_ref: Array, base_gains: Array, K: Array, h: float, friction: Array
) -> tuple[Array, Array, Array]:
    """Deviations `[ex, ey, ephi; e; nu]` over one period, written down equation by equation: Phi, Gamma, feedback."""
    n, nb = K.size, v_ref.size
    p, poses = n + nb, 3 if nb else 0

    def rate(d: Array, torque: Array) -> Array:
        pose, nu = d[:poses], d[poses + n :]
        edot = -nu[nb:]
        posedot = np.zeros(0)
        if nb:
            (vr, wr), (ex, ey, ephi), (v, w) = v_ref, pose, nu[:2]
            posedot = np.array([wr * ey - v, -wr * ex + vr * ephi, -w])
        return np.concatenate((posedot, edot, np.linalg.solve(M, torque - friction * nu)))

    def torque(d: Array) -> Array:
        pose, e, nu = d[:poses], d[poses : poses + n], d[poses + n :]
        alpha = np.zeros(0)
        if nb:
            (kx, ky, kth), (vr, _), (ex, ey, ephi) = base_gains, v_ref, pose
            alpha = np.array([kx * ex, vr * ky * ey + abs(vr) * kth * ephi])
        return gains * (np.concatenate((alpha, K * e)) - nu)

    size = poses + n + p
    columns = np.eye(size)
    A = np.stack([rate(d, np.zeros(p)) for d in columns], axis=1)
    B = np.stack([rate(np.zeros(size), u) for u in np.eye(p)], axis=1)
    Phi, Gamma, *_ = cont2discrete((A, B, np.eye(size), np.zeros((size, p))), h, "zoh")
    return Phi, Gamma, np.stack([torque(d) for d in columns], axis=1)


def judged(loop: dict[str, Array | float]) -> dict[str, Any]:
    """The same with the law of the base in the place of its reference and gains."""
    rest = {name: value for name, value in loop.items() if name not in ("v_ref", "base_gains", "friction")}
    base = DifferentialDrive if np.size(loop["v_ref"]) else Fixed
    rest |= {"machinery": Machinery(np.asarray(loop["friction"]))}  # type: ignore[dict-item]
    return rest | {"law": base.linear_errors(np.asarray(loop["v_ref"]), np.asarray(loop["base_gains"]))}


def random_loop(seed: int, nb: int) -> dict[str, Array | float]:
    rng = np.random.default_rng(seed)
    p = nb + 2
    root = rng.normal(size=(p, p))
    return {
        "M": root @ root.T + 2 * np.eye(p),
        "gains": rng.uniform(1, 100, p),
        "v_ref": rng.uniform(-1, 1, nb),
        "base_gains": rng.uniform(1, 20, 3),
        "K": rng.uniform(1, 10, 2),
        "h": rng.uniform(0.001, 0.1),
        "friction": rng.uniform(0, 3, p),
    }


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 2**31), st.sampled_from([0, 2]))
def test_radius_is_the_growth_of_the_held_loop(seed: int, nb: int) -> None:
    """Growth over many periods of the loop, simulated from a random deviation."""
    loop = random_loop(seed, nb)
    Phi, Gamma, feedback = held_loop(**loop)  # type: ignore[arg-type]
    closed, periods = Phi + Gamma @ feedback, 2**14
    power, log_scale = closed.copy(), 0.0
    for _ in range(14):  # squaring, rescaled so that nothing overflows
        power = power @ power
        scale = np.linalg.norm(power)
        power, log_scale = power / scale, 2 * log_scale + np.log(scale)
    verdict = sampled_loop(**judged(loop))  # type: ignore[arg-type]
    assert np.log(verdict.radius) == pytest.approx(log_scale / periods, abs=2e-3)


@settings(deadline=None)
@given(st.floats(0.1, 1e3), st.floats(1e-4, 0.1), st.floats(0.01, 3.0))
def test_one_mass_is_stable_up_to_twice_its_mass_over_the_period(mass: float, h: float, fraction: float) -> None:
    """`nu_next = (1 - h k / M) nu`: the limit is k = 2 M / h."""
    gain = fraction * 2 * mass / h
    verdict = sampled_loop(np.array([[mass]]), np.array([gain]), STILL, np.zeros(1), h)
    assert verdict.gain_limits == pytest.approx([2 * mass / h])
    assert verdict.radius == pytest.approx(max(1.0, abs(1 - 2 * fraction)), rel=1e-9)  # 1: the position, without K
    if abs(fraction - 1) > 1e-6:
        assert verdict.stable == (fraction < 1)


@settings(deadline=None)
@given(st.floats(0.05, 1.5), st.floats(0.05, 1.5))
def test_one_joint_with_position_gain(k: float, K: float) -> None:
    """`z^2 + (a + b - 2) z + 1 - a + b`, a = h k / M, b = a h K / 2: stable while k < 2 M / h and K < 2 / h."""
    M, h = 3.0, 0.02
    a = 2 * k
    b = a * K
    verdict = sampled_loop(np.array([[M]]), np.array([a * M / h]), STILL, np.array([2 * K / h]), h)
    assert verdict.radius == pytest.approx(np.abs(np.roots([1, a + b - 2, 1 - a + b])).max(), rel=1e-7)
    if min(abs(k - 1), abs(K - 1)) > 1e-6:
        assert verdict.stable == (max(k, K) < 1)


def test_friction_makes_a_held_mass_decay() -> None:
    M, h, k, D = 2.0, 0.05, 90.0, 3.0
    decay = np.exp(-h * D / M)
    radius = {
        friction is not None: sampled_loop(
            np.array([[M]]), np.array([k]), STILL, np.zeros(1), h, Machinery(friction)
        ).radius
        for friction in (np.array([D]), None)
    }
    assert radius[True] == pytest.approx(abs(decay - k * (1 - decay) / D))
    assert radius[False] == pytest.approx(abs(1 - h * k / M))


def test_lateral_error_is_neither_stable_nor_unstable_at_rest_and_reverse_equals_forward() -> None:
    M, gains, K = np.diag([100.0, 8.0, 1.0]), np.array([500.0, 300.0, 30.0]), np.array([7.0])
    thesis = np.array([10.0, 64.0, 16.0])

    def law(vr: float) -> LinearErrors:
        return DifferentialDrive.linear_errors(np.array([vr, 0.0]), thesis)

    radius = {vr: sampled_loop(M, gains, law(vr), K, 0.002).radius for vr in (-0.3, 0.0, 0.3)}
    assert radius[0.0] == pytest.approx(1, abs=1e-9)
    assert radius[0.3] < 1 - 1e-4
    assert radius[-0.3] == pytest.approx(radius[0.3])


def test_refusal_tells_the_numbers() -> None:
    verdict, gains = SampledLoop(1.25, np.array([100.0, 400.0])), np.array([90.0, 20.0])
    with pytest.raises(ConfigError, match=r"radius 1.25 > 1, the torque held for 0.01 s") as refused:
        require_stable(verdict, gains, ("v", "w"), 0.01)
    assert "v: 90 (limit alone 100)" in str(refused.value)
    assert "w: 20" not in str(refused.value)
    assert refused.value.key == "feedback"
    with pytest.raises(ConfigError, match="none, the kinematic gains"):
        require_stable(verdict, gains / 100, ("v", "w"), 0.01)
    require_stable(SampledLoop(1.0, gains), gains, ("v", "w"), 0.01)


def numbers_of(text: str) -> Feedback:
    """Gains that a refusal says."""
    found = re.search(r"feedback=(Feedback\((?:[^()]|\([^()]*\))*\))", text)
    assert found, text
    made = eval(found[1], {"Feedback": Feedback})
    assert isinstance(made, Feedback)
    return made


@settings(deadline=None, max_examples=10)
@given(st.floats(1.0, 1e5), st.floats(1.0, 1e4))
def test_gains_that_a_refusal_says_hold(base: float, arm: float) -> None:
    """As `Stepper` judges them, at ten postures; a gain that is not to blame stays."""
    robot = load("platform_arm")
    try:
        Stepper(robot, PD(Feedback(base, arm)), StepperSettings(period=H)).finish()
    except ConfigError as refused:
        assert "mmnn inspect ROBOT --gains" in refused.fix
        found = numbers_of(refused.fix)
        Stepper(robot, PD(found), StepperSettings(period=H)).finish()
        change = found.vector(robot.dimensions) / Feedback(base, arm).vector(robot.dimensions)
        assert (change <= 1.0).all() if "lower them" in refused.fix else (change > 1.0).any()
        assert "they are too low" not in refused.why or "change them" in refused.fix


# --- the real loop

H = 0.02


def standing(robot: Robot, feedback: Feedback, check_gains: bool, seconds: float) -> Loop:
    """A robot whose arm should stay as it is: the mass matrix of the run is the one that is judged."""
    seconds = 2 * H if PLAIN else seconds
    return Loop(
        robot,
        Trajectory(Line(0.3) if robot.dimensions.base else None, (Hold(0.4),) * robot.dimensions.arm),
        PD(feedback),
        timing=Timing(duration=seconds, control_period=H, plant_step=H / 10),
        start=Start(pose_offset=(-1e-6, 0.0, 0.0), joint_offset=1e-6, moving=True),
        check_gains=check_gains,
        engine="ordinary",
    )


def verdict(loop: Loop, gains: Array) -> SampledLoop:
    robot = loop.robot
    M = Dynamics(robot).mass_matrix(loop.start.state(robot, loop.table()[0])[0])
    law = robot.base.linear_errors(np.array([0.3, 0.0]), loop.kinematic.base_gains(robot.dimensions))
    return sampled_loop(M, gains, law, loop.kinematic.arm_gains(robot.dimensions), H)


def limit(robot: Robot, feedback: Callable[[float], Feedback]) -> float:
    """Scale of the gains at which the judged radius is 1, by bisection."""
    loop, low, high = standing(robot, feedback(1.0), False, H), 1e-3, 1e3
    for _ in range(60):
        middle = np.sqrt(low * high)
        stable = verdict(loop, feedback(middle).vector(robot.dimensions)).stable
        low, high = (middle, high) if stable else (low, middle)
    return low


def all_gains(scale: float) -> Feedback:
    return Feedback(500.0 * scale, 30.0 * scale)


def forward_gain(scale: float) -> Feedback:
    return Feedback((500.0 * scale, 200.0), 2.0)


@pytest.mark.parametrize(
    ("name", "feedback"),
    [("platform_arm", all_gains), ("two_axis_arm", all_gains), ("platform_arm", forward_gain)],
    ids=["platform_arm", "two_axis_arm", "platform_forward"],
)
def test_deviations_grow_above_the_limit_at_the_judged_rate_and_shrink_below(
    name: str, feedback: Callable[[float], Feedback]
) -> None:
    robot = load(name)
    scale = limit(robot, feedback)
    above = feedback(1.05 * scale)
    with pytest.raises(ConfigError, match=r"the sampled PD loop is unstable: spectral radius 1[.]"):
        standing(robot, above, True, 1.6).run()
    calm, wild = standing(robot, feedback(0.95 * scale), True, 3.2).run(), standing(robot, above, False, 2.0).run()
    assert calm.outcome.status == "completed"
    if PLAIN:
        return  # too short to tell
    deviations = [np.linalg.norm(run["nu"] - run["nu_ref"], axis=1) for run in (calm, wild)]
    assert deviations[0][-1] < 0.3 * deviations[0].max()
    per_sample = (deviations[1][90] / deviations[1][50]) ** (1 / 40)
    judged = verdict(standing(robot, above, False, H), above.vector(robot.dimensions)).radius
    assert judged > 1.05
    assert per_sample == pytest.approx(judged, rel=0.01)


@pytest.mark.skipif(PLAIN, reason="too long a run for plain Python")
def test_a_base_above_its_limit_leaves_its_bounds() -> None:
    """The mass of the base does not depend on the arm, so nothing stops the growth."""
    robot = load("platform_arm")
    gains = forward_gain(1.05 * limit(robot, forward_gain))
    run = standing(robot, gains, False, 8.0).run()
    assert run.outcome.status == "diverged"
    assert 0.5 < run.outcome.time < 8.0


# -- delay -------------------------------------------------------------------------------------------------------------


@settings(deadline=None, max_examples=20)
@given(st.floats(0.1, 50.0), st.floats(1.0, 200.0), st.floats(0.0, 20.0))
def test_margin_of_one_joint_is_the_phase_margin_of_the_textbook(mass: float, bandwidth: float, K: float) -> None:
    """`bandwidth (s + K) / s^2` held for a short period: crossing at w, `(atan(w / K)) / w - h / 2` left."""
    h = 1e-5
    held = loop_of_one(mass, K, h)
    w = np.sqrt(0.5 * (bandwidth**2 + np.sqrt(bandwidth**4 + 4 * (bandwidth * K) ** 2)))
    assert held.margin(np.array([mass * bandwidth]), h, False) == pytest.approx(np.arctan2(w, K) / w - h / 2, rel=1e-3)


def loop_of_one(
    mass: float, K: float, h: float, lag: Array | None = None, sight: VelocityFilter | None = None
) -> HeldLoop:
    """One joint."""
    held = sampled.held_loop(np.array([[mass]]), STILL, np.array([K]), h, Machinery(None, lag, None, sight))
    assert held is not None
    return held


@settings(deadline=None, max_examples=15)
@given(st.integers(0, 2**31), st.sampled_from([0, 2]), st.integers(1, 4), st.booleans())
def test_margin_in_whole_periods_is_where_the_delayed_loop_turns_unstable(
    seed: int, nb: int, periods: int, inside: bool
) -> None:
    """Against the eigenvalues of the loop with its last torques as further states."""
    loop = random_loop(seed, nb) | {"h": 0.01}
    gains = np.asarray(loop["gains"]) * 0.2
    held = sampled.held_loop(**{name: value for name, value in judged(loop).items() if name != "gains"})
    assert held is not None
    margin, F = held.margin(gains, 0.01, inside), held.feedback(gains, inside)
    k, p = len(held.state), len(gains)
    shifted = np.zeros((k + periods * p, k + periods * p))
    shifted[:k, :k], shifted[:k, k : k + p] = held.state, held.torque  # the oldest torque acts now
    shifted[k : k + (periods - 1) * p, k + p :] = np.eye((periods - 1) * p)
    shifted[k + (periods - 1) * p :, :k] = F
    radius = np.abs(np.linalg.eigvals(shifted)).max()
    if abs(margin / (periods * 0.01) - 1) > 0.01:
        assert (radius <= 1 + 1e-7) == (margin > periods * 0.01)


def test_a_lagging_motor_costs_margin() -> None:
    """`20 / (s (1 + T s))`: the crossing solves `w sqrt(1 + (w T)^2) = 20`, where `pi / 2 - atan(w T)` is left."""
    h, mass, gain = 1e-5, 2.0, np.array([40.0])
    for lag in (0.002, 0.02):
        found = loop_of_one(mass, 0.0, h, np.array([lag])).margin(gain, h, False)
        w = np.sqrt((np.sqrt(1 + 4 * (20.0 * lag) ** 2) - 1) / 2) / lag
        assert found == pytest.approx((np.pi / 2 - np.arctan(w * lag)) / w - h / 2, rel=1e-3)


class Measured:
    """A joint whose motor lags, its torque some periods late, its rate made of the encoder: written step by step."""

    def __init__(self, sensor: Sensor, h: float, parts: int, lag: float, periods: int) -> None:
        self.sensor, self.h, self.parts, self.lag, self.periods = sensor, h, parts, lag, periods
        A = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0 / lag]])  # q, nu, torque over the mass
        held = cont2discrete((A, np.array([[0.0], [0.0], [1.0 / lag]]), np.eye(3), np.zeros((3, 1))), h / parts, "zoh")
        self.Phi, self.Gamma = held[0], held[1][:, 0]

    def next(self, x: Array, bandwidth: float, K: float, inside: bool) -> Array:
        """`[q, nu, torque, reading, tracked angle, rate, torques under way]` of the next control sample."""
        q, reading, tracked, rate, T = x[:3], x[3], x[4], x[5], self.h / self.parts
        asked = -bandwidth * (K * q[0] + rate) - (K * rate if inside else 0.0)
        acts = x[6] if self.periods else asked
        for _ in range(self.parts):
            q = self.Phi @ q + self.Gamma * acts
            moved, reading = q[0] - reading, q[0]
            wc = self.sensor.bandwidth
            if self.sensor.velocity == "observer":
                pole = np.exp(-wc * T)
                off = reading - (tracked + T * rate)
                tracked += T * rate + (1.0 - pole**2) * off
                rate += (1.0 - pole) ** 2 / T * off
            else:
                alpha = wc * T / (1.0 + wc * T) if self.sensor.velocity == "filtered" else 1.0
                tracked, rate = 0.0, rate + alpha * (moved / T - rate)
        return np.concatenate((q, [reading, tracked, rate], x[7:], [asked] if self.periods else []))

    def radius(self, bandwidth: float, K: float, inside: bool) -> float:
        """Spectral radius of that map."""
        columns = np.eye(6 + self.periods)
        return float(
            np.abs(np.linalg.eigvals(np.stack([self.next(x, bandwidth, K, inside) for x in columns], 1))).max()
        )


@settings(deadline=None, max_examples=40)
@given(
    st.sampled_from(["filtered", "observer", "difference"]),
    st.floats(30.0, 400.0),
    st.floats(5.0, 60.0),
    st.floats(0.001, 0.02),
    st.integers(1, 3),
    st.integers(0, 3),
    st.booleans(),
)
def test_what_velocities_are_made_of_is_in_the_loop(  # type: ignore[no-untyped-def]
    kind, wc, bandwidth, lag, parts, periods, inside
) -> None:
    """Against the filter's or observer's own steps, several of them in a control period, beside a lag and a delay."""
    h, K, mass = 0.006, 6.0, 0.7
    sensor = Sensor(velocity=kind, bandwidth=wc)
    held = loop_of_one(mass, K, h, np.array([lag]), VelocityFilter.of(sensor, h / parts))
    gains, joint = np.array([mass * bandwidth]), Measured(sensor, h, parts, lag, periods)
    if parts == 1:
        assert held.radius(gains, inside) == pytest.approx(
            Measured(sensor, h, 1, lag, 0).radius(bandwidth, K, inside), abs=1e-6
        )
        margin = held.margin(gains, h, inside)
        if periods and abs(margin / (periods * h) - 1) > 0.01:
            assert (joint.radius(bandwidth, K, inside) <= 1 + 1e-7) == (margin > periods * h)
    elif not periods:  # the mean velocity of the period stands for those of its parts
        assert held.radius(gains, inside) == pytest.approx(joint.radius(bandwidth, K, inside), abs=0.03)


def test_exact_velocities_and_an_observer_on_a_model_are_no_part_of_the_loop() -> None:
    assert VelocityFilter.of(Sensor(), 0.01) is None and VelocityFilter.of(Sensor(velocity="model"), 0.01) is None
    assert VelocityFilter.late(0.0, 0.01) is None
    assert VelocityFilter.late(0.02, 0.001) == VelocityFilter.of(Sensor(velocity="filtered", bandwidth=50.0), 0.001)


def late(share: float, latency: Latency, controller: type = PD) -> Loop:
    """The thesis's robot with joint gains so strong that some milliseconds lose it."""
    timing = Timing(duration=0.5, control_period=0.002, plant_step=0.0005)
    gains = Feedback(base=share * 50.0, arm=share * 80.0, scaling="inertia")
    robot = load("platform_arm")
    made = suited(controller(gains), robot, lambda: LoopToSuit(Kinematic(), 0.002))
    return Loop(robot, Trajectory(Line(speed=0.3), (Hold(0.3), Hold(0.4))), made, timing=timing, latency=latency)


def test_a_latency_that_the_gains_do_not_bear_is_refused_and_the_fix_works() -> None:
    latency = Latency(sensing=0.004, command=0.01, jitter=0.002)
    with pytest.raises(ConfigError, match=r"latency: error: the loop does not bear a latency of 16 ms") as caught:
        late(1.0, latency).run()
    assert "delay margin is" in caught.value.why
    share = float(re.search(r"to ([\d.e-]+) of it", caught.value.fix)[1])  # type: ignore[index]
    assert 0.05 < share < 1.0
    late(share, latency).require_stable_gains()
    with pytest.raises(ConfigError):
        late(1.05 * share, latency).require_stable_gains()
    late(1.0, Latency(command=0.001)).require_stable_gains()


def test_the_feedback_inside_psi_counts() -> None:
    margin = {kind: sampled.delay_margin(late(1.0, Latency(), kind).plan()) for kind in (PD, ComputedTorque)}
    assert 0 < margin[ComputedTorque] < margin[PD] < 0.1


@pytest.mark.parametrize(("name", "value"), [("sensing", -1.0), ("command", np.nan), ("sensing", 0.0031)])
def test_latencies_without_sense_are_one_line(name: str, value: float) -> None:
    with pytest.raises(ConfigError, match=rf"latency\.{name}: error"):
        late(0.1, Latency(**{name: value})).run()


@pytest.mark.compiled
def test_commands_arrive_late_in_order_and_a_resumed_run_is_the_same() -> None:
    """What the motors give is what was commanded that much earlier; with jitter no command overtakes another."""
    loop = late(0.2, Latency(command=0.004))
    run = loop.run()
    sent, given = run["motor_torque"], run["applied"]
    np.testing.assert_allclose(given[2:], sent[:-2], atol=1e-12)
    assert not given[:2].any()
    timing = loop.timing
    order = Latency(command=0.001, jitter=0.007).in_force(timing, np.random.default_rng(0))
    assert (np.diff(order) >= 0).all() and order[0] == -1 and len(order) == 1000
    behind = np.arange(1000) // 4 - order
    assert behind.max() <= 5 and behind.min() >= 0
    jittery = late(0.2, Latency(command=0.001, jitter=0.004))
    whole = jittery.run()
    half = replace(jittery, timing=msgspec.structs.replace(timing, duration=0.25)).run()
    state = half.final
    ordinary = replace(jittery, engine="ordinary").run()
    np.testing.assert_allclose(ordinary["motor_torque"], whole["motor_torque"], atol=1e-7)
    assert state["hardware_state"].shape == whole.final["hardware_state"].shape


HEAVY = Dynamics(fixed_arm(2))


@settings(deadline=None, max_examples=10)
@given(st.floats(20.0, 200.0), st.floats(20.0, 200.0), st.booleans())
def test_an_arm_sags_until_its_springs_hold_it_and_gravity_is_stiff_there(a: float, b: float, held: bool) -> None:
    """Balance of torques, and finite differences of gravity, by Pinocchio; a servo carries what it is given."""
    arm, position, springs = HEAVY.robot.arm_index, HEAVY.robot.neutral_position(), np.array([a, b])
    position[arm] = wanted = np.array([0.3, -0.2])
    free = np.array([1]) if held else np.array([0, 1])
    found = sampled.sag(HEAVY, position, springs, free)
    q, carried = position[arm], np.setdiff1d([0, 1], free)
    assert found is not None and (q[carried] == wanted[carried]).all() and np.abs(q - wanted).max() > 1e-3
    weight = HEAVY.gravity(position)
    np.testing.assert_allclose((springs * (wanted - q))[free], weight[free], atol=1e-4 * np.abs(weight).max())
    for i in free:
        moved = position.copy()
        moved[arm[i]] += 1e-4
        slope = (HEAVY.gravity(moved) - weight) / 1e-4
        np.testing.assert_allclose(found[free, i], slope[free], atol=1e-3 * (1.0 + np.abs(slope).max()))
    assert np.linalg.eigvalsh(np.diag(springs)[np.ix_(free, free)] + found[np.ix_(free, free)]).min() > 0.0


def test_the_stiffness_of_gravity_moves_the_eigenvalues_of_a_pendulum() -> None:
    """`M q'' = -G q`: without a torque it swings at `sqrt(G / M)`."""
    mass, G, h = 2.0, 50.0, 0.01
    held = sampled.held_loop(np.array([[mass]]), STILL, np.array([1.0]), h, stiffness=np.array([[G]]))
    assert held is not None
    assert np.abs(np.angle(np.linalg.eigvals(held.state))) == pytest.approx(np.sqrt(G / mass) * h, rel=1e-9)


@settings(deadline=None, max_examples=25)
@given(st.floats(-40.0, 40.0), st.floats(2.0, 10.0), st.floats(1.0, 7.0), st.floats(1e-3, 0.02))
def test_gravity_that_is_carried_late_is_in_the_margin(G: float, k: float, K: float, h: float) -> None:
    """`M q'' = -G q + tau`, tau some whole periods late as a chain of states: stable up to the margin, not beyond."""
    M, late = 1.3, 30
    A, B = np.array([[0.0, 1.0], [-G / M, 0.0]]), np.array([[0.0], [1.0 / M]])
    Phi, Gamma, *_ = cont2discrete((A, B, np.eye(2), np.zeros((2, 1))), h, "zoh")
    loop, gains = (np.array([[M]]), STILL, np.array([K]), h), np.array([k * M])
    held = sampled.held_loop(*loop, stiffness=np.array([[G]]), carried=True)
    assert held is not None
    margin = held.margin(gains, h, False)
    for delay in range(late):
        chain = np.eye(
            3 + delay, k=1
        )  # behind the state the torques under way, the one that acts first, the new one last
        chain[:2] = np.hstack((Phi, Gamma, np.zeros((2, delay))))
        chain[-1] = np.array([G - k * K * M, -k * M]) @ chain[:2]
        stable = np.abs(np.linalg.eigvals(chain)).max() < 1.0
        if abs(delay * h - margin) > 1e-6:
            assert stable == (delay * h < margin), (delay * h, margin)
