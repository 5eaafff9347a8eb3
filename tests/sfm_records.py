"""What `sfm` writes down, where a test cares about a part of it only."""

from typing import Any

from stylesplat.io.captures.sfm_file import SfmRecord


def sfm_record(**known: Any) -> SfmRecord:
    """A record of which only some fields say something."""
    nothing = ("left_out", "unregistered", "origins", "frame", "settings", "numbers", "libraries")
    empty = {name: dict[str, Any]() for name in nothing}
    return SfmRecord(**{"source": "photos", "digest": "", **empty, **known})
