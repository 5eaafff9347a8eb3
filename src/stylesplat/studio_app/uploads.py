"""Uploads that are too large are refused before they are held in memory."""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import viser

MOST_PARTS = 200  # viser's page sends half a megabyte at a time


class Transfers(dict[str, Any]):
    """viser's list of what is on its way: what is not in it, it does not keep."""

    def __init__(self, most: int, refused: Callable[[int], None]) -> None:
        """Begin with nothing on its way.

        Args:
            most: Bytes that all of it may have together.
            refused: Is told how many bytes something has that is not taken.
        """
        super().__init__()
        self._most, self._refused = most, refused

    def __setitem__(self, key: str, transfer: Mapping[str, Any]) -> None:
        size = int(transfer["total_bytes"])
        together = size + sum(int(each["total_bytes"]) for each in self.values())
        if together > self._most or int(transfer["part_count"]) > MOST_PARTS:
            self._refused(size)
            return
        super().__setitem__(key, transfer)


def bound_uploads(server: "viser.ViserServer", most: int, refused: Callable[[int], None]) -> None:
    """Let no more than so many bytes be on their way at once; viser has no bound of its own."""
    api: Any = server.gui
    assert api._current_file_upload_states == {}  # its name in viser 1.1
    api._current_file_upload_states = Transfers(most, refused)
