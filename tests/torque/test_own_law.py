"""A user's law from its file: named in an experiment or a command, run, judged, plotted; and what is refused."""

from __future__ import annotations

import ast
import hashlib
import json
import re
import shutil
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from places import ROOT
from test_prove import compiled_only

from mmnn_pin import LearningLaw, Recording, load_experiment, run_experiment
from mmnn_pin.cli import main
from mmnn_pin.errors import ConfigError, InputError, UnknownName
from mmnn_pin.lab.experiments.config import recorded_experiment
from mmnn_pin.lab.experiments.laws import load_class
from mmnn_pin.lab.psi.judgement import Judgement
from mmnn_pin.lab.psi.psi import worst

EXAMPLE = ROOT / "examples/own_law.py"
SPEC = f"{EXAMPLE}:LeastSquares"
SHORT = ("--set", "time.duration=0.6", "--set", "time.control_period=0.002", "--set", "time.plant_step=0.002")

LAW = """
import numpy as np
from mmnn_pin import LearningLaw, TorqueController
from mmnn_pin.torque.controller import ControllerState

open({marker!r}, "a").write("x")

class Own(LearningLaw):
    rate: float = 2.0
    sizes: tuple[int, ...] = (3, 4)

    def init(self, context):
        return ControllerState.of(W=(1, context.layout.dof))

    def estimate(self, now, state):
        return state["W"][0]

    def learn(self, now, state):
        state["W"] += self.rate * now.s

class Half(LearningLaw):
    def init(self, context):
        return ControllerState.of()

class Plain(TorqueController):
    def __init__(self, feedback, ki):
        self.feedback, self.ki = feedback, ki

    def step(self, time, reference, measurement, command, state):
        return 20.0 * np.concatenate((command.z, command.r))

class Picky(Own):
    def init(self, context):
        return ControllerState.of(W=(2, 2))[self.name]

class Loose:
    pass
"""


@pytest.fixture
def law(tmp_path: Path) -> Path:
    """A file with laws, which leaves a mark when it is run."""
    file = tmp_path / "laws.py"
    file.write_text(LAW.format(marker=str(tmp_path / "was_run")))
    return file


def told(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, dict[str, Any], str]:
    code = main([*map(str, arguments), "--json"])
    captured = capsys.readouterr()
    return code, json.loads(captured.out), captured.err


# -- the example --


def test_the_example_is_a_class_of_under_60_lines() -> None:
    (kind,) = (node for node in ast.parse(EXAMPLE.read_text()).body if isinstance(node, ast.ClassDef))
    assert kind.end_lineno is not None and kind.end_lineno - kind.lineno + 1 < 60


@pytest.mark.long
@compiled_only
def test_the_example_is_run_judged_and_plotted_like_any_other(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, file = tmp_path / "runs", tmp_path / "runs/LeastSquares.h5"
    noise = ("--set", "sensor.noise=1e-4", "--set", "sensor.velocity_noise=2e-3", "--set", "friction.base=[30.0,5.0]")
    more = ("--set", "laws.LeastSquares.noise=2e-3", "--set", "time.duration=6")
    code, found, _ = told(
        capsys, "run", "track", "--controller", SPEC, "--controller", "pd", "--out", out, *SHORT, *noise, *more
    )
    assert code == 0 and set(found["runs"]) == {"LeastSquares", "pd"} and set(found["plots"]) == {"errors"}
    ours, pd = (found["runs"][name]["metrics"] for name in ("LeastSquares", "pd"))
    late = [name for name in pd if name.endswith("rms_2_10")]
    assert late and all(ours[name] < 0.5 * pd[name] for name in late)
    # what it knows is told once its file is named; it is a law that knows
    kinds = [kind for kind in LearningLaw.__subclasses__() if kind.__name__ == "LeastSquares"]
    for kind in kinds:
        kind.__name__ = "Forgotten"  # as in a fresh process
    code, found, errors = told(capsys, "judge", file)
    assert errors.startswith("warning: what the weights of LeastSquares know is judged with --law ")  # before it begins
    assert code == 0 and found["psi"]["online"]["base"] < 0.1 and found["psi"]["frozen"] == {}
    assert any(f"--law {EXAMPLE}" in remark for remark in found["remarks"])
    for kind in kinds:
        kind.__name__ = "LeastSquares"
    code, found, _ = told(capsys, "judge", file, "--law", EXAMPLE)
    frozen = found["psi"]["frozen"]
    assert code == 0 and worst(np.array([frozen["held_out"]["base"], frozen["held_out"]["arm"]])) < 0.1
    assert found["psi"]["networks"]["all"]["units"] == 27
    assert not any("law" in remark for remark in found["remarks"])
    whats = [word for what in ("psi", "fvu", "weights", "frozen") for word in ("--what", what)]
    code, found, _ = told(capsys, "plot", out, "--law", EXAMPLE, *whats, "--out", tmp_path / "plots")
    assert code == 0 and all(Path(picture).stat().st_size > 5000 for picture in found["files"].values())
    code, found, _ = told(capsys, "report", out, "--law", SPEC, "--html", tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text()
    assert code == 0 and "LeastSquares" in page and "FVU frozen, held out" in page


# -- by name, with settings, recorded --


@compiled_only
def test_it_is_recorded_with_its_file_class_hash_and_settings(
    law: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    experiment = load_experiment(
        "track", ['controllers=["pd","fast","laws.py:Own"]', 'laws.fast={law="laws.py:Own",rate=5.0}', *SHORT[1::2]]
    )
    assert experiment.controllers == ("pd", "fast", "Own") and not (tmp_path / "was_run").exists()
    result = run_experiment(experiment, "mine", out=tmp_path / "runs")
    assert sorted(f.name for f in (tmp_path / "runs").iterdir()) == ["Own.h5", "fast.h5", "pd.h5"]
    for name, rate in (("fast", 5.0), ("Own", 2.0)):
        recording = result.recordings[name]
        about = recording.meta["law"]
        assert about == {"class": "Own", "file": str(law), "sha256": hashlib.sha256(law.read_bytes()).hexdigest()}
        assert recording.meta["controller"] == name
        found = recording.meta["controller_settings"]
        assert found["rate"] == rate and found["sizes"] == [3, 4] and found["learning"] is True
        equal = result.recordings["pd"].meta["controller_settings"]
        assert recorded_experiment(recording) == experiment and equal == {}
        gain = recording["effective_gain"][0]
        np.testing.assert_array_equal(gain, result.recordings["pd"]["effective_gain"][0])
    ratio = result.recordings["fast"].weights["W"][1] / result.recordings["Own"].weights["W"][1]
    assert (np.abs(ratio) > 1.5).any()  # the settings count
    frozen = run_experiment(
        load_experiment("track", ['controllers=["laws.py:Own"]', "learning.learning=false", *SHORT[1::2]]), "f"
    )
    assert not frozen.recordings["Own"]["psi_hat"].any()


@compiled_only
def test_nothing_runs_a_file_because_a_recording_says_so(
    law: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, *_ = told(capsys, "run", "track", "--controller", f"{law}:Own", "--out", tmp_path / "runs", *SHORT)
    file, mark = tmp_path / "runs/Own.h5", tmp_path / "was_run"
    assert code == 0 and mark.read_text() == "x"  # once
    text = law.read_text().replace("Own", "Other")
    law.write_text(text + "\n# changed\n")  # another content, so it would be run again
    with h5py.File(file, "r+") as recording:
        about = json.loads(recording.attrs["law"][5:]) | {"class": "Other"}
        recording.attrs["law"] = "json:" + json.dumps(about)
    for command in ("judge", "plot", "report", "export", "replay"):
        more = {
            "plot": ("--out", tmp_path / "p", "--what", "frozen", "--what", "fvu"),
            "report": ("--html", tmp_path / "r.html"),
        }
        more |= {"export": ("--to", "csv", "--out", tmp_path / "x"), "replay": ("--html", tmp_path / "v.html")}
        main([command, str(file), *map(str, more.get(command, ()))])
        capsys.readouterr()
        assert mark.read_text() == "x", command
    code, found, _ = told(capsys, "judge", file, "--law", law)
    assert code == 0 and mark.read_text() == "xx"
    assert found["psi"]["frozen"] and any("its SHA-256 differs" in remark for remark in found["remarks"])


def test_settings_are_of_the_types_that_the_class_declares(law: Path) -> None:
    def controller(*settings: str) -> Any:
        return load_experiment("track", [f'controllers=["{law}:Own"]', *settings]).controller("Own")

    assert controller("laws.Own.rate=3").rate == 3.0 and controller("laws.Own.sizes=[1]").sizes == (1,)
    with pytest.raises(ConfigError, match="'fast' is a text: give a number") as caught:
        controller("laws.Own.rate=fast")
    assert caught.value.key == "laws.Own.rate"
    with pytest.raises(UnknownName, match=r"unknown setting 'speed'.*there is: rate, sizes"):
        controller("laws.Own.speed=3")
    with pytest.raises(ConfigError, match="equal for all"):
        controller("laws.Own.feedback=3")


# -- what is refused, in one line and before anything is written --


@pytest.mark.parametrize(
    ("spec", "words"),
    [
        ("{law}:Own2", "it has no controller class 'Own2': there is: Own, Half, Plain, Picky"),
        (
            "{law}:Loose",
            "laws.py:<class Loose>: error: Loose is no TorqueController: derive it from",
        ),
        ("{law}:Half", "laws.py:<class Half>: error: Half lacks estimate, learn: write it"),
        ("{short}:Short", "short.py:2: error: Short.step takes self, s: write def step(self, time, reference, "),
        ("{law}:Plain", "laws.Plain: error: Plain cannot be made: TypeError"),
        ("{law}:Picky", "laws.py:<[self.name]>: error: controller 'Picky' failed: KeyError: 'Picky'"),
        ("{law}", "names no class: write FILE.py:Class"),
        ("{none}:Own", "error: cannot be read: No such file or directory: name a file"),
        ("{broken}:Own", "broken.py:3: error: the file fails when it is read: SyntaxError"),
        ("{lacking}:Own", "lacking.py:2: error: the file fails when it is read: ModuleNotFoundError"),
        ("no.such.module:Own", "no module 'no.such.module'"),
        ("nobody", "unknown controller 'nobody'"),
    ],
)
def test_what_is_wrong_with_a_file_is_one_line(
    spec: str, words: str, law: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "broken.py").write_text("x = 1\n\nclass (:\n")
    (tmp_path / "lacking.py").write_text("import os\nimport no_such_thing\n")
    short = "from mmnn_pin import TorqueController\nclass Short(TorqueController):\n    def step(self, s): ...\n"
    (tmp_path / "short.py").write_text(short)
    places = {name: tmp_path / f"{name}.py" for name in ("none", "broken", "lacking", "short")} | {"law": law}
    for mark in re.findall("<(.+)>", words):
        (line,) = (str(i) for i, text in enumerate(law.read_text().splitlines(), 1) if mark in text)
        words = words.replace(f"<{mark}>", line)
    spec = spec.format(**places)
    code, _, err = told(capsys, "run", "track", "--controller", spec, "--out", tmp_path / "out", *SHORT)
    assert code == 2 and words in err and err.count("\n") == 1, err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (['controllers=["a.py:Own","b.py:Own"]'], "'b.py:Own' is called Own, too: laws.Own is a.py:Own"),
        (['controllers=["a.py:pd"]'], "'pd' is a controller of this package"),
        (['controllers=["a.py:Own","Own"]'], "a controller appears twice"),
        (["laws.Own.rate=3"], "does not say where its class is"),
        (['laws={"../x"={law="a.py:Own"}}'], "'../x' is no name for a file"),
        (['laws.x={law="a.py"}'], "names no class"),
    ],
)
def test_names_are_safe_and_unique(settings: list[str], words: str) -> None:
    with pytest.raises(InputError) as caught:
        load_experiment("track", settings)
    assert words in str(caught.value)


def test_installed_modules_and_what_lies_beside_a_file_are_found(tmp_path: Path, law: Path) -> None:
    shutil.copy(law, tmp_path / "beside.py")
    (tmp_path / "mine.py").write_text("from beside import Own\n\nclass Mine(Own):\n    rate: float = 7.0\n")
    kind = load_class(f"{tmp_path / 'mine.py'}:Mine")
    assert kind().rate == 7.0 and load_class(f"{tmp_path / 'mine.py'}:Mine") is kind


@compiled_only
def test_a_law_runs_in_cases_and_studies(law: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    study = tmp_path / "study.toml"
    study.write_text(
        f'experiment = "track"\ncontrollers = ["pd", "{law}:Own"]\n[set]\n"time.duration" = 0.05\n'
        "[factors.masses]\ngrid = [0.9, 1.1]\n"
    )
    code, found, err = told(capsys, "study", study, "--out", tmp_path / "out", "--workers", "1")
    assert code == 0, err
    assert {"pd", "Own"} <= set(json.dumps(found).replace('"', " ").split())


def test_a_proof_of_a_law_defined_in_this_process_needs_no_file() -> None:
    class Here(LearningLaw):
        def init(self, context):
            from mmnn_pin.torque.controller import ControllerState

            return ControllerState.of(W=(context.layout.dof,))

        def estimate(self, now, state):
            return state["W"]

        def learn(self, now, state):
            state["W"] += 0.1 * now.s

    from proofs import loop_of, robot_of_kind
    from robots import feedback

    run = loop_of("fixed", Here(feedback=feedback(robot_of_kind("fixed"), 0.002)), duration=0.02).run()
    learner = Judgement(run).subject.learner
    assert learner is not None and type(learner.controller) is Here
    np.testing.assert_array_equal(learner.end["W"], run.weights["W"][-1])
    assert isinstance(run, Recording)


@pytest.mark.parametrize("signal", ["s", "nu", "sent", "q", "nu_ref", "command.z", "measurement.pose"])
def test_a_law_cannot_change_what_it_is_told(
    law: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], signal: str
) -> None:
    law.write_text(
        f"{law.read_text()}\n"
        "class Greedy(Own):\n"
        "    def estimate(self, now, state):\n"
        f"        now.{signal}[:] *= 2.0\n"
        "        return state['W'][0]\n"
    )
    words = ["run", "track", "--controller", f"{law}:Greedy", "--out", tmp_path / "runs", *SHORT]
    code, found, _ = told(capsys, *words)
    assert code == 2 and "read-only" in str(found["error"])
