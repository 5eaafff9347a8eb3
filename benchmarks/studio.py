"""How soon the studio answers, measured in headless Chromium with software WebGL.

    python benchmarks/studio.py SCENE STYLES [--paintings 20]

The scene is copied first. Times are medians of five, but for those of the one painting. At rest a
picture counts when it was sent. `--paintings` measures the studio's memory over so many drafts
instead, without a browser.
"""

import argparse
import resource
import shutil
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import stylesplat as ss
from studio_tab import Tab, center_of, studio_tab, until
from stylesplat.studio_app.history import object_names
from stylesplat.studio_app.paint_queue import make_style
from stylesplat.studio_app.studio import StudioServer

SIZE = 1344, 540  # the picture beside the panel has 960x540
WIDTH = "Math.max(...[...document.querySelectorAll('canvas')].map(e => e.width))"
PATIENCE = 300.0
TIMES = 5

Time = tuple[str, float]


def seconds_until(ask: Callable[[], object], what: str) -> float:
    start = time.perf_counter()
    until(lambda: ask() or None, what, PATIENCE)
    return time.perf_counter() - start


def opening(scene: Path, styles: Path, tab: Tab) -> tuple[StudioServer, float]:
    start = time.perf_counter()
    opened = ss.studio(scene, styles=styles, port=0, block=False)
    tab.page.open(opened.url)
    until(lambda: opened.server.get_clients() or None, "a browser", PATIENCE)
    seconds_until(lambda: fits(opened, tab) and rests(opened), "a picture")
    return opened, time.perf_counter() - start


def fits(opened: StudioServer, tab: Tab) -> bool:
    """Whether the studio knows how large the picture is, beside the panel."""
    (client,) = opened.server.get_clients().values()
    return tab.page.evaluate(WIDTH) == client.camera.image_width


def rests(opened: StudioServer) -> bool:
    return all(map(opened.page.viewport.rest.showing, opened.server.get_clients()))


def picks(opened: StudioServer, tab: Tab) -> Iterator[Time]:
    session = opened.session
    place = center_of(opened, next(iter(session.state.scene.objects)))
    for _ in range(TIMES):
        session.worker.settle(PATIENCE)
        before = session.state
        tab.click(*place)
        changed = lambda before=before: session.state is not before  # noqa: E731
        yield "click to the pick", seconds_until(changed, "a pick")
        opened.page.viewport.rest.changed()
        time.sleep(0.05)
        yield "camera at rest to the exact picture", seconds_until(lambda: rests(opened), "rest")


def painting(opened: StudioServer, tab: Tab) -> Iterator[Time]:
    session = opened.session
    tab.press_button("Paint")
    tab.press_button(next(iter(opened.page.paint.gallery.pictures)))
    start = time.perf_counter()
    yield "style to the colour preview", seconds_until(lambda: session.preview, "a preview")

    def has_strokes() -> bool:
        return session.progress is not None and session.progress.share > 0

    seconds_until(has_strokes, "strokes")
    yield "style to the first strokes", time.perf_counter() - start
    seconds_until(lambda: not session.painting, "the painting")
    yield "style to the final picture", time.perf_counter() - start


def intensities(opened: StudioServer, tab: Tab) -> Iterator[Time]:
    session = opened.session
    tab.press_button("Compare")
    tab.focus_last_slider()
    tab.press("Home")
    until(lambda: session.state.note.endswith(" at 0%"), "intensity 0")
    for _ in range(TIMES):
        until(lambda: rests(opened), "rest", PATIENCE)
        before = session.state
        tab.press("ArrowRight")
        changed = lambda before=before: session.state is not before  # noqa: E731
        yield "intensity to other colours", seconds_until(changed, "another intensity")


def measure(scene: Path, styles: Path, tab: Tab) -> dict[str, list[float]]:
    opened, first = opening(scene, styles, tab)
    times = {"studio to the first picture": [first]}
    try:
        for found in (picks(opened, tab), painting(opened, tab), intensities(opened, tab)):
            for name, seconds in found:
                times.setdefault(name, []).append(seconds)
                print(f"{name}: {seconds:.2f} s", file=sys.stderr, flush=True)
    finally:
        opened.close()
    return times


def memories(scene: Path, styles: Path, count: int) -> None:
    """The largest memory so far after each of some paintings, of all objects in turn."""
    opened = ss.studio(scene, styles=styles, port=0, block=False)
    session, paint = opened.session, opened.page.paint
    names, pictures = object_names(session.state.scene), [*paint.gallery.pictures.values()]
    for number in range(count):
        name, style_picture = names[number % len(names)], pictures[number // 2 % len(pictures)]
        style = make_style(style_picture.path, quality="draft")
        paint.queue.paint((name,), style, style_picture.title)
        session.worker.settle(PATIENCE)
        most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
        print(f"{number + 1:3d} {session.state.note:50s} {most:.2f} GB", flush=True)
    opened.close()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scene", type=Path)
    parser.add_argument("styles", type=Path)
    parser.add_argument("--paintings", type=int)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        scene = Path(shutil.copytree(given.scene, Path(folder) / "scene"))
        if given.paintings is not None:
            memories(scene, given.styles, given.paintings)
            return
        with studio_tab(size=SIZE, downloads=Path(folder)) as tab:
            for name, times in measure(scene, given.styles, tab).items():
                print(f"{name:36s} {statistics.median(times):7.2f} s")


if __name__ == "__main__":
    main()
