"""The thesis's figures: its arrangement, the recorded numbers, its intervals as bands, and the pictures of a run."""

from __future__ import annotations

from pathlib import Path

import builders
import numpy as np
import pytest
from builders import FIXED, MOBILE
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from mmnn_pin.cli.results import whats
from mmnn_pin.errors import RecordingError
from mmnn_pin.lab.experiments.config import FOLDER, bundled, load_experiment
from mmnn_pin.lab.experiments.thesis import figure_intervals, figure_ranges
from mmnn_pin.lab.show.figure import STYLES
from mmnn_pin.lab.show.gallery import PICTURES, require_plots, write_pictures
from mmnn_pin.lab.show.plots import gains_figure, psi_figure
from mmnn_pin.lab.show.thesis_figures import (
    arm_figure,
    joints_figure,
    one_layer_figure,
    pose_figure,
    two_layer_figure,
    velocity_figure,
)
from mmnn_pin.recording.recording import Recording
from mmnn_pin.signals import Dimensions


def recording(controller: str, layout: Dimensions = MOBILE, variant: str = "fair", rows: int = 40) -> Recording:
    config = f'{{"variant": "{variant}"}}'
    return builders.recording(controller, layout, rows=rows, noise=0.01, seed=len(controller), config=config)


@pytest.fixture
def runs() -> dict[str, Recording]:
    return {name: recording(name) for name in ("two_layer", "pd", "one_layer", "two_layer_zero")}


def curves(axes: Axes) -> list[Line2D]:
    return [line for line in axes.get_lines() if len(line.get_xdata()) > 2]  # type: ignore[arg-type]


def rings(axes: Axes) -> list[float]:
    return sorted(float(line.get_ydata()[0]) for line in axes.get_lines() if line.get_marker() == "o")  # type: ignore


def bands(axes: Axes) -> list[tuple[float, float]]:
    found = [patch for patch in axes.patches if isinstance(patch, Rectangle)]
    return sorted((patch.get_y(), patch.get_y() + patch.get_height()) for patch in found)


def test_pose_errors_of_one_layer_above_and_of_two_layer_below(runs: dict[str, Recording]) -> None:
    figure = pose_figure(runs)
    for axes, name in zip(figure.axes, ("one_layer", "two_layer"), strict=True):
        assert axes.get_ylabel().startswith(name)
        assert len({str(line.get_linestyle()) for line in curves(axes)}) > 1  # told apart in grey
        for line, x in zip(curves(axes), runs[name]["pose_error"].T, strict=True):
            np.testing.assert_allclose(line.get_ydata(), 1e3 * x)
            assert to_hex(line.get_color()).upper() == STYLES[name].color


@pytest.mark.parametrize(("make", "signal"), [(velocity_figure, "z"), (arm_figure, "e")])
def test_components_above_each_other_with_both_controllers(make, signal, runs: dict[str, Recording]) -> None:
    for column, axes in enumerate(make(runs).axes):
        for line, name in zip(curves(axes), ("one_layer", "two_layer"), strict=True):
            np.testing.assert_allclose(line.get_ydata(), 1e3 * runs[name][signal][:, column])
            assert to_hex(line.get_color()).upper() == STYLES[name].color


@pytest.mark.parametrize("name", [name for name in PICTURES if name.startswith("figure-")])
def test_bands_are_the_intervals_and_rings_the_values_of_the_table(name: str, runs: dict[str, Recording]) -> None:
    rows = figure_ranges(runs)
    for axes, place in zip(PICTURES[name].make(runs).axes, ("top", "bottom"), strict=True):
        here = f"{name.removeprefix('figure-')} {place}"
        known = [each for each in figure_intervals(int(here[0])) if each.figure == here]
        unit = 1e3 if here[0] == "4" else 1.0  # figures of chapter 5 are in degrees, as their intervals
        np.testing.assert_allclose(bands(axes), sorted((unit * k.lower, unit * k.upper) for k in known))
        np.testing.assert_allclose(rings(axes), sorted(unit * row["value"] for row in rows if row["figure"] == here))
        low, high = axes.get_ylim()
        assert all(low < edge < high for band in bands(axes) for edge in band)


def test_angles_lie_over_their_reference_in_degrees(runs: dict[str, Recording]) -> None:
    for make, name in ((one_layer_figure, "one_layer"), (two_layer_figure, "two_layer_zero")):
        for column, axes in enumerate(make(runs).axes):
            reference, joint = curves(axes)
            np.testing.assert_allclose(reference.get_ydata(), np.degrees(runs[name]["q_ref"][:, column]))
            np.testing.assert_allclose(joint.get_ydata(), np.degrees(runs[name]["q"][:, column]))
            assert to_hex(joint.get_color()).upper() == STYLES[name].color


def test_joint_errors_are_measured_ones_of_both_in_degrees(runs: dict[str, Recording]) -> None:
    for column, axes in enumerate(joints_figure(runs).axes):
        for line, name in zip(curves(axes), ("one_layer", "two_layer_zero"), strict=True):
            np.testing.assert_allclose(line.get_ydata(), np.degrees(runs[name]["e"][:, column]))
    del runs["two_layer_zero"]
    assert curves(joints_figure(runs).axes[0])[1].get_color() == STYLES["two_layer"].color
    np.testing.assert_allclose(
        curves(two_layer_figure(runs).axes[0])[1].get_ydata(), np.degrees(runs["two_layer"]["q"][:, 0])
    )


def test_the_variant_stands_in_the_title_unless_two_are_mixed(runs: dict[str, Recording]) -> None:
    def title() -> str:
        return pose_figure(runs).legends[0].get_title().get_text()

    assert title() == "Figure 4.2: pose error of the platform (variant fair)"
    runs["one_layer"] = recording("one_layer", variant="printed")
    assert title() == "Figure 4.2: pose error of the platform"


def test_one_run_of_each_learner_is_needed(runs: dict[str, Recording]) -> None:
    with pytest.raises(RecordingError, match="one run of one_layer with the signal z; there are 0"):
        velocity_figure({"two_layer": runs["two_layer"]})
    with pytest.raises(RecordingError, match="there are 2"):
        velocity_figure(
            {"a.h5": recording("one_layer"), "b.h5": recording("one_layer"), "two_layer": runs["two_layer"]}
        )
    with pytest.raises(RecordingError, match="pose_error; there are 0"):
        pose_figure({name: recording(name, FIXED) for name in ("one_layer", "two_layer")})
    assert len(arm_figure({name: recording(name, FIXED) for name in ("one_layer", "two_layer")}).axes) == 2


def test_psi_is_drawn_for_those_who_learn(runs: dict[str, Recording]) -> None:
    runs["pd"]["psi_hat"][:] = 0.0
    runs["computed_torque"] = recording("computed_torque")
    assert [axes.get_title() for axes in psi_figure(runs).axes[:2]] == ["two_layer", "one_layer"]
    with pytest.raises(RecordingError, match="nothing to plot for psi: its signals are not in pd"):
        psi_figure({"pd": runs["pd"]})


def test_gains_are_drawn_once_where_two_are_equal_by_construction(runs: dict[str, Recording]) -> None:
    del runs["two_layer_zero"]
    runs |= {name: recording(name) for name in ("pd_effective", "pd_effective_one_layer")}
    figure = gains_figure(runs)
    assert [axes.get_ylabel() for axes in figure.axes] == ["v [N s/m]", "w [N m s]", "lift [N m s]", "elbow [N m s]"]
    for column, axes in enumerate(figure.axes):
        for line, name in zip(curves(axes), ("two_layer", "pd", "one_layer"), strict=True):
            np.testing.assert_array_equal(line.get_ydata(), runs[name]["effective_gain"][:, column])
    alone = gains_figure({"pd_effective": runs["pd_effective"]})
    assert len(curves(alone.axes[0])) == 1


def test_names_of_pictures_agree_everywhere() -> None:
    assert sorted(whats()) == sorted(PICTURES)
    for name in (*bundled(), "chapter4.printed", "chapter4.figures"):
        require_plots(load_experiment(FOLDER / f"{name}.toml").plots)


def test_a_run_writes_what_it_has_something_for(runs: dict[str, Recording], tmp_path: Path) -> None:
    written = write_pictures(runs, ("figure-4.4", "gains"), tmp_path / "new")
    assert {name: file.read_bytes()[:4] for name, file in written.items()} == {
        "figure-4.4": b"\x89PNG",
        "gains": b"\x89PNG",
    }
    assert list(write_pictures({"pd": runs["pd"]}, ("figure-4.2", "gains"), tmp_path)) == ["gains"]
    empty = {"pd": recording("pd", rows=0)}
    assert write_pictures(empty, PICTURES, tmp_path / "none") == {} and not (tmp_path / "none").exists()
