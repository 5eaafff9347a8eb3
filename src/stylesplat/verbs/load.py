"""`load`: posed photos."""

from pathlib import Path

from stylesplat.argument_kinds import check_arguments
from stylesplat.io.captures.capture_folder import Masks, open_capture
from stylesplat.scene.capture import Capture


@check_arguments
def load(path: Path | str, *, downscale: float = 1.0, masks: Masks = None) -> Capture:
    """Read a capture: photos with a COLMAP reconstruction, `transforms.json`, or LLFF's poses.

    Only the headers of the photos are read now; photos are decoded and undistorted on each access.
    The world frame is that of the files. Photos that the files hold out (`transforms_test.json`,
    `test_filenames`) become `held_out`, and their masks (`mask_path`) `valid_masks`. If photos are
    cut out (a few with an alpha channel are decoded to find out), the opaque part is an object
    called `object`, unless there are label maps.

    Args:
        path: The capture's folder.
        downscale: Factor by which photos, label maps and cameras are made smaller.
        masks: The folder of label maps; by default the capture's `object_mask/` if it has one.
            False ignores label maps, and the object of cut-out photos too.

    Raises:
        StyleSplatError: If the folder is no capture, or a file of it is missing or damaged or
            does not fit the others.
    """
    return open_capture(path, masks=masks).at(downscale)
