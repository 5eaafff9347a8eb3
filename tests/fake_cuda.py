"""A GPU for machines without one: tensors of the CPU that count as CUDA's, and refuse to mix.

It finds what a GPU would refuse: an operation on tensors of both devices, numpy's view of a GPU's
tensor. gsplat is the stand-in of `rendering/native_gsplat.py`. What torch does backwards is not
looked at.
"""

from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode

from fake_gsplat import install_training_kernels
from rendering.native_gsplat import install
from stylesplat.color.blur import blur_matrix
from stylesplat.color.lab import luma_weights

MOVES = {Tensor.copy_, Tensor.__setitem__, Tensor.data.__set__, Tensor.grad.__set__}  # pyright: ignore
INDEXES = {Tensor.__getitem__, Tensor.index_put, Tensor.index_put_}
KERNELS = ("rasterization", "rasterize_to_pixels", "spherical_harmonics")
KERNELS += ("fully_fused_projection", "isect_tiles", "isect_offset_encode")
DEVICE, IS_CUDA = Tensor.device.__get__, Tensor.is_cuda.__get__  # pyright: ignore
# What has neither a device nor tensors in its answer: most calls, as types are checked
PLAIN = {getattr(Tensor, name).__get__ for name in ("shape", "ndim", "dtype", "requires_grad")}
PLAIN |= {Tensor.size, Tensor.dim, Tensor.numel, Tensor.__len__, Tensor.is_floating_point}
TO_NUMPY = {Tensor.numpy, Tensor.__array__, Tensor.data_ptr}


@pytest.fixture(params=["stand-in", pytest.param("real", marks=pytest.mark.cuda)])
def cuda(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """The device `cuda`: a GPU, and on any machine its stand-in."""
    if request.param == "real":
        yield "cuda"
        return
    gsplat = pytest.importorskip("gsplat")
    install(monkeypatch, quickly=True)
    for name in KERNELS:
        monkeypatch.setattr(gsplat, name, _kernel(getattr(gsplat, name)))
    install_training_kernels(monkeypatch, _kernel)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "is_bf16_supported", lambda: False)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 1)
    card = SimpleNamespace(name="stand-in", total_memory=2**34)
    monkeypatch.setattr(torch.cuda, "get_device_properties", lambda _: card)
    with FakeCuda():
        yield "cuda"
    for cached in (blur_matrix, luma_weights):  # else a real GPU is given the stand-in's tensors
        cached.cache_clear()


def _kernel(function: Callable) -> Callable:
    """What runs on the GPU as a whole: no tensor of the CPU may reach it."""

    def call(*args: Any, **kwargs: Any) -> Any:
        for each in _tensors((args, kwargs)):
            assert on_gpu(each), f"gsplat got a tensor of the CPU, {tuple(each.shape)}"
        with torch._C.DisableTorchFunction():
            found = function(*args, **kwargs)
            for each in _tensors(found):
                _marked(each, True)
        return found

    return call


def _tensors(tree: Any) -> list[Tensor]:
    if isinstance(tree, Tensor):
        return [tree]
    if isinstance(tree, dict):
        tree = tree.values()
    elif not isinstance(tree, tuple | list):
        return []
    return [tensor for each in tree for tensor in _tensors(each)]


def on_gpu(tensor: Tensor) -> bool:
    return getattr(tensor, "_on_fake_gpu", False)


class FakeCuda(TorchFunctionMode):
    """Follows which tensors count as a GPU's."""

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = dict(kwargs or {})
        if func in PLAIN:
            return func(*args, **kwargs)
        own = args[0] if args and isinstance(args[0], Tensor) else None
        if func == DEVICE:
            return torch.device("cuda", 0) if on_gpu(args[0]) else func(*args)
        if func == IS_CUDA:
            return on_gpu(args[0])
        if func in TO_NUMPY and on_gpu(args[0]):
            raise TypeError("can't convert cuda:0 device type tensor to numpy. Use Tensor.cpu().")
        if func in (Tensor.to, Tensor.cpu):
            return self._moved(func, *args, **kwargs)
        given = _tensors((args, kwargs))
        place = kwargs.get("device")
        if place is not None:
            kwargs["device"] = "cpu"
            gpu = torch.device(place).type == "cuda"
            generator = kwargs.get("generator")
            if generator is not None and gpu:
                raise RuntimeError("Expected a 'cuda' device type for generator, found 'cpu'.")
        else:
            gpu = self._same_device(func, own, given)
        found = func(*args, **kwargs)
        if func is Tensor.__iter__:
            return iter([_marked(each, gpu) for each in found])
        if func == Tensor.data.__set__:  # pyright: ignore
            _marked(args[0], on_gpu(args[1]))
        if func in MOVES:
            return found
        for each in _tensors(found):
            _marked(each, gpu)
        return found

    def _moved(self, func: Any, tensor: Tensor, *args: Any, **kwargs: Any) -> Tensor:
        gpu, rest = on_gpu(tensor) and func is not Tensor.cpu, []
        for each in (*args, kwargs.pop("device", None), kwargs.pop("other", None)):
            if isinstance(each, str | torch.device):
                gpu = torch.device(each).type == "cuda"
            elif isinstance(each, Tensor):
                gpu, kwargs["dtype"] = on_gpu(each), each.dtype
            elif each is not None:
                rest.append(each)
        found = func(tensor, *rest, **kwargs) if rest or kwargs else tensor
        if gpu == on_gpu(tensor) or found is not tensor:
            return _marked(found, gpu)
        return _marked(tensor.clone(), gpu)

    def _same_device(self, func: Any, own: Tensor | None, given: list[Tensor]) -> bool:
        """Whether the result is a GPU's; raises where devices meet that must not."""
        if own is not None and (func in INDEXES or func in MOVES) and on_gpu(own):
            return True  # by indices of either
        if func in MOVES:
            return False
        several = {on_gpu(each) for each in given if each.ndim}
        if len(several) > 1:
            name = getattr(func, "__name__", func)
            raise RuntimeError(f"{name}: Expected all tensors to be on the same device.")
        return any(on_gpu(each) for each in given)


def _marked(tensor: Tensor, gpu: bool) -> Tensor:
    if gpu != on_gpu(tensor):
        tensor._on_fake_gpu = gpu  # pyright: ignore
    return tensor
