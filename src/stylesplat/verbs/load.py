"""`load`: posed photos."""

from pathlib import Path

from stylesplat.argument_kinds import check_arguments
from stylesplat.io.captures.capture_folder import Masks, open_capture
from stylesplat.scene.capture import Capture


@check_arguments
def load(path: Path | str, *, downscale: float = 1.0, masks: Masks = None) -> Capture:
    """Read a capture: a COLMAP reconstruction with its photos, or a `transforms.json`.

    Only the headers of the photos are read; the photos themselves are on access, each time anew,
    and then undistorted. The world stays as it is in the files. Of photos with transparency a few
    are looked at: if they are cut out, what is opaque is an object called `object`, unless there
    are label maps.

    Args:
        path: The capture's folder.
        downscale: How many times smaller photos, label maps and cameras shall be.
        masks: The folder of label maps; by default the capture's `object_mask/` if it has one.
            False leaves label maps out, unread, and the object of cut-out photos too.

    Raises:
        StyleSplatError: If the folder is no capture, or a file of it is missing or damaged or
            does not fit the others.
    """
    return open_capture(path, masks=masks).at(downscale)
