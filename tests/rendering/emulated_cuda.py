"""Our CUDA kernels on the CPU: the same sources, compiled by g++, below the same Python.

`emulated_cuda.h` has what CUDA has and C++ has not.
"""

import ctypes
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from functools import cache
from hashlib import sha256
from pathlib import Path
from threading import Lock
from typing import Any

import pytest
import torch
from torch import Tensor

from stylesplat.rendering import nvrtc
from stylesplat.rendering.nvrtc import Argument, packed_arguments, source_text

HEADER = Path(__file__).with_name("emulated_cuda.h")
KERNEL = re.compile(r'(?:extern "C" __global__ void|BLEND_KERNEL) ([a-z]\w*)\(')
OPTIONS = "-std=c++17 -O2 -shared -fPIC -w -ffp-contract=off -U_FORTIFY_SOURCE".split()
CODES = {
    **{torch.float32: "f", torch.float64: "d", torch.int32: "i"},
    **{torch.int64: "q", torch.bool: "?"},
}
ONE_AT_A_TIME = Lock()


def install(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let `cuda` run its kernels on the CPU for one test."""
    if sys.platform != "linux" or shutil.which("g++") is None:
        pytest.skip("emulates CUDA's kernels by g++, on Linux")
    monkeypatch.setattr(nvrtc, "load_kernels", load)


@cache
def load(source: Path, device: torch.device, **defines: int | float) -> "Kernels":
    return Kernels(source, defines)


class Kernels:
    """As `nvrtc.Kernels`, and checks the types of all arguments."""

    def __init__(self, source: Path, defines: dict[str, int | float]) -> None:
        text = HEADER.read_text() + source_text(source, **defines)
        for name in set(KERNEL.findall(source.read_text())):
            guard = "#if CHANNELS == 4\n%s#endif\n" if name == "front_depth" else "%s"
            text += "\n" + guard % (
                f'extern "C" const char* codes_{name}() {{ return emulated::codes({name}); }}\n'
                f'extern "C" void run_{name}(const char* packed, int columns, int rows, int count)'
                f" {{ emulated::launch({name}, packed, columns, rows, count); }}\n"
            )
        self._library = ctypes.CDLL(str(_compiled(text)))

    def launch(self, name: str, grid: tuple[int, int], threads: int, *arguments: Argument) -> None:
        codes: Callable[[], Any] = getattr(self._library, f"codes_{name}")
        codes.restype = ctypes.c_char_p  # pyright: ignore
        expected = codes().decode().split()
        assert len(arguments) == len(expected), f"{name} takes {len(expected)} arguments"
        for place, (argument, code) in enumerate(zip(arguments, expected, strict=True)):
            assert fits(argument, code), f"argument {place} of {name} is no {code}"
        with ONE_AT_A_TIME:
            getattr(self._library, f"run_{name}")(packed_arguments(arguments), *grid, threads)


def fits(argument: Argument, code: str) -> bool:
    if isinstance(argument, Tensor):
        return code == f"*{CODES[argument.dtype]}"
    if argument is None:
        return code.startswith("*")
    return code == ("f" if isinstance(argument, float) else "i")


def _compiled(text: str) -> Path:
    """The library of a source, which other tests and processes find again."""
    path = Path(tempfile.gettempdir()) / f"emulated-{sha256(text.encode()).hexdigest()[:24]}.so"
    if not path.exists():
        with tempfile.TemporaryDirectory() as folder:
            source, made = Path(folder) / "kernels.cpp", path.with_suffix(f".{Path(folder).name}")
            source.write_text(text)
            subprocess.run(["g++", *OPTIONS, str(source), "-o", str(made)], check=True)
        made.replace(path)
    return path
