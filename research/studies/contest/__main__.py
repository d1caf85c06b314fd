"""Everything that docs/explanation/contest.md says, from nothing: `python -m research.studies.contest` in a checkout.

Runs the contest, writes tables, figures and the document; with `--tune` it searches the learners' settings and stops.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from mmnn_pin.errors import StudyError
from mmnn_pin.lab.experiments.cases import chosen_cases
from research.contest.contest import run_contest
from research.contest.settings import load_contest
from research.contest.show import write_figures
from research.contest.standing import Standing
from research.studies.document import Clock

from .document import DOCUMENT, DRAWN, summed
from .search import SOON, TRIES, TUNED, TUNINGS, Bench, Say, Tries, budget, keep, lines, search, spaces, tuned
from .second_look import benches, taken

QUICK = (
    *("time.duration=1.6", "windows=[[0, 0.5], [0.8, 1.6]]", "time.control_period=0.0025", "time.plant_step=0.00125"),
    *(f"held_out.{name}.duration=0.9" for name in ("similar", "tight", "circle")),
    "contest.seeds=2",
)


def main(arguments: Sequence[str] | None = None) -> None:
    """Parse the command line, run, write."""
    parser = argparse.ArgumentParser(prog="python -m research.studies.contest", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("runs/contest"), help="folder for all that is written")
    parser.add_argument("--quick", action="store_true", help="two tasks for a second: shows that it runs")
    parser.add_argument("--force", action="store_true", help="run anew what is in the folder")
    parser.add_argument(
        "--publish", action="store_true", help="renew docs/explanation/contest.md, its figures and the summary"
    )
    parser.add_argument("--tune", action="store_true", help="search the learners' settings, and stop")
    parser.add_argument("--only", choices=TUNINGS, action="append", help="one of the searches; may be repeated")
    parser.add_argument("--learner", action="append", metavar="NAME", help="of this learner; may be repeated")
    parser.add_argument("--tries", type=int, metavar="N", help=f"sets of settings per learner ({each(TRIES)})")
    parser.add_argument("--again", action="store_true", help="only the second look, at the tries that are kept")
    options = parser.parse_args(arguments)
    known = {name for tuning in TUNINGS for name in spaces(tuning)}
    if unknown := sorted(set(options.learner or ()) - known):
        parser.error(f"nothing is searched for {', '.join(unknown)}; there is: {', '.join(sorted(known))}")
    if not options.tune and (options.only or options.learner or options.again):
        parser.error("--only, --learner and --again go with --tune")
    clock = Clock()
    if options.tune:
        for tuning in options.only or TUNINGS:
            learners = [name for name in spaces(tuning) if not options.learner or name in options.learner]
            try:
                tune(tuning, learners, options.tries or TRIES[tuning], options.out, clock.say, options.again)
            except StudyError as error:
                parser.exit(2, f"{error}\n")
        return
    overrides, cases = (QUICK, ["eight", "rich"]) if options.quick else ((), [])
    summary = study(options.out, overrides, cases, options.force, clock)
    DOCUMENT.save(summary, options.out, options.publish)


def each(numbers: dict[str, int]) -> str:
    """Names and numbers as a text."""
    return ", ".join(f"{name} {number}" for name, number in numbers.items())


def tune(tuning: str, learners: Sequence[str], tries: int, out: Path, say: Say, again: bool = False) -> None:
    """Search for some learners; each is kept as it is done, and what was tried in a folder: run it again to go on.

    Args:
        tuning: Which search.
        learners: Whose settings.
        tries: How many sets for each.
        out: For the folder.
        say: Told what happens.
        again: Take the scores that are kept; the best is run once more.

    Raises:
        StudyError: A score that is kept is not that of today's code and spaces.
    """
    bench = Bench.made(tuning)
    say(f"{tuning}: {budget(bench, len(learners), tries)}")
    others = benches(bench)
    (out / "tuning").mkdir(parents=True, exist_ok=True)
    for learner in learners:
        journal = None if again else out / "tuning" / f"{tuning}-{learner}.json"
        scores = tuned()[tuning].get(learner, {}).get("scores", []) if again else []
        found = search(bench, learner, spaces(tuning)[learner], tries, say, journal, scores)
        if again:
            require_today(bench, tuning, learner, found)
        keep(tuning, learner, taken(others, learner, found, say))
    for line in lines(tuning):
        say(f"{tuning}: {line}")


def require_today(bench: Bench, tuning: str, learner: str, found: Tries) -> None:
    """Refuse scores that are kept of other code or spaces, by running the best once more.

    Raises:
        StudyError: It has another score.
    """
    settings, score = min(found, key=lambda one: one[1])
    now = bench.score(learner, settings)
    if now != score:
        raise StudyError(
            f"{tuning}: {learner}: the best score that is kept is {score:.6g}, today's {now:.6g}",
            why="code or spaces changed since",
            fix=f"search anew, without --again: --tune --only {tuning} --learner {learner}",
            file=TUNED,
        )


def study(out: Path, overrides: Sequence[str], cases: Sequence[str], force: bool, clock: Clock) -> dict[str, Any]:
    """Run all of it; rows and figures go to `out`, the numbers of the document are returned."""
    standing = made(out, overrides, cases, force, clock.say)
    drawn = {name: title for name, title in standing.tasks.items() if name in DRAWN}
    write_figures(replace(standing, tasks=drawn), out / "figures")
    return {
        **summed(standing),
        "tuned": {tuning: {name: short(one) for name, one in tuned()[tuning].items()} for tuning in TUNINGS},
        "soon": SOON,
        "tries": TRIES,
        "run": clock.facts(),
    }


def short(found: dict[str, Any]) -> dict[str, Any]:
    """A search with the best score in place of those of all its tries and of the second look."""
    return {key: value for key, value in found.items() if key not in ("scores", "looked")} | {
        "best": min(found["scores"])
    }


def made(out: Path, overrides: Sequence[str], cases: Sequence[str], force: bool, say: Say) -> Standing:
    """One contest.

    Raises:
        KeyboardInterrupt: It was stopped; what is done is kept.
    """
    experiment = chosen_cases(load_contest("contest", overrides), cases)
    before = [""]

    def show(label: str, fraction: float) -> None:
        if label != before[0]:
            before[0] = label
            say(f"{100 * fraction:3.0f} %  {label}")

    standing = run_contest(experiment, "contest", out=out, force=force, progress=show)
    if standing.interrupted:
        raise KeyboardInterrupt
    return standing


if __name__ == "__main__":
    main()
