"""What gsplat 1.5.3's CUDA kernels compute, in torch, behind the signatures of the real ones."""

import inspect
from collections.abc import Callable
from typing import Any

import pytest
import torch

from stylesplat.rendering.reference import rotation_matrices
from stylesplat.training.densification import relocate


def install_training_kernels(
    monkeypatch: pytest.MonkeyPatch, wrap: Callable[[Callable], Callable] = lambda each: each
) -> None:
    """Put stand-ins for the kernels that training calls into gsplat for one test."""
    gsplat = pytest.importorskip("gsplat")
    for module, name, stand_in in (
        (gsplat.cuda._wrapper, "adam", adam),
        (gsplat, "quat_scale_to_covar_preci", quat_scale_to_covar_preci),
        (gsplat.strategy.ops, "quat_scale_to_covar_preci", quat_scale_to_covar_preci),
        (gsplat.strategy.ops, "compute_relocation", compute_relocation),
    ):
        real = inspect.unwrap(getattr(module, name))
        monkeypatch.setattr(module, name, wrap(_bound(real, stand_in)))


def _bound(real: Callable, stand_in: Callable) -> Callable:
    signature = inspect.signature(real)

    def call(*args: Any, **kwargs: Any) -> Any:
        arguments = signature.bind(*args, **kwargs)
        arguments.apply_defaults()
        return stand_in(**arguments.arguments)

    return call


def adam(param, param_grad, exp_avg, exp_avg_sq, valid, lr, b1, b2, eps) -> None:
    """AdamCUDA.cu: neither mean is corrected for starting at 0; memory is read as it lies."""
    assert len(param), "the kernel divides by the number of rows"
    for tensor in (param, param_grad, exp_avg, exp_avg_sq):
        assert tensor.is_contiguous() and tensor.dtype == torch.float32
        assert tensor.shape == param.shape
    assert valid.dtype == torch.bool and valid.shape == (len(param),)
    first = b1 * exp_avg[valid] + (1 - b1) * param_grad[valid]
    second = b2 * exp_avg_sq[valid] + (1 - b2) * param_grad[valid] ** 2
    exp_avg[valid], exp_avg_sq[valid] = first, second
    param[valid] -= lr * first / (second.sqrt() + eps)


def quat_scale_to_covar_preci(quats, scales, compute_covar, compute_preci, triu):
    """R S S R^T of quaternions of any norm."""
    assert compute_covar and not triu
    axes = rotation_matrices(quats) * scales[:, None]
    covars = axes @ axes.transpose(1, 2)
    return covars, torch.linalg.inv(covars) if compute_preci else None


def compute_relocation(opacities, scales, ratios, binoms):
    """relocation.cu: equation 9 of 3DGS-MCMC."""
    assert binoms[4, 2] == 6 and opacities.shape == ratios.shape
    return relocate(opacities, scales, ratios.clamp(1, len(binoms)))
