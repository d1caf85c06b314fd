"""Run the tutorials: every command and program of a page, in a folder of its own, against what the page says comes out.

    python docs/execute.py [PAGE ...] [--write]

A page is Markdown. In its order: a block with a caption is written to the file of that name; a block `sh` is run by
bash, a block `python` goes on in the page's one Python program. A block `text` after it is what is printed: numbers
may differ by 5 %, a line `...` stands for any lines. --write fills in text blocks that are empty or only `...`.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).resolve().parent
BLOCK = re.compile(r"^```(?:\{code-block\} )?(\w+)\n((?::\w+:[^\n]*\n)*)\n?(.*?)^```$", re.M | re.S)
NUMBER = re.compile(r"[-+]?\d+(?:\.\d*)?(?:e[-+]?\d+)?")
CLOSE = 0.05  # relative; of the last digit that is printed, one


class Differs(Exception):
    """What a block printed is not what the page says."""


@dataclass
class Block:
    """A block of code: its language, the file it is written to or nothing, its text, where that begins in the page."""

    language: str
    file: str
    text: str
    start: int


def blocks(page: str) -> Iterator[Block]:
    """The blocks of a page."""
    for match in BLOCK.finditer(page):
        caption = re.search(r":caption: *(\S+)", match[2])
        yield Block(match[1], caption[1] if caption else "", match[3], match.start(3))


def run(block: Block, names: dict[str, object]) -> str:
    """What a block prints.

    Raises:
        Differs: It fails.
    """
    if block.language == "python":
        with contextlib.redirect_stdout(io.StringIO()) as printed:
            exec(compile(block.text, "<tutorial>", "exec"), names)
        return printed.getvalue()
    sys.stdout.flush()
    done = subprocess.run(["bash", "-euo", "pipefail", "-c", block.text], capture_output=True, text=True)
    if done.returncode:
        raise Differs(f"{block.text}\nexit code {done.returncode}\n{done.stdout}{done.stderr}")
    return done.stdout


def same_word(printed: str, told: str) -> bool:
    """Whether two words agree, numbers in them nearly."""
    if NUMBER.sub("#", printed) != NUMBER.sub("#", told):
        return False
    for one, other in zip(NUMBER.findall(printed), NUMBER.findall(told), strict=True):
        digits = len(other.partition("e")[0].partition(".")[2])
        if abs(float(one) - float(other)) > CLOSE * abs(float(other)) + 1.01 * 10.0**-digits:
            return False
    return True


def same_line(printed: str, told: str) -> bool:
    """Whether two lines agree, whatever their spaces and rules."""
    one, other = (re.sub(r"[-─]{4,}", "", line).split() for line in (printed, told))
    return len(one) == len(other) and all(map(same_word, one, other))


def agrees(printed: list[str], told: list[str]) -> bool:
    """Whether lines are what is told, where a line `...` stands for any."""
    if not told:
        return not printed
    if told[0].strip() == "...":
        return any(agrees(printed[i:], told[1:]) for i in range(len(printed) + 1))
    return bool(printed) and same_line(printed[0], told[0]) and agrees(printed[1:], told[1:])


def lines(text: str) -> list[str]:
    """The lines that say something."""
    return [line.rstrip() for line in text.splitlines() if line.strip()]


def execute(page: Path, write: bool) -> None:
    """Run a page in the present folder.

    Raises:
        Differs: A block fails, or prints something else.
    """
    text = page.read_text(encoding="utf-8")
    names: dict[str, object] = {"__name__": "__main__"}
    printed, filled = "", []
    for block in blocks(text):
        if block.file:
            Path(block.file).write_text(block.text, encoding="utf-8")
        elif block.language in ("sh", "python"):
            printed = run(block, names)
        elif block.language == "text" and write and block.text.strip() in ("", "..."):
            filled.append((block, printed))
        elif block.language == "text" and not agrees(lines(printed), lines(block.text)):
            raise Differs(f"the page says\n\n{block.text}\nand what is printed is\n\n{printed}")
    for block, output in reversed(filled):
        text = text[: block.start] + "\n".join(lines(output)) + "\n" + text[block.start + len(block.text) :]
    if filled:
        page.write_text(text, encoding="utf-8")


def in_a_folder(page: Path, write: bool) -> bool:
    """Run a page in a folder of its own and in a process of its own; whether it went well."""
    begin = time.perf_counter()
    command = [sys.executable, str(Path(__file__).resolve()), "--here", str(page.resolve()), *["--write"] * write]
    with tempfile.TemporaryDirectory() as folder:
        here = {"PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
        here["PYTHONPATH"] = os.pathsep.join((folder, str(HERE.parent), os.environ.get("PYTHONPATH", "")))
        done = subprocess.run(command, cwd=folder, env=os.environ | here | {"MPLBACKEND": "agg", "COLUMNS": "100"})
    print(
        f"{'ok    ' if done.returncode == 0 else 'FAILED'} {time.perf_counter() - begin:6.1f} s  {page.name}",
        flush=True,
    )
    return done.returncode == 0


def main() -> int:
    """Run pages; 1 where one does not do what it says."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pages", nargs="*", type=Path)
    parser.add_argument("--write", action="store_true", help="fill in empty text blocks")
    parser.add_argument("--here", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args()
    pages = given.pages or sorted(page for page in (HERE / "tutorials").glob("*.md") if page.name != "index.md")
    if not given.here:
        results = [in_a_folder(page, given.write) for page in pages]
        return 0 if all(results) else 1
    try:
        execute(pages[0], given.write)
    except Differs as error:
        print(f"{pages[0].name}: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
