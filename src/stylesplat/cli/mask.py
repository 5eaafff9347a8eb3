"""`stylesplat mask`: write label maps for photos, or give a scene without photos its objects."""

import shutil
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from tyro.conf import Positional, UseAppendAction, arg

import stylesplat as ss
from stylesplat.cli.command import (
    CONTINUES,
    Answer,
    Device,
    EditingCommand,
    MakingCommand,
    OptionalOutput,
    next_command,
    object_commands,
    optional_picture,
    rewrite_scene,
)
from stylesplat.cli.sfm import find_photos_capture
from stylesplat.errors import StyleSplatError, shell_command
from stylesplat.interrupts import WHOLE
from stylesplat.io.atomic import locked_folder, progress_path, refuse_occupied
from stylesplat.io.files import is_file
from stylesplat.options import BOX, LINE
from stylesplat.structure_from_motion.earlier_capture import is_sfm_unfinished, view_of_photo

if TYPE_CHECKING:
    from stylesplat.io.captures.capture_folder import SfmRecord
    from stylesplat.masks.sam import SamMethod

Drawn = dict[str, list[Any]]  # by object, places in views
OfferedMethod = Literal["files", "grabcut", "sam", "sam2", "edgetam", "sam3"]
WITHOUT_MODEL = ("files", "grabcut")  # models keep what they have found so far
PREVIEW, RIMS = "preview.jpg", "rims.jpg"  # beside the label maps, which are PNGs
SCENE_PREVIEW = "masks.jpg"  # in the folder of a scene
SIDE = 480  # pixels of the views in it
MEND = (
    "If a mask is wrong there: the same command again with --overwrite and a line in the photo of "
    "its box, --stroke over what it missed or --not-stroke over what it took too much, whose "
    "colours it learns; or `mask` with --keep or --drop and a box over the part that is to change."
)


@dataclass(frozen=True)
class MaskCommand(MakingCommand):
    """Give photos their label maps, which say what object each pixel shows.

    Example: stylesplat mask garden --box vase=IMG_0007.jpg:500,300,800,700
    """

    capture: Positional[Path]
    """Folder with the posed photos; the label maps go into its object_mask/. Given photos
    without poses, or a video, `sfm` makes a capture beside them first, and the label maps go there.
    Or a scene that was imported without photos: its views are masked, as `render` draws them, and
    the objects go into the scene."""
    method: OfferedMethod | None = None
    """files imports masks of another program (the default with --from), grabcut cuts out what the
    boxes hold (the default otherwise), and the others find all objects with that model."""
    box: UseAppendAction[tuple[str, ...]] = ()
    """NAME=VIEW:x0,y0,x1,y1 around an object, in pixels of the photo itself, at its full size. May
    be repeated, for other objects and for other photos of the same; one photo often suffices."""
    stroke: UseAppendAction[tuple[str, ...]] = ()
    """NAME=VIEW:x,y,x,y,... along a line over an object, where a cut took it for background. May
    be repeated."""
    not_stroke: UseAppendAction[tuple[str, ...]] = ()
    """The same over what does not belong to the object, where the cut took too much."""
    keep: UseAppendAction[tuple[str, ...]] = ()
    """NAME=VIEW:x0,y0,x1,y1 in any photo: all that shows there belongs to the object, in all
    photos. Without --box the label maps that are there are corrected; NAME= may be left out where
    they have one object. May be repeated."""
    drop: UseAppendAction[tuple[str, ...]] = ()
    """NAME=VIEW:x0,y0,x1,y1 in any photo: nothing that shows there belongs to the object, in all
    photos; for what it stands on, or its shadow. May be repeated."""
    source: Annotated[Path | None, arg(name="from")] = None
    """Masks of another program: a folder with pictures of ids named like the photos (DEVA,
    Gaussian Grouping), or with a sub-folder of binary masks per object; or COCO JSON with RLE."""
    model: str | None = None
    """Folder or hub name of another checkpoint of the method."""
    scene: Path | None = None
    """A scene of these photos, on which masks of different photos meet; by default a splat is
    trained for a minute or more."""
    device: Device = "auto"
    output: OptionalOutput = None
    """Folder of the scene to make, where a scene is masked; by default it is changed itself."""

    @property
    def after_interruption(self) -> str:
        continues = self._model_method or is_sfm_unfinished(self.capture, beside=self.capture)
        return CONTINUES if continues else WHOLE

    @property
    def _model_method(self) -> "SamMethod | None":
        return None if self.method in WITHOUT_MODEL else self.method

    def run(self) -> Answer:
        from stylesplat.io.kinds import SCENE
        from stylesplat.scene.virtual_cameras import has_rendered_views
        from stylesplat.verbs.mask import mask_source

        scene = ss.open(self.scene) if self.scene else None
        given = self._drawn() | {"source": self.source, "model": self.model, "scene": scene}
        mask_source(self.method, **given)  # before photos are read
        if is_file(self.capture / SCENE) and has_rendered_views(ss.open(self.capture)):
            return self._mask_scene()
        return self._mask_photos(scene)

    @property
    def _corrects(self) -> bool:
        """Whether label maps are corrected that are there."""
        marks = self.keep or self.drop or self.stroke or self.not_stroke
        return bool(marks) and not self.box

    def _drawn(self, record: "SfmRecord | None" = None) -> dict[str, Drawn]:
        """What is drawn by object, with the names that photos have in the capture."""
        given = (
            ("boxes", self.box, None),
            ("keep", self.keep, None),
            ("drop", self.drop, None),
            ("strokes", self.stroke, True),
            ("strokes", self.not_stroke, False),
        )
        found = {kind: Drawn() for kind, *_ in given}
        for kind, texts, over_object in given:
            for text in texts:
                name, _, place = text.partition("=") if "=" in text else ("object", "", text)
                view, mark = (BOX if over_object is None else LINE).parse(place)
                if over_object is not None:
                    points = zip(mark[::2], mark[1::2], strict=True)
                    mark = ss.Stroke((*points,), over_object)
                marked = view_of_photo(view, record), mark
                found[kind].setdefault(name, []).append(marked)
        return found

    def _fetch_model(self) -> None:
        from stylesplat.masks.sam import find_proposer
        from stylesplat.rendering.render import pick_device

        pick_device(self.device)  # raises before the download
        if method := self._model_method:
            find_proposer(method, self.model)

    def _masked(self, photos: Any, place: Path, drawn: dict[str, Drawn], **options: Any) -> Any:
        """Photos or a scene with masks; models keep what they have found beside the result."""
        progress = progress_path(place) if self._model_method else None
        options |= {"method": self.method, "model": self.model, "device": self.device}
        return ss.mask(photos, source=self.source, progress=progress, **drawn, **options)

    def _mask_photos(self, scene: "ss.Scene | None") -> Answer:
        from stylesplat.figures.sheets import draw_contact_contours, mask_preview
        from stylesplat.io.captures.capture_folder import OBJECT_MASK, read_sfm
        from stylesplat.io.images import write_image
        from stylesplat.io.label_maps import refuse_label_maps, write_label_maps
        from stylesplat.scene.cameras import find_name

        self.refuse_given(("output",), "photos, whose label maps go into object_mask/")
        folder = find_photos_capture(
            self.capture, beside=self.capture, drawn=_places(self._drawn()), fetch=self._fetch_model
        )
        output = folder / OBJECT_MASK
        preview, rims = output / PREVIEW, output / RIMS
        refuse_occupied(output, marker="", overwrite=True)  # label maps are refused below
        capture = ss.load(folder, masks=None if self._corrects else False)
        with locked_folder(output):
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
            with optional_picture():
                for earlier in (preview, rims):  # they show earlier label maps
                    earlier.unlink(missing_ok=True)
                written = ss.load(folder)
                write_image(mask_preview(written, called), preview)
                if called:
                    write_image(draw_contact_contours(written, called), rims)
            shutil.rmtree(progress_path(output), ignore_errors=True)
        objects = ", ".join(called.get(id, f"id {id}") for id in ids) or "no objects"
        photos = f"{len(found)} of {len(masked)} photos"
        lines = [f"{output}: label maps of {photos}, which show {objects}."]
        is_drawn = is_file(preview)
        if is_drawn:
            lines.append(f"Picture: {preview}, the label maps over some of the photos.")
            if is_file(rims):
                lines.append(f"Picture: {rims}, where the objects stand, in three views of each.")
            lines += [MEND] if self.box or self._corrects else []
        values = {"masks": output, "preview": preview if is_drawn else None, "photos": len(found)}
        values |= {"of": len(masked), "ids": ids, "names": called}
        following = next_command("train", self.capture)
        if self.scene is not None:  # it takes the new labels in seconds, without training
            following = shell_command("labels", self.scene, "--masks", output)
        return Answer(values, lines, [following])

    def _mask_scene(self) -> Answer:
        self.refuse_given(("scene",), "a scene, which is that scene itself")
        place = self.output or self.capture

        def mask(before: "ss.Scene") -> "ss.Scene":
            if before.splats.classifier and not (self.box or self.overwrite):
                raise StyleSplatError(
                    f"{self.capture} knows objects already, which these masks would replace. "
                    "Pass --overwrite, or add objects with --box."
                )
            return self._masked(before, place / "masks", self._drawn())

        with locked_folder(place):
            after = rewrite_scene(self.capture, self.output, mask, overwrite=self.overwrite)
            shutil.rmtree(progress_path(place / "masks"), ignore_errors=True)
            return _describe_objects(after, place, self.device)


@dataclass(frozen=True)
class LabelsCommand(EditingCommand):
    """Give a scene the labels of corrected label maps, in seconds: they are lifted, not trained.

    Example: stylesplat labels garden-scene --masks garden/object_mask
    """

    masks: Path | None = None
    """Folder of label maps, or COCO JSON, as `mask --from` takes them; by default object_mask/ of
    the scene's photos."""
    device: Device = "auto"

    def run(self) -> Answer:
        with locked_folder(self.folder):
            after = self.rewrite(lambda scene: ss.labels(scene, self.masks, device=self.device))
            return _describe_objects(after, self.folder, self.device)


def _places(drawn: dict[str, Drawn]) -> list[tuple[str, Any]]:
    """All views, and the boxes in them; None for a stroke."""
    return [
        (view, None if kind == "strokes" else box)
        for kind, each in drawn.items()
        for view, box in chain(*each.values())
    ]


def _describe_objects(scene: "ss.Scene", place: Path, device: str) -> Answer:
    """The objects of a scene, drawn as label maps over renders of its views."""
    from stylesplat.figures.sheets import mask_preview
    from stylesplat.io.images import write_image
    from stylesplat.masks.working_splat import rendered_capture
    from stylesplat.rendering.render import pick_device
    from stylesplat.scene.capture import at_most
    from stylesplat.selection.labels import object_ids, render_labels
    from stylesplat.selection.resolve import names_of

    ids, preview, photos = object_ids(scene.splats), None, None
    names = {id: name for id in ids for name in names_of(scene, id)[:1]}
    listed = ", ".join(names.get(id, f"id {id} without a name") for id in ids)
    lines = [f"{place}: its objects are {listed or 'none'}."]
    with optional_picture():
        where = pick_device(device)
        small, splats = at_most(rendered_capture(scene, where), SIDE), scene.splats.to(where)
        maps = [render_labels(splats, camera).cpu() for camera in small.cameras]
        write_image(mask_preview(replace(small, label_maps=maps), names), place / SCENE_PREVIEW)
        preview, photos = place / SCENE_PREVIEW, sum(bool(labels.any()) for labels in maps)
        lines.append(f"Picture: {preview}, the objects of its Gaussians in some views.")
    following = object_commands(place, [*names.values()][-1:], labelled=True) if ids else []
    values = {"scene": place, "preview": preview, "photos": photos, "of": len(scene.cameras)}
    return Answer({**values, "ids": list(ids), "names": names}, lines, following)
