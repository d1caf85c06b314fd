"""Tables, figure and page of an identification."""

from __future__ import annotations

import math
import os
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any
from zipfile import BadZipFile, ZipFile

import numpy as np

from ...errors import RecordingError
from ...files import DENSEST, LARGEST, ROOM, opened, parsed_json, read_bytes
from .figure import TRUTH, Look, add_legend, folded, new_figure, styled, svg
from .files import HtmlPage, fill_template
from .table import WIDTH, Cell, CellKind, Column, Table, TextLine, number, row_of, terminal_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MODELS: dict[str, tuple[str, Look]] = {
    "identified": ("identified", {"color": "#0072B2", "linewidth": 1.1}),
    "urdf": ("URDF", {"color": "#D55E00", "linewidth": 1.1}),
    "friction": ("friction alone", {"color": "#999999", "linewidth": 1.1}),
}
WORDS = (
    "Held out: motion that the fit never saw. Error: RMS of measured minus predicted torque over RMS of measured, both "
    "through the same low-pass, where the joint moves."
)
FITTED = ("held_out", "least_squares_held_out")  # errors of what was fitted
CHECKED = 8  # findings on one screen
PRIOR = 0.5  # share known below which a number is mostly the URDF's


def text_of(report: dict[str, Any], colour: bool = False, width: int = WIDTH) -> str:
    """The report of an identification as text of at most `width` columns."""
    parts: list[Any] = [headline(report), *(f"warning: {text}" for text in report.get("warnings", ()))]
    for table in (joints_table(report), bodies_table(report), friction_table(report)):
        parts += ["", TextLine(table.title, "bold"), table, *table.notes]
    if report["wheels"]:
        parts += ["", TextLine("Wheels", "bold"), wheels_table(report)]
    parts += ["", f"{len(report['base_parameters'])} base parameters, {conditioned(report)}"]
    parts += [f"- {note}" for note in (*unidentified(report), *report["notes"])]
    return terminal_text(parts, colour, width)


def check_text(report: dict[str, Any]) -> str:
    """The doctor's findings, worst first, on one screen."""
    found = report["findings"]
    count = sum(one["grade"] == "refused" for one in found)
    every = f"{len(found)} finding{'s' * (len(found) != 1)}"
    head = f"{count} of {every} against the physics: nothing would be written"
    if not count:
        head = "nothing contradicts the physics" + (f", {every}" if found else "")
    parts: list[Any] = [TextLine(f"{report['robot']}: {head}", "bold")]
    for one in found[:CHECKED]:
        about = f" ({one['why']})" if one["why"] else ""
        parts.append(f"{one['grade'].upper()}  {one['what']}{about}")
        parts += [f"    changes: {one['changes']}"] if one["changes"] else []
        parts += [f"    mend it: {one['fix']}"] if one["fix"] else []
    parts += [f"and {len(found) - CHECKED} more, see --json"] if len(found) > CHECKED else []
    for log in report["logs"]:
        parts.append(f"{log['name']}: {'; '.join(log['notes'])}")
        parts += [f"    {line}" for line in delay_lines(log)]
    return terminal_text(parts)


def delay_lines(log: dict[str, Any]) -> Iterator[str]:
    """Delays of a log's efforts and rates, with bands of 95 %."""
    for kind, what in (("efforts", "efforts are late by"), ("motors", "efforts follow commands by")):
        said = [f"{name} {delay_text(one)}" for name, one in log[kind].items() if one is not None]
        if said:
            yield f"{what} {', '.join(said)} ms"


def delay_text(one: dict[str, float]) -> str:
    """A delay with its band [ms], and its lag."""
    lag = f" + lag {1e3 * one['lag']:.3g} ± {1.96e3 * one['lag_sd']:.2g}" if one["lag"] else ""
    return f"{1e3 * one['delay']:.3g} ± {1.96e3 * one['sd']:.2g}{lag}"


def headline(report: dict[str, Any]) -> str:
    """The verdict in a sentence."""
    ours, urdf, alone = (percent(report[key]) for key in ("held_out", "urdf_held_out", "friction_held_out"))
    count = sum(joint["identified"] for joint in report["joints"].values())
    word = "better than" if report["better"] else "NOT better than both"
    numbers = [report[key] for key in ("held_out", "urdf_held_out", "friction_held_out")]
    if not report["better"] and None not in numbers and numbers[0] < min(numbers[1:]):
        word = f"of what a URDF can hold of it {percent(report['without_toml_held_out'])}: NOT better than both"
    if not report["plausible"]:
        any_numbers = percent(report["least_squares_held_out"])
        word = f"NOT believed (least squares without regard to masses: {any_numbers}), beside"
    return (
        f"{report['robot']}: {count} of {len(report['joints'])} efforts identified; held-out error {ours}, {word} "
        f"the URDF ({urdf}) and friction alone ({alone})"
    )


def percent(share: float | None) -> str:
    """A share in percent."""
    return "-" if share is None or not math.isfinite(share) else f"{100 * share:.3g} %"


def joints_table(report: dict[str, Any]) -> Table:
    """Held-out errors joint by joint."""
    keys = ("held_out", "without_toml_held_out", "least_squares_held_out", "friction_held_out", "urdf_held_out")
    heads = ("identified", "in the URDF", "least squares", "friction alone", "URDF before")
    columns = (Column("joint", text=True), *(Column(head) for head in heads))
    rows = []
    for name, joint in report["joints"].items():
        errors = {key: joint[key] for key in keys if joint["identified"] or key not in FITTED}
        best = min((error for error in errors.values() if error is not None), default=None)
        cells = [
            Cell(percent(errors.get(key)), "best" if best is not None and errors.get(key) == best else "")
            for key in keys
        ]
        rows.append(row_of(name, *cells))
    rows.append(row_of("all identified", *(percent(report[key]) for key in keys)))
    note = (
        f"Low-pass at {report['cutoff']:.3g} Hz. 'In the URDF': without rotors and constants, which a URDF cannot hold."
        " A dash: not identified."
    )
    return Table("Held-out torque error", columns, tuple(rows), (WORDS, note))


def bodies_table(report: dict[str, Any]) -> Table:
    """Masses and centres with their intervals."""
    columns = (
        Column("body", text=True), Column("mass", "kg"), Column("URDF", "kg"),
        Column("x", "mm", "centre"), Column("y", "mm", "centre"), Column("z", "mm", "centre"), Column("known", "%"),
    )  # fmt: skip
    rows = []
    for name, body in report["bodies"].items():
        kind: CellKind = "dim" if body["known"] < PRIOR else ""
        texts = [f"{body['mass']:.3g} ± {1.96 * body['mass_sd']:.2g}", f"{body['urdf_mass']:.3g}"]
        for value, sd in zip(body["com"], body["com_sd"], strict=True):
            texts.append(f"{1e3 * value:.0f} ± {1.96e3 * sd:.0f}")
        rows.append(row_of(name, *(Cell(text, kind) for text in (*texts, f"{100 * body['known']:.0f}"))))
    note = (
        "Intervals of 95 %. A single mass is seldom visible in torques: where little is known it is the URDF's, and "
        "the interval that of a URDF trusted within 50 %. Known: by how much the motion narrowed the interval of the "
        "body's best determined number."
    )
    whole = report["total"]
    total = f"Together {whole['mass']:.4g} ± {1.96 * whole['mass_sd']:.2g} kg, in the URDF {whole['urdf_mass']:.4g} kg."
    if "driven" in whole:
        total += (
            f" Effective mass of driving straight, with wheels and rotors: {whole['driven']:.4g} ± "
            f"{1.96 * whole['driven_sd']:.2g} kg."
        )
    return Table("Bodies", columns, tuple(rows), (total, note))


def friction_table(report: dict[str, Any]) -> Table:
    """Friction, rotors and constants with their intervals."""
    kinds = [
        kind
        for kind in ("viscous", "coulomb", "stribeck", "rotor", "offset")
        if any(kind in j for j in report["friction"].values())
    ]
    columns = (Column("joint", text=True), *(Column(kind) for kind in kinds))
    rows = [row_of(name, *(interval(joint.get(kind)) for kind in kinds)) for name, joint in report["friction"].items()]
    why = dict[str, list[str]]()
    for name, text in report["rotors"].items():
        why.setdefault(text, []).append(name)
    notes = [f"{', '.join(names)}: {text}" for text, names in why.items()]
    return Table("Friction, rotors, constants", columns, tuple(rows), ("Intervals of 95 %; SI units.", *notes))


def interval(value: dict[str, float] | None) -> str:
    """A number with its interval."""
    return "" if value is None else f"{value['value']:.3g} ± {1.96 * value['sd']:.2g}"


def wheels_table(report: dict[str, Any]) -> Table:
    """Radii and track from odometry against the reference pose."""
    columns = (Column("", text=True), Column("identified", "mm"), Column("before", "mm"))
    rows = [
        row_of(
            name.replace("_", " "), f"{1e3 * one['value']:.2f} ± {1.96e3 * one['sd']:.2f}", f"{1e3 * one['urdf']:.2f}"
        )
        for name, one in report["wheels"].items()
    ]
    note = "From the wheels' angles against the reference pose; radius (mean) and track are written to NAME.mmnn.toml."
    return Table("Wheels", columns, tuple(rows), (note,))


def payload_text(load: dict[str, Any]) -> str:
    """The load of a hand, and how far the robot itself is trusted, in words."""
    pairs = zip(load["com"], load["com_sd"], strict=True)
    centre = ", ".join("unknown" if sd is None else f"{1e3 * x:.0f} ± {1.96e3 * sd:.0f}" for x, sd in pairs)
    doubt = f"its bodies are taken as {percent(load['doubt'])} off"
    if load["known_by"]:
        doubt = f"of {load['known_by']}, taken as {percent(load['doubt'])} further off than it says"
    return (
        f"{load['link']} carries {load['mass']:.3g} ± {1.96 * load['mass_sd']:.2g} kg at ({centre}) mm (95 %)\n"
        f"torque error {percent(load['error_without'])} without it, {percent(load['error_with'])} with it; the robot: "
        f"{doubt}"
    )


def excitation_text(found: dict[str, Any]) -> str:
    """The parameters that a motion would determine, worst first."""
    columns = (Column("combination", text=True, fold=True), Column("sd", "%"))
    every = found["base_parameters"]
    rows = [row_of(one["combination"], number(100 * one["sd"] / one["size"])) for one in every[:10]]
    well = sum(one["sd"] < 0.1 * one["size"] for one in every)
    head = (
        f"{found['robot']}: {found['duration']:.0f} s, condition number {found['condition']:.3g}; of {len(every)} base "
        f"parameters {well} are predicted within 10 % of their size. The worst, sd over size:"
    )
    where = [f"{axis} from {low:.2f} to {high:.2f} m" for axis, (low, high) in zip("xy", found["floor"], strict=False)]
    if found["nearest_obstacle"] is not None:
        where.append(f"no nearer than {found['nearest_obstacle']:.2f} m to an obstacle")
    if where:
        head = f"It drives within {', '.join(where)}. {head}" if found["floor"] else f"It comes {where[0]}. {head}"
    return terminal_text([head, Table("Predicted", columns, tuple(rows))])


def base_table(report: dict[str, Any]) -> Table:
    """Base parameters with standard deviations."""
    columns = (Column("combination", text=True, fold=True), Column("value"), Column("sd"), Column("URDF"))
    rows = [
        row_of(
            one["combination"],
            *(number(one[key]) if one[key] is not None else "not moved" for key in ("value", "sd", "urdf")),
        )
        for one in report["base_parameters"]
    ]
    note = f"Weighted least squares without the URDF; {conditioned(report)}."
    return Table("Base parameters", columns, tuple(rows), (note,))


def conditioned(report: dict[str, Any]) -> str:
    """The condition of the base parameters: how well the motion tells them apart."""
    if report["condition"] is not None:
        return f"condition number of the weighted regressor {report['condition']:.3g}"
    every = report["base_parameters"]
    return f"of which the motion tells {sum(one['identified'] for one in every)} apart"


def unidentified(report: dict[str, Any]) -> list[str]:
    """Parameters that stay at the URDF's values, a line each."""
    return [f"{name}: stays at the URDF: {why}" for name, why in report["not_identified"].items()]


@styled
def curves_figure(curves: dict[str, Any]) -> Figure:
    """Measured and predicted efforts of the motion held out, and what is left, joint by joint."""
    names = [str(name) for name in curves["names"]]
    figure = new_figure(11, 1.9 * len(names) + 0.9)
    panels = figure.subplots(len(names), 2, sharex=True, squeeze=False)
    for i, (name, (left, right)) in enumerate(zip(names, panels, strict=True)):
        measured = np.where(curves["use"][:, i], curves["measured"][:, i], np.nan)
        left.plot(curves["time"], measured, **TRUTH)
        most = 5 * np.nanmax(np.abs(measured), initial=1e-9)
        for model, (_, look) in MODELS.items():
            predicted = curves[model][:, i]
            if model == "identified" or np.nanmax(np.abs(predicted), initial=0) < most:
                left.plot(curves["time"], predicted, **look)
                right.plot(curves["time"], measured - predicted, **look)
        left.set(ylabel=folded(name))
    panels[0, 0].set_title("Measured and predicted efforts [N m or N]")
    panels[0, 1].set_title("Measured minus predicted")
    for axes in panels[-1]:
        axes.set_xlabel("time [s]")
    add_legend(figure, "Motion held out", [("measured", TRUTH), *MODELS.values()])
    return figure


def page(file: Path, command: str) -> HtmlPage:
    """The page of an identification that `mmnn identify` wrote.

    Args:
        file: Its JSON.
        command: What the user typed.

    Raises:
        RecordingError: The file, or the curves beside it, cannot be read.
    """
    try:
        report = parsed_json(read_bytes(file, LARGEST))
        with opened(file.with_suffix(".npz")) as content, ZipFile(content) as archive:
            if sum(part.file_size for part in archive.infolist()) > ROOM + DENSEST * os.fstat(content.fileno()).st_size:
                raise ValueError("its curves unpack to far more than they should")
            content.seek(0)
            with np.load(content, allow_pickle=False) as stored:
                curves = {name: stored[name] for name in stored.files}
        picture = {
            "svg": svg(curves_figure(curves)),
            "caption": "Motion held out; where a joint stands still it does not count.",
        }
        tables = [joints_table(report), bodies_table(report), friction_table(report), base_table(report)]
        tables += [wheels_table(report)] if report["wheels"] else []
        points = [*(f"warning: {text}" for text in report.get("warnings", ())), *unidentified(report), *report["notes"]]
        first = headline(report)
    except (
        *(OSError, ValueError, LookupError, TypeError, AttributeError),
        *(BadZipFile, zlib.error, MemoryError),
    ) as error:
        fix = "run mmnn identify again"
        raise RecordingError(
            "not an identification", why=f"{type(error).__name__}: {error}", fix=fix, file=file
        ) from None
    html = fill_template(
        "identified.html", title=f"{report['robot']} identified", headline=first, points=points, tables=tables,
        pictures=[picture], command=command, file=report.get("file", ""),
    )  # fmt: skip
    return HtmlPage(html)
