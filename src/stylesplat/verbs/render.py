"""`render`, `orbit` and `view`: pictures of a scene, cameras of a round trip, the browser."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from stylesplat.errors import StyleSplatError, count_noun, join_names, noun_repr
from stylesplat.figures.pictures import render_pictures
from stylesplat.io.images import ViewPicture
from stylesplat.options import check_arguments
from stylesplat.progress import track
from stylesplat.rendering.render import pick_device
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.content import content_of
from stylesplat.scene.scene import Scene
from stylesplat.scene.virtual_cameras import (
    has_rendered_views,
    orbit_around,
    orbit_cameras,
    zoom_to_content,
)
from stylesplat.selection.resolve import find_object
from stylesplat.torch_modes import steps_in_own_modes

RenderedViews = Literal["test", "train", "all", "orbit"]
Names = list[str] | tuple[str, ...]

FRAMES, FPS = 180, 30  # six seconds


@dataclass(frozen=True)
class Views:
    """Pictures of a scene, rendered one after the other as they are asked for."""

    names: tuple[str, ...]
    """Of the cameras: the photos' file names."""
    pictures: Iterator[ViewPicture]
    """What each sees, on the CPU: an image, or the ids of labels, or depths."""

    def __repr__(self) -> str:
        return noun_repr(self, count_noun(len(self), "picture"), join_names(self.names))

    def __len__(self) -> int:
        return len(self.names)

    def __iter__(self) -> Iterator[tuple[str, ViewPicture]]:
        return zip(self.names, self.pictures, strict=True)


@check_arguments
def render(
    scene: Scene,
    views: RenderedViews | Names | Cameras = "all",
    *,
    what: str = "color",
    background: str | None = None,
    downscale: float = 1.0,
    frames: int | None = None,
    device: str = "auto",
) -> Views:
    """Render views of a scene.

    Args:
        scene: What to look at.
        views: Held-out (test), training or all views, a round trip (orbit); names of photos; or
            any cameras, such as those of `orbit` and `read_camera_path`.
        what: `color`; `labels`, the ids of label maps; `label-colors`, a colour for each;
            `identities`, their principal components as colours; `depth` as colours, near is
            bright; `depth-float`, along the view in world units, 0 where nothing is; or
            `object:NAME`, one object alone.
        background: What is behind: `transparent`, which gives images an alpha channel, `black`,
            `white` or `#rrggbb`. By default black behind `color`, white behind other images.
        downscale: How many times smaller than the photos.
        frames: How many a round trip has; see `orbit`.
        device: Where to render.

    Returns:
        Names and pictures; the latter are rendered as they are asked for.

    Raises:
        StyleSplatError: If the scene has no such views or objects, or there is no such picture or
            background.

    Example:
        >>> for name, picture in render(scene, "test"):  # doctest: +SKIP
        ...     Image.fromarray(picture.numpy()).save(name)
    """
    cameras = cameras_of_views(scene, views, frames).downscale(downscale)
    splats = scene.splats.to(pick_device(device))
    picked = None
    if what.startswith("object:"):
        mask, what = find_object(scene, what.removeprefix("object:")), "object"
        picked = scene.to_splats(mask)
    pictures = render_pictures(splats, cameras, what, picked=picked, background=background)
    pictures = steps_in_own_modes(pictures)
    return Views(cameras.names, track(pictures, "rendering", total=len(cameras)))


def cameras_of_views(
    scene: Scene, views: RenderedViews | Names | Cameras, frames: int | None = None
) -> Cameras:
    """The cameras of `render`'s argument `views`."""
    if frames is not None and not (isinstance(views, str) and views == "orbit"):
        raise StyleSplatError(
            f"Cannot render {frames} frames of these views: a round trip has frames. Pass "
            "views='orbit', or leave `frames` out."
        )
    if isinstance(views, Cameras):
        return views
    if views == "orbit":
        return orbit(scene, frames=frames)
    if isinstance(views, str):
        return scene.views(views)
    return scene.cameras[[scene.cameras.index(name) for name in views]]


@check_arguments
def orbit(
    scene: Scene,
    *,
    around: str | None = None,
    frames: int | None = None,
    size: tuple[int, int] | None = None,
) -> Cameras:
    """A smooth round trip: where the photos were taken, or without photos all around.

    Args:
        scene: What to go around.
        around: The object in the middle, which fills the pictures; by default what the photos
            look at, or all content.
        frames: How many, 180 by default; the one after the last would be the first again.
        size: Width and height of the pictures, by default the photos'. Where they have another
            shape, more is seen at two sides.

    Raises:
        StyleSplatError: If there is no such object, or the photos look at nothing in common.

    Example:
        >>> turntable = orbit(scene, around="vase", size=(1280, 720))  # doctest: +SKIP
        >>> for name, picture in render(scene, turntable):  # doctest: +SKIP
        ...     Image.fromarray(picture.numpy()).save(name)
    """
    count = FRAMES if frames is None else frames
    picked = None if around is None else scene.to_splats(find_object(scene, around))
    if has_rendered_views(scene):
        views = scene.cameras if size is None else scene.cameras.resize(*size)
        return orbit_around(content_of(scene.splats, picked), views, count)
    content = None if picked is None else content_of(scene.splats, picked)
    path = orbit_cameras(scene.cameras, count, content and content.extent.centre)
    path = path if size is None else path.resize(*size)
    return path if content is None else zoom_to_content(path, content)
