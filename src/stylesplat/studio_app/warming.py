"""What every painting needs first, fetched before somebody asks for one."""

from typing import TYPE_CHECKING, Any

import torch

from stylesplat.progress import Silence, observed
from stylesplat.scene.ring import ring_cameras
from stylesplat.scene.scene import Scene, SceneObject
from stylesplat.scene.splats import Splats
from stylesplat.stylization.config import StyleConfig
from stylesplat.stylization.style import Style
from stylesplat.verbs.stylize_live import stylize_live
from stylesplat.work import Worker

if TYPE_CHECKING:
    import viser

WAIT = 1.0  # seconds in which the first picture is made
GAUSSIANS = 300
NAME = "noise"


def warm_up_for_the_first(server: "viser.ViserServer", worker: Worker, **options: Any) -> None:
    """Warm up as soon as the first browser has its picture."""
    joined = list[bool]()

    async def join(client: "viser.ClientHandle") -> None:
        if not joined:
            joined.append(True)
            server.get_event_loop().call_later(WAIT, ask)

    def ask() -> None:
        worker.ask(lambda: warm_up(worker, **options), patient=True)

    server.on_client_connect(join)


def warm_up(worker: Worker, **options: Any) -> None:
    """Paint a ball of noise for a step: kernels, libraries and the network are there afterwards.

    Args:
        worker: In whose thread this is; it does what it is asked for meanwhile.
        options: Of `stylize_live`.
    """
    style = Style(torch.rand(64, 64, 3), config=StyleConfig(steps=1, quality="draft"))
    with observed(_Breath(worker)):
        for _ in stylize_live(ball_of_noise(), NAME, style, **options):
            pass


def ball_of_noise() -> Scene:
    """A small scene."""
    generator = torch.Generator().manual_seed(0)
    splats = Splats(
        means=torch.nn.functional.normalize(torch.randn(GAUSSIANS, 3, generator=generator), dim=1),
        quats=torch.tensor([[1.0, 0, 0, 0]]).repeat(GAUSSIANS, 1),
        scales=torch.full((GAUSSIANS, 3), -1.6),
        opacities=torch.full((GAUSSIANS,), 3.0),
        sh0=torch.randn(GAUSSIANS, 1, 3, generator=generator),
        shN=torch.zeros(GAUSSIANS, 15, 3),
    )
    cameras = ring_cameras(splats, torch.tensor([0.0, 0.0, 1.0])).at_most(64)
    picked = torch.ones(GAUSSIANS, dtype=torch.bool)
    return Scene(splats, cameras, objects={NAME: SceneObject(picked)})


class _Breath(Silence):
    """Tells nothing, and lets short work in."""

    def __init__(self, worker: Worker) -> None:
        self._worker = worker

    def advance(self, amount: int | float = 1) -> None:
        """Something may wait."""
        self._worker.breathe()
