"""What the panel See does: the picture of all browsers, and where their cameras are."""

from dataclasses import replace
from typing import TYPE_CHECKING, Literal

import numpy as np
import torch
from jaxtyping import Bool, UInt8
from torch import Tensor

from stylesplat.figures.browser import AtRest, place_camera
from stylesplat.figures.live_splats import MOST, LiveSplats, ViewerSplats
from stylesplat.figures.orbits import first_view
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.content import content_of, extent_of
from stylesplat.scene.scene import Scene
from stylesplat.scene.splats import Splats
from stylesplat.studio_app.flights import Flights, Stand, stand_of
from stylesplat.studio_app.session import Session

if TYPE_CHECKING:
    import viser

Compared = Literal["after", "before", "split"]

BEHIND = (0.086, 0.086, 0.094)  # what is behind everything at first: that of the dark page
MOST_FRAMES = 60  # cameras that are drawn
NEAREST = 0.1  # world units to what a photo's camera turns about, at least
CLOSE = 1.6  # extents of an object from which it is looked at


class Stage:
    """The picture: splats that follow the session, and exact ones as cameras rest."""

    def __init__(self, server: "viser.ViserServer", session: Session) -> None:
        """Show the session's state from now on."""
        self.server, self.session = server, session
        self.behind = BEHIND
        """The colour behind everything."""
        self.compared: Compared = "after"
        """Whether paintings are seen, or what was before, or one beside the other."""
        self.split = 0.5
        """Where a split view has its border, of the picture's width."""
        self._holding, self.flights = set[int](), Flights()
        scene = session.state.scene
        place_camera(server, scene.splats, scene.cameras)
        view = first_view(scene.splats, scene.cameras)
        self._first = Stand(
            *(each.double().numpy() for each in (view.position, view.target, view.up)),
            fov=server.initial_camera.fov,
        )
        self._last = self.shown()
        self._splats = LiveSplats(server, self._last)
        self.rest = AtRest(server, session.worker, self.look)
        self.rest.set_paper(BEHIND)
        self._drawn_over = set[str]()
        self._frames = list["viser.CameraFrustumHandle"]()
        session.on_change(self.refresh)
        server.on_client_disconnect(lambda client: self.hold(client.client_id, False))
        count = len(scene.splats)
        if count > MOST:
            session.greetings.append(
                f"The browser moves {MOST:,} of {count:,} Gaussians; at rest the picture is of all."
            )

    def shown(self) -> ViewerSplats:
        """What is to be seen now."""
        seen = self.session.shown
        before = self.compared == "before" or self._holding
        if before and self.session.preview is None:
            return _before(self.session.state.scene, seen.hidden)
        return seen

    def refresh(self) -> None:
        """Something is another: in the worker's thread."""
        self._last = self.shown()
        self._splats.show(self._last)
        self.rest.active = not self.session.painting
        self.rest.behind = bool(self._drawn_over)
        self.rest.changed()

    def look(
        self, camera: Cameras, pointed: Bool[Tensor, " N"] | None = None
    ) -> UInt8[np.ndarray, "H W 3"]:
        """What a camera sees exactly, some Gaussians tinted as those below the pointer."""
        image = replace(self._last, pointed=pointed).render(camera, self.behind).numpy()
        if self.compared == "split" and not self._holding and self.session.preview is None:
            scene, hidden = self.session.state.scene, self._last.hidden
            before = _before(scene, hidden).render(camera, self.behind).numpy()
            middle = round(self.split * image.shape[1])
            image[:, :middle] = before[:, :middle]
            image[:, max(0, middle - 1) : middle + 1] = 255
        return image

    def compare(self, compared: Compared, split: float | None = None) -> None:
        """Show paintings, or what was before, or both, with a border somewhere."""
        self.compared = compared
        self.split = self.split if split is None else split
        self.session.ask(self.refresh, kind="compare")

    @property
    def held(self) -> bool:
        """Whether somebody holds the key that shows what was before."""
        return bool(self._holding)

    def hold(self, client_id: int, before: bool) -> None:
        """Show what was before for as long as somebody holds a key."""
        if before == (client_id in self._holding):
            return
        (self._holding.add if before else self._holding.discard)(client_id)
        self.session.ask(self._exchange, kind="compare")

    def _exchange(self) -> None:
        """In the worker's thread: something else is to be seen, at once and without a gap."""
        self._last = self.shown()
        self.rest.again()
        self._splats.show(self._last)

    def paper(self, behind: tuple[float, float, float]) -> None:
        """Another colour behind everything."""
        self.behind = behind
        self.rest.set_paper(behind)
        self.session.ask(self.refresh, kind="compare")

    def frames(self, show: bool) -> None:
        """Draw the cameras of the photos, to fly to, or take them away."""
        for frame in self._frames:
            frame.remove()
        self._frames = []
        if show:
            cameras = self.session.state.scene.cameras
            for row in range(0, len(cameras), -(-len(cameras) // MOST_FRAMES)):
                self._frames.append(self._frame(cameras[row], _spacing(cameras)))
        self.draw_over("frames", show)

    def draw_over(self, what: str, there: bool) -> None:
        """Something is drawn in the scene, which exact pictures must not hide; or no longer."""
        (self._drawn_over.add if there else self._drawn_over.discard)(what)
        self.session.ask(self.refresh, kind="compare")

    def _frame(self, camera: Cameras, size: float) -> "viser.CameraFrustumHandle":
        wxyz, position, fov = pose_of(camera)
        width, height = camera.size
        frame = self.server.scene.add_camera_frustum(
            f"/photos/{camera.names[0]}",
            fov=fov,
            aspect=width / height,
            scale=size,
            color=(255, 170, 40),
            wxyz=wxyz,
            position=position,
        )

        @frame.on_click
        def _(event: "viser.SceneNodePointerEvent[viser.CameraFrustumHandle]") -> None:
            self.flights.fly(event.client, stand_at(self.session.state.scene, camera))

        return frame

    def home(self, client: "viser.ClientHandle") -> None:
        """Where it began, or if something is picked, close to that."""
        self.flights.fly(client, self.at_home(stand_of(client)))

    def at_home(self, now: Stand) -> Stand:
        """Where Home leads to."""
        state = self.session.state
        picked = self.session.masks.together(state.scene, state.picked)
        if picked is None:
            return self._first
        position, centre = close_to(state.scene.splats, picked, now.position)
        return replace(now, position=position, target=centre)


def _before(scene: Scene, hidden: Bool[Tensor, " M"] | None) -> ViewerSplats:
    """A scene without its layers; of what is hidden the rows that are there."""
    base = scene.unpainted
    return ViewerSplats(base, hidden=None if hidden is None else hidden[: len(base)])


def close_to(
    splats: Splats, picked: Bool[Tensor, " N"], position: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Where to stand and where to look to see an object from the side that one is at."""
    extent = extent_of(splats, picked)
    centre = extent.centre.numpy()
    away = position - centre
    distance = CLOSE * float(extent.size.norm())
    return centre + away / max(float(np.linalg.norm(away)), 1e-9) * distance, centre


def stand_at(scene: Scene, camera: Cameras) -> Stand:
    """Where a photo was taken, turning about what is in its middle as far away as the content."""
    _, position, fov = pose_of(camera)
    forward = camera.viewmats[0, 2, :3].double().numpy()
    content = content_of(scene.splats).extent.centre.double().numpy()
    distance = max(float((content - position) @ forward), NEAREST)
    return Stand(
        position, position + distance * forward, -camera.viewmats[0, 1, :3].double().numpy(), fov
    )


def pose_of(camera: Cameras) -> tuple[np.ndarray, np.ndarray, float]:
    """A camera's rotation to the world, wxyz; its place; and radians from top to bottom."""
    from viser.transforms import SO3

    rotation = camera.viewmats[0, :3, :3].double().numpy()
    height, focal = camera.sizes[0, 1], camera.Ks[0, 1, 1]
    fov = 2 * float(torch.atan(height / (2 * focal)))
    return SO3.from_matrix(rotation.T).wxyz, camera.positions[0].double().numpy(), fov


def _spacing(cameras: Cameras) -> float:
    """A length by which cameras can be drawn without hiding each other."""
    positions = cameras.positions.double()
    if len(cameras) < 2:
        return 0.1
    gaps = torch.cdist(positions, positions).fill_diagonal_(float("inf")).amin(dim=1)
    return float(gaps.median().clamp(min=1e-3)) / 3
