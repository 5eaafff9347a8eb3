"""What a full disk is like, without one."""

import resource
from collections.abc import Iterator
from contextlib import contextmanager

NO_ROOM = 4096  # bytes that a file may have


@contextmanager
def no_room(bytes_a_file: int = NO_ROOM) -> Iterator[None]:
    """Within the block files cannot grow larger, neither ours nor those of processes we start."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (bytes_a_file, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
