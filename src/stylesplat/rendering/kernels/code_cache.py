"""Where compiled kernels are kept: where numba would, else in the temporary folder, else nowhere.

numba itself gives up where neither the package's folder nor the home can be written to, as in
containers and read-only images, and where the disk is full. What it reads it runs, so a folder
that somebody else could have filled is never taken.
"""

import os
import stat
import tempfile
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from numba.core.caching import CompileResultCacheImpl, FunctionCache, UserWideCacheLocator

from stylesplat.io.files import reason
from stylesplat.progress import say

PRIVATE = 0o700
TEMPORARY = (
    "Neither the package's folder nor the home can be written to, so the compiled CPU kernels are "
    "kept in {}. NUMBA_CACHE_DIR can name another place."
)
NOWHERE = (
    "No folder for the compiled CPU kernels can be written to, so every start compiles them. "
    "NUMBA_CACHE_DIR can name one."
)
FAILED = "Cannot keep the compiled CPU kernels, so the next start compiles them again: {}."

said = set[str]()  # each line is told once


def say_once(line: str) -> None:
    """Tell the user something, unless this process did."""
    if line not in said:
        said.add(line)
        say(line)


def keep(dispatcher: Any, function: Callable[..., Any]) -> None:
    """Let a kernel find its machine code in a cache; `numba.njit(cache=True)` that never fails."""
    try:
        cache = KernelCache(function, dispatcher.targetoptions)
    except RuntimeError:  # numba has tried all places
        say_once(NOWHERE)
        return
    dispatcher._cache = cache
    if isinstance(cache._impl.locator, PrivateLocator):
        say_once(TEMPORARY.format(private_folder()))


def private_folder() -> Path:
    """A folder in the temporary one that belongs to this user alone; made if there is none.

    Raises:
        OSError: If it cannot be made, or somebody else can write to it or replace it.
    """
    if not hasattr(os, "getuid"):
        raise OSError("whose files are whose is not known on this system")
    parent = Path(tempfile.gettempdir()).resolve()
    folder = parent / f"stylesplat-{os.getuid()}"
    with suppress(FileExistsError):
        folder.mkdir(PRIVATE)
    if not _only_ours(folder.lstat()) or not _keeps_names(parent.stat()):
        raise PermissionError(f"{folder} may be another user's")
    return folder


def _only_ours(found: os.stat_result) -> bool:
    """Whether what is there is a folder, and no link, that nobody else may change."""
    mode = found.st_mode
    return stat.S_ISDIR(mode) and stat.S_IMODE(mode) == PRIVATE and found.st_uid == os.getuid()


def _keeps_names(parent: os.stat_result) -> bool:
    """Whether others cannot replace what this user has in a folder."""
    open_to_others = parent.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    sticky = parent.st_mode & stat.S_ISVTX
    return parent.st_uid in (0, os.getuid()) and bool(sticky or not open_to_others)


class PrivateLocator(UserWideCacheLocator):
    """Of caches in `private_folder`."""

    def __init__(self, py_func: Callable[..., Any], py_file: str) -> None:
        super().__init__(py_func, py_file)
        self._cache_path = str(private_folder() / self.get_suitable_cache_subpath(py_file))

    @classmethod
    def from_function(cls, py_func: Callable[..., Any], py_file: str) -> "PrivateLocator | None":
        """The place for a kernel, if there is one."""
        try:
            return super().from_function(py_func, py_file)
        except OSError:
            return None


class _Places(CompileResultCacheImpl):
    _locator_classes = [*CompileResultCacheImpl._locator_classes, PrivateLocator]  # noqa: RUF012


class KernelCache(FunctionCache):
    """A kernel's, which is done without if it fails."""

    _impl_class = _Places

    def __init__(self, function: Callable[..., Any], options: Mapping[str, Any]) -> None:
        super().__init__(function)
        self._options = repr(sorted(options.items()))

    def _index_key(self, sig: Any, codegen: Any) -> tuple[Any, ...]:
        """As numba's, which takes a function compiled with other options for the same."""
        return (*super()._index_key(sig, codegen), self._options)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The machine code for some types; None if there is none that can be read."""
        try:
            return super().load_overload(sig, target_context)
        except Exception:  # damaged pickles raise any
            self._attempt(self.flush)
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep it."""
        self._attempt(lambda: super(KernelCache, self).save_overload(sig, data))

    def _attempt(self, write: Callable[[], None]) -> None:
        try:
            write()
        except OSError as error:
            say_once(FAILED.format(error.strerror or reason(error)))
            self.disable()
