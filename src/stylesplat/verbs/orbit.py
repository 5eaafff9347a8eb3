"""`orbit`: cameras of a round trip."""

from stylesplat.argument_kinds import check_arguments
from stylesplat.figures.orbits import filled, orbit_around, orbit_cameras
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.content import content_of
from stylesplat.scene.framing import has_no_photos
from stylesplat.scene.scene import Scene
from stylesplat.selection.choose import find_object

FRAMES, FPS = 180, 30  # six seconds


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
    picked = None if around is None else find_object(scene, around)
    if has_no_photos(scene):
        splats, views = scene.splats, scene.cameras
        content = content_of(splats, picked)
        return orbit_around(content, views if size is None else views.resize(*size), count)
    content = None if picked is None else content_of(scene.splats, picked)
    path = orbit_cameras(scene.cameras, count, content and content.extent.centre)
    path = path if size is None else path.resize(*size)
    return path if content is None else filled(path, content)
