import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

import pytest
import torch
from huggingface_hub import constants
from PIL import Image
from torch import Tensor

from balls import CAMERAS, PLAIN, SPLATS, viewmat_from
from capture_files import corner, write_ball_capture, write_photos
from fake_cuda import cuda  # noqa: F401  (a fixture)
from hub_server import Hub, serve
from right_ids import right_pixels
from stylesplat.cli.mask import MaskCommand
from stylesplat.errors import StyleSplatError
from stylesplat.io import hub
from stylesplat.io.captures.capture_folder import load
from stylesplat.io.scene_folder import save
from stylesplat.masks import from_model as mask_models
from stylesplat.masks.sam import SamMethod
from stylesplat.masks.tracking import labels_to_masks
from stylesplat.scene.scene import Scene
from stylesplat.selection.labels import render_labels
from stylesplat.verbs.mask import mask

TRUTH = [render_labels(SPLATS, CAMERAS[row]) for row in range(len(CAMERAS))]


class Scripted:
    """Knows the balls, recognises photos by their content, and writes down what it is asked."""

    def __init__(self, capture: Path, truth: Sequence[Tensor] = TRUTH) -> None:
        self.truth, self.followed = truth, False
        photos = load(capture, masks=False).photos
        self.rows = {photos[row].numpy().tobytes(): row for row in range(len(photos))}
        self.asked: list[int] = []
        self.stop_after = 10**6

    def row(self, photo: Tensor) -> int:
        return self.rows[photo.numpy().tobytes()]

    def propose(self, photo: Tensor) -> list[Tensor]:
        if len(self.asked) == self.stop_after:
            raise KeyboardInterrupt
        self.asked.append(self.row(photo))
        return [*labels_to_masks(self.truth[self.row(photo)]).values()]

    def propagate(
        self, photos: Sequence[Tensor], seeds: Mapping[int, Tensor]
    ) -> list[dict[int, Tensor]]:
        self.followed = True
        first, *rest = (self.truth[self.row(photo)] for photo in photos)
        meant = {id: int(first[mask].mode().values) for id, mask in seeds.items()}
        return [
            dict(seeds),
            *({id: labels == ball for id, ball in meant.items()} for labels in rest),
        ]


@pytest.fixture
def capture(tmp_path: Path) -> Path:
    return write_ball_capture(tmp_path / "balls", masks=False)


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    save(Scene(PLAIN, CAMERAS), tmp_path / "scene")
    return tmp_path / "scene"


@pytest.fixture
def scripted(capture: Path, monkeypatch: pytest.MonkeyPatch) -> Scripted:
    model = Scripted(capture)
    monkeypatch.setattr(mask_models, "load_proposer", lambda *_: model)
    monkeypatch.setattr(mask_models, "load_propagator", lambda *_: model)
    return model


def run_model(
    capture: Path,
    method: SamMethod,
    scene: Path | None,
    model: str | None = None,
    device: Literal["cpu", "cuda"] = "cpu",
) -> dict:
    """`stylesplat mask CAPTURE --method METHOD`."""
    return MaskCommand(capture, method, model=model, scene=scene, device=device).run().values


def found_maps(capture: Path) -> list[Tensor]:
    maps = load(capture).label_maps
    assert maps is not None
    return [labels for labels in maps if labels is not None]


def test_objects_get_ids_that_all_photos_share(capture: Path, scene: Path, scripted: Scripted):
    found = run_model(capture, "sam2", scene)
    assert found["ids"] == [1, 2, 3] and found["photos"] == 8
    assert right_pixels(found_maps(capture), TRUTH) > 0.9
    assert not (capture / "object_mask.partial").exists()
    with pytest.raises(StyleSplatError, match="--overwrite"):
        run_model(capture, "sam2", scene)


def test_a_model_that_cannot_be_had_is_told_before_photos_are_posed(tmp_path: Path):
    write_photos(tmp_path / "photos", corner(3))
    with pytest.raises(StyleSplatError, match="is no model"):
        run_model(tmp_path / "photos", "sam2", None, model=str(tmp_path / "models"))
    assert [each.name for each in tmp_path.iterdir()] == ["photos"]


def test_a_missing_gpu_is_told_before_a_model_is_downloaded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    write_photos(tmp_path / "photos", corner(3))
    with pytest.raises(StyleSplatError, match="Cannot compute on cuda"):
        run_model(tmp_path / "photos", "sam2", None, model="owner/nowhere", device="cuda")


def test_in_memory_with_and_without_a_folder_for_progress(
    capture: Path, tmp_path: Path, scripted: Scripted
):
    balls, scene = load(capture), Scene(PLAIN, CAMERAS)
    nowhere = replace(balls, path=None)  # photos in memory, no folder for anything
    masked = mask(nowhere, method="sam2", scene=scene, device="cpu")
    assert masked.label_maps is not None and not masked.object_names
    found = [labels for labels in masked.label_maps if labels is not None]
    assert right_pixels(found, TRUTH) > 0.9
    asked, progress = len(scripted.asked), tmp_path / "progress"
    mask(balls, method="sam2", scene=scene, device="cpu", progress=progress)
    assert len(scripted.asked) == 2 * asked
    again = mask(balls, method="sam2", scene=scene, device="cpu", progress=progress)
    assert len(scripted.asked) == 2 * asked, "all was found before"
    assert again.label_maps is not None
    for one, other in zip(masked.label_maps, again.label_maps, strict=True):
        assert one is not None and other is not None and torch.equal(one, other)


def test_on_a_cpu_a_splat_carries_the_masks_of_few_photos(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, said: list[str]
):
    angles = torch.arange(24) * math.tau / 24
    places = [(-3 * math.sin(a), -3 * math.cos(a), 1.5) for a in angles.tolist()]
    orbit = replace(
        CAMERAS,
        viewmats=torch.stack([viewmat_from(place) for place in places]),
        Ks=CAMERAS.Ks[:1].expand(24, 3, 3),
        sizes=CAMERAS.sizes[:1].expand(24, 2),
        names=tuple(f"{row:04d}.jpg" for row in range(24)),
    )
    capture = write_ball_capture(tmp_path / "orbit", orbit, masks=False)
    save(Scene(PLAIN, orbit), tmp_path / "scene")
    truth = [render_labels(SPLATS, orbit[row]) for row in range(24)]
    model = Scripted(capture, truth)
    monkeypatch.setattr(mask_models, "load_proposer", lambda *_: model)
    monkeypatch.setattr(mask_models, "load_propagator", lambda *_: pytest.fail("not needed"))
    run_model(capture, "sam2", tmp_path / "scene")
    assert len(model.asked) == len(set(model.asked)) == 16
    assert "On a CPU sam2 is asked about 16 of 24 photos in about " in said[0]
    maps = found_maps(capture)
    others = [row for row in range(24) if row not in model.asked]
    assert right_pixels([maps[row] for row in others], [truth[row] for row in others]) > 0.8
    assert right_pixels(maps, truth) > 0.9


def test_on_a_gpu_the_model_follows_objects_and_goes_on(
    cuda: Literal["cuda"],  # noqa: F811
    capture: Path,
    scene: Path,
    scripted: Scripted,
):
    scripted.stop_after = 4  # in the second clip: the first asks about three photos
    with pytest.raises(KeyboardInterrupt):
        run_model(capture, "sam2", scene, device=cuda)
    before, scripted.asked, scripted.stop_after = scripted.asked, [], 10**6
    assert run_model(capture, "sam2", scene, device=cuda)["ids"] == [1, 2, 3]
    assert not set(before[:3]) & set(scripted.asked), "the first clip is done"
    assert scripted.followed and right_pixels(found_maps(capture), TRUTH) > 0.9


@pytest.mark.parametrize("changed", ["nothing", "method", "photo"])
def test_an_interrupted_run_goes_on_unless_something_changed(
    changed: str, capture: Path, scene: Path, scripted: Scripted, said: list[str]
):
    scripted.stop_after = 4
    with pytest.raises(KeyboardInterrupt):
        run_model(capture, "sam2", scene)
    assert not (capture / "object_mask").exists()
    before, scripted.asked, scripted.stop_after = scripted.asked, [], 10**6
    if changed == "photo":
        photo = capture / "images" / CAMERAS.names[0]
        Image.eval(Image.open(photo), lambda value: 255 - value).save(photo)
        scripted.rows |= Scripted(capture).rows
    found = run_model(capture, "edgetam" if changed == "method" else "sam2", scene)
    if changed == "nothing":
        assert "Continuing from" in "\n".join(said)
        assert sorted(before + scripted.asked) == [*range(8)], "none is asked about twice"
    else:
        assert "beginning anew" in "\n".join(said)
        assert len(set(scripted.asked)) == len(scripted.asked) and 0 in scripted.asked
    assert found["ids"] == [1, 2, 3]
    assert right_pixels(found_maps(capture), TRUTH) > 0.9


def test_nothing_found(capture: Path, scene: Path, scripted: Scripted, monkeypatch):
    monkeypatch.setattr(scripted, "propose", lambda _: [])
    with pytest.raises(StyleSplatError, match=r"found no object.*--box"):
        run_model(capture, "sam2", scene)
    assert not (capture / "object_mask").exists()


def test_a_model_that_cannot_be_had_is_said_before_any_work(
    capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(mask_models, "working_splat", lambda *_: pytest.fail("trained"))
    with pytest.raises(StyleSplatError, match="none"):
        run_model(capture, "sam2", None, model=str(tmp_path / "none"))
    assert not (capture / "object_mask.partial").exists()


@pytest.fixture
def lenient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Random weights find anything; that it fits together is what is tested."""
    real = mask_models.load_proposer

    def load(*arguments):
        return replace(real(*arguments), min_iou=-1e9, min_stability=0.0, points_per_side=4)

    monkeypatch.setattr(mask_models, "load_proposer", load)


def come_to_the_end(capture: Path, scene: Path, model: Path | str) -> None:
    try:
        found = run_model(capture, "sam2", scene, model=str(model))
    except StyleSplatError as error:
        assert "found no object" in str(error)
    else:
        assert found["photos"] == 8


@pytest.mark.usefixtures("lenient")
def test_a_real_model(capture: Path, scene: Path, tiny_model):
    come_to_the_end(capture, scene, tiny_model("sam2"))


@pytest.mark.usefixtures("lenient")
def test_size_and_licence_are_said_once_before_photos_are_posed(
    scene: Path, tmp_path: Path, tiny_model, monkeypatch: pytest.MonkeyPatch, said: list[str]
):
    def pose(_: Path, output: Path) -> None:
        assert hub.is_at_hand("owner/tiny"), "posing is work that a download must not waste"
        write_ball_capture(output, masks=False)

    write_photos(tmp_path / "photos", corner(3))
    monkeypatch.setattr("stylesplat.verbs.sfm.sfm", pose)
    monkeypatch.setattr(constants, "HF_HUB_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(constants, "HF_HUB_DISABLE_XET", True)
    with serve(Hub("owner/tiny", tiny_model("sam2"), {"license": "mit"}), monkeypatch):
        come_to_the_end(tmp_path / "photos", scene, "owner/tiny")
    announced = [line for line in said if line.startswith("Downloading")]
    assert announced == said[:1] and "licence: mit" in announced[0]
    assert "finding them first" in said[1]
