"""`mask` of a scene that came without photos: its views are the photos."""

from pathlib import Path

import pytest
import torch

from balls import BALLS, BARE, CAMERAS, PLAIN, SPLATS, VIEWS, agreement, around
from stylesplat.errors import StyleSplatError
from stylesplat.io.label_maps import write_label_map
from stylesplat.scene.scene import Scene
from stylesplat.selection.labels import object_ids, pick, render_labels
from stylesplat.verbs.mask import mask
from stylesplat.verbs.objects import extents, objects
from stylesplat.verbs.select import select


@pytest.fixture(scope="module")
def masked() -> Scene:
    """With one ball, from a box in one view, named without its suffix."""
    return mask(BARE, boxes={"red": around(3, "view_004")}, device="cpu")


def test_one_box_in_one_view_names_an_object(masked: Scene):
    assert [*masked.objects] == ["red"]
    assert agreement(masked.objects["red"].mask, 3) > 0.8
    assert torch.equal(masked.splats.means, PLAIN.means) and BARE.splats.classifier is None
    (listed,) = objects(masked)
    assert listed["names"] == ["red"] and 0.5 < listed["confidence"] <= 1
    y, x = (render_labels(SPLATS, VIEWS[9]) == 3).nonzero().double().mean(dim=0).tolist()
    again = select(masked, "same", point=("view_009", x, y))
    assert torch.equal(again.objects["same"].mask, masked.objects["red"].mask)


def test_a_second_object_joins_the_first(masked: Scene):
    both = mask(masked, boxes={"green": around(7, "view_020")}, device="cpu")
    assert [*both.objects] == ["red", "green"]
    assert [each["names"] for each in objects(both)] == [["red"], ["green"]]
    assert agreement(both.objects["green"].mask, 7) > 0.8
    assert agreement(pick(both.splats, object_id=1), 3) > 0.8, "by its label as well"
    assert object_ids(both.splats) == (1, 2)


def test_masks_drawn_on_renders_replace_all_labels(masked: Scene, tmp_path: Path):
    for row, name in enumerate(VIEWS.names):
        write_label_map(render_labels(SPLATS, VIEWS[row]), tmp_path / name)
    scene = select(masked, "part", box3d=(-2.0, -2.0, -2.0, 0.0, 2.0, 2.0))
    drawn = mask(scene, source=tmp_path, device="cpu")
    assert object_ids(drawn.splats) == tuple(BALLS)
    assert [*drawn.objects] == ["part"], "what was chosen by label is forgotten"
    for id in BALLS:
        found = pick(drawn.splats, object_id=id)
        assert agreement(found, id) > 0.75, "all but where it stands, which no view shows"


def test_scenes_of_photos_are_refused():
    with pytest.raises(StyleSplatError, match=r"made from photos\. Mask those"):
        mask(Scene(PLAIN, CAMERAS), boxes={"red": ("0001.jpg", (1, 1, 9, 9))})
    with pytest.raises(StyleSplatError, match="`scene` means nothing for a scene"):
        mask(BARE, boxes={"red": ("view_004", (1, 1, 9, 9))}, scene=BARE)


def test_extents_of_what_is_there():
    named = select(BARE, "left", box3d=(-2.0, -2.0, 0.01, -0.3, 2.0, 2.0))
    found = extents(named)
    low, high = found["named"]["left"]["box"][:3], found["named"]["left"]["box"][3:]
    assert low == pytest.approx([-1.0, -0.3, 0.0], abs=0.12)
    assert high == pytest.approx([-0.4, 0.3, 0.6], abs=0.12)
    flat = extents(Scene(PLAIN[:200], VIEWS))["content"]
    assert flat["size"] == pytest.approx([2.4, 2.4, 0.0], abs=0.2)
