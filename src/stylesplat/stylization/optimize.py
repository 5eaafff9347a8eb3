"""The optimisation of an object's colours against style features."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.optim.lr_scheduler import ExponentialLR
from tqdm import tqdm

from stylesplat.rendering.rasterize import Backend, rasterize
from stylesplat.rendering.sh import sh0_from_rgb
from stylesplat.scene.splats import Splats
from stylesplat.stylization.config import StyleConfig
from stylesplat.stylization.features import FeatureNetwork
from stylesplat.stylization.measure import view_loss
from stylesplat.stylization.views import ObjectView

SHN_SLOWDOWN = 20  # the official code's ratio of the rates of sh0 and shN
REPORT_EVERY = 10  # steps between two updates of the loss shown


def optimize_colors(
    splats: Splats,
    picked: Bool[Tensor, " N"],
    views: Sequence[ObjectView],
    targets: Sequence[Float[Tensor, "_ _"]],
    network: FeatureNetwork,
    *,
    config: StyleConfig,
    title: str,
    backend: Backend = "auto",
) -> Splats:
    """Move the colours of picked Gaussians until the object's features match the style's.

    Gradients are asked for the picked rows of `sh0` (and `shN`) only, so the rasteriser skips
    those of everything else.

    Args:
        splats: The scene, without gradients.
        picked: The object's Gaussians.
        views: Of the object; one is drawn per step.
        targets: Features of the style image, for each block.
        network: Whose features these are.
        config: Settings.
        title: Of the progress bar.
        backend: Of the rasteriser.
    """
    generator = torch.Generator().manual_seed(config.seed)
    targets = [_sample(target, config.style_samples, generator) for target in targets]
    rows = picked.nonzero()[:, 0]
    fields = ("sh0", "shN") if config.view_dependent else ("sh0",)
    leaves = {name: getattr(splats, name)[rows].requires_grad_() for name in fields}
    optimizer = torch.optim.Adam(
        [
            {"params": [leaf], "lr": config.lr / (SHN_SLOWDOWN if name == "shN" else 1)}
            for name, leaf in leaves.items()
        ],
        eps=1e-15,  # as in 3D Gaussian splatting: gradients of single Gaussians are tiny
    )
    scheduler = ExponentialLR(optimizer, config.final_lr ** (1 / config.steps))
    bar = tqdm(_draws(views, config.steps, generator), total=config.steps, desc=title)
    for step, view in enumerate(bar):
        image, _, _ = rasterize(_with_rows(splats, leaves, rows), view.camera, backend=backend)
        loss = view_loss(image[0], view, targets, network, config.blocks)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        scheduler.step()
        _keep_in_range(leaves["sh0"])
        if step % REPORT_EVERY == 0:
            bar.set_postfix(nnfm=f"{loss.item():.3f}")
    return _with_rows(splats, leaves, rows).detach()


def _with_rows(splats: Splats, leaves: dict[str, Tensor], rows: Tensor) -> Splats:
    return replace(
        splats,
        **{name: getattr(splats, name).index_copy(0, rows, leaf) for name, leaf in leaves.items()},
    )


@torch.no_grad()
def _keep_in_range(sh0: Tensor) -> None:
    """Colours that the rasteriser clamps at 0 would have no gradient to come back by."""
    black, white = sh0_from_rgb(torch.tensor([[0.0], [1.0]]).expand(2, 3)).to(sh0)
    sh0.clamp_(black, white)


def _draws(
    views: Sequence[ObjectView], count: int, generator: torch.Generator
) -> Iterator[ObjectView]:
    """Views in random order, each as often as the others."""
    order: list[int] = []
    for _ in range(count):
        order = order or torch.randperm(len(views), generator=generator).tolist()
        yield views[order.pop()]


def _sample(feats: Tensor, count: int | None, generator: torch.Generator) -> Tensor:
    if count is None or count >= len(feats):
        return feats
    return feats[torch.randperm(len(feats), generator=generator)[:count].to(feats.device)]
