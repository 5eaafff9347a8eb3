"""A splat on which masks of different photos meet, and photos of a splat that came without any."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import torch
from jaxtyping import UInt8
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.imaging.similarity import psnr
from stylesplat.progress import say
from stylesplat.rendering.render import pick_device, render
from stylesplat.scene.capture import Capture, OwnLabels, at_most, resize_labels
from stylesplat.scene.frames import FRAME_SAME, Frame, move_cameras, with_poses_of
from stylesplat.scene.scene import Scene
from stylesplat.scene.sequences import Lazy, evenly_spaced
from stylesplat.scene.splats import Splats
from stylesplat.training.config import TrainConfig
from stylesplat.training.loop import fit
from stylesplat.training.object_alone import cut_out_labels, outline_moving_object

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
    """The splat of a scene of these photos, or one that is trained for a minute or more."""
    torch_device = pick_device(device)
    capture = replace(capture, label_maps=None, object_names={})
    if scene is None:
        small = at_most(capture, QUICK_SIZE)
        outlines = outline_moving_object(small)
        if outlines is not None:
            say("The camera stood still: the quick splat is trained on what moves alone.")
            label_maps = [each.int() for each in outlines]
            small = cut_out_labels(replace(small, label_maps=label_maps))
            small = replace(small, label_maps=None)
        say("Training a quick splat, for a minute or more; --scene takes one that you have.")
        state = fit(small, WORKING_QUICK, device=torch_device)
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
