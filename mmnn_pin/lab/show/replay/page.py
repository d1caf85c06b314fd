"""The page: scene, viewer and controls in one HTML text that opens anywhere, also from a file.

The viewer is meshcat's bundle, compressed to a quarter and unpacked by the browser itself. A content security policy in
the page forbids every request.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import ClassVar

from ....errors import RecordingError
from ....recording.recording import Recording
from ..html_page import HtmlPage
from .blob import compressed
from .scene import Scene, extent_of

FPS = 60.0
LARGE = 50_000_000  # bytes of a page that the user is warned of
SCRIPTS = ("unpack.js", "geometry.js", "robot.js", "stage.js", "run.js", "player.js", "main.js")


@dataclass(frozen=True)
class Page(HtmlPage):
    """A replay.

    Attributes:
        html: The whole page.
        frames: Frames shown, of all runs.
        samples: Samples recorded, of all runs.
        warnings: What is not shown as the URDF says, one line each; the last one tells of a page that is large.
    """

    frames: int
    samples: int
    warnings: tuple[str, ...]

    what: ClassVar[str] = "replay"

    def iframe(self, height: int = 520) -> str:
        """The page as an element for another page: isolated from it, at rest until it is played.

        Args:
            height: In CSS pixels.
        """
        return self.within(f"{height}px")


def page(
    recordings: Mapping[str, Recording], *, title: str = "", fps: float = FPS, package_dirs: Sequence[str | Path] = ()
) -> Page:
    """The replay of one run, or of several in one scene.

    Args:
        recordings: The runs by the name that the legend shows.
        title: Heading of the page; by default the robots and the experiment.
        fps: Frames per second that are kept; the page interpolates between them.
        package_dirs: Folders to look for meshes in before those that the recordings know.

    Raises:
        RecordingError: No run, one without anything to show, or one that does not tell its robot.
        InputError: The robot of a run cannot be built.
    """
    from jinja2 import Environment

    scene = Scene.of(recordings, fps, package_dirs)
    text = (
        Environment(autoescape=True)
        .from_string(source("page.html"))
        .render(
            title=title or title_of(recordings),
            style=source("page.css"),
            scripts="\n".join(map(source, SCRIPTS)),
            viewer=viewer(),
            data=scene.blob.pack(scene.header(extent_of(recordings))),
        )
    )
    warnings = scene.warnings
    if len(text) > LARGE:
        fix = "show fewer runs, keep fewer frames per second (--fps), or use simpler meshes"
        warnings += (f"the page is large, {len(text) / 1e6:.0f} MB: {fix}",)
    return Page(text, scene.frames, scene.samples, warnings)


def title_of(recordings: Mapping[str, Recording]) -> str:
    """What was run on which robot."""
    metas = [recording.meta for recording in recordings.values()]
    what = dict.fromkeys(str(meta[key]) for key in ("experiment", "robot") for meta in metas if key in meta)
    return ", ".join(what) or "replay"


def source(name: str) -> str:
    """A file of the page."""
    return resources.files(__package__).joinpath("web", name).read_text("utf-8")


@cache
def viewer() -> str:
    """Meshcat's viewer with its licences, compressed; meshcat itself is not imported.

    Raises:
        RecordingError: Meshcat is not installed, or holds no viewer.
    """
    found = importlib.util.find_spec("meshcat")
    folder = Path(found.origin).parent / "viewer" if found and found.origin else Path()
    try:
        licences = [(folder / name).read_text("utf-8") for name in ("LICENSE", "dist/main.min.js.LICENSE.txt")]
        code = (folder / "dist/main.min.js").read_text("utf-8")
    except OSError as error:
        raise RecordingError("no viewer", why=f"meshcat's is not at {folder}", fix="pip install meshcat") from error
    return compressed(f"/*\n{licences[0]}*/\n{licences[1]}\n{code}".encode())
