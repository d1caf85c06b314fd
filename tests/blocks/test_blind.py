"""How far a robot goes while no measurement says where it is: never 0.2 rad or 5 cm before the supervisor stops it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import cache
from itertools import product as product_of

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import config
from robots import fixed_arm, mobile_arm

from mmnn_pin import Hold, Line, Measurement, Recording, Sine, Stepper, Trajectory, load, load_experiment
from mmnn_pin.elementary.matrices import product
from mmnn_pin.errors import ConfigError
from mmnn_pin.model.robot import Robot
from mmnn_pin.plant.ideal import IdealPlant
from mmnn_pin.safety import RAMPING, Safety
from mmnn_pin.safety.settings import REACH
from mmnn_pin.torque.entries import ENTRIES

ROBOTS = ["platform_arm", "two_axis_arm", "swerve_arm"]
CONTROLLERS = {"pd_gravity": True, "adaptive": True, "learned": False}  # by name: whether it takes servos
EFFORT = ("effort", "effort")
STIFF = ("velocity", "position of known stiffness")
SERVOS = [EFFORT, ("velocity", "effort"), ("velocity", "velocity"), ("velocity", "position"), STIFF]
QUICK = [
    ("platform_arm", "adaptive", EFFORT),
    ("platform_arm", "pd_gravity", ("velocity", "position")),
    ("two_axis_arm", "learned", EFFORT),
    ("swerve_arm", "pd_gravity", ("velocity", "effort")),
]
KINDS = [  # each compiles a loop of its own
    pytest.param(
        *(name, controller, servos),
        marks=[] if (name, controller, servos) in QUICK else pytest.mark.long,
        id="-".join((name, controller, *servos)),
    )
    for name in ROBOTS
    for controller, takes_servos in CONTROLLERS.items()
    for servos in (SERVOS if takes_servos else [EFFORT])
]
CONTROLLED = [entry.name for entry in ENTRIES if not entry.gain_of]  # the others take gains of a run that is over
LEAST = 0.02  # a silence that no robot may take amiss [s]


@cache
def robot_of(name: str) -> Robot:
    return load(name)


def simulated(robot: Robot, controller: str, start: float, *settings: str) -> Recording:
    """A run whose sensors fall silent at some time."""
    lost = f'disturbances=[{{type="messages", fault="lost", start={start}}}]'
    settings = (f"time.duration={start + 0.6}", "safety.stop_time=0.05", lost, *settings)
    return load_experiment("track", overrides=list(settings)).loop(robot, controller).run()


def interfaces(robot: Robot, servos: tuple[str, ...]) -> list[str]:
    """Settings that give wheels and arm their interfaces."""
    if servos == EFFORT:
        return []
    wheels = robot.actuator_names[: robot.dimensions.motors - robot.dimensions.arm]
    kinds = {joint: servos[joint not in wheels].split()[0] for joint in robot.actuator_names}
    stiff = ["servo.stiffness=200.0", "servo.damping=5.0"] if servos == STIFF else []
    return ["interfaces={" + ", ".join(f'"{joint}"="{kind}"' for joint, kind in kinds.items()) + "}", *stiff]


def gone(robot: Robot, step: np.ndarray) -> float:
    """A change of position, as a share of what may be gone unseen: the base [m, rad], joints, pivots with a motor."""
    slide, turn = REACH
    d = robot.dimensions
    base = [math.hypot(step[0], step[1]) / slide, abs(step[2]) / turn] if d.base else []
    return max([*base, *np.abs(step[robot.arm_index]) / turn])


@pytest.mark.compiled
@pytest.mark.parametrize(("name", "controller", "servos"), KINDS)
@given(
    start=st.integers(10, 100).map(lambda k: 0.01 * k),
    period=st.sampled_from([0.0, 0.01, 0.02]),
    seed=st.integers(0, 99),
)
@settings(max_examples=20, derandomize=True)
def test_no_joint_and_no_base_goes_far_before_a_silence_is_seen(name, controller, servos, start, period, seed) -> None:
    robot = robot_of(name)
    chosen = [f"seed={seed}", f"start.pose_offset=[{0.0002 * seed}, 0.0, 0.0]"] if robot.dimensions.base else []
    if period:
        chosen.append(f"time.sensor_period={period}")
    run = simulated(robot, controller, start, *chosen, *interfaces(robot, servos))
    assert run.outcome.status == "tripped" and run.outcome.signal == "measurement"
    h = run.time[1] - run.time[0]
    every = period or h
    heard = round(every * math.floor((start - 1e-6) / every) / h)
    seen = int(np.argmax(run["safety"].ravel() == RAMPING))
    assert seen > heard and gone(robot, run["position"][seen] - run["position"][heard]) <= 1.0
    assert run.time[seen] - run.time[heard] > LEAST


EVERY = [  # in turn, so that every controller and every interface is among the quick ones
    pytest.param(name, *servos, marks=[] if (k + i) % len(SERVOS) == 0 else pytest.mark.long)
    for k, name in enumerate(CONTROLLED)
    for i, servos in enumerate(SERVOS)
]


@pytest.mark.skipif(not config.DISABLE_JIT, reason="each compiles a loop of its own")
@pytest.mark.parametrize(("controller", "wheels", "arm"), EVERY)
def test_that_holds_for_every_controller_on_every_interface(controller: str, wheels: str, arm: str) -> None:
    robot, servos = robot_of("platform_arm"), (wheels, arm)
    rng = np.random.default_rng(len(controller) + 7 * SERVOS.index(servos))
    start = 0.002 * int(rng.integers(15, 50))
    steps = [f"time.{name}=0.002" for name in ("control_period", "plant_step")]
    try:
        run = simulated(robot, controller, start, *steps, "safety.stop_time=0.01", *interfaces(robot, servos))
    except ConfigError as error:
        assert servos != EFFORT and "a servo of which no stiffness is known does not tell it" in str(error)
        return
    assert run.outcome.status == "tripped" and run.outcome.signal == "measurement"
    heard, seen = round(start / 0.002) - 1, int(np.argmax(run["safety"].ravel() == RAMPING))
    assert seen > heard and gone(robot, run["position"][seen] - run["position"][heard]) <= 1.0


# -- one robot, sample by sample -------------------------------------------------------------------------------------

ROBOT = load("platform_arm")
H = 0.002
LIMITS = Safety(torque="urdf", joint_error=0.5, position_error=0.5)


Put = Callable[[int, list[Measurement]], tuple[Measurement | None, float | None]]


def driven(controller: str, safety: Safety, seconds: float, put: Put) -> Iterator[tuple[Stepper, IdealPlant]]:
    """Samples of a robot in motion; `put` says what is sent at sample k of all that was true so far, and its time."""
    overrides = [f"time.control_period={H}", f"time.plant_step={H}"]
    stepper = Stepper.of(load_experiment("track", overrides=overrides).loop(ROBOT, controller), safety=safety)
    plant, seen = IdealPlant(ROBOT, H, "implicit_friction"), list[Measurement]()
    plant.start(ROBOT.neutral_position(), np.zeros(4))
    arm = dict(zip(ROBOT.joint_names, (Sine(amplitude=0.4, period=4.0), Hold(0.2)), strict=True))
    motion = stepper.plan(Trajectory.of(ROBOT, base=Line(speed=0.3), arm=arm), 5.0)
    for k in range(round(seconds / H)):
        position, nu = plant.position.copy(), plant.nu.copy()
        seen.append(Measurement(position[:3], nu[:2], position[ROBOT.arm_index], nu[2:]))
        taken, measured = put(k, seen)
        command = stepper.step(k * H, taken, motion if k == 0 else None, measured=measured)
        yield stepper, plant
        plant.step(product(ROBOT.E, command.motor_effort))
        plant.refresh()


def samples(controller: str, safety: Safety, deaf: float, kind: str) -> Iterator[tuple[Stepper, IdealPlant]]:
    """Samples of a robot in motion, whose measurements or parts of them stop, repeat or get old from a time on [s]."""

    def put(k: int, seen: list[Measurement]) -> tuple[Measurement | None, float | None]:
        now, last = seen[-1], seen[min(k, round(deaf / H))]
        base, arm = now if "arm" in kind else last, now if "base" in kind else last
        measured = min(k * H, deaf) if " is silent" in kind else None
        is_lost = kind == "silent" and last is not now
        return None if is_lost else Measurement(base.pose, base.velocity, arm.q, arm.qdot), measured

    return driven(controller, safety, deaf + 0.8, put)


@pytest.mark.parametrize(
    "kind", ["silent", "repeated", "arm is silent", "base is silent", "arm repeats", "base repeats"]
)
@pytest.mark.parametrize("controller", ["pd_gravity", "adaptive"])
def test_on_a_robot_silent_sensors_and_messages_that_repeat_are_seen_before_it_went_far(controller, kind) -> None:
    """A part that is measured may move on; then it comes to rest by what is measured."""
    went, speed, seen = [], 0.0, np.array(["arm" in kind] * 3 + ["base" in kind] * 4)
    for stepper, plant in samples(controller, LIMITS, 0.5, kind):
        if stepper.time < 0.5:
            start = plant.position.copy()
        if not stepper.tripped:
            went.append(gone(ROBOT, np.where(seen, 0.0, plant.position - start)))
        else:
            speed = max(speed, np.abs(plant.nu).max())
            if kind in ("silent", "repeated") and stepper.time > 0.5 + LEAST:
                assert stepper.row[stepper.setup.layout.where("safety")] == RAMPING
    assert stepper.tripped and (0.3 if "silent" in kind else 0.0) < max(went) < 1.0
    assert speed < 8.0  # on what was asked of frozen measurements this arm comes to 60 rad/s
    assert np.abs(plant.nu[:2]).max() < 0.02 or "arm" not in kind
    assert np.abs(plant.nu[2:]).max() < 0.2 or "base" not in kind
    assert "no new measurement says where" in stepper.finish().outcome.message


STANDS = {  # what stays as it was, what of its velocity is sent, and how many measurements it goes through
    "joint at rate 0": (["arm_1_joint"], 0.0, 1),
    "joint alternates": (["arm_1_joint"], 1.0, 2),
    "base at rate 0": (["base"], 0.0, 1),
    "base alternates": (["base"], 1.0, 2),
    "all alternates": (["base", *ROBOT.joint_names], 1.0, 2),
}


UNMET = pytest.mark.xfail(strict=True, reason="from the first message on it goes 0.23 rad: docs/how-to/faults.md")
FROZEN = [
    pytest.param(*case, marks=UNMET if case == ("pd_gravity", "all alternates", 0) else [])
    for case in product_of(["pd_gravity", "adaptive"], STANDS, [0, 10, 250])
]


@pytest.mark.parametrize(("controller", "kind", "start"), FROZEN)
def test_on_a_robot_what_stands_or_goes_back_and_forth_is_seen_before_it_went_far(controller, kind, start) -> None:
    """From a sample on, the first included; the arm's first joint swings with up to 0.6 rad/s."""
    parts, share, several = STANDS[kind]
    arm, went, origin = np.isin(ROBOT.joint_names, parts), 0.0, ROBOT.neutral_position()
    stands = np.array([*["base" in parts] * 3, *arm, False, False])  # of the position

    def put(k: int, seen: list[Measurement]) -> tuple[Measurement, None]:
        now, kept = seen[-1], seen[max(0, min(k, start) - k % several)]
        if k <= start:
            return now, None
        q, qdot = np.where(arm, kept.q, now.q), np.where(arm, share * kept.qdot, now.qdot)
        base, rate = (kept, share) if "base" in parts else (now, 1.0)
        return Measurement(base.pose, rate * base.velocity, q, qdot), None

    for stepper, plant in driven(controller, LIMITS, H * start + 0.8, put):
        if stepper.tripped:
            break
        if stepper.time <= H * start:
            origin = plant.position.copy()
        went = max(went, gone(ROBOT, np.where(stands, plant.position - origin, 0.0)))
    assert stepper.tripped and went < 1.0
    assert "no new measurement says where" in stepper.finish().outcome.message


def test_a_time_that_is_given_holds_alone() -> None:
    for stepper, _ in samples("pd_gravity", Safety(timeout=0.3), 0.5, "silent"):
        if stepper.tripped:
            break
    assert stepper.time == pytest.approx(0.5 + 0.3 + H)
    assert "age of the measurement 0.302 s" in stepper.finish().outcome.message


class Still:
    """A stepper at rest, fed by hand."""

    def __init__(self, **more: float) -> None:
        overrides = [f"time.control_period={H}", f"time.plant_step={H}"]
        loop = load_experiment("track", overrides=overrides).loop(ROBOT, "pid")
        self.stepper, self.k = Stepper.of(loop, safety=Safety(**more)), 0

    def step(self, measurement: Measurement | None, measured: float | None = None) -> bool:
        self.stepper.step(self.k * H, measurement, measured=measured)
        self.k += 1
        return self.stepper.tripped


def test_a_robot_that_rests_may_say_the_same_for_ever() -> None:
    """Its integral winds up against friction meanwhile, and every tenth sample alone has a message."""
    still, seen = Still(), Measurement(np.zeros(3), np.zeros(2), np.array([0.001, 0.0]), np.zeros(2))
    assert not any(still.step(seen if k % 10 == 0 else None) for k in range(3000))


@pytest.mark.parametrize("every", [1, 5, 25])
def test_messages_that_come_as_slowly_as_ever_are_no_silence(every) -> None:
    """At 1 m/s a base goes 5 cm between two of 20 Hz: one that fails to come is too much, none is not."""
    still = Still(joint_error="none", position_error="none", heading_error="none")
    for k in range(800):
        x, v = max(0.0, k - 300) * H, float(k >= 300)
        fast = Measurement(
            np.array([x, 0.0, 0.0]), np.array([v, 0.0]), np.array([0.3 * x, 0.0]), np.array([0.3 * v, 0.0])
        )
        assert not still.step(fast if k % every == 0 else None)
    silent = [still.step(None) for _ in range(60)]
    assert silent[-1] and silent.index(True) <= max(2 * every, 0.06 / H)


@pytest.mark.parametrize("has_stamps", [False, True])
@pytest.mark.parametrize("every", [1, 5, 25])
def test_a_base_may_be_measured_more_seldom_than_joints(every, has_stamps) -> None:
    """At rest, then up to 0.5 m/s, with one message lost; joints swing, rounded as by 12 bits, or rest."""
    still, base, measured = Still(joint_error="none", position_error="none", heading_error="none"), (0.0, 0.0), 0.0
    x, count, lost = 0.0, math.tau / 4096, 2000 // every
    for k in range(3000):
        t = k * H
        v = min(max(0.5 * (t - 2.0), 0.0), 0.5)
        x += H * v
        if k % every == 0 and k // every != lost:
            base, measured = (x, v), t
        q = np.array([count * round(0.3 * math.sin(t) / count), 0.0])
        seen = Measurement(np.array([base[0], 0.0, 0.0]), np.array([base[1], 0.0]), q, np.array([0.024, 0.0]))
        assert not still.step(seen, measured if has_stamps else None)


def test_it_goes_on_after_a_silence_when_it_is_told_to() -> None:
    still, moves = Still(), np.array([0.0, 0.5])
    for k in range(100):
        still.step(Measurement(np.zeros(3), np.zeros(2), moves * k * H, moves))
    assert any(still.step(None) for _ in range(300))
    for k in range(100, 110):
        still.step(Measurement(np.zeros(3), np.zeros(2), moves * 100 * H, 0.0 * moves + 1e-6 * k))
    still.stepper.reset()
    assert not any(still.step(Measurement(np.zeros(3), np.zeros(2), moves * 100 * H, np.zeros(2))) for _ in range(200))


VELOCITIES = ("true", "difference", "filtered", "observer")


@pytest.mark.compiled
@given(data=st.data())
@settings(max_examples=25, derandomize=True)
def test_a_healthy_robot_is_never_taken_for_blind(data) -> None:
    """Random robots whose joints stick, with coarse encoders, noise, slow messages, and a base slower than its arm."""
    pick = lambda *values: data.draw(st.sampled_from(values))  # noqa: E731
    joints, seed, step = pick(2, 3, 4), data.draw(st.integers(0, 99)), math.tau / pick(2**8, 2**10, 2**12, 2**17)
    is_mobile, period = pick(True, False), pick(0.002, 0.01, 0.02, 0.05)
    robot = mobile_arm(joints, seed) if is_mobile else fixed_arm(joints, seed)
    steps = [step * (0.1 if i == 2 else 1.0) for i in range(joints)]  # the third slides, on a pinion of 0.1 m
    sensor = [f"sensor.resolution={steps}", f"sensor.noise={pick(0.0, 1e-4)}", f"sensor.velocity='{pick(*VELOCITIES)}'"]
    if is_mobile:
        sensor += [f"sensor.wheel_resolution={step}", "sensor.pose='odometry'"]
        sensor += [f"sensor.base_period={period * pick(1, 2, 3)}"] if period < 0.02 else []
    sticks = ["time.integrator='stick'", f"friction.coulomb={pick(0.0, 0.2, 1.0, 3.0)}"]
    times = ["time.control_period=0.002", "time.plant_step=0.002", "time.duration=2.0", f"time.sensor_period={period}"]
    chosen = [*times, *sticks, *sensor, f"seed={seed}", "safety.stop_time=0.05"]
    run = load_experiment("track", overrides=chosen).loop(robot, "pd_gravity").run()
    assert run.outcome.status == "completed", run.outcome.message
