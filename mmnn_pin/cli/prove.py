"""`mmnn prove`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from ..errors import InputError, RecordingError
from .options import examples, law, numbers, shared
from .output import DONE, FAILED, compile_if_cold, progress_bar, recordings_in, say, say_json

if TYPE_CHECKING:
    from ..recording.recording import Recording


@click.command(
    short_help="Tell whether a run learned Psi, and whether its Lyapunov function falls.",
    epilog=examples(
        "mmnn prove runs/chapter4/two_layer.h5",
        "mmnn prove runs/track/two_layer.h5 --payload 3 --plots proof",
        "mmnn prove runs/certified/two_layer.h5 --disturbance v=5",
        "mmnn prove runs/chapter4/pd.h5 --every-period --json",
        "mmnn prove runs/track/MyLaw.h5 --law my_law.py     a law of your own",
    ),
)
@click.argument("run", metavar="RUN", type=click.Path(path_type=Path))
@click.option(
    "--payload",
    type=click.FloatRange(0, 1e6, min_open=True),
    metavar="KG",
    help="Load of the changed robot.  [default: a quarter of what the arm weighs]",
)
@click.option(
    "--windows", type=click.IntRange(1, 1000), default=5, show_default=True, help="Windows of the online FVU."
)
@click.option(
    "--every-period", is_flag=True, help="Check the equality over every control period, however long it takes."
)
@click.option(
    "--region",
    metavar="SIZE=VALUE",
    multiple=True,
    help="Certify errors within these sizes, not the largest region that is found; give all of them: pose=M, the "
    "base's pose error; arm=SIZE, the arm's errors; energy=J, s'Ms/2 (docs/theory.md); repeatable.",
)
@click.option(
    "--disturbance",
    metavar="VELOCITY=FORCE",
    multiple=True,
    help="Certify against an external force up to this, as v=5; repeatable.",
)
@click.option("--plots", type=click.Path(path_type=Path), metavar="DIR", help="Write the figures to this folder.")
@click.option("--force", is_flag=True, help="Replace existing figures.")
@law
@shared
def prove(
    run: Path,
    payload: float | None,
    windows: int,
    every_period: bool,
    region: tuple[str, ...],
    disturbance: tuple[str, ...],
    plots: Path | None,
    force: bool,
    as_json: bool,
) -> int:
    """Judge one recording: Psi_hat against the truth, the Lyapunov function, the equality behind it.

    Psi: fraction of variance unexplained (FVU) online and with the final weights held fixed, on the run's own
    trajectory, on one held out, and with a payload; shares of the torque; ranks and excitation of the networks; ideal
    weights by an offline fit. Lyapunov function: V, its derivative term by term, when and why it grows. Equality: the
    energy of the errors over every control period. Certificate: a region that the loop provably never leaves, the bound
    that it ends up in, conditions and constants, a condition on the learning rates (docs/theory.md). Exit code 1 when
    the equality or the certificate is violated.
    """
    from ..lab.proof.balance import BUDGET
    from ..lab.proof.certified_run import certified_run
    from ..lab.proof.proof import Proof, sentence
    from ..lab.show.proof.figures import write_proof
    from ..lab.show.proof.text import render, render_certificate

    wanted, forces = numbers(region, "--region"), numbers(disturbance, "--disturbance")
    recording = opened(run)
    compile_if_cold()
    with progress_bar() as show:
        budget = float("inf") if every_period else BUDGET
        proof = Proof(recording, payload=payload, windows=windows, budget=budget, progress=show)
        missing = proof.missing
    if len(missing) == 4:
        raise InputError("nothing to judge", why="; ".join(map(sentence, missing.values())), file=run)
    certified = certified_run(proof, wanted, forces)
    files = {} if plots is None else write_proof(proof, plots, force)
    if as_json:
        result = proof.to_dict() | {"certificate": certified.to_dict()}
        say_json(result | ({} if plots is None else {"files": {k: str(v) for k, v in files.items()}}))
    else:
        say(render(proof, colour=sys.stdout.isatty()))
        say(render_certificate(certified, colour=sys.stdout.isatty()))
        say("\n".join(f"wrote {file}" for file in files.values())) if files else None
    return DONE if proof.holds and certified.holds else FAILED


def opened(run: Path) -> Recording:
    """The recording to be judged.

    Raises:
        RecordingError: A folder, no recording, or one without rows.
    """
    from ..recording.recording import Recording

    if run.is_dir():
        raise RecordingError("a folder", why="one run is judged at a time", fix=recordings_in(run), file=run)
    recording = Recording.open(run)
    if not len(recording):
        raise RecordingError("holds no rows", why="the run ended before its first sample", file=run)
    return recording
