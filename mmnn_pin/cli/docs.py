"""`mmnn docs`: the pages of the documentation and what a key of an experiment means, where no site is at hand."""

from __future__ import annotations

import inspect
import re
from pathlib import Path

import click
from click.shell_completion import CompletionItem

from ..errors import UnknownName
from .options import PACKAGE, examples, shared, starting
from .output import DONE, answer

FOLDERS = (PACKAGE / "docs", PACKAGE.parent / "docs")  # of a wheel, of a clone
ARGUMENT = re.compile(r"^    (?P<name>\w+): (?P<text>.*(?:\n {8}.*)*)", re.M)


def pages() -> dict[str, Path]:
    """Pages by name, such as `how-to/studies`."""
    folder = next((folder for folder in FOLDERS if (folder / "how-to").is_dir()), FOLDERS[0])
    return {file.relative_to(folder).with_suffix("").as_posix(): file for file in sorted(folder.glob("*/*.md"))}


def title(page: Path) -> str:
    """The heading of a page."""
    return page.read_text("utf-8").partition("\n")[0].lstrip("# ")


def meaning(key: str) -> str:
    """What a key of an experiment means, as its class says it, and the keys in it; empty for one that there is not."""
    from ..lab.experiments.config import keys_of, kind_at

    above, _, name = key.rpartition(".")
    kind = kind_at(above or None)
    if name not in keys_of(kind):
        return ""
    inner = kind_at(key)
    lines = [f"{key}: {said(kind, name)}", *(f"{key}.{one}: {said(inner, one)}" for one in keys_of(inner))]
    return "\n".join(lines)


def said(kind: type, name: str) -> str:
    """What the docstring of a class of settings says of one of them."""
    found = {found["name"]: found["text"] for found in ARGUMENT.finditer(inspect.getdoc(kind) or "")}
    return " ".join(found.get(name, "a table").split())


def names(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Pages that a shell completes."""
    return starting(pages(), incomplete)


@click.command(
    short_help="Read the documentation: its pages, or what a key of an experiment means.",
    epilog=examples("mmnn docs", "mmnn docs how-to/studies | less", "mmnn docs latency", "mmnn docs latency.margin"),
)
@click.argument("page", required=False, shell_complete=names)
@shared
def docs(page: str | None, as_json: bool) -> int:
    """Print a page of the documentation, or what a key of an experiment means with the keys in it; else all pages."""
    there = pages()
    if page is None:
        found = {name: title(file) for name, file in there.items()}
        answer(as_json, lambda: found, lambda: "\n".join(f"{name:30}{heading}" for name, heading in found.items()))
        return DONE
    name = page.removeprefix("docs/").removesuffix(".md")
    text = there[name].read_text("utf-8") if name in there else meaning(page)
    if not text:
        raise UnknownName("page or key", page, there)
    answer(as_json, lambda: {"page": page, "text": text}, lambda: text.rstrip())
    return DONE
