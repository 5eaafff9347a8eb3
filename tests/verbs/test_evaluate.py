"""What can be measured of a scene: with photos or without, styled or not, held out or not."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from balls import CAMERAS, TRAINED, painted, write_pictures
from capture_files import write_ball_capture
from stylesplat.errors import StyleSplatError
from stylesplat.io import scene_folder
from stylesplat.io.captures.capture_folder import load
from stylesplat.scene.capture import Capture
from stylesplat.scene.layers import Source
from stylesplat.scene.scene import Scene
from stylesplat.verbs.evaluate import EVALUATION, evaluate

pytestmark = pytest.mark.usefixtures("quick_painting")

PHOTOS = {"psnr", "ssim", "iou", "miou", "boundary_iou", "boundary_miou"}
CHANGES = {"changed_gaussians", "outside_psnr", "outside_max_difference"}
STYLE = {"nnfm_before", "nnfm_after"}


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Capture:
    return load(write_ball_capture(tmp_path_factory.mktemp("capture")))


@pytest.fixture(scope="module")
def picture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_pictures(tmp_path_factory.mktemp("pictures"))[0]


@pytest.fixture(scope="module")
def styled(picture: Path) -> Scene:
    return painted(TRAINED, "red", picture)


def without_held_out(scene: Scene) -> Scene:
    return replace(scene, held_out=())


def assert_as_said(styled: Scene, found: Mapping[str, Any]) -> None:
    """What `stylize` measured is the same within the few pixels that views are cut larger."""
    assert found["schema"] == EVALUATION
    shared = found.keys() & styled.metrics.keys()
    assert {"nnfm_after", "outside_psnr"} <= shared
    for name in shared:
        assert found[name] == pytest.approx(styled.metrics[name], rel=0.03), name


def test_a_trained_scene(capture: Capture):
    found = evaluate(TRAINED, capture, device="cpu")
    assert found.keys() == PHOTOS | {"schema"} and found["psnr"] > 20
    assert capture.path is not None
    small = evaluate(TRAINED, load(capture.path, downscale=2.0), device="cpu")
    assert small.keys() == found.keys() and 15 < small["psnr"] != found["psnr"]


def test_a_trained_scene_without_photos_or_held_out_views(capture: Capture):
    with pytest.raises(StyleSplatError, match="Give the capture of its photos"):
        evaluate(TRAINED, device="cpu")
    with pytest.raises(StyleSplatError, match="no held-out views to evaluate"):
        evaluate(without_held_out(TRAINED), capture, device="cpu")


def test_a_styled_scene(styled: Scene, capture: Capture, tmp_path: Path):
    alone = evaluate(styled, device="cpu")
    assert alone.keys() >= CHANGES | STYLE | {"content_ssim"} and not alone.keys() & PHOTOS
    assert_as_said(styled, alone)
    scene_folder.save(styled, tmp_path / "styled")
    both = evaluate(scene_folder.open(tmp_path / "styled"), capture, device="cpu")
    assert both.keys() == alone.keys() | PHOTOS
    manual = (Path(__file__).parents[2] / "docs" / "manual.md").read_text(encoding="utf-8")
    assert all(f"`{name}`" in manual for name in both), "its schema is in the manual"


def test_a_style_that_is_gone_leaves_the_other_numbers(styled: Scene, said: list[str]):
    (layer,) = styled.layers
    lost = replace(layer, styles=(Source(Path("/lost/wave.png"), "12ab"),))
    scene = replace(styled, layers=(lost,))
    found = evaluate(scene, device="cpu")
    assert not found.keys() & STYLE and found.keys() >= CHANGES | {"content_ssim"}
    (line,) = said
    assert line.startswith("red is not compared with its style: Cannot read /lost/wave.png")


def test_photos_of_another_scene(capture: Capture):
    strange = replace(CAMERAS, names=tuple("abcdefgh"))
    with pytest.raises(StyleSplatError, match="No view is called"):
        evaluate(replace(TRAINED, cameras=strange, held_out=("a",)), capture, device="cpu")
    with pytest.raises(StyleSplatError, match="None of the 1 held-out photos is in"):
        evaluate(TRAINED, capture.only(range(1, 8)), device="cpu")
