"""`stylesplat sfm`."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

from tyro.conf import Positional

import stylesplat as ss
from stylesplat.cli.next_steps import mask_command, next_lines
from stylesplat.cli.options import CONTINUES, Command, Output


@dataclass(frozen=True)
class Sfm(Command):
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
            matching=self.matching,
            cameras=self.cameras,
            seed=self.seed,
            overwrite=self.overwrite,
        )
        record = read_sfm(self.output)
        assert record is not None, SFM_FILE
        found = {"capture": self.output, "photos": record.given, "registered": record.registered}
        if self.json:  # else `sfm` has named them
            found |= {"left_out": record.left_out, "unregistered": record.unregistered}
        return dict(record.numbers) | found

    def words(self, result: dict[str, Any]) -> Iterator[str]:
        from stylesplat.verbs.sfm import PICTURE

        posed = f"{result['registered']} of {result['photos']} photos with their cameras"
        yield f"{self.output}: {posed}."
        if (picture := self.output / PICTURE).is_file():
            yield f"Picture: {picture}, the cameras and points from above and the side."
        yield from next_lines(mask_command(self.output))
