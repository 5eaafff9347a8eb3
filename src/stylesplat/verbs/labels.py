"""`labels`: the labels of a scene lifted anew, from corrected label maps."""

from dataclasses import replace
from pathlib import Path

from stylesplat.argument_kinds import check_arguments
from stylesplat.errors import StyleSplatError
from stylesplat.io.captures.capture_folder import OBJECT_MASK, with_drawn_maps
from stylesplat.masks.import_masks import import_label_maps, refuse_plain
from stylesplat.masks.quick_splat import rendered_capture
from stylesplat.progress import say
from stylesplat.rendering.render import pick_device
from stylesplat.scene.capture import Capture, at_most
from stylesplat.scene.frames import with_poses_of
from stylesplat.scene.scene import Scene
from stylesplat.selection.choose import SHAPING
from stylesplat.selection.identities import object_ids
from stylesplat.selection.objects import relabel
from stylesplat.verbs.import_ import WORKING_SIZE
from stylesplat.verbs.load import load
from stylesplat.verbs.select import select

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
        before = () if SHAPING & each.how.keys() else tuple(each.how.get("ids", ()))
        if ids := [id for id in before if id in known]:
            found = select(found, name, id=ids, threshold=each.how.get("threshold", 0.5))
            found = _without_parts(found, name, scene)
        elif before:
            say(f"{name!r} is gone: the label maps do not contain its id.")
        else:
            found = found.with_object(name, each)
    metrics = {name: value for name, value in scene.metrics.items() if name not in STALE}
    return replace(found, metrics=metrics)


def _without_parts(found: Scene, name: str, scene: Scene) -> Scene:
    """The scene whose object has lost what parts were made of it before."""
    again = found.objects[name]
    left = again.picked.clone()
    for part in scene.objects.values():
        if part.how.get("of") == name:
            left &= ~part.picked
    how = {**again.how, "gaussians": int(left.sum())}
    return found.with_object(name, replace(again, picked=left, how=how))


def _with_masks(scene: Scene, masks: Path | str | None) -> Capture:
    """The photos of a scene, or its renders if they are gone, with the label maps of a folder."""
    photos = scene.capture if scene.capture is not None and scene.capture.is_dir() else None
    if masks is None:
        if photos is None:
            raise StyleSplatError("The scene's photos are not there. Say --masks, a folder.")
        masks = photos / OBJECT_MASK
    cpu = pick_device("cpu")
    capture = rendered_capture(scene, cpu) if photos is None else load(photos, masks=False)
    found = import_label_maps(Path(masks), capture.cameras.names)
    return with_drawn_maps(capture, found.maps, found.names)
