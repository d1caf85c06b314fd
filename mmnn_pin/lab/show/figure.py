"""Register, looks of controllers, marks, limits, legend and files of all figures.

A figure is a function with one line above it: `@figure("name")`. `mmnn plot`, an experiment's `plots`, the notebook and
the pages of studies find it by that name.

Colours are from Okabe and Ito's palette, which colour-blind eyes tell apart; the dashes survive a print in grey.
matplotlib is imported when the first figure is made, and never its state machine pyplot: no display is needed.
"""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import wraps
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec

import numpy as np

from ...errors import RecordingError
from ...files import whole_file
from ...recording.recording import Recording
from ...signals import Array
from ...torque.entries import CONTROLLERS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

P = ParamSpec("P")
Dash = tuple[float, tuple[float, ...] | None]
Look = Mapping[str, Any]  # keywords of matplotlib's `plot`

LETTERS = 17  # of a line beside an axis
FORMATS = ("png", "svg", "pdf")
RC: Any = {
    "font.size": 9,
    "axes.titlesize": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.formatter.limits": (-4, 5),
    "grid.color": "0.9",
    "grid.linewidth": 0.6,
    "svg.hashsalt": "mmnn_pin",
}
TOUCHED = ("axes.", "font.", "grid.", "legend.", "lines.", "mathtext.", "text.", "xtick.", "ytick.", "figure.")


@dataclass(frozen=True)
class Style:
    """Look of the curves of one controller: an RGB hex colour, a dash pattern, a width in points."""

    color: str
    dash: Dash
    width: float = 1.4

    @property
    def line(self) -> Look:
        """Keywords of matplotlib's `plot`; a solid line lies under the dashed ones and hides none."""
        depth = 2.0 if self.dash[1] is None else 2.1
        return {"color": self.color, "linestyle": self.dash, "linewidth": self.width, "zorder": depth}


STYLES = {name: Style(one.colour, (0, one.dashes or None), one.width) for name, one in CONTROLLERS.items()}
FREE = ("#AA3377", "#228833", "#EE7733", "#4477AA", "#666666")
DASHES = ((3, 1), (8, 1.5, 3, 1.5), (2, 1, 2, 3), (12, 2, 1, 2), (1, 3))
OTHERS = tuple(  # one colour after the other: on a replay there are no dashes
    Style(color, (0.0, DASHES[(place + turn) % len(DASHES)])) for turn in range(2) for place, color in enumerate(FREE)
)
TRUTH: Look = {"color": "0.65", "linewidth": 3.5, "solid_capstyle": "round", "zorder": 1.9}


@dataclass(frozen=True)
class FigureEntry:
    """A figure in the register."""

    make: Callable[[Any], Figure]  # draws it: runs by name, or what a folder holds
    lacks: Callable[[Any], str]  # why it cannot be drawn of these; empty where it can
    caption: str  # what to know of it, for a page


FIGURES: dict[str, dict[str, FigureEntry]] = {"runs": {}, "judged": {}, "study": {}}  # by what they show


def figure(
    name: str, of: str = "runs", *, needs: Callable[[Any], str] | None = None, caption: str = ""
) -> Callable[[Callable[P, Figure]], Callable[P, Figure]]:
    """Register a figure, and draw it in our look.

    Args:
        name: By which it is asked for.
        of: What it shows: runs by name, what was learned in them (`judged`), or a kind of `folders.FOLDERS`.
        needs: Tells why it cannot be drawn of these, nothing where it can; see `signals`.
        caption: What to know of it, for a page.
    """
    lacks: Callable[[Any], str] = needs or (signals() if of in ("runs", "judged") else lambda shown: "")

    def register(make: Callable[P, Figure]) -> Callable[P, Figure]:
        drawn = styled(make)

        @wraps(make)
        def checked(*args: P.args, **kwargs: P.kwargs) -> Figure:
            if why := lacks(args[0]):
                raise RecordingError(f"nothing to plot for {name}", why=why, fix="choose another figure or recording")
            return drawn(*args, **kwargs)

        FIGURES.setdefault(of, {})[name] = FigureEntry(checked, lacks, caption)
        return checked

    return register


def signals(*names: str) -> Callable[[Mapping[str, Recording]], str]:
    """The needs of a figure of runs: one of these signals in one of the runs, or only runs."""

    def lacks(recordings: Mapping[str, Recording]) -> str:
        if not recordings:
            return "no recording was given"
        known = not names or any(name in recording for recording in recordings.values() for name in names)
        return "" if known else f"its signals are not in {', '.join(recordings)}"

    return lacks


def write_figures(
    entries: Mapping[str, FigureEntry], recordings: Mapping[str, Recording], folder: Path, force: bool = True
) -> dict[str, Path]:
    """Draw the figures that these recordings have something for, then write them as PNG; name to file.

    Raises:
        RecordingError: A file that cannot be written, or that is there without `force`.
    """
    figures = {}
    for name, entry in entries.items():
        try:
            figures[name] = entry.make(recordings)
        except RecordingError:  # such as a figure of two learners where only one was run
            continue
    return {name: save(figure, folder / f"{name}.png", force) for name, figure in figures.items()}


def styles_of_controllers(controllers: Iterable[str]) -> dict[str, Style]:
    """Style of every controller: its own, or where it has none or another has the same, the next that is free."""
    return distinct({name: STYLES.get(name) for name in controllers})


def styles_of(recordings: Mapping[str, Recording]) -> dict[str, Style]:
    """Style of every recording: by its key, else by its controller; no two alike while there are others."""
    return distinct({n: STYLES.get(n) or STYLES.get(str(r.meta.get("controller"))) for n, r in recordings.items()})


def distinct(wanted: Mapping[str, Style | None]) -> dict[str, Style]:
    """Styles by name: what is wanted, controllers of the package first; else, or where that is taken, of `OTHERS`."""
    found: dict[str, Style] = {}
    others, known = cycle(OTHERS), [name for name in STYLES if name in wanted]
    for name in (*known, *(name for name in wanted if name not in STYLES)):
        own = wanted[name]
        found[name] = own if own is not None and own not in found.values() else next(others)
    return {name: found[name] for name in wanted}


def in_the_dark(color: str) -> str:
    """A colour as it is seen on a dark ground: dark greys are turned round, other dark colours have white in them."""
    parts = [int(color[i : i + 2], 16) for i in (1, 3, 5)]
    if max(parts) == min(parts) < 128:
        parts = [255 - part for part in parts]
    while 0.2126 * parts[0] + 0.7152 * parts[1] + 0.0722 * parts[2] < 0.36 * 255:
        parts = [part + (255 - part) // 10 for part in parts]
    return f"#{bytes(parts).hex()}"


def styled(make: Callable[P, Figure]) -> Callable[P, Figure]:
    """Make a figure in our look, whatever the user's matplotlib settings are."""

    @wraps(make)
    def inner(*args: P.args, **kwargs: P.kwargs) -> Figure:
        from matplotlib import rc_context, rcParamsDefault

        look: Any = {name: value for name, value in rcParamsDefault.items() if name.startswith(TOUCHED)} | RC
        with rc_context(look):
            return make(*args, **kwargs)

    return inner


def new_figure(width: float, height: float) -> Figure:
    """Empty figure, sizes in inches."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def axes_grid(count: int, most: int, width: float, height: float, margin: float) -> tuple[Figure, list[Axes]]:
    """A figure and so many axes of this size [inch], at most `most` beside each other, with a margin for the title."""
    columns = min(most, count)
    rows = -(-count // columns)
    picture = new_figure(width * columns, height * rows + margin)
    grid: Any = picture.subplots(rows, columns, squeeze=False)
    for axes in grid.flat[count:]:
        axes.set_axis_off()
    return picture, list(grid.flat[:count])


def log_ticks(axis: Axis, steps: Sequence[float]) -> None:
    """Plain numbers on a logarithmic axis, at these steps of every power of ten."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis.set_major_locator(LogLocator(subs=steps, numticks=8))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def mark_empty(axes: Axes) -> None:
    """Say in an axes that nothing is drawn in it."""
    axes.set_xticks([])
    axes.text(0.5, 0.5, "none", transform=axes.transAxes, ha="center", va="center", color="0.5")


def require_found(recordings: Mapping[str, Recording], found: Collection[object], what: str) -> None:
    """Refuse to draw a figure in which nothing is.

    Args:
        recordings: What was to be plotted.
        found: What of it the figure shows.
        what: The figure's name.

    Raises:
        RecordingError: Nothing was found.
    """
    if not found:
        why = f"its signals are not in {', '.join(recordings)}"
        raise RecordingError(f"nothing to plot for {what}", why=why, fix="choose another figure or recording")


def add_legend(figure: Figure, title: str, looks: Sequence[tuple[str, Look]]) -> None:
    """Title of a figure and its one legend, above the axes, from labels and looks."""
    from matplotlib.lines import Line2D

    longest = max((len(label) for label, _ in looks), default=0)
    rows = max(1, -(-len(looks) // max(1, int(figure.get_figwidth() / (0.065 * longest + 0.65)))))
    legend = figure.legend(
        [Line2D([], [], **look) for _, look in looks],
        [label for label, _ in looks],
        loc="outside upper left",
        ncols=max(1, -(-len(looks) // rows)),
        frameon=False,
        handlelength=3.6,
        title=title,
        alignment="left",
    )
    legend.get_title().set(fontsize=12, fontweight="bold")


def run_label(name: str, recording: Recording) -> str:
    """Name of a run, with how it ended if it ended early."""
    outcome = recording.outcome
    return name if outcome.status == "completed" else f"{name} ({outcome.status} at {outcome.time:.3g} s)"


def legend_label(name: str, recording: Recording) -> str:
    """Name of a run for a legend of matplotlib."""
    return plain(run_label(name, recording))


def style_looks(recordings: Mapping[str, Recording], styles: Mapping[str, Style]) -> list[tuple[str, Look]]:
    """Entries of a legend for runs."""
    return [(legend_label(name, recording), styles[name].line) for name, recording in recordings.items()]


def plain(text: str) -> str:
    """Text that matplotlib does not read as mathematics."""
    return text.replace("$", r"\$")


def folded(label: str, letters: int = LETTERS) -> str:
    """The label of an axis in lines short enough for it, broken at blanks and underscores, not in its unit."""
    lines = [""]
    for part in re.findall(r"\[[^\]]*\]$|[^_ ]*[_ ]|[^_ ]+$", label):
        for piece in (part[i : i + letters] for i in range(0, len(part), letters)):
            if len(lines[-1]) + len(piece.rstrip()) > letters:
                lines.append("")
            lines[-1] += piece
    return plain("\n".join(line.rstrip() for line in lines))


def scale_rows(recordings: Iterable[Recording]) -> list[tuple[Recording, slice]]:
    """Recordings and their rows that may set the scale of an axes.

    A diverged run sets no scale where another did not diverge; where all did, their last tenth does not.
    """
    every = [recording for recording in recordings if len(recording)]
    calm = [(recording, slice(None)) for recording in every if recording.outcome.status != "diverged"]
    return calm or [(recording, slice(max(1, int(0.9 * len(recording))))) for recording in every]


def limits(curves: Iterable[Array]) -> tuple[float, float]:
    """Limits of an axes that show the finite values of some curves, and zero, with a margin."""
    values = np.concatenate([[0.0], *curves])
    values = values[np.isfinite(values)]
    lower, upper = float(values.min()), float(values.max())
    margin = 0.07 * (upper - lower) or 1.0
    return lower - margin, upper + margin


def mark_end(axes: Axes, recording: Recording, style: Style, x: Array, y: Array) -> None:
    """Cross where the curve of a run that ended early was last seen in the axes."""
    if recording.outcome.status == "completed":
        return
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    seen = np.flatnonzero((left <= x) & (x <= right) & (bottom <= y) & (y <= top))
    if len(seen):
        last = seen[-1]
        axes.plot(x[last], y[last], "X", ms=8, color=style.color, mec="white", clip_on=False, zorder=5)


def save(figure: Figure, path: str | Path, force: bool = True) -> Path:
    """Write a figure as PNG, SVG or PDF, by the suffix; whole or not at all.

    Args:
        figure: The figure.
        path: The file.
        force: Whether it may replace another one.

    Raises:
        RecordingError: Another suffix, a place that cannot be written, or a file that is there.
    """
    from matplotlib import rc_context

    path = Path(path)
    if (suffix := path.suffix[1:].lower()) not in FORMATS:
        fix = f"end its name in {', '.join(f'.{known}' for known in FORMATS)}"
        raise RecordingError("cannot write the figure", why=f"unknown format '{path.suffix}'", fix=fix, file=path)
    undated: dict[str, Any] = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}.get(suffix, {})
    with whole_file(path, "figure", force) as part, rc_context(RC), without_glyphs():
        packing: Any = {"pil_kwargs": {"compress_level": 1}} if suffix == "png" else {}  # packed well by `thin`
        figure.savefig(part, format=suffix, dpi=160, metadata=undated, **packing)
        if suffix == "png":
            thin(part)
    return path


@contextmanager
def without_glyphs() -> Iterator[None]:
    """Draw boxes for letters that the font lacks, without a warning for each."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph ")
        yield


def svg(figure: Figure) -> str:
    """A figure as an SVG element."""
    file = io.StringIO()
    with without_glyphs():
        figure.savefig(file, format="svg", metadata={"Date": None})
    text = file.getvalue()
    return text[text.index("<svg") :]


def pictures(of: str, shown: Any) -> list[dict[str, str]]:
    """The figures of a page that there is something for, as SVG, each with its caption."""
    entries = {name: entry for name, entry in FIGURES[of].items() if not entry.lacks(shown)}
    return [{"name": n, "svg": svg(entry.make(shown)), "caption": entry.caption} for n, entry in entries.items()]


def thin(path: Path) -> None:
    """Keep 256 colours of a PNG, which no eye tells apart in a plot: a third of the bytes."""
    from PIL import Image

    with Image.open(path) as image:
        few = image.convert("RGB").quantize(256, dither=Image.Dither.NONE)
    few.save(path, "png", optimize=True)
