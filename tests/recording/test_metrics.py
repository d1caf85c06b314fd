"""The reducer fed in blocks against numpy on the whole recording."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mmnn_pin.errors import UnknownName
from mmnn_pin.recording.metrics import Reducer, halves, metrics
from mmnn_pin.recording.recorder import Recorder
from mmnn_pin.recording.recording import Outcome, Recording
from mmnn_pin.signals import Array, Dimensions, Layout

PERIOD = 0.01
LAYOUTS = {
    "mobile": Layout(base=2, arm=3, full=8, motors=5),
    "base alone": Layout(base=2, arm=0, full=5, motors=2),
    "fixed": Layout(base=0, arm=2, full=2, motors=2),
}
WINDOWS = ((0.0, 0.1), (0.1, 0.35), (0.05, 0.15), (5.0, 9.0))
layouts = pytest.mark.parametrize("layout", LAYOUTS.values(), ids=LAYOUTS)


def facts(layout: Dimensions) -> dict:
    return {
        "control_period": PERIOD,
        "velocity_names": [f"u{i}" for i in range(layout.dof)],
        "actuator_names": [f"m{i}" for i in range(layout.motors)],
    }


def random_rows(layout: Layout, count: int, seed: int = 0) -> Array:
    rng = np.random.default_rng(seed)
    rows = rng.standard_normal((count, layout.width)) * 10.0 ** rng.uniform(-3, 3, layout.width)
    rows[:, 0] = PERIOD * np.arange(count)
    return rows


def recorded(layout: Layout, rows: Array) -> Recording:
    with Recorder(layout, facts(layout)) as recorder:
        recorder.append_block(rows)
        return recorder.finish(Outcome("completed", len(rows) * PERIOD))


def reduced(layout: Layout, rows: Array, cuts=()) -> dict[str, float]:
    reducer = Reducer.of(layout, facts(layout), WINDOWS)
    for block in np.split(rows, sorted(cuts)):
        reducer.append_block(np.ascontiguousarray(block))
    return reducer.result()


def by_numpy(layout: Layout, rows: Array) -> dict[str, float]:
    """The same numbers from the whole table, each by its definition."""
    part = {name: rows[:, layout.where(f"true_{name}")] for name in ("pose_error", "z", "e")}
    part |= {name: rows[:, layout.where(name)] for name in ("torque", "psi_hat", "motor_torque")}
    gain, t, names, nb = (
        rows[:, layout.where("effective_gain")],
        rows[:, 0],
        facts(layout)["velocity_names"],
        layout.base,
    )
    labels = {"pose_error": ("x", "y", "phi"), "z": names[:nb], "e": names[nb:]}
    numbers = {}
    for name, columns in labels.items():
        for label, x in zip(columns, part[name].T, strict=False):
            numbers[f"{name}.{label}.peak"] = np.linalg.norm(x, np.inf)
            for a, b in WINDOWS:
                chosen = x[np.flatnonzero((t >= a) & (t < b))]
                numbers[f"{name}.{label}.rms_{a:g}_{b:g}"] = np.linalg.norm(chosen) / np.sqrt(len(chosen) or np.nan)
    numbers["effort"] = PERIOD * np.linalg.norm(part["motor_torque"]) ** 2
    for name, where in (("base", slice(0, nb)), ("arm", slice(nb, None))):
        if part["torque"][:, where].size:
            learned, applied = (np.linalg.norm(part[signal][:, where]) for signal in ("psi_hat", "torque"))
            numbers[f"learned_share.{name}"] = learned / applied
            numbers[f"effective_gain.{name}"] = gain[:, where].mean()
    numbers["energy_residual"] = np.linalg.norm(rows[:, layout.where("energy_residual")], np.inf)
    return numbers


@layouts
@settings(max_examples=15, deadline=None)
@given(count=st.integers(1, 60), cuts=st.sets(st.integers(0, 60), max_size=8), seed=st.integers(0, 100))
def test_blocks_of_any_size_give_the_numbers_of_the_whole(layout, count, cuts, seed):
    rows = random_rows(layout, count, seed)
    got, wanted = reduced(layout, rows, cuts), by_numpy(layout, rows)
    assert got.keys() == wanted.keys()
    for name, value in wanted.items():
        assert got[name] == pytest.approx(value, rel=1e-12, nan_ok=True), name
    same = reduced(layout, rows), metrics(recorded(layout, rows), WINDOWS)
    for other in same:  # to the last bit, and in the same order
        assert list(other) == list(got)
        np.testing.assert_array_equal(list(other.values()), list(got.values()))


@layouts
def test_no_samples_have_no_errors(layout):
    got = reduced(layout, random_rows(layout, 0))
    assert all(np.isnan(value) for name, value in got.items() if ".peak" in name or ".rms" in name)
    assert got["effort"] == got["energy_residual"] == 0.0


def test_a_window_holds_its_beginning_and_not_its_end():
    layout = LAYOUTS["mobile"]
    rows = random_rows(layout, 40)
    rows[:, layout.where("true_z")] = 0.0
    rows[10, layout.where("true_z")] = 7.0  # at 0.1 s, where one window ends and the next begins
    got = reduced(layout, rows)
    assert got["z.u0.rms_0_0.1"] == 0.0 and got["z.u0.rms_0.1_0.35"] == pytest.approx(7.0 / 5.0)
    assert got["z.u1.peak"] == 7.0


def test_no_torque_has_no_learned_share():
    layout = LAYOUTS["mobile"]
    rows = random_rows(layout, 5)
    rows[:, layout.where("torque")] = 0.0
    assert reduced(layout, rows)["learned_share.base"] == 0.0


@pytest.mark.parametrize("kept", [("z", "e"), ("motor_torque", "torque", "psi_hat")])
def test_a_recording_without_torques_is_refused(kept):
    with Recorder(LAYOUTS["mobile"], facts(LAYOUTS["mobile"]), signals=kept) as recorder:
        recorder.append_block(random_rows(LAYOUTS["mobile"], 5))
        recording = recorder.finish(Outcome("completed", 0.05))
    with pytest.raises(UnknownName, match="motor_torque" if "z" in kept else "effective_gain"):
        metrics(recording, WINDOWS)


def test_no_windows_give_peaks_only():
    layout = LAYOUTS["fixed"]
    reducer = Reducer.of(layout, facts(layout), ())
    reducer.append_block(random_rows(layout, 5))
    assert not any("rms" in name for name in reducer.result())


@layouts
def test_halves_are_the_base_and_the_arm(layout):
    parts = halves(recorded(layout, random_rows(layout, 2)))
    sizes = {name: part.stop - part.start for name, part in parts.items()}
    assert sizes == {name: size for name, size in (("base", layout.base), ("arm", layout.arm)) if size}
