"""`adjust`: how strong layers of paint are; `recolor`: objects' colours, without a style."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from stylesplat.errors import StyleSplatError
from stylesplat.io.style_pictures import read_style, resize
from stylesplat.options import check_arguments, check_intensity
from stylesplat.progress import say
from stylesplat.scene.layers import RECOLOR, recoloring, shown_like
from stylesplat.scene.objects import check_name_or_id
from stylesplat.scene.palette import map_palette
from stylesplat.scene.scene import Scene, named_layers, require_painted, strengths_of
from stylesplat.selection.resolve import background_of, find_object
from stylesplat.stylization.colors import hex_of, object_palette, recolor_map, swapped_palette
from stylesplat.stylization.config import RecolorConfig, recolor_config
from stylesplat.stylization.sculpture import with_sculptures
from stylesplat.stylization.style import all_colors, source_of


@check_arguments
def adjust(
    scene: Scene,
    intensity: float | None = None,
    *,
    form: float | None = None,
    objects: str | Sequence[str] = (),
    undo: bool = False,
) -> Scene:
    """Change the strength of layers of paint or the form that shows in them, or remove layers.

    Renders are linear in the colours, so this blends the renders, wherever no colour is clamped.

    Args:
        scene: A styled scene.
        intensity: 0 for what is beneath, 1 for the style's, up to 1.5 to exaggerate.
        form: How much of the object's own light and relief shows in the paint, 0 to 1.5. Above 1
            strokes give way to it, and dark places get room for it; the first time this takes
            some seconds.
        objects: What to adjust; all that were styled by default. `vase/recolor` is what recolours
            the vase, and so is `vase` if it has no paint.
        undo: Give the scene as it was before these objects were styled, to the bit; what else was
            styled stays as it is.

    Raises:
        StyleSplatError: If the scene is not styled, or not in these objects, or nothing says what
            to do.
    """
    require_painted(scene)
    names = named_layers(scene, [objects] if isinstance(objects, str) else objects)
    if undo and (intensity is not None or form is not None):
        raise StyleSplatError(
            "Undoing removes the paint, so it has no intensity or form. Leave out --undo or these."
        )
    if undo:
        return scene.without_layers(names or None)
    if intensity is None and form is None:
        raise StyleSplatError("Nothing to adjust. Pass an --intensity F, a --form F, or --undo.")
    if intensity is not None:
        check_intensity(intensity)
    if form is not None:
        check_intensity(form, "form")
    names = names or [*strengths_of(scene)]
    if form is not None and all(name.endswith(RECOLOR) for name in names):
        raise StyleSplatError(f"{names[0]} has no paint, and form shows in paint only.")
    strengths = {} if intensity is None else dict.fromkeys(names, float(intensity))
    forms = {} if form is None else dict.fromkeys(names, float(form))
    scene = with_sculptures(scene.with_strengths(strengths, forms), forms)
    # What was measured of the style before is no longer true
    return replace(scene, metrics={"train": scene.metrics.get("train", {})})


RECOLOR_BACKGROUND = "background"
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
            `temperature`, `tint`, `swap`, texts of FROM=TO, and `match`, a picture's file.

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


@check_arguments
def palette(scene: Scene, name: str) -> list[str]:
    """The main colours of an object as #rrggbb, the most frequent first, which `swap` exchanges.

    Raises:
        StyleSplatError: If there is no such object.
    """
    mask = scene.to_splats(find_object(scene, name))
    return [hex_of(color) for color in object_palette(scene.splats, mask, scene.cameras)]


def _recolored(scene: Scene, name: str, config: RecolorConfig, strength: float) -> Scene:
    check_name_or_id(name)
    known = {*scene.objects, *scene.painted_objects}
    is_background = name == RECOLOR_BACKGROUND and name not in known
    mask = background_of(scene) if is_background else find_object(scene, name)
    if not mask.any():
        raise StyleSplatError(f"Cannot recolor {name}: it has no Gaussians. Select it again.")
    own = f"{name}{RECOLOR}"
    below, before = scene.below(own), scene.layer(own)
    if any(each.object == name for each in scene.layers[len(below.layers) + 1 :]):
        say(f"{name} was painted since it was recolored: the new colours go on top of the paint.")
        below = scene = scene.without_layers([own])
    picture = None
    if config.match:
        picture = all_colors([resize(read_style(config.match), PICTURE_SIDE)])
    splats, shown = below.splats, below.to_splats(mask)
    palette = swapped_palette(config, splats, shown, scene.cameras)
    if palette is not None:
        rows = shown.nonzero()[:, 0]
        bands = map_palette(splats.sh0[rows], splats.shN[rows], palette)
        splats = splats.with_rows(rows, dict(zip(("sh0", "shN"), bands, strict=True)))
    layer = recoloring(
        name,
        mask.nonzero()[:, 0].cpu(),
        recolor_map(config, splats, shown, scene.cameras, picture),
        palette=palette,
        strength=strength,
        styles=(source_of(config.match),) if config.match else (),
        settings={key: value for key, value in config.changed.items() if key != "match"},
        visible=before is None or before.visible,
    )
    return scene.with_layer(shown_like(layer, before, len(scene.base)))
