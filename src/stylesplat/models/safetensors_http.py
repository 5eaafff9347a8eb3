"""Single tensors out of a safetensors file on a web server, by HTTP range requests."""

import json
from collections.abc import Iterable
from http.client import HTTPException
from urllib.request import Request, urlopen

import torch
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.progress import Task, task

DTYPES = {"F32": torch.float32, "F16": torch.float16, "BF16": torch.bfloat16}
LENGTH_BYTES = 8  # the file begins with the header's length, little-endian
MAX_HEADER = 2**24  # a longer header is no header
TIMEOUT = 30  # seconds
CHUNK = 2**18  # bytes between two updates of the progress bar


def fetch_tensors(url: str, names: Iterable[str], *, title: str) -> dict[str, Tensor]:
    """Download some tensors of a remote safetensors file, as float32, and nothing else of it."""
    try:
        start, header = _read_header(url)
        missing = [name for name in names if name not in header]
        if missing:
            raise StyleSplatError(f"{url} lacks {', '.join(missing)}. Pass another weights file.")
        total = sum(b - a for a, b in (header[name]["data_offsets"] for name in names))
        with task(title, total, unit="B") as bar:
            return {name: _read_tensor(url, start, header[name], bar) for name in names}
    except (OSError, HTTPException, ValueError, KeyError) as error:
        reason = getattr(error, "reason", error)
        raise StyleSplatError(f"Cannot download from {url}: {reason}.") from error


def _read_header(url: str) -> tuple[int, dict]:
    length = int.from_bytes(_read_range(url, 0, LENGTH_BYTES), "little")
    if length > MAX_HEADER:
        raise ValueError("it is no safetensors file")
    start = LENGTH_BYTES + length
    return start, json.loads(_read_range(url, LENGTH_BYTES, start))


def _read_tensor(url: str, start: int, entry: dict, bar: Task) -> Tensor:
    begin, end = entry["data_offsets"]
    content = _read_range(url, start + begin, start + end, bar)
    tensor = torch.frombuffer(content, dtype=DTYPES[entry["dtype"]]).float()
    return tensor.reshape(entry["shape"])


def _read_range(url: str, begin: int, end: int, bar: Task | None = None) -> bytearray:
    request = Request(url, headers={"Range": f"bytes={begin}-{end - 1}"})
    content = bytearray()
    with urlopen(request, timeout=TIMEOUT) as response:
        if response.status != 206:
            raise ValueError("the server sends whole files only")
        while chunk := response.read(CHUNK):
            content += chunk
            if bar is not None:
                bar.advance(len(chunk))
    if len(content) != end - begin:
        raise ValueError("the connection broke off")
    return content
