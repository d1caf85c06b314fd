"""`mmnn prove`, or `python -m research.prove`: what one run proves, and what is certified of its loop."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from mmnn_pin.cli.options import FORCE, examples, judged_on, law, numbers, shared
from mmnn_pin.cli.output import DONE, FAILED, answer, look, named, progress_bar, styled, wrote
from mmnn_pin.cli.results import ONE_RUN, to_judge


@click.command(
    short_help="Tell whether a run learned Psi, and whether its Lyapunov function falls.",
    epilog=examples(
        "mmnn prove runs/chapter4/two_layer.h5",
        "mmnn prove runs/track/two_layer.h5 --payload 3 --plots proof",
        "mmnn prove runs/certified/two_layer.h5 --disturbance v=5",
        "mmnn prove runs/track/concurrent.h5 --tube         what its errors cannot exceed",
        "mmnn prove runs/track/MyLaw.h5 --law my_law.py     a law of your own",
    ),
)
@ONE_RUN
@judged_on
@click.option(
    "--every-period", is_flag=True, help="Check the equality over every control period, however long it takes."
)
@click.option(
    "--region",
    metavar="SIZE=VALUE",
    multiple=True,
    help="Certify errors within these sizes, not the largest region that is found; all of pose=M, arm=SIZE, energy=J.",
)
@click.option("--tube", is_flag=True, help="Bound the errors of all motions along this reference, too (seconds).")
@click.option(
    "--disturbance",
    metavar="VELOCITY=FORCE",
    multiple=True,
    help="Certify against an external force up to this, as v=5; repeatable.",
)
@click.option("--plots", type=click.Path(path_type=Path), metavar="DIR", help="Write the figures to this folder.")
@FORCE
@law
@shared
def prove(
    run: Path,
    payload: float | None,
    windows: int,
    every_period: bool,
    region: tuple[str, ...],
    disturbance: tuple[str, ...],
    tube: bool,
    plots: Path | None,
    force: bool,
    as_json: bool,
) -> int:
    """Judge one recording: whether it learned Psi, whether its Lyapunov function falls, and what is guaranteed.

    Psi: the fraction of its variance that the estimate leaves unexplained (FVU), online and with final weights held,
    on the run's own trajectory, on another one and with a payload. Lyapunov function: V, its derivative term by term,
    when and why it grows. Equality: whether the energy of the errors changes as the model says (mmnn docs
    explanation/proof). Certificate: a region that the loop provably never leaves, the bound it ends up in, how fast
    it may learn (mmnn docs explanation/theory). Exit code 1 when a run violates one of them.
    """
    from mmnn_pin.lab.show.psi_figures import write_judged
    from research.proof.balance import BUDGET
    from research.proof.certified_run import prove as judge
    from research.proof.text import render, render_certificate

    wanted, forces = numbers(region, "--region"), numbers(disturbance, "--disturbance")
    recording = to_judge(run)
    with progress_bar() as show:
        found = judge(
            recording, payload=payload, windows=windows, budget=float("inf") if every_period else BUDGET,
            region=wanted, disturbance=forces, tube=tube, progress=show,
        )  # fmt: skip

    def both() -> str:
        return f"{render(found.proof, **look())}\n{render_certificate(found.certificate, **look())}"

    files = {} if plots is None else write_judged(found.proof, plots, force)
    written = {} if plots is None else {"files": named(files)}
    answer(
        as_json,
        lambda: found.to_dict() | written,
        lambda: "\n".join((styled(both()), wrote(files.values()))).rstrip(),
    )
    return DONE if found.holds else FAILED


if __name__ == "__main__":
    from research import alone

    sys.exit(alone(prove))
