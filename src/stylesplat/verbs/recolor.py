"""`recolor`: change the colours of objects, at once and without a style."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import torch

from stylesplat.argument_kinds import check_arguments
from stylesplat.color.recolor import recolor_map
from stylesplat.color.recolor_config import RecolorConfig, recolor_config
from stylesplat.errors import StyleSplatError
from stylesplat.io.style_pictures import read_style, resize
from stylesplat.progress import say
from stylesplat.scene.arguments import check_intensity
from stylesplat.scene.compose import beneath, family, with_layers
from stylesplat.scene.layer import RECOLOR, recoloring
from stylesplat.scene.scene import Scene, check_name_or_id
from stylesplat.selection.choose import background_of, find_object
from stylesplat.stylization.style import source_of
from stylesplat.stylization.style_image import all_colors

BACKGROUND = "background"
PICTURE_SIDE = 256.0  # pixels of the picture whose colours are matched


@check_arguments
def recolor(
    scene: Scene,
    objects: str | Sequence[str],
    *,
    strength: float = 1.0,
    **settings: Any,
) -> Scene:
    """Change the colours of objects, each by a layer of its own.

    The new layer goes on top of the stack and applies to the object's paint, too; paint that comes
    later covers it. A recolouring that the object has is replaced, in its place in the stack
    unless the object was painted since. `adjust` changes its strength or removes it, by the name
    `OBJECT/recolor`.

    Args:
        scene: What to recolour.
        objects: Names or label ids; `background` is what belongs to no object.
        strength: How much of the change to blend in, 0 to 1.5.
        settings: Fields of `RecolorConfig`: `hue`, `saturation`, `brightness`, `contrast`,
            `temperature`, `tint`, and `match`, a picture's file.

    Raises:
        StyleSplatError: If there is no such object or it has no Gaussians, a setting is out of
            range, or nothing would change.

    Example:
        >>> recolor(scene, "vase", hue=120, saturation=1.3)  # doctest: +SKIP
        >>> recolor(scene, "background", saturation=0, strength=0.8)  # doctest: +SKIP
    """
    check_intensity(strength)
    config = recolor_config(settings)
    if not objects:
        raise StyleSplatError("Nothing to recolor. Name an --object, or background.")
    for name in dict.fromkeys([objects] if isinstance(objects, str) else objects):
        scene = _recolored(scene, name, config, strength)
    # What was measured of a style before is no longer true
    return replace(scene, metrics={"train": scene.metrics.get("train", scene.metrics)})


def _recolored(scene: Scene, name: str, config: RecolorConfig, strength: float) -> Scene:
    check_name_or_id(name)
    known = {*scene.objects, *scene.painted_objects}
    is_background = name == BACKGROUND and name not in known
    whole = background_of(scene) if is_background else find_object(scene, name)
    rows = whole[: len(scene.unpainted)].nonzero()[:, 0].cpu()
    if not len(rows):
        raise StyleSplatError(f"Cannot recolor {name}: it has no Gaussians. Select it again.")
    under, place = beneath(scene, f"{name}{RECOLOR}")
    layers = [each for each in scene.layers if each.name != f"{name}{RECOLOR}"]
    if any(each.object == name for each in layers[place:]):
        say(f"{name} was painted since it was recolored: the new colours go on top of the paint.")
        under, place = with_layers(scene, layers), len(layers)
    own = torch.zeros(len(scene.unpainted), dtype=torch.bool).index_fill(0, rows, True)
    mask = own[family(under)].to(under.splats.device)
    picture = None
    if config.match:
        picture = all_colors([resize(read_style(config.match), PICTURE_SIDE)])
    layer = recoloring(
        name,
        rows,
        recolor_map(config, under.splats, mask, scene.cameras, picture),
        strength=strength,
        styles=(source_of(config.match),) if config.match else (),
        settings={key: value for key, value in config.changed.items() if key != "match"},
    )
    return with_layers(scene, [*layers[:place], layer, *layers[place:]])
