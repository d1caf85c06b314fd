"""The figures show the recorded numbers, in the units their axes name, and tell the controllers apart."""

import re
import subprocess
import sys
from itertools import combinations

import numpy as np
import pytest
from matplotlib.colors import to_hex, to_rgb
from matplotlib.figure import Figure
from places import ROOT

from mmnn_pin.errors import RecordingError
from mmnn_pin.lab.experiments import controllers
from mmnn_pin.lab.show import plots
from mmnn_pin.lab.show.curves import touch
from mmnn_pin.lab.show.figure import (
    FIGURES,
    OTHERS,
    STYLES,
    folded,
    in_the_dark,
    save,
    styles_of,
    styles_of_controllers,
    svg,
)
from mmnn_pin.lab.show.gallery import PICTURES
from mmnn_pin.lab.show.plots import errors_figure, path_figure, psi_figure, torque_figure
from mmnn_pin.recording.recorder import Recorder
from mmnn_pin.recording.recording import Outcome, Recording
from mmnn_pin.signals import Layout

MOBILE, FIXED = Layout(base=2, arm=2, full=7, motors=4), Layout(base=0, arm=2, full=2, motors=2)
CONTROLLERS = ("two_layer", "one_layer", "pd", "pd_effective", "pd_effective_one_layer", "computed_torque")
OVERLAID = ("errors", "torque", "psi", "gains", "path")
SLIDING = "<robot name='r'><joint name='lift' type='prismatic'/><joint name='elbow' type='revolute'/></robot>"


def recording(controller="two_layer", layout=MOBILE, rows=50, outcome=None, seed=0, **meta) -> Recording:
    table = np.random.default_rng(seed).normal(size=(rows, layout.width))
    table[:, 0] = 0.1 * np.arange(rows)
    names = ("v", "w", "lift", "elbow")[-layout.dof :]
    motors = ("left", "right", "lift", "elbow")[-layout.motors :]
    facts = {"controller": controller, "velocity_names": names, "actuator_names": motors, "urdf": SLIDING}
    recorder = Recorder(layout, facts | meta)
    recorder.append_block(table)
    return recorder.finish(outcome or Outcome("completed", 0.1 * rows))


def diverged(controller="pd", **options) -> Recording:
    rec = recording(controller, rows=20, outcome=Outcome("diverged", 2.0, "nu[0]"), seed=3, **options)
    for name in {"pose_error", "z", "e", "psi_hat", "torque", "motor_torque", "pose"} & set(rec):
        rec[name][-5:] *= np.array([1e3, 1e9, 1e100, 1e300, np.nan])[:, None]
    return rec


def axes_of(figure: Figure, ylabel: str):
    (found,) = [axes for axes in figure.axes if axes.get_ylabel() == ylabel]
    return found


def curves(axes):
    """Lines with more than two points: neither zero lines nor marks."""
    return [line for line in axes.get_lines() if len(line.get_xdata()) > 2]


def legend_of(figure: Figure) -> list[str]:
    (legend,) = figure.legends
    return [text.get_text() for text in legend.get_texts()]


def test_of_what_is_felt_only_that_is_drawn_which_says_something():
    """Axes of the wrench that no joint feels, and torques within their band, have no panel."""
    run = recording(layout=Layout(base=2, arm=2, full=7, motors=4, touch=1))
    run["external_wrench"][:, [2, 3, 4]] = 1e-9
    run["external_band"][:] = [10.0, 10.0, 0.1, 10.0]
    panels = list(touch({"pd": run}))
    assert [panel.title for panel in panels] == ["contact", "hand fx", "hand fy", "hand mz", "on lift"]
    np.testing.assert_array_equal(panels[4].curves["pd"][1], run["external_torque"][:, 2])


def test_errors_are_drawn_in_the_units_on_their_axes():
    runs = {"two_layer": recording(seed=1), "pd": recording("pd", seed=2)}
    figure = errors_figure(runs)
    expected = {
        "x [mm]": ("true_pose_error", 0),
        "y [mm]": ("true_pose_error", 1),
        "heading [mrad]": ("true_pose_error", 2),
        "v [mm/s]": ("true_z", 0),
        "w [mrad/s]": ("true_z", 1),
        "lift [mm]": ("true_e", 0),
        "elbow [mrad]": ("true_e", 1),
    }
    assert [axes.get_ylabel() for axes in figure.axes] == list(expected)
    for ylabel, (signal, column) in expected.items():
        for line, rec in zip(curves(axes_of(figure, ylabel)), runs.values(), strict=True):
            np.testing.assert_allclose(line.get_xdata(), rec.time)
            np.testing.assert_allclose(line.get_ydata(), 1000 * rec[signal][:, column])
    assert legend_of(figure) == ["two_layer", "pd"]
    assert [axes.get_xlabel() for axes in figure.axes].count("time [s]") == 3  # the lowest of every column


def test_a_controller_looks_the_same_everywhere():
    runs = {name: recording(name, seed=k) for k, name in enumerate(CONTROLLERS)}
    for what in ("errors", "torque", "path"):
        for some in (runs, dict(reversed(runs.items())), {"pd": runs["pd"]}):
            axes = PICTURES[what].make(some).axes[-1]
            for line, name in zip(curves(axes), some, strict=True):
                assert to_hex(line.get_color()).upper() == STYLES[name].color
                assert line.get_linewidth() == STYLES[name].width


def test_styles_differ_in_colour_and_in_dash():
    assert set(STYLES) == set(controllers.CONTROLLERS)
    assert STYLES["two_layer_zero"] == STYLES["two_layer"], "the thesis's network, wherever it appears"
    named = [style for name, style in STYLES.items() if name != "two_layer_zero"]
    for a, b in combinations(named, 2):
        assert a.color != b.color and a.dash != b.dash
    every = (*named, *OTHERS)
    assert len({(style.color, style.dash) for style in every}) == len(every)
    for style in every:  # dark enough for white paper, also in grey
        assert np.dot([0.2126, 0.7152, 0.0722], to_rgb(style.color)) < 0.7


def test_other_names_get_their_controller_s_style_once_and_then_free_ones():
    rec = recording("pd")
    styles = styles_of({"a.h5": rec, "b.h5": rec, "two_layer": recording(), "mine": recording("mine")})
    assert (styles["a.h5"], styles["two_layer"]) == (STYLES["pd"], STYLES["two_layer"])
    assert len(set(styles.values())) == 4
    many = styles_of({str(k): recording("mine", rows=1) for k in range(2 * len(OTHERS))})
    assert len(set(many.values())) == len(OTHERS)
    five = styles_of({str(k): recording("mine", rows=1) for k in range(5)}).values()
    assert len({style.color for style in five}) == 5, "a replay has colours alone"
    for names in (("two_layer", "two_layer_zero"), ("two_layer_zero", "two_layer")):
        for both in (styles_of({name: recording(name) for name in names}), styles_of_controllers(names)):
            assert list(both) == list(names) and both["two_layer"] == STYLES["two_layer"] != both["two_layer_zero"]


def test_a_note_of_a_limit_stands_above_the_curves():
    axes = torque_figure({"two_layer": recording(effort_limits=(1e6, 2.0, float("inf"), 3.0))}).axes[2]
    lower, upper = axes.get_ylim()
    highest = max(line.get_ydata().max() for line in curves(axes))
    assert axes.texts and highest < upper - 0.16 * (upper - lower)


def test_torques_of_base_and_motors_with_their_limits():
    rec = recording(effort_limits=(1e6, 2.0, float("inf"), 3.0))
    figure = torque_figure({"two_layer": rec})
    labels = [axes.get_ylabel() for axes in figure.axes]
    assert labels == ["v [N]", "w [N m]", "left [N m]", "right [N m]", "lift [N]", "elbow [N m]"]
    columns = [("torque", 0), ("torque", 1), *(("motor_torque", i) for i in range(4))]
    for axes, (signal, k) in zip(figure.axes, columns, strict=True):
        np.testing.assert_array_equal(curves(axes)[0].get_ydata(), rec[signal][:, k])
        assert curves(axes)[0].get_drawstyle() == "steps-post"  # held between samples
    limits = [[line.get_ydata()[0] for line in axes.get_lines()[2:]] for axes in figure.axes]
    assert limits == [[], [], [], [-2.0, 2.0], [], [-3.0, 3.0]]
    assert [text.get_text() for text in figure.axes[2].texts] == [r"limit $\pm$1e+06 N m"]


def test_psi_stands_beside_what_was_learned_per_component_and_controller():
    runs = {"two_layer": recording(seed=1), "one_layer": recording("one_layer", seed=2)}
    figure = psi_figure(runs)
    grid = np.array(figure.axes).reshape(4, 2)
    assert [axes.get_ylabel() for axes in grid[:, 0]] == ["v [N]", "w [N m]", "lift [N]", "elbow [N m]"]
    for column, rec in zip(grid.T, runs.values(), strict=True):
        for i, axes in enumerate(column):
            truth, learned = curves(axes)
            np.testing.assert_array_equal(truth.get_ydata(), rec["psi"][:, i])
            np.testing.assert_array_equal(learned.get_ydata(), rec["psi_hat"][:, i])
    assert [axes.get_title() for axes in grid[0]] == list(runs)


@pytest.mark.parametrize("count", [5, 6, 13])
def test_psi_of_many_learners_is_folded(count, tmp_path):
    """Each run stays whole in a column, the scale of a component is one; a row of 13 was 40 inches wide."""
    runs = {f"run {k}": recording(seed=k) for k in range(count)}
    figure = psi_figure(runs)
    bands, columns = {5: (1, 5), 6: (2, 3), 13: (3, 5)}[count]
    grid = np.array(figure.axes).reshape(bands, 4, columns)
    for k, (name, rec) in enumerate(runs.items()):
        mine = grid[k // columns, :, k % columns]
        assert mine[0].get_title() == name and mine[-1].get_xlabel() == "time [s]"
        for i, axes in enumerate(mine):
            np.testing.assert_array_equal(curves(axes)[1].get_ydata(), rec["psi_hat"][:, i])
            assert axes.get_ylim() == grid[0, i, 0].get_ylim()
    assert [axes.axison for axes in grid[:, 0].flat] == [k < count for k in range(bands * columns)]
    assert figure.get_size_inches()[0] <= 16


def test_path_and_headings_in_the_plane():
    rec = recording(seed=1)
    figure = path_figure({"two_layer": rec})
    plane, below = figure.axes
    reference, driven = curves(plane)
    np.testing.assert_array_equal(reference.get_xydata(), rec["pose_ref"][:, :2])
    np.testing.assert_array_equal(driven.get_xydata(), rec["pose"][:, :2])
    assert plane.get_aspect() == 1.0
    wanted, arrows = plane.collections
    at = [np.flatnonzero((rec["pose"][:, :2] == point).all(axis=1))[0] for point in arrows.get_offsets()]
    assert at[0] == 0 and at[-1] == len(rec) - 1 and len(at) == 10
    np.testing.assert_allclose(np.arctan2(arrows.V, arrows.U), np.angle(np.exp(1j * rec["pose"][at, 2])))
    gap = rec["pose_ref"] - rec["pose"]
    np.testing.assert_allclose(below.get_lines()[0].get_ydata(), 1000 * np.sqrt(gap[:, 0] ** 2 + gap[:, 1] ** 2))
    assert len(wanted.U) == 10 and legend_of(figure) == ["reference", "two_layer"]


def test_a_reference_that_several_runs_share_is_drawn_once():
    whole, short = recording(seed=1), recording("pd", rows=20, seed=2)
    short["pose_ref"][:] = whole["pose_ref"][:20]
    assert len(curves(path_figure({"two_layer": whole, "pd": short}).axes[0])) == 3
    assert len(curves(path_figure({"two_layer": whole, "pd": recording("pd", seed=2)}).axes[0])) == 4


@pytest.mark.parametrize("what", OVERLAID)
def test_a_diverged_run_ends_in_a_cross_and_leaves_the_scale_alone(what):
    alone = PICTURES[what].make({"two_layer": recording()})
    both = PICTURES[what].make({"two_layer": recording(), "pd": diverged()})
    if what == "path":  # its reference is another
        assert max(map(abs, both.axes[0].get_xlim())) < 30
    else:
        step = 2 if what == "psi" else 1
        for one, two in zip(alone.axes, both.axes[::step], strict=True):
            assert one.get_ylim() == two.get_ylim()
    crosses = [line for axes in both.axes for line in axes.get_lines() if line.get_marker() == "X"]
    assert len(crosses) == (0 if what == "psi" else len(both.axes))
    for cross in crosses:
        (low, high), (y,) = cross.axes.get_ylim(), cross.get_ydata()
        assert low <= y <= high
    texts = legend_of(both) if what != "psi" else [axes.get_title() for axes in both.axes[:2]]
    assert "pd (diverged at 2 s)" in texts


@pytest.mark.parametrize(("what", "layout"), [("errors", FIXED), ("path", MOBILE)])
def test_huge_values_can_be_drawn(what, layout, tmp_path):
    runs = {"two_layer": recording(layout=layout), "pd": diverged(layout=layout)}
    save(PICTURES[what].make(runs), tmp_path / "both.png")
    save(PICTURES[what].make({"pd": runs["pd"]}), tmp_path / "alone.png")


def test_a_fixed_arm_shows_what_it_has():
    runs = {"two_layer": recording(layout=FIXED)}
    assert [axes.get_ylabel() for axes in errors_figure(runs).axes] == ["lift [mm]", "elbow [mrad]"]
    assert len(psi_figure(runs).axes) == len(torque_figure(runs).axes) == 2
    with pytest.raises(RecordingError, match="nothing to plot for path: its signals are not in two_layer"):
        path_figure(runs)


def test_robots_without_motors_show_the_arm_s_torque_and_long_arms_take_columns():
    names = tuple(f"j{i}" for i in range(7))
    figure = torque_figure({"pd": recording(layout=Layout(0, 7, 7, 0), velocity_names=names, actuator_names=())})
    assert [axes.get_ylabel() for axes in figure.axes] == [f"j{i} [N m]" for i in range(7)]
    left = sorted({round(axes.get_position().x0, 3) for axes in figure.axes})
    assert len(left) == 2


@pytest.mark.parametrize("what", OVERLAID)
def test_empty_runs_and_strange_names_do_no_harm(what, tmp_path):
    with pytest.raises(RecordingError, match="no recording was given"):
        PICTURES[what].make({})
    layout = MOBILE if what == "path" else FIXED
    none = recording(layout=layout, rows=0, outcome=Outcome("tripped", 0.0))
    runs = {"$x_{$": recording(layout=layout), "none": none, "one": recording(layout=layout, rows=1)}
    save(PICTURES[what].make(runs), tmp_path / "odd.svg")


def test_letters_that_the_font_lacks_warn_nobody(tmp_path, recwarn):
    figure = torque_figure({"\u80d8\x9b": recording(layout=FIXED), "pd": recording("pd", layout=FIXED)})
    save(figure, tmp_path / "odd.png")
    assert svg(figure) and [str(one.message) for one in recwarn] == []


@pytest.mark.parametrize(("name", "magic"), [("a.png", b"\x89PNG"), ("new/a.SVG", b"<?xml"), ("a.pdf", b"%PDF")])
def test_formats_by_suffix_and_equal_bytes(name, magic, tmp_path):
    runs = {"two_layer": recording(layout=FIXED)}
    first = save(errors_figure(runs), tmp_path / name).read_bytes()
    assert first.startswith(magic)
    assert save(errors_figure(runs), tmp_path / name).read_bytes() == first
    assert list((tmp_path / name).parent.glob(".*")) == []


def test_what_cannot_be_saved_is_told(tmp_path):
    figure = Figure()
    for name in ("a.bmp", "a"):
        with pytest.raises(RecordingError, match=r"unknown format.*\.png, \.svg, \.pdf"):
            save(figure, tmp_path / name)
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordingError, match="cannot write the figure"):
        save(figure, tmp_path / "file" / "a.png")
    (tmp_path / "a.png").mkdir()
    with pytest.raises(RecordingError, match="cannot write the figure"):
        save(figure, tmp_path / "a.png")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.png", "file"]


def test_plots_need_no_display_and_load_matplotlib_late():
    code = (
        "import sys, mmnn_pin.lab.show.plots as p, mmnn_pin.errors as e; assert 'matplotlib' not in sys.modules; "
        "import os; os.environ['MPLBACKEND'] = 'TkAgg'\n"
        "try: p.errors_figure({})\nexcept e.RecordingError: pass\n"
        "assert 'matplotlib.pyplot' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_the_figure_of_contributing_draws_the_slip_of_every_wheel(monkeypatch):
    (text,) = re.findall(r"```python\n(@chart.*?)```", (ROOT / "CONTRIBUTING.md").read_text(), re.S)
    for register in (FIGURES["runs"], plots.curves.CHARTS):  # they are as they were afterwards
        monkeypatch.setitem(register, "slip", None)
    exec("from __future__ import annotations\n" + text, dict(vars(plots.curves)))
    plots.figure("slip")(plots.stack_of("slip"))
    run = recording(layout=Layout(base=2, arm=2, full=7, motors=4, wheels=2))
    figure = FIGURES["runs"]["slip"].make({"pd": run})
    for i, wheel in enumerate(("left", "right")):
        (line,) = curves(axes_of(figure, f"{wheel} [m/s]"))
        np.testing.assert_array_equal(line.get_ydata(), run["slip"][:, i])
    with pytest.raises(RecordingError, match="nothing to plot for slip"):
        FIGURES["runs"]["slip"].make({"pd": recording()})


@pytest.mark.parametrize("what", OVERLAID[:4])
def test_long_names_of_joints_do_not_meet(what):
    """Fourteen joints: no label is longer than its own axes, and every column says what it is."""
    joints = (*(f"left_gripper_finger_{i}_of_wrist_roll_joint" for i in range(13)), "CamelCaseWithoutAnyPlaceToFold")
    layout, names = Layout(base=2, arm=14, full=19, motors=16), ("v", "w", *joints)
    facts = {"velocity_names": names, "actuator_names": ("left_drive_wheel_joint", "right_drive_wheel_joint", *joints)}
    figure = PICTURES[what].make({"two_layer": recording(layout=layout, **facts)})
    figure.canvas.draw()
    for axes in figure.axes:
        label, own = axes.yaxis.label, axes.get_window_extent()
        if label.get_text():
            box = label.get_window_extent()
            assert own.y0 - 4 <= box.y0 and box.y1 <= own.y1 + 4, label.get_text()
    tops = {axes.get_subplotspec().colspan.start: axes for axes in reversed(figure.axes)}
    assert all(axes.get_title().strip() for axes in tops.values())


def test_a_label_is_not_broken_in_its_unit():
    assert folded("arm_1_joint [N m s]").split("\n") == ["arm_1_joint", "[N m s]"]
    assert folded("pose error, in the base frame [mm or mrad]").split("\n")[-1].endswith("[mm or mrad]")


def test_the_reference_of_a_replay_has_a_colour_of_its_own():
    """No run's colour is near that of the wanted path and the ghost, on a light page or a dark one (CIELAB)."""
    script = (ROOT / "mmnn_pin/lab/show/replay/web/run.js").read_text()
    light, dark = re.search(r'REFERENCE = \{ light: "(#\w+)", dark: "(#\w+)" \}', script).groups()
    for name in ("two_layer", "pd", "pd_gravity", "pid", "pd_effective", "computed_torque"):
        assert distance(STYLES[name].color, light) > 30, name
        assert distance(in_the_dark(STYLES[name].color), dark) > 30, name


def distance(one: str, other: str) -> float:
    """Distance of two colours in CIELAB."""
    a, b = (lab(np.array(to_rgb(color))) for color in (one, other))
    return float(np.linalg.norm(a - b))


def lab(rgb: np.ndarray) -> np.ndarray:
    """CIELAB of sRGB, white D65."""
    flat = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    to_xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
    share = to_xyz @ flat / [0.9505, 1.0, 1.089]
    x, y, z = np.where(share > 0.008856, np.cbrt(share), 7.787 * share + 16 / 116)
    return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])
