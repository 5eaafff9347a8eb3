"""A box in the scene with a handle at two of its corners, to pick what lies inside."""

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from stylesplat.scene.content import content_of, extent_of
from stylesplat.studio_app.viewing import Stage

if TYPE_CHECKING:
    import viser

NODE = "/box"
COLOR = (255, 170, 40)
# Of a box whose corners are counted in binary: pairs that differ in one axis
EDGES = [(a, a | bit) for a in range(8) for bit in (1, 2, 4) if not a & bit]


class BoxHandles:
    """The box, as all browsers see it."""

    def __init__(self, stage: Stage) -> None:
        """Begin without one."""
        self._stage = stage
        self._handles: list[viser.TransformControlsHandle] = []
        self._lines: viser.LineSegmentsHandle | None = None

    def show(self, show: bool) -> None:
        """Put the box around what is picked, or the content; or take it away."""
        for handle in self._handles:
            handle.remove()
        if self._lines is not None:
            self._lines.remove()
        self._handles, self._lines = [], None
        if show:
            self._add()
        self._stage.draw_over("box", show)

    @property
    def corners(self) -> tuple[list[float], list[float]] | None:
        """The lower one and the upper one; None without a box."""
        if not self._handles:
            return None
        places = np.array([handle.position for handle in self._handles])
        return places.min(axis=0).tolist(), places.max(axis=0).tolist()

    def _add(self) -> None:
        session, scene = self._stage.session, self._stage.server.scene
        state = session.state
        picked = session.masks.together(state.scene, state.picked)
        splats = state.scene.splats
        extent = content_of(splats).extent if picked is None else extent_of(splats, picked)
        size = float(extent.size.norm()) / 8
        for name, corner in (("low", extent.low), ("high", extent.high)):
            handle = scene.add_transform_controls(
                f"{NODE}/{name}",
                scale=size,
                disable_rotations=True,
                position=corner.numpy(),
            )
            handle.on_update(lambda _: self._moved())
            self._handles.append(handle)
        self._lines = scene.add_line_segments(
            f"{NODE}/edges",
            points=self._edges(),
            colors=COLOR,
            thickness=2.0,
            thickness_units="screen",
        )

    def _moved(self) -> None:
        if self._lines is not None and self._handles:
            self._lines.points = self._edges()

    def _edges(self) -> Float[np.ndarray, "12 2 3"]:
        low, high = (handle.position for handle in self._handles)
        bits = np.array([[row >> axis & 1 for axis in range(3)] for row in range(8)])
        return np.where(bits, high, low)[np.array(EDGES)].astype(np.float32)
