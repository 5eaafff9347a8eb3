"""The picture in all browsers, and the moves of their cameras."""

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from stylesplat.figures.browser import AtRest, place_camera
from stylesplat.figures.live_splats import MOST, LiveSplats, ViewerSplats
from stylesplat.figures.orbits import first_view
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.content import content_of, extent_of
from stylesplat.scene.scene import Scene
from stylesplat.studio_app.session import Session

if TYPE_CHECKING:
    import viser


SECONDS = 0.5  # of a move
PAUSE = 1 / 20  # seconds between two poses: browsers without a GPU draw each of them

Vector = Float[np.ndarray, "3"]


@dataclass(frozen=True)
class CameraPose:
    """The pose of a browser's camera, in world coordinates."""

    position: Vector
    target: Vector
    """The middle of its picture, about which it turns."""
    up: Vector
    fov: float
    """Vertical, radians."""


def interpolate_poses(start: CameraPose, end: CameraPose, share: float) -> CameraPose:
    """A pose between two, which eases in and out, and goes round the target where that stays."""
    eased = share * share * (3 - 2 * share)

    def mix(a: Vector, b: Vector) -> Vector:
        return a + eased * (b - a)

    target = mix(start.target, end.target)
    away = mix(start.position - start.target, end.position - end.target)
    length = np.linalg.norm(away)
    lengths = [np.linalg.norm(each.position - each.target) for each in (start, end)]
    if length > 1e-6 * max(lengths):  # else it is on the other side: straight through
        away = away / length * (lengths[0] + eased * (lengths[1] - lengths[0]))
    up = mix(start.up, end.up)
    up = up / np.linalg.norm(up) if np.linalg.norm(up) > 1e-6 else end.up
    fov = start.fov + eased * (end.fov - start.fov)
    return CameraPose(target + away, target, up, fov)


def poses_between(
    start: CameraPose, end: CameraPose, seconds: float = SECONDS
) -> Iterator[CameraPose]:
    """Poses as time goes by; the last one is the end."""
    began = time.monotonic()
    while (share := (time.monotonic() - began) / max(seconds, 1e-9)) < 1:
        yield interpolate_poses(start, end, share)
        time.sleep(PAUSE)
    yield end


Compared = Literal["after", "before", "split"]

BACKGROUND = (0.086, 0.086, 0.094)  # colour behind the scene at first: that of the dark page
MOST_FRAMES = 60  # cameras of photos that are drawn
NEAREST = 0.1  # world units from a photo's camera to its target, at least
CLOSE = 1.6  # extents of an object between it and a camera close to it


class Viewport:
    """The picture: splats that follow the session, and exact pictures while cameras rest."""

    def __init__(self, server: "viser.ViserServer", session: Session) -> None:
        self.server, self.session = server, session
        self.background = BACKGROUND
        self.compared: Compared = "after"
        self.split = 0.5
        """The border of a split view, as a share of the picture's width."""
        self._holding = set[int]()
        self._moves = dict[int, object]()  # the last one of each browser
        scene = session.state.scene
        place_camera(server, scene.splats, scene.cameras)
        view = first_view(scene.splats, scene.cameras)
        self._first = CameraPose(
            *(each.double().numpy() for each in (view.position, view.target, view.up)),
            fov=server.initial_camera.fov,
        )
        self._last = self.display()
        self._splats = LiveSplats(server, self._last)
        self.rest = AtRest(server, session.worker, self.look)
        self.rest.set_paper(BACKGROUND)
        self._drawn_over = set[str]()
        self._frames = list["viser.CameraFrustumHandle"]()
        session.on_change.append(self.refresh)
        server.on_client_disconnect(lambda client: self.hold(client.client_id, False))
        count = len(scene.splats)
        if count > MOST:
            session.greetings.append(
                f"The browser moves {MOST:,} of {count:,} Gaussians; at rest the picture is of all."
            )

    def display(self) -> ViewerSplats:
        seen = self.session.display
        before = self.compared == "before" or self._holding
        if before and self.session.preview is None:
            return _before(self.session.state.scene, seen.hidden)
        return seen

    def refresh(self) -> None:
        """Update the picture, in the worker's thread."""
        self._last = self.display()
        self._splats.show(self._last)
        self.rest.active = not self.session.painting
        self.rest.behind = bool(self._drawn_over)
        self.rest.changed()

    def look(
        self, camera: Cameras, pointed: Bool[Tensor, " N"] | None = None
    ) -> UInt8[np.ndarray, "H W 3"]:
        """Render the exact picture of a camera, with the Gaussians below the pointer tinted."""
        image = replace(self._last, pointed=pointed).render(camera, self.background).numpy()
        if self.compared == "split" and not self._holding and self.session.preview is None:
            scene, hidden = self.session.state.scene, self._last.hidden
            before = _before(scene, hidden).render(camera, self.background).numpy()
            middle = round(self.split * image.shape[1])
            image[:, :middle] = before[:, :middle]
            image[:, max(0, middle - 1) : middle + 1] = 255
        return image

    def compare(self, compared: Compared, split: float | None = None) -> None:
        """Show the scene after or before painting, or both."""
        self.compared = compared
        self.split = self.split if split is None else split
        self.session.ask(self.refresh, kind="compare")

    @property
    def held(self) -> bool:
        return bool(self._holding)

    def hold(self, client_id: int, before: bool) -> None:
        """Show the scene before painting while a browser holds the key for that."""
        if before == (client_id in self._holding):
            return
        (self._holding.add if before else self._holding.discard)(client_id)
        self.session.ask(self._exchange, kind="compare")

    def _exchange(self) -> None:
        """Replace the picture without a gap, in the worker's thread."""
        self._last = self.display()
        self.rest.again()
        self._splats.show(self._last)

    def set_background(self, background: tuple[float, float, float]) -> None:
        self.background = background
        self.rest.set_paper(background)
        self.session.ask(self.refresh, kind="compare")

    def frames(self, show: bool) -> None:
        """Draw the cameras of the photos, or remove them."""
        for frame in self._frames:
            frame.remove()
        self._frames = []
        if show:
            cameras = self.session.state.scene.cameras
            for row in range(0, len(cameras), -(-len(cameras) // MOST_FRAMES)):
                self._frames.append(self._frame(cameras[row], _spacing(cameras)))
        self.draw_over("frames", show)

    def draw_over(self, what: str, there: bool) -> None:
        """Note that a thing is drawn in the scene, which exact pictures must not cover."""
        (self._drawn_over.add if there else self._drawn_over.discard)(what)
        self.session.ask(self.refresh, kind="compare")

    def _frame(self, camera: Cameras, size: float) -> "viser.CameraFrustumHandle":
        wxyz, position, fov = viser_pose(camera)
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
            self.move(event.client, photo_pose(self.session.state.scene, camera))

        return frame

    def move(self, client: "viser.ClientHandle", end: CameraPose) -> None:
        """Move a browser's camera; returns when it has arrived, or moves elsewhere."""
        move, camera = object(), client.camera
        self._moves[client.client_id] = move
        start = CameraPose(camera.position, camera.look_at, camera.up_direction, camera.fov)
        for pose in poses_between(start, end):
            if self._moves[client.client_id] is not move:
                return
            with client.atomic():
                camera.up_direction = pose.up
                camera.position = pose.position
                camera.look_at = pose.target
                camera.fov = pose.fov

    def home(self, client: "viser.ClientHandle") -> None:
        """Move a camera close to what is picked, on its side of that, or to where it began."""
        state, camera = self.session.state, client.camera
        picked = self.session.masks.together(state.scene, state.picked)
        if picked is None:
            self.move(client, self._first)
            return
        extent = extent_of(state.scene.splats, picked)
        centre = extent.centre.numpy()
        away = camera.position - centre
        away = away / max(float(np.linalg.norm(away)), 1e-9) * CLOSE * float(extent.size.norm())
        self.move(client, CameraPose(centre + away, centre, camera.up_direction, camera.fov))


def _before(scene: Scene, hidden: Bool[Tensor, " M"] | None) -> ViewerSplats:
    """The scene without its layers."""
    base = scene.unpainted
    return ViewerSplats(base, hidden=None if hidden is None else hidden[: len(base)])


def photo_pose(scene: Scene, camera: Cameras) -> CameraPose:
    """The pose of a photo, whose target is as far away as the content."""
    _, position, fov = viser_pose(camera)
    forward = camera.viewmats[0, 2, :3].double().numpy()
    content = content_of(scene.splats).extent.centre.double().numpy()
    distance = max(float((content - position) @ forward), NEAREST)
    return CameraPose(
        position, position + distance * forward, -camera.viewmats[0, 1, :3].double().numpy(), fov
    )


def viser_pose(camera: Cameras) -> tuple[np.ndarray, np.ndarray, float]:
    """Rotation to the world (wxyz), position and vertical field of view (radians) of a camera."""
    from viser.transforms import SO3

    rotation = camera.viewmats[0, :3, :3].double().numpy()
    height, focal = camera.sizes[0, 1], camera.Ks[0, 1, 1]
    fov = 2 * float(torch.atan(height / (2 * focal)))
    return SO3.from_matrix(rotation.T).wxyz, camera.positions[0].double().numpy(), fov


def _spacing(cameras: Cameras) -> float:
    """A size at which drawn cameras do not cover each other."""
    positions = cameras.positions.double()
    if len(cameras) < 2:
        return 0.1
    gaps = torch.cdist(positions, positions).fill_diagonal_(float("inf")).amin(dim=1)
    return float(gaps.median().clamp(min=1e-3)) / 3
