"""How soon the studio answers, in headless Chromium with software WebGL.

    .venv/bin/python benchmarks/studio.py SCENE STYLES OBJECT OBJECT

The scene is copied first. Times are medians of several turns, from the click to the picture that
the page shows; a painting is stopped after its first strokes, and undone.
"""

import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import chain
from pathlib import Path
from statistics import median
from typing import Annotated

import tyro
from bench import machine, table

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from browser import Tab, studio_tab, until

SIZE = 1344, 800  # pixels of the window
SECONDS = 3.0  # of a drag
# Every picture: when it was shown, and whether the camera moved then
WATCH = """window.pictures = []; new MutationObserver(() => window.pictures.push(
    [performance.now(), studio.root.dataset.after.endsWith("moving")]
)).observe(studio.root, { attributes: true, attributeFilter: ["data-after"] })"""

Times = Iterator[tuple[str, float]]


@contextmanager
def studio(scene: Path, styles: Path) -> Iterator[str]:
    """A studio in a process of its own; yields its address."""
    command = [sys.executable, "-m", "stylesplat", "studio", str(scene), "--styles", str(styles)]
    with subprocess.Popen([*command, "--port", "0"], stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        found = None
        while found is None:
            found = re.search(r"http://\S+", process.stderr.readline())
        try:
            yield found[0]
        finally:
            process.terminate()
            process.communicate()


def seconds_to(tab: Tab, goal: str, act: str) -> float:
    """Seconds from an action of the page to the next picture at rest after a goal is reached."""
    return tab.page.evaluate(f"""new Promise((done) => {{
        const began = performance.now();
        let reached = null;
        const again = () => {{
            if (reached === null && ({goal})) reached = window.pictures.length;
            const next = reached === null ? null : window.pictures.slice(reached - 1).find(
                ([at, moving]) => at > began && !moving);
            if (next) done((next[0] - began) / 1000); else setTimeout(again, 5);
        }};
        {act};
        again();
    }})""")


def button(label: str) -> str:
    return f"[...document.querySelectorAll('button')].find((each) => [each.ariaLabel, each.title, \
each.innerText.trim()].some((text) => text?.startsWith({json.dumps(label)})))"


def pictures(tab: Tab, url: str, turns: int) -> Times:
    for _ in range(turns):
        start = time.perf_counter()
        tab.page.open(url)
        tab.page.until("window.studio?.shown.after >= 0")
        yield "page to the first picture", time.perf_counter() - start
    tab.page.evaluate(WATCH)
    tab.settle()


def picks(tab: Tab, names: tuple[str, str], turns: int) -> Times:
    middles = {name: tab.middle_of(name) for name in names}
    for number in range(turns + 1):
        name = names[number % 2]
        start = time.perf_counter()
        tab.page.mouse("move", *middles[name])
        tab.page.until(f"studio.overlay.pointed === {json.dumps(name)}")
        yield "hover", time.perf_counter() - start
        start = time.perf_counter()
        tab.click(*middles[name])
        tab.page.until(f"String(studio.overlay.picked?.names) === {json.dumps(name)}")
        yield "click to the outline", time.perf_counter() - start
        tab.settle()


def moves(tab: Tab, turns: int) -> Times:
    x, y = (side / 2 for side in SIZE)
    for _ in range(turns):
        before = tab.page.evaluate("window.pictures.length")
        tab.page.mouse("move", x, y)
        tab.page.mouse("press", x, y)
        start = time.perf_counter()
        while time.perf_counter() - start < SECONDS:
            x += 2
            tab.page.mouse("move", x, y, button="left", buttons=1)
            time.sleep(0.016)
        seconds = time.perf_counter() - start
        count = tab.page.evaluate("window.pictures.length") - before
        tab.page.mouse("release", x, y)
        yield "a picture of a moving camera", seconds / max(count, 1)
        tab.page.evaluate("studio.camera.reset() || studio.moved()")
        x = SIZE[0] / 2
        tab.settle()


def paintings(tab: Tab, name: str, turns: int) -> Times:
    tab.click(*tab.middle_of(name))
    until(lambda: tab.place_of("Paint like"), "a style")
    style = f"{button('Paint like')}.click()"
    for turn in range(turns):
        tab.page.until("!document.body.innerText.includes('Stop')")
        time.sleep(2.0)  # thumbnails of before
        start = time.perf_counter()
        yield "style to colours", seconds_to(tab, "true", style)
        seconds_to(tab, "document.body.innerText.includes(': step ')", "0")
        yield "style to strokes", time.perf_counter() - start
        tab.press_button("Stop")
        until(lambda: tab.place_of("Continue"), "the end")
        if turn < turns - 1:
            tab.press_button("Undo")
            until(lambda: not tab.place_of("Continue"), "undo")


def strengths(tab: Tab) -> Times:
    time.sleep(3.0)
    found = "document.querySelector('input[type=range][aria-label=Strength]')"
    for value in (0.5, 0.9, 0.4, 1.0, 0.7):
        event = "new Event('input', {bubbles: true})"
        act = f"{found}.value = {value}; {found}.dispatchEvent({event})"
        yield "strength", seconds_to(tab, "true", act)
        tab.settle()
        time.sleep(1.0)


def main(
    scene: Annotated[Path, tyro.conf.Positional],
    styles: Annotated[Path, tyro.conf.Positional],
    objects: Annotated[tuple[str, str], tyro.conf.Positional],
    turns: int = 5,
) -> None:
    print(machine(), f"OMP_NUM_THREADS={os.environ.get('OMP_NUM_THREADS', '')}", flush=True)
    times = dict[str, list[float]]()
    with tempfile.TemporaryDirectory() as folder:
        copy = shutil.copytree(scene, Path(folder) / "scene")
        with (
            studio(copy, styles) as url,
            studio_tab(size=SIZE, downloads=Path(folder)) as tab,
        ):
            for name, seconds in pictures(tab, url, turns):
                times.setdefault(name, []).append(seconds)
            time.sleep(8.0)  # kernels and the network are loaded meanwhile
            parts = (
                picks(tab, objects, turns),
                moves(tab, turns),
                paintings(tab, objects[0], turns),
                strengths(tab),
            )
            for name, seconds in chain(*parts):
                times.setdefault(name, []).append(seconds)
    rows = [[name, f"{median(each):.2f}", f"{max(each):.2f}"] for name, each in times.items()]
    print(table(("what", "median s", "longest"), rows))


if __name__ == "__main__":
    tyro.cli(main)
