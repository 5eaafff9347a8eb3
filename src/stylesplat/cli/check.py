"""`stylesplat check`."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tyro.conf import Positional

import stylesplat as ss
from stylesplat.cli.options import MakingCommand, OptionalOutput, refuse_picture
from stylesplat.cli.results import mask_command, next_lines, pasted, unused
from stylesplat.cli.sfm import find_earlier_capture
from stylesplat.io.atomic import changing


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
        from stylesplat.io.kinds import is_posed, kind_of, no_capture
        from stylesplat.structure_from_motion.image_measures import SIDE

        if self.output is not None:
            refuse_picture(self.output, overwrite=self.overwrite)
        folder = self.capture
        if kind_of(folder) == "nothing":
            raise no_capture(folder)
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
