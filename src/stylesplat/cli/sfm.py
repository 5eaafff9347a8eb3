"""`stylesplat sfm` and `check`: the cameras of photos or of a video, which are found once."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from tyro.conf import Positional

import stylesplat as ss
from stylesplat.cli.arguments import parse_place
from stylesplat.cli.options import (
    CONTINUES,
    MakingCommand,
    OptionalOutput,
    Output,
    refuse_picture,
)
from stylesplat.cli.results import mask_command, next_lines, pasted, unused
from stylesplat.errors import StyleSplatError
from stylesplat.io.atomic import changing, partial_of
from stylesplat.io.files import is_file, is_there, real_path
from stylesplat.progress import say

if TYPE_CHECKING:
    from stylesplat.io.captures.sfm_file import SfmRecord

SUFFIX = "-capture"  # after the name of the photos' folder
Drawn = Iterable[tuple[str, Sequence[float] | None]]


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
    matching: Literal["auto", "exhaustive", "sequential", "similar"] = "auto"
    """Which photos are compared: all with all, each with the next ones, or those that look alike;
    auto goes by their number and order."""
    masks: Path | None = None
    """Folder of masks named like the photos, or COCO JSON: poses come from what they show, all that
    is black is ignored. For an object on a turntable."""
    object: str | None = None
    """VIEW:x0,y0,x1,y1, a box around such an object in one photo, in that photo's pixels: it is
    followed into the others."""
    cameras: Literal["auto", "one", "several"] = "auto"
    """One lens for all photos of a size and a camera, one for all of a size, or one for each."""
    seed: int = 0
    """The same seed and number of threads give the same poses."""
    after_interruption: ClassVar[str] = CONTINUES

    def run(self) -> dict[str, Any]:
        from stylesplat.io.captures.sfm_file import SFM_FILE, read_sfm

        ss.sfm(
            self.source,
            self.output,
            frames=self.frames,
            masks=self.masks,
            box=self.object and parse_place(self.object, "VIEW:x0,y0,x1,y1"),
            matching=self.matching,
            cameras=self.cameras,
            seed=self.seed,
            overwrite=self.overwrite,
        )
        record = read_sfm(self.output)
        assert record is not None, SFM_FILE
        return {
            **record.numbers,
            "capture": self.output,
            "photos": record.given,
            "registered": record.registered,
            "left_out": record.left_out,
            "unregistered": record.unregistered,
        }

    def words(self, result: dict[str, Any]) -> Iterator[str]:
        from stylesplat.verbs.sfm import PICTURE

        posed = f"{result['registered']} of {result['photos']} photos with their cameras"
        yield f"{self.output}: {posed}."
        if (picture := self.output / PICTURE).is_file():
            yield f"Picture: {picture}, the cameras and points from above and the side."
        yield from next_lines(mask_command(self.output))


@dataclass(frozen=True)
class Check(MakingCommand):
    """Say whether photos and their poses will make a good scene, and what to do if not.

    Example: stylesplat check garden -o garden-check.jpg
    """

    capture: Positional[Path]
    """Folder of the posed photos, which stays as it is; or of photos whose poses were found."""
    output: OptionalOutput = None
    """Picture to make: cameras and points from above and from the side."""

    def run(self) -> dict[str, Any]:
        from stylesplat.figures.capture_picture import capture_picture
        from stylesplat.io.captures.capture_folder import open_capture
        from stylesplat.io.images import write_image
        from stylesplat.io.kinds import is_posed, kind_of, wrong_kind
        from stylesplat.structure_from_motion.image_measures import SIDE

        if self.output is not None:
            refuse_picture(self.output, overwrite=self.overwrite)
        folder = self.capture
        if kind_of(folder) == "nothing":
            raise wrong_kind(folder, "capture")
        if not is_posed(folder):
            folder = find_earlier_capture(folder, beside=folder) or folder
        files = open_capture(folder, masks=False)
        capture = files.at(files.cameras.shrink_to(SIDE))
        report = ss.check(capture)
        if self.output is None:
            return report.summary()
        with changing(self.output):
            write_image(capture_picture(capture, report), self.output)
        return report.summary() | {"picture": self.output}

    def words(self, result: dict[str, Any]) -> Iterator[str]:
        from stylesplat.io.captures.capture_folder import OBJECT_MASK

        width = max(map(len, result["findings"]))
        for what, found in result["findings"].items():
            advice = f" {found['advice']}" if found["advice"] else ""
            yield f"{what:{width}}  {found['verdict']}  {found['says']}.{advice}"
        if "picture" in result:
            yield f"Picture: {result['picture']}, the cameras and points from above and the side."
        masked = (self.capture / OBJECT_MASK).is_dir()
        train = pasted("train", self.capture, "-o", unused(self.capture, "-scene"))
        yield from next_lines(train if masked else mask_command(self.capture))


def find_photos_capture(given: Path, *, beside: Path, drawn: Drawn = ()) -> Path:
    """The capture that was given, or that of the photos or the video that were.

    An earlier capture of the same photos is used if it lies beside them or beside `beside`;
    otherwise `sfm` makes one beside `beside`, after the names and boxes in `drawn` are checked.
    """
    from stylesplat.io.kinds import is_posed, kind_of, refuse_other_than_photos, wrong_kind

    if is_posed(given):
        return given
    refuse_other_than_photos(given)
    if kind_of(given) == "part of a capture":
        raise wrong_kind(given, "capture")
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
    say(f"{given} has no camera poses: finding them first, to be kept in {output}.")
    sfm(given, output)
    return output


def _check_drawn(given: Path, drawn: Drawn) -> None:
    """Check names and boxes, except in a video, whose frames have no names yet."""
    from stylesplat.io.images import image_sizes
    from stylesplat.scene.arguments import check_box
    from stylesplat.scene.cameras import find_name
    from stylesplat.structure_from_motion.photo_folder import find_sources

    photos = find_sources(given, skip=partial_of(given)).photos if given.is_dir() else ()
    for view, box in drawn if photos else ():
        name = photos[find_name(view, photos)]
        if box is not None:
            check_box(box, image_sizes(given / name)[1], name)


def capture_place(given: Path, *, beside: Path) -> Path:
    """The folder for the capture of photos or a video, which is never among the photos."""
    own, folder = real_path(given), real_path(beside).parent
    if folder.is_relative_to(own):
        folder = own.parent
    return folder / f"{own.stem if is_file(own) else own.name}{SUFFIX}"


def find_earlier_capture(given: Path, *, beside: Path) -> Path | None:
    """The capture that was made of photos or a video; an error if these have changed since."""
    from stylesplat.io.captures.sfm_file import read_sfm
    from stylesplat.verbs.sfm import source_digest

    stale = None
    for place in dict.fromkeys(capture_place(given, beside=near) for near in (given, beside)):
        record = read_sfm(place)
        if record is not None and Path(record.source) == given.resolve():
            if record.digest == source_digest(given):
                return place
            stale = place
    if stale is None:
        return None
    raise StyleSplatError(
        f"The photos in {given} have changed since {stale} was made of them. Make it again with "
        f"`stylesplat sfm {given} -o {stale} --overwrite` (its label maps are kept), or use it as "
        "it is: name it in place of the photos."
    )


def view_of_photo(name: str, record: "SfmRecord | None") -> str:
    """The name in a capture of a photo that the user knows by its own name."""
    if record is None:
        return name
    unposed = record.left_out | record.unregistered
    views = {own: view for view, own in record.origins.items()}
    if name not in unposed | views:
        alike = [own for own in unposed | views if Path(own).with_suffix("").as_posix() == name]
        name = alike[0] if len(alike) == 1 else name
    if name in unposed:
        raise StyleSplatError(f"The photo {name} has no pose: {unposed[name]}. Take another one.")
    return views.get(name, name)


def is_sfm_unfinished(given: Path, *, beside: Path) -> bool:
    """Whether `find_photos_capture` would continue an interrupted run."""

    return is_there(partial_of(capture_place(given, beside=beside)) / "sfm")
