"""Arrays of numpy's format: nothing is unpickled, no memory is taken for what a header claims."""

import math
import tokenize
import zipfile
import zlib
from collections.abc import Callable
from io import BufferedIOBase
from typing import cast

import numpy as np
from jaxtyping import Shaped

WHOLE = "iu"  # kinds of numpy's types that are integers
# What damaged arrays and archives of them raise
DAMAGED = (
    *(ValueError, EOFError, OSError, RuntimeError, KeyError, TypeError, SyntaxError),
    *(OverflowError, MemoryError, zipfile.BadZipFile, zlib.error, tokenize.TokenError),
)

Shape = tuple[int, ...]


def read_npy(
    stream: BufferedIOBase, check: Callable[[Shape], None], *, kinds: str = WHOLE
) -> Shaped[np.ndarray, "..."]:
    """An array, of one dimension, whose header is believed only where the content agrees.

    Args:
        stream: Where its file begins.
        check: Refuses shapes that nobody expects, before memory is taken.
        kinds: Of numpy's types that it may have.

    Raises:
        ValueError: If it is damaged or of another kind; other `DAMAGED` likewise.
    """
    version = np.lib.format.read_magic(stream)
    if version not in ((1, 0), (2, 0)):
        raise ValueError("it is of a later version of numpy's format. Save plain integers")
    read = (
        np.lib.format.read_array_header_1_0
        if version == (1, 0)
        else np.lib.format.read_array_header_2_0
    )
    shape, _, dtype = read(stream)
    if dtype.hasobject:
        raise ValueError("it holds pickled Python objects, which are never loaded. Save integers")
    if dtype.kind not in kinds:
        raise ValueError(f"it holds {dtype}, not integers. Save it with .astype(int)")
    check(shape)
    size = math.prod(shape) * dtype.itemsize
    content = stream.read(size + 1)
    if len(content) != size:
        raise ValueError("it is cut off, or holds more than its header says")
    return np.frombuffer(content, dtype)


def read_member(
    archive: zipfile.ZipFile, name: str, check: Callable[[Shape], None], *, kinds: str = WHOLE
) -> Shaped[np.ndarray, "..."]:
    """An array of an .npz, in the same way."""
    with archive.open(name) as stream:
        return read_npy(cast("BufferedIOBase", stream), check, kinds=kinds)
