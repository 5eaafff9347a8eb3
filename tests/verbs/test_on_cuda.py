"""Whatever computes on a GPU, scenes come back to the CPU; on any machine, see `fake_cuda.py`.

`sfm` and `check` have no device to set: pycolmap's wheels compute on the CPU. The stand-in has no
generators, which training needs, and runs none of the models of `mask`: they are transformers' own.
"""

from dataclasses import replace
from pathlib import Path

import pytest

from balls import BARE, GREEN, TRAINED, agreement, around, assert_same_splats, box_around, opened
from balls import PAINTED_FAST as FAST
from capture_files import write_ball_capture
from fake_cuda import cuda  # noqa: F401  (a fixture)
from stylesplat.metrics.iou import mask_iou
from stylesplat.scene.scene import Scene
from stylesplat.selection.members import likeliest
from stylesplat.stylization.style import Style
from stylesplat.verbs.adjust import adjust
from stylesplat.verbs.compare import compare
from stylesplat.verbs.evaluate import evaluate
from stylesplat.verbs.import_ import import_
from stylesplat.verbs.labels import labels
from stylesplat.verbs.load import load
from stylesplat.verbs.mask import mask
from stylesplat.verbs.render import render
from stylesplat.verbs.select import select
from stylesplat.verbs.sheet import sheet
from stylesplat.verbs.stylize_live import stylize_live

pytestmark = pytest.mark.usefixtures("quick_painting")


@pytest.fixture
def styled(stack: Path) -> Scene:
    """Painted on the CPU."""
    return opened(stack / "once")


def test_what_is_painted_upon_is_undone(cuda: str, stack: Path, styled: Scene):  # noqa: F811
    """`stylize` with a GPU is a part of the test of `doctor`."""
    style = Style(stack / "wave.png", config=FAST, quality="draft")
    *_, live = stylize_live(styled, "green", style, device=cuda)
    without = adjust(live.scene(), objects="green", undo=True)
    assert_same_splats(without.splats, styled.splats)
    assert_same_splats(adjust(live.scene(), undo=True).splats, TRAINED.splats)


def test_evaluate_measures_the_same(cuda: str, styled: Scene, tmp_path: Path):  # noqa: F811
    capture = load(write_ball_capture(tmp_path / "capture"))
    found = evaluate(styled, capture, device=cuda)
    expected = evaluate(styled, capture, device="cpu")
    assert found.keys() == expected.keys()
    assert found["psnr"] == pytest.approx(expected["psnr"], abs=0.1)
    assert found["nnfm_after"] == pytest.approx(expected["nnfm_after"], abs=0.01)


def test_renders_and_comparisons_are_the_same(cuda: str, tmp_path: Path):  # noqa: F811
    capture = load(write_ball_capture(tmp_path / "capture"))
    for what in ("color", "label-colors", "depth"):
        found, expected = (render(TRAINED, "test", what=what, device=d) for d in (cuda, "cpu"))
        for (name, image), (other, usual) in zip(found, expected, strict=True):
            close = 0.02 if usual.is_floating_point() else 2
            same = (image.float() - usual.float()).abs() <= close
            assert name == other and same.float().mean() > 0.98
    darker = replace(TRAINED, splats=replace(TRAINED.splats, sh0=TRAINED.splats.sh0 - 0.5))
    scenes, photos = {"a": TRAINED, "b": darker}, {"a": capture, "b": capture}
    found, expected = (compare(scenes, photos, device=device) for device in (cuda, "cpu"))
    for one, other in zip(found.scenes, expected.scenes, strict=True):
        assert one.metrics["psnr"] == pytest.approx(other.metrics["psnr"], abs=0.1)


def test_labels_are_lifted_alike(cuda: str, tmp_path: Path):  # noqa: F811
    capture = load(write_ball_capture(tmp_path / "capture"))
    for verb in (
        labels,
        lambda scene, photos, device: import_(scene.splats, photos, device=device),
    ):
        ids = [likeliest(verb(TRAINED, capture, device=d).splats) for d in (cuda, "cpu")]
        assert (ids[0] == ids[1]).float().mean() > 0.98


def test_masks_of_a_scene(cuda: str):  # noqa: F811
    picked = [
        mask(BARE, boxes={"red": around(3, "view_004")}, device=device).objects["red"].picked
        for device in (cuda, "cpu")
    ]
    assert picked[0].device.type == "cpu" and agreement(picked[0], 3) > 0.8
    assert (picked[0] == picked[1]).float().mean() > 0.98


def test_masks_of_photos(cuda: str, tmp_path: Path):  # noqa: F811
    """On a scene of theirs: the splat that is trained else needs a GPU's generators."""
    capture = load(write_ball_capture(tmp_path / "capture"))
    box = capture.cameras.names[0], box_around(capture.labels(0) == 3, 2)
    bare = replace(capture, label_maps=None, object_names={})
    found, usual = (
        mask(bare, boxes={"red": box}, scene=TRAINED, device=device) for device in (cuda, "cpu")
    )
    for row in range(len(capture)):
        assert (found.labels(row) == usual.labels(row)).float().mean() > 0.98
    assert mask_iou(found.labels(0) == 1, capture.labels(0) == 3) > 0.5
    again = mask(found, drop={"red": box}, scene=TRAINED, device=cuda)
    assert not (again.labels(0) == 1).any()


def test_a_sheet_is_painted(cuda: str, stack: Path):  # noqa: F811
    settings = {"steps": 2, "block": FAST.block, "object_size": 30, "quality": "draft"}
    assert sheet(TRAINED, "red", [stack / "wave.png"], device=cuda, **settings).cells == 1


def test_select_takes_a_mask_of_either_device(cuda: str):  # noqa: F811
    found = select(TRAINED, "it", rows=GREEN.to(cuda)).objects["it"]
    assert found.picked.device.type == "cpu"
    assert found.picked.equal(GREEN)
