"""The losses of training: of colours, of depths, and of identities where they are learned.

After StyleSplat, section 3.3, and Gaussian Grouping.
"""
# pyright: reportIncompatibleMethodOverride=false
# (torch's own signature of `backward` is (*args))

from math import log

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree
from torch import Tensor
from torch.autograd import Function
from torch.autograd.function import once_differentiable
from torch.nn.functional import cross_entropy, kl_div, l1_loss, log_softmax

from stylesplat.imaging.similarity import ssim
from stylesplat.rendering.kernels.ssim import Photometric
from stylesplat.rendering.reference import NEAR_PLANE
from stylesplat.scene.splats import Classifier

DSSIM_WEIGHT = 0.2
NEIGHBOR_WEIGHT = 2.0  # Gaussian Grouping's reg3d_lambda_val
LOSS_MAX_POINTS = 200_000  # Gaussian Grouping's reg3d_max_points
NO_CLASS = -1  # of pixels that are not to be learned from
LOSS_DISTANCES_AT_ONCE = 2**26  # 256 MB of them


def photometric_loss(
    image: Float[Tensor, "H W 3"],
    target: Float[Tensor, "H W 3"],
    valid: Bool[Tensor, "H W"] | None = None,
) -> tuple[Float[Tensor, ""], Float[Tensor, ""]]:
    """0.8 L1 + 0.2 (1 - SSIM), the loss of 3D Gaussian splatting; and the mean squared error.

    The error is of the image clamped to 0..1 and has no gradient. Pixels that are not valid have no
    influence, neither alone nor in the windows of others: they are black in both images, and the
    means are over the others.
    """
    if valid is not None:
        image, target = (each.where(valid[..., None], 0) for each in (image, target))
    if image.is_cuda:
        loss, error = photometric_reference(image, target)
    else:
        loss, error = Photometric.apply(image, target, DSSIM_WEIGHT)
    if valid is None:
        return loss, error
    share = valid.float().mean().clamp(min=1 / valid.numel())  # some photos have none
    return loss / share, error / share


def photometric_reference(
    image: Float[Tensor, "H W 3"], target: Float[Tensor, "H W 3"]
) -> tuple[Float[Tensor, ""], Float[Tensor, ""]]:
    """`photometric_loss` in plain torch, on any device and in any precision."""
    dissimilarity = 1 - ssim(image, target)
    error = (image.detach().clamp(0, 1) - target).square().mean()
    return (1 - DSSIM_WEIGHT) * l1_loss(image, target) + DSSIM_WEIGHT * dissimilarity, error


def depth_phases(depths: Float[Tensor, " N"]) -> Float[Tensor, "N 2"]:
    """What is composited for `depth_scatter`: cosine and sine of the depths' logarithms."""
    logarithms = depths.clamp(min=NEAR_PLANE).log()
    return torch.stack([logarithms.cos(), logarithms.sin()], dim=1)


def depth_scatter(
    phases: Float[Tensor, "H W 2"], coverage: Float[Tensor, "H W 1"]
) -> Float[Tensor, ""]:
    """How much the depths differ that pixels mix; 0 where each shows one depth.

    It is the sum over pairs of a pixel's weights times 1 - cos(log(z1 / z2)), averaged over pixels:
    the distortion of Mip-NeRF 360 (Barron et al. 2022) and 2DGS (Huang et al. 2024), in closed form
    by two composited channels. Of a covered pixel it is the variance of the logarithms, where these
    differ little; depths that differ by more than exp(pi), 23 times, are drawn together no more.
    """
    return (coverage.square().squeeze(-1) - phases.square().sum(dim=-1)).mean()


def identity_loss(
    render_identities: Float[Tensor, "P 16"], classes: Int[Tensor, " P"], classifier: Classifier
) -> Float[Tensor, ""]:
    """Cross-entropy of the classified render against classes (or `NO_CLASS`), over ln K."""
    logits = classifier.logits(render_identities)
    total = cross_entropy(logits, classes, ignore_index=NO_CLASS, reduction="sum")
    count = (classes != NO_CLASS).sum().clamp(min=1)
    return total / count / log(max(len(classifier.ids), 2))


def neighbor_loss(
    identities: Float[Tensor, "S 16"], neighbors: Float[Tensor, "S k 16"], classifier: Classifier
) -> Float[Tensor, ""]:
    """KL divergence between the labels of Gaussians and those of their nearest neighbours."""
    own = log_softmax(classifier.logits(identities), dim=-1)[:, None]
    theirs = log_softmax(classifier.logits(neighbors), dim=-1)
    divergence = kl_div(theirs, own.expand_as(theirs), reduction="none", log_target=True).sum(-1)
    return NEIGHBOR_WEIGHT * divergence.mean() / len(classifier.ids)


def sample_neighbors(
    means: Float[Tensor, "N 3"],
    samples: int,
    count: int,
    generator: torch.Generator,
    *,
    max_points: int = LOSS_MAX_POINTS,
) -> tuple[Int[Tensor, " S"], Int[Tensor, "S k"]]:
    """Rows of random points and of their nearest neighbours.

    Of more than `max_points` points a random choice of that many takes part, as in Gaussian
    Grouping, so that a step takes the same time however many there are.
    """
    if len(means) > max_points:
        order = torch.randperm(len(means), generator=generator, device=means.device)
        some = order[:max_points]
        sample, neighbors = sample_neighbors(
            means[some], samples, count, generator, max_points=max_points
        )
        return some[sample], some[neighbors]
    sample = torch.randint(len(means), (samples,), generator=generator, device=means.device)
    return sample, nearest_neighbors(means, sample, count)


def nearest_neighbors(
    means: Float[Tensor, "N 3"], sample: Int[Tensor, " S"], count: int
) -> Int[Tensor, "S k"]:
    """Rows of the nearest other points of each sampled point."""
    if not means.is_cuda:
        tree = KDTree(means.numpy(), balanced_tree=False, compact_nodes=False)  # quick to build
        found = np.asarray(tree.query(means[sample].numpy(), k=count + 1)[1])
        own = found == sample.numpy()[:, None]
        own[~own.any(axis=1), -1] = True  # of twins at one place, it itself may not be among them
        return torch.from_numpy(found[~own].reshape(len(found), count))
    found = []
    for some in sample.split(max(1, LOSS_DISTANCES_AT_ONCE // len(means))):
        # Axis by axis: a matrix product rounds small distances away, and without one torch's
        # `cdist` takes 125 ms for 1,000 of 100,000 points where this takes 3.5 (H200)
        distances = means.new_zeros(len(some), len(means))
        for along in means.unbind(dim=1):
            distances += (along[some, None] - along).square_()
        distances.scatter_(1, some[:, None], torch.inf)
        found.append(distances.topk(count, dim=1, largest=False).indices)
    return torch.cat(found)


class _SplitRender(Function):
    @staticmethod
    def forward(ctx, render, rows, columns):
        ctx.shape, ctx.sampled = render.shape, (rows, columns)
        return render[..., :3].contiguous(), render[rows, columns, 3:].contiguous()

    @staticmethod
    @once_differentiable
    def backward(ctx, v_colors, v_features):
        v_render = v_colors.new_zeros(ctx.shape)
        v_render[..., :3] = v_colors
        v_render[*ctx.sampled, 3:] = v_features
        return v_render, None, None


def split_render(
    render: Float[Tensor, "H W D"], offset: tuple[int, int], stride: int
) -> tuple[Float[Tensor, "H W 3"], Float[Tensor, "h w F"]]:
    """The colours, and the features at every n-th pixel along y and x from an offset.

    The backward pass fills one gradient of the whole render; slices would fill one each.
    """
    y, x = offset
    return _SplitRender.apply(render, slice(y, None, stride), slice(x, None, stride))
