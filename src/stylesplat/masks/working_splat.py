"""A splat on which masks of different photos meet, and photos of a splat that came without any.

Of photos from a turntable before a camera that stood still, poses are those of the object, and the
room contradicts them: a splat of both is a fog around the object. Each pixel of the room, however,
has the same colour in most photos that do not show the object there: photos are cut out to what
turns.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from scipy.ndimage import binary_fill_holes
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.imaging.color import linear_rgb
from stylesplat.imaging.similarity import psnr
from stylesplat.progress import say, track
from stylesplat.rendering.render import pick_device, render
from stylesplat.scene.capture import Capture, OwnLabels, at_most, resize_labels
from stylesplat.scene.frames import FRAME_SAME, Frame, move_cameras, with_poses_of
from stylesplat.scene.scene import Scene
from stylesplat.scene.sequences import Lazy, evenly_spaced
from stylesplat.scene.splats import Splats
from stylesplat.training.config import TrainConfig
from stylesplat.training.loop import fit

STILL_PHOTOS = 48  # that tell what stands still
STILL_MIN_PHOTOS = 8  # fewer tell nothing
STILL_SAME_COLOR = 10  # of 255, by which colours of a pixel may differ that are the same
STAYS = 0.9  # share of the photos in which a pixel has the same colour if nothing moves there
STILL = 0.2  # share of such pixels from which the camera stood still: .48 on the own turntable,
# .00 around fox, doll, desk and demo
DIFFERS = 0.06  # of a colour channel; less is noise
LIGHT, HUE = 2.5, 0.3  # logarithms of intensities: a shadow's at most, and how it may be tinted
WORKING_DARK = 0.01  # intensity that is added, so that noise in the dark has no hue
EDGE, EDGES = 0.04, 0.005  # a plain sky is the same in all photos, too: still pixels at an edge
MOVING_LEAST = 0.02  # of each photo moves, or the object has the hue of what is behind it
SPECK, GAP = 3, 9  # pixels at working size: smaller specks are dropped, narrower gaps closed


@torch.no_grad()
def segment_moving_object(capture: Capture) -> Capture | None:
    """The photos with all transparent but what moves before a camera that stood still.

    Shadows that move are left out where they keep the hue of what they fall on. None if the camera
    moved or too few photos tell, if what moves cannot be told from its surroundings, and for
    photos of several sizes or that are cut out.
    """
    sizes = {camera.size for camera in capture.cameras}
    if len(sizes) > 1 or capture.alphas is not None or len(capture) < STILL_MIN_PHOTOS:
        return None
    photos = [capture.photos[row] for row in evenly_spaced(range(len(capture)), STILL_PHOTOS)]
    still, share = _still(torch.stack(photos))
    stays, grey = share > STAYS, still.mean(dim=-1)
    edges = (grey[1:, 1:] - grey[1:, :-1]).abs() + (grey[1:, 1:] - grey[:-1, 1:]).abs() > EDGE
    if stays.float().mean() < STILL or (edges & stays[1:, 1:]).float().mean() < EDGES:
        return None
    if min(float(_moving(each, still).float().mean()) for each in photos) < MOVING_LEAST:
        return None

    @lru_cache(maxsize=2)  # the photo is asked for, and then its alpha
    def cut_out(row: int) -> tuple[UInt8[Tensor, "H W 3"], UInt8[Tensor, "H W"]]:
        photo = capture.photos[row]
        moving = _moving(photo, still)
        return photo * moving[..., None], 255 * moving.to(torch.uint8)

    def part(row: int, which: int) -> Tensor:
        return cut_out(row)[which]

    rows = range(len(capture))
    cut_photos, alphas = (Lazy([partial(part, row, which) for row in rows]) for which in (0, 1))
    return replace(capture, photos=cut_photos, alphas=alphas)


def _still(
    photos: UInt8[Tensor, "P H W 3"],
) -> tuple[Float[Tensor, "H W 3"], Float[Tensor, "H W"]]:
    """The colour that each pixel has most often, 0 to 1, and its share of the photos."""
    photos = photos.short()
    still, most = photos[0].clone(), photos.new_zeros(photos.shape[1:3])
    for each in track(photos, "looking at what stands still", unit="photo"):
        count = ((photos - each).abs_().amax(dim=-1) < STILL_SAME_COLOR).sum(dim=0).to(most)
        better = count > most
        still[better], most[better] = each[better], count[better]
    same = ((photos - still).abs_().amax(dim=-1) < STILL_SAME_COLOR).float()
    mean = torch.einsum("phw,phwc->hwc", same, photos.float()) / same.sum(dim=0)[..., None]
    return mean / 255, same.mean(dim=0)


def _moving(photo: UInt8[Tensor, "H W 3"], still: Float[Tensor, "H W 3"]) -> Bool[Tensor, "H W"]:
    """Where a photo shows something else than what stands still, in whatever light."""
    image = photo.float() / 255
    change = (linear_rgb(image) + WORKING_DARK).log() - (linear_rgb(still) + WORKING_DARK).log()
    light = change.mean(dim=-1, keepdim=True)
    is_light = (light.abs() < LIGHT)[..., 0] & ((change - light).abs().amax(dim=-1) < HUE)
    moves = ((image - still).abs().amax(dim=-1) > DIFFERS) & ~is_light
    moves = moves.numpy().astype(np.uint8)
    moves = cv2.morphologyEx(moves, cv2.MORPH_OPEN, np.ones((SPECK, SPECK), np.uint8))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (GAP, GAP))
    moves = cv2.morphologyEx(moves, cv2.MORPH_CLOSE, disc)
    return torch.from_numpy(binary_fill_holes(moves))


WORKING_QUICK = TrainConfig(steps=3000, max_gaussians=30_000, test_every=0, sh_degree=1)
QUICK_SIZE = 480  # pixels of the longer side of its photos
CACHED_RENDERS = 256  # of 2 MB each
COMPARED_VIEWS = 5  # in which a splat is compared with photos
CHECK_SIZE = 240  # pixels of the longer side: smaller photos are enough for the comparison
FITTING_GAIN = 2.0  # dB above the photo's mean colour, from which a splat belongs to the photos


@dataclass(frozen=True, eq=False)
class WorkingSplat:
    """Photos at working size, and a splat of what they show."""

    capture: Capture
    splats: Splats
    """In the frame of the capture's cameras."""


def working_splat(capture: Capture, scene: Scene | None, device: str) -> WorkingSplat:
    """The splat of a scene of these photos, or one that is trained for about a minute."""
    torch_device = pick_device(device)
    capture = replace(capture, label_maps=None, object_names={})
    if scene is None:
        small = at_most(capture, QUICK_SIZE)
        moving = segment_moving_object(small)
        if moving is not None:
            say("The camera stood still: the quick splat is trained on what moves alone.")
        say("Training a quick splat, for a minute or more; --scene takes one that you have.")
        state = fit(moving or small, WORKING_QUICK, device=torch_device)
        return WorkingSplat(capture, state.splats.detach())
    missing = set(capture.cameras.names) - set(scene.cameras.names)
    if missing:
        raise StyleSplatError(
            f"This is a scene of other photos: it has no view {min(missing)}. Give a scene of "
            "these photos, or none."
        )
    splats = scene.base.to(torch_device)
    small = with_poses_of(at_most(capture, CHECK_SIZE), scene.cameras)
    if frame_fits(splats, small, {"scene": FRAME_SAME})["scene"] <= FITTING_GAIN:
        raise StyleSplatError(
            "The scene does not show what the photos do. Give a scene of these photos, or none."
        )
    return WorkingSplat(with_poses_of(capture, scene.cameras), splats)


def with_label_maps(
    capture: Capture, maps: Sequence[Callable[[], OwnLabels]], names: Mapping[int, str]
) -> Capture:
    """A capture with label maps that were made at another size, and are made on access."""

    def enlarged(row: int) -> OwnLabels:
        return resize_labels(maps[row](), capture.cameras[row].size[::-1])

    made = Lazy([partial(enlarged, row) for row in range(len(capture))])
    return replace(capture, label_maps=made, object_names=dict(names))


def rendered_capture(scene: Scene, device: torch.device) -> Capture:
    """A capture of a scene: its views, rendered on access, as they look without a style."""
    splats = scene.base.detach().to(device)

    @lru_cache(maxsize=CACHED_RENDERS)
    @torch.no_grad()
    def photo(row: int) -> UInt8[Tensor, "H W 3"]:
        image = render(splats, scene.cameras[row])[0].clamp(0, 1)
        return (255 * image).round().to(torch.uint8).cpu()

    rows = range(len(scene.cameras))
    return Capture(scene.cameras, Lazy([partial(photo, row) for row in rows]))


@torch.no_grad()
def frame_fits(splats: Splats, capture: Capture, frames: Mapping[str, Frame]) -> dict[str, float]:
    """How much closer to the photos renders are than their mean colour, in each frame.

    A frame turns the capture's world into the splat's. Returns the median over a few views of the
    gain in PSNR, in dB; more than `FITTING_GAIN` fits. Small photos are enough.
    """
    rows = evenly_spaced(range(len(capture.cameras)), COMPARED_VIEWS)
    photos = [capture.photos[row].to(splats.means) / 255 for row in rows]
    found = {}
    for name, frame in frames.items():
        cameras = move_cameras(capture.cameras[rows], frame)
        gains = []
        for row, photo in enumerate(photos):
            valid = capture.valid(rows[row])
            image = render(splats, cameras[row])[0].clamp(0, 1).flatten(0, 1)
            kept = slice(None) if valid is None else valid.flatten().to(image.device)
            image, photo = image[kept], photo.flatten(0, 1)[kept]
            gains.append(psnr(image, photo) - psnr(photo.mean(dim=0).expand_as(photo), photo))
        found[name] = float(torch.stack(gains).median())
    return found
