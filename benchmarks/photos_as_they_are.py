"""What do learned exposures and refined poses gain, where photos and poses are off and where not?

    .venv/bin/python benchmarks/photos_as_they_are.py                 # fox and desk
    .venv/bin/python benchmarks/photos_as_they_are.py --scenes fox --steps 3000 --downscale 2

Photos as they are; with gains of 0.6 to 1.6 in linear light and shifts of white balance; and with
poses that are 0.5 degrees and 1 % of the scene's radius off. Each is trained with and without the
remedy, for the same steps. Held-out photos are measured as they are ("plain"), and half by half,
each half fitted on the other ("fitted"); of runs with and without alike. Points take the colours
that the changed photos show there.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
import tyro
from bench import capture, machine, table
from jaxtyping import Float
from torch import Tensor

from stylesplat.evaluation.photos import Fits, evaluate_views
from stylesplat.scene.capture import Capture
from stylesplat.scene.projection import project, shown
from stylesplat.training.initialize import scene_extent
from stylesplat.training.loop import fit
from stylesplat.training.per_photo import shift_cameras, with_refined_cameras
from stylesplat.training.train_config import TrainConfig
from stylesplat.training.training_views import split_views

GAINS = (0.6, 1.6)  # in linear light
TINT = 0.08  # standard deviation of the logarithms of channels' gains
TURN, SHIFT = 0.5, 0.01  # degrees, and shares of the cameras' radius
EXTENT_OVER_RADIUS = 1.1  # `scene_extent`'s
HEADS = (
    "scene",
    "photos",
    "trained",
    "held-out PSNR, plain",
    "fitted",
    "SSIM, fitted",
    "cameras off by",
    "ms a step",
)


@dataclass(frozen=True)
class Options:
    """What to train."""

    scenes: tuple[str, ...] = ("fox", "desk")
    """Folders in `../shared/data`."""
    downscale: float = 4
    """How many times smaller the photos shall be."""
    steps: int = 1500
    """Of each run."""
    max_gaussians: int = 30_000
    """Gaussians at most."""
    seed: int = 0
    """Seed of what is changed and of training."""
    changes: tuple[str, ...] = ("none", "exposures", "poses")
    """Which of these to measure."""


def exposed(photos: Capture, seed: int) -> Capture:
    """Photos of other exposures and white balances."""
    random = torch.Generator().manual_seed(seed)
    low, high = torch.tensor(GAINS).log()
    gains = low + (high - low) * torch.rand(len(photos), 1, generator=random)
    gains = (gains + TINT * torch.randn(len(photos), 3, generator=random)).exp()
    changed = [_brighter(photos.photos[row], gains[row]) for row in range(len(photos))]
    return _with_own_colors(replace(photos, photos=changed))


def shaken(photos: Capture, seed: int) -> Capture:
    """The capture with poses that are a little off, all by as much."""
    random = torch.Generator().manual_seed(seed)
    turns, shifts = torch.nn.functional.normalize(
        torch.randn(2, len(photos), 3, generator=random), dim=-1
    )
    noise = torch.cat([turns * torch.tensor(TURN).deg2rad(), shifts * SHIFT], dim=1)
    return replace(photos, cameras=shift_cameras(photos.cameras, noise, _radius(photos)))


def _brighter(photo: Tensor, gain: Float[Tensor, "3"]) -> Tensor:
    """sRGB bytes of so many times the light."""
    values = photo / 255
    light = torch.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)
    light = (light * gain).clamp(0, 1)
    values = torch.where(light <= 0.0031308, light * 12.92, 1.055 * light ** (1 / 2.4) - 0.055)
    return (255 * values).round().to(torch.uint8)


def _with_own_colors(photos: Capture) -> Capture:
    """Points in the mean colours of the training photos, not those of the photos before."""
    assert photos.points is not None
    sums, counts = torch.zeros(len(photos.points), 3), torch.zeros(len(photos.points), 1)
    for row in split_views(photos, TrainConfig.test_every)[0]:
        seen = shown(photos.points, photos.cameras[row])
        x, y = project(photos.points[seen], photos.cameras[row])[0].floor().long().unbind(dim=1)
        sums[seen] += photos.photos[row][y, x].float()
        counts[seen] += 1
    means = torch.where(counts > 0, sums / counts.clamp(min=1), 128.0)
    return replace(photos, point_colors=means.round().to(torch.uint8))


def _radius(photos: Capture) -> float:
    return scene_extent(photos.cameras) / EXTENT_OVER_RADIUS


def poses_off(found: Capture, truth: Capture) -> str:
    """How far the training cameras are from the true ones, beyond all together."""
    rows, _ = split_views(truth, TrainConfig.test_every)
    ours, theirs = found.cameras[rows], truth.cameras[rows]
    turns = theirs.viewmats[:, :3, :3].mT @ ours.viewmats[:, :3, :3]
    axes = torch.stack([turns[:, 2, 1], turns[:, 0, 2], turns[:, 1, 0]], dim=1)  # small angles
    angle, gap = (
        (each - each.mean(dim=0)).square().sum(dim=1).mean().sqrt()
        for each in (axes, ours.positions - theirs.positions)
    )
    return f"{angle.rad2deg():.2f} degrees, {gap / _radius(truth):.2%}"


def row_of(photos: Capture, truth: Capture, config: TrainConfig, what: str) -> list[object]:
    """Train and measure."""
    state = fit(photos, config)
    rows, held_out = split_views(photos, config.test_every)
    fits = Fits(colors=what != "poses", pose=what == "poses", unit=scene_extent(photos.cameras))
    scores = evaluate_views(state.splats.detach(), photos, held_out, fits=fits)
    remedy = ", ".join(n for n in ("color_maps", "pose_shifts") if n in state.params)
    return [
        remedy or "as given",
        f"{scores['psnr_unfitted']:.2f} dB",
        f"{scores['psnr']:.2f} dB",
        f"{scores['ssim']:.4f}",
        poses_off(with_refined_cameras(photos, state, rows), truth),
        f"{1e3 * state.seconds / state.step:.0f}",
    ]


CHANGES: dict[str, Callable[[Capture, int], Capture]] = {
    "none": lambda photos, seed: photos,
    "exposures": exposed,
    "poses": shaken,
}


def main(options: Options) -> None:
    """Print the table, row by row as they come, and whole at the end."""
    print(f"{options.steps} steps at 1/{options.downscale:g}, {machine()}")
    rows: list[list[object]] = []
    for scene in options.scenes:
        truth = _with_own_colors(capture(scene, options.downscale, identities=False))
        for what in options.changes:
            photos = CHANGES[what](truth, options.seed)
            for config in _configs(options, what):
                rows.append([scene, what, *row_of(photos, truth, config, what)])
                print(*rows[-1], sep=" | ", flush=True)
    print(table(HEADS, rows))


def _configs(options: Options, what: str) -> list[TrainConfig]:
    """Without and with each remedy; photos as they are try both."""
    plain = TrainConfig(
        steps=options.steps,
        max_gaussians=options.max_gaussians,
        seed=options.seed,
        color_correction="off",
    )
    corrected, posed = replace(plain, color_correction="on"), replace(plain, refine_poses=True)
    remedies = {"none": [corrected, posed], "exposures": [corrected], "poses": [posed]}
    return [plain, *remedies[what]]


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
