"""`stylesplat mask SCENE`, of a scene without photos: the objects go into the scene."""

import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stylesplat.cli.next_steps import next_lines, stylize_command
from stylesplat.cli.optional_pictures import told_if_missing
from stylesplat.cli.options import refuse_given
from stylesplat.cli.results import save_or_rescue
from stylesplat.errors import StyleSplatError

if TYPE_CHECKING:
    from stylesplat.cli.mask import Mask, Method
    from stylesplat.cli.options import Device
    from stylesplat.masks.from_boxes import Boxes, Strokes
    from stylesplat.scene.scene import Scene

PREVIEW = "masks.jpg"  # in the scene's folder


def is_without_photos(folder: Path) -> bool:
    """Whether a folder is a scene that was imported without photos.

    Raises:
        StyleSplatError: If it is a scene that cannot be read.
    """
    from stylesplat.io.kinds import SCENE
    from stylesplat.io.scene_folder import open
    from stylesplat.scene.framing import has_no_photos

    # Unlike Path.is_file, it takes any name
    return os.path.isfile(folder / SCENE) and has_no_photos(open(folder))  # noqa: PTH113


def mask_scene(
    command: "Mask", method: "Method", boxes: "Boxes", strokes: "Strokes"
) -> dict[str, Any]:
    """Mask the views of a scene.

    Raises:
        StyleSplatError: As `mask` does; or if all labels of the scene would be lost, or the output
            holds something, and `--overwrite` is not given.
    """
    from stylesplat.io.atomic import changing, partial_of, refuse_occupied, refuse_unwritable
    from stylesplat.io.kinds import SCENE
    from stylesplat.io.scene_folder import open
    from stylesplat.verbs.mask import mask

    refuse_given(command, ("scene",), "a scene, which is that scene itself")
    place = command.output or command.capture
    with changing(place):
        if command.output is None:
            refuse_unwritable(place)
        else:
            refuse_occupied(place, marker=SCENE, overwrite=command.overwrite)
        before = open(command.capture)
        if method != "grabcut" and before.splats.classifier and not command.overwrite:
            raise StyleSplatError(
                f"{command.capture} knows objects already, which --method {method} would replace. "
                "Pass --overwrite, or add objects with --box."
            )
        progress = None if method in ("grabcut", "files") else partial_of(place / "masks")
        after = mask(
            before,
            boxes=boxes,
            strokes=strokes,
            source=command.source,
            method=method,
            model=command.model,
            device=command.device,
            progress=progress,
        )
        if command.output is None:
            _revise(before, after, place)
        else:
            save_or_rescue(after, place, overwrite=command.overwrite)
        if progress:
            shutil.rmtree(progress, ignore_errors=True)
        return _result(after, place, command.device)


def scene_words(result: dict[str, Any]) -> Iterator[str]:
    """What was made, and how to go on."""
    names = list(result["names"].values())
    yield f"{result['scene']}: it has {', '.join(names) or 'no objects'} now."
    if result["preview"]:
        yield f"Picture: {result['preview']}, what its Gaussians belong to in some of the views."
    if names:
        yield from next_lines(stylize_command(result["scene"], names[-1]))


def _revise(before: "Scene", after: "Scene", place: Path) -> None:
    """Change the scene, and take away pictures of selections that are others now, or none."""
    from stylesplat.cli.select import picture_of
    from stylesplat.io.scene_folder import revise

    same = {name for name, each in before.objects.items() if after.objects.get(name) is each}
    old = [picture_of(place, name) for name in before.objects if name not in same]
    revise(before, after, place)
    for picture in old:
        picture.unlink(missing_ok=True)


def _result(scene: "Scene", place: Path, device: "Device") -> dict[str, Any]:
    from stylesplat.io.atomic import changing
    from stylesplat.selection.choose import names_of
    from stylesplat.selection.identities import object_ids

    ids = object_ids(scene.splats)
    names = {id: name for id in ids for name in names_of(scene, id)[:1]}
    shown = None
    with told_if_missing(), changing(place / PREVIEW):
        shown = _draw(scene, names, place / PREVIEW, device)
    return {
        "scene": place,
        "preview": None if shown is None else place / PREVIEW,
        "photos": shown,
        "of": len(scene.cameras),
        "ids": list(ids),
        "names": names,
    }


def _draw(scene: "Scene", names: dict[int, str], target: Path, device: "Device") -> int:
    """Draw what the Gaussians' labels look like in the views; how many of these show any."""
    from dataclasses import replace

    from stylesplat.figures.sheets import mask_preview
    from stylesplat.io.images import write_image
    from stylesplat.masks.quick_splat import rendered_capture
    from stylesplat.rendering.device import pick_device
    from stylesplat.scene.capture import at_most
    from stylesplat.selection.identities import render_labels

    place = pick_device(device)
    small, splats = at_most(rendered_capture(scene, place), 480), scene.splats.to(place)
    maps = [render_labels(splats, small.cameras[row]).cpu() for row in range(len(small))]
    write_image(mask_preview(replace(small, label_maps=maps), names), target)
    return sum(bool(labels.any()) for labels in maps)
