"""`render`: pictures of a scene, one per view."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from jaxtyping import Int, UInt8
from torch import Tensor

from stylesplat.drawing.orbit import orbit_around, orbit_cameras
from stylesplat.drawing.pictures import render_pictures
from stylesplat.progress import track
from stylesplat.rendering.device import pick_device
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.content import content_of
from stylesplat.scene.ring import FOCAL, has_no_photos
from stylesplat.scene.scene import Scene
from stylesplat.selection.choose import find_object

Which = Literal["test", "train", "all", "orbit"]
ORBIT_FRAMES = 180  # six seconds at 30 frames a second


@dataclass(frozen=True)
class Views:
    """Pictures of a scene, rendered one after the other as they are asked for."""

    names: tuple[str, ...]
    """Of the cameras: the photos' file names."""
    pictures: Iterator[UInt8[Tensor, "H W 3"] | Int[Tensor, "H W"]]
    """What each sees, on the CPU: an image, or the ids of labels."""

    def __len__(self) -> int:
        return len(self.names)

    def __iter__(self) -> Iterator[tuple[str, UInt8[Tensor, "H W 3"] | Int[Tensor, "H W"]]]:
        return zip(self.names, self.pictures, strict=True)


def render(
    scene: Scene,
    views: Which = "all",
    *,
    what: str = "color",
    downscale: float = 1.0,
    device: str = "auto",
) -> Views:
    """Render views of a scene.

    Args:
        scene: What to look at.
        views: Held-out (test), training or all views, or a round trip of 180 frames.
        what: `color`; `labels`, the ids of label maps; `identities`, their principal components
            as colours; `depth`; or `object:NAME`, one object alone.
        downscale: How many times smaller than the photos.
        device: Where to render.

    Returns:
        Names and pictures; the latter are rendered as they are asked for.

    Raises:
        StyleSplatError: If the scene has no such views or objects.

    Example:
        >>> for name, picture in render(scene, "test"):  # doctest: +SKIP
        ...     Image.fromarray(picture.numpy()).save(name)
    """
    if views == "orbit":
        cameras = _orbit(scene)
    else:
        cameras = scene.views(views)
    cameras = cameras.downscale(downscale)
    splats = scene.splats.to(pick_device(device))
    picked = None
    if what.startswith("object:"):
        picked, what = find_object(scene, what.removeprefix("object:")), "object"
    pictures = render_pictures(splats, cameras, what, picked=picked)
    counted = track(pictures, "rendering", total=len(cameras))
    return Views(cameras.names, counted)


def _orbit(scene: Scene) -> Cameras:
    """Around what the photos show, where they were taken; without photos around the content."""
    if has_no_photos(scene):
        return orbit_around(content_of(scene.splats), scene.cameras, FOCAL, ORBIT_FRAMES)
    return orbit_cameras(scene.cameras, ORBIT_FRAMES)
