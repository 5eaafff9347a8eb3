"""`stylesplat mask`."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from tyro.conf import Positional, UseAppendAction, arg

from stylesplat.cli.options import Device, Json, Overwrite, refuse_given
from stylesplat.cli.parse import parse_named_box, parse_stroke
from stylesplat.errors import StyleSplatError

if TYPE_CHECKING:
    from stylesplat.masks.boxes.grabcut import Stroke

DRAWN = ("box", "stroke", "not_stroke")  # what is drawn in photos


@dataclass(frozen=True)
class Mask:
    """Give photos their label maps, which say what object each pixel shows.

    Example: stylesplat mask garden --box vase=IMG_0007.jpg:500,300,800,700
    """

    capture: Positional[Path]
    """Folder with the posed photos; the label maps go into its object_mask/."""
    method: Literal["files", "grabcut", "sam", "sam2", "edgetam", "sam3"] | None = None
    """files takes masks of another program and grabcut cuts out what boxes hold, by default what
    the other options call for; the others find all objects with that model."""
    source: Annotated[Path | None, arg(name="from")] = None
    """What another program made: a folder with pictures of ids named like the photos (DEVA,
    Gaussian Grouping), or with a sub-folder of binary masks per object; or COCO JSON with RLE."""
    box: UseAppendAction[tuple[str, ...]] = ()
    """NAME=VIEW:x0,y0,x1,y1 around an object, in photo pixels. May be repeated, for other objects
    and for other photos of the same; one photo often suffices."""
    stroke: UseAppendAction[tuple[str, ...]] = ()
    """NAME=VIEW:x,y,x,y,... along a line over an object that has a box there, where the cut took
    it for background. May be repeated."""
    not_stroke: UseAppendAction[tuple[str, ...]] = ()
    """The same over what is not the object, where the cut took too much."""
    model: str | None = None
    """Folder or hub name of another checkpoint of the method."""
    scene: Path | None = None
    """A scene of these photos, on which masks of different photos meet; by default a splat is
    trained for about a minute."""
    device: Device = "auto"
    """Where to compute; auto takes an NVIDIA GPU where there is one."""
    overwrite: Overwrite = False
    json: Json = False

    def run(self) -> dict[str, Any]:
        """Do it."""
        from stylesplat.verbs.mask import import_masks
        from stylesplat.verbs.mask_boxes import mask_boxes
        from stylesplat.verbs.mask_models import mask_with_model

        method = self.method or ("files" if self.source else "grabcut")
        if method == "files":
            refuse_given(self, (*DRAWN, "scene", "model"), f"--method {method}")
            if self.source is None:
                raise StyleSplatError("Say with --from where the masks are.")
            return import_masks(self.capture, self.source, overwrite=self.overwrite)
        refuse_given(self, ("source",), f"--method {method}")
        common = {"scene": self.scene, "device": self.device, "overwrite": self.overwrite}
        if method == "grabcut":
            refuse_given(self, ("model",), f"--method {method}")
            boxes = [parse_named_box(each) for each in self.box]
            return mask_boxes(self.capture, boxes, strokes=self._strokes(), **common)
        refuse_given(self, DRAWN, f"--method {method}")
        return mask_with_model(self.capture, method, model=self.model, **common)

    def _strokes(self) -> list[tuple[str, str, "Stroke"]]:
        from stylesplat.masks.boxes.grabcut import Stroke

        return [
            (name, view, Stroke(points, over_object))
            for texts, over_object in ((self.stroke, True), (self.not_stroke, False))
            for name, view, points in map(parse_stroke, texts)
        ]
