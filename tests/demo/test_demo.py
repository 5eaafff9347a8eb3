"""The demo: the capture that ships, and the whole run on a few small photos of it."""

import json
import shutil
import subprocess
from contextlib import nullcontext
from dataclasses import replace
from html import escape
from pathlib import Path

import pytest
import torch
from PIL import Image

import stylesplat as ss
from browser import Browser, as_url, needs_chromium
from doc_pages import OURS
from stylesplat.demo import demo_run
from stylesplat.demo.demo_run import (
    ARCHIVE,
    TRAINING,
    copy_capture,
    run_demo,
    stylize_noise,
    warm_up_stylization,
)
from stylesplat.errors import StyleSplatError
from stylesplat.stylization.config import StyleConfig

ROWS = range(16, 48, 4)  # photos of the small capture; the first one, which is held out, is shown
SMALLER = 4  # times


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return copy_capture(tmp_path_factory.mktemp("demo") / "capture")


@pytest.fixture(scope="module")
def archive(capture: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The capture with few small photos."""
    small = shutil.copytree(capture, tmp_path_factory.mktemp("small") / "small")
    content = json.loads((small / "transforms.json").read_text())
    content["frames"] = [content["frames"][row] for row in ROWS]
    for frame in content["frames"]:
        frame |= {key: frame[key] / SMALLER for key in ("fl_x", "fl_y", "cx", "cy")}
        frame |= {key: frame[key] // SMALLER for key in ("w", "h")}
    (small / "transforms.json").write_text(json.dumps(content))
    for path in (small / "images").iterdir():
        with Image.open(path) as photo:
            photo.reduce(SMALLER).save(path)
    return Path(shutil.make_archive(str(small), "zip", small))


def test_the_shipped_capture_is_small_and_whole(capture: Path):
    assert ARCHIVE.stat().st_size < 3e6
    photos, exact = ss.load(capture), ss.load(capture, masks=capture / "object_mask_exact")
    assert len(photos) == 48 and photos.cameras[0].size == (480, 360)
    assert photos.points is not None and len(photos.points) == 40_000
    above = -photos.cameras.viewmats[:, 1, :3].mean(dim=0)  # of the photos, in the world
    assert above[1] < -0.8 and above[[0, 2]].abs().max() < 0.1, "upright in viewers: y down"
    top, table = photos.points[:, 1].quantile(torch.tensor([0.01, 0.9])).tolist()
    assert top < -0.5 and abs(table) < 0.1, "objects stand on a table at 0"
    assert photos.label_maps is not None and exact.label_maps is not None
    agree = []
    for row in range(0, 48, 8):
        given, true = photos.label_maps[row], exact.label_maps[row]
        assert given is not None and true is not None
        agree.append(float((given == true).float().mean()))
    assert 0.9 < sum(agree) / len(agree) < 0.999, "wrong here and there, on purpose"
    names = json.loads((capture / "object_names.json").read_text())
    assert names == {"1": "vase", "2": "teapot", "3": "pear", "4": "block", "5": "ball"}
    for style in ("swirling_night", "burning_tide", "scales"):
        with Image.open(capture / "styles" / f"{style}.jpg") as painting:
            assert painting.size == (576, 576)


@pytest.fixture(scope="module")
def made(archive: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A demo that was interrupted before it painted, and started again."""
    out = tmp_path_factory.mktemp("demo") / "demo"
    few = StyleConfig(steps=2, object_size=112, quality="draft")

    def stop(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    def run(**options: object) -> dict:
        training = replace(TRAINING, steps=30, max_gaussians=6000)
        return run_demo(out, archive=archive, training=training, styling=few, **options)  # type: ignore[arg-type]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            demo_run, "warm_up_stylization", lambda capture: nullcontext()
        )  # it has its own test
        patch.setattr("stylesplat.verbs.render.FRAMES", 3)
        with patch.context() as interrupting:
            interrupting.setattr(demo_run, "stylize", stop)
            with pytest.raises(KeyboardInterrupt):
                run()
        trained = (out / "scene" / "splats.ply").stat().st_mtime_ns
        result = run()
    assert (out / "scene" / "splats.ply").stat().st_mtime_ns == trained, "it is not trained twice"
    assert result.keys() == {"report", "splat", "page", "video", "seconds"}
    assert all(result[what].stat().st_size > 0 for what in result.keys() - {"seconds"})
    return out


def test_scenes_and_pictures(made: Path):
    assert not [*made.glob("*.partial")]
    with Image.open(made / "after" / "016.png") as picture:
        assert picture.size == (240, 180), "twice the photos' size"
    scene, styled = ss.open(made / "scene"), ss.open(made / "styled")
    assert {*scene.objects} >= {"vase", "teapot"}
    assert styled.painted_objects == ("vase", "teapot")
    assert len(ss.load(made / "capture")) == len(ROWS), "it was not copied again"
    with pytest.raises(StyleSplatError, match="--overwrite"):
        run_demo(made)


def test_the_gallery_paints_its_objects(made: Path):
    page = [each.words for each in OURS if each.place.startswith("docs/gallery.md")]
    commands = [words for words in page if words[1] == "stylize" and words[2].startswith("demo")]
    assert len(commands) == 2
    styles = [word for words in commands for word in words if "=" in word]
    assert {word.partition("=")[0] for word in styles} == {*ss.open(made / "scene").objects}


def test_the_report_holds_everything_and_names_no_file(made: Path):
    page = (made / "report.html").read_text()
    assert "painted Gaussians</th>" in page
    assert "Vase: " in page and "Teapot: " in page, "how close each is to its painting"
    assert escape((made / "styled.html").read_text()) in page, "the splat to turn"
    assert page.count("data:video/mp4;base64,") == 1
    assert page.count("data:image/png;base64,") + page.count("data:image/jpeg;base64,") >= 10
    assert str(made) not in page
    without_splat = page.replace(escape((made / "styled.html").read_text()), "")
    assert "$" not in without_splat, "every placeholder is filled"


@needs_chromium
def test_the_report_shows_the_splat_in_a_browser(made: Path, chromium: Browser):
    with chromium.tab(500, 700) as browser:
        browser.open(as_url(made / "report.html"))
        browser.evaluate("document.querySelector('iframe').scrollIntoView()")
        browser.until("document.querySelector('iframe').contentWindow.viewer")
        box = browser.evaluate("document.querySelector('iframe').getBoundingClientRect().toJSON()")
        left, top, right, bottom = (round(box[side]) for side in ("left", "top", "right", "bottom"))
        shown = browser.screenshot()[top:bottom, left:right].astype(float)
        assert shown.std() > 20, "not an empty frame"
        assert browser.complaints() == []


@pytest.mark.usefixtures("quick_painting")
def test_warm_up_calls_every_kernel(archive: Path, tmp_path: Path):
    # An error in it would only cost time, so nobody would notice
    stylize_noise(copy_capture(tmp_path / "few", archive))


def test_warm_up_ends_with_an_interruption(capture: Path, monkeypatch: pytest.MonkeyPatch):
    started = []
    popen = subprocess.Popen

    def start(*arguments, **options):
        started.append(popen(*arguments, **options))
        return started[-1]

    monkeypatch.setattr(subprocess, "Popen", start)
    with pytest.raises(KeyboardInterrupt), warm_up_stylization(capture):
        raise KeyboardInterrupt
    assert started[0].poll() is not None, "it has ended"
