"""All pictures by name, and which of them an experiment's run writes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from ...errors import RecordingError
from ...recording.recording import Recording
from .figure import save
from .monitors import MONITORS
from .plots import FIGURES
from .proof.figures import PROOF_FIGURES
from .thesis_figures import THESIS_FIGURES

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PICTURES: Mapping[str, Callable[[Mapping[str, Recording]], Figure]] = {
    **FIGURES,
    **MONITORS,
    **PROOF_FIGURES,
    **THESIS_FIGURES,
}


def write_pictures(recordings: Mapping[str, Recording], names: Iterable[str], folder: Path) -> dict[str, Path]:
    """Write the pictures that these recordings have something for, as PNG; name to file.

    Raises:
        RecordingError: A file that cannot be written.
    """
    runs = {name: recording for name, recording in recordings.items() if len(recording)}
    figures = {}
    for name in names:
        try:
            figures[name] = PICTURES[name](runs)
        except RecordingError:  # such as a figure of two learners where only one was run
            continue
    return {name: save(figure, folder / f"{name}.png") for name, figure in figures.items()}
