"""`adjust`: change how strong layers of paint are, afterwards and without optimising."""

from collections.abc import Sequence
from dataclasses import replace

from stylesplat.argument_kinds import check_arguments
from stylesplat.errors import StyleSplatError
from stylesplat.scene.arguments import check_intensity
from stylesplat.scene.compose import (
    named_layers,
    require_painted,
    strengths_of,
    with_strengths,
    without_layers,
)
from stylesplat.scene.layer import RECOLOR
from stylesplat.scene.scene import Scene


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
        form: How much of the object's own light and relief shows in the paint, 0 to 1.5.
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
        return without_layers(scene, names or None)
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
    scene = with_strengths(scene, strengths, forms)
    # What was measured of the style before is no longer true
    return replace(scene, metrics={"train": scene.metrics.get("train", {})})
