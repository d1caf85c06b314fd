"""Experiments as data: configs and their errors, the order of runs, equal starts, the numbers they are judged by."""

from __future__ import annotations

import json
import re
import shlex
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import builders
import numpy as np
import pytest

from mmnn_pin import (
    PD,
    Hold,
    InputError,
    Line,
    Loop,
    Recording,
    Sine,
    Timing,
    Trajectory,
    load,
    load_experiment,
    run_experiment,
)
from mmnn_pin.errors import ConfigError, RecordingError, TrajectoryError, UnknownName
from mmnn_pin.lab.experiments.config import bundled, keys_of, kind_at, override, parse_value, recorded_experiment
from mmnn_pin.lab.experiments.controllers import CONTROLLERS, DEFAULT, EFFECTIVE
from mmnn_pin.lab.experiments.experiment import Experiment
from mmnn_pin.lab.experiments.result import Result
from mmnn_pin.lab.experiments.runner import in_order, limit_notes, reference_notes, weak_notes
from mmnn_pin.loop.suited import MotorLoad
from mmnn_pin.recording.metrics import metrics
from mmnn_pin.recording.recording import as_columns
from mmnn_pin.reference.trajectory import still
from mmnn_pin.signals import Layout, Setpoint
from mmnn_pin.torque.entries import ENTRIES

SHORT = ("time.duration=0.02",)


def short(*settings: str) -> Experiment:
    return load_experiment("chapter4", (*SHORT, *settings))


@pytest.fixture(scope="module")
def result() -> Result:
    """Chapter 4 with all controllers, 20 samples, in memory."""
    return run_experiment(load_experiment("chapter4", ["time.duration=0.04"]), "chapter4")


# -- chapter 4 --------------------------------------------------------------------------------------------------------


def test_chapter4_has_the_printed_numbers() -> None:
    e = load_experiment("chapter4")
    assert (e.kinematic.kx, e.kinematic.ky, e.kinematic.kth) == (10, 64, 16)
    assert (e.feedback.base, e.feedback.arm) == (500, 30)
    assert (e.two_layer.F, e.two_layer.G, e.two_layer.kappa) == ((1, 0.2), (1, 0.2), 1)
    assert (e.one_layer.beta, e.one_layer.mu, e.one_layer.centre_range) == ((0.5, 0.5), 0.35, 10)
    assert (e.two_layer.hidden, e.one_layer.hidden, e.time.duration) == (22, 22, 5)
    layout = e.load_robot().dimensions
    path = e.trajectory(layout).table([0.0, 1.0, 2.0], layout)
    line, arm = path[:, :3], path[:, 7:9]
    np.testing.assert_allclose(line, [[0, 0, 0], [0.3, 0, 0], [0.6, 0, 0]], atol=1e-12)
    np.testing.assert_allclose(np.rad2deg(arm), [[0, 45], [45, 45], [0, 45]], atol=1e-12)


def test_inputs_are_the_22_of_the_thesis() -> None:
    e = load_experiment("chapter4")
    assert e.inputs.rows(Layout.of(e.load_robot().dimensions)).size == 22


# -- configs and their errors -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "value"),
    [
        *(("2", 2), ("2.5", 2.5), (".05", 0.05), ("-5.", -5.0), (".5e-1", 0.05), ("true", True), ("[1, 2]", [1, 2])),
        *(("'a b'", "a b"), ("word", "word"), (".", "."), ("..", ".."), ("1.2.3", "1.2.3"), ("a/b.urdf",) * 2),
    ],
)
def test_override_values_are_toml_or_text(text: str, value: object) -> None:
    assert parse_value(text) == value and type(parse_value(text)) is type(value)


def test_overrides_reach_tables_lists_and_new_tables() -> None:
    table = {"a": {"b": 1}, "list": [{"x": 1}, 5]}
    for text in ("a.b=2", "list.0.x=3", "list.1=6", "new.deep.key = 7"):
        override(table, text)
    assert table == {"a": {"b": 2}, "list": [{"x": 3}, 6], "new": {"deep": {"key": 7}}}


@pytest.mark.parametrize("text", ["a", "=3", "a..b=3", "a.=3", "a.b.c=3", "list.x.y=3", "list.2=3", "list.1.z=3"])
def test_bad_overrides_are_refused(text: str) -> None:
    table = {"a": {"b": 1}, "list": [{"x": 1}, 5]}
    with pytest.raises(ConfigError):
        override(table, text)


def test_overrides_change_what_is_run() -> None:
    e = short("reference.arm.1.value=0.1", "robust.ZB=[1, 2]", "learning.rates=per_second", "time.integrator='rk4'")
    assert e.reference.arm[1]["value"] == 0.1 and e.robust.ZB == (1, 2) and e.learning.rates == "per_second"
    assert e.controller("two_layer").rates == "per_second"


@pytest.mark.parametrize(
    ("setting", "key"),
    [
        ("time.duration='long'", "time.duration"),
        ("two_layer.F=[1, 'x']", "two_layer.F.1"),
        ("feedback.base=-1", "feedback.base"),
        ("robust.ZB=[1, nan]", "robust.ZB"),
        ("time.plant_step=0.0003", "time.plant_step"),
        ("friction.arm=-2", "friction.arm"),
        ("one_layer.width=0", "one_layer.width"),
        ("two_layer.hidden=0", "two_layer.hidden"),
        ("weights_interval=0", "weights_interval"),
        ("windows=[[2, 1]]", "windows"),
        ("start.pose_offset=[nan, 0, 0]", "start.pose_offset"),
        ("controllers=['pd', 'pd']", "controllers"),
        ("seed=-1", "seed"),
    ],
)
def test_errors_name_file_and_key_path(setting: str, key: str, tmp_path: Path) -> None:
    """Of a file; of an override that it came from there."""
    with pytest.raises(ConfigError) as error:
        load_experiment("chapter4", [setting])
    assert error.value.key == key and error.value.file is None
    option = "" if key in ("controllers", "seed") else "--set "
    assert str(error.value).startswith(f"{option}{key}: error: ")
    file = tmp_path / "mine.toml"
    file.write_text(f'experiment = "chapter4"\n{setting}\n')
    with pytest.raises(ConfigError) as error:
        load_experiment(file)
    assert error.value.key == key and error.value.file == file
    assert str(error.value).startswith(f"{file}:2:{key}: error: ")
    other = tmp_path / "other.toml"
    other.write_text('title = "starts from a file that is wrong"\nexperiment = "mine.toml"\n')
    with pytest.raises(ConfigError) as error:
        load_experiment(other)
    assert str(error.value).startswith(f"{file}:2:{key}: error: ")


@pytest.mark.parametrize(
    ("setting", "key"),
    [
        ("reference.base.type=spiral", "reference.base.type"),
        ("reference.base.sped=1", "reference.base"),
        ("reference.base.speed=fast", "reference.base.speed"),
        ("reference.arm.0.period=x", "reference.arm.0.period"),
        ("reference.arm=[]", "reference.arm"),
    ],
)
def test_errors_of_references_name_the_key_path(setting: str, key: str) -> None:
    e = short(setting)
    with pytest.raises(InputError) as error:
        run_experiment(e, "chapter4")
    assert error.value.key == key


def test_a_base_without_a_path_is_refused() -> None:
    text = json.loads(load_experiment("chapter4").to_json())
    text["reference"]["base"] = None
    import msgspec

    with pytest.raises(ConfigError, match="no path for the base"):
        run_experiment(msgspec.convert(text, Experiment), "x")


def test_known_keys_follow_the_settings() -> None:
    assert keys_of(kind_at(None)) == Experiment.__struct_fields__
    assert keys_of(kind_at("two_layer")) == ("hidden", "F", "G", "kappa", "initial", "v_range")
    assert keys_of(kind_at("seed")) == keys_of(kind_at("no.such.key")) == ()
    table = {"disturbances": [{"type": "push"}, {"type": "commands"}]}
    assert keys_of(kind_at("disturbances.1", table)) == ("start", "end", "fault")
    assert "torque_time" in keys_of(kind_at("safety"))


def test_experiments_are_found_by_name_and_by_path(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(bundled()["chapter4"].read_text().replace("seed = 1 ", "seed = 5 "))
    assert load_experiment("chapter4").seed == 1 and load_experiment(file).seed == load_experiment(str(file)).seed == 5
    with pytest.raises(UnknownName) as unknown:
        load_experiment("chapter44")
    assert unknown.value.available == tuple(bundled()) and "did you mean 'chapter4'" in str(unknown.value)
    with pytest.raises(ConfigError, match="no such file"):
        load_experiment(tmp_path / "other.toml")


def test_what_is_recorded_can_be_run_again(tmp_path: Path) -> None:
    e = short("controllers=['pd']", "feedback.base=321")
    run_experiment(e, "chapter4", out=tmp_path)
    text = Recording.open(tmp_path / "pd.h5").config_text
    import msgspec

    assert msgspec.json.decode(text, type=Experiment) == e


# -- runs -------------------------------------------------------------------------------------------------------------


def test_learners_run_before_the_pd_that_takes_their_gain() -> None:
    assert in_order(["pd_effective", "pd"]) == ["pd", "two_layer", "pd_effective"]
    assert in_order(["pd_effective_one_layer", "pd_effective", "two_layer"]) == [
        *("two_layer", "one_layer"),
        *("pd_effective_one_layer", "pd_effective"),
    ]
    assert in_order(["pd_effective", "two_layer_random", "two_layer_zero"])[-1] == "pd_effective"
    assert in_order(["pd_effective", "two_layer_random"]) == ["two_layer_random", "pd_effective"]  # no other is run
    for name in CONTROLLERS:
        order = in_order([name])
        assert order[-1] == name and (name not in EFFECTIVE or order == [EFFECTIVE[name], name])


def test_results_are_in_the_order_asked_for(result: Result) -> None:
    assert tuple(result.recordings) == tuple(result.metrics) == DEFAULT and result.completed


def test_all_controllers_start_equal(result: Result) -> None:
    rows = [[recording[name][0] for name in ("position", "nu", "pose_ref", "q_ref", "pose_error", "z", "e", "r")]
            for recording in result.recordings.values()]  # fmt: skip
    for row in rows[1:]:
        for one, other in zip(rows[0], row, strict=True):
            assert np.array_equal(one, other)
    assert np.allclose(rows[0][0][:3], [-0.01, 0, 0]) and not rows[0][1].any()  # 10 mm behind, at rest


@pytest.mark.parametrize(("pd", "learner"), EFFECTIVE.items())
def test_pd_effective_has_the_gain_of_its_learner_and_no_network(result: Result, pd: str, learner: str) -> None:
    runs = result.recordings
    assert np.array_equal(runs[pd]["effective_gain"], runs[learner]["effective_gain"])
    assert not runs[pd]["psi_hat"].any()
    s = np.hstack([runs[pd]["z"], runs[pd]["r"]])
    np.testing.assert_allclose(runs[pd]["torque"], runs[pd]["effective_gain"] * s, rtol=1e-12)


def test_a_learner_not_asked_for_is_run_but_not_kept(tmp_path: Path) -> None:
    result = run_experiment(short("controllers=['pd_effective']"), "x", out=tmp_path)
    assert list(result.recordings) == ["pd_effective"] and [f.name for f in tmp_path.iterdir()] == ["pd_effective.h5"]
    assert (result.recordings["pd_effective"]["effective_gain"] > 500).any()


def test_a_learner_without_samples_leaves_its_pd_out() -> None:
    e = short("controllers=['two_layer', 'pd_effective']", "two_layer.v_range=1e300")
    result = run_experiment(e, "x")
    assert list(result.recordings) == ["two_layer"] and not result.completed
    assert len(result.recordings["two_layer"]) == 0 and any("pd_effective was not run" in note for note in result.notes)
    assert json.loads(json.dumps(result.to_dict(), allow_nan=False))["runs"]["two_layer"]["outcome"] == "diverged"


def test_equal_seeds_give_equal_runs_and_other_seeds_other_weights() -> None:
    runs = [run_experiment(short("controllers=['two_layer']", f"seed={s}"), "x").recordings for s in (3, 3, 4)]
    one, two, other = (run["two_layer"] for run in runs)
    assert all(np.array_equal(one[name], two[name]) for name in one)
    assert not np.array_equal(one.weights["V1"], other.weights["V1"])


def test_nothing_is_written_when_one_controller_is_bad(tmp_path: Path) -> None:
    e = short("controllers=['pd', 'two_layer']", "robust.base=1e5")  # pd alone would be stable
    with pytest.raises(ConfigError, match="unstable"):
        run_experiment(e, "x", out=tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_existing_recordings_are_kept_without_force(tmp_path: Path) -> None:
    (tmp_path / "pd.h5").write_text("mine")
    with pytest.raises(RecordingError, match="exists"):
        run_experiment(short(), "x", out=tmp_path)
    assert [f.name for f in tmp_path.iterdir()] == ["pd.h5"] and (tmp_path / "pd.h5").read_text() == "mine"
    run_experiment(short("controllers=['pd']"), "x", out=tmp_path, force=True)
    assert Recording.open(tmp_path / "pd.h5").complete


def test_progress_is_told_per_controller() -> None:
    told: list[tuple[str, float]] = []
    run_experiment(short("controllers=['pd']"), "x", progress=lambda name, part: told.append((name, part)))
    assert told and all(name == "pd" and 0 <= part <= 1 for name, part in told)


def test_standing_still_is_told() -> None:
    result = run_experiment(load_experiment("chapter4", ["time.duration=0.6", "reference.base.speed=0",
                                                         "controllers=['pd']"]), "x")  # fmt: skip
    assert any("vr = 0" in note for note in result.notes)


def test_friction_of_the_config_acts_on_the_plant() -> None:
    heavy, free = (run_experiment(short("controllers=['pd']", f"friction.base={f}"), "x") for f in ("[300, 5]", "0"))
    speeds = [r.recordings["pd"]["nu"][-1, 0] for r in (heavy, free)]
    assert 0 < speeds[0] < speeds[1]


def test_switches_reach_the_controller() -> None:
    off = ("learning.learning=false", "learning.leakage=false", "learning.robust_term=false")
    controller = short(*off).controller("two_layer")
    assert controller.robust is None and not controller.learning and not controller.leakage
    result = run_experiment(short("controllers=['two_layer', 'pd']", *off), "x").recordings
    # W = 0 and nothing is learned: the two-layer controller is PD.
    assert np.array_equal(result["two_layer"]["torque"], result["pd"]["torque"])


def test_comparison_is_relative_to_pd(result: Result) -> None:
    table = result.to_dict()["comparison"]["relative_to_pd"]
    assert set(table) == set(DEFAULT) - {"pd"}
    peaks = [np.abs(result.recordings[c]["e"][:, 0]).max() for c in ("two_layer", "pd")]
    assert table["two_layer"]["e.arm_1_joint.peak"] == pytest.approx(peaks[0] / peaks[1])
    assert result.relative_to("nobody") == {}


# -- metrics ----------------------------------------------------------------------------------------------------------


def recording(rows: int = 10, period: float = 0.5) -> tuple[Recording, Layout]:
    """A recording with known signals: true_z = (k, -2k), true_e = 3, torques, gains."""
    layout, k = Layout(base=2, arm=1, full=6, motors=3), np.arange(rows)[:, None]
    signals = {
        "true_z": k * (1, -2),
        "true_e": 3.0,
        "motor_torque": (1.0, 2.0, 3.0),
        "torque": (3.0, 4.0, 2.0),
        "psi_hat": (3.0, 0.0, 1.0),
        "effective_gain": np.hstack([np.full((rows, 2), (10.0, 20.0)), k]),
        "energy_residual": -1e-3 * k,
    }
    names = {"velocity_names": ("v", "w", "j"), "actuator_names": ("l", "r", "j")}
    return builders.recording("pd", layout, rows=rows, period=period, signals=signals, **names), layout


def test_metrics_of_known_signals() -> None:
    got = metrics(recording()[0], [(0.0, 1.0), (1.0, 3.0)])
    assert got["z.v.peak"] == 9 and got["z.w.peak"] == 18
    assert got["z.v.rms_0_1"] == pytest.approx(np.sqrt((0 + 1) / 2))  # samples at 0 and 0.5 s
    assert got["z.w.rms_1_3"] == pytest.approx(2 * np.sqrt((4 + 9 + 16 + 25) / 4))
    assert got["e.j.peak"] == got["e.j.rms_1_3"] == pytest.approx(3)
    assert got["effort"] == pytest.approx(14 * 10 * 0.5)
    assert got["learned_share.base"] == pytest.approx(3 / 5) and got["learned_share.arm"] == pytest.approx(1 / 2)
    assert got["effective_gain.base"] == 15 and got["effective_gain.arm"] == 4.5
    assert got["energy_residual"] == pytest.approx(9e-3)


def test_windows_that_were_not_reached_and_empty_runs_have_no_number() -> None:
    got = metrics(recording(rows=2)[0], [(0.0, 1.0), (1.0, 5.0)])
    assert np.isfinite(got["z.v.rms_0_1"]) and np.isnan(got["z.v.rms_1_5"])
    empty = metrics(recording(rows=0)[0], [(0.0, 1.0)])
    assert np.isnan(empty["z.v.peak"]) and np.isnan(empty["e.j.rms_0_1"]) and empty["effort"] == 0
    assert empty["learned_share.base"] == 0 and np.isnan(empty["effective_gain.arm"])


def test_scalar_signals_are_columns_too() -> None:
    assert as_columns(np.arange(3.0)).shape == (3, 1) and as_columns(np.ones((3, 2))).shape == (3, 2)


def test_an_unknown_key_is_told_with_the_nearest_one() -> None:
    with pytest.raises(ConfigError) as error:
        load_experiment("track", ["feedbak.arm=3"])
    assert "unknown key 'feedbak': did you mean 'feedback'? there is" in str(error.value)


def test_notes_tell_what_the_plant_does_not(tmp_path: Path) -> None:
    """A file that goes on, a joint that cannot hold itself, one that goes beyond its limits."""
    file = tmp_path / "motion.csv"
    file.write_text("t,x,y,phi,position.arm_1_joint\n0,0,0,0,0\n1,0.1,0,0,0.1\n2,0.2,0,0,0.2\n9,0.9,0,0,0.2\n")
    texts = [f"reference.file='{file}'", "controllers=['pd']", "time.duration=0.5", "windows=[[0.0, 0.5]]"]
    notes = run_experiment(load_experiment("track", texts), "track").notes
    assert "motion.csv goes on to 9 s, the runs end at 0.5 s: --set time.duration=9" in notes
    robot = load("platform_arm")
    assert weak_notes(robot) == []
    heavy = replace(robot, effort_limits=np.full(len(robot.effort_limits), -1.0))
    assert [note.split()[0] for note in weak_notes(heavy)] == list(robot.joint_names)
    run = Loop(robot, Trajectory(Line(0.0), (Sine(0.5, 2.0), Hold(0.4))), PD(), timing=Timing(duration=0.5)).run()
    assert limit_notes(robot, {"pd": run}) == []
    tight = replace(robot, upper=np.where(np.arange(len(robot.upper)) == robot.arm_index[1], 0.3, robot.upper))
    (note,) = limit_notes(tight, {"pd": run})
    assert note.startswith("arm_2_joint goes 0.") and note.endswith("under pd; the plant has no end stops")
    bare = load("platform_arm", lock=robot.joint_names)
    run = Loop(bare, Trajectory(Line(0.0), ()), PD(), timing=Timing(duration=0.1)).run()
    assert limit_notes(bare, {"pd": run}) == []


def test_a_path_too_tight_for_a_car_is_drawn_larger_and_that_is_told() -> None:
    tight = load_experiment("track", ["robot='car_arm'", "reference.base={type='circle', radius=0.3, speed=0.3}"])
    (note,) = reference_notes(tight, tight.load_robot())
    assert note == "the path is drawn 3.19 times as large: what steers asks for it"  # 0.9 m at its stops, 0.95 of these


def test_a_motion_that_is_slowed_down_names_the_motor_that_asks_for_it() -> None:
    track = load_experiment("track", ["speed_limits=[99.0, 99.0, 0.1, 99.0]"])
    robot = track.load_robot()
    [note] = [n for n in reference_notes(track, robot) if "times as long" in n]
    assert note.endswith(": arm_1_joint has at most 0.1 rad/s, of which it may take 75% (reference.share)")
    slow = track.trajectory_of(robot)
    assert float(note.split()[3]) == pytest.approx(slow.slowness, rel=1e-2)
    rows = slow.table(np.linspace(0.0, 60.0, 6001), robot.dimensions)
    q = [Setpoint.side_by_side(row, robot.dimensions).q[0] for row in rows]
    assert 0.5 * 0.075 < np.abs(np.diff(q)).max() / 0.01 < 0.0751  # as slow as it must be, no slower


@pytest.mark.parametrize("friction", [0.0, 0.9])
def test_the_limit_that_is_named_is_the_one_that_makes_it_slow(friction: float) -> None:
    """Wheels are furthest beyond their limit at first; where friction takes nearly all, the last joint decides."""
    limits = {"speed_limits": [8.0, 8.0, 99.0, 99.0], "effort_limits": [99.0, 99.0, 99.0, 0.8]}
    overrides = [f"friction.coulomb=[0,{friction}]", "friction.arm=[0,0.3]", "masses.arm_2_joint=0.02"]
    overrides += [f"{name}={values}" for name, values in limits.items()]
    track = load_experiment("track", overrides)
    robot = track.load_robot()
    [note] = [n for n in reference_notes(track, robot) if "times as long" in n]
    assert ("arm_2_joint has at most 0.8 N m" in note) == bool(friction)
    assert ("go into gravity and friction at any pace" in note) == bool(friction)
    named = "effort_limits" if friction else "speed_limits"
    free = load_experiment("track", [*overrides, f"{named}={[10.0 * limit for limit in limits[named]]}"])
    assert free.trajectory_of(free.load_robot()).slowness < track.trajectory_of(robot).slowness


@pytest.mark.parametrize(
    ("columns", "rows"),
    [("t,x,y", "0,0,0\n1,0.1,0\n2,0.2,0\n3,0.3,0"), ("t,position.arm_1_joint", "0,0\n1,0.1\n2,0.2\n3,0.2")],
)
def test_what_a_file_does_not_move_is_told_and_rests_as_the_note_says(tmp_path: Path, columns: str, rows: str) -> None:
    (tmp_path / "motion.csv").write_text(f"{columns}\n{rows}\n")
    texts = [f"reference.file='{tmp_path / 'motion.csv'}'"]

    def noted(*more: str) -> tuple[Trajectory, list[str]]:
        track = load_experiment("track", [*texts, *more])
        robot = track.load_robot()
        reference = track.trajectory_of(robot)
        return reference, [note for note in reference_notes(track, robot) if "as the experiment says" in note]

    moving, [note] = noted()
    resting, none = noted(shlex.split(note.partition("--set ")[2])[0])
    assert not none
    for reference, still_ones in ((moving, 0), (resting, 1)):
        parts = reference.arm[:1] if "x" in columns else (reference.base,)
        assert sum(map(still, parts)) == still_ones


@pytest.mark.parametrize("factor", [1.0, 12.0, 1000.0])
def test_a_motion_in_other_units_is_refused_and_one_that_is_too_fast_is_slowed(tmp_path: Path, factor: float) -> None:
    t = np.linspace(0.0, 8.0, 81)
    rows = np.column_stack((t, 0.3 * factor * t, 0.1 * factor * np.sin(t)))
    np.savetxt(tmp_path / "motion.csv", rows, delimiter=",", header="t,x,y", comments="")
    texts = [f"reference.file='{tmp_path / 'motion.csv'}'", "speed_limits=[10.0, 10.0, 9.0, 9.0]"]
    track = load_experiment("track", texts)
    robot = track.load_robot()
    if factor == 1000.0:
        with pytest.raises(TrajectoryError, match="times as fast as wheel_left_joint can be: slowed down 16 times"):
            track.trajectory_of(robot)
    else:
        reference = track.trajectory_of(robot)
        assert (reference.slowness > 1.0) == (factor > 1.0)
        assert MotorLoad(robot).along(reference, 8.0)[1].max() <= 1.0


def test_a_key_without_its_table_is_told_with_it_and_the_advice_is_a_key() -> None:
    tables = {name: keys_of(kind_at(name, None, Experiment)) for name in keys_of(Experiment)}
    alone = sorted({key for keys in tables.values() for key in keys} - set(tables))[::40]
    for key in alone:
        with pytest.raises(ConfigError) as told:
            load_experiment("track", [f"{key}=1"])
        advised = re.findall(r"'([\w.]+)'", str(told.value).partition("did you mean ")[2])
        assert advised
        assert all(path.rpartition(".")[2] == key and key in tables[path.partition(".")[0]] for path in advised), key


def test_what_has_no_trailer_cannot_have_it_guided() -> None:
    for robot in ("car_arm", "platform_arm"):
        guided = load_experiment("track", [f"robot='{robot}'", "kinematic.guide='trailer'", "controllers=['pd']"])
        with pytest.raises(ConfigError, match=f"'{robot}' has 0 trailers"):
            run_experiment(guided, "track")


def test_every_learner_has_its_table() -> None:
    for entry in ENTRIES:
        if (kind := entry.load_settings()) is not None:
            assert kind_at(entry.key) is kind, entry.name


def test_a_recording_of_learners_that_are_no_more_is_read() -> None:
    old = json.loads(load_experiment("track", ["controllers=['pd']"]).to_json())
    gone = {"two_layer_composite": {"rate": 1.0}, "drem": {"rate": 1.0}}
    old |= gone | {"controllers": ["pd", *gone]}
    for names, kept in ((old["controllers"], ("pd",)), (["two_layer_composite"], DEFAULT)):
        text = json.dumps(old | {"controllers": names})
        experiment = recorded_experiment(SimpleNamespace(config_text=text, path=None))
        assert experiment is not None and experiment.controllers == kept
    with pytest.raises(RecordingError, match="another version of mmnn_pin wrote it"):
        recorded_experiment(SimpleNamespace(config_text=json.dumps(old | {"nothing": {}}), path=None))
