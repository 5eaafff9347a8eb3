"""The sheets that commands draw: objects, selections, label maps, before and after, photos."""

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from scipy.ndimage import binary_erosion, distance_transform_edt, uniform_filter
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.figures.best_views import (
    SEARCHED_VIEWS,
    aim_at,
    find_views,
    most_detailed,
    shown_detail,
    survey_view,
)
from stylesplat.figures.grid import CARD, GRID_CELL, Row, add_legend, draw_grid, wrap_cells
from stylesplat.figures.pictures import label_colors, render_picture, to_uint8
from stylesplat.imaging.similarity import psnr
from stylesplat.io.captures.capture_folder import open_capture
from stylesplat.io.captures.photos import PHOTO_OPAQUE
from stylesplat.photo_libraries import cv2
from stylesplat.progress import track
from stylesplat.rendering.render import pick_device, render
from stylesplat.rendering.view_pool import map_views
from stylesplat.rendering.weights import COVERED, colors_and_coverage
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import BACKGROUND, Capture, at_most, ids_of
from stylesplat.scene.scene import Scene, require_painted
from stylesplat.scene.sequences import evenly_spaced
from stylesplat.scene.splats import Splats
from stylesplat.selection.labels import each_object, object_ids, render_labels
from stylesplat.selection.shares import object_shares, survey
from stylesplat.training.object_alone import OBJECTS_ALONE, as_trained

MAX_COLUMNS = 4  # of a sheet with few objects; a sheet of many is about square
SHEET_SURVEY_VIEWS = 24  # views searched for the best ones of each object

SHEET_PANEL = 480  # pixels along the longer side of a view of a selection
DIM = 0.55  # of the brightness of what is not selected
SHEET_LEFT_OUT = (0.1, 0.35, 1.0)  # the colour of what is selected but takes no paint
OUTLINE_COLOR, OUTLINE_WIDTH = (255, 200, 0), 2
SHEET_SPECK = 5  # pixels: narrower parts have no outline, which would cover them
ROOM = 3.0  # length of a panel in lengths of the object, unless the view is shorter
MIN_ROOM = 1 / 6  # of the view, which a panel shows at least, so that the place is recognised

PREVIEW_PHOTOS, PREVIEW_COLUMNS = 8, 4  # of a preview of label maps
PHOTO_SIDE = 400  # pixels of such a photo's longer side at most
TINT = 0.55  # how much of an object's colour covers the photo

RIM, RIM_VIEWS = 512, 3  # pixels a side of an object's lower end, and how many views show it
BELOW = 0.15  # of that, below the object

SHEET_LONGEST = 2048  # pixels of a side: photos of phones have more than a screen shows


@torch.no_grad()
def object_sheet(
    splats: Splats, cameras: Cameras, *, names: Mapping[int, str] | None = None
) -> UInt8[Tensor, "H W 3"]:
    """Draw each object with its id, its name and the number of its Gaussians.

    Each object is cut out of the whole scene, from the view that shows most of it and of its
    detail. What hides it in this view hides it here.
    """
    ids = object_ids(splats)
    if not ids:
        raise StyleSplatError(
            "These splats have no objects: the label maps hold only background. "
            "Train with label maps that name some."
        )
    searched = evenly_spaced(range(len(cameras)), SHEET_SURVEY_VIEWS)
    views = [survey_view(cameras[row]) for row in searched]
    scores: dict[int, dict[int, float]] = {id: {} for id in ids}  # by object and row

    def look(view: Cameras) -> tuple[Tensor, Tensor]:
        return render_labels(splats, view), render(splats, view)[0]

    looks = track(map_views(look, views, splats.device), "looking for objects", total=len(views))
    for row, (labels, image) in zip(searched, looks, strict=True):
        for id in {*labels.unique().tolist()} & scores.keys():
            scores[id][row] = shown_detail(image, labels == id)
    seen = survey(splats, views)
    cells = []
    for id, picked in track(each_object(splats, ids), "objects", unit="object", total=len(ids)):
        nearby, own = splats, picked
        if seen is not None and picked.any():
            around = seen.around(picked)
            nearby, own = splats[around], picked[around]
        name = (names or {}).get(id)
        title = f"{id} · {name}" if name else str(id)
        caption = f"{title}\n{int(picked.sum()):,} Gaussians"
        best = cameras[max(scores[id], key=scores[id].__getitem__)] if scores[id] else None
        cells.append((_portrait(nearby, own, best), caption))
    lines = math.ceil(len(cells) / max(MAX_COLUMNS, math.sqrt(len(cells))))
    return draw_grid(wrap_cells(cells, math.ceil(len(cells) / lines)))


@torch.no_grad()
def selection_picture(
    splats: Splats, cameras: Cameras, picked: Bool[Tensor, " N"]
) -> UInt8[Tensor, "H W 3"] | None:
    """Draw a selection in up to three views from different sides, with the names of the views.

    Selected Gaussians are drawn in colour, all others in grey. Those that `stylize` does not
    paint, as they lie beside the object or on the surface below it, are blue. Returns None if the
    selection shows in no view.
    """
    found = find_views(splats, cameras, picked)
    if not found:
        return None
    features = torch.stack([picked.to(splats.means), object_shares(splats, picked, cameras)], dim=1)
    views = [_crop_around(cameras[each.row], each.mask) for each in found]
    return draw_grid([Row([(_panel(splats, view, features), view.names[0]) for view in views])])


def mask_preview(capture: Capture, names: Mapping[int, str]) -> UInt8[Tensor, "H W 3"]:
    """Draw label maps over photos from the first to the last, with a legend of the objects."""
    maps, small = capture.label_maps or [], at_most(capture, PHOTO_SIDE)
    rows = [row for row in range(len(capture)) if maps[row] is not None]
    cells, ids = [], set[int]()
    for row in evenly_spaced(rows, PREVIEW_PHOTOS):
        labels, photo = small.labels(row), small.photos[row].float()
        assert labels is not None
        ids |= ids_of(labels) - {BACKGROUND}
        tinted = TINT * label_colors(labels) + (1 - TINT) * photo
        shown = tinted.where((labels != BACKGROUND)[..., None], photo)
        cells.append((shown.round().byte(), ""))
    key = [
        (names.get(id, str(id)), label_colors(torch.tensor([[id]]))[0, 0].tolist())
        for id in sorted(ids)
    ]
    return add_legend(draw_grid(wrap_cells(cells, PREVIEW_COLUMNS)), key)


def draw_contact_contours(capture: Capture, names: Mapping[int, str]) -> UInt8[Tensor, "H W 3"]:
    """Draw outlines of objects, by id, where they stand, in three views that differ."""
    small = at_most(capture, PHOTO_SIDE)
    views = small.cameras.viewmats[:, 2, :3]
    maps = [small.labels(row) for row in range(len(small))]
    rows = []
    for id, name in names.items():
        pixels = torch.tensor([0 if each is None else int((each == id).sum()) for each in maps])
        chosen, shown = [int(pixels.argmax())], pixels > pixels.max() / 4
        for _ in range(RIM_VIEWS - 1):
            alike = (views @ views[chosen].T).amax(dim=1).masked_fill(~shown, 2.0)
            chosen.append(int(alike.argmin()))
        cells = [
            (_lower_rim(capture, row, id), f"{name}, {small.cameras.names[row]}")
            for row in dict.fromkeys(chosen)
        ]
        rows.append(Row(cells))
    return draw_grid(rows)


def _lower_rim(capture: Capture, row: int, id: int) -> UInt8[Tensor, "S S 3"]:
    labels, photo = capture.labels(row), capture.photos[row].numpy()
    assert labels is not None
    mask = (labels == id).numpy().astype(np.uint8)
    left, top, width, height = cv2.boundingRect(mask)
    side = max(width, 1)
    x0, y0 = left, top + height + round(BELOW * side) - side
    scale = RIM / side
    place = np.array([[scale, 0, -scale * x0], [0, scale, -scale * y0]])
    size = RIM, RIM
    picture = cv2.warpAffine(photo, place, size, borderValue=CARD)
    found = cv2.warpAffine(mask, place, size, flags=cv2.INTER_NEAREST)
    contours = cv2.findContours(found, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)[0]
    return torch.from_numpy(cv2.drawContours(picture, contours, -1, OUTLINE_COLOR, 1))


@torch.no_grad()
def before_after(
    scene: Scene, *, device: str = "auto"
) -> tuple[str, UInt8[Tensor, "H W 3"]] | None:
    """Draw the view that shows most of the painted objects and of their detail, before and after.

    It is as large as its photo, up to 2048 pixels a side. Returns its name and the pictures side by
    side, or None if no view shows painted objects.
    """
    require_painted(scene)
    base = scene.base.to(pick_device(device))
    masks = [layer.covered(len(base)) for layer in scene.layers]
    picked = torch.stack(masks).any(dim=0).to(base.device)
    found = find_views(base, scene.cameras, picked, count=SEARCHED_VIEWS)
    if not found:
        return None
    camera = scene.cameras[most_detailed(base, scene.cameras, found).row].at_most(SHEET_LONGEST)
    pair = [render_picture(each.to(base.device), camera) for each in (base, scene.splats)]
    return camera.names[0], draw_grid([Row([*zip(pair, ("before", "after"), strict=True)])])


@torch.no_grad()
def beside_photo(
    scene: Scene, capture: Capture, name: str, *, device: str = "auto"
) -> UInt8[Tensor, "H W 3"]:
    """Draw a photo and the render of its view, with their PSNR.

    The photo is drawn at its full size if the capture is smaller, up to 2048 pixels a side. Where
    objects were trained alone, it is cut out by the label maps, and drawn at their size. The PSNR
    is measured at the size of the capture, over opaque pixels.
    """
    capture = whole = as_trained(capture, scene.info)
    if capture.downscale != 1 and capture.path is not None and not scene.info.get(OBJECTS_ALONE):
        whole = open_capture(capture.path, masks=False).at(1.0)
    splats = scene.splats.to(pick_device(device))
    photo, image = _photo_and_render(scene, splats, capture, name)
    row = capture.cameras.index(name)
    valid, alpha = capture.valid(row), capture.alpha(row)
    counted = torch.ones(photo.shape[:2], dtype=torch.bool) if valid is None else valid
    if alpha is not None and (opaque := counted & (alpha >= PHOTO_OPAQUE)).any():
        counted = opaque
    decibels = float(psnr(image[counted] / 255, photo[counted] / 255))
    pair = _photo_and_render(scene, splats, at_most(whole, SHEET_LONGEST), name)
    held_out = "held-out " if name in scene.held_out else ""
    captions = f"{held_out}photo {name}", f"render, PSNR {decibels:.1f} dB"
    return draw_grid([Row([*zip(pair, captions, strict=True)])])


@torch.no_grad()
def one_view(scene: Scene, name: str, *, device: str = "auto") -> UInt8[Tensor, "H W 3"]:
    camera = scene.cameras[scene.cameras.index(name)].at_most(SHEET_LONGEST)
    return render_picture(scene.splats.to(pick_device(device)), camera)


def _portrait(
    splats: Splats, picked: Bool[Tensor, " N"], camera: Cameras | None
) -> UInt8[Tensor, "H W 3"]:
    card = torch.tensor(CARD, dtype=torch.uint8).expand(GRID_CELL, GRID_CELL, 3)
    if camera is None:
        return card
    image, share = colors_and_coverage(splats, aim_at(splats, picked, camera, GRID_CELL), picked)
    return to_uint8(share * image + (1 - share) * card.to(image) / 255).cpu()


def _crop_around(camera: Cameras, mask: Bool[Tensor, "h w"]) -> Cameras:
    """The view at the size of a panel; around a small object only a part of it."""
    size = camera.sizes[0]
    scale = size / torch.tensor(mask.shape).flip(0)
    pixels = mask.nonzero().flip(1).cpu()  # x, y
    low, high = pixels.amin(dim=0) * scale, (pixels.amax(dim=0) + 1) * scale
    share = (ROOM * ((high - low) / size).max()).clamp(MIN_ROOM, 1)
    part = share * size
    corner = torch.minimum(((low + high - part) / 2).clamp(min=0), size - part)
    zoom = SHEET_PANEL / float(part.max())
    return camera.crop(corner.tolist(), (part * zoom).round().int().tolist(), zoom=zoom)


def _panel(
    splats: Splats, camera: Cameras, features: Float[Tensor, "N 2"]
) -> UInt8[Tensor, "_ _ 3"]:
    """One view; the features are the selection and the shares of it that take paint."""
    rendered, _ = render(splats, camera, features=features)
    image, covered, own = rendered.split([3, 1, 1], dim=-1)
    grey = DIM * image.mean(dim=-1, keepdim=True)
    left_out = (covered - own) * image.new_tensor(SHEET_LEFT_OUT)
    panel = (own * image + left_out + (1 - covered) * grey).cpu().clamp(0, 1)
    mask = (covered[..., 0].cpu() > COVERED).numpy().astype(np.float32)
    mask = np.asarray(uniform_filter(mask, SHEET_SPECK, mode="nearest")) > 0.5  # the median
    outline = mask & np.logical_not(binary_erosion(mask))
    away = np.asarray(distance_transform_edt(~outline))
    line = torch.from_numpy((OUTLINE_WIDTH + 1) / 2 - away).clamp(0, 1)[..., None]
    return to_uint8(panel + line * (panel.new_tensor(OUTLINE_COLOR) / 255 - panel))


def _photo_and_render(
    scene: Scene, splats: Splats, capture: Capture, name: str
) -> tuple[UInt8[Tensor, "H W 3"], UInt8[Tensor, "H W 3"]]:
    """A photo, and the render at the pose that the scene has of it, both of one size.

    What a mask leaves out of the photo is black. Cut-outs are before what they were trained on.
    """
    row, own = capture.cameras.index(name), scene.cameras[scene.cameras.index(name)]
    camera = replace(capture.cameras[row], viewmats=own.viewmats)
    photo, alpha, valid = capture.photos[row], capture.alpha(row), capture.valid(row)
    background = None
    if alpha is not None and scene.info.get("settings", {}).get("background") == "white":
        background = "white"
        photo = photo + (255 - alpha[..., None]).minimum(255 - photo)
    photo = photo if valid is None else photo * valid[..., None]
    return photo, render_picture(splats, camera, background)
