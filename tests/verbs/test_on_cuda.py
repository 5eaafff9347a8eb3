"""Whatever computes on a GPU, scenes come back to the CPU; on any machine, see `fake_cuda.py`.

`train` and `stylize` are tested in `test_doctor.py` and the rooms' `test_on_device.py`; `studio`
paints by `stylize_live`. `sfm` and `check` have no device to set, as pycolmap's wheels compute on
the CPU.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import pytest
import torch
from torch import Tensor

from balls import (
    BARE,
    CAMERAS,
    GREEN,
    RED,
    TRAINED,
    agreement,
    around,
    assert_same_splats,
    box_around,
    class_probabilities,
    opened,
    save_scene,
)
from balls import PAINTED_FAST as FAST
from capture_files import write_ball_capture
from fake_cuda import cuda  # noqa: F401  (a fixture)
from right_ids import right_pixels
from stylesplat.cli.mask import LabelsCommand
from stylesplat.errors import StyleSplatError
from stylesplat.figures.sheets import before_after, beside_photo, one_view
from stylesplat.imaging.similarity import mask_iou
from stylesplat.io.captures.capture_folder import load
from stylesplat.masks import from_model
from stylesplat.masks import working_splat as quick_splat
from stylesplat.masks.sam import FAMILIES, SamMethod, load_propagator, load_proposer
from stylesplat.masks.tracking import labels_to_masks
from stylesplat.scene.capture import Capture
from stylesplat.scene.scene import Scene
from stylesplat.selection.text import load_detector
from stylesplat.stylization.style import Style
from stylesplat.training.config import TrainConfig
from stylesplat.training.state import State
from stylesplat.verbs.adjust import adjust
from stylesplat.verbs.evaluate import compare, evaluate
from stylesplat.verbs.import_ import import_
from stylesplat.verbs.mask import labels, mask
from stylesplat.verbs.render import render
from stylesplat.verbs.select import select
from stylesplat.verbs.sheet import sheet
from stylesplat.verbs.stylize import stylize_live

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
    assert_same_splats(live.splats.to("cpu"), live.scene().splats)


def test_evaluate_measures_the_same(cuda: str, styled: Scene, tmp_path: Path):  # noqa: F811
    capture = load(write_ball_capture(tmp_path / "capture"))
    found = evaluate(styled, capture, device=cuda)
    expected = evaluate(styled, capture, device="cpu")
    assert found.keys() == expected.keys()
    assert found["psnr"] == pytest.approx(expected["psnr"], abs=0.1)
    assert found["nnfm_after"] == pytest.approx(expected["nnfm_after"], abs=0.01)


def test_renders_and_comparisons_are_the_same(cuda: str, tmp_path: Path):  # noqa: F811
    capture = load(write_ball_capture(tmp_path / "capture"))
    # Principal components that are as long as each other have any direction
    assert TRAINED.splats.identities is not None
    uneven = TRAINED.splats.identities * torch.linspace(1, 3, 16)
    scene = replace(TRAINED, base=replace(TRAINED.splats, identities=uneven))
    for what in ("color", "label-colors", "identities", "depth", "object:red"):
        shown = scene if what == "identities" else TRAINED
        found, expected = (render(shown, "test", what=what, device=d) for d in (cuda, "cpu"))
        for (name, image), (other, usual) in zip(found, expected, strict=True):
            close = 0.02 if usual.is_floating_point() else 2
            same = (image.float() - usual.float()).abs() <= close
            assert name == other and same.float().mean() > 0.98
    darker = replace(TRAINED, base=replace(TRAINED.splats, sh0=TRAINED.splats.sh0 - 0.5))
    scenes, photos = {"a": TRAINED, "b": darker}, {"a": capture, "b": capture}
    found, expected = (compare(scenes, photos, device=device) for device in (cuda, "cpu"))
    for one, other in zip(found.scenes, expected.scenes, strict=True):
        assert one.metrics["psnr"] == pytest.approx(other.metrics["psnr"], abs=0.1)


def test_pictures_of_commands_are_the_same(cuda: str, styled: Scene, tmp_path: Path):  # noqa: F811
    """A command whose picture fails says so, and goes on."""
    capture = load(write_ball_capture(tmp_path / "capture"))
    view = CAMERAS.names[0]
    for draw in (
        lambda device: before_after(styled, device=device),
        lambda device: (view, beside_photo(styled, capture, view, device=device)),
        lambda device: (view, one_view(styled, view, device=device)),
    ):
        found, usual = (draw(device) for device in (cuda, "cpu"))
        assert found is not None and usual is not None and found[0] == usual[0]
        assert found[1].shape == usual[1].shape
        assert ((found[1].float() - usual[1].float()).abs() <= 2).float().mean() > 0.98
    scene = save_scene(tmp_path / "scene")
    masks = tmp_path / "capture" / "object_mask"
    assert Path(LabelsCommand(scene, masks=masks, device="cuda").run().values["preview"]).exists()


def test_labels_are_lifted_alike(cuda: str, tmp_path: Path):  # noqa: F811
    capture = load(write_ball_capture(tmp_path / "capture"))
    for verb in (
        labels,
        lambda scene, photos, device: import_(scene.splats, photos, device=device),
    ):
        found = [verb(TRAINED, capture, device=d).splats for d in (cuda, "cpu")]
        one, other = (class_probabilities(splats).argmax(dim=1) for splats in found)
        assert (one == other).float().mean() > 0.98


def test_masks_of_a_scene(cuda: str):  # noqa: F811
    picked = [
        mask(BARE, boxes={"red": around(3, "view_004")}, device=device).objects["red"].mask
        for device in (cuda, "cpu")
    ]
    assert picked[0].device.type == "cpu" and agreement(picked[0], 3) > 0.8
    assert (picked[0] == picked[1]).float().mean() > 0.98


def test_masks_of_photos(cuda: str, tmp_path: Path):  # noqa: F811
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


class Oracle:
    """Knows the masks of photos."""

    def __init__(self, photos: Sequence[Tensor], maps: Sequence[Tensor]) -> None:
        self.photos, self.maps = photos, maps

    def propose(self, photo: Tensor) -> list[Tensor]:
        row = next(row for row, known in enumerate(self.photos) if known.equal(photo))
        return [*labels_to_masks(self.maps[row]).values()]


def maps_of(capture: Capture) -> list[Tensor]:
    found = [capture.labels(row) for row in range(len(capture))]
    return [labels for labels in found if labels is not None]


def noise(*size: int) -> Tensor:
    generator = torch.Generator().manual_seed(0)
    return torch.randint(256, size, generator=generator).to(torch.uint8)


def test_masks_are_propagated_by_a_splat(
    cuda: str,  # noqa: F811
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
):
    capture = load(write_ball_capture(tmp_path / "capture"))
    oracle = Oracle(capture.photos, maps_of(capture))
    monkeypatch.setattr(from_model, "load_proposer", lambda *_: oracle)
    found = mask(capture, method="sam", scene=TRAINED, device=cuda)
    assert right_pixels(maps_of(found), oracle.maps) > 0.8


def test_masks_of_a_model_on_a_splat_of_its_own(
    cuda: str,  # noqa: F811
    tiny_model: Callable[[str], Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
):
    """Random weights find nothing that photos confirm."""
    capture = load(write_ball_capture(tmp_path / "capture")).only(range(4))
    proposer, fit, trained = from_model.load_proposer, quick_splat.fit, list[str]()

    def lenient(*arguments: Any) -> Any:
        return replace(proposer(*arguments), min_iou=-1e9, min_stability=0.0, points_per_side=3)

    def short(capture: Capture, config: TrainConfig, *, device: torch.device) -> State:
        trained.append(device.type)
        return fit(capture, replace(config, steps=8, max_gaussians=500), device=device)

    monkeypatch.setattr(from_model, "load_proposer", lenient)
    monkeypatch.setattr(quick_splat, "fit", short)
    with pytest.raises(StyleSplatError, match="no object that several photos confirm"):
        mask(capture, method="sam2", model=str(tiny_model("sam2")), device=cuda)
    assert trained == ["cuda"]


@pytest.mark.parametrize("method", get_args(SamMethod))
def test_models_of_masks(cuda: str, method: SamMethod, tiny_model: Callable[[str], Path]):  # noqa: F811
    """In bfloat16 on both devices."""
    photos = [
        *torch.randint(256, (3, 40, 56, 3), generator=torch.Generator().manual_seed(0)).to(
            torch.uint8
        )
    ]
    loose = {"min_iou": -1e9, "min_stability": 0.0, "max_overlap": 1.0, "points_per_side": 3}
    proposer, usual = (
        replace(load_proposer(method, str(tiny_model(method)), device), **loose)
        for device in (cuda, "cpu")
    )
    usual.model.to(proposer.model.dtype)
    found, expected = (each.propose(photos[0]) for each in (proposer, usual))
    assert proposer.model.device.type == "cuda" and found[0].device.type == "cpu"
    assert len(found) == pytest.approx(len(expected), abs=2) and len(found) > 9
    if FAMILIES[method].video_types:
        propagator = load_propagator(method, str(tiny_model(method)), cuda)
        head = propagator.model.mask_decoder.pred_obj_score_head.proj_out  # how sure, as a logit
        head.weight.zero_()
        head.bias.fill_(5.0)
        seed = torch.zeros(40, 56, dtype=torch.bool)
        seed[5:20, 5:20] = True
        followed = propagator.propagate(photos, {3: seed})
        masks = [each for some in followed for each in some.values()]
        assert len(followed) == 3 and len(masks) > 1
        assert all(each.device.type == "cpu" and each.shape == seed.shape for each in masks)


@pytest.mark.parametrize("kind", ["grounding-dino", "sam3"])
def test_phrases(cuda: str, kind: str, tiny_model: Callable[[str], Path]):  # noqa: F811
    model, picture, devices = str(tiny_model(kind)), noise(48, 64, 3), (cuda, "cpu")
    found, expected = (
        replace(load_detector(model, device), min_score=0.0).detect(picture, "red")
        for device in devices
    )
    torch.testing.assert_close(found.boxes, expected.boxes, atol=0.1, rtol=0)
    torch.testing.assert_close(found.scores, expected.scores, atol=1e-2, rtol=0)
    # The view in which Grounding DINO's boxes, which are always the same, fit an object
    few = replace(TRAINED, cameras=CAMERAS[[5]], held_out=())

    def meant(device: str) -> Tensor | str:
        try:
            return select(few, "it", text="red", model=model, device=device).objects["it"].mask
        except StyleSplatError as error:
            return str(error)

    found, expected = map(meant, devices)
    if isinstance(expected, str):
        assert kind == "sam3" and "No object of the scene fits" in expected == found
    else:
        assert isinstance(found, Tensor) and found.equal(expected) and found.equal(RED)


def test_a_sheet_is_painted(cuda: str, stack: Path):  # noqa: F811
    settings = {"steps": 2, "block": FAST.block, "object_size": 30, "quality": "draft"}
    few = replace(TRAINED, cameras=CAMERAS[::4])
    assert sheet(few, "red", [stack / "wave.png"], device=cuda, **settings).cells == 1


def test_select_takes_a_mask_of_either_device(cuda: str):  # noqa: F811
    found = select(TRAINED, "it", rows=GREEN.to(cuda)).objects["it"]
    assert found.mask.device.type == "cpu"
    assert found.mask.equal(GREEN)
