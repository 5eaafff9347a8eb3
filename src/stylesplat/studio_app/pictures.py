"""The pictures of a scene that browsers show, and what lies where in them.

A binary message is the length of its header (4 bytes, little-endian), the header as JSON, and the
content. Its field `kind` is

- `picture`: a JPEG; `which` is `after` or `before`;
- `map`: deflated, one byte a pixel, which object a click takes (1 is the first of `names`, 0 none),
  then two bytes a pixel, the depth as float16;
- `picked`: deflated, one byte a pixel, how much of it is picked;
- `splats`: the Gaussians, as `figures/packed.py` packs them, for browsers that draw them.
"""

import json
import math
from collections.abc import Callable
from functools import partial
from typing import Any
from zlib import compress

import torch
from jaxtyping import Int
from torch import Tensor

from stylesplat.figures.packed import pack
from stylesplat.figures.pictures import to_uint8
from stylesplat.rendering.render import render
from stylesplat.rendering.shares import coverage, render_shares
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.compose import splats_without_paint
from stylesplat.scene.framing import centred_K
from stylesplat.scene.projection import depths_of
from stylesplat.scene.splats import Splats
from stylesplat.selection.identities import MIN_COVERAGE
from stylesplat.studio_app.history import object_names
from stylesplat.studio_app.messages import Look
from stylesplat.studio_app.session import Display, Session
from stylesplat.studio_app.thumbnails import Pixels, jpeg

PIXELS = 960 * 540  # of a picture at rest: more takes too long
MOVING = PIXELS // 4  # of a picture while the camera moves
MAP = PIXELS // 4  # of a map
MOST = 500_000  # Gaussians that a browser draws; a laptop turns 300,000 smoothly
MOST_NAMES = 255  # objects that a map tells apart
ALIKE = 0.95  # of the largest share: of objects that show alike, the smallest is meant
QUALITY, MOVING_QUALITY = 92, 75  # of JPEGs

Color = tuple[float, float, float]
Send = Callable[[int, str, bytes], None]


def camera_of(look: Look, pixels: int = PIXELS) -> Cameras:
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
def render_display(display: Display, camera: Cameras, background: Color) -> Pixels:
    """The exact picture, with colours that depend on the view."""
    behind = torch.tensor(background).to(display.splats.means)
    image, _ = render(display.visible, camera, background=behind)
    return to_uint8(image).cpu().numpy()


class Pictures:
    """Sends each browser the pictures of its camera, made in the worker's thread."""

    def __init__(self, session: Session, before: Callable[[], Display], send: Send) -> None:
        self.session, self._before, self._send = session, before, send
        self.background: Color = (0.086, 0.086, 0.094)
        self._looks = dict[int, Look]()
        self._sent = dict[tuple[int, str], object]()  # what each browser has of each kind
        self._display = session.display
        self._packed: tuple[Display, bytes] | None = None
        self._without_preview = session.display  # what clicks take; a painting does not change it
        session.on_change.append(self.refresh)

    def look(self, client: int, look: Look) -> None:
        """Ask for the picture of a camera."""
        self._looks[client] = look
        self._ask(client)

    @property
    def looks(self) -> tuple[Look, ...]:
        """The cameras of all browsers."""
        return tuple(self._looks.values())

    def look_of(self, client: int) -> Look | None:
        return self._looks.get(client)

    def leave(self, client: int) -> None:
        self._looks.pop(client, None)
        for key in [key for key in self._sent if key[0] == client]:
            del self._sent[key]

    def refresh(self) -> None:
        """Ask for all pictures that a change of the state concerns, in the worker's thread."""
        display = self.session.display
        if not _is_same(display, self._display):
            self._display = display
        for client in [*self._looks]:
            self._ask(client)

    def _ask(self, client: int) -> None:
        job = partial(self._picture, client)
        self.session.ask(job, kind=f"picture {client}")

    def _picture(self, client: int) -> None:
        look = self._looks.get(client)
        if look is None:
            return
        camera = camera_of(look, MOVING if look.moving else PIXELS)
        quality = MOVING_QUALITY if look.moving else QUALITY
        kinds: dict[str, Display] = {"after": self._display}
        if look.before:
            kinds["before"] = self._before()
        for which, display in kinds.items():
            if self._is_new(client, which, (look.number, look.moving, display, self.background)):
                pixels = render_display(display, camera, self.background)
                header = {"which": which, "look": look.number, "moving": look.moving}
                message = binary_message("picture", jpeg(pixels, quality), **header)
                self._send(client, which, message)
        if not look.moving:
            jobs = {"map": self._map, "picked": self._picked, "splats": self._splats}
            for name, job in jobs.items():  # after all that is waiting, such as a slider's next
                if look.draws or name != "splats":
                    self.session.ask(partial(job, client), kind=f"{name} {client}", patient=True)

    def _is_new(self, client: int, kind: str, value: object) -> bool:
        """Whether a browser does not have this yet; it has from now on."""
        if self._sent.get((client, kind)) == value:
            return False
        self._sent[client, kind] = value
        return True

    def _resting(self, client: int) -> Look | None:
        look = self._looks.get(client)
        return None if look is None or look.moving else look

    def _of_state(self) -> Display:
        """What the state displays, which is not what a painting under way does."""
        display = self.session.display_of(self.session.state)
        if not _is_same(display, self._without_preview):
            self._without_preview = display
        return self._without_preview

    @torch.no_grad()
    def _map(self, client: int) -> None:
        look, state = self._resting(client), self.session.state
        if look is None:
            return
        scene, names = state.scene, object_names(state.scene)[:MOST_NAMES]
        names = [name for name in names if name not in state.hidden]
        display = self._of_state()
        if not self._is_new(client, "map", (look.number, display, tuple(names))):
            return
        camera, splats = camera_of(look, MAP), display.visible
        masks = [self.session.masks.of(scene, name) for name in names]
        counts = torch.tensor([int(mask.sum()) for mask in masks])
        columns = [mask.to(splats.means) for mask in masks]
        if display.hidden is not None:
            columns = [column[~display.hidden] for column in columns]
        columns += [torch.ones_like(splats.opacities), depths_of(splats.means, camera)]
        image = render_shares(splats, camera, torch.stack(columns, dim=1)).cpu()
        alphas, depths = image[..., -2], image[..., -1]
        ids = torch.zeros(alphas.shape, dtype=torch.uint8)
        if names:
            seen = image[..., :-2]
            most = seen.amax(dim=-1, keepdim=True)
            sizes = counts.expand_as(seen).masked_fill(seen < ALIKE * most, 2**62)
            found = sizes.argmin(dim=-1) + 1
            ids = (found * (most[..., 0] >= MIN_COVERAGE)).to(torch.uint8)
        depths = torch.where(alphas > 0.5, depths / alphas.clamp(min=1e-6), 0.0)
        content = ids.numpy().tobytes() + depths.half().numpy().tobytes()
        header = {"look": look.number, "size": camera.size, "names": names}
        self._send(client, "map", binary_message("map", compress(content, 1), **header))

    def _picked(self, client: int) -> None:
        look, state = self._resting(client), self.session.state
        if look is None:
            return
        picked = self.session.masks.together(state.scene, state.picked)
        display = self._of_state()
        if not self._is_new(client, "picked", (look.number, display, state.picked)):
            return
        camera, content = camera_of(look, MAP), b""
        if picked is not None:
            if display.hidden is not None:
                picked = picked[~display.hidden]
            if picked.any():
                share = coverage(display.visible, camera, picked)
                content = compress((255 * share.cpu()).round().byte().numpy().tobytes(), 1)
        header = {"look": look.number, "size": camera.size, "names": state.picked}
        self._send(client, "picked", binary_message("picked", content, **header))

    def _splats(self, client: int) -> None:
        if self.session.painting or not self._is_new(client, "splats", self._display):
            return
        if self._packed is None or self._packed[0] is not self._display:
            self._packed = self._display, self._pack()
        self._send(client, "splats", self._packed[1])

    def _pack(self) -> bytes:
        display, scene = self._display, self.session.state.scene
        splats, before = (
            display.splats.detach().to("cpu"),
            splats_without_paint(scene).detach().to("cpu"),
        )
        if display.hidden is not None:
            splats, before = splats[~display.hidden], before[~display.hidden]
        rows = weightiest(splats, MOST)
        if rows is not None:
            splats, before = splats[rows], before[rows]
        packed = pack(splats, before, sh_degree=0, level=1)
        return binary_message("splats", packed.content, **packed.about)


def _is_same(one: Display, other: Display) -> bool:
    if one.splats.sh0 is not other.splats.sh0 or one.splats.opacities is not other.splats.opacities:
        return False
    if one.hidden is None or other.hidden is None:
        return one.hidden is other.hidden
    return torch.equal(one.hidden, other.hidden)


def weightiest(splats: Splats, count: int) -> Int[Tensor, " M"] | None:
    """Rows of the `count` Gaussians of the largest visible area; None if there are not more."""
    if len(splats) <= count:
        return None
    sizes = splats.scales.sort(dim=1).values[:, 1:].sum(dim=1)  # logarithm of the larger area
    weights = torch.nn.functional.logsigmoid(splats.opacities) + sizes
    return weights.topk(count).indices.sort().values
