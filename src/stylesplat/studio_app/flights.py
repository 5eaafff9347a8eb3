"""A browser's camera on its way to another place: half a second that shows where that is."""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

if TYPE_CHECKING:
    import viser

SECONDS = 0.5
PAUSE = 1 / 20  # seconds between two places: browsers without a GPU draw each of them

Vector = Float[np.ndarray, "3"]


@dataclass(frozen=True)
class Stand:
    """Where a browser's camera is, in world coordinates."""

    position: Vector
    """Of the camera."""
    target: Vector
    """What is in the middle of its picture, and what it turns about."""
    up: Vector
    """What is above in its picture."""
    fov: float
    """Radians from the top to the bottom."""


def between(start: Stand, end: Stand, share: float) -> Stand:
    """A place on the way: slow at both ends, and round the target as far as that stays."""
    eased = share * share * (3 - 2 * share)

    def mixed(a: Vector, b: Vector) -> Vector:
        return a + eased * (b - a)

    target = mixed(start.target, end.target)
    away = mixed(start.position - start.target, end.position - end.target)
    length = np.linalg.norm(away)
    lengths = [np.linalg.norm(each.position - each.target) for each in (start, end)]
    if length > 1e-6 * max(lengths):  # else it is on the other side: straight through
        away = away / length * (lengths[0] + eased * (lengths[1] - lengths[0]))
    up = mixed(start.up, end.up)
    up = up / np.linalg.norm(up) if np.linalg.norm(up) > 1e-6 else end.up
    fov = start.fov + eased * (end.fov - start.fov)
    return Stand(target + away, target, up, fov)


def stand_of(client: "viser.ClientHandle") -> Stand:
    """Where a browser's camera is now."""
    camera = client.camera
    return Stand(camera.position, camera.look_at, camera.up_direction, camera.fov)


def take(client: "viser.ClientHandle", stand: Stand) -> None:
    """Put a browser's camera somewhere."""
    with client.atomic():
        client.camera.up_direction = stand.up
        client.camera.position = stand.position
        client.camera.look_at = stand.target
        client.camera.fov = stand.fov


def way(start: Stand, end: Stand, seconds: float = SECONDS) -> Iterator[Stand]:
    """Places on the way as time goes by, the end the last of them."""
    began = time.monotonic()
    while (share := (time.monotonic() - began) / max(seconds, 1e-9)) < 1:
        yield between(start, end, share)
        time.sleep(PAUSE)
    yield end


class Flights:
    """Those that are under way: a browser's last one ends those before it."""

    def __init__(self) -> None:
        self._last = dict[int, object]()

    def fly(self, client: "viser.ClientHandle", end: Stand) -> None:
        """Take a browser's camera somewhere; returns as it is there, or flies elsewhere."""
        flight = self._last[client.client_id] = object()
        for stand in way(stand_of(client), end):
            if self._last[client.client_id] is not flight:
                return
            take(client, stand)
