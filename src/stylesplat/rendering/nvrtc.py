"""Our CUDA kernels: compiled for a GPU at first use, and launched on torch's stream.

The compiler is NVRTC, which every CUDA build of torch brings, so that no toolkit is needed. What it
makes lies in the user's cache. The kernels of a source file take pointers, ints and floats.
"""

import ctypes
import os
import struct
import sys
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.rendering import reference

FOLDER = Path(__file__).with_name("kernels")
SHARED_CONSTANTS = (
    *("EPS2D", "NEAR_PLANE", "FAR_PLANE", "MIN_ALPHA", "MAX_ALPHA", "MIN_TRANSMITTANCE"),
    *("MAX_EXTENT", "MAX_RADIUS", "FOV_MARGIN"),
)
THREADS = 256  # of a block, where rows are independent of each other
OPTIONS = ("--std=c++17",)
Argument = Tensor | int | float | None
PARAM_BUFFER, PARAM_SIZE, PARAM_END = 1, 2, 0  # of cuLaunchKernel's `extra`
INVALID_CONTEXT = 201


def source_text(source: Path, **defines: int | float) -> str:
    """A source with what all share, constants in front; whole numbers stay whole."""
    shared = {name: float(getattr(reference, name)) for name in SHARED_CONSTANTS}
    shared |= {"ROWS_OF_BLOCK": THREADS}
    lines = [
        f"#define {name} {value}" + ("f" if isinstance(value, float) else "")
        for name, value in (shared | defines).items()
    ]
    for path in (FOLDER / "common.cuh", source):
        lines += [f'#line 1 "{path.name}"', path.read_text(encoding="utf-8")]
    return "\n".join(lines)


class Kernels:
    """The kernels of one source on one GPU."""

    def __init__(self, cubin: bytes, device: torch.device) -> None:
        self._device, self._driver = device, _driver()
        self._functions = dict[str, ctypes.c_void_p]()
        self._module = ctypes.c_void_p()
        with torch.cuda.device(device):
            torch.cuda.synchronize()  # makes its context the thread's
            self._check(self._driver.cuModuleLoadData(ctypes.byref(self._module), cubin))

    def launch(self, name: str, grid: tuple[int, int], threads: int, *arguments: Argument) -> None:
        """Start a kernel with blocks of threads; there may be no blocks."""
        if 0 in grid:
            return
        function = self._functions.get(name) or self._function(name)
        packed = packed_arguments(arguments)
        buffer = (ctypes.c_char * len(packed)).from_buffer_copy(packed)
        size = ctypes.c_size_t(len(packed))
        place = ctypes.addressof(buffer), ctypes.addressof(size)
        extra = (ctypes.c_void_p * 5)(PARAM_BUFFER, place[0], PARAM_SIZE, place[1], PARAM_END)
        shape = *grid, 1, threads, 1, 1, 0
        if torch.cuda.current_device() == self._device.index:
            self._start(function, *shape, extra)
        else:
            with torch.cuda.device(self._device):
                self._start(function, *shape, extra)

    def _start(self, function: ctypes.c_void_p, *given: Any) -> None:
        *shape, extra = given
        stream = torch.cuda.current_stream().cuda_stream
        result = self._driver.cuLaunchKernel(function, *shape, stream, None, extra)
        if result == INVALID_CONTEXT:  # a thread that has not used the GPU
            torch.cuda.synchronize()
            result = self._driver.cuLaunchKernel(function, *shape, stream, None, extra)
        self._check(result)

    def _function(self, name: str) -> ctypes.c_void_p:
        function = ctypes.c_void_p()
        self._check(
            self._driver.cuModuleGetFunction(ctypes.byref(function), self._module, name.encode())
        )
        self._functions[name] = function
        return function

    def _check(self, result: int) -> None:
        if result:
            text = ctypes.c_char_p()
            self._driver.cuGetErrorString(result, ctypes.byref(text))
            said = (text.value or b"unknown error").decode()
            raise StyleSplatError(
                f"Cannot run a kernel on {self._device}: CUDA error {result}, {said}. Update "
                "NVIDIA's driver, or use --device cpu."
            )


def packed_arguments(arguments: tuple[Argument, ...]) -> bytes:
    """Arguments as they lie in a kernel's memory: pointers, int and float."""
    values = [
        each if isinstance(each, (int, float)) else 0 if each is None else each.data_ptr()
        for each in arguments
    ]
    return _layout(tuple(map(type, arguments))).pack(*values)


@cache
def _layout(types: tuple[type, ...]) -> struct.Struct:
    return struct.Struct("".join({int: "i", float: "f"}.get(each, "P") for each in types))


@cache
def load_kernels(source: Path, device: torch.device, **defines: int | float) -> Kernels:
    """The kernels of a source with constants defined, for a GPU."""
    major, minor = torch.cuda.get_device_capability(device)
    return Kernels(cached_cubin(source, f"sm_{major}{minor}", **defines), device)


def for_each_row(
    source: Path,
    kernel: str,
    device: torch.device,
    count: int,
    *arguments: Argument,
    **defines: int | float,
) -> None:
    """Run a kernel with a thread for each row."""
    grid = -(-count // THREADS), 1
    load_kernels(source, device, **defines).launch(kernel, grid, THREADS, *arguments)


def cached_cubin(source: Path, architecture: str, **defines: int | float) -> bytes:
    """What `compile_source` makes, from the user's cache if it is there and can be written to."""
    text = source_text(source, **defines)
    key = sha256(f"{architecture} {version()} {OPTIONS} {text}".encode()).hexdigest()
    name = f"{source.stem}-{key[:24]}.cubin"
    with suppress(OSError, RuntimeError):  # RuntimeError: there is no home
        return (_cache_folder() / name).read_bytes()
    cubin = compile_source(source, architecture, **defines)
    with suppress(OSError, RuntimeError):
        folder = _cache_folder()
        folder.mkdir(parents=True, exist_ok=True)
        handle, draft = tempfile.mkstemp(dir=folder)
        with os.fdopen(handle, "wb") as file:
            file.write(cubin)
        Path(draft).replace(folder / name)
    return cubin


def _cache_folder() -> Path:
    local = os.environ.get("LOCALAPPDATA" if sys.platform == "win32" else "XDG_CACHE_HOME")
    return (Path(local) if local else Path.home() / ".cache") / "stylesplat" / "kernels"


def compile_source(source: Path, architecture: str, **defines: int | float) -> bytes:
    """The kernels of a source as a GPU of an architecture (`sm_90`) takes them.

    Raises:
        StyleSplatError: If torch has brought no NVRTC, or the source has an error.
    """
    nvrtc, program = _nvrtc(), ctypes.c_void_p()
    text = source_text(source, **defines).encode()
    result = nvrtc.nvrtcCreateProgram(
        ctypes.byref(program), text, source.name.encode(), 0, None, None
    )
    options = [f"--gpu-architecture={architecture}".encode(), *(o.encode() for o in OPTIONS)]
    size = ctypes.c_size_t()
    try:
        result = result or nvrtc.nvrtcCompileProgram(
            program, len(options), (ctypes.c_char_p * len(options))(*options)
        )
        if result:
            nvrtc.nvrtcGetProgramLogSize(program, ctypes.byref(size))
            log = ctypes.create_string_buffer(max(size.value, 1))
            nvrtc.nvrtcGetProgramLog(program, log)
            lines = log.value.decode(errors="replace").splitlines()
            errors = [line for line in lines if "error" in line] or [f"NVRTC error {result}"]
            raise StyleSplatError(
                f"Cannot compile {source.name} for {architecture}: {errors[0]}. Please report it, "
                "and use --device cpu meanwhile."
            )
        nvrtc.nvrtcGetCUBINSize(program, ctypes.byref(size))
        cubin = ctypes.create_string_buffer(size.value)
        nvrtc.nvrtcGetCUBIN(program, cubin)
        return cubin.raw
    finally:
        nvrtc.nvrtcDestroyProgram(ctypes.byref(program))


def version() -> str:
    """The version of the compiler, as 13.2. Raises a StyleSplatError if there is none."""
    major, minor = ctypes.c_int(), ctypes.c_int()
    _nvrtc().nvrtcVersion(ctypes.byref(major), ctypes.byref(minor))
    return f"{major.value}.{minor.value}"


class DriverState(NamedTuple):
    """What NVIDIA's driver says of itself, whatever torch can do with it."""

    cuda: tuple[int, int]
    """The newest CUDA that it supports, as 12, 4."""
    gpus: int


def driver_state() -> DriverState | None:
    """Ask NVIDIA's driver; None if there is none."""
    try:
        driver = _driver()
    except OSError:
        return None
    version, gpus = ctypes.c_int(), ctypes.c_int()
    driver.cuDriverGetVersion(ctypes.byref(version))
    if driver.cuInit(0) == 0:  # else it has no GPU, or cannot use it
        driver.cuDeviceGetCount(ctypes.byref(gpus))
    return DriverState((version.value // 1000, version.value % 1000 // 10), gpus.value)


@cache
def _driver() -> ctypes.CDLL:
    """NVIDIA's driver. Raises an OSError if there is none."""
    driver = ctypes.CDLL("nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1")
    pointer, number = ctypes.c_void_p, ctypes.c_uint
    driver.cuLaunchKernel.argtypes = [pointer, *7 * [number], *3 * [pointer]]
    return driver


@cache
def _nvrtc() -> ctypes.CDLL:
    for file in _nvrtc_files():
        with suppress(OSError, AttributeError):
            library = ctypes.CDLL(file)
            library.nvrtcGetCUBIN  # noqa: B018  (raises if it is not there)
            return library
    raise StyleSplatError(
        f"Rendering on a GPU needs NVRTC, which torch {torch.__version__} has not brought. Install "
        "a CUDA build of torch, see https://pytorch.org/get-started/locally/, or use --device cpu."
    )


def _nvrtc_files() -> Iterator[str]:
    """Where the compiler may lie: in NVIDIA's wheels, with torch's libraries, in the system."""
    packages, major = Path(torch.__file__).parents[1], (torch.version.cuda or "0").split(".")[0]
    folders = [*packages.glob("nvidia/*/lib"), *packages.glob("nvidia/*/bin*/**")]
    for folder in (*folders, packages / "torch" / "lib"):
        yield from map(str, folder.glob(f"libnvrtc.so.{major}"))
        yield from map(str, folder.glob(f"nvrtc64_{major}*_0.dll"))
    yield f"libnvrtc.so.{major}"
    yield f"nvrtc64_{major}0_0.dll"
    yield str(packages / "torch" / "lib" / "libcaffe2_nvrtc.so")  # depends on it
