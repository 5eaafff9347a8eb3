"""The whole demo, on a still life of few small photos."""

from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from html import escape
from pathlib import Path

import pytest
from PIL import Image

import stylesplat as ss
from stylesplat.demo import demo_run as run
from stylesplat.demo.demo_capture import MARKER, write_demo_capture
from stylesplat.demo.demo_run import run_demo
from stylesplat.errors import StyleSplatError
from stylesplat.stylization.config import StyleConfig
from stylesplat.verbs.train import train


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    def capture(folder: Path) -> Path:
        path = folder / "small"
        if not (path / MARKER).is_file():
            write_demo_capture(path, views=9, width=120, height=90)
        return path

    monkeypatch.setattr(run, "demo_capture", capture)
    monkeypatch.setattr(run, "SHOWN", "000")
    monkeypatch.setattr(run, "compiled_meanwhile", nullcontext)  # see test_rehearsal
    monkeypatch.setattr(run, "TRAINING", replace(run.TRAINING, steps=60))
    # Labels that are lifted are there after few steps
    monkeypatch.setattr(run, "train", partial(train, segment="lift"))
    monkeypatch.setattr(run, "STYLING", StyleConfig(steps=2, pattern="large", quality="draft"))
    monkeypatch.setattr("stylesplat.verbs.orbit.FRAMES", 3)


def test_all_of_it_and_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    out = tmp_path / "demo"

    def stop(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(run, "stylize", stop)
        with pytest.raises(KeyboardInterrupt):
            run_demo(out)
    trained = (out / "scene" / "splats.ply").stat().st_mtime_ns
    made = run_demo(out)
    assert (out / "scene" / "splats.ply").stat().st_mtime_ns == trained, "it is not trained twice"
    assert made.keys() == {"report", "splat", "page", "video", "seconds"}
    assert all(made[what].stat().st_size > 0 for what in made.keys() - {"seconds"})
    assert not [*out.glob("*.partial")]
    page = (out / "report.html").read_text()
    assert "painted Gaussians</th>" in page and "of the way" in page
    assert escape(made["page"].read_text()) in page, "the splat to turn"
    with Image.open(out / "after" / "000.png") as picture:
        assert picture.size == (240, 180), "twice the photos' size"
    scene, styled = ss.open(out / "scene"), ss.open(out / "styled")
    assert {*scene.objects} >= {"vase", "teapot"}
    assert styled.painted_objects == ("vase", "teapot")
    assert len(ss.load(out / "capture" / "small")) == 9
    with pytest.raises(StyleSplatError, match="--overwrite"):
        run_demo(out)
