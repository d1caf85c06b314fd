"""What an average hides is told: runs that throw a joint about, that shake a motor, and velocities that stay exact."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mmnn_pin import load, load_experiment, run_experiment
from mmnn_pin.lab.experiments.outliers import FAR, THROWN, chatter, chattering, far_peaks, fast_share, outliers
from mmnn_pin.lab.experiments.runner import sensor_notes
from mmnn_pin.lab.show.comparison import notes
from mmnn_pin.lab.show.report import result_of
from mmnn_pin.lab.show.report.verdict import warnings
from mmnn_pin.sensing import Sensor


def errors(**runs: tuple[float, float]) -> dict[str, dict[str, float]]:
    """Errors of runs by name: the peak of a joint, and the RMS of the base's x by which they rank."""
    base = {"e.elbow.rms_0_1": 9.0, "e.elbow.rms_1_5": 0.01, "pose_error.x.peak": 0.01}
    return {name: {"e.elbow.peak": peak, **base, "pose_error.x.rms_1_5": rms} for name, (peak, rms) in runs.items()}


def test_a_run_that_throws_a_joint_about_and_ranks_well_is_told_and_no_other() -> None:
    (told,) = far_peaks(errors(pd_gravity=(0.05, 0.02), pid=(0.06, 0.001), one_layer=(1.4, 0.01)))
    assert told.startswith("one_layer throws elbow about: its error peaks at 1.4, 25 times the others' 0.055")
    assert told.endswith("by RMS errors it ranks before pd_gravity all the same")
    assert far_peaks(errors(pd=(0.05, 0.02), pid=(0.9 * FAR * 0.05, 0.01))) == []
    assert far_peaks(errors(pd=(1e-4, 0.02), pid=(0.9 * THROWN, 0.01))) == []


def test_a_run_that_ranks_last_for_it_is_not_told() -> None:
    """PD under gravity sags from beginning to end, and its RMS says so."""
    assert far_peaks(errors(pid=(0.02, 0.01), pd_gravity=(0.02, 0.01), pd=(0.2, 0.1))) == []


@pytest.fixture(scope="module")
def result():
    """Three runs that hold still."""
    changes = ["controllers=['pd','pd_gravity','two_layer']", "time.duration=0.4", "windows=[[0.0,0.2],[0.2,0.4]]"]
    return run_experiment(load_experiment("track", changes), "track")


@given(st.floats(0.0, 5.0), st.floats(0.3, 9.0), st.floats(11.0, 40.0), st.floats(0.0, 1.0), st.sampled_from([1, 10]))
@settings(max_examples=30, deadline=None)
def test_a_torque_of_two_sines_is_as_fast_as_the_faster_one(
    constant: float, slow: float, quick: float, size: float, every: int
) -> None:
    """In closed form, at 1 kHz and at 100 Hz."""
    time = np.arange(0.0, 10.0, 0.001 * every)
    torque = constant + np.sin(2 * np.pi * slow * time) + size * np.sin(2 * np.pi * quick * time)
    (share,) = fast_share(torque[:, None], 0.001 * every)
    assert share == pytest.approx(size / np.sqrt(2 * constant**2 + 1 + size**2), abs=0.02)


def test_a_run_that_shakes_a_motor_is_told_in_notes_report_and_json(result) -> None:
    assert not any("shakes" in note for note in notes(result))
    shaken = result.recordings["two_layer"]
    torque = shaken["motor_torque"]
    torque += 0.5 * np.abs(torque).max(axis=0) * np.sin(2 * np.pi * 30.0 * shaken.time)[:, None]
    motor = max(chatter(shaken), key=chatter(shaken).__getitem__)
    (told,) = outliers(result.recordings, result.metrics)
    assert told.startswith(f"two_layer shakes {motor}: ")
    assert " of the RMS of its torque is faster than 10 Hz, " in told
    assert told in notes(result) and told in result.to_dict()["comparison"]["notes"]
    assert f"{told}." in list(warnings(result_of(result.recordings)))


@pytest.mark.parametrize(
    ("sensor", "told"),
    [
        (Sensor(noise=1e-4), "sensor.noise is of encoders alone: velocities and the base's pose stay exact; "),
        (Sensor(noise=1e-4, wheel_noise=1e-4, pose="odometry"), "sensor.noise and sensor.wheel_noise are of"),
        (Sensor(noise=1e-4, velocity="filtered"), ""),
        (Sensor(noise=1e-4, velocity_noise=1e-3), ""),
        (Sensor(pose_noise=(1e-3, 1e-3, 1e-3)), ""),
        (Sensor(), ""),
    ],
)
def test_noise_of_encoders_alone_leaves_velocities_exact_and_it_is_said(sensor: Sensor, told: str) -> None:
    found = sensor_notes(sensor, load("platform_arm"))
    assert len(found) == (told != "") and all(note.startswith(told) for note in found)


def test_runs_that_shake_one_motor_are_told_in_one_sentence_with_their_count() -> None:
    calm = {name: {"a": 0.01, "b": 0.02} for name in ("pd", "pid", "feedforward", "two_layer")}
    shaken = {"concurrent": {"a": 0.5, "b": 0.2}, "kalman": {"a": 0.3, "b": 0.0}, "learned": {"a": 0.0, "b": 0.4}}
    one, other = chattering(calm | shaken)
    assert one.startswith(
        "2 runs shake a (concurrent, kalman): 30 to 50 % of the RMS of its torque is faster than 10 Hz, "
    )
    assert one.endswith("up to 50 times as much as the others'") and other.startswith(
        "learned shakes b: 40 % of the RMS"
    )


def test_the_note_is_one_of_the_run() -> None:
    changes = ["controllers=['pd']", "time.duration=0.02", "windows=[[0.0,0.02]]", "sensor.noise=1e-4"]
    ran = run_experiment(load_experiment("track", [*changes, "robot='two_axis_arm'"]), "track")
    assert any(note.startswith("sensor.noise is of encoders alone: velocities stay exact") for note in ran.notes)
