"""How soon the studio answers, measured in headless Chromium with software WebGL.

    python benchmarks/studio.py SCENE STYLES

The scene is copied first. Times are medians; a picture counts when the page shows it.
"""

import argparse
import shutil
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import stylesplat as ss
from chromium import Tab, browser, until

SIZE = 1344, 540  # the picture beside the panel has 960x540
PATIENCE = 300.0
TIMES = 5


def timed(act: Callable[[], object], ask: Callable[[], object], what: str) -> float:
    start = time.perf_counter()
    act()
    until(lambda: ask() or None, what, PATIENCE)
    return time.perf_counter() - start


def measure(scene: Path, styles: Path, tab: Tab) -> dict[str, float]:
    found = dict[str, float]()
    start = time.perf_counter()
    opened = ss.studio(scene, styles=styles, port=0, block=False)
    session, rest = opened.session, opened.page.stage.rest
    try:
        tab.open(f"http://127.0.0.1:{opened.port}")
        (client,) = until(opened.server.get_clients, "a browser", PATIENCE)
        until(lambda: rest.showing(client), "a picture", PATIENCE)
        found["first picture"] = time.perf_counter() - start
        session.worker.settle(PATIENCE)
        times = dict[str, list[float]]()

        def note(name: str, seconds: float) -> None:
            times.setdefault(name, []).append(seconds)

        for _ in range(TIMES):
            before = session.state
            tab.click(SIZE[0] * 0.3, SIZE[1] * 0.5)
            changed = lambda before=before: session.state is not before  # noqa: E731
            note("click to pick", timed(lambda: None, changed, "pick"))
            rest.changed()
            time.sleep(0.05)
            note("exact render at rest", timed(lambda: None, lambda: rest.showing(client), "rest"))
        title = opened.page.paint.gallery.exhibits[0].title
        tab.press_button("Paint")

        def press() -> None:
            tab.press_button(title)

        found["style to preview"] = timed(press, lambda: session.preview is not None, "preview")
        start = time.perf_counter()
        until(
            lambda: session.progress is not None and session.progress.share > 0, "strokes", PATIENCE
        )
        found["preview to first strokes"] = time.perf_counter() - start
        until(lambda: not session.painting, "the painting", PATIENCE)
        found["preview to the final picture"] = time.perf_counter() - start
        name = session.state.picked[0]
        from stylesplat.atelier.comparing import at_intensity

        for number in range(TIMES):
            value = 0.1 * number
            session.worker.settle(PATIENCE)
            begun = session.state

            def change(value: float = value) -> None:
                session.do(lambda state: at_intensity(state, name, value))

            asked = timed(change, lambda begun=begun: session.state is not begun, "intensity")
            note("intensity to new splats", asked)
        return found | {name: statistics.median(each) for name, each in times.items()}
    finally:
        opened.close()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scene", type=Path)
    parser.add_argument("styles", type=Path)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        scene = Path(shutil.copytree(given.scene, Path(folder) / "scene"))
        with browser(size=SIZE, downloads=Path(folder)) as tab:
            for name, seconds in measure(scene, given.styles, tab).items():
                print(f"{name:32s} {seconds:7.2f} s")


if __name__ == "__main__":
    main()
