"""A headless Chromium for tests: found, or installed from Debian; pages opened with an eye on what they do.

Screenshots go to the folder `MMNN_SCREENSHOTS` names, else to the test's own.
"""

from __future__ import annotations

import fcntl
import io
import os
import shutil
import subprocess
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
SOFTWARE_GL = ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
APT = ("apt-get", "-q", "-o", "Acquire::http::Timeout=20", "-o", "Acquire::Retries=1")
READY = 60_000  # longest wait for a page [ms]; software drawing is slow


def chromium() -> str | None:
    """Chromium's path; as root on Debian it is installed when there is none."""
    found = next(filter(None, map(shutil.which, NAMES)), None)
    if found or os.geteuid() or not shutil.which("apt-get"):
        return found
    with open(Path(tempfile.gettempdir()) / "mmnn_pin_chromium.lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # two workers must not install at once
        for command in (("update",), ("install", "-y", "--no-install-recommends", "chromium", "fonts-dejavu-core")):
            if not shutil.which("chromium"):
                with suppress(OSError, subprocess.SubprocessError):
                    subprocess.run((*APT, *command), capture_output=True, timeout=300)
    return shutil.which("chromium")


@contextmanager
def browser() -> Iterator[Any]:
    """A browser for some tests, which are skipped, with a warning, where there is none."""
    path = chromium()
    if path is None:
        warnings.warn("NO BROWSER: the pages are not tested; install Debian's chromium", stacklevel=2)
        pytest.skip("no chromium here, and none could be installed")
    sync_api = pytest.importorskip("playwright.sync_api", reason="NO BROWSER: pip install playwright")
    with sync_api.sync_playwright() as driver:
        started = driver.chromium.launch(executable_path=path, args=["--no-sandbox", *SOFTWARE_GL])
        yield started
        started.close()


@dataclass
class Opened:
    """An open page."""

    page: Any  # playwright's page
    problems: list[str] = field(default_factory=list)  # errors on the console, uncaught ones, dialogs
    requests: list[str] = field(default_factory=list)  # what it asked for but itself

    def settle(self) -> None:
        """Wait until two frames are drawn: a page draws its plots anew as soon as it learns how wide it is."""
        self.page.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")

    def shot(self, file: Path | None = None) -> np.ndarray:
        """What is to be seen, (height, width, 3) in [0, 255]; kept in the folder of screenshots."""
        from PIL import Image

        self.settle()
        data = self.page.screenshot()
        if file is not None:
            folder = Path(os.environ.get("MMNN_SCREENSHOTS") or file.parent)
            folder.mkdir(parents=True, exist_ok=True)
            (folder / file.name).write_bytes(data)
        return np.asarray(Image.open(io.BytesIO(data)).convert("RGB")).astype(int)


@contextmanager
def opened(browser: Any, file: Path, ready: str = "window.replay", **options: Any) -> Iterator[Opened]:
    """A file opened from disk, as soon as a condition holds in it.

    Args:
        browser: From `browser`.
        file: The page.
        ready: The condition, in JavaScript.
        options: Of Playwright's `new_page`.
    """
    page = browser.new_page(**({"viewport": {"width": 900, "height": 600}} | options))
    seen, own = Opened(page), file.resolve().as_uri()
    page.on("console", lambda message: seen.problems.append(message.text) if message.type == "error" else None)
    page.on("pageerror", lambda error: seen.problems.append(str(error)))
    page.on("dialog", lambda dialog: (seen.problems.append(f"dialog: {dialog.message}"), dialog.dismiss()))
    page.on("request", lambda request: seen.requests.append(request.url) if request.url != own else None)
    page.goto(own)
    page.wait_for_function(ready, timeout=READY)
    seen.settle()
    yield seen
    page.close()
