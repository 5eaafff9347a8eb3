"""Training on a GPU; on any machine, see `fake_cuda.py`. Its generators draw what a CPU's draw."""

from dataclasses import replace

import pytest
import torch

from fake_cuda import HostTrips, Operations, cuda  # noqa: F401  (a fixture)
from processes import begun
from stylesplat.scene.capture import Capture
from stylesplat.scene.outliers import scene_extent
from stylesplat.training.config import TrainConfig
from stylesplat.training.densification import MCMCStrategy
from stylesplat.training.loop import GPU_STEPS, fit
from stylesplat.training.state import State
from stylesplat.training.step import train_step

CONFIG = TrainConfig(
    steps=30,
    max_gaussians=200,
    refine_every=10,
    identity_every=1,
    color_correction="on",
    rate_factor=1.0,  # with large steps rounding decides sooner where copies go
)


class Noiseless(MCMCStrategy):
    """Grows and relocates, but moves nothing at random: devices shape their noise differently.

    The first Gaussians are made long: of round ones rounding decides along which axis they split.
    """

    def step_pre_backward(self, params, optimizers, state, step, info) -> None:
        super().step_pre_backward(params, optimizers, state, step, info)
        info["noise"].zero_()

    def step_post_backward(self, params, optimizers, state, step, info) -> None:
        if step == 0:
            params["scales"].data[:, 0] += 2.0  # splits take off .35 each
        super().step_post_backward(params, optimizers, state, step, info)


def test_the_same_is_learned_as_on_the_cpu(cuda: str, capture: Capture):  # noqa: F811
    losses: dict[str, list[float]] = {}

    def trained(device: str) -> State:
        reported = losses.setdefault(device, [])
        return fit(
            capture,
            CONFIG,
            device=device,
            on_progress=lambda _, loss, __: reported.append(loss),
            strategy=Noiseless(CONFIG, scene_extent(capture.cameras)),
        )

    found, expected = trained(cuda), trained("cpu")
    assert len(losses[cuda]) >= CONFIG.steps / GPU_STEPS and losses[cuda][-1] < losses[cuda][0]
    assert all(each.is_cuda and each.isfinite().all() for each in found.params.values())
    assert found.ids == expected.ids and len(found.splats) == len(expected.splats) == 200
    if torch.cuda.is_initialized():  # a GPU draws other numbers than the stand-in
        return
    order = torch.cdist(expected.splats.means, found.splats.means.cpu()).argmin(dim=1)
    assert len(order.unique()) == 200, "rounding may decide the order of rows, but of these alone"
    for name, there in found.params.items():
        here, there = expected.params[name].detach(), there.detach().cpu()
        if len(there) == len(order):
            there = there[order]
        error = (there - here).norm() / here.norm()
        # Rounding, which Adam blows up where gradients hardly differ from 0: rotations of round
        # Gaussians, bands that few cameras tell apart. A step without its corrections gives 0.1.
        assert error < (2e-2 if name in ("quats", "shN") else 5e-3), name


@pytest.mark.parametrize(("refine_poses", "most"), [(False, 300), (True, 410)])
def test_steps_never_wait_for_the_device_and_ask_for_few_operations(
    cuda: str,  # noqa: F811
    capture: Capture,
    refine_poses: bool,
    most: int,
):
    """See docs/scale.md for the operations."""
    config = replace(CONFIG, refine_poses=refine_poses)
    run, state = begun(capture, config, of_photos=True, device=torch.device(cuda))
    trips, counts = {}, {}
    with HostTrips() as mode, Operations() as operations:
        for step in range(config.refine_every):
            state, _ = train_step(run, state)
            trips[step], mode.found = mode.found, []
            counts[step], operations.count = operations.count, 0
    assert trips.pop(config.refine_every - 1), "growth asks the device"
    trips.pop(0)  # sends constants
    # of a real GPU the number of pairs, where Gaussians are sorted into tiles
    assert all(found in ([], ["__int__"]) for found in trips.values()), trips
    assert max(counts[step] for step in trips) <= most
