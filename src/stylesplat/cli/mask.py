"""`stylesplat mask`: read the photos, find what they show, write the label maps."""

import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from tyro.conf import Positional, UseAppendAction, arg

from stylesplat.cli.mask_scene import is_without_photos, mask_scene, scene_words
from stylesplat.cli.next_steps import next_lines, unused
from stylesplat.cli.optional_pictures import told_if_missing
from stylesplat.cli.options import (
    CONTINUES,
    Device,
    Json,
    OptionalOutput,
    Overwrite,
    Verbose,
    refuse_given,
)
from stylesplat.cli.parse import parse_named_box, parse_stroke
from stylesplat.cli.posed import is_under_way, posed, view_called
from stylesplat.cli.results import write_or_rescue
from stylesplat.io.atomic import partial_of
from stylesplat.scene.arguments import pasted
from stylesplat.signals import WHOLE

if TYPE_CHECKING:
    from stylesplat.io.captures.sfm_file import SfmRecord
    from stylesplat.masks.grabcut import Box, Stroke
    from stylesplat.scene.capture import Capture
    from stylesplat.scene.scene import Scene

Method = Literal["files", "grabcut", "sam", "sam2", "edgetam", "sam3"]

DRAWN = ("box", "stroke", "not_stroke")  # what is drawn in photos
# Options that mean nothing with a method that is no model; the others keep what they have found
REFUSED = {"files": (*DRAWN, "scene", "model"), "grabcut": ("source", "model")}
PREVIEW = "preview.jpg"  # beside the label maps, which are PNGs
MEND = (
    "If a mask is wrong there: again with --overwrite, and a second --box for it in a photo from "
    "another side, or --not-stroke over what it took too much."
)


@dataclass(frozen=True)
class Mask:
    """Give photos their label maps, which say what object each pixel shows.

    Example: stylesplat mask garden --box vase=IMG_0007.jpg:500,300,800,700
    """

    first: ClassVar = ("box", "method", "source")
    capture: Positional[Path]
    """Folder with the posed photos; the label maps go into its object_mask/. Of photos without
    poses, or a video, `sfm` makes a capture first, beside them; the label maps go into that one.
    Or a scene that was imported without photos: views of it are masked, as `render` draws them,
    and the objects go into the scene."""
    method: Method | None = None
    """files takes masks of another program and grabcut cuts out what boxes hold, by default what
    the other options call for; the others find all objects with that model."""
    source: Annotated[Path | None, arg(name="from")] = None
    """What another program made: a folder with pictures of ids named like the photos (DEVA,
    Gaussian Grouping), or with a sub-folder of binary masks per object; or COCO JSON with RLE."""
    box: UseAppendAction[tuple[str, ...]] = ()
    """NAME=VIEW:x0,y0,x1,y1 around an object, in pixels of the photo itself, at its full size. May
    be repeated, for other objects and for other photos of the same; one photo often suffices."""
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
    output: OptionalOutput = None
    """Folder of the scene to make, where a scene is masked; by default it is changed itself."""
    overwrite: Overwrite = False
    verbose: Verbose = False
    json: Json = False

    @property
    def after_interruption(self) -> str:
        """How to go on."""
        if is_under_way(self.capture, beside=self.capture):
            return CONTINUES
        return WHOLE if self._method in REFUSED else CONTINUES

    @property
    def _method(self) -> Method:
        return self.method or ("files" if self.source else "grabcut")

    def run(self) -> dict[str, Any]:
        """Do it."""
        from stylesplat.io.atomic import changing, refuse_occupied
        from stylesplat.io.captures.capture_folder import OBJECT_MASK
        from stylesplat.verbs.load import load

        method = self._method
        self._refuse_contradictions(method)
        if is_without_photos(self.capture):
            return mask_scene(self, method, self._boxes(None), self._strokes(None))
        refuse_given(self, ("output",), "photos, whose label maps go into object_mask/")
        scene = self._scene()
        lines = ((view, None) for view, _ in chain(*self._strokes(None).values()))
        drawn = chain(*self._boxes(None).values(), lines)
        folder = posed(self.capture, beside=self.capture, drawn=drawn)
        output = folder / OBJECT_MASK
        progress = None if method in REFUSED else partial_of(output)
        refuse_occupied(output, marker="", overwrite=True)  # label maps there are told later
        capture = load(folder, masks=False)
        with changing(output):
            return self._mask(capture, scene, output, progress)

    def _refuse_contradictions(self, method: Method) -> None:
        """Say what is wrong with the options before poses are found and photos are read."""
        from stylesplat.verbs.mask import settled_method

        why = f"--method {method}" if self.method or self.source is None else "--from"
        refuse_given(self, REFUSED.get(method, (*DRAWN, "source")), why)
        drawn = {"boxes": self._boxes(None), "strokes": self._strokes(None)}
        settled_method(method, drawn | {"source": self.source})

    def words(self, result: dict[str, Any]) -> Iterator[str]:
        """What was made, and how to go on."""
        if "scene" in result:
            yield from scene_words(result)
            return
        shown = ", ".join(result["names"].get(id, f"id {id}") for id in result["ids"])
        photos = f"{result['photos']} of {result['of']} photos"
        yield f"{result['masks']}: label maps of {photos}, which show {shown or 'no objects'}."
        if result["preview"]:
            yield f"Picture: {result['preview']}, what they say on some of the photos."
            if self.box:
                yield MEND
        scene = unused(self.capture, "-scene")
        yield from next_lines(pasted("train", self.capture, "-o", scene))

    def _mask(
        self, capture: "Capture", scene: "Scene | None", output: Path, progress: Path | None
    ) -> dict[str, Any]:
        from stylesplat.io.captures.sfm_file import read_sfm
        from stylesplat.io.label_maps import refuse_label_maps
        from stylesplat.scene.cameras import row_called
        from stylesplat.verbs.mask import mask

        record = read_sfm(output.parent)
        boxes, strokes = self._boxes(record), self._strokes(record)
        names = capture.cameras.names
        own = [record.origins.get(name, name) for name in names] if record else names
        for view, _ in chain(*boxes.values(), *strokes.values()):
            row_called(view, names, told=own)  # raises before label maps are said to be there
        refuse_label_maps(capture, output, overwrite=self.overwrite)
        masked = mask(
            capture,
            boxes=boxes,
            strokes=strokes,
            source=self.source,
            method=self._method,
            model=self.model,
            scene=scene,
            device=self.device,
            progress=progress,
        )
        result = self._write(masked, output)
        if progress:
            shutil.rmtree(progress)
        return result

    def _boxes(self, record: "SfmRecord | None") -> "dict[str, list[tuple[str, Box]]]":
        boxes: dict[str, list[tuple[str, Box]]] = {}
        for name, view, box in map(parse_named_box, self.box):
            boxes.setdefault(name, []).append((view_called(view, record), box))
        return boxes

    def _strokes(self, record: "SfmRecord | None") -> "dict[str, list[tuple[str, Stroke]]]":
        from stylesplat.masks.grabcut import Stroke

        strokes: dict[str, list[tuple[str, Stroke]]] = {}
        for texts, over_object in ((self.stroke, True), (self.not_stroke, False)):
            for name, view, points in map(parse_stroke, texts):
                stroke = Stroke(points, over_object)
                strokes.setdefault(name, []).append((view_called(view, record), stroke))
        return strokes

    def _scene(self) -> "Scene | None":
        from stylesplat.io.scene_folder import open

        return open(self.scene) if self.scene else None

    def _write(self, masked: "Capture", output: Path) -> dict[str, Any]:
        from stylesplat.figures.sheets import mask_preview
        from stylesplat.io.atomic import changing
        from stylesplat.io.files import is_file
        from stylesplat.io.images import write_image
        from stylesplat.io.label_maps import write_label_maps
        from stylesplat.verbs.load import load

        found = write_or_rescue(
            lambda place, replace: write_label_maps(masked, place, overwrite=replace),
            output,
            overwrite=self.overwrite,
            what="The label maps are",
        )
        ids = sorted(set[int]().union(*found.values()))
        names = {id: masked.object_names[id] for id in ids if id in masked.object_names}
        preview = output / PREVIEW
        with told_if_missing(), changing(preview):
            preview.unlink(missing_ok=True)  # it shows earlier label maps
            write_image(mask_preview(load(output.parent), names), preview)
        return {
            "masks": output,
            "preview": preview if is_file(preview) else None,
            "photos": len(found),
            "of": len(masked),
            "ids": ids,
            "names": names,
        }
