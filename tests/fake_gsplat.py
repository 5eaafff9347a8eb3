"""What gsplat 1.5.3's CUDA kernels compute, in torch, behind the signatures of the real ones."""

import inspect
from collections.abc import Callable
from math import comb
from types import ModuleType
from typing import Any

import pytest
import torch

from stylesplat.rendering.reference import rotation_matrices


def cuda_ops(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """Operations of training for GPUs, on tensors of the CPU."""
    pytest.importorskip("gsplat")
    from stylesplat.training import cuda_ops as module

    for name, stand_in in (
        ("fused_adam", adam),
        ("compute_relocation", compute_relocation),
        ("quat_scale_to_covar_preci", quat_scale_to_covar_preci),
    ):
        real = inspect.unwrap(getattr(module, name))
        monkeypatch.setattr(module, name, _bound(real, stand_in))
    return module


def _bound(real: Callable, stand_in: Callable) -> Callable:
    signature = inspect.signature(real)

    def call(*args: Any, **kwargs: Any) -> Any:
        arguments = signature.bind(*args, **kwargs)
        arguments.apply_defaults()
        return stand_in(**arguments.arguments)

    return call


def adam(param, param_grad, exp_avg, exp_avg_sq, valid, lr, b1, b2, eps) -> None:
    """AdamCUDA.cu: neither mean is corrected for starting at 0; memory is read as it lies."""
    for tensor in (param, param_grad, exp_avg, exp_avg_sq):
        assert tensor.is_contiguous() and tensor.dtype == torch.float32
        assert tensor.shape == param.shape
    assert valid.dtype == torch.bool and valid.shape == (len(param),)
    first = b1 * exp_avg[valid] + (1 - b1) * param_grad[valid]
    second = b2 * exp_avg_sq[valid] + (1 - b2) * param_grad[valid] ** 2
    exp_avg[valid], exp_avg_sq[valid] = first, second
    param[valid] -= lr * first / (second.sqrt() + eps)


def compute_relocation(opacities, scales, ratios, binoms):
    """RelocationCUDA.cu: activated opacities and scales; the ratios are clamped in place."""
    (count,), (most, _) = opacities.shape, binoms.shape
    assert scales.shape == (count, 3) and ratios.shape == (count,)
    assert float(binoms[10, 3]) == comb(10, 3) and binoms.dtype == opacities.dtype
    ratios.clamp_(min=1, max=most)
    new = 1 - (1 - opacities) ** (1 / ratios)
    total = torch.zeros_like(new)
    for i in range(1, int(ratios.max()) + 1):
        for k in range(i):
            term = binoms[i - 1, k] * (-1) ** k / (k + 1) ** 0.5 * new ** (k + 1)
            total += torch.where(ratios >= i, term, 0)
    return new, (opacities / total)[:, None] * scales


def quat_scale_to_covar_preci(quats, scales, compute_covar, compute_preci, triu):
    """R S S R^T of quaternions of any norm."""
    assert compute_covar and not triu
    axes = rotation_matrices(quats) * scales[:, None]
    covars = axes @ axes.transpose(1, 2)
    return covars, torch.linalg.inv(covars) if compute_preci else None
