"""`adjust`: change how strong a style is, afterwards and without optimising."""

from collections.abc import Sequence
from dataclasses import replace

from stylesplat.argument_kinds import check_arguments
from stylesplat.errors import StyleSplatError
from stylesplat.scene.intensity import check_intensity
from stylesplat.scene.scene import Scene
from stylesplat.stylization.bookkeeping import at_intensities
from stylesplat.stylization.undo import require_painted_objects, unpainted


@check_arguments
def adjust(
    scene: Scene,
    intensity: float | None = None,
    *,
    objects: str | Sequence[str] = (),
    undo: bool = False,
) -> Scene:
    """Blend the styled colours of a scene with those before, or take the style back.

    Renders are linear in the colours, so this blends the renders, wherever no colour is clamped.

    Args:
        scene: A styled scene.
        intensity: 0 for what was before, 1 for the style's, up to 1.5 to exaggerate.
        objects: What to adjust; all that were styled by default.
        undo: Give the scene as it was before these objects were styled, to the bit; what else was
            styled stays as it is.

    Raises:
        StyleSplatError: If the scene is not styled, or not in these objects, or nothing says what
            to do.
    """
    names = [objects] if isinstance(objects, str) else list(objects)
    if undo:
        return unpainted(scene, names or None)
    if intensity is None:
        raise StyleSplatError("Nothing to adjust. Pass an --intensity F, or --undo.")
    check_intensity(intensity)
    painted = require_painted_objects(scene, names)
    scene = at_intensities(scene, dict.fromkeys(names or painted.names, float(intensity)))
    # What was measured of the style before is no longer true
    return replace(scene, metrics={"train": scene.metrics.get("train", {})})
