"""Densification as sampling: dead Gaussians move to where opaque ones are (3DGS-MCMC).

Kheradmand et al. 2024. A Gaussian that is copied becomes smaller and no more opaque, so that it and
its copies, here side by side, look about as it did; noise in proportion to transparency lets
Gaussians explore. The paper copies in proportion to opacity; here also to a score of positional
gradients (`take_scores`), by which 3DGS finds where Gaussians are too few (Kerbl et al. 2023).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from inspect import signature
from math import comb, exp
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numba
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from stylesplat.errors import count_noun
from stylesplat.io.splats.packing import morton_order
from stylesplat.io.splats.splat_ply import SMALLEST_QUAT
from stylesplat.io.tensors import GAUSSIANS, IDENTITIES, rows_in_range
from stylesplat.progress import say
from stylesplat.rendering.kernels.jit import kernel
from stylesplat.rendering.nvrtc import for_each_row
from stylesplat.rendering.reference import rotation_matrices
from stylesplat.rendering.view_pool import per_view
from stylesplat.rendering.weights import backproject, geometry_only
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import Splats
from stylesplat.training.adam import TensorOptimizer
from stylesplat.training.config import TrainConfig, means_decay

DEAD_OPACITY = 0.005
MAX_COPIES = 51  # of one Gaussian at a time (official)
# Deviation of a Gaussian and its copies along its longest axis, in its own (official: 0). Two faint
# ones are as far apart as leaves no dip between them
COPY_SPREAD = 0.5**0.5
MAX_OPACITY = 1 - 1e-6  # of a copy; its logit is finite
# Over the extent. Official: 80 (5e5 times the rate of the means) times the extent, which is as much
# at an extent of 8
NOISE_RATE = 5000.0
NOISE_SHARPNESS = 100.0  # of the threshold at the opacity of dead Gaussians
# Pixels of all photos together: without Gaussians that have fewer, held-out photos of fox, desk and
# toy stay within .003 dB, those of the cape within .02
SHOWN_LEAST = 1.0
LEAST_CHANGE = 0.02  # of the mean, so that what has no gradient yet may be copied, too
DENSE_OPAQUE = -1.8  # logit of 0.14; above it the noise is a millionth and not worth its time
OPACITY_WEIGHT = 0.01  # of the regularisers that let Gaussians die
SCALE_WEIGHT = 0.08  # official: 0.01, at an extent of 8
NOISE_CONSTANTS = {
    "DEAD_OPACITY": DEAD_OPACITY,
    "NOISE_SHARPNESS": NOISE_SHARPNESS,
    "DENSE_OPAQUE": DENSE_OPAQUE,
}
KERNEL = Path(__file__).with_name("add_noise.cu")
DECLARED = GAUSSIANS | {"identities": IDENTITIES}

Params = dict[str, Tensor]
Optimizers = dict[str, TensorOptimizer]
StepValues = dict[str, Any]


@runtime_checkable
class Strategy(Protocol):
    """How training moves, adds and removes Gaussians: gsplat's interface, so that its own fit.

    Both methods are called as gsplat calls them, `(params, optimizers, state, step, info)`, before
    the gradients of a photo are computed and after its step, and change these dicts in place.
    `params` are the raw tensors of `Splats` that have one row per Gaussian; `optimizers` hold
    their moments as `torch.optim.Adam` does; `state` is what `initialize_state` returned. Where
    they take such an argument, `initialize_state` gets the `scene_scale` (the scene's extent) and
    `step_post_backward` gets `lr` (the learning rate of the means), as gsplat's do.

    `info` has what `rasterize` returns and, as gsplat's, `width`, `height`, `n_cameras` and
    `gaussian_ids`. It also has `loss`, to which `step_pre_backward` may add; the `progress` of the
    run in 0..1; the `first_count` of Gaussians; the `classifier`, if identities are learned; and a
    `generator`, which follows from seed and step. After the step, `photos` is how many photos the
    gradients are the mean of; `means_grad` is that of the means, if they have one; `visible` are
    the Gaussians in view; and `round` is the range of steps whose gradients were computed together:
    the number of Gaussians may change only after its last step.
    """

    def initialize_state(self, *args: Any, **kwargs: Any) -> dict[str, Any]: ...

    def step_pre_backward(self, *args: Any, **kwargs: Any) -> None: ...

    def step_post_backward(self, *args: Any, **kwargs: Any) -> None: ...


def supported_kwargs(function: Callable[..., Any], **offered: Any) -> dict[str, Any]:
    """The arguments offered for which the function has a parameter."""
    return {name: offered[name] for name in offered.keys() & signature(function).parameters.keys()}


@dataclass(frozen=True)
class MCMCStrategy:
    """The strategy of `train`: 3DGS-MCMC with growth by a schedule.

    It prefers to copy Gaussians whose shifts would change the loss most, and those of objects.
    """

    config: TrainConfig
    extent: float
    """Unit of length of the scene."""

    def initialize_state(self) -> StepValues:
        return {}

    def step_pre_backward(
        self, params: Params, optimizers: Optimizers, state: StepValues, step: int, info: StepValues
    ) -> None:
        """Add the regularisers to the loss; draw the noise, here because photos run in parallel."""
        means = params["means"]
        info["noise"] = torch.randn(means.shape, generator=info["generator"], device=means.device)
        info["loss"] = info["loss"] + regularizer(params, self.extent)

    def step_post_backward(
        self, params: Params, optimizers: Optimizers, state: StepValues, step: int, info: StepValues
    ) -> None:
        """Add noise to the means; relocate and grow at the end of each interval.

        Until then `state` holds the sums of `add_gradients`.
        """
        config, progress, photos = self.config, info["progress"], info["photos"]
        if progress < config.refine_end and info["means_grad"] is not None:
            add_gradients(state, info["means_grad"], info["visible"])
        decay = means_decay(progress)
        perturb_means(params, self.extent, decay, info["noise"], photos=photos)
        first, end, every = info["round"].start, info["round"].stop, config.refine_every
        is_due = step + photos == end and end // every > first // every
        if is_due and progress < config.refine_end:
            splats = Splats(**dict[str, Any](params), classifier=info["classifier"])
            preference = growth_preference(splats, config.object_growth)
            if state:
                scores = take_scores(state, params)
                preference = scores if preference is None else scores * preference
            count = config.gaussian_count(progress, info["first_count"])
            generator = info["generator"]
            relocate_and_grow(params, optimizers, count, generator, preference=preference)


@torch.no_grad()
def without_hidden(splats: Splats, cameras: Cameras) -> Splats:
    """The splats without what photos show less than `SHOWN_LEAST` pixels of; a line says how many.

    They lie beneath surfaces or have faded.
    """
    bare = geometry_only(splats)

    def shown(row: int) -> Float[Tensor, " N"]:
        width, height = cameras[row].size
        return backproject(bare, cameras[row], bare.means.new_ones(height, width, 1))[:, 0]

    looks = per_view(shown, range(len(cameras)), "finding hidden Gaussians", splats.device)
    kept = sum(looks, bare.means.new_zeros(len(bare))) >= SHOWN_LEAST
    hidden = len(splats) - int(kept.sum())
    if not hidden or hidden == len(splats):
        return splats
    say(f"Left out, as no photo shows them: {count_noun(hidden, 'Gaussian')}.")
    return splats[kept]


def regularizer(params: Params, extent: float) -> Float[Tensor, ""]:
    """Pulls opacities and sizes, in a scene's unit of length, towards 0."""
    opacity = torch.sigmoid(params["opacities"]).mean()
    return OPACITY_WEIGHT * opacity + SCALE_WEIGHT * params["scales"].exp().mean() / extent


@torch.no_grad()
def perturb_means(
    params: Params, extent: float, decay: float, noise: Float[Tensor, "N 3"], *, photos: int = 1
) -> None:
    """Add noise to the means, in place, along each Gaussian's covariance, more to fainter ones.

    `noise` is standard normal; `decay` falls in the course of training; the variances of the
    photos' noises add up. Covariances are squares of lengths, hence the division by the extent.
    """
    rate = NOISE_RATE * decay * photos**0.5 / extent
    add_noise = add_noise_cuda if noise.is_cuda else add_noise_cpu
    add_noise({name: t.detach() for name, t in params.items()}, noise, rate)


def add_noise_cuda(params: Params, noise: Float[Tensor, "N 3"], rate: float) -> None:
    """Add noise along the axes of each Gaussian, without the opaque ones."""
    means, *others = (params[name] for name in ("means", "quats", "scales", "opacities"))
    assert means.is_contiguous()
    given = means, *(each.contiguous() for each in others), noise.contiguous(), rate, len(means)
    for_each_row(KERNEL, "add_noise", means.device, len(means), *given, **NOISE_CONSTANTS)


def add_noise_cpu(params: Params, noise: Float[Tensor, "N 3"], rate: float) -> None:
    """The same on a CPU."""
    names = ("means", "quats", "scales", "opacities")
    _add_noise(tuple(t.numpy() for t in (*(params[name] for name in names), noise)), rate)


@kernel
def _add_noise(arrays, rate):
    means, quats, scales, opacities, noise = arrays
    for i in numba.prange(means.shape[0]):
        if opacities[i] > DENSE_OPAQUE:
            continue
        opacity = 1 / (1 + exp(-opacities[i]))
        step = rate / (1 + exp(-NOISE_SHARPNESS * (DEAD_OPACITY - opacity)))
        a = step * noise[i, 0] * exp(2 * scales[i, 0])
        b = step * noise[i, 1] * exp(2 * scales[i, 1])
        c = step * noise[i, 2] * exp(2 * scales[i, 2])
        w, x, y, z = quats[i]
        double = 2 / max(w * w + x * x + y * y + z * z, 1e-24)
        # the rotation as v + 2 w (q x v) + 2 q x (q x v)
        d, e, f = y * c - z * b, z * a - x * c, x * b - y * a
        means[i, 0] += a + double * (w * d + y * f - z * e)
        means[i, 1] += b + double * (w * e + z * d - x * f)
        means[i, 2] += c + double * (w * f + x * e - y * d)


def add_gradients(
    state: StepValues, means_grad: Float[Tensor, "N 3"], visible: Bool[Tensor, " N"]
) -> None:
    """Add the norms of a photo's gradients by the means, and count the Gaussians that it shows.

    Norms, because gradients of several photos cancel where one Gaussian stands for several things.
    """
    norms = means_grad.norm(dim=1)
    if state:
        state["grad_norms"].add_(norms)
        state["counts"].add_(visible)
    else:
        state |= {"grad_norms": norms, "counts": visible.float()}


def take_scores(state: StepValues, params: Params) -> Float[Tensor, " N"]:
    """Scores of how much Gaussians need others beside them, from the sums, which are forgotten.

    A score is the square root of how much the loss of a photo that shows a Gaussian changes when
    the Gaussian is shifted by its own size. If copies share this change, least of it is left in all
    where their numbers are in proportion to the roots.
    """
    gradients = state.pop("grad_norms") / state.pop("counts").clamp(min=1)
    changes = gradients * params["scales"].detach().mean(dim=1).exp()
    changes = changes.nan_to_num(0.0, 0.0, 0.0)  # of what has run away
    mean = changes.mean().clamp(min=torch.finfo(changes.dtype).tiny)
    return (changes / mean + LEAST_CHANGE).sqrt()


def sound_rows(params: Params) -> Bool[Tensor, " N"]:
    """Which Gaussians can be drawn and saved: their numbers are finite and in range."""
    sound = params["quats"].detach().abs().amax(dim=1) >= SMALLEST_QUAT
    for name, tensor in params.items():
        if name in DECLARED:
            sound = sound & rows_in_range(tensor.detach(), DECLARED[name])
    return sound


@torch.no_grad()
def relocate_and_grow(
    params: Params,
    optimizers: Optimizers,
    count: int,
    generator: torch.Generator,
    *,
    preference: Float[Tensor, " N"] | None = None,
) -> None:
    """Move the dead Gaussians to living ones, and add copies until there are `count`, in place.

    Those that have run away are dead, too: no photo shows them, so none brings them back.
    The chance of being copied is the opacity times the preference. A Gaussian and its copies start
    from zero moments and stand side by side (`_split`). All are put in the order of their places
    before that, so that those which a pixel mixes lie together in memory: a step of 300,000 takes
    a sixth less of a processor's time.
    """
    opacities = torch.sigmoid(params["opacities"])
    lives = (opacities > DEAD_OPACITY) & sound_rows(params)
    alive, dead = lives.nonzero()[:, 0], (~lives).nonzero()[:, 0]
    n = len(opacities)
    needed = len(dead) + max(count - n, 0)
    if needed == 0 or len(alive) == 0:
        return
    chances = opacities if preference is None else opacities * preference
    drawn = torch.multinomial(chances[alive], needed, replacement=True, generator=generator)
    sources = alive[drawn]
    rows = torch.cat([torch.arange(n, device=sources.device), sources[len(dead) :]])
    rows[dead] = sources[: len(dead)]
    fresh = torch.zeros(len(rows), dtype=torch.bool, device=rows.device)
    fresh[dead] = True
    fresh[n:] = True
    fresh[sources] = True
    order = morton_order(params["means"].detach()[rows])
    rows, fresh = rows[order], fresh[order]
    taken = {name: tensor.detach()[rows] for name, tensor in params.items()}
    _split(taken, rows, fresh)
    for name, tensor in taken.items():
        optimizer = optimizers[name]
        moments = optimizer.state.pop(params[name])
        for key in ("exp_avg", "exp_avg_sq"):
            moments[key] = moments[key][rows]
            moments[key][fresh] = 0
        params[name] = tensor.requires_grad_()
        optimizer.state[tensor] = moments
        optimizer.param_groups[0]["params"] = [tensor]


def _split(taken: Params, rows: Int[Tensor, " N"], fresh: Bool[Tensor, " N"]) -> None:
    """Let the fresh Gaussians of the same row look together about as that row did, in place.

    They stand in a line along its longest axis, as in Deng et al. 2024, "Efficient Density Control
    for 3D Gaussian Splatting", and are shorter by what this adds to the covariance of all. Their
    opacities grow as their area seen across the line shrinks, but not above that row's: opaque ones
    would take hundreds of steps to come back from 1.
    """
    sources = rows[fresh]
    counts = torch.bincount(sources)[sources]
    old, most = taken["scales"][fresh].exp(), torch.sigmoid(taken["opacities"][fresh])
    opacities, scales = relocate(most, old, counts.clamp(max=MAX_COPIES))
    longest = torch.nn.functional.one_hot(old.argmax(dim=1), 3).bool()
    axes = rotation_matrices(taken["quats"][fresh]).mT[longest]
    offsets = COPY_SPREAD * old[longest] * _places(sources, counts)
    taken["means"][fresh] += offsets[:, None] * axes
    shrinkage = (1 - COPY_SPREAD**2) ** 0.5
    scales[longest] *= shrinkage
    taken["scales"][fresh] = scales.log()
    opacities = torch.minimum(opacities / shrinkage, most).clamp(DEAD_OPACITY, MAX_OPACITY)
    taken["opacities"][fresh] = torch.logit(opacities)


def _places(rows: Int[Tensor, " M"], counts: Int[Tensor, " M"]) -> Float[Tensor, " M"]:
    """Places at equal distances for the elements of each row, of mean 0 and deviation 1."""
    order = rows.argsort(stable=True)
    first = torch.searchsorted(rows[order], rows)
    ranks = torch.empty_like(rows)
    ranks[order] = torch.arange(len(rows), device=rows.device)
    return (2 * (ranks - first) - (counts - 1)) / ((counts.double() ** 2 - 1) / 3).sqrt().float()


def relocate(
    opacities: Float[Tensor, " M"], scales: Float[Tensor, "M 3"], copies: Int[Tensor, " M"]
) -> tuple[Float[Tensor, " M"], Float[Tensor, "M 3"]]:
    """Activated opacities and scales with which so many copies at one place look like one Gaussian.

    Equation 9 of 3DGS-MCMC (Kheradmand et al. 2024), for at most `MAX_COPIES`. Its terms alternate
    and are large, hence float64.
    """
    old = opacities.double()
    new = 1 - (1 - old) ** (1 / copies)
    powers = torch.arange(1, MAX_COPIES + 1, device=new.device)
    terms = _spread_terms().to(new.device)[copies] * new[:, None] ** powers
    factor = old / terms.sum(dim=1)
    return new.to(opacities), scales * factor.to(scales)[:, None]


@cache
@torch.inference_mode(False)  # else training could not use them later
def _spread_terms() -> Float[Tensor, "n k"]:
    """By copies n and power k of the opacity, the factor of the paper's double sum.

    The inner binomials C(i - 1, k - 1) add up to C(n, k) over i.
    """
    table = torch.zeros(MAX_COPIES + 1, MAX_COPIES, dtype=torch.float64)
    for n in range(1, MAX_COPIES + 1):
        for k in range(1, n + 1):
            table[n, k - 1] = comb(n, k) * (-1) ** (k - 1) / k**0.5
    return table


@torch.no_grad()
def growth_preference(splats: Splats, object_growth: float) -> Float[Tensor, " N"] | None:
    """Factors on the chances of being copied, 1 for the background; None without identities."""
    if splats.identities is None or splats.classifier is None:
        return None
    scores = splats.classifier.some_at_a_time(splats.identities)
    background = torch.cat([some.softmax(dim=-1)[:, 0] for _, some in scores])
    return 1 + (object_growth - 1) * (1 - background)
