"""`labels`: corrected label maps onto a scene that was made with others."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from balls import CAMERAS, SPLATS, agreement
from capture_files import write_ball_capture
from stylesplat.errors import StyleSplatError
from stylesplat.io.label_maps import write_label_map, write_names
from stylesplat.scene.scene import Scene
from stylesplat.selection.labels import render_labels
from stylesplat.verbs.mask import labels
from stylesplat.verbs.select import select

SCENE = select(
    select(Scene(SPLATS, CAMERAS, held_out=CAMERAS.names[:1]), "red", id=3),
    "ball",
    sphere=(0.0, 0.8, 0.3, 0.4),
)
CORRECTED = {3: 7, 7: 3, 300: 0}  # each is in the other's place, and the third is no object


def write_corrected(folder: Path) -> Path:
    for row, name in enumerate(CAMERAS.names):
        drawn = render_labels(SPLATS, CAMERAS[row])
        found = drawn.clone()
        for id, other in CORRECTED.items():
            found[drawn == id] = other
        write_label_map(found, folder / Path(name).with_suffix(".png"))
    write_names({7: "green"}, folder)
    return folder


@pytest.mark.parametrize("photos", [False, True])
def test_names_follow_their_labels(tmp_path: Path, photos: bool):
    scene, folder = SCENE, tmp_path / "corrected"
    if photos:
        capture = write_ball_capture(tmp_path / "capture", masks=False)
        scene = replace(SCENE, capture=capture)
        folder = capture / "object_mask"
    write_corrected(folder)
    found = labels(scene, None if photos else folder, device="cpu")
    assert agreement(found.objects["red"].mask, 7) > 0.75
    assert agreement(found.objects["green"].mask, 3) > 0.75
    assert found.objects["ball"] is SCENE.objects["ball"], "a shape has no label"
    for name in ("means", "sh0", "opacities"):
        assert torch.equal(getattr(found.splats, name), getattr(SPLATS, name))
    assert found.splats.classifier is not None and found.splats.classifier.ids == (0, 3, 7)


def test_an_object_keeps_its_parts_out(tmp_path: Path):
    place = tuple(SPLATS.means[SCENE.objects["red"].mask][0].tolist())
    scene = select(SCENE, "part", sphere=(*place, 0.1), of="red")
    found = labels(scene, write_corrected(tmp_path), device="cpu")
    part = scene.objects["part"].mask
    assert part.any() and torch.equal(found.objects["part"].mask, part)
    assert agreement(found.objects["red"].mask, 7) > 0.75
    assert not (found.objects["red"].mask & part).any()


@pytest.mark.parametrize(
    ("pixel", "name", "message"),
    [
        (0, "0001.png", "nothing but background"),
        (5, "0001.png", "one object in every pixel"),
        (5, "lost.png", "No mask in .* belongs to a photo"),
    ],
)
def test_label_maps_that_say_nothing(tmp_path: Path, pixel: int, name: str, message: str):
    write_label_map(torch.full((36, 48), pixel), tmp_path / name)
    with pytest.raises(StyleSplatError, match=message):
        labels(SCENE, tmp_path, device="cpu")
    with pytest.raises(StyleSplatError, match="Say --masks"):
        labels(SCENE, device="cpu")
