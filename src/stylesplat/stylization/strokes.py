"""The direction of the strokes on an object's surface, and discs stretched along it."""

import torch
from jaxtyping import Bool, Float
from scipy.spatial import KDTree
from torch import Tensor

from stylesplat.metrics.lab import LUMA
from stylesplat.rendering.reference import rotation_matrices
from stylesplat.scene.splats import Splats

NEIGHBOURS = 32  # discs that gradients and structure tensors are averaged over
GRADIENT_WIDTH = 1.5  # deviation of the weights of a gradient's fit, in distances between discs
TENSOR_WIDTH = 2.5  # and of the average of structure tensors
RIDGE = 1e-3  # of the fit, for discs whose neighbours lie on a line
LONG, NARROW = 1.8, 0.6  # factors on scales along and across a stroke; 2.5 spikes the silhouette


@torch.no_grad()
def align_to_strokes(splats: Splats, discs: Bool[Tensor, " N"], distance: float) -> Splats:
    """Turn discs along the strokes painted so far, and stretch them.

    In each disc's tangent plane the structure tensor of the painted luminance gives the direction
    (the eigenvector of its smaller eigenvalue) and how coherent it is (Weickert 1999).

    The scene is on the CPU. The third axis of a disc is its normal. The distance is that between
    neighbouring discs.
    """
    rows = discs.nonzero()[:, 0]
    means, axes = splats.means[rows], rotation_matrices(splats.quats[rows])
    tangents, normals = axes[:, :, :2], axes[:, :, 2]
    points = means.double().numpy()
    far, near = KDTree(points).query(points, k=min(NEIGHBOURS, len(rows)), workers=-1)
    far = torch.from_numpy(far).to(means).view(len(rows), -1) / distance
    near = torch.from_numpy(near).view(len(rows), -1)
    same_side = (normals[near] * normals[:, None]).sum(dim=2).clamp(min=0)  # [D, k]

    def weights(width: float) -> Tensor:
        return same_side * (-(far / width).square() / 2).exp()

    luma = splats.sh0[rows, 0] @ splats.sh0.new_tensor(LUMA)
    gradients = _gradients(means / distance, tangents, luma, near, weights(GRADIENT_WIDTH))
    averaged, tensors = weights(TENSOR_WIDTH), means.new_zeros(len(rows), 2, 2)
    for column in range(near.shape[1]):
        local = torch.einsum("dij,di->dj", tangents, gradients[near[:, column]])
        tensors += averaged[:, column, None, None] * local[:, :, None] * local[:, None]
    values, vectors = torch.linalg.eigh(tensors)  # ascending
    along = vectors[:, :, 0]
    coherence = (values[:, 1] - values[:, 0]) / values.sum(dim=1).clamp(min=1e-12)
    half = torch.atan2(along[:, 1], along[:, 0]) / 2
    stretch = 1 + torch.stack(
        [(LONG - 1) * coherence, (NARROW - 1) * coherence, 0 * coherence], dim=1
    )
    turned = {
        "quats": _turned_in_plane(splats.quats[rows], half.cos(), half.sin()),
        "scales": splats.scales[rows] + stretch.log(),
    }
    return splats.with_rows(rows, turned)


def _gradients(
    points: Float[Tensor, "D 3"],
    tangents: Float[Tensor, "D 3 2"],
    values: Float[Tensor, " D"],
    near: Tensor,
    weights: Float[Tensor, "D k"],
) -> Float[Tensor, "D 3"]:
    """Gradients along the surface, by a weighted fit of a plane to each point's neighbours."""
    total = weights.sum(dim=1, keepdim=True).clamp(min=1e-9)
    offsets = torch.einsum("dki,dij->dkj", points[near] - points[:, None], tangents)
    offsets = offsets - ((weights[..., None] * offsets).sum(dim=1) / total)[:, None]
    changes = values[near] - (weights * values[near]).sum(dim=1, keepdim=True) / total
    normal = torch.einsum("dk,dki,dkj->dij", weights, offsets, offsets)
    right = torch.einsum("dk,dki,dk->di", weights, offsets, changes)
    fitted = torch.linalg.solve(normal + RIDGE * torch.eye(2).to(points), right)
    return torch.einsum("dij,dj->di", tangents, fitted)


def _turned_in_plane(
    quats: Float[Tensor, "D 4"], cos: Float[Tensor, " D"], sin: Float[Tensor, " D"]
) -> Float[Tensor, "D 4"]:
    """Rotations after one about their own third axis, by twice the angle of `cos` and `sin`."""
    w, x, y, z = quats.unbind(1)
    turned = [w * cos - z * sin, x * cos + y * sin, y * cos - x * sin, z * cos + w * sin]
    return torch.stack(turned, dim=1)
