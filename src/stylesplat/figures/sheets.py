"""The sheets that commands draw: objects, selections, label maps, before and after, photos."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor
from torch.nn.functional import interpolate

from stylesplat.errors import StyleSplatError
from stylesplat.figures.best_views import (
    SEARCHED_VIEWS,
    VIEWS,
    ObjectMask,
    aim_at,
    best_rows,
    find_views,
    masks_of,
    most_detailed,
    small,
    visibility,
)
from stylesplat.figures.grid import (
    CARD,
    CELL,
    MARGIN,
    PAPER,
    GridPicture,
    Row,
    draw_grid,
    in_lines,
    legend,
    stacked,
)
from stylesplat.figures.pictures import label_colors, render_pictures, to_uint8
from stylesplat.io.captures.capture_folder import open_capture
from stylesplat.metrics.psnr import psnr
from stylesplat.progress import track
from stylesplat.rendering.at_once import at_once
from stylesplat.rendering.render import pick_device, render
from stylesplat.rendering.shares import colors_and_coverage
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture, at_most
from stylesplat.scene.compose import require_painted
from stylesplat.scene.content import solid
from stylesplat.scene.labels import BACKGROUND, ids_of, resize_labels
from stylesplat.scene.projection import crop
from stylesplat.scene.sampling import evenly
from stylesplat.scene.scene import Scene
from stylesplat.scene.splats import Splats
from stylesplat.selection.identities import MIN_COVERAGE, object_ids, render_labels
from stylesplat.selection.pick import each_object
from stylesplat.selection.soft_picks import own_shares, survey
from stylesplat.stylization.views import Box

GAP = 8  # pixels between the cut-outs of one object
SMALL = (CELL - GAP) // 2  # pixels along those from other sides
MAX_COLUMNS = 4  # of a sheet with few objects; of many there are as many lines as columns
SURVEY_VIEWS = 24  # views searched for the best ones of each object

PANEL = 480  # pixels along the longer side of a view of a selection
DIM = 0.55  # of the brightness of what is not selected
LEFT_OUT = (0.1, 0.35, 1.0)  # the colour of what is selected but takes no paint
OUTLINE, THICKNESS = (255, 200, 0), 2
SPECK = 5  # pixels: what is narrower shows in colour, but an outline would cover it
ROOM = 3.0  # how many times as long as the object a view may be, beyond which it is cut to that
MIN_ROOM = 1 / 6  # of a view, which is never cut to less: one would not know the place

PHOTOS, PHOTO_COLUMNS = 8, 4  # of a preview of label maps
PHOTO_WIDTH, PHOTO_HEIGHT = 400, 300  # pixels of such a photo at most
TINT = 0.55  # how much of an object's colour covers the photo

LONGEST = 2048  # pixels of a side: photos of phones have more than a screen shows
NARROWEST = 450  # pixels of the width of a picture that is to be looked at


@torch.no_grad()
def object_sheet(
    splats: Splats,
    cameras: Cameras,
    *,
    names: Mapping[int, str] | None = None,
) -> UInt8[Tensor, "H W 3"]:
    """Draw each object with its id, its name and the number of its Gaussians.

    Each object is cut out of the whole scene, from the view that shows most of it and small from
    two other sides. What hides it in these views hides it here.

    Returns:
        The sheet, objects in the order of their ids.

    Raises:
        StyleSplatError: If the splats have no identities, or no objects.
    """
    ids = object_ids(splats)
    if not ids:
        raise StyleSplatError(
            "These splats have no objects: the label maps hold only background. "
            "Train with label maps that name some."
        )
    searched = evenly(range(len(cameras)), SURVEY_VIEWS)
    scores = _scores(splats, cameras, searched, ids)
    seen = survey(splats, [small(cameras[row]) for row in searched])
    cells = []
    for id, picked in track(each_object(splats, ids), "objects", unit="object", total=len(ids)):
        rows = best_rows(cameras, splats.means[solid(splats, picked)], scores[id])
        there, own = splats, picked
        if seen is not None and picked.any():
            around = seen.around(picked)
            there, own = splats[around], picked[around]
        title = " · ".join([str(id), *filter(None, [(names or {}).get(id)])])
        caption = f"{title}\n{int(picked.sum()):,} Gaussians"
        cells.append((_portraits(there, own, cameras[rows]), caption))
    lines = math.ceil(len(cells) / max(MAX_COLUMNS, math.sqrt(len(cells))))
    return draw_grid(in_lines(cells, math.ceil(len(cells) / lines)))


@torch.no_grad()
def selection_picture(
    splats: Splats, cameras: Cameras, picked: Bool[Tensor, " N"]
) -> UInt8[Tensor, "H W 3"] | None:
    """Draw a selection in up to three views from different sides, with the names of the views.

    Selected Gaussians are drawn in colour, all others in grey. Those that `stylize` does not
    paint, as they lie beside the object or on the surface below it, are blue.

    Returns:
        The views side by side; None if the selection shows in none.
    """
    views = find_views(splats, cameras, picked)
    if not views:
        return None
    features = torch.stack([picked.to(splats.means), own_shares(splats, picked, cameras)], dim=1)
    cuts = [_cut(cameras[view.row], view) for view in views]
    return draw_grid([Row([(_panel(splats, cut, features), cut.names[0]) for cut in cuts])])


def mask_preview(capture: Capture, names: Mapping[int, str]) -> UInt8[Tensor, "H W 3"]:
    """Draw label maps over photos from the first to the last, with a legend of the objects."""
    maps = capture.label_maps or []
    rows = [row for row in range(len(capture)) if maps[row] is not None]
    cells, ids = [], set[int]()
    for row in evenly(rows, PHOTOS):
        labels = maps[row]
        assert labels is not None
        ids |= ids_of(labels) - {BACKGROUND}
        cells.append((_tinted(capture.photos[row], labels), ""))
    page = draw_grid(in_lines(cells, PHOTO_COLUMNS))
    colors = [label_colors(torch.tensor([[id]]))[0, 0].tolist() for id in sorted(ids)]
    called = [names.get(id, str(id)) for id in sorted(ids)]
    key = legend([*zip(called, colors, strict=True)], page.shape[1] - 2 * MARGIN)
    return stacked(page, key)


@torch.no_grad()
def before_after(
    scene: Scene,
    *,
    surveys: Mapping[str, Sequence[Box]] | None = None,
    device: str = "auto",
) -> tuple[str, UInt8[Tensor, "H W 3"]] | None:
    """Draw the view that shows most of the painted objects and of their detail, before and after.

    It is as large as its photo, up to 2048 pixels a side.

    Args:
        scene: A painted scene.
        surveys: The boxes of the painted objects, if they are known.
        device: Where to render.

    Returns:
        The view's name and the pictures side by side; None if no view shows painted objects.

    Raises:
        StyleSplatError: If the scene is not painted.
    """
    require_painted(scene)
    base = scene.unpainted.to(pick_device(device))
    surveyed = surveys is not None and surveys.keys() == {*scene.painted_objects}
    masks = masks_of(surveys.values(), scene.cameras) if surveys and surveyed else None
    picked = torch.zeros(len(base), dtype=torch.bool, device=base.device)
    for layer in scene.layers:
        picked[layer.rows.to(base.device)] = True
    found = find_views(base, scene.cameras, picked, count=SEARCHED_VIEWS, masks=masks)
    if not found:
        return None
    camera = scene.cameras[most_detailed(base, scene.cameras, found).row].at_most(LONGEST)
    pair = [_render(each.to(base.device), camera) for each in (base, scene.splats)]
    return camera.names[0], draw_grid([Row([*zip(pair, ("before", "after"), strict=True)])])


@torch.no_grad()
def beside_photo(
    scene: Scene, capture: Capture, name: str, *, device: str = "auto"
) -> UInt8[Tensor, "H W 3"]:
    """Draw a photo and the render of its view, with their PSNR.

    They are drawn at the photo's own size, though the capture may be loaded at a smaller one, up
    to 2048 pixels a side and no narrower than 450. The PSNR is measured at the size of the capture.

    Raises:
        StyleSplatError: If the photos cannot be read again at their own size.
    """
    whole = capture
    if capture.downscale != 1 and capture.path is not None:
        whole = open_capture(capture.path, masks=False).at(1.0)
    splats = scene.splats.to(pick_device(device))
    pair = _photo_and_render(scene, splats, at_most(whole, LONGEST), name)
    close = psnr(*(each / 255 for each in _photo_and_render(scene, splats, capture, name)))
    held_out = "held-out " * (name in scene.held_out)
    captions = f"{held_out}photo {name}", f"render, PSNR {float(close):.1f} dB"
    return draw_grid([Row([*zip(map(_wide_enough, pair), captions, strict=True)])])


@torch.no_grad()
def one_view(
    scene: Scene, name: str, *, longest: int = LONGEST, device: str = "auto"
) -> UInt8[Tensor, "H W 3"]:
    """Render one of the views of a scene, at most so many pixels along its longer side."""
    camera = scene.cameras[scene.cameras.index(name)].at_most(longest)
    return _render(scene.splats.to(pick_device(device)), camera)


def _scores(
    splats: Splats, cameras: Cameras, rows: Sequence[int], ids: Sequence[int]
) -> dict[int, dict[int, float]]:
    """By object and row of a camera the `visibility` there, if it is visible."""
    scores: dict[int, dict[int, float]] = {id: {} for id in ids}
    labelled = at_once(lambda row: render_labels(splats, small(cameras[row])), rows, splats.device)
    for row, labels in zip(
        rows, track(labelled, "looking for objects", total=len(rows)), strict=True
    ):
        for id in labels.unique().tolist():
            if id in scores:
                scores[id][row] = visibility(labels == id)
    return scores


def _portraits(
    splats: Splats, picked: Bool[Tensor, " N"], cameras: Cameras
) -> UInt8[Tensor, "H W 3"]:
    """An object alone from up to three cameras: the first large, the others small beside it."""
    card = torch.tensor(CARD, dtype=torch.uint8)
    sheet = torch.tensor(PAPER, dtype=torch.uint8).repeat(CELL, CELL + GAP + SMALL, 1)
    places = [(0, 0, CELL), *((n * (SMALL + GAP), CELL + GAP, SMALL) for n in range(VIEWS - 1))]
    for number, (top, left, side) in enumerate(places):
        portrait = card.expand(side, side, 3)
        if number < len(cameras):
            camera = aim_at(splats, picked, cameras[number], side)
            image, share = colors_and_coverage(splats, camera, picked)
            portrait = to_uint8(share * image + (1 - share) * card.to(image) / 255).cpu()
        sheet[top : top + side, left : left + side] = portrait
    return sheet


def _cut(camera: Cameras, found: ObjectMask) -> Cameras:
    """The view at the size of a panel; around a small object only a part of it."""
    size = camera.sizes[0]
    scale = size / torch.tensor(found.mask.shape).flip(0)
    places = found.mask.nonzero().flip(1).cpu()  # x, y
    low, high = places.amin(dim=0) * scale, (places.amax(dim=0) + 1) * scale
    share = (ROOM * ((high - low) / size).max()).clamp(MIN_ROOM, 1)
    zoom = PANEL / (share * size.max())
    wide = (share * size * zoom).round()
    scaled = camera.downscale(1 / float(zoom))
    corner = ((low + high) / 2 * zoom - wide / 2).round().clamp(min=0)
    corner = torch.minimum(corner, (scaled.sizes[0] - wide).clamp(min=0))
    return crop(scaled, corner.tolist(), wide.int().tolist())


def _panel(
    splats: Splats, camera: Cameras, features: Float[Tensor, "N 2"]
) -> UInt8[Tensor, "_ _ 3"]:
    """One view; the features are the selection and the shares of it that take paint."""
    rendered, _ = render(splats, camera, features=features)
    image, covered, own = rendered.split([3, 1, 1], dim=-1)
    grey = DIM * image.mean(dim=-1, keepdim=True)
    left_out = (covered - own) * image.new_tensor(LEFT_OUT)
    panel = to_uint8(own * image + left_out + (1 - covered) * grey).cpu().numpy()
    mask = (covered[..., 0].cpu() > MIN_COVERAGE).numpy().astype(np.uint8)
    edges, _ = cv2.findContours(cv2.medianBlur(mask, SPECK), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    return torch.from_numpy(cv2.drawContours(panel, edges, -1, OUTLINE, THICKNESS, cv2.LINE_AA))


def _tinted(photo: UInt8[Tensor, "H W 3"], labels: Int[Tensor, "H W"]) -> GridPicture:
    """A small photo with each object in its colour."""
    height, width, _ = photo.shape
    factor = min(PHOTO_WIDTH / width, PHOTO_HEIGHT / height, 1.0)
    size = max(1, round(width * factor)), max(1, round(height * factor))
    resized = cv2.resize(photo.numpy(), size, interpolation=cv2.INTER_AREA)
    mapped = resize_labels(labels, size[::-1])
    plain = torch.from_numpy(resized).float()
    tinted = TINT * label_colors(mapped) + (1 - TINT) * plain
    return tinted.where((mapped != BACKGROUND)[..., None], plain).round().byte()


def _render(splats: Splats, camera: Cameras) -> UInt8[Tensor, "H W 3"]:
    return next(iter(render_pictures(splats, camera)))


def _photo_and_render(
    scene: Scene, splats: Splats, capture: Capture, name: str
) -> tuple[UInt8[Tensor, "H W 3"], UInt8[Tensor, "H W 3"]]:
    """A photo, and the render at the pose that the scene has of it, both of one size."""
    row, own = capture.cameras.index(name), scene.cameras[scene.cameras.index(name)]
    camera = replace(capture.cameras[row], viewmats=own.viewmats)
    return capture.photos[row], _render(splats, camera)


def _wide_enough(picture: UInt8[Tensor, "h w 3"]) -> UInt8[Tensor, "H W 3"]:
    """A picture that is wide enough to read its caption."""
    height, width, _ = picture.shape
    if width >= NARROWEST:
        return picture
    planes = picture.permute(2, 0, 1)[None].float()
    size = round(height * NARROWEST / width), NARROWEST
    resized = interpolate(planes, size, mode="bicubic", align_corners=False)
    return resized[0].permute(1, 2, 0).round().clamp(0, 255).byte()
