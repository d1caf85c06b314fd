"""`mmnn export`."""

from __future__ import annotations

from pathlib import Path

import click

from ..errors import ConfigError
from .folders import open_runs, study_of
from .options import examples, shared
from .output import DONE, say, say_json

TO = ("csv", "npz", "parquet", "mcap")


@click.command(
    short_help="Write recordings in the formats of other programs.",
    epilog=examples(
        "mmnn export runs/chapter4/two_layer.h5 --to csv",
        "mmnn export runs/chapter4/two_layer.h5 --to mcap --out two_layer.mcap     for Foxglove, PlotJuggler",
        "mmnn export runs/chapter4 --to parquet --out tables                       every recording of a folder",
        "mmnn export runs/robustness --to csv                                      the rows of a study",
    ),
)
@click.argument("runs", nargs=-1, required=True, metavar="RUN...", type=click.Path(path_type=Path))
@click.option("--to", type=click.Choice(TO), required=True, help="The format.")
@click.option("--out", type=click.Path(path_type=Path), help="A file, or a folder.  [default: beside the recording]")
@click.option("--force", is_flag=True, help="Replace existing files.")
@shared
def export(runs: tuple[Path, ...], to: str, out: Path | None, force: bool, as_json: bool) -> int:
    """Write recordings as tables (csv, npz, parquet) or as MCAP. RUN is a recording, or a folder with recordings.

    RUN may also be one study, its folder or its database: its rows are written as csv or parquet.
    MCAP holds joint states, transforms, odometry and all signals as messages of ROS 2. Parquet and MCAP need
    `pip install 'mmnn_pin[export]'`.
    """
    from ..lab.show.export import export as write
    from ..lab.show.whole import require_free

    if (study := study_of(runs)) is not None:
        return export_study(study, to, out, force, as_json)
    recordings = {run: recording for path in runs for recording in open_runs(path) if (run := recording.path)}
    files = targets(list(recordings), out, to)
    for file in files:
        require_free(file, force)
    written = [write(rec, file, to, force=True) for rec, file in zip(recordings.values(), files, strict=True)]
    if as_json:
        told = zip(recordings, written, strict=True)
        say_json({"to": to, "files": {str(run): str(file) for run, file in told}})
    else:
        say("\n".join(f"wrote {file}" for file in written))
    return DONE


def export_study(path: Path, to: str, out: Path | None, force: bool, as_json: bool) -> int:
    """Write the rows of a study."""
    from ..lab.show.study.rows import export as write
    from ..lab.study.results import load_results

    results = load_results(path)
    is_file = out is not None and out.suffix and not out.is_dir()
    file = out if is_file and out is not None else (out or path.parent) / f"{results.name}.{to}"
    write(results, file, to, force=force)
    if as_json:
        say_json({"to": to, "files": {str(path): str(file)}})
    else:
        say(f"wrote {file}")
    return DONE


def targets(runs: list[Path], out: Path | None, to: str) -> list[Path]:
    """File for every recording: the one named, or one per recording in the folder named, or beside each.

    Raises:
        ConfigError: One file for several recordings.
    """
    if out is not None and (out.suffix and not out.is_dir()):
        if len(runs) > 1:
            raise ConfigError(f"one file for {len(runs)} recordings", fix="name a folder", file=out, key="--out")
        return [out]
    files = [(run.parent if out is None else out) / f"{run.stem}.{to}" for run in runs]
    for i, file in enumerate(files):
        if file in files[:i]:
            why = f"{runs[files.index(file)]} and {runs[i]} have the same name"
            raise ConfigError("two recordings for one file", why=why, fix="export them apart", file=file)
    return files
