"""The verbs that show a scene: `render`, `orbit` and `sheet`."""

import pytest
import torch

from balls import BARE, CAMERAS, PAINTED_FAST, TRAINED
from stylesplat.errors import StyleSplatError
from stylesplat.verbs.render import orbit, render
from stylesplat.verbs.sheet import sheet


def test_views_are_chosen_by_set_by_name_or_as_cameras():
    test, all_views = render(TRAINED, "test", device="cpu"), render(TRAINED, device="cpu")
    assert test.names == TRAINED.held_out and len(all_views) == len(CAMERAS)
    assert repr(test) == "Views(1 picture, 0000.jpg)"
    (name, picture), *_ = all_views
    assert name == test.names[0] and torch.equal(picture, next(test.pictures))
    named = render(TRAINED, ["0002", "0001.jpg"], downscale=2.0, device="cpu")
    assert named.names == ("0002.jpg", "0001.jpg")
    assert next(named.pictures).shape == (18, 24, 3)
    cameras = render(TRAINED, CAMERAS[3], what="object:red", background="white", device="cpu")
    assert (next(cameras.pictures)[0, 0] == 255).all()
    with pytest.raises(StyleSplatError, match="No view is called 'lost'"):
        render(TRAINED, ["lost"])


def test_round_trips_with_photos_and_without():
    path = orbit(TRAINED, around="red", frames=6, size=(64, 32))
    assert path.size == (64, 32) and len(path) == len({*path.names}) == 6
    assert render(TRAINED, "orbit", frames=3, device="cpu").names == orbit(TRAINED, frames=3).names
    assert orbit(BARE, frames=4).size == BARE.cameras.size
    assert orbit(BARE, frames=4, size=(50, 50)).size == (50, 50)


def test_a_sheet_blends_cells_that_differ_in_intensity_only(quick_painting: None):
    wave = torch.rand(48, 64, 3, generator=torch.Generator().manual_seed(0))
    settings = {"steps": 2, "block": PAINTED_FAST.block, "object_size": 30, "quality": "draft"}
    found = sheet(TRAINED, "red", [wave], vary={"intensity": (0.5, 1.0)}, device="cpu", **settings)
    assert (found.cells, found.repainted) == (2, 1) and found.view in CAMERAS.names
    assert repr(found).startswith("StyleSheet(2 cells, ")
