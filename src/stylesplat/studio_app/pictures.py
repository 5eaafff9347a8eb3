"""The pictures of a scene that browsers show, and what lies where in them.

A binary message is the length of its header (4 bytes, little-endian), the header as JSON, and the
content. Its field `kind` is

- `picture`: a JPEG; `which` is `after` or `before`. Of a band of a picture, whose `size` is that of
  the whole, `top` is its first row, and `last` says that the picture is complete;
- `map`: deflated, one byte a pixel, which object a click takes (1 is the first of `names`, 0 none),
  then two bytes a pixel, the depth as float16;
- `picked`: deflated, one byte a pixel, how much of it is picked;
- `splats`: the Gaussians, as `figures/web_page.py` packs them, for browsers that draw them.
"""

import json
import math
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any
from zlib import compress

import torch
from jaxtyping import Shaped
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.figures.pictures import to_uint8
from stylesplat.figures.web_page import pack
from stylesplat.io.images import jpeg
from stylesplat.rendering.render import render, render_row_bands
from stylesplat.rendering.weights import COVERED, composite, coverage
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.projection import depths_of
from stylesplat.scene.splats import Splats
from stylesplat.scene.virtual_cameras import centred_K
from stylesplat.studio_app.detail import ReducedSplats, most_visible
from stylesplat.studio_app.gallery import ThumbnailPixels
from stylesplat.studio_app.history import object_names
from stylesplat.studio_app.messages import ViewRequest
from stylesplat.studio_app.session import Callbacks, Display, Session

STUDIO_PICTURE_PIXELS = 960 * 540  # of the first picture at rest, which is there at once
SHARP_PIXELS = 2560 * 1440  # of the second, at most
BAND_PIXELS = 400_000  # of its bands: after each, what pages ask for meanwhile has its turn
BAND_STEP = 16  # rows: bands begin where blocks of JPEGs do
MOVING = STUDIO_PICTURE_PIXELS // 4  # of a picture while the camera moves
MAP = STUDIO_PICTURE_PIXELS // 4  # of a map
STUDIO_PICTURE_MOST = 500_000  # Gaussians that a browser draws; a laptop turns 300,000 smoothly
MOST_NAMES = 255  # objects that a map tells apart
ALIKE = 0.95  # of the largest share: of objects that show alike, the smallest is meant
STILL_QUALITY, MOVING_QUALITY = 92, 75  # of JPEGs

RgbColor = tuple[float, float, float]
BEHIND: RgbColor = (0.086, 0.086, 0.094)  # what pages draw until they ask for another colour


def camera_of(look: ViewRequest, pixels: int = STUDIO_PICTURE_PIXELS) -> Cameras:
    """The camera of a browser, with at most so many pixels."""
    camera = Cameras(
        viewmats=torch.tensor(look.viewmat).view(1, 4, 4),
        Ks=centred_K(look.focal, look.size)[None].float(),
        sizes=torch.tensor([look.size]),
        names=("browser",),
    )
    width, height = look.size
    return camera.downscale(max(1.0, math.sqrt(width * height / pixels)))


def binary_message(kind: str, content: bytes, **header: Any) -> bytes:
    head = json.dumps({"kind": kind, **header}).encode()
    return len(head).to_bytes(4, "little") + head + content


@torch.no_grad()
def render_pixels(splats: Splats, camera: Cameras, background: RgbColor) -> ThumbnailPixels:
    behind = torch.tensor(background).to(splats.means)
    image, _ = render(splats, camera, background=behind)
    return to_uint8(image).cpu().numpy()


class Pictures:
    def __init__(self, session: Session, before: Callable[[], Display]) -> None:
        self.session, self._before = session, before
        self.background = BEHIND
        self.looks = dict[int, ViewRequest]()
        self.on_rest = Callbacks()
        """Called with what is displayed and a picture of it that a page gets."""
        self.client = 0
        """The page that asks for what the worker does."""
        self._sent = dict[tuple[int, str], object]()  # what each browser has of each kind
        self._packed: tuple[Display, bytes] | None = None
        self._reduced = dict[str, tuple[Display, ReducedSplats]]()  # of a moving camera
        session.on_change.append(self.refresh)

    def look(self, client: int, look: ViewRequest) -> None:
        self.looks[client] = look
        self._ask(client)

    def camera(self, pixels: int = STUDIO_PICTURE_PIXELS) -> Cameras:
        """The camera of the page that asks."""
        look = self.looks.get(self.client)
        if look is None:
            raise StyleSplatError("This page has no picture yet.")
        return camera_of(look, pixels)

    def leave(self, client: int) -> None:
        self.looks.pop(client, None)
        for key in [key for key in self._sent if key[0] == client]:
            del self._sent[key]

    def refresh(self) -> None:
        """Ask for all pictures that a change of the state concerns, in the worker's thread."""
        for client in [*self.looks]:
            self._ask(client)

    def _ask(self, client: int) -> None:
        with self.session.telling(client):
            self.session.ask(partial(self._picture, client), kind=f"picture {client}")

    def _picture(self, client: int) -> None:
        """Send the picture, and ask for all else, for which a large scene takes long."""
        look = self.looks.get(client)
        if look is None:
            return
        if look.moving:
            self._render(client, look, MOVING)
            return
        if self._is_sharp_next(client, look):
            self._sharp(client, look)
        else:
            self._render(client, look, STUDIO_PICTURE_PIXELS)
        scene, masks = self.session.state.scene, self.session.masks
        for name in object_names(scene):
            if not masks.has(scene, name):
                self.session.ask(partial(self._find, name), kind=f"find {name}", patient=True)
        for job in (self._sharp, self._map, self._picked, self._splats):  # after all that waits
            if look.draws or job != self._splats:
                kind = f"{job.__name__} {client}"
                self.session.ask(partial(self._at_rest, job, client), kind=kind, patient=True)

    def _displays(self, look: ViewRequest) -> dict[str, Display]:
        before = {"before": self._before()} if look.before else {}
        return {"after": self.session.display, **before}

    def _has_sharp(self, look: ViewRequest) -> bool:
        """Whether the window is large; a painting goes on in place of its sharp picture."""
        return math.prod(look.size) > STUDIO_PICTURE_PIXELS and not self.session.painting

    def _is_sharp_next(self, client: int, look: ViewRequest) -> bool:
        """Whether the camera alone has moved: what moved with it stays until the sharp picture."""
        seen = all(
            self._sent.get((client, f"{which} seen")) == (display, self.background)
            for which, display in self._displays(look).items()
        )
        return seen and self._has_sharp(look)

    def _render(self, client: int, look: ViewRequest, pixels: int) -> None:
        """Send the pictures, of so many pixels at most, that the browser does not have yet."""
        camera = camera_of(look, pixels)
        for which, display in self._displays(look).items():
            value = look.number, look.moving, display, self.background
            if not look.moving:
                self._sent[client, f"{which} seen"] = value[2:]
            if self._is_new(client, f"{which} {pixels}", value):
                splats = self._moving(which, display, camera) if look.moving else display.visible
                content = render_pixels(splats, camera, self.background)
                if not look.moving:
                    self._sent.pop((client, f"{which} sharp"), None)  # it takes the place of that
                if which == "after" and not look.moving:
                    self.on_rest.call(display, content)
                content = jpeg(content, MOVING_QUALITY if look.moving else STILL_QUALITY)
                header = {"which": which, "moving": look.moving, "drawn": self._has_splats(client)}
                self._send(client, which, "picture", content, look, **header)

    def _moving(self, which: str, display: Display, camera: Cameras) -> Splats:
        """What shows while the camera moves: on a CPU a part of many Gaussians."""
        if display.visible.device.type != "cpu":
            return display.visible
        known = self._reduced.get(which)
        if known is None or known[0] is not display:
            known = self._reduced[which] = display, ReducedSplats(display.visible)
        return known[1].seen_from(camera)

    def _sharp(self, client: int, look: ViewRequest) -> None:
        """In a large window, send the picture with all its pixels in bands, the middle first.

        What pages ask for meanwhile is done between them, and ends it where it changes the picture.
        """
        if not self._has_sharp(look):
            return
        camera, background = camera_of(look, SHARP_PIXELS), self.background
        size = width, total = camera.size
        height = BAND_STEP * math.ceil(BAND_PIXELS / width / BAND_STEP)
        for which, display in self._displays(look).items():
            key, value = (client, f"{which} sharp"), (look.number, display, background)
            if self._sent.get(key) == value:
                continue
            behind, rows = torch.tensor(background).to(display.visible.means), 0
            bands = render_row_bands(display.visible, camera, background=behind, height=height)
            for top, image in bands:
                rows += len(image)
                header = {"moving": False, "drawn": self._has_splats(client), "last": rows == total}
                header |= {"which": which, "top": top, "size": size}
                content = jpeg(to_uint8(image).cpu().numpy(), STILL_QUALITY)
                self._send(client, f"{which} {top}", "picture", content, look, **header)
                self.session.worker.run_urgent_jobs()
                now = self.looks.get(client), self._displays(look)[which], self.background
                if now != (look, display, background) or not self._has_sharp(look):
                    return
            self._sent[key] = value

    def _find(self, name: str) -> None:
        with suppress(StyleSplatError):  # an id without Gaussians
            self.session.masks.of(self.session.state.scene, name)
            self.session.on_change.call()

    def _at_rest(self, job: Callable[[int, ViewRequest], None], client: int) -> None:
        look = self.looks.get(client)
        if look is not None and not look.moving:
            job(client, look)

    def _is_new(self, client: int, kind: str, value: object) -> bool:
        """Whether a browser does not have this yet; it has from now on."""
        if self._sent.get((client, kind)) == value:
            return False
        self._sent[client, kind] = value
        return True

    def _has_splats(self, client: int) -> bool:
        """Whether a browser that draws has the Gaussians that are displayed now."""
        return self._sent.get((client, "splats")) is self.session.display

    def _send(
        self, client: int, key: str, kind: str, content: bytes, look: ViewRequest, **header: Any
    ) -> None:
        message = binary_message(kind, content, look=look.number, **header)
        self.session.on_send.call(client, key, message)

    @torch.no_grad()
    def _map(self, client: int, look: ViewRequest) -> None:
        session, state = self.session, self.session.state
        scene, names = state.scene, object_names(state.scene)[:MOST_NAMES]
        names = [n for n in names if n not in state.hidden and session.masks.has(scene, n)]
        masks = [scene.to_splats(session.masks.of(scene, name)) for name in names]
        display = session.display_of(state)  # not a painting under way: clicks take the same
        key = look.number, display, *zip(names, map(_digest, masks), strict=True)
        if not self._is_new(client, "map", key):
            return
        camera, splats = camera_of(look, MAP), display.visible
        counts = torch.tensor([int(mask.sum()) for mask in masks])
        columns = [display.shown(mask).to(splats.means) for mask in masks]
        columns += [torch.ones_like(splats.opacities), depths_of(splats.means, camera)]
        image = composite(splats, camera, torch.stack(columns, dim=1)).cpu()
        alphas, depths = image[..., -2], image[..., -1]
        ids = torch.zeros(alphas.shape, dtype=torch.uint8)
        if names:
            seen = image[..., :-2]
            most = seen.amax(dim=-1, keepdim=True)
            sizes = counts.expand_as(seen).masked_fill(seen < ALIKE * most, 2**62)
            found = sizes.argmin(dim=-1) + 1
            ids = (found * (most[..., 0] >= COVERED)).to(torch.uint8)
        depths = torch.where(alphas > 0.5, depths / alphas.clamp(min=1e-6), 0.0)
        content = compress(ids.numpy().tobytes() + depths.half().numpy().tobytes(), 1)
        self._send(client, "map", "map", content, look, size=camera.size, names=names)

    def _picked(self, client: int, look: ViewRequest) -> None:
        session, state = self.session, self.session.state
        selection, rows = state.selection, session.masks.together(state.scene, state.picked)
        if selection is not None:
            rows = selection.weights / 255
        picked = None if rows is None else state.scene.to_splats(rows)
        display = session.display_of(state)
        key = look.number, display, state.picked, None if picked is None else _digest(picked)
        if not self._is_new(client, "picked", key):
            return
        camera, content = camera_of(look, MAP), b""
        if picked is not None and display.shown(picked).any():
            share = coverage(display.visible, camera, display.shown(picked))
            content = compress((255 * share.cpu().clamp(max=1)).round().byte().numpy().tobytes(), 1)
        header = {"size": camera.size, "names": state.picked, "selected": selection is not None}
        self._send(client, "picked", "picked", content, look, **header)

    def _splats(self, client: int, look: ViewRequest) -> None:
        display = self.session.display
        if self.session.painting or not self._is_new(client, "splats", display):
            return
        if self._packed is None or self._packed[0] is not display:
            base = self.session.state.scene.base
            before = Display(base, None if display.hidden is None else display.hidden[: len(base)])
            splats, base = (each.visible.detach().to("cpu") for each in (display, before))
            rows = most_visible(splats, STUDIO_PICTURE_MOST)
            packed = pack(splats[rows], base[rows[rows < len(base)]], sh_degree=0, level=1)
            self._packed = display, binary_message("splats", packed.content, **packed.about)
        self.session.on_send.call(client, "splats", self._packed[1])


def _digest(mask: Shaped[Tensor, " N"]) -> int:
    return hash(mask.cpu().numpy().tobytes())
