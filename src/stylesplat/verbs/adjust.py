"""`adjust`: change how strong a style is, afterwards and without optimising."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Bool
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.io.files import refuse_occupied
from stylesplat.io.scene_folder import SCENE, Scene, read_scene, update_colors, write_scene
from stylesplat.scene.splats import Splats
from stylesplat.stylization.color import blend_colors
from stylesplat.stylization.style_config import check_intensity
from stylesplat.verbs.objects import find_object


def adjust_scene(
    path: Path,
    intensity: float | None,
    *,
    names: Sequence[str] = (),
    output: Path | None = None,
    overwrite: bool = False,
) -> dict[str, Any]:
    """Blend the styled colours of a scene with those before, exactly: renders are linear in them.

    Args:
        path: A styled scene.
        intensity: 0 for the colours before, 1 for the style's, up to 1.5 to exaggerate.
        names: Objects to adjust; all that were styled by default.
        output: A scene to make; by default the scene itself is changed. Either can be adjusted
            again, back to what it was too.
        overwrite: Whether `output` may hold a scene already.

    Returns:
        The intensity of each styled object, and the `scene`.

    Raises:
        StyleSplatError: If the scene is not styled, or not in these objects.
    """
    if intensity is None:
        raise StyleSplatError(
            f"Nothing to adjust in {path}. Pass --intensity F, or --undo with a folder to write to."
        )
    check_intensity(intensity)
    if output is not None and not overwrite:
        refuse_occupied(output, marker=SCENE)
    scene = read_scene(path)
    objects = _styled_objects(scene, path)
    unknown = next((name for name in names if name not in objects), None)
    if unknown is not None:
        raise StyleSplatError(
            f"{unknown} is not styled in {path}. Styled objects: {', '.join(objects)}."
        )
    picks = {name: find_object(scene, name) for name in objects}
    base = replace(scene.splats, **(scene.base_colors or {}))
    full = replace(scene.splats, **(scene.style_colors or {}))
    splats = scene.splats
    for name in names or objects:
        splats = _repainted(splats, base, full, picks[name], intensity)
        objects[name] = {**objects[name], "intensity": intensity}
    scene = replace(
        scene,
        splats=splats,
        recipe={**(scene.recipe or {}), "objects": list(objects.values())},
        metrics={"train": scene.metrics.get("train", {})},  # the others are no longer true
    )
    if output is None:
        update_colors(scene, path)
    else:
        write_scene(scene, output, overwrite=overwrite)
    shown = {name: how["intensity"] for name, how in objects.items()}
    return {"scene": output or path, "intensity": shown}


def undo_scene(path: Path, output: Path | None, *, overwrite: bool = False) -> dict[str, Any]:
    """Write a styled scene as it was before, to the bit.

    Args:
        path: A styled scene, which stays.
        output: The scene to make.
        overwrite: Whether `output` may hold a scene already.

    Raises:
        StyleSplatError: If the scene is not styled, or there is no `output`.
    """
    if output is None:
        raise StyleSplatError(
            "Undoing keeps the styled scene. Pass a folder for the other with -o."
        )
    if not overwrite:
        refuse_occupied(output, marker=SCENE)
    write_scene(unstyled(read_scene(path), path), output, overwrite=overwrite)
    return {"scene": output}


def unstyled(scene: Scene, path: Path) -> Scene:
    """The scene before it was styled.

    Raises:
        StyleSplatError: If it is not styled.
    """
    if scene.base_colors is None:
        raise StyleSplatError(f"{path} is not styled: there is nothing to undo.")
    splats = replace(scene.splats, **scene.base_colors)
    # `stylize` names what label ids meant
    picks = {name: picked for name, picked in scene.picks.items() if not name.isdecimal()}
    if scene.unsplit is not None:
        shape = scene.unsplit
        splats = splats[torch.arange(shape.count)]
        splats = replace(
            splats,
            scales=splats.scales.index_copy(0, shape.rows, shape.scales),
            opacities=splats.opacities.index_copy(0, shape.rows, shape.opacities),
        )
        picks = {name: picked[: shape.count] for name, picked in picks.items()}
    return replace(
        scene,
        splats=splats,
        picks=picks,
        base_colors=None,
        style_colors=None,
        unsplit=None,
        recipe=None,
        metrics=scene.metrics.get("train", {}),
    )


def _styled_objects(scene: Scene, path: Path) -> dict[str, dict[str, Any]]:
    """What the recipe says of each styled object, its intensity included."""
    recipe = scene.recipe or {}
    default = {"intensity": recipe.get("settings", {}).get("intensity", 1.0)}
    objects = {how["name"]: default | how for how in recipe.get("objects", [])}
    if scene.base_colors is None or scene.style_colors is None or not objects:
        raise StyleSplatError(
            f"{path} is not styled. Style it with `stylesplat stylize {path} --style OBJECT=IMAGE`."
        )
    return objects


def _repainted(
    splats: Splats, base: Splats, styled: Splats, picked: Bool[Tensor, " N"], intensity: float
) -> Splats:
    """The splats with the picked colours between base and styled."""
    return blend_colors(splats, blend_colors(base, styled, picked, intensity), picked, 1.0)
