"""`stylesplat sfm` and `check`: the cameras of photos or of a video, which are found once."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, ClassVar

from tyro.conf import Positional

import stylesplat as ss
from stylesplat.cli.arguments import from_config
from stylesplat.cli.command import (
    CONTINUES,
    Answer,
    MakingCommand,
    OptionalOutput,
    Output,
    mask_command,
    next_command,
)
from stylesplat.errors import StyleSplatError, join_names
from stylesplat.io.atomic import locked_folder, progress_path
from stylesplat.options import BOX
from stylesplat.progress import say
from stylesplat.structure_from_motion.config import SfmConfig
from stylesplat.structure_from_motion.earlier_capture import capture_place, find_earlier_capture

DrawnBoxes = Iterable[tuple[str, Sequence[float] | None]]


@dataclass(frozen=True)
class Sfm(MakingCommand):
    """Find the cameras of photos or of a video: structure from motion with COLMAP.

    Example: stylesplat sfm MyPhotos -o garden
    """

    source: Positional[Path]
    """Folder of photos (JPEG, PNG, TIFF, WebP, HEIC), sub-folders included; or a video."""
    output: Output
    """Folder of the capture to make. An interrupted run is kept beside it, and continues."""
    frames: int = 100
    """About how many frames of a video to take."""
    masks: Path | None = None
    """Folder of masks named like the photos, or COCO JSON: poses come from what they show, all that
    is black is ignored. For an object on a turntable."""
    object: str | None = None
    """VIEW:x0,y0,x1,y1, a box around such an object in one photo, in that photo's pixels: it is
    followed into the others."""
    settings: Annotated[dict[str, Any], from_config(SfmConfig)] = field(default_factory=dict)
    after_interruption: ClassVar[str] = CONTINUES

    def run(self) -> Answer:
        from stylesplat.io.captures.capture_folder import SFM_FILE, read_sfm
        from stylesplat.verbs.sfm import SFM_PICTURE

        capture = ss.sfm(
            self.source,
            self.output,
            frames=self.frames,
            masks=self.masks,
            box=self.object and BOX.parse(self.object),
            overwrite=self.overwrite,
            **self.settings,
        )
        record = read_sfm(self.output)
        assert record is not None, SFM_FILE
        values = {
            **record.numbers,
            "capture": self.output,
            "photos": record.given,
            "registered": record.registered,
            "left_out": record.left_out,
            "unregistered": record.unregistered,
        }
        posed = f"{record.registered} of {record.given} photos with their cameras"
        picture = f"{self.output / SFM_PICTURE}, the cameras and points from above and the side"
        pixels = f"in pixels of the undistorted photos in {self.output / 'images'}"
        lines = (
            f"{self.output}: {posed}. Boxes and points are {pixels}.",
            f"Picture: {picture}.",
        )
        following = mask_command(self.output)
        if capture.label_maps is not None:  # of what turns, of masks, or of cut-outs
            following = next_command("train", self.output)
        return Answer(values, lines, [following])


@dataclass(frozen=True)
class Check(MakingCommand):
    """Say whether photos and their poses will make a good scene, and what to do if not.

    Example: stylesplat check garden -o garden-check.jpg
    """

    capture: Positional[Path]
    """Folder of the posed photos, which stays as it is; or of photos whose poses were found."""
    output: OptionalOutput = None
    """Picture to make: cameras and points from above and from the side."""

    def run(self) -> Answer:
        from stylesplat.figures.capture_picture import capture_picture
        from stylesplat.io.captures.capture_folder import open_capture
        from stylesplat.io.images import write_image
        from stylesplat.io.kinds import is_posed, kind_of, wrong_kind_error
        from stylesplat.structure_from_motion.image_measures import MEASURE_SIDE

        if self.output is not None:
            self.refuse_picture(self.output)
        folder = self.capture
        if kind_of(folder) == "nothing":
            raise wrong_kind_error(folder, "capture")
        if not is_posed(folder):
            folder = find_earlier_capture(folder, beside=folder) or folder
        files = open_capture(folder)
        capture = files.at(files.whole.cameras.shrink_to(MEASURE_SIDE))
        report = ss.check(capture)
        values = report.summary()
        width = max(map(len, values["findings"]))
        lines = [
            f"{what:{width}}  {found['verdict']}  {found['says']}. {found['advice']}".rstrip()
            for what, found in values["findings"].items()
        ]
        if self.output is not None:
            with locked_folder(self.output):
                write_image(capture_picture(capture, report), self.output)
            values["picture"] = self.output
            lines.append(f"Picture: {self.output}, the cameras and points from above and the side.")
        labelled = capture.label_maps is not None
        following = next_command("train", self.capture) if labelled else mask_command(self.capture)
        return Answer(values, lines, [following])


def find_photos_capture(
    given: Path,
    *,
    beside: Path,
    drawn: DrawnBoxes = (),
    fetch: Callable[[], None] = lambda: None,
) -> Path:
    """The capture that was given, or that of the photos or the video that were.

    An earlier capture of the same photos is used if it lies beside them or beside `beside`;
    otherwise `sfm` makes one beside `beside`, after the names and boxes in `drawn` are checked and
    `fetch` has brought what the work after it needs.
    """
    from stylesplat.io.kinds import (
        find_foreign_poses,
        is_posed,
        kind_of,
        refuse_other_than_photos,
        wrong_kind_error,
    )

    if is_posed(given):
        return given
    refuse_other_than_photos(given)
    if kind_of(given) == "part of a capture":
        raise wrong_kind_error(given, "capture")
    from stylesplat.structure_from_motion.prepare import check_source
    from stylesplat.verbs.sfm import sfm

    output = capture_place(given, beside=beside)
    if output == beside.resolve():
        raise StyleSplatError(
            f"{beside} is where the capture of {given} is kept. Choose another name."
        )
    found = find_earlier_capture(given, beside=beside)
    if found is not None:
        say(f"{given} has no camera poses: taking those in {found}.")
        return found
    if output.exists():
        raise StyleSplatError(
            f"{given} has no camera poses, and where they would be kept, {output}, is something "
            f"else. Find them with `stylesplat sfm {given} -o CAPTURE`, and name that in its place."
        )
    check_source(given)
    _check_drawn(given, drawn)
    fetch()
    if foreign := find_foreign_poses(given):
        say(
            f"{join_names(foreign, whole=True)} may hold poses, in a form or a place that is not "
            "read: poses are found anew. To use those, export them as COLMAP's text into sparse/0."
        )
    say(f"{given} has no camera poses: finding them first, to be kept in {output}.")
    sfm(given, output)
    return output


def _check_drawn(given: Path, drawn: DrawnBoxes) -> None:
    """Check names and boxes, except in a video, whose frames have no names yet."""
    from stylesplat.io.images import image_sizes
    from stylesplat.options import check_box
    from stylesplat.scene.cameras import find_name
    from stylesplat.structure_from_motion.photos import find_sources

    photos = find_sources(given, skip=progress_path(given)).photos if given.is_dir() else ()
    for view, box in drawn if photos else ():
        name = photos[find_name(view, photos)]
        if box is not None:
            check_box(box, image_sizes(given / name)[1], name)
