"""`mask`: give a capture its label maps, or a scene without photos its objects."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args

from stylesplat.argument_kinds import check_arguments
from stylesplat.errors import StyleSplatError, check_choice
from stylesplat.io.captures.capture_folder import with_drawn_maps
from stylesplat.masks import sam
from stylesplat.masks.from_boxes import Boxes, Strokes, mask_boxes, refuse_without_box
from stylesplat.masks.from_model import mask_with_model
from stylesplat.masks.import_masks import check_mask_source, import_label_maps, refuse_plain
from stylesplat.masks.quick_splat import rendered_capture
from stylesplat.rendering.render import pick_device
from stylesplat.scene.capture import Capture
from stylesplat.scene.framing import has_no_photos
from stylesplat.scene.scene import Scene
from stylesplat.selection.objects import relabel

Photos = TypeVar("Photos", Capture, Scene)
Method = Literal["files", "grabcut"] | sam.Method
# The arguments of each method; others would have no effect
MARKS = {"strokes", "keep", "drop"}
TAKES = {"files": {"source"}, "grabcut": {"boxes", "scene"} | MARKS}
MODELS_TAKE = {"model", "scene", "progress"}


@check_arguments
def mask(
    capture: Photos,
    *,
    boxes: Boxes | None = None,
    strokes: Strokes | None = None,
    keep: Boxes | None = None,
    drop: Boxes | None = None,
    source: Path | str | None = None,
    method: Method | None = None,
    model: str | None = None,
    scene: Scene | None = None,
    device: str = "auto",
    progress: Path | None = None,
) -> Photos:
    """Say what object each pixel of the photos shows.

    A scene that came without photos is masked in renders of its views, under their names; what
    they show is lifted onto its Gaussians. Objects from boxes join those that it has, or replace
    those of the same names; others replace all that were chosen by label.

    Boxes and strokes are in pixels of the photos at full size, also where the capture was loaded
    with a `downscale`.

    Args:
        capture: Posed photos, whose label maps matter only if they are corrected. Or a scene that
            was imported without photos.
        boxes: By object's name a view and a rectangle around the object, `(view, x0, y0, x1, y1)`
            or `(view, (x0, y0, x1, y1))`; several in a list. One view often suffices.
        strokes: By object's name a view, and a line over the object or over what is not; several
            in a list.
        keep: By object's name a view and a rectangle in which all that shows belongs to the
            object, as `boxes` are written. What is marked in one photo is so in all. Strokes,
            `keep` and `drop` without `boxes` correct the label maps that the capture has.
        drop: The same where nothing that shows belongs to it.
        source: Masks of another program: a folder of id pictures named like the photos or with a
            sub-folder of binary masks per object, or COCO JSON with RLE masks.
        method: `files` takes the masks in `source` and `grabcut` cuts out what the boxes hold, by
            default what is given; the others find all objects with a model of that family.
        model: Folder or hub name of a checkpoint; by default a small one of the family.
        scene: A scene of these photos, on which the masks of different photos meet; by default a
            splat is trained for about a minute. Renders of a scene meet on that scene.
        device: Where to compute: `auto`, `cpu` or `cuda`.
        progress: A folder for what a model has found so far, from where an interrupted run goes
            on. It stays until its owner removes it.

    Returns:
        The same photos with label maps of their size, made on access, and the objects' names. Of
        a scene that scene, its objects with names.

    Raises:
        StyleSplatError: If nothing says what to mask, something given does not fit the photos or
            means nothing with the method, an object cannot be called so, a model cannot be had,
            or nothing is found. If a scene has photos, which are what to mask then.
    """
    if isinstance(capture, Scene):
        if scene is not None:
            raise StyleSplatError("`scene` means nothing for a scene. Leave it out.")
        options = {"boxes": boxes, "strokes": strokes, "keep": keep, "drop": drop}
        options |= {"source": source, "method": method, "model": model, "progress": progress}
        return _mask_scene(capture, options, device)
    drawn = {"boxes": boxes or {}, "strokes": strokes or {}, "keep": keep or {}, "drop": drop or {}}
    given = {**drawn, "source": source, "model": model}
    method = settled_method(method, given | {"scene": scene, "progress": progress})
    if method == "files":
        assert source is not None
        found = import_label_maps(Path(source), capture.cameras.names)
        maps = (drawn.read() for drawn in found.maps.values())
        refuse_plain(maps, f"The masks in {source}", "Make them anew.")
        return with_drawn_maps(capture, found.maps, found.names)
    if method == "grabcut":
        return mask_boxes(capture, **drawn, scene=scene, device=device)
    return mask_with_model(
        capture, method, model=model, scene=scene, device=device, progress=progress
    )


def settled_method(method: Method | None, given: Mapping[str, Any]) -> Method:
    """The method that the other arguments of `mask` imply, by name; photos are not needed.

    Refuses arguments that the method does not take, and files that are missing.
    """
    source = given.get("source")
    method = method or ("grabcut" if source is None else "files")
    check_choice(method, "method", ("files", "grabcut", *get_args(sam.Method)))
    for name, value in given.items():
        if value and name not in TAKES.get(method, MODELS_TAKE):
            raise StyleSplatError(
                f"`{name}` means nothing with the method `{method}`. Leave it out."
            )
    if method == "files":
        if source is None:
            raise StyleSplatError("Say with --from where the masks are; in Python, with `source`.")
        check_mask_source(Path(source))
    if method == "grabcut" and (given.get("boxes") or not any(given.get(n) for n in MARKS)):
        refuse_without_box(given.get("boxes") or {})
    return method


def _mask_scene(scene: Scene, options: dict[str, Any], device: str) -> Scene:
    """Mask renders of a scene without photos, and lift the labels onto it."""
    if not has_no_photos(scene):
        raise StyleSplatError(
            "This scene was made from photos. Mask those, and train or import again; or name what "
            "it has with `select`."
        )
    place = pick_device(device)
    foreign = options["method"] == "files" or options["source"] is not None
    masked = mask(
        rendered_capture(scene, place), **options, scene=None if foreign else scene, device=device
    )
    drawn = options["method"] in (None, "grabcut") and not foreign
    return relabel(scene, masked, add=drawn, device=place)
