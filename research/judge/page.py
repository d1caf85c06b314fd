"""The judge's page, docs/explanation/judge.md: its tables between markers, and the rows beside it as CSV."""

from __future__ import annotations

import hashlib
import re
import subprocess
from collections.abc import Sequence
from itertools import chain
from pathlib import Path

from mmnn_pin.lab.show.table import number
from research.studies.document import DOCS, write_rows

from .draws import FILE, preregistered
from .score import Row, Score, paired, parts_of_table, ratio_of, score_of

PAGE = DOCS / "explanation" / "judge.md"
SHOWN = 7  # controllers in the tables of parts
DEFAULT = "learned"  # what is asked to be better
ERRORS = "arm [rad]", "base [m]"


def publish(rows: Sequence[Row], page: Path = PAGE) -> None:
    """Fill the tables of a page, and write the rows beside it.

    Args:
        rows: Of all controllers on both plants.
        page: With markers `<!-- judge: NAME -->` and `<!-- /judge -->` about every table.
    """
    first, second = ([row for row in rows if row["plant"] == plant] for plant in ("judge", "contact"))
    parts = {"facts": facts(rows), "all": overall(first), "contact": overall(second), "target": target(first)}
    parts |= {name: by_part(parts_of_table(first)[name]) for name in ("robots", "disturbances")}
    text = page.read_text(encoding="utf-8")
    for name, content in parts.items():
        marked = re.compile(rf"(<!-- judge: {name} -->\n).*?(<!-- /judge -->)", re.DOTALL)
        text = marked.sub(lambda found, own=content: f"{found[1]}{own}\n{found[2]}", text)  # type: ignore[misc]
    page.write_text(text, encoding="utf-8")
    pairs = chain.from_iterable(paired(rows, name) for name in controllers_of(rows))
    write_rows(page.with_suffix(".csv"), [flat(*pair) for pair in pairs])


def facts(rows: Sequence[Row]) -> str:
    """Which file was written when, and how much was run."""
    log = ["git", "log", "-1", "--format=%H of %cs", "--", FILE.name]
    commit = subprocess.run(log, cwd=FILE.parent, capture_output=True, text=True, check=False).stdout.strip()
    digest = hashlib.sha256(FILE.read_bytes()).hexdigest()[:16]
    draws = len({(row["robot"], row["draw"], row["plant"]) for row in rows})
    hours = sum(row["seconds"] for row in rows) / 3600
    return (
        f"`preregistered.toml` (sha256 {digest}...) was last committed as {commit}. {len(rows)} runs of "
        f"{len({row['controller'] for row in rows})} controllers on {draws} draws of "
        f"{len({row['robot'] for row in rows})} robots, {hours:.1f} hours of processor time; "
        "[judge.csv](judge.csv) has every one."
    )


def controllers_of(rows: Sequence[Row]) -> list[str]:
    """The controllers that have rows, in the file's order."""
    have = {row["controller"] for row in rows}
    return [name for name in preregistered()["controllers"]["judged"] if name in have]


def overall(rows: Sequence[Row]) -> str:
    """Scores of all controllers, the smallest median first."""
    scores = {name: score_of(paired(rows, name)) for name in controllers_of(rows)}
    names = "controller", "better [%]", "median", "90 %", "worst", "lost", "lost alone", "arm", "base", "draws"
    head = f"| {' | '.join(names)} |\n|{' --- |' * len(names)}"
    lines = [f"| `{name}` | {line_of(scores[name])} |" for name in sorted(scores, key=lambda name: scores[name].median)]
    return "\n".join([head, *lines])


def line_of(s: Score) -> str:
    """Cells of a score."""
    ratios = (number(value, "lost") for value in (s.median, s.high, s.worst))
    parts = (number(value, "lost") for value in (s.arm, s.base))
    return " | ".join([f"{100 * s.better:.0f}", *ratios, str(s.lost), str(s.alone), *parts, str(s.draws)])


def by_part(parts: dict[str, list[Row]]) -> str:
    """Median ratio, share of better draws and losses on every part, of the few controllers with the least median."""
    rows, baseline = list(chain.from_iterable(parts.values())), preregistered()["controllers"]["baseline"]
    ordered = sorted(controllers_of(rows), key=lambda name: score_of(paired(rows, name)).median)
    names = [name for name in ordered if name != baseline][:SHOWN]
    lines = [f"| | draws | {' | '.join(f'`{name}`' for name in names)} |", f"| --- |{' --- |' * (len(names) + 1)}"]
    for title, own in parts.items():
        scores = [score_of(paired(own, name)) for name in names]
        draws = len({(row["robot"], row["draw"], row["plant"]) for row in own})
        lines.append(f"| {title} | {draws} | {' | '.join(map(short, scores))} |")
    return "\n".join(lines)


def short(s: Score) -> str:
    """Median ratio, in brackets the share of better draws, then what was lost alone."""
    lost = f", {s.alone} lost" if s.alone else ""
    return f"{number(s.median, 'lost')} ({100 * s.better:.0f} %{lost})"


def target(rows: Sequence[Row]) -> str:
    """What was asked of the default, and what it does."""
    asked, s = preregistered()["scoring"], score_of(paired(rows, DEFAULT))
    lines = [
        ("better than the baseline", f"{100 * asked['better']:.0f} % of draws or more", f"{100 * s.better:.0f} %"),
        ("median ratio", f"{asked['median']:g} or less", number(s.median, "lost")),
        ("worst ratio", f"{asked['worst']:g} or less", number(s.worst, "lost")),
        ("lost where the baseline is not", "0", str(s.alone)),
    ]
    return "\n".join(
        [f"| `{DEFAULT}` | asked | is |\n| --- | --- | --- |", *(f"| {' | '.join(one)} |" for one in lines)]
    )


def flat(row: Row, baseline: Row) -> Row:
    """A row of the CSV file, with its ratio to the baseline's of the same draw."""
    errors = dict(zip(ERRORS, (row["arm"], row["base"]), strict=True))
    own = {name: row[name] for name in ("robot", "draw", "plant", "controller")}
    return own | errors | {"ratio": ratio_of(row, baseline), "lost": row["lost"]} | row["said"]
