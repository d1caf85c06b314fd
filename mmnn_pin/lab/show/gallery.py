"""All that shows results: figures by name for `mmnn plot` and an experiment's run, and what objects show of themselves.

Importing this module fills the registers: every module that shows something is imported here, and then what stands
above the package (`shown.filled`).
"""

from __future__ import annotations

import base64
import io
import shutil
from collections import ChainMap
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike

from ...deploy.identify.identification import Identification
from ...errors import InputError, UnknownName
from ...model.robot import Robot
from ...recording.recording import Recording
from ...shown import AsText, filled, shows
from ..experiments.result import Result
from ..study.sweep import Sweep
from . import comparison, identified, plots, psi, psi_figures, robots, study, study_figures, thesis_figures
from .figure import FIGURES, RC, FigureEntry, save, write_figures
from .replay import page
from .report import report
from .table import WIDTH

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .view import RobotView

MODULES = (identified, plots, psi, psi_figures, robots, study_figures, thesis_figures)  # that register themselves
PICTURES: Mapping[str, FigureEntry] = ChainMap(FIGURES["judged"], FIGURES["runs"])  # of runs
NOTEBOOK = ("errors", "path", "torque")
MOST = 5_000_000  # bytes of a replay that goes into a notebook


def write_pictures(
    recordings: Mapping[str, Recording], names: Iterable[str], folder: Path, force: bool = True
) -> dict[str, Path]:
    """Write the pictures that these recordings have something for, as PNG; name to file.

    Raises:
        RecordingError: A file that cannot be written.
    """
    runs = {name: recording for name, recording in recordings.items() if len(recording)}
    return write_figures({name: PICTURES[name] for name in names}, runs, folder, force)


def require_plots(names: Iterable[str]) -> None:
    """Refuse names of pictures that there are not (`UnknownName`)."""
    for name in names:
        if name not in PICTURES:
            raise UnknownName("plot", name, PICTURES, key="plots")


@dataclass(frozen=True, repr=False)
class Shown(AsText):
    """Tables that print as text, and that a notebook shows."""

    text: str  # for a terminal

    def __repr__(self) -> str:
        return self.text


@dataclass(frozen=True, repr=False)
class Picture:
    """A figure of matplotlib; a notebook shows it."""

    name: str  # of the figure
    figure: Figure  # it

    def __repr__(self) -> str:
        return f'<Picture {self.name}: .save("{self.name}.svg") writes it, .figure is matplotlib\'s>'

    def _repr_html_(self) -> str:
        return image(self.figure, self.name)

    def save(self, path: str | Path) -> Path:
        """Write it as PNG, SVG or PDF, by the suffix.

        Raises:
            RecordingError: Another suffix, or a place that cannot be written.
        """
        return save(self.figure, path)


@shows(Result, "table")
def tables(result: Result) -> Shown:
    """The tables of an experiment with its notes, as wide as the terminal."""
    found = "".join(f"\nnote: {note}" for note in comparison.notes(result))
    return Shown(comparison.render(result, width=columns()) + ("\n" + found if found else ""))


@shows(Sweep, "table")
def sweep_table(sweep: Sweep) -> Shown:
    """The results at every value of a factor, as text."""
    return Shown(study.levels_text(sweep.results, sweep.key, columns()))


@shows(Sweep, "plot")
def sweep_picture(sweep: Sweep) -> Picture:
    """Errors against what was swept.

    Raises:
        RecordingError: It is no number.
    """
    return Picture("sweep", FIGURES["study"]["study-errors"].make(sweep.results))


def columns() -> int:
    """Columns of the terminal, 80 at least."""
    return max(80, shutil.get_terminal_size((WIDTH, 24)).columns)


@shows(Result, "plot")
def picture(recordings: Mapping[str, Recording], what: str) -> Picture:
    """A figure of runs.

    Raises:
        UnknownName: There is no such figure.
        RecordingError: The runs have nothing for it.
    """
    if what not in PICTURES:
        raise UnknownName("figure", what, PICTURES)
    return Picture(what, PICTURES[what].make(recordings))


@shows(Recording, "html")
def notebook_html(recording: Recording) -> str:
    """A recording in a notebook: its summary, its plots, its replay; what it has nothing for is left out."""
    name = str(recording.meta.get("controller", "run"))
    pictures = "".join(image_of(name, recording, what) for what in NOTEBOOK)
    return f"<pre>{escape(recording.summary())}</pre>{pictures}{replay_in(name, recording)}"


def image_of(name: str, recording: Recording, what: str) -> str:
    """A figure as an image; nothing where there is nothing to plot."""
    try:
        return image(PICTURES[what].make({name: recording}), what)
    except InputError:
        return ""


def image(figure: Figure, what: str) -> str:
    """A figure as an image of a page."""
    from matplotlib import rc_context

    data = io.BytesIO()
    with rc_context(RC):
        figure.savefig(data, format="png", dpi=110)
    return f'<img alt="{what}" src="data:image/png;base64,{base64.b64encode(data.getvalue()).decode()}">'


def replay_in(name: str, recording: Recording) -> str:
    """The replay, or why it is not there."""
    try:
        made = page({name: recording})
    except InputError as error:
        return f"<p>no replay: {escape(error.what)}</p>"
    if made.size > MOST:
        return f"<p>the replay has {made.size / 1e6:.0f} MB: <code>mmnn replay</code> shows it</p>"
    return made.iframe()


shows(Identification, "text")(lambda found: identified.text_of(found.to_dict()))
shows(Result, "replay")(page)


@shows(Robot, "view")
def view(robot: Robot, q: ArrayLike | None = None, **options: Any) -> RobotView:
    """A robot in meshcat; see `RobotView`."""
    from .view import RobotView

    return RobotView(robot, q, **options)


@shows(Recording, "view")
def view_run(recording: Recording, **options: Any) -> RobotView:
    """A run in meshcat; see `view.played`."""
    from .view import played

    return played(recording, **options)


shows(Result, "report")(report)
filled()
