"""What a recording shows in a notebook: its summary, its plots, and its replay in the page."""

from __future__ import annotations

import base64
import html
import io

from ...errors import InputError
from ...recording.recording import Recording
from .figure import RC
from .gallery import PICTURES
from .replay import page

SHOWN = ("errors", "path", "torque")
MOST = 5_000_000  # bytes of a replay that goes into a notebook


def notebook_html(recording: Recording) -> str:
    """The recording as HTML: what it has nothing for is left out."""
    name = str(recording.meta.get("controller", "run"))
    pictures = "".join(picture(name, recording, what) for what in SHOWN)
    return f"<pre>{html.escape(recording.summary())}</pre>{pictures}{replayed(name, recording)}"


def picture(name: str, recording: Recording, what: str) -> str:
    """A plot as an image; nothing where there is nothing to plot."""
    from matplotlib import rc_context

    try:
        figure = PICTURES[what]({name: recording})
    except InputError:
        return ""
    data = io.BytesIO()
    with rc_context(RC):
        figure.savefig(data, format="png", dpi=110)
    return f'<img alt="{what}" src="data:image/png;base64,{base64.b64encode(data.getvalue()).decode()}">'


def replayed(name: str, recording: Recording) -> str:
    """The replay, or why it is not there."""
    try:
        made = page({name: recording})
    except InputError as error:
        return f"<p>no replay: {html.escape(error.what)}</p>"
    if made.size > MOST:
        return f"<p>the replay has {made.size / 1e6:.0f} MB: <code>mmnn replay</code> shows it</p>"
    return made.iframe()
