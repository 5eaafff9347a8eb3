"""`stylesplat mask`: write label maps for photos, or give a scene without photos its objects."""

import shutil
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from tyro.conf import Positional, UseAppendAction, arg

import stylesplat as ss
from stylesplat.cli.arguments import parse_place
from stylesplat.cli.options import (
    CONTINUES,
    Device,
    EditingCommand,
    MakingCommand,
    OptionalOutput,
    refuse_given,
)
from stylesplat.cli.results import (
    next_lines,
    optional_picture,
    pasted,
    rewrite_scene,
    stylize_command,
    unused,
)
from stylesplat.cli.sfm import find_photos_capture, is_sfm_unfinished, view_of_photo
from stylesplat.errors import StyleSplatError
from stylesplat.io.atomic import changing, partial_of, refuse_occupied
from stylesplat.io.files import is_file
from stylesplat.signals import WHOLE

if TYPE_CHECKING:
    from stylesplat.io.captures.sfm_file import SfmRecord

Drawn = dict[str, list[Any]]  # by object, places in views
Method = Literal["files", "grabcut", "sam", "sam2", "edgetam", "sam3"]
WITHOUT_MODEL = ("files", "grabcut")  # models keep what they have found so far
PREVIEW = "preview.jpg"  # beside the label maps, which are PNGs
SCENE_PREVIEW = "masks.jpg"  # in the folder of a scene
SIDE = 480  # pixels of the views in it
MEND = (
    "If a mask is wrong there: `mask` with --keep or --drop and a box in any photo over what it "
    "missed or took too much; or again with --overwrite and a second --box from another side."
)


@dataclass(frozen=True)
class Mask(MakingCommand):
    """Give photos their label maps, which say what object each pixel shows.

    Example: stylesplat mask garden --box vase=IMG_0007.jpg:500,300,800,700
    """

    capture: Positional[Path]
    """Folder with the posed photos; the label maps go into its object_mask/. Of photos without
    poses, or a video, `sfm` makes a capture first, beside them; the label maps go into that one.
    Or a scene that was imported without photos: views of it are masked, as `render` draws them,
    and the objects go into the scene."""
    method: Method | None = None
    """files takes masks of another program (--from, then the default), grabcut cuts out what the
    boxes hold (otherwise the default), and the others find all objects with that model."""
    box: UseAppendAction[tuple[str, ...]] = ()
    """NAME=VIEW:x0,y0,x1,y1 around an object, in pixels of the photo itself, at its full size. May
    be repeated, for other objects and for other photos of the same; one photo often suffices."""
    stroke: UseAppendAction[tuple[str, ...]] = ()
    """NAME=VIEW:x,y,x,y,... along a line over an object, where a cut took it for background. May
    be repeated."""
    not_stroke: UseAppendAction[tuple[str, ...]] = ()
    """The same over what is not the object, where the cut took too much."""
    keep: UseAppendAction[tuple[str, ...]] = ()
    """NAME=VIEW:x0,y0,x1,y1 in any photo: all that shows there belongs to the object, in all
    photos. Without --box the label maps that are there are corrected; NAME= may be left out where
    they have one object. May be repeated."""
    drop: UseAppendAction[tuple[str, ...]] = ()
    """The same where nothing belongs to it: what it stands on, its shadow. May be repeated."""
    source: Annotated[Path | None, arg(name="from")] = None
    """Masks of another program: a folder with pictures of ids named like the photos (DEVA,
    Gaussian Grouping), or with a sub-folder of binary masks per object; or COCO JSON with RLE."""
    model: str | None = None
    """Folder or hub name of another checkpoint of the method."""
    scene: Path | None = None
    """A scene of these photos, on which masks of different photos meet; by default a splat is
    trained for about a minute."""
    device: Device = "auto"
    output: OptionalOutput = None
    """Folder of the scene to make, where a scene is masked; by default it is changed itself."""

    @property
    def after_interruption(self) -> str:
        continues = self._keeps_progress or is_sfm_unfinished(self.capture, beside=self.capture)
        return CONTINUES if continues else WHOLE

    @property
    def _keeps_progress(self) -> bool:
        return self.method is not None and self.method not in WITHOUT_MODEL

    def run(self) -> dict[str, Any]:
        from stylesplat.io.kinds import SCENE
        from stylesplat.scene.framing import has_no_photos
        from stylesplat.verbs.mask import settled_method

        given = self._drawn() | {"source": self.source, "model": self.model, "scene": self.scene}
        settled_method(self.method, given)  # before photos are read
        if is_file(self.capture / SCENE) and has_no_photos(ss.open(self.capture)):
            return self._mask_scene()
        return self._mask_photos()

    def words(self, result: dict[str, Any]) -> Iterator[str]:
        names = result["names"]
        if "scene" in result:
            yield from _object_lines(result)
            return
        objects = ", ".join(names.get(id, f"id {id}") for id in result["ids"]) or "no objects"
        photos = f"{result['photos']} of {result['of']} photos"
        yield f"{result['masks']}: label maps of {photos}, which show {objects}."
        if result["preview"]:
            yield f"Picture: {result['preview']}, the label maps over some of the photos."
            if self.box or self._corrects:
                yield MEND
        scene = unused(self.capture, "-scene")
        yield from next_lines(pasted("train", self.capture, "-o", scene))

    @property
    def _corrects(self) -> bool:
        """Whether label maps are corrected that are there."""
        marks = self.keep or self.drop or self.stroke or self.not_stroke
        return bool(marks) and not self.box

    def _drawn(self, record: "SfmRecord | None" = None) -> dict[str, Drawn]:
        """What is drawn by object, with the names that photos have in the capture."""
        given = {"boxes": self.box, "keep": self.keep, "drop": self.drop}
        found = {kind: Drawn() for kind in (*given, "strokes")}
        for kind, texts in given.items():
            for text in texts:
                name, view, box = _parse_drawn(text, "VIEW:x0,y0,x1,y1")
                found[kind].setdefault(name, []).append((view_of_photo(view, record), box))
        for texts, over_object in ((self.stroke, True), (self.not_stroke, False)):
            for text in texts:
                name, view, line = _parse_drawn(text, "VIEW:x,y,x,y,...")
                stroke = ss.Stroke((*zip(line[::2], line[1::2], strict=True),), over_object)
                place = view_of_photo(view, record), stroke
                found["strokes"].setdefault(name, []).append(place)
        return found

    def _masked(self, photos: Any, place: Path, drawn: dict[str, Drawn], **options: Any) -> Any:
        """Photos or a scene with masks; models keep what they have found beside the result."""
        progress = partial_of(place) if self._keeps_progress else None
        options |= {"method": self.method, "model": self.model, "device": self.device}
        return ss.mask(photos, source=self.source, progress=progress, **drawn, **options)

    def _mask_photos(self) -> dict[str, Any]:
        from stylesplat.io.captures.capture_folder import OBJECT_MASK
        from stylesplat.io.captures.sfm_file import read_sfm
        from stylesplat.io.label_maps import refuse_label_maps, write_label_maps
        from stylesplat.scene.cameras import find_name

        refuse_given(self, ("output",), "photos, whose label maps go into object_mask/")
        scene = ss.open(self.scene) if self.scene else None
        folder = find_photos_capture(
            self.capture, beside=self.capture, drawn=_places(self._drawn())
        )
        output = folder / OBJECT_MASK
        refuse_occupied(output, marker="", overwrite=True)  # label maps are refused below
        capture = ss.load(folder, masks=None if self._corrects else False)
        with changing(output):
            record, names = read_sfm(folder), capture.cameras.names
            drawn = self._drawn(record)
            own = [record.origins.get(name, name) for name in names] if record else names
            for view, _ in _places(drawn):
                find_name(view, names, shown_names=own)  # raises before label maps are refused
            overwrite = self.overwrite or self._corrects
            refuse_label_maps(capture, output, overwrite=overwrite)
            masked = self._masked(capture, output, drawn, scene=scene)
            found = write_label_maps(masked, output, overwrite=overwrite)
            ids = sorted(set[int]().union(*found.values()))
            called = {id: masked.object_names[id] for id in ids if id in masked.object_names}
            preview = output / PREVIEW
            with optional_picture():
                preview.unlink(missing_ok=True)  # it shows earlier label maps
                _draw(ss.load(folder), called, preview)
            shutil.rmtree(partial_of(output), ignore_errors=True)
        drawn_to = preview if is_file(preview) else None
        counts = {"photos": len(found), "of": len(masked), "ids": ids, "names": called}
        return {"masks": output, "preview": drawn_to, **counts}

    def _mask_scene(self) -> dict[str, Any]:
        refuse_given(self, ("scene",), "a scene, which is that scene itself")
        place = self.output or self.capture

        def mask(before: "ss.Scene") -> "ss.Scene":
            if before.splats.classifier and not (self.box or self.overwrite):
                raise StyleSplatError(
                    f"{self.capture} knows objects already, which these masks would replace. "
                    "Pass --overwrite, or add objects with --box."
                )
            return self._masked(before, place / "masks", self._drawn())

        with changing(place):
            after = rewrite_scene(self.capture, self.output, mask, overwrite=self.overwrite)
            shutil.rmtree(partial_of(place / "masks"), ignore_errors=True)
            return _describe_objects(after, place, self.device)


@dataclass(frozen=True)
class Labels(EditingCommand):
    """Give a scene the labels of corrected label maps, in seconds: they are lifted, not trained.

    Example: stylesplat labels garden-scene --masks garden/object_mask
    """

    masks: Path | None = None
    """Folder of label maps, or COCO JSON, as `mask --from` takes them; by default object_mask/ of
    the scene's photos."""
    device: Device = "auto"

    def run(self) -> dict[str, Any]:
        with changing(self.folder):
            after = self.rewrite(lambda scene: ss.labels(scene, self.masks, device=self.device))
            return _describe_objects(after, self.folder, self.device)

    def words(self, result: dict[str, Any]) -> Iterator[str]:
        yield from _object_lines(result)


def _object_lines(result: dict[str, Any]) -> Iterator[str]:
    """The objects of a scene as `_describe_objects` has described them."""
    names = result["names"]
    yield f"{result['scene']}: its objects are {', '.join(names.values()) or 'none'}."
    if result["preview"]:
        yield f"Picture: {result['preview']}, the objects of its Gaussians in some views."
    if names:
        yield from next_lines(stylize_command(result["scene"], [*names.values()][-1]))


def _parse_drawn(text: str, form: str) -> tuple[str, str, tuple[float, ...]]:
    """An object's name, which may be left out, the view, and the numbers behind it."""
    name, equals, place = text.partition("=")
    return (name if equals else "object", *parse_place(place if equals else text, form))


def _places(drawn: dict[str, Drawn]) -> list[tuple[str, Any]]:
    """All views, and the boxes in them; None for a stroke."""
    return [
        (view, None if kind == "strokes" else box)
        for kind, each in drawn.items()
        for view, box in chain(*each.values())
    ]


def _describe_objects(scene: "ss.Scene", place: Path, device: str) -> dict[str, Any]:
    """The objects of a scene, drawn as label maps over renders of its views."""
    from stylesplat.masks.quick_splat import rendered_capture
    from stylesplat.rendering.render import pick_device
    from stylesplat.scene.capture import at_most
    from stylesplat.selection.choose import names_of
    from stylesplat.selection.identities import object_ids, render_labels

    ids = object_ids(scene.splats)
    names = {id: name for id in ids for name in names_of(scene, id)[:1]}
    found: dict[str, Any] = {"scene": place, "preview": None, "photos": None}
    with optional_picture():
        small = at_most(rendered_capture(scene, pick_device(device)), SIDE)
        splats = scene.splats.to(pick_device(device))
        maps = [render_labels(splats, camera).cpu() for camera in small.cameras]
        _draw(replace(small, label_maps=maps), names, place / SCENE_PREVIEW)
        shows = sum(bool(labels.any()) for labels in maps)
        found |= {"preview": place / SCENE_PREVIEW, "photos": shows}
    return found | {"of": len(scene.cameras), "ids": list(ids), "names": names}


def _draw(capture: "ss.Capture", names: dict[int, str], target: Path) -> None:
    from stylesplat.figures.sheets import mask_preview
    from stylesplat.io.images import write_image

    write_image(mask_preview(capture, names), target)
