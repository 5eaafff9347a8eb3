"""OpenCV, PyAV and pycolmap, which work on photos and videos, imported at their first use.

A splat that exists is selected, painted, rendered and exported without them.
"""

from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING

from stylesplat.errors import StyleSplatError
from stylesplat.interrupts import preserve_signal_handlers

PACKAGES = {"av": "PyAV", "cv2": "OpenCV", "pycolmap": "pycolmap"}


class _Library(ModuleType):
    """A library that may not be installed; has its names from the first use on."""

    def __getattr__(self, name: str) -> object:
        library = self.__name__
        try:
            with preserve_signal_handlers():  # pycolmap's logging takes SIGTERM and prints a stack
                module = import_module(library)
        except ModuleNotFoundError as error:
            raise StyleSplatError(
                f"{PACKAGES[library]} is not installed, which photos, videos and label maps need. "
                "Run `pip install 'stylesplat[photos]'`."
            ) from error
        self.__dict__.update(vars(module))
        return getattr(module, name)


if TYPE_CHECKING:
    import av as av
    import av.container
    import av.error
    import av.video.reformatter
    import cv2 as cv2
    import pycolmap as pycolmap
else:
    av, cv2, pycolmap = (_Library(name) for name in PACKAGES)
