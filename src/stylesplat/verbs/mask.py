"""`mask`: a capture's label maps, or a scene's objects; `labels`: a scene's labels lifted anew."""

from dataclasses import fields, replace
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args

from stylesplat.errors import StyleSplatError, check_choice
from stylesplat.io.captures.capture_folder import OBJECT_MASK, load, with_drawn_maps
from stylesplat.masks import sam
from stylesplat.masks.from_boxes import Boxes, FromBoxes, Strokes
from stylesplat.masks.from_model import FromModel
from stylesplat.masks.import_masks import FromFiles, import_label_maps, refuse_plain
from stylesplat.masks.working_splat import rendered_capture
from stylesplat.options import check_arguments
from stylesplat.progress import say
from stylesplat.rendering.render import pick_device
from stylesplat.scene.capture import Capture, at_most
from stylesplat.scene.frames import with_poses_of
from stylesplat.scene.scene import Scene
from stylesplat.scene.selection import Selection
from stylesplat.scene.virtual_cameras import has_rendered_views
from stylesplat.selection.labels import object_ids
from stylesplat.selection.objects import relabel
from stylesplat.selection.resolve import resolve_selection
from stylesplat.verbs.import_ import WORKING_SIZE

STALE = ("confidence", "unseen_gaussians", "miou", "boundary_miou")  # metrics of earlier labels


@check_arguments
def labels(
    scene: Scene, masks: Path | str | Capture | None = None, *, device: str = "auto"
) -> Scene:
    """Lift label maps onto a scene anew, without training. Nothing but the labels changes.

    Objects that are named by label ids get the Gaussians that have these ids now, without those of
    their parts; other selections keep theirs. Held-out views are not lifted, so that they can
    measure the labels.

    Args:
        scene: A trained or imported scene, painted or not.
        masks: The folder of label maps, or COCO JSON, as `mask` takes them; or the scene's photos
            with label maps [H, W]. By default the `object_mask/` of the scene's capture.
        device: Where to compute.

    Returns:
        The scene with other labels. Metrics of its labels are dropped: `evaluate` measures them.

    Raises:
        StyleSplatError: If there are no label maps, they are of other photos or sizes, or show
            nothing but background or nothing but one object.

    Example:
        >>> scene = labels(scene, "garden/object_mask")  # doctest: +SKIP
    """
    place = pick_device(device)
    capture = masks if isinstance(masks, Capture) else _with_masks(scene, masks)
    training = {*scene.views("train").names}
    rows = [row for row, name in enumerate(capture.cameras.names) if name in training]
    maps = map(capture.labels, rows)
    refuse_plain(maps, "The label maps of this scene's training photos", "Check --masks.")
    small = with_poses_of(at_most(capture.only(rows), WORKING_SIZE), scene.cameras)
    found = relabel(scene, small, add=False, device=place)
    known = object_ids(found.splats)
    for name, each in scene.objects.items():
        if name in found.objects:
            continue
        old = each.selection
        before = old.ids if old.is_whole else ()
        if ids := [id for id in before if id in known]:
            rules = {"threshold": old.threshold, "keep_outliers": old.keep_outliers}
            again = resolve_selection(found, Selection(ids=tuple(ids), **rules))
            for part in scene.objects.values():
                if part.selection.of == name:
                    again = replace(again, mask=again.mask & ~part.mask)
            found = found.with_object(name, again)
        elif before:
            say(f"{name!r} is gone: the label maps do not contain its id.")
        else:
            found = found.with_object(name, each)
    metrics = {name: value for name, value in scene.metrics.items() if name not in STALE}
    return replace(found, metrics=metrics)


def _with_masks(scene: Scene, masks: Path | str | None) -> Capture:
    """The photos of a scene, or its renders if they are gone, with the label maps of a folder."""
    photos = scene.capture if scene.capture is not None and scene.capture.is_dir() else None
    if masks is None:
        if photos is None:
            raise StyleSplatError("The scene's photos are not there. Say --masks, a folder.")
        masks = photos / OBJECT_MASK
    cpu = pick_device("cpu")
    capture = rendered_capture(scene, cpu) if photos is None else load(photos, masks=False)
    return with_drawn_maps(capture, import_label_maps(Path(masks), capture.cameras.names))


Photos = TypeVar("Photos", Capture, Scene)
MaskMethod = Literal["files", "grabcut"] | sam.SamMethod
MaskSource = FromFiles | FromBoxes | FromModel


@check_arguments
def mask(
    capture: Photos,
    *,
    boxes: Boxes | None = None,
    strokes: Strokes | None = None,
    keep: Boxes | None = None,
    drop: Boxes | None = None,
    source: Path | str | None = None,
    method: MaskMethod | None = None,
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
            splat is trained for a minute or more. Renders of a scene meet on that scene.
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
    if isinstance(capture, Scene) and scene is not None:
        raise StyleSplatError("`scene` means nothing for a scene. Leave it out.")
    drawn = {"boxes": boxes, "strokes": strokes, "keep": keep, "drop": drop}
    given = {"source": None if source is None else Path(source), "model": model, "scene": scene}
    masks = mask_source(method, **drawn, **given, progress=progress)
    if not isinstance(capture, Scene):
        return masks.mask(capture, device)
    if not has_rendered_views(capture):
        raise StyleSplatError(
            "This scene was made from photos. Mask those, and train or import again; or name what "
            "it has with `select`."
        )
    place = pick_device(device)
    views = rendered_capture(capture, place)
    if not isinstance(masks, FromFiles):
        masks = replace(masks, scene=capture)
    masked = masks.mask(views, device)
    return relabel(capture, masked, add=isinstance(masks, FromBoxes), device=place)


def mask_source(method: MaskMethod | None, **given: Any) -> MaskSource:
    """Where masks come from, by the arguments of `mask`; photos are not needed.

    Refuses arguments that the method does not take, and files that are missing.
    """
    method = method or ("grabcut" if given.get("source") is None else "files")
    check_choice(method, "method", ("files", "grabcut", *get_args(sam.SamMethod)))
    kinds: dict[str, type[MaskSource]] = {"files": FromFiles, "grabcut": FromBoxes}
    kind, given = kinds.get(method, FromModel), {name: v for name, v in given.items() if v}
    known = {each.name for each in fields(kind)}
    if idle := [name for name in given if name not in known]:
        raise StyleSplatError(
            f"`{idle[0]}` means nothing with the method `{method}`. Leave it out."
        )
    if kind is FromFiles and "source" not in given:
        raise StyleSplatError("Say with --from where the masks are; in Python, with `source`.")
    if method not in ("files", "grabcut"):
        given["family"] = method
    return kind(**given)
