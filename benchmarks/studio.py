"""How soon the studio answers, in headless Chromium with software WebGL; how much memory it takes.

    .venv/bin/python benchmarks/studio.py

Without arguments it takes the fox with 100,000 Gaussians, which is trained once, and as a large
scene 3,000,000 copies of these, shifted. Scenes are copied first. Times are medians of several
turns, from the click to the picture that the page shows; a painting is stopped after its first
strokes, and undone. Processor seconds are those of the studio's process: other programs lengthen
them less than times. Half an hour on two quiet cores; `--parts` does some of it.
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
from dataclasses import replace
from itertools import chain
from pathlib import Path
from statistics import median
from typing import Literal

import tyro
from bench import OUT, STYLES, machine, resized, table, trained_scene

import stylesplat as ss

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from browser import Tab, as_url, launched, studio_tab, until

SIZE = 1344, 800  # pixels of the window
SECONDS = 3.0  # of a drag
LARGE, TURNED = 3_000_000, 500_000  # Gaussians
VIEWER = {100_000: 9, 1_000_000: 3}  # frames that are drawn, by the number of Gaussians
PAINTINGS, STEPS = 20, 10  # whose memory is measured
GIB = 2**30
# Every picture: when it was shown, and whether the camera moved then
WATCH = """window.pictures = []; new MutationObserver(() => window.pictures.push(
    [performance.now(), studio.root.dataset.after.endsWith("moving")]
)).observe(studio.root, { attributes: true, attributeFilter: ["data-after"] })"""

Times = Iterator[tuple[str, float]]


@contextmanager
def studio(scene: Path, styles: Path) -> Iterator[tuple[str, int]]:
    """A studio in a process of its own; yields its address and the process's number."""
    command = [sys.executable, "-m", "stylesplat", "studio", str(scene), "--styles", str(styles)]
    with subprocess.Popen([*command, "--port", "0"], stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        found = None
        while found is None:
            found = re.search(r"http://\S+", process.stderr.readline())
        try:
            yield found[0], process.pid
        finally:
            process.terminate()
            process.communicate()


def processor_seconds(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return sum(map(int, fields[11:13])) / os.sysconf("SC_CLK_TCK")


def memory(pid: int | str, field: str) -> float:
    """In GiB."""
    found = re.search(rf"{field}:\s+(\d+) kB", Path(f"/proc/{pid}/status").read_text())
    assert found is not None
    return 1024 * int(found[1]) / GIB


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
    tab.wait_until_idle()


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
        tab.wait_until_idle()


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
        tab.wait_until_idle()


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
        tab.wait_until_idle()
        time.sleep(1.0)


def small(scene: Path, styles: Path, objects: tuple[str, str], turns: int) -> list[list[str]]:
    """What an artist does."""
    times = dict[str, list[float]]()
    with tempfile.TemporaryDirectory() as folder:
        copy = shutil.copytree(scene, Path(folder) / "scene")
        with (
            studio(copy, styles) as (url, _),
            launched() as browser,
            studio_tab(browser, size=SIZE, downloads=Path(folder)) as tab,
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
    return [[name, f"{median(each):.2f} s", f"{max(each):.2f}"] for name, each in times.items()]


def large(scene: Path, styles: Path) -> Iterator[list[str]]:
    """From the command to the first picture of a large scene, and to its objects."""
    with tempfile.TemporaryDirectory() as folder:
        small_scene = ss.open(scene)
        splats = resized(small_scene.splats, LARGE)
        larger = replace(small_scene, base=splats, layers=(), objects={}, path=None)
        ss.save(larger, Path(folder) / "scene")
        del small_scene, splats, larger
        with (
            launched() as browser,
            studio_tab(browser, size=SIZE, downloads=Path(folder)) as tab,
        ):
            start = time.perf_counter()
            with studio(Path(folder) / "scene", styles) as (url, pid):
                tab.page.open(url)
                goals = {
                    "first picture": "window.studio?.shown.after >= 0",
                    "all objects": "studio.overlay.map?.names.length > 0",
                }
                for name, goal in goals.items():
                    until(lambda goal=goal: tab.page.evaluate(goal), name, 900.0)
                    seconds, own = time.perf_counter() - start, processor_seconds(pid)
                    what = f"{LARGE:,} Gaussians, command to {name}"
                    yield [what, f"{seconds:.1f} s", f"{own:.1f} of the processor"]
                yield [f"{LARGE:,} Gaussians, memory", f"{memory(pid, 'VmHWM'):.2f} GiB", "peak"]


def turning(scene: Path, styles: Path, turns: int) -> Iterator[list[str]]:
    """Pictures a second while a large scene is turned, where no graphics card draws."""
    with tempfile.TemporaryDirectory() as folder:
        opened = ss.open(scene)
        splats = resized(opened.splats, TURNED)
        larger = replace(opened, base=splats, layers=(), objects={}, path=None)
        ss.save(larger, Path(folder) / "scene")
        with (
            studio(Path(folder) / "scene", styles) as (url, _),
            launched() as browser,
            studio_tab(browser, size=SIZE, downloads=Path(folder)) as tab,
        ):
            tab.page.open(url)
            goal = "window.studio?.overlay.map?.names.length > 0"
            until(lambda: tab.page.evaluate(goal), "all objects", 900.0)
            time.sleep(8.0)  # kernels and the network are loaded meanwhile
            tab.page.evaluate(WATCH)
            times = [seconds for _, seconds in moves(tab, turns)]
        what = f"turning {TURNED:,} Gaussians, without a graphics card"
        yield [what, f"{1 / median(times):.1f} /s", f"{max(times):.2f} s"]


def viewer(scene: Path) -> Iterator[list[str]]:
    """Frames of the viewer, of exported pages as well, at 960x540 by software."""
    opened = ss.open(scene)
    for count, frames in VIEWER.items():
        with (
            tempfile.TemporaryDirectory() as folder,
            launched() as browser,
            browser.tab(960, 540) as page,
        ):
            file = Path(folder) / "page.html"
            splats = resized(opened.splats, count)
            ss.export(replace(opened, base=splats, layers=(), objects={}), file)
            page.open(as_url(file))
            until(lambda: page.evaluate("Boolean(window.viewer)"), "the viewer", 900.0)
            times = page.evaluate(f"""(() => {{
                const canvas = document.querySelector("canvas"), gl = canvas.getContext("webgl2");
                return [...Array({frames}).keys()].map(() => {{
                    viewer.camera.turn(0.1, 0);
                    const began = performance.now();
                    viewer.draw(viewer.camera.view([canvas.width, canvas.height]));
                    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
                    return (performance.now() - began) / 1000;
                }});
            }})()""")
            seconds = median(times)
            yield [f"viewer, {count:,} Gaussians", f"{1 / seconds:.1f} /s", f"{max(times):.2f} s"]


def painted(scene: Path, styles: Path, objects: tuple[str, str]) -> Iterator[list[str]]:
    """The memory of many paintings in default quality, which are all kept as variants."""
    with tempfile.TemporaryDirectory() as folder:
        copy = shutil.copytree(scene, Path(folder) / "scene")
        opened = ss.studio(copy, styles=styles, port=0, block=False)
        actions, session = opened.server.actions, opened.session
        session.worker.wait_until_idle(600)
        yield ["memory, scene open", f"{memory('self', 'VmRSS'):.2f} GiB", ""]
        pictures = [*actions.gallery.pictures.values()]
        for number in range(PAINTINGS):
            picture, name = pictures[number % len(pictures)], objects[number % 2]
            style = ss.Style(picture.path, steps=STEPS)
            session.ask(lambda s=style, n=name, t=picture.title: actions.queue.paint([n], s, t))
            assert session.worker.wait_until_idle(900)
        assert len(actions.variants) == PAINTINGS
        peak = f"peak {memory('self', 'VmHWM'):.2f}"
        yield [f"memory, {PAINTINGS} paintings", f"{memory('self', 'VmRSS'):.2f} GiB", peak]
        opened.close()


def main(
    scene: Path | None = None,
    styles: Path = STYLES,
    objects: tuple[str, str] = ("1", "2"),
    turns: int = 5,
    parts: tuple[Literal["memory", "small", "turning", "large", "viewer"], ...] = (
        "memory",
        "small",
        "turning",
        "large",
        "viewer",
    ),
) -> None:
    """`memory` comes first: it is that of this process."""
    known = OUT / "test_objects" / "fox"  # of looks.py
    if scene is None:
        scene = known if known.exists() else trained_scene("fox", downscale=2, gaussians=100_000)
    print(machine(), f"OMP_NUM_THREADS={os.environ.get('OMP_NUM_THREADS', '')}", flush=True)
    does = {
        "memory": lambda: painted(scene, styles, objects),
        "small": lambda: small(scene, styles, objects, turns),
        "turning": lambda: turning(scene, styles, turns),
        "large": lambda: large(scene, styles),
        "viewer": lambda: viewer(scene),
    }
    rows = list[list[str]]()
    for part in parts:
        for row in does[part]():
            print(*row, sep=", ", flush=True)
            rows.append(row)
    print(table(("what", "median", "longest"), rows))


if __name__ == "__main__":
    tyro.cli(main)
