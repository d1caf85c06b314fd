"""All figures of a proof by name, and how they are written."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from ....errors import RecordingError
from ....recording.recording import Recording
from ...proof.proof import Proof
from ..figure import save
from ..files import require_free
from .cache import keep
from .lyapunov_figures import equality_figure, lyapunov_figure, terms_figure
from .psi_figures import frozen_figure, fvu_figure, ranks_figure, shares_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PROOF_FIGURES: Mapping[str, Callable[[Mapping[str, Recording]], Figure]] = {
    "fvu": fvu_figure,
    "frozen": frozen_figure,
    "shares": shares_figure,
    "ranks": ranks_figure,
    "lyapunov": lyapunov_figure,
    "lyapunov-terms": terms_figure,
    "equality": equality_figure,
}


def write_proof(proof: Proof, folder: Path, force: bool = False) -> dict[str, Path]:
    """Write the figures that a proof has something for, as PNG; name to file.

    Raises:
        RecordingError: A file exists and `force` is off, or cannot be written; before any is.
    """
    keep(proof)
    runs, figures = {proof.subject.controller: proof.subject.recording}, {}
    for name in PROOF_FIGURES:
        require_free(folder / f"{name}.png", force)
    for name, make in PROOF_FIGURES.items():
        try:
            figures[name] = make(runs)
        except RecordingError:  # such as the ranks of a controller without networks
            continue
    return {name: save(figure, folder / f"{name}.png") for name, figure in figures.items()}
