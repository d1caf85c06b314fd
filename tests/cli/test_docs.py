"""`mmnn docs`: pages and keys are read here; whatever the program points to is there, in a clone and in a wheel."""

from __future__ import annotations

import ast
import json
import re
from importlib import import_module
from pathlib import Path

import pytest
from places import ROOT

from mmnn_pin.cli import main
from mmnn_pin.lab.experiments.config import keys_of
from mmnn_pin.loop.latency import Latency

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
    assert titles["how-to/studies"] and set(titles) == set(docs.pages())
    assert main(["docs", "docs/how-to/studies.md"]) == 0
    assert capsys.readouterr().out.strip() == (ROOT / "docs/how-to/studies.md").read_text("utf-8").strip()
    assert main(["docs", "latency.margin"]) == 0
    said = "latency.margin: Delay beyond these that a loop should bear; less is reported. "
    said += "Lower feedback gains bear more [s]."
    assert capsys.readouterr().out.strip() == said
    assert main(["docs", "latency"]) == 0
    table, *inner = capsys.readouterr().out.splitlines()
    assert table.startswith("latency: How long measurements") and said.strip() in inner
    assert [line.partition(":")[0] for line in inner] == [f"latency.{name}" for name in keys_of(Latency)]
    assert main(["docs", "how-to/studie"]) == 2
    assert "did you mean 'how-to/studies'?" in capsys.readouterr().err


def test_a_wheel_has_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The folders that the wheel takes are those that are read, and the package's own come first."""
    rules = (ROOT / "pyproject.toml").read_text("utf-8")
    for folder in {file.parent.name for file in docs.pages().values()}:
        assert f'"docs/{folder}" = "mmnn_pin/docs/{folder}"' in rules
    (tmp_path / "docs/how-to").mkdir(parents=True)
    (tmp_path / "docs/how-to/here.md").write_text("# Here\n")
    monkeypatch.setattr(docs, "FOLDERS", (tmp_path / "docs", *docs.FOLDERS))
    assert list(docs.pages()) == ["how-to/here"] and docs.title(docs.pages()["how-to/here"]) == "Here"
