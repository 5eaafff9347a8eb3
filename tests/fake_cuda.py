"""A GPU for machines without one: tensors of the CPU that count as CUDA's, and refuse to mix.

It finds what a GPU would refuse: an operation on tensors of both devices, random numbers by the
generator of another device, numpy's view of a GPU's tensor. `HostTrips` finds what the host would
wait for. In the place of our GPU kernels run those of the CPU; `rendering/emulated_cuda.py` runs
the real ones, which takes longer. What torch does backwards is not looked at.
"""

from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from torch import Tensor
from torch._ops import OpOverload
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode

from stylesplat.imaging.color import luma_weights
from stylesplat.imaging.similarity import blur_matrix, ssim_window
from stylesplat.rendering import cpu
from stylesplat.rendering import cuda as kernels
from stylesplat.training import adam, densification

MOVES = {Tensor.copy_, Tensor.__setitem__, Tensor.data.__set__, Tensor.grad.__set__}  # pyright: ignore
MOVES |= {torch._has_compatible_shallow_copy_type}  # pyright: ignore  (asked as modules move)
INDEXES = {Tensor.__getitem__, Tensor.index_put, Tensor.index_put_}
RENDERING = {"spherical_harmonics", "project_gaussians", "rasterize", "front_depth"}
RENDERING |= {"tile", "composite", "backproject"}
DEVICE, IS_CUDA = Tensor.device.__get__, Tensor.is_cuda.__get__  # pyright: ignore
# What has neither a device nor tensors in its answer: most calls, as types are checked
PLAIN = {getattr(Tensor, name).__get__ for name in ("shape", "ndim", "dtype", "requires_grad")}
PLAIN |= {Tensor.size, Tensor.dim, Tensor.numel, Tensor.__len__, Tensor.is_floating_point}
TO_NUMPY = {Tensor.numpy, Tensor.__array__, Tensor.data_ptr}
TO_HOST = {Tensor.item, Tensor.tolist, Tensor.__bool__, Tensor.__int__, Tensor.__float__}
TO_HOST |= {Tensor.nonzero, Tensor.unique, Tensor.__format__, torch.bincount, torch.nonzero}
TO_HOST |= {torch.unique, torch.masked_select, Tensor.masked_select}
TO_HOST |= {Tensor.repeat_interleave, torch.repeat_interleave}
TO_HOST |= {torch.linalg.solve, torch.linalg.inv, torch.linalg.eigh}  # look for their errors
FROM_HOST = {torch.tensor, torch.as_tensor, Tensor.new_tensor}
PRODUCTS = {Tensor.matmul, Tensor.__matmul__, torch.matmul, Tensor.mm, Tensor.mv}
BY_MASK = {Tensor.__getitem__, Tensor.__setitem__}
CONSTANTS = (blur_matrix, luma_weights, ssim_window)
GENERATOR = torch.Generator  # before it is replaced


@pytest.fixture(params=["stand-in", pytest.param("real", marks=pytest.mark.cuda)])
def cuda(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """The device `cuda`: a GPU, and on any machine its stand-in."""
    if request.param == "real":
        yield "cuda"
        return
    monkeypatch.setattr(kernels, "CudaRasterizer", StandIn)
    monkeypatch.setattr(adam, "adam_cuda", _kernel(adam.adam_cpu))
    monkeypatch.setattr(densification, "add_noise_cuda", _kernel(densification.add_noise_cpu))
    monkeypatch.setattr(torch, "Generator", FakeGenerator)
    monkeypatch.setattr(Tensor, "pin_memory", _pinned)  # in threads, too
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "is_bf16_supported", lambda: False)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 1)
    monkeypatch.setattr(torch.cuda, "synchronize", lambda: None)
    stream = SimpleNamespace(is_capturing=lambda: False)
    monkeypatch.setattr(torch.accelerator, "current_stream", lambda: stream)
    card = SimpleNamespace(name="stand-in", total_memory=2**34, major=8, minor=0)
    monkeypatch.setattr(torch.cuda, "get_device_properties", lambda _: card)
    with FakeCuda():
        yield "cuda"
    for cached in CONSTANTS:  # else a real GPU is given the stand-in's tensors
        cached.cache_clear()


class StandIn(cpu.CpuRasterizer):
    """The CPU's, each of whose methods runs on the GPU as a whole."""

    def __getattribute__(self, name: str) -> Any:
        found = super().__getattribute__(name)
        return _kernel(getattr(cpu.CpuRasterizer(), name)) if name in RENDERING else found


def _kernel(function: Callable) -> Callable:
    """What runs on the GPU as a whole: no tensor of the CPU may reach it."""

    def call(*args: Any, **kwargs: Any) -> Any:
        for each in _tensors((args, kwargs)):
            assert on_gpu(each), f"a kernel got a tensor of the CPU, {tuple(each.shape)}"
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
    found = []
    for each in tree:  # without a call for each number, of which lists have thousands
        if isinstance(each, Tensor):
            found.append(each)
        elif isinstance(each, tuple | list | dict):
            found += _tensors(each)
    return found


def on_gpu(tensor: Tensor) -> bool:
    return getattr(tensor, "_on_fake_gpu", False)


class _GeneratorType(type(GENERATOR)):
    """Makes annotations with the stand-in's class accept every generator."""

    def __instancecheck__(cls, instance: object) -> bool:
        return isinstance(instance, GENERATOR)


class FakeGenerator(GENERATOR, metaclass=_GeneratorType):
    """Draws on each device what the CPU's generator draws."""

    _device: torch.device

    def __new__(cls, device: torch.device | str = "cpu") -> "FakeGenerator":
        made = super().__new__(cls, "cpu")  # pyright: ignore[reportCallIssue]
        made._device = torch.device(device)
        return made

    def __init__(self, *_: object) -> None: ...

    @property
    def device(self) -> torch.device:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self._device


class FakeCuda(TorchFunctionMode):
    """Follows which tensors count as a GPU's."""

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        if func in PLAIN:
            return func(*args, **(kwargs or {}))
        kwargs = dict(kwargs or {})
        own = args[0] if args and isinstance(args[0], Tensor) else None
        if func == DEVICE:
            return torch.device("cuda", 0) if on_gpu(args[0]) else func(*args)
        if func == IS_CUDA:
            return on_gpu(args[0])
        if func in TO_NUMPY and on_gpu(args[0]):
            raise TypeError("can't convert cuda:0 device type tensor to numpy. Use Tensor.cpu().")
        if func in (Tensor.to, Tensor.cpu):
            return self._moved(func, *args, **kwargs)
        if func is Tensor.is_pinned:
            return getattr(args[0], "_is_pinned", False)
        given = _tensors((args, kwargs))
        if func in PRODUCTS and any(on_gpu(t) and not t.is_floating_point() for t in given):
            raise NotImplementedError("addmv_impl_cuda not implemented for 'Long'")
        place = kwargs.get("device")
        if place is not None:
            gpu = torch.device(place).type == "cuda"
            kwargs["device"] = "cpu" if gpu else place
        else:
            gpu = self._same_device(func, own, given)
        generator = kwargs.get("generator")
        if generator is not None and (generator.device.type == "cuda") != gpu:
            raise RuntimeError(f"The generator is of another device: {generator.device}.")
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
            elif isinstance(each, torch.dtype):  # else None, or whether the host may go on
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


class HostTrips(TorchFunctionMode):
    """Notes the calls for which the host waits for a GPU; pinned memory is sent without."""

    def __init__(self) -> None:
        self.found: list[str] = []

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        own = args[0] if args and isinstance(args[0], Tensor) else None
        was_there = own is not None and own.is_cuda
        result = func(*args, **(kwargs or {}))
        is_there = isinstance(result, Tensor) and result.is_cuda
        by_mask = func in BY_MASK and isinstance(args[1], Tensor) and args[1].dtype == torch.bool
        left = was_there and (func in TO_HOST or by_mask)
        came = is_there and func in FROM_HOST
        moved = func in (Tensor.to, Tensor.cpu) and is_there != was_there
        pinned = moved and is_there and own is not None and own.is_pinned()
        is_sent = pinned and (kwargs or {}).get("non_blocking")
        if left or came or (moved and not is_sent):
            self.found.append(getattr(func, "__name__", str(func)))
        return result


class Operations(TorchDispatchMode):
    """Counts operations, forward and backward, each of which is a kernel to start on a GPU.

    Views and new memory are none. What stands in for a kernel of ours counts with its parts.
    """

    def __init__(self) -> None:
        super().__init__()
        self.count = 0

    def __torch_dispatch__(
        self, func: OpOverload, types: Any, args: Any = (), kwargs: Any = None
    ) -> Any:
        self.count += not func.is_view and "empty" not in func.name()
        return func(*args, **(kwargs or {}))


def _pinned(tensor: Tensor) -> Tensor:
    assert not on_gpu(tensor), "only the host's memory can be pinned"
    copy = tensor.clone()
    copy._is_pinned = True  # pyright: ignore
    return copy


def _marked(tensor: Tensor, gpu: bool) -> Tensor:
    if gpu != on_gpu(tensor):
        tensor._on_fake_gpu = gpu  # pyright: ignore
    return tensor
