"""The folder of a contest in `mmnn plot`, `report` and `prove`; windows that a short run does not reach."""

from __future__ import annotations

import json
import re
import shutil
from itertools import pairwise

import msgspec
import numpy as np
import pytest
from test_contest import NAMES, SET, quick

from mmnn_pin.cli import main
from mmnn_pin.errors import RecordingError
from mmnn_pin.lab.experiments.config import load_experiment
from mmnn_pin.lab.experiments.runner import run_experiment
from mmnn_pin.lab.show.table import number
from research.contest import show as figures
from research.contest.contest import opened, run_contest
from research.contest.show import render
from research.contest.task import demand, tasks_of
from research.contest.trial import Trial

FEW = ("pd", "two_layer", "adaptive")


@pytest.fixture(scope="module")
def standing(tmp_path_factory):
    experiment = quick(("eight", "poor"), more=["contest.beside=[]"], controllers=FEW)
    return run_contest(experiment, "contest", out=tmp_path_factory.mktemp("folder"), workers=2)


@pytest.fixture
def folder(standing):
    return standing.folder


def call(capsys, *words):
    code = main([str(word) for word in words])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


# -- the contest out of its folder --


def test_a_folder_gives_back_the_whole_contest(standing, folder):
    again = opened(folder)
    assert render(again) == render(standing) and again.to_dict() == standing.to_dict()
    (task, _) = tasks_of(quick(("eight", "poor"), controllers=FEW), FEW)
    assert again.demands["eight"] == demand(task)
    assert not again.missing and again.completed


def test_later_commands_add_to_a_folder_and_missing_rows_are_told(tmp_path, monkeypatch):
    first = run_contest(quick(controllers=("two_layer",)), "contest", out=tmp_path)
    more = run_contest(quick(("poor",), controllers=("pd",)), "contest", out=tmp_path)
    both = opened(tmp_path)
    assert list(both.tasks) == ["eight", "poor"] and set(both.controllers) == {*first.controllers, *more.controllers}
    assert len(both.results) == len(first.results) + len(more.results) and not both.interrupted
    kept = json.loads((tmp_path / "rows.json").read_text())
    del kept["poor/pd"]
    (tmp_path / "rows.json").write_text(json.dumps(kept))
    rest = opened(tmp_path)
    assert rest.missing == ("poor/pd",) and rest.interrupted and not rest.completed
    anew = run_contest(quick(("poor",), controllers=("pd",), more=["contest.beside=[]"]), "c", out=tmp_path, force=True)
    assert list(opened(tmp_path).tasks) == ["poor"] and len(opened(tmp_path).results) == len(anew.results)


def test_broken_and_old_folders_are_refused(tmp_path, folder, capsys):
    shutil.copy(folder / "rows.json", tmp_path)
    with pytest.raises(RecordingError, match=r"no contest\.json"):
        opened(tmp_path)
    (tmp_path / "contest.json").write_text('{"name": 3}')
    code, _, err = call(capsys, "plot", tmp_path, "--out", tmp_path / "plots")
    assert code == 2 and "contest.json: error: cannot be read" in err and err.count("\n") == 1
    shutil.copy(folder / "contest.json", tmp_path)
    (tmp_path / "rows.json").unlink()
    with pytest.raises(RecordingError, match="a contest without rows"):
        opened(tmp_path)


# -- plot, report, prove --


def test_plot_draws_the_figures_of_a_contest_again(folder, tmp_path, capsys):
    code, out, _ = call(capsys, "plot", folder, "--out", tmp_path, "--json")
    files = json.loads(out)["files"]
    assert code == 0 and list(files) == list(figures.FIGURES["contest"])
    assert call(capsys, "plot", folder, "--what", "contest-fvu", "--out", tmp_path / "one.svg")[0] == 0
    assert (tmp_path / "one.svg").read_text().lstrip().startswith("<?xml")
    code, _, err = call(capsys, "plot", folder, "--out", tmp_path)
    assert code == 2 and "the picture exists" in err


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["plot", "{}", "--what", "psi"], "'psi' is a plot of the runs of one folder: name one of its folders"),
        (["plot", "{}/eight", "--what", "contest-fvu"], "'contest-fvu' is a figure of a contest"),
        (["plot", "{}", "{}/eight/pd.h5"], "a contest among other runs: name it alone"),
        (["report", "{}", "{}/eight", "--html", "x.html"], "a contest among other runs: name it alone"),
        (["export", "{}", "--to", "csv"], "name one of its folders: eight, poor"),
        (["prove", "{}"], "FOLDER is one of eight, poor; FILE one of adaptive.h5, pd.h5, two_layer.h5"),
        (["prove", "{}/eight"], "name one of its recordings: adaptive.h5, pd.h5, two_layer.h5"),
    ],
)
def test_what_a_folder_is_not_taken_for_is_one_line(words, says, folder, capsys):
    code, _, err = call(capsys, *(word.format(folder) for word in words))
    assert code == 2 and says in err and err.count("\n") == 1, err


@pytest.mark.parametrize("span", [2.5, 5.0, 34.0, 51.0, 99.0, 101.0, 300.0, 1e4, 1e9])
def test_numbers_of_a_logarithmic_axis_do_not_touch(span):
    """In the panel of the FVU, on both axes, wherever the range begins; a short one has two at least."""
    for low in (0.17, 1.0, 3.3):
        figure, (axes,) = figures.axes_grid(1, 4, 3.2, 3.1, 0.9)
        axes.plot([low, low * span], [low, low * span])
        axes.set(xscale="log", yscale="log", xlim=(low, low * span), ylim=(low, low * span))
        figures.number_axes(axes.xaxis, axes.yaxis)
        figure.canvas.draw()
        for axis, part in ((axes.xaxis, "intervalx"), (axes.yaxis, "intervaly")):
            inside, labels = getattr(axes.bbox, part), axis.get_ticklabels(which="both")
            places = [tuple(getattr(label.get_window_extent(), part)) for label in labels if label.get_text()]
            places = sorted((a, b) for a, b in places if inside[0] <= (a + b) / 2 <= inside[1])
            assert len(places) >= 2 and all(a[1] < b[0] for a, b in pairwise(places))


def test_the_page_has_all_tables_targets_and_figures(standing, folder, tmp_path, capsys):
    code, out, _ = call(capsys, "report", folder, "--html", tmp_path / "page.html", "--json")
    page = (tmp_path / "page.html").read_text()
    assert code == 0 and json.loads(out)["bytes"] == len(page.encode())
    assert page.count("<svg") == len(figures.FIGURES["contest"])
    assert not re.findall(r"(?:src|href)=.http", page)
    for task in ("eight", "poor"):
        for name in FEW:
            shown = number(1e3 * np.median([row.rms["phi"] for row in standing.of(task, name)]))
            assert re.search(rf">{re.escape(shown)}(\s±\d+ %)?<", page)
    judged = [target for target in standing.targets() if target.reached is not None]
    assert f"{sum(target.met for target in judged)} of {len(judged)} targets met" in page
    assert all(text in page for text in ("What the learners say", "not excited", "mmnn report"))


# -- learning curves, pictures --


def test_joined_windows_keep_the_mean_square():
    curve = list(np.random.default_rng(3).uniform(0.1, 3.0, 80))
    thin = figures.thinned(curve, 4)
    assert len(thin) == 20
    assert np.mean(thin**2) == pytest.approx(np.mean(np.square(curve)))
    assert figures.thinned([2.0, 1.0], 1).tolist() == [2.0, 1.0]


def test_a_picture_has_few_colours_and_looks_the_same(standing, tmp_path):
    from PIL import Image

    from mmnn_pin.lab.show.figure import save

    figure = figures.errors(standing)
    figure.savefig(tmp_path / "all.png", dpi=160)
    few = save(figure, tmp_path / "few.png")
    one, other = (np.asarray(Image.open(file).convert("RGB"), float) for file in (tmp_path / "all.png", few))
    assert few.stat().st_size < 0.6 * (tmp_path / "all.png").stat().st_size
    assert np.sqrt(np.mean((one - other) ** 2)) < 2.0  # of 255


# -- windows that are not reached --


def test_windows_beyond_a_run_are_told_once(capsys, tmp_path):
    short = ["--set", "time.duration=0.5", "--set", "windows=[[0, 0.2], [0.3, 2], [3, 4]]", "--set", "plots=[]"]
    code, out, err = call(capsys, "run", "chapter4", "--controller", "pd", *short, "--out", tmp_path / "a")
    assert code == 0 and out.count("no errors in the window 3-4 s: the run is over after 0.5 s") == 1 and err == ""
    assert out.count("errors in the window 0.3-2 s count to the end of the run, 0.5 s") == 1
    experiment = load_experiment("chapter4", ["time.duration=0.5", "windows=[[0, 0.2], [0.2, 0.5]]"])
    within = run_experiment(msgspec.structs.replace(experiment, controllers=("pd",)), "c")
    assert not any("window" in note for note in within.notes)


def test_a_contest_tells_before_it_runs_where_no_errors_will_be(capsys, tmp_path):
    late = ["--set", "windows=[[0, 1], [3, 4]]", "--set", "contest.beside=[]", "--controller", "pd"]
    words = ["contest", "--case", "eight", *SET, *late, "--out", tmp_path, "--json"]
    code, out, err = call(capsys, *words)
    assert code == 0 and err.count("no errors where the last window begins after the end") == 1
    assert "eight (3-4 s of 1.6 s)" in err and "eight (3-4 s" in json.loads(out)["comparison"]["notes"][0]
    assert tasks_of(quick(), NAMES)[0].experiment.windows[-1] == (0.8, 1.6)


def test_a_law_that_says_inf_at_once_is_a_lost_run(capsys, tmp_path):
    """Its recording holds no rows, which nothing behind it may mind."""
    (tmp_path / "mine.py").write_text(
        "import numpy as np\nfrom mmnn_pin import LearningLaw\n"
        "from mmnn_pin.torque.controller import ControllerState\n\n\nclass Inf(LearningLaw):\n"
        "    def init(self, context):\n        return ControllerState.of(w=(2,))\n\n"
        "    def estimate(self, now, state):\n        return np.full(now.s.size, np.inf)\n\n"
        "    def learn(self, now, state):\n        pass\n"
    )
    words = ["--controller", tmp_path / "mine.py:Inf", "--set", "contest.beside=[]", "--out", tmp_path / "out"]
    code, out, err = call(capsys, "contest", "--case", "eight", *SET, *words)
    assert code == 1 and "2 of 2 lost" in out and "diverged at 0 s" in out and err == "", err
    assert not opened(tmp_path / "out").completed


def test_files_of_trials_have_the_keys_that_older_versions_wrote() -> None:
    text = b'{"fingerprint":"a","step_time":null,"rows":[]}'
    trial = msgspec.json.decode(text, type=Trial)
    assert trial.results == [] and msgspec.json.encode(trial) == text
