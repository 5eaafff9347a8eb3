"""The README's moving picture: the studio in headless Chromium paints an object of a scene.

    python scripts/studio_recording.py tankard STYLES tankard "Paint like van gogh" docs/studio.webp

A click on the object, a style, the strokes as they appear, a turn of the camera, and the handle
between before and after. Waiting is left out. The scene is copied first; Chromium is needed.
"""

import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from re import search

import numpy as np
from PIL import Image

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from browser import Tab, launched, studio_tab, until

WINDOW, WIDTH = (1180, 760), 880  # pixels of the window, and of the picture's width
SHORT, LONG = 90, 900  # milliseconds of a frame, and of one to look at
READY = 10.0  # seconds: pictures of the objects and of the materials come meanwhile
EVERY, MOST = 1.0, 420.0  # seconds between frames of a painting, and of it at most
TURN, SPLIT = 18, 16  # frames
HANDLE = "[...document.querySelectorAll('[role=slider]')].find((each) => each.offsetParent)"


class Recording:
    """Frames of a tab, and how long each is shown."""

    def __init__(self, tab: Tab) -> None:
        self.tab, self.frames, self.times = tab, list[Image.Image](), list[int]()

    def take(self, milliseconds: int) -> None:
        """Add what the page shows now, or show the last frame longer if that is the same."""
        image = Image.fromarray(self.tab.page.screenshot())
        image = image.resize((WIDTH, WIDTH * image.height // image.width), Image.Resampling.LANCZOS)
        if self.frames and not np.any(np.asarray(image) != np.asarray(self.frames[-1])):
            self.times[-1] = max(self.times[-1], milliseconds)
            return
        self.frames.append(image)
        self.times.append(milliseconds)

    def drag(self, start: tuple[float, float], by: list[float]) -> None:
        """Drag sideways to each of some distances, with a frame at each."""
        page, (x, y) = self.tab.page, start
        page.mouse("move", x, y)
        page.mouse("press", x, y)
        for distance in by:
            page.mouse("move", x + distance, y, button="left", buttons=1)
            time.sleep(0.3)
            self.take(SHORT)
        page.mouse("release", x + by[-1], y)


def record(tab: Tab, name: str, style: str) -> Recording:
    """Do what the docstring of this file says."""
    recording = Recording(tab)
    tab.press_button("Skip")  # the hints of a first visit
    time.sleep(READY)
    place = tab.middle_of(name)
    recording.take(LONG)
    tab.page.mouse("move", *place)
    tab.page.until(f"studio.overlay.pointed === {name!r}")
    recording.take(LONG)
    tab.click(*place)
    tab.page.until(f"String(studio.overlay.picked?.names) === {name!r}")
    tab.wait_until_idle()
    recording.take(LONG)
    tab.press_button(style)
    until(lambda: "Stop" in tab.text(), "the painting")
    end = time.monotonic() + MOST
    while "Stop" in tab.text() and time.monotonic() < end:
        recording.take(SHORT)
        time.sleep(EVERY)
    if "Stop" in tab.text():
        tab.press_button("Stop")
        until(lambda: "Stop" not in tab.text(), "the end")
    tab.page.mouse("move", 5, 5)
    tab.wait_until_idle()
    recording.take(LONG)
    middle = (WINDOW[0] / 2, WINDOW[1] * 0.25)
    recording.drag(middle, [250 * np.sin(np.pi * i / TURN) for i in range(1, TURN + 1)])
    tab.wait_until_idle()
    recording.take(LONG)
    tab.press_button("Split")
    box = until(
        lambda: tab.page.evaluate(f"{HANDLE}?.getBoundingClientRect().toJSON()"), "a handle"
    )
    handle = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    tab.wait_until_idle()
    recording.take(LONG)
    recording.drag(handle, [230 * np.sin(2 * np.pi * i / SPLIT) for i in range(1, SPLIT + 1)])
    recording.take(2 * LONG)
    return recording


def main(scene: str, styles: str, name: str, style: str, output: str) -> None:
    """Write the recording as an animated WebP."""
    with tempfile.TemporaryDirectory() as folder:
        copy = shutil.copytree(scene, Path(folder) / "scene")
        command = [sys.executable, "-m", "stylesplat", "studio", str(copy), "--styles", styles]
        with subprocess.Popen([*command, "--port", "0"], stderr=subprocess.PIPE, text=True) as run:
            assert run.stderr is not None
            try:
                while (found := search(r"http://\S+", run.stderr.readline())) is None:
                    pass
                with (
                    launched() as browser,
                    studio_tab(browser, size=WINDOW, downloads=Path(folder)) as tab,
                ):
                    tab.open(found[0])
                    made = record(tab, name, style)
            finally:
                run.terminate()
    options = {"duration": made.times, "loop": 0, "quality": 60, "method": 4}
    made.frames[0].save(output, save_all=True, append_images=made.frames[1:], **options)
    size = Path(output).stat().st_size / 1e6
    print(f"{output}: {len(made.frames)} frames, {sum(made.times) / 1000:.0f} s, {size:.1f} MB")


if __name__ == "__main__":
    main(*sys.argv[1:])
