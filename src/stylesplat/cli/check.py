"""`stylesplat check`."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from tyro.conf import Positional

from stylesplat.cli.next_steps import mask_command, next_lines, unused
from stylesplat.cli.options import Json, OptionalOutput, Overwrite, Verbose, refuse_picture
from stylesplat.cli.posed import earlier_capture
from stylesplat.scene.arguments import pasted

if TYPE_CHECKING:
    from stylesplat.scene.capture import Capture
    from stylesplat.structure_from_motion.diagnostics import CaptureReport


@dataclass(frozen=True)
class Check:
    """Say whether photos and their poses will make a good scene, and what to do if not.

    Example: stylesplat check garden -o garden-check.jpg
    """

    first: ClassVar = ("output",)
    capture: Positional[Path]
    """Folder of the posed photos, which stays as it is; or of photos whose poses were found."""
    output: OptionalOutput = None
    """Picture to make: cameras and points from above and from the side."""
    overwrite: Overwrite = False
    verbose: Verbose = False
    json: Json = False

    def run(self) -> dict[str, Any]:
        """Do it."""
        from stylesplat.io.captures.capture_folder import open_capture
        from stylesplat.io.kinds import is_posed, kind_of, no_capture
        from stylesplat.structure_from_motion.image_measures import SIDE
        from stylesplat.verbs.check import check

        if self.output is not None:
            refuse_picture(self.output, overwrite=self.overwrite)
        folder = self.capture
        if kind_of(folder) == "nothing":
            raise no_capture(folder)
        if not is_posed(folder):
            folder = earlier_capture(folder, beside=folder) or folder
        files = open_capture(folder, masks=False)
        capture = files.at(files.cameras.shrink_to(SIDE))
        report = check(capture)
        picture = {} if self.output is None else {"picture": self._draw(capture, report)}
        return report.summary() | picture

    def words(self, result: dict[str, Any]) -> Iterator[str]:
        """What was made, and how to go on."""
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

    def _draw(self, capture: "Capture", report: "CaptureReport") -> Path:
        from stylesplat.figures.capture_picture import capture_picture
        from stylesplat.io.atomic import changing
        from stylesplat.io.images import write_image

        assert self.output is not None
        with changing(self.output):
            write_image(capture_picture(capture, report), self.output)
        return self.output
