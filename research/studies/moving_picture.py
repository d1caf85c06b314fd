"""The moving picture of a replay page, as the README shows it.

    mmnn run track --robot tiago --controller two_layer --set time.duration=40 --out runs/tiago
    mmnn replay runs/tiago/two_layer.h5 --html runs/tiago/replay.html
    python -m research.studies.moving_picture runs/tiago/replay.html docs/figures/replay.gif

Needs Chromium, playwright and Pillow (`pip install -e ".[test]"`).
"""

from __future__ import annotations

import argparse
import io
import shutil
import sys
from pathlib import Path

from PIL import Image

SIZE = {"width": 960, "height": 540}
COLOURS = 96  # of the picture
DRAWN = 600  # software takes that long to draw a frame [ms]
FLAGS = ("--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")


def main(words: list[str] | None = None) -> int:
    """Write the picture; exit code 0."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("page", type=Path)
    parser.add_argument("picture", type=Path)
    parser.add_argument("--frames", type=int, default=48)
    parser.add_argument("--seconds", type=float, default=8.0, help="that the picture takes")
    parser.add_argument("--width", type=int, default=640, help="of the picture in pixels")
    given = parser.parse_args(words)
    frames = [small(frame, given.width) for frame in shots(given.page, given.frames)]
    first, *others = with_colours(frames)
    wait = round(1e3 * given.seconds / given.frames)
    first.save(given.picture, save_all=True, append_images=others, duration=wait, loop=0, optimize=True)
    drawn = getattr(Image.open(given.picture), "n_frames", 1)  # frames that are alike become one
    print(f"wrote {given.picture}: {given.picture.stat().st_size / 1e6:.2f} MB, {drawn} frames")
    return 0


def shots(page: Path, count: int) -> list[Image.Image]:
    """Pictures of a page at moments spread evenly over its run."""
    from playwright.sync_api import sync_playwright

    path = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    found: list[Image.Image] = []
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=path, args=list(FLAGS))
        tab = browser.new_page(viewport={"width": SIZE["width"], "height": SIZE["height"]})
        tab.goto(page.resolve().as_uri())
        tab.wait_for_function("Number(document.getElementById('scrub').max) > 0", timeout=120_000)
        tab.add_style_tag(content="#controls, #about { display: none }")
        last = float(tab.evaluate("Number(document.getElementById('scrub').max)"))
        for i in range(count):
            tab.evaluate(
                "at => { const s = document.getElementById('scrub'); s.value = at;"
                " s.dispatchEvent(new Event('input')); }",
                i * last / count,
            )
            tab.wait_for_timeout(DRAWN)
            found.append(Image.open(io.BytesIO(tab.screenshot())))
        browser.close()
    return found


def small(frame: Image.Image, width: int) -> Image.Image:
    """The middle of a frame at a width."""
    across, down = frame.size
    frame = frame.crop((round(0.12 * across), round(0.1 * down), round(0.88 * across), round(0.9 * down)))
    height = round(frame.height * width / frame.width)
    return frame.convert("RGB").resize((width, height), Image.Resampling.LANCZOS)


def with_colours(frames: list[Image.Image]) -> list[Image.Image]:
    """Frames with the same few colours: what does not move then does not flicker, and takes no room."""
    some = frames[:: max(1, len(frames) // 6)]
    sheet = Image.new("RGB", (some[0].width, some[0].height * len(some)))
    for i, frame in enumerate(some):
        sheet.paste(frame, (0, i * frame.height))
    colours = sheet.quantize(COLOURS, kmeans=1, dither=Image.Dither.NONE)
    return [frame.quantize(palette=colours, dither=Image.Dither.NONE) for frame in frames]


if __name__ == "__main__":
    sys.exit(main())
