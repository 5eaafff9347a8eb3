"""Small things that panels share."""

from typing import TYPE_CHECKING, cast

if TYPE_CHECKING:
    import viser


def icon(name: str) -> "viser.IconName":
    """One of Tabler's icons by its name there."""
    return cast("viser.IconName", name)
