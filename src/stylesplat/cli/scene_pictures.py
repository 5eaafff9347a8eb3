"""Pictures that commands leave in the scenes that they make."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stylesplat.cli.optional_pictures import told_if_missing

if TYPE_CHECKING:
    from jaxtyping import UInt8
    from torch import Tensor

    from stylesplat.scene.capture import Capture
    from stylesplat.scene.scene import Scene
    from stylesplat.stylization.object_views import Box

BEFORE_AFTER = "before_after.png"
PHOTO_AND_RENDER = "photo_and_render.png"
VIEW = "view.png"


def write_before_after(
    scene: "Scene",
    folder: Path,
    *,
    surveys: "Mapping[str, Sequence[Box]] | None" = None,
    device: str = "auto",
) -> dict[str, Any]:
    """Draw what was painted on a scene; where, and in which view, see `before_after`."""
    from stylesplat.figures.sheets import before_after

    views = list[str]()

    def draw() -> "UInt8[Tensor, 'H W 3'] | None":
        found = before_after(scene, surveys=surveys, device=device)
        if found is None:
            return None
        views.append(found[0])
        return found[1]

    path = _written(draw, folder / BEFORE_AFTER)
    return {"before_after": path} | ({"before_after_view": views[0]} if path else {})


def before_after_line(result: Mapping[str, Any]) -> Iterator[str]:
    """Where that picture is and which view it shows, if there is one."""
    if result["before_after"]:
        yield f"Picture: {result['before_after']} (view {result['before_after_view']})"


def look(
    scene: "Scene", capture: "Capture | None", folder: Path, *, device: str = "auto"
) -> dict[str, Any]:
    """What a scene that is new shows and knows, for words about it."""
    return {
        "scene": folder,
        "picture": write_look(scene, capture, folder, device=device),
        "objects": sorted(scene.objects),
        "labelled": scene.splats.classifier is not None,
    }


def write_look(
    scene: "Scene", capture: "Capture | None", folder: Path, *, device: str = "auto"
) -> Path | None:
    """Draw a view of a scene beside its photo, one that was not trained on if there is one.

    Without photos the view alone.
    """
    from stylesplat.figures.sheets import beside_photo, one_view

    names = scene.held_out or scene.cameras.names
    name = names[len(names) // 2]
    if capture is None:
        return _written(lambda: one_view(scene, name, device=device), folder / VIEW)
    return _written(
        lambda: beside_photo(scene, capture, name, device=device), folder / PHOTO_AND_RENDER
    )


def _written(draw: "Callable[[], UInt8[Tensor, 'H W 3'] | None]", target: Path) -> Path | None:
    """The picture's file; None if there is nothing to draw, or that fails.

    The scene is there by then, so a picture that cannot be drawn or written is no failure.
    """
    from stylesplat.io.atomic import changing
    from stylesplat.io.images import write_image

    with told_if_missing(), changing(target):
        picture = draw()
        if picture is None:
            target.unlink(missing_ok=True)
            return None
        write_image(picture, target)
        return target
    return None
