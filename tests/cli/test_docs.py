"""`mmnn docs`: pages and keys are read here; whatever the program points to is there, in a clone and in a wheel."""

from __future__ import annotations

import ast
import json
import re
import tomllib
from importlib import import_module
from pathlib import Path

import msgspec
import pytest
from places import ROOT

import mmnn_pin
from mmnn_pin.cli import main
from mmnn_pin.lab.experiments.experiment import Experiment

docs = import_module("mmnn_pin.cli.docs")  # not the command of that name
POINTER = re.compile(r"mmnn docs ([\w-]+[./][\w./-]*\w)")


def texts(file: Path) -> list[str]:
    """All strings of a program that may be printed: docstrings of commands, and others that are no docstrings."""
    tree, found = ast.parse(file.read_text("utf-8")), []
    said = [node.value for node in ast.walk(tree) if isinstance(node, ast.Expr)]
    for node in ast.walk(tree):
        printed = file.parent.name == "cli" or node not in said
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and printed:
            found.append(" ".join(node.value.split()))
    return found


def test_every_pointer_that_is_printed_leads_somewhere(capsys: pytest.CaptureFixture[str]) -> None:
    every = [text for file in (ROOT / "mmnn_pin").rglob("*.py") for text in texts(file)]
    assert not [text for text in every if re.search(r"docs/\S+\.md", text)], "no file of a clone: name `mmnn docs PAGE`"
    pointers = {found for text in every for found in POINTER.findall(text)}
    assert len(pointers) > 5 and "how-to/studies" in pointers and "latency.margin" in pointers
    for pointer in pointers:
        assert main(["docs", pointer]) == 0, pointer
        assert len(capsys.readouterr().out) > 40, pointer


def test_pages_and_keys(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["docs", "--json"]) == 0
    titles = json.loads(capsys.readouterr().out)
    assert titles["how-to/studies"] and set(titles) == {*docs.pages(), *docs.LISTED}
    assert main(["docs", "docs/how-to/studies.md"]) == 0
    assert capsys.readouterr().out.strip() == (ROOT / "docs/how-to/studies.md").read_text("utf-8").strip()
    assert main(["docs", "latency.margin"]) == 0
    said = "latency.margin: Delay margin that a loop should have beyond these [s]; less is reported. "
    said += "Lower feedback gains have more."
    assert capsys.readouterr().out.strip() == said
    assert main(["docs", "how-to/studie"]) == 2
    assert "did you mean 'how-to/studies'?" in capsys.readouterr().err


def printed(capsys: pytest.CaptureFixture[str], name: str) -> str:
    assert main(["docs", name]) == 0, name
    return capsys.readouterr().out


@pytest.mark.parametrize("key", [f.encode_name for f in msgspec.structs.fields(Experiment)])
def test_every_key_is_printed_and_a_table_lists_its_subkeys_with_defaults(
    key: str, capsys: pytest.CaptureFixture[str]
) -> None:
    text = printed(capsys, key)
    assert text.startswith(f"{key}: ") and len(text) > len(key) + 8
    (field,) = (f for f in msgspec.structs.fields(Experiment) if f.encode_name == key)
    for table in docs.tables_in(field.type):
        tag = table.__struct_config__.tag
        part = text.partition(f'type = "{tag}"')[2].partition("\n\n")[0] if tag else text
        made = table() if not any(f.required for f in msgspec.structs.fields(table)) else None
        for inner in msgspec.structs.fields(table):
            line = re.search(rf"^  {inner.encode_name} +.*(?:\n {{5,}}.*)*", part, re.M)
            assert line, inner.encode_name
            default = re.search(r"\[(?:default: (.*)|required|a table)\]$", " ".join(line[0].split()))
            assert default, line[0]
            if made is not None and isinstance(value := getattr(made, inner.name), int | float):
                assert default[1] == str(value).lower()


def test_what_the_site_writes_from_the_code_is_listed_here(capsys: pytest.CaptureFixture[str]) -> None:
    python = printed(capsys, "reference/python")
    for name in (name for name in mmnn_pin.__all__ if not name.startswith("_")):
        assert re.search(rf"^{name} +\S", python, re.M), name
        assert printed(capsys, name).startswith(name)
    assert "length  Extent along its long axis [m]. [required]" in printed(capsys, "reference.base")
    assert 'type = "minimum_jerk"' in printed(capsys, "reference.arm")
    assert "eight" in printed(capsys, "reference/paths") and "mmnn identify" in printed(capsys, "reference/commands")
    assert "pd_gravity" in printed(capsys, "reference/controllers")
    assert re.search(r"^servo +The servos", printed(capsys, "reference/experiment-keys"), re.M)
    assert main(["docs", "reference/pyton"]) == 2
    assert "did you mean 'reference/python'?" in capsys.readouterr().err


def test_a_wheel_has_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The folders that the wheel takes are those that are read, and the package's own come first."""
    rules = (ROOT / "pyproject.toml").read_text("utf-8")
    for folder in {file.parent.name for file in docs.pages().values()}:
        assert f'"docs/{folder}" = "mmnn_pin/docs/{folder}"' in rules
    (tmp_path / "docs/how-to").mkdir(parents=True)
    (tmp_path / "docs/how-to/here.md").write_text("# Here\n")
    monkeypatch.setattr(docs, "FOLDERS", (tmp_path / "docs", *docs.FOLDERS))
    assert list(docs.pages()) == ["how-to/here"] and docs.title(docs.pages()["how-to/here"]) == "Here"


def test_what_a_build_of_the_site_wrote_does_not_hide_what_is_listed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("how-to/here", "reference/python"):
        (tmp_path / name).parent.mkdir()
        (tmp_path / f"{name}.md").write_text("# Directives of Sphinx\n")
    monkeypatch.setattr(docs, "FOLDERS", (tmp_path,))
    assert list(docs.pages()) == ["how-to/here"]
    assert "Trajectory" in printed(capsys, "reference/python")


def test_a_key_that_is_misspelt_is_told_with_its_neighbours(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["docs", "latency.margn"]) == 2
    assert "unknown key 'latency.margn': did you mean 'latency.margin'? there is: latency." in capsys.readouterr().err
    assert main(["docs", "nothing.such"]) == 2 and "how-to/robots" in capsys.readouterr().err


LINK = re.compile(r"\]\(([^)#\s]+)(?:#[^)]*)?\)")


def test_pages_that_pages_link_to_are_in_a_clone() -> None:
    written = {f"{name}.md" for name in docs.LISTED} | {"reference/python-more.md"}  # by a build of the site, not here
    dead = [
        f"{page.relative_to(ROOT)}: {target}"
        for page in [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("examples/**/*.md")]
        if "/".join(page.parts[-2:]) not in written
        for target in LINK.findall(page.read_text("utf-8"))
        if "://" not in target and not target.startswith("mailto:")
        if not (place := (page.parent / target).resolve()).exists() or "/".join(place.parts[-2:]) in written
    ]
    assert dead == []


@pytest.mark.parametrize("name", ["Timed", "Overrides", "Stepper.step", "Robot.view", "reference.timed.Smoothed"])
def test_any_public_name_is_printed_with_its_docstring(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    out = printed(capsys, name)
    assert out.startswith(f"{name}(") and "\nof mmnn_pin." in out and len(out.splitlines()) > 3


def test_what_stands_beside_fields_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    assert "    basis: Array  # (k0, k) `theta = theta_0 + basis w`" in printed(capsys, "torque.concurrent.History")
    above = printed(capsys, "Wheel").partition("    # angle from the rolling direction")[2]
    assert above.splitlines()[2] == "    roller: float | None = None"


LAB = ROOT / "mmnn_pin/lab/experiments"
FILES = {
    "experiment": [*LAB.glob("*.toml"), ROOT / "examples/udp/task.toml", ROOT / "examples/backing.toml"],
    "study": [ROOT / "examples/robustness.toml", ROOT / "examples/tuning.toml"],
    "hardware": [*(LAB / "profiles").glob("*.toml")],
}
WRONG = {  # a key, a type, a name
    "experiment": [
        *("sede = 1", "time.duraton = 3.0", "reference.base.sped = 1.0", "cases.a.sett = {}", "overrides.weels = 1"),
        *("feedback.arm = 'fast'", "seed = 1.5", "reference.base = {type = 'line', speed = 'x'}", "masses = 'a'"),
        *("reference.base.type = 'lin'", "reference.arm = [{type = 'sin'}]", "reference.hand.path = [{type = 'arc'}]"),
        *(
            "plots = ['erors']",
            "plant = 'contac'",
            "time.integrator = 'rk5'",
            "interfaces.a = 'velo'",
            "overrides.base = 'tank'",
        ),
        *("hardware.arm.interface = 'velocty'", "hardware.arm.bandwith = 1.0", "held_out.a.heading.type = 'sin'"),
    ],
    "study": [
        *("sede = 1", "factors.a.unif = [1, 2]", "tune.gain = {}"),
        *("factors.a = [1, 2]", "factors.a.uniform = ['a', 2]", "success.at_most.a = 'b'"),
        *("model = 'nom'", "sampling.method = 'sob'", "tune.sampler = 'x'"),
    ],
    "hardware": [
        *("arms.rate = 1.0", "arm.bandwith = 1.0", "joints.a.rat = 1.0", "base.odometri = 'true'"),
        *("rate = 'fast'", "joints.a = 1.0", "arm.interface = 'velocty'", "base.odometry = 'gps'"),
    ],
}
RIGHT = (
    "hardware = 'tiago'",
    "reference.base.speed = 0.2",
    "reference.arm = {type = 'swing', amplitude = 1, period = 4}",
)


@pytest.mark.parametrize("kind", docs.kinds())
def test_schemas_take_the_files_that_are_there_and_refuse_others(kind: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Judged by jsonschema, which shares no code with what reads the files."""
    jsonschema = pytest.importorskip("jsonschema")
    assert main(["docs", "--schema", kind]) == 0
    schema = json.loads(capsys.readouterr().out)
    jsonschema.Draft202012Validator.check_schema(schema)
    judge = jsonschema.Draft202012Validator(schema)
    right = [file.read_text("utf-8") for file in FILES.get(kind, [])] + [*(RIGHT if kind == "experiment" else ())]
    for text in right:
        assert [error.message for error in judge.iter_errors(tomllib.loads(text))] == [], text
    for text in WRONG.get(kind, []):
        assert not judge.is_valid(tomllib.loads(text)), text
    if kind == "experiment":
        told = schema["$defs"]["Experiment"]["properties"]
        assert told["seed"]["description"] and told["experiment"]["description"] and told["hardware"]["description"]
