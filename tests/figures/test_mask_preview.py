from dataclasses import replace

import pytest
import torch

from balls import CAMERAS, SPLATS
from stylesplat.figures.grid import MARGIN, PAPER
from stylesplat.figures.pictures import label_colors
from stylesplat.figures.sheets import PHOTO_COLUMNS, PHOTO_HEIGHT, PHOTO_WIDTH, TINT, mask_preview
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture
from stylesplat.selection.identities import render_labels

GREY = 100


def capture(cameras: Cameras = CAMERAS, *, without: tuple[int, ...] = ()) -> Capture:
    """Grey photos; some have no label map."""
    rows = range(len(cameras))
    width, height = CAMERAS.size
    maps = [None if row in without else render_labels(SPLATS, cameras[row]) for row in rows]
    photos = [torch.full((height, width, 3), GREY, dtype=torch.uint8) for _ in rows]
    return Capture(cameras=cameras, photos=photos, label_maps=maps)


def cell(page: torch.Tensor, number: int) -> torch.Tensor:
    width, height = CAMERAS.size
    line, column = divmod(number, PHOTO_COLUMNS)
    top, left = MARGIN + line * (height + MARGIN), MARGIN + column * (width + MARGIN)
    return page[top : top + height, left : left + width]


def test_objects_are_tinted_and_the_rest_stays_as_it_is():
    page, labels = mask_preview(capture(), {}), render_labels(SPLATS, CAMERAS[5])
    shown = cell(page, 5).float()
    expected = TINT * label_colors(labels).float() + (1 - TINT) * GREY
    expected[labels == 0] = GREY
    assert (shown - expected).abs().max() <= 0.5, "rounding"


def test_the_legend_calls_objects_by_name_or_id():
    plain = mask_preview(capture(), {})
    named = mask_preview(capture(), {3: "vase", 999: "shows nowhere"})
    legend = slice(MARGIN + 2 * (CAMERAS.size[1] + MARGIN), None)
    assert torch.equal(plain[: legend.start], named[: legend.start])
    assert not torch.equal(plain[legend], named[legend])
    for id in (3, 7, 300):
        color = label_colors(torch.tensor([[id]]))[0, 0]
        assert (named[legend] == color).all(dim=-1).any()
    gone = label_colors(torch.tensor([[999]]))[0, 0]
    assert not (named[legend] == gone).all(dim=-1).any()


def test_many_names_take_many_lines():
    few = mask_preview(capture(), {3: "a", 7: "b", 300: "c"})
    many = mask_preview(capture(), {3: "a" * 40, 7: "b" * 40, 300: "c" * 40})
    assert many.shape[1] == few.shape[1] and many.shape[0] > few.shape[0]


@pytest.mark.parametrize("name", ["two\nlines", "\n", " ", "вазa 花瓶"])  # noqa: RUF001
def test_names_of_any_kind(name: str):
    assert mask_preview(capture(), {3: name}).shape[1] == mask_preview(capture(), {}).shape[1]


def test_photos_without_a_label_map_are_left_out():
    page = mask_preview(capture(without=(0, 1, 2, 4, 5, 6, 7)), {})
    width, _ = CAMERAS.size
    assert page.shape[1] == width + 2 * MARGIN, "one cell"
    labels = render_labels(SPLATS, CAMERAS[3])
    assert (cell(page, 0)[labels == 0] == GREY).all()


def test_eight_photos_at_most_from_the_first_to_the_last():
    rows = [row for row in range(8) for _ in range(3)]
    many = CAMERAS[rows]
    many = replace(many, names=tuple(f"{row}.jpg" for row in range(24)))
    assert mask_preview(capture(many), {}).shape == mask_preview(capture(), {}).shape


def test_large_photos_are_made_smaller_and_keep_their_shape():
    Ks = CAMERAS.Ks[:1].clone()
    Ks[:, :2] *= 20
    sizes = 20 * CAMERAS.sizes[:1]
    camera = Cameras(CAMERAS.viewmats[:1], Ks, sizes, ("a.jpg",))
    width, height = camera.size
    photo = torch.full((height, width, 3), GREY, dtype=torch.uint8)
    labels = torch.full((height, width), 7)
    page = mask_preview(Capture(cameras=camera, photos=[photo], label_maps=[labels]), {})
    assert width > PHOTO_WIDTH and height > PHOTO_HEIGHT
    assert page.shape[1] == 400 + 2 * MARGIN
    assert (page[0, 0] == torch.tensor(PAPER)).all()
