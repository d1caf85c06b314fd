"""Sensors, supervisor, motors and disturbances together: engines alike, runs resumed, batches, the contact plant."""

from __future__ import annotations

import math
import re
import shlex
import tomllib
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from msgspec import structs
from numba import config
from places import ROOT
from robots import fixed_arm, mobile_arm

from mmnn_pin import PD, Feedback, Hold, Line, Loop, Neural, Sine, Timing, Trajectory, load, load_experiment
from mmnn_pin.actuator import Actuator
from mmnn_pin.disturbance import BlockedJoint, CommandFault, DeadMotor, FrozenEncoder, Messages, Payload, Push
from mmnn_pin.errors import ConfigError
from mmnn_pin.lab.experiments.experiment import Experiment
from mmnn_pin.lab.experiments.hardware_table import HardwareTable
from mmnn_pin.lab.show.plots import torque_figure
from mmnn_pin.lab.show.replay.motion import events_of
from mmnn_pin.loop.batch import simulate_many
from mmnn_pin.loop.before_run import Start
from mmnn_pin.loop.hardware import sense
from mmnn_pin.safety import Safety
from mmnn_pin.sensing import Sensor
from mmnn_pin.signals import Layout
from mmnn_pin.torque.controller import ControllerState
from mmnn_pin.torque.model_based import ComputedTorque
from mmnn_pin.torque.one_layer import OneLayer
from mmnn_pin.torque.two_layer import TwoLayer

ROBOT = load("platform_arm")
LEFT, ARM = ROBOT.base.wheels[0].joint, ROBOT.joint_names[0]
DURATION = 0.06 if config.DISABLE_JIT else 0.3
T = DURATION / 6
WEAK = Feedback(200.0, 3.0)
GEAR = Actuator(
    gap=(0.01, 0.01, 0.02, 0.02), rotor_inertia=(0.01, 0.01, 0.01, 0.005), stiffness=300.0, rotor_friction=0.01
)
SUPPLY = Actuator(voltage=24.0, torque_constant=0.5, resistance=0.5, battery_resistance=0.05, pwm_levels=256)
ROUGH = Sensor(
    resolution=1e-3,
    wheel_resolution=1e-3,
    velocity="filtered",
    pose="odometry",
    noise=1e-4,
    delay=1,
    jitter=1,
    loss=0.1,
)

ACTUATORS = {
    "torque limit": Actuator(torque_limit=(1.0, 1.0, 2.0, 0.5)),
    "urdf limits": Actuator(torque_limit="urdf", speed_limit="urdf"),
    "speed limit": Actuator(speed_limit=(3.0, 3.0, 1.0, 0.1)),
    "torque gain": Actuator(torque_gain=(0.9, 1.1, 0.8, 1.2)),
    "lag": Actuator(lag=(0.005, 0.005, 0.002, 0.0)),
    "supply": SUPPLY,
    "backlash": GEAR,
}
SENSORS = {
    "rough": ROUGH,
    "motor side": Sensor(side="motor"),
    "motor side, differences": Sensor(side="motor", velocity="difference"),
    "model": Sensor(velocity="model", bandwidth=60.0, resolution=1e-3, wheel_resolution=1e-3, pose="odometry"),
}
SAFETIES = {
    "nothing passed": Safety(),
    "torque": Safety(torque=1.0, torque_time=9.0),
    "torque trip": Safety(torque=0.5, torque_time=T, stop_time=T),
    "weights": Safety(weights=0.3),
    "joint speed": Safety(joint_speed=1.0, stop_time=2 * T),
    "joint error": Safety(joint_error=0.099, stop_time=2 * T, ramp=T),
}
EVENTS = {
    "step": Push(on="v", force=80.0, start=T, end=3 * T),
    "impulse": Push(on=ARM, shape="impulse", force=0.2, start=T),
    "sine": Push(on="w", shape="sine", force=20.0, frequency=9.0, start=T),
    "noise": Push(on="w", shape="noise", force=20.0),
    "payload": Payload(mass=2.0, start=2 * T, at=(0.2, 0.0, 0.0)),
    "dead motor": DeadMotor(joint=LEFT, start=T, end=3 * T),
    "blocked wheel": BlockedJoint(joint=LEFT, start=T, end=3 * T),
    "blocked joint": BlockedJoint(joint=ARM, start=T),
    "frozen encoder": FrozenEncoder(joint=ARM, start=T, end=3 * T),
    "lost messages": Messages(fault="lost", start=T, end=2 * T),
    "late messages": Messages(fault="late", delay=3, start=T, end=3 * T),
    "shuffled messages": Messages(fault="shuffled", delay=3, start=T),
    "spikes": Messages(fault="spike", size=0.01, start=T),
    "lost commands": CommandFault(fault="lost", start=T, end=2 * T),
}
TIMEOUTS = Safety(timeout=T / 2, ramp=T / 2, stop_time=2 * T)
SUPERVISED = {
    "messages that are no numbers": (Messages(fault="nan", start=T, end=1.3 * T),),
    "no numbers from the start": (Messages(fault="nan", end=0.3 * T),),
    "commands that are no numbers": (CommandFault(fault="nan", start=T, end=1.3 * T),),
    "silent sensors": (Messages(fault="lost", start=T),),
    "sensors that come back": (Messages(fault="lost", start=T, end=2 * T),),
    "silent controller": (CommandFault(fault="lost", start=T),),
}
ALL = {
    "actuator": structs.replace(GEAR, lag=0.002, torque_limit="urdf", voltage=48.0, torque_constant=0.5, resistance=0.5,
                                battery_resistance=0.05, pwm_levels=512),
    "sensor": structs.replace(ROUGH, side="motor"),
    "safety": Safety(torque="urdf", timeout=2 * T, position_error=0.5, weights=5.0),
    "disturbances": (*(EVENTS[name] for name in ("step", "noise", "payload", "late messages", "lost commands")),
                     FrozenEncoder(joint=LEFT, start=2 * T, end=3 * T), BlockedJoint(joint=LEFT, start=4 * T)),
}  # fmt: skip
TRIPPED = {**ALL, "safety": Safety(joint_speed=1.65, stop_time=9.0)}

CASES = {f"actuator: {name}": {"actuator": actuator} for name, actuator in ACTUATORS.items()}
CASES |= {f"sensor: {name}": {"sensor": sensor, "actuator": GEAR} for name, sensor in SENSORS.items()}
CASES |= {f"safety: {name}": {"safety": safety} for name, safety in SAFETIES.items()}
CASES |= {f"disturbance: {name}": {"disturbances": (event,)} for name, event in EVENTS.items()}
CASES |= {f"supervised: {name}": {"disturbances": events, "safety": TIMEOUTS} for name, events in SUPERVISED.items()}
CASES |= {"all": ALL, "all, tripped": TRIPPED}


def loop_of(case, controller=None, robot=ROBOT, trajectory=None, **more):
    stick = case.get("disturbances", ()) and any(isinstance(one, BlockedJoint) for one in case["disturbances"])
    timing = Timing(DURATION, integrator="stick" if stick else "semi_implicit_euler")
    controller = controller or Neural(TwoLayer(), WEAK, robust=None)
    trajectory = trajectory or Trajectory(Line(0.3), (Sine(0.5, 2.0), Hold(0.4)))
    start = Start(joint_offset=0.1, moving=True)
    return Loop(robot, trajectory, controller, **{"timing": timing, "start": start, "seed": 3, **case, **more})


def require_equal(one, other, rtol=1e-9, atol=1e-9):
    assert one.outcome.status == other.outcome.status and one.outcome.signal == other.outcome.signal
    assert one.outcome.time == other.outcome.time and len(one) == len(other)
    for name in one.names:
        scale = 1.0 + np.abs(one[name]).max()
        np.testing.assert_allclose(one[name], other[name], rtol=rtol, atol=atol * scale, err_msg=name)


@pytest.mark.compiled
@pytest.mark.parametrize("name", CASES)
def test_both_engines_do_the_same(name):
    ordinary, compiled = (loop_of(CASES[name], engine=engine).run() for engine in ("ordinary", "compiled"))
    assert ordinary.meta["loop"] == "ordinary" and compiled.meta["loop"] == "compiled"
    require_equal(ordinary, compiled)
    ideal = loop_of({}).run()
    if name not in ("safety: nothing passed", "actuator: urdf limits"):
        n = min(len(ideal), len(compiled))
        assert (
            np.abs(ideal["nu"][:n] - compiled["nu"][:n]).max() > 1e-6 or name == "safety: weights"
        )  # it did something


@pytest.mark.compiled
@pytest.mark.parametrize("controller", [PD(WEAK), Neural(OneLayer(), WEAK), ComputedTorque(WEAK)], ids=str)
@pytest.mark.parametrize("integrator", ["rk4", "stick"])
def test_both_engines_do_the_same_with_every_controller(controller, integrator):
    events = tuple(one for one in ALL["disturbances"] if not isinstance(one, BlockedJoint))
    loop = loop_of({**ALL, "disturbances": events}, controller, nominal=ROBOT.with_masses(1.2))
    loop = replace(loop, timing=Timing(DURATION, 0.004, 0.001, 0.002, integrator))
    require_equal(*(replace(loop, engine=engine).run() for engine in ("ordinary", "compiled")))


@pytest.mark.compiled
@pytest.mark.parametrize("make", [lambda: mobile_arm(3, 2), lambda: fixed_arm(3, 1)], ids=["mobile", "fixed"])
def test_both_engines_do_the_same_on_robots_that_feel_gravity(make):
    robot = make()
    path = Line(0.2) if robot.dimensions.base else None
    case = {
        "actuator": Actuator(gap=0.004, rotor_inertia=1e-3, lag=0.002, torque_limit="urdf"),
        "safety": Safety(joint_speed=2.0, stop_time=3 * T, torque="urdf"),
        "disturbances": (Payload(mass=1.0, start=2 * T), Push(on=robot.joint_names[0], force=30.0, start=3 * T)),
    }
    from robots import feedback

    trajectory = Trajectory(path, (Sine(0.3, 2.0),) * 3)
    loop = loop_of(case, PD(feedback(robot, 0.002)), robot, trajectory)
    require_equal(*(replace(loop, engine=engine).run() for engine in ("ordinary", "compiled")), rtol=1e-8, atol=1e-8)


# --- Resumed runs and batches -----------------------------------------------------------------------------------------


@pytest.mark.compiled
@pytest.mark.parametrize("engine", ["ordinary", "compiled"])
@pytest.mark.parametrize(
    "name",
    [
        "all",
        "all, tripped",
        "supervised: messages that are no numbers",
        "supervised: silent controller",
        "disturbance: frozen encoder",
        "disturbance: payload",
        "actuator: backlash",
        "sensor: model",
    ],
)
@pytest.mark.parametrize("sixths", [2, 4])
def test_a_resumed_run_is_the_whole_one_bit_for_bit(name, engine, sixths):
    whole = loop_of(CASES[name], engine=engine)
    straight, k = whole.run(), round(sixths * T / 0.002)
    if k >= len(straight):
        return  # it has stopped before
    end = replace(whole, timing=replace_duration(whole.timing, sixths * T)).run().final
    state = ControllerState(np.array(end["controller_state"]), whole.state_from().shapes)
    rest = whole.run(
        state=state, plant_state=(end["position"], end["nu"]), hardware_state=end["hardware_state"], first=k
    )
    assert rest.outcome.status == straight.outcome.status and rest.outcome.message == straight.outcome.message
    for signal in straight.names:
        if signal not in ("energy", "work", "energy_residual"):  # counted from where a run begins
            np.testing.assert_array_equal(rest[signal], straight[signal][k:], err_msg=signal)
    assert np.abs(rest["energy_residual"] - rest["energy_residual"][0]).max() < 5.0
    assert name != "all, tripped" or straight.outcome.time < 4 * T


def replace_duration(timing, duration):
    return structs.replace(timing, duration=duration)


def test_a_memory_that_does_not_fit_is_refused():
    loop = loop_of(CASES["actuator: backlash"])
    size = loop.run().final["hardware_state"].size
    for state, text in ((np.zeros(size + 1), "of shape"), (np.full(size, math.nan), "not finite")):
        with pytest.raises(ConfigError, match=rf"hardware_state.*{text}"):
            loop.run(hardware_state=state)


def test_many_runs_at_once_are_the_runs_one_by_one():
    loops = [
        loop_of({**CASES[name]}, weights_interval=0.02, engine="compiled")
        for name in ("all", "all, tripped", "disturbance: payload")
    ]
    for loop, found in zip(loops, simulate_many(loops, windows=[(0.0, DURATION)]), strict=True):
        run = loop.run()
        assert found.outcome == run.outcome
        name = f"e.{ARM}.peak"
        assert found.metrics[name] == np.abs(run["true_e"][:, 0]).max()


def test_runs_with_one_seed_are_equal_and_the_rig_does_not_change_the_weights_drawn():
    a, b = (loop_of(ALL, weights_interval=0.02).run() for _ in range(2))
    for name in a.names:
        np.testing.assert_array_equal(a[name], b[name])
    ideal = loop_of({}, weights_interval=0.02).run()
    np.testing.assert_array_equal(a.weights["V1"][0], ideal.weights["V1"][0])


def test_controller_sensors_and_disturbances_draw_from_streams_of_their_own():
    """With one stream for two of them their noises would be one: a gust that the sensors know of."""
    loop = loop_of({})
    generators = (loop.context().rng, *loop.streams())
    drawn = [rng.standard_normal(2000) for rng in generators]
    np.testing.assert_allclose(np.corrcoef(drawn), np.eye(len(drawn)), atol=0.1)  # 4.5 standard deviations


def test_an_ideal_loop_has_no_rig_and_its_rows_no_room_for_one():
    run = loop_of({}).run()
    assert not {"applied", "disturbance", "safety"} & set(run.names) and run.final["hardware_state"].size == 0
    with_rig = loop_of({"safety": Safety()}).run()
    assert {"applied", "disturbance", "safety"} <= set(with_rig.names)
    np.testing.assert_array_equal(with_rig["applied"], with_rig["motor_torque"])


def test_a_recording_tells_its_rig():
    facts = loop_of(ALL).facts()
    assert facts["actuator"]["pwm_levels"] == 512 and facts["safety"]["torque"] == "urdf"
    assert [one["type"] for one in facts["disturbances"]][:2] == ["push", "push"]
    assert not {"actuator", "safety", "disturbances"} & set(loop_of({}).facts())


# --- What is known to whom --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("engine", ["ordinary", "compiled"])
def test_supervisor_and_controller_see_the_measurement_and_nothing_else(engine):
    """Sensors that never say anything new, and a state that runs away: nobody is alarmed, and torques stay the same."""
    stuck = {
        "sensor": Sensor(delay=10_000),
        "safety": Safety(speed=0.5, joint_speed=2.0, position_error=0.5, timeout=9.0),
    }
    calm = loop_of(stuck, engine=engine).run()
    pushed = loop_of(
        {**stuck, "disturbances": (Push(on="v", force=2000.0), Push(on=ARM, force=60.0))}, engine=engine
    ).run()
    assert np.abs(pushed["nu"][:, 0]).max() > 0.5 and np.abs(pushed["nu"][:, 2]).max() > 2.0  # it is too fast
    assert pushed.outcome.status == "completed" and not np.any(pushed["safety"])
    np.testing.assert_array_equal(pushed["torque"], calm["torque"])


def test_a_measurement_that_contradicts_the_state_trips_a_robot_that_is_where_it_should_be():
    case = {"sensor": Sensor(offset=(0.2, 0.0)), "safety": Safety(joint_error=0.1)}
    run = loop_of(case, start=Start(moving=True)).run()
    assert run.outcome.status == "tripped" and run.outcome.signal == "e[0]"
    assert np.abs(run["true_e"][0]).max() < 1e-12


def test_the_exact_sensor_is_the_state():
    loop = loop_of({"safety": Safety()})
    engine = loop.engine_at()
    row, at, y = engine.row, Layout.of(loop.robot.dimensions).offsets, engine.y
    sense(0, 0.0, row, at, y[:7], y[7:11], loop.robot.arm_index, engine.hardware)
    np.testing.assert_array_equal(row[Layout.of(loop.robot.dimensions).where("pose")], y[:3])


def test_the_tables_and_commands_of_the_page_load():
    """docs/how-to/hardware.md: every TOML block fits chapter 4, every `--set` of its commands, too."""
    page = (ROOT / "docs/how-to/hardware.md").read_text()
    blocks = re.findall(r"```toml\n(.*?)```", page, re.S)
    plain = msgspec.to_builtins(load_experiment("chapter4"))
    tables = [tomllib.loads(block) for block in blocks]
    own = [table for table in tables if "profile" in table]  # a file of hardware beside a robot
    assert msgspec.convert(own[0], HardwareTable).rate == 30.0 and len(own) == 1
    for table in tables:
        if table in own:
            continue
        experiment = msgspec.convert(plain | table, Experiment)
        experiment.loop(ROBOT, experiment.controller("pd")).engine_at()
    text = page.replace("\\\n", " ")
    commands = re.findall(r"mmnn run chapter4 ((?:--set (?:'[^']*'|[^\s`']+)\s*)+)", text)
    assert len(blocks) == 3 and len(commands) == 6
    for command in commands:
        words = [word for word in shlex.split(command) if word != "--set"]
        experiment = load_experiment("chapter4", words)
        experiment.loop(ROBOT, experiment.controller("pd")).engine_at()


# --- What is shown ----------------------------------------------------------------------------------------------------


def test_a_replay_colours_what_the_supervisor_did():
    events = (CommandFault(fault="nan", start=T, end=1.5 * T), Messages(fault="lost", start=2 * T))
    run = loop_of({"safety": Safety(timeout=T, ramp=T, stop_time=T), "disturbances": events}).run()
    assert run.outcome.status == "tripped"
    found = {(event.kind, event.text.partition(":")[0]): event for event in events_of(run)}
    assert set(found) == {
        ("stop", "tripped"),
        ("limit", "the supervisor clips a torque or holds a value"),
        ("stop", "stopped without feedback"),
    }
    assert found["stop", "tripped"].start == run.outcome.time and found["stop", "tripped"].end == np.inf
    assert found["limit", "the supervisor clips a torque or holds a value"].start == pytest.approx(T, abs=0.003)
    interrupted = loop_of({"safety": Safety(timeout=T, ramp=T), "disturbances": events}).run()
    assert "stop" in {event.kind for event in events_of(interrupted)}


def test_the_torque_figure_shows_what_motors_gave_and_when_the_run_was_stopped():
    case = {"actuator": Actuator(lag=0.01), "safety": Safety(joint_speed=1.0, stop_time=2 * T)}
    runs = {"ideal": loop_of({}).run(), "real": loop_of(case).run()}
    figure = torque_figure(runs)
    legend = [text.get_text() for text in figure.legends[0].get_texts()]
    assert legend[2:] == ["given by the motors", "stopped by the supervisor"] and "tripped at" in legend[1]
    given = runs["real"]["applied"]
    shown = [line.get_ydata() for axes in figure.axes for line in axes.lines]
    for j in range(4):
        assert any(len(line) == len(given) and np.array_equal(line, given[:, j]) for line in shown)
    assert all(axes.patches for axes in figure.axes)
    plain = torque_figure({"ideal": runs["ideal"]})
    assert len(plain.legends[0].get_texts()) == 1 and not any(axes.patches for axes in plain.axes)


# --- The contact plant ------------------------------------------------------------------------------------------------


def contact_of(case, duration=0.2, **more):
    pytest.importorskip("mujoco")
    loop = loop_of(case, PD(WEAK), plant="contact", **more)
    return replace(loop, timing=Timing(duration, integrator="semi_implicit_euler"))


CONTACT = {
    "push": (
        {"disturbances": (Push(on="v", force=40.0, start=0.02), Push(on="w", force=5.0), Push(on=ARM, force=0.5))},
        1e-2,
    ),
    "payload": ({"disturbances": (Payload(mass=2.0, start=0.04, at=(0.2, 0.0, 0.0)),)}, 1e-2),
    "dead motor": ({"disturbances": (DeadMotor(joint=LEFT, start=0.04),)}, 1e-2),
    "motors": ({"actuator": Actuator(lag=0.005, torque_limit=4.0)}, 1e-2),
    "supply": ({"actuator": SUPPLY}, 1e-2),
    "backlash": ({"actuator": GEAR}, 5e-2),
    "stop": ({"safety": Safety(joint_error=0.099, stop_time=0.1)}, 1e-2),
    "silent sensors": (
        {"safety": Safety(timeout=0.02, ramp=0.02), "disturbances": (Messages(fault="lost", start=0.04),)},
        1e-2,
    ),
}


@pytest.mark.skipif(config.DISABLE_JIT, reason="says nothing of compiled code")
@pytest.mark.parametrize("name", CONTACT)
def test_on_wheels_that_grip_it_is_the_same_as_on_wheels_that_roll(name):
    case, most = CONTACT[name]
    loop = contact_of(case)
    run, ideal = loop.run(), replace(loop, plant="ideal").run()
    assert run.outcome.status == ideal.outcome.status
    n = min(len(run), len(ideal))
    assert n > 20
    np.testing.assert_allclose(run["nu"][:n], ideal["nu"][:n], atol=most * (1 + np.abs(ideal["nu"]).max()))
    without = replace(contact_of({}), plant="ideal").run()
    difference = np.abs(ideal["nu"][:n] - without["nu"][:n]).max()
    assert difference > np.abs(run["nu"][:n] - ideal["nu"][:n]).max()  # more than what the plants differ by


@pytest.mark.skipif(config.DISABLE_JIT, reason="says nothing of compiled code")
def test_on_the_floor_a_blocked_wheel_turns_the_base():
    run = contact_of({"disturbances": (BlockedJoint(joint=LEFT, start=0.05),)}, 0.4).run()
    wheel = ROBOT.position_names.index(LEFT)
    late = run.time > 0.1
    turned = np.diff(run["position"][late, wheel]) / 0.002
    assert np.abs(turned).max() < 0.02  # [rad/s], of 4 before
    assert np.ptp(run["pose"][late, 2]) > 0.02
