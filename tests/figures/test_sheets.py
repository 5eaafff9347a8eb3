"""The sheets that commands draw: objects, selections, label maps, before and after, photos."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from balls import CAMERAS, CLASSIFIER, SPLATS, TRAINED, enlarged, painted, write_pictures
from capture_files import write_ball_capture
from stylesplat.errors import StyleSplatError
from stylesplat.figures.best_views import close_up
from stylesplat.figures.grid import CAPTION, CARD, GRID_CELL, GRID_MARGIN
from stylesplat.figures.pictures import label_colors
from stylesplat.figures.sheets import (
    BELOW,
    OUTLINE_COLOR,
    OUTLINE_WIDTH,
    PREVIEW_COLUMNS,
    RIM,
    SHEET_PANEL,
    TINT,
    before_after,
    beside_photo,
    draw_contact_contours,
    mask_preview,
    object_sheet,
    one_view,
    selection_picture,
)
from stylesplat.io.captures.capture_folder import load
from stylesplat.rendering.render import rasterize
from stylesplat.rendering.weights import coverage
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture
from stylesplat.scene.scene import Scene
from stylesplat.scene.splats import Classifier
from stylesplat.selection.labels import pick, render_labels
from stylesplat.training.object_alone import OBJECTS_ALONE

RED, GREEN, BLUE = (pick(SPLATS, object_id=id, remove_outliers=False) for id in (3, 7, 300))
HEIGHT = SHEET_PANEL * 36 // 48  # of a view of a selection
GREY = 100


def part(sheet: torch.Tensor, left: int, top: int, width: int, height: int) -> torch.Tensor:
    return sheet[top : top + height, left : left + width].float()


def portrait(sheet: torch.Tensor, column: int) -> torch.Tensor:
    return part(
        sheet, GRID_MARGIN + column * (GRID_CELL + GRID_MARGIN), GRID_MARGIN, GRID_CELL, GRID_CELL
    )


def test_each_object_fills_its_picture_alone():
    sheet = object_sheet(SPLATS, CAMERAS)
    for column, channel in enumerate((0, 1, 2)):  # the red, green and blue ball
        cell = portrait(sheet, column)
        shown = (cell - torch.tensor(CARD)).abs().sum(dim=-1) > 60
        assert 0.4 < shown.float().mean() < 0.9  # a disc in its square covers 0.79
        assert cell[shown].mean(dim=0).argmax() == channel
        assert torch.equal(cell[0, 0], torch.tensor(CARD).float())


def test_no_close_up_of_what_does_not_show():
    nothing = torch.zeros(len(SPLATS), dtype=torch.bool)
    nothing[0] = True
    splats = replace(SPLATS, opacities=SPLATS.opacities.index_fill(0, torch.tensor([0]), -9.0))
    with pytest.raises(StyleSplatError, match=r"does not show in any of 8 views"):
        close_up(splats, CAMERAS, nothing)
    with pytest.raises(StyleSplatError, match=r"does not show in 0003\.jpg"):
        close_up(splats, CAMERAS[3], nothing)


def test_objects_without_gaussians_or_no_objects():
    weight = torch.cat([CLASSIFIER.weight, torch.zeros(1, 16)])
    bias = torch.cat([CLASSIFIER.bias, torch.tensor([-50.0])])
    more = Classifier(weight, bias, ids=(*CLASSIFIER.ids, 999))
    sheet = object_sheet(replace(SPLATS, classifier=more), CAMERAS)
    assert (portrait(sheet, 3) == torch.tensor(CARD)).all()
    alone = Classifier(CLASSIFIER.weight[:1], CLASSIFIER.bias[:1], ids=(0,))
    with pytest.raises(StyleSplatError, match="no objects"):
        object_sheet(replace(SPLATS, classifier=alone), CAMERAS)


def drawn(picked: torch.Tensor, cameras: Cameras = CAMERAS) -> torch.Tensor:
    picture = selection_picture(SPLATS, cameras, picked)
    assert picture is not None
    return picture


def panel(picture: torch.Tensor, number: int) -> torch.Tensor:
    return part(
        picture,
        GRID_MARGIN + number * (SHEET_PANEL + GRID_MARGIN),
        GRID_MARGIN,
        SHEET_PANEL,
        HEIGHT,
    )


def colored(panel: torch.Tensor, color: tuple[int, ...]) -> torch.Tensor:
    return (panel - torch.tensor(color)).abs().amax(dim=-1) < 40


def test_a_selection_has_its_colour_and_an_outline_and_all_else_is_grey():
    picture = drawn(BLUE)
    assert picture.shape == (
        2 * GRID_MARGIN + HEIGHT + CAPTION,
        GRID_MARGIN + 3 * (SHEET_PANEL + GRID_MARGIN),
        3,
    )
    for number in range(3):
        view = panel(picture, number)
        outline = colored(view, OUTLINE_COLOR)
        spread = view.amax(dim=-1) - view.amin(dim=-1)
        vivid = (spread > 90) & ~outline
        assert vivid.sum() > 400 and outline.sum() > 100
        assert (view[vivid].argmax(dim=-1) == 2).float().mean() > 0.9
        assert 0.3 < (spread < 20).float().mean() < 0.98
        line, ball = outline.nonzero(), vivid.nonzero()
        gaps = torch.cat([ball.amin(dim=0) - line.amin(dim=0), line.amax(dim=0) - ball.amax(dim=0)])
        assert -OUTLINE_WIDTH <= gaps.min() and gaps.max() < 20, "a tenth of its width: it fades"


def test_blue_is_what_takes_no_paint():
    """A few Gaussians of another ball, which they do not cover."""
    few = RED.clone()
    few[GREEN.nonzero()[:8, 0]] = True
    where = (drawn(few).float() - drawn(RED).float())[..., 2] > 20
    assert where.sum() > 20
    red, green, blue = drawn(few)[where].float().mean(dim=0)
    assert blue > 1.3 * max(red, green)


def masked(cameras: Cameras = CAMERAS, *, without: tuple[int, ...] = ()) -> Capture:
    """Grey photos; some have no label map."""
    rows = range(len(cameras))
    width, height = CAMERAS.size
    maps = [None if row in without else render_labels(SPLATS, cameras[row]) for row in rows]
    photos = [torch.full((height, width, 3), GREY, dtype=torch.uint8) for _ in rows]
    return Capture(cameras=cameras, photos=photos, label_maps=maps)


def photo(page: torch.Tensor, number: int) -> torch.Tensor:
    width, height = CAMERAS.size
    line, column = divmod(number, PREVIEW_COLUMNS)
    left, top = (
        GRID_MARGIN + column * (width + GRID_MARGIN),
        GRID_MARGIN + line * (height + GRID_MARGIN),
    )
    return part(page, left, top, width, height)


def test_masked_objects_are_tinted_and_the_rest_stays_as_it_is():
    labels = render_labels(SPLATS, CAMERAS[5])
    expected = TINT * label_colors(labels).float() + (1 - TINT) * GREY
    expected[labels == 0] = GREY
    assert (photo(mask_preview(masked(), {}), 5) - expected).abs().max() <= 0.5, "rounding"
    page = mask_preview(masked(without=(0, 1, 2, 4, 5, 6, 7)), {})
    assert page.shape[1] == CAMERAS.size[0] + 2 * GRID_MARGIN, "one cell"


def test_the_lower_rims_are_of_views_that_differ_and_of_places_where_objects_end():
    capture = masked(enlarged(CAMERAS, 2), without=(0,))
    capture = replace(capture, photos=[torch.full((72, 96, 3), GREY, dtype=torch.uint8)] * 8)
    page = draw_contact_contours(capture, {3: "red", 7: "green"}).float()
    assert page.shape[1] == 3 * RIM + 4 * GRID_MARGIN
    outlined = (page - torch.tensor([*OUTLINE_COLOR])).abs().amax(dim=-1) == 0
    for row in range(2):
        for column in range(3):
            left, top = (
                GRID_MARGIN + column * (RIM + GRID_MARGIN),
                GRID_MARGIN + row * (RIM + GRID_MARGIN + CAPTION),
            )
            lines, columns = outlined[top : top + RIM, left : left + RIM].nonzero().T
            lowest = float(lines.max())
            assert abs(lowest - (1 - BELOW) * RIM) < RIM / 10, "what lies below shows, too"
            assert columns.min() < RIM / 10 and columns.max() > 0.9 * RIM, "all of its width"


@pytest.mark.parametrize("name", ["two\nlines", "вazа 花瓶" * 9])  # noqa: RUF001
def test_the_legend_calls_objects_by_name_or_id(name: str):
    plain = mask_preview(masked(), {})
    named = mask_preview(masked(), {3: name, 999: "shows nowhere"})
    legend = slice(GRID_MARGIN + 2 * (CAMERAS.size[1] + GRID_MARGIN), None)
    assert torch.equal(plain[: legend.start], named[: legend.start])
    assert plain.shape[1] == named.shape[1] and plain.shape[0] <= named.shape[0]
    for id, is_shown in ((3, True), (7, True), (300, True), (999, False)):
        color = label_colors(torch.tensor([[id]]))[0, 0]
        assert (named[legend] == color).all(dim=-1).any() == is_shown


def pair(picture: torch.Tensor, width: int, height: int) -> list[torch.Tensor]:
    """The two pictures of a row."""
    return [
        part(picture, left, GRID_MARGIN, width, height)
        for left in (GRID_MARGIN, 2 * GRID_MARGIN + width)
    ]


def test_before_and_after_at_the_photos_size(tmp_path: Path, quick_painting: None):
    pictures = write_pictures(tmp_path)
    scene = replace(TRAINED, cameras=enlarged(CAMERAS, 2))
    styled = painted(scene, "red", pictures, measured=False, intensity=1.0, block=2)
    found = before_after(styled, device="cpu")
    assert found is not None and found[0] in styled.cameras.names
    assert found[1].shape == (72 + CAPTION + 2 * GRID_MARGIN, 2 * 96 + 3 * GRID_MARGIN, 3)
    before, after = pair(found[1], 96, 72)
    changed = (before - after).abs().amax(dim=-1) > 0
    assert 20 < int(changed.sum()) < 0.3 * changed.numel(), "the ball, and nothing else"
    assert before[changed][:, 0].mean() > 100 > before[changed][:, 2].mean(), "it was red before"
    away = replace(styled.cameras, viewmats=styled.cameras.viewmats + 0)
    away.viewmats[:, 2, 3] -= 100
    assert before_after(replace(styled, cameras=away), device="cpu") is None


def test_a_photo_beside_its_render(tmp_path: Path):
    """At the photo's own size, though the scene was made from a smaller one, and captioned."""
    views = enlarged(CAMERAS[[2, 5]], 12)
    capture = load(write_ball_capture(tmp_path / "balls", views, masks=False), downscale=6.0)
    scene: Scene = replace(TRAINED, cameras=views, held_out=CAMERAS.names[2:3])
    picture = beside_photo(scene, capture, CAMERAS.names[2], device="cpu")
    wide, high = 12 * 48, 12 * 36
    assert picture.shape == (high + CAPTION + 2 * GRID_MARGIN, 2 * wide + 3 * GRID_MARGIN, 3)
    photo, render = pair(picture, wide, high)
    assert (photo - render).abs().mean() < 12, "they show the same"
    other = one_view(scene, CAMERAS.names[5], device="cpu").float()
    assert (photo - other).abs().mean() > 20
    trained = beside_photo(replace(scene, held_out=()), capture, CAMERAS.names[2], device="cpu")
    changed = (trained != picture).any(dim=-1).nonzero()
    assert changed[:, 0].min() >= GRID_MARGIN + high and changed[:, 1].max() < GRID_MARGIN + wide


def test_cut_outs_and_masks_beside_their_renders():
    images, coverage, _ = rasterize(SPLATS, CAMERAS)
    photos = [(255 * image.clamp(0, 1)).round().to(torch.uint8) for image in images]
    alphas = [(255 * alpha[..., 0]).round().to(torch.uint8) for alpha in coverage]
    capture = Capture(CAMERAS, photos, alphas=alphas)
    scene: Scene = replace(TRAINED, info={"settings": {"background": "white"}})
    width, height = CAMERAS[2].size
    whole = beside_photo(scene, capture, CAMERAS.names[2], device="cpu")
    photo, render = pair(whole, width, height)
    assert (photo - render).abs().mean() < 12
    assert all((each == 255).all(dim=-1).any() for each in (photo, render))
    nothing = torch.zeros(height, width, dtype=torch.bool)
    valid = nothing.clone()
    valid[:20] = True
    masked = replace(capture, valid_masks=[nothing, nothing, valid, *[nothing] * 5])
    part, _ = pair(beside_photo(scene, masked, CAMERAS.names[2], device="cpu"), width, height)
    assert torch.equal(part[:20], photo[:20]) and (part[20:] == 0).all()


def test_a_photo_of_objects_that_were_trained_alone_is_cut_out():
    images, _, _ = rasterize(SPLATS, CAMERAS)
    photos = [(255 * image.clamp(0, 1)).round().to(torch.uint8) for image in images]
    labels = [(coverage(SPLATS, camera, RED) > 0.5).int() for camera in CAMERAS]
    capture = Capture(CAMERAS, photos, label_maps=labels)
    scene: Scene = replace(TRAINED, info={OBJECTS_ALONE: True})
    width, height = CAMERAS[2].size
    picture = beside_photo(scene, capture, CAMERAS.names[2], device="cpu")
    photo, _ = pair(picture, width, height)
    assert (photo[labels[2] == 0] == 0).all() and (photo[labels[2] == 1] > 20).any()
    other = beside_photo(replace(scene, info={}), capture, CAMERAS.names[2], device="cpu")
    assert not torch.equal(pair(other, width, height)[0], photo)
