"""Files of tensors that are consistent in themselves, and not what their reader expects."""

import io
import json
import random
import struct
from typing import Any, NamedTuple

import json_mutants

DTYPES = {"F64": 8, "F32": 4, "F16": 2, "BF16": 2, "I64": 8, "I32": 4, "U8": 1, "BOOL": 1}
FLOATS = (float("nan"), float("inf"), float("-inf"), 1e38, -1e38, -1.0, 2.0)
NAMES = ("__metadata__", "", "0", "count", "extra", "a/b", "../x", "\ud800", "x" * 300, "ids")


class Stored(NamedTuple):
    """A tensor in a safetensors file."""

    dtype: str
    shape: list[int]
    data: bytes


def safetensors_mutant(content: bytes, random_: random.Random) -> bytes:
    """The same with a tensor renamed, dropped, added, reshaped, of another type or value."""
    tensors = _read(content)
    if random_.random() < 0.15:  # a header that does not go with what follows it
        length = struct.unpack_from("<Q", content)[0]
        header = json_mutants.json_mutant(content[8 : 8 + length], random_)
        return struct.pack("<Q", len(header)) + header + content[8 + length :]
    if tensors:
        random_.choice(CHANGES)(tensors, random_.choice([*tensors]), random_)
    return _written(tensors)


def checkpoint_mutant(content: bytes, random_: random.Random) -> bytes:
    """A checkpoint that lacks keys, or has other values or tensors."""
    import torch

    holder: dict[str, Any] = {"": torch.load(io.BytesIO(content), weights_only=True)}
    for _ in range(random_.choice((1, 1, 2))):
        parent, key = random_.choice([*_places(holder)])
        match random_.randrange(3):
            case 0 if key != "":
                del parent[key]
            case 1:
                parent[key] = json_mutants.nasty(random_)
            case _:
                parent[key] = _other(parent[key], random_)
    written = io.BytesIO()
    torch.save(holder.get(""), written)
    return written.getvalue()


def _read(content: bytes) -> dict[str, Stored]:
    (length,) = struct.unpack_from("<Q", content)
    header, data = json.loads(content[8 : 8 + length]), content[8 + length :]
    header.pop("__metadata__", None)
    return {
        name: Stored(each["dtype"], each["shape"], data[slice(*each["data_offsets"])])
        for name, each in header.items()
    }


def _written(tensors: dict[str, Stored]) -> bytes:
    header, data = {}, b""
    for name, (dtype, shape, stored) in tensors.items():
        ends = [len(data), len(data) + len(stored)]
        header[name] = {"dtype": dtype, "shape": shape, "data_offsets": ends}
        data += stored
    text = json.dumps(header).encode()
    return struct.pack("<Q", len(text)) + text + data


def _rename(tensors: dict[str, Stored], name: str, random_: random.Random) -> None:
    tensors[random_.choice((*NAMES, *tensors))] = tensors.pop(name)


def _drop(tensors: dict[str, Stored], name: str, random_: random.Random) -> None:
    del tensors[name]


def _add(tensors: dict[str, Stored], name: str, random_: random.Random) -> None:
    tensors[random_.choice(NAMES)] = random_.choice((tensors[name], Stored("F32", [0], b"")))


def _reshape(tensors: dict[str, Stored], name: str, random_: random.Random) -> None:
    """In a way that keeps the number of values."""
    dtype, shape, data = tensors[name]
    count = len(data) // DTYPES[dtype]
    first = shape[:1] or [1]
    others = ([count], [1, *shape], [*shape, 1], shape[::-1], [*first, count // (first[0] or 1)])
    tensors[name] = Stored(dtype, random_.choice(others), data)


def _cut(tensors: dict[str, Stored], name: str, random_: random.Random) -> None:
    """Fewer or more rows, or none."""
    dtype, shape, data = tensors[name]
    rows = (shape or [1])[0]
    size = len(data) // max(1, rows)
    count = random_.choice((0, 1, max(0, rows - 1), rows + 1))
    tensors[name] = Stored(dtype, [count, *shape[1:]], (data + data[:size])[: size * count])
    if len(tensors[name].data) != size * count:
        tensors[name] = Stored(dtype, [0, *shape[1:]], b"")


def _retype(tensors: dict[str, Stored], name: str, random_: random.Random) -> None:
    """The same bits or zeros as numbers of another type."""
    dtype, shape, data = tensors[name]
    other = random_.choice([*DTYPES])
    if DTYPES[other] != DTYPES[dtype]:
        data = bytes(len(data) // DTYPES[dtype] * DTYPES[other])
    tensors[name] = Stored(other, shape, data)


def _poison(tensors: dict[str, Stored], name: str, random_: random.Random) -> None:
    """Values that no Gaussian has, or rows that there are not."""
    dtype, shape, data = tensors[name]
    changed = bytearray(data)
    width = DTYPES[dtype]
    for _ in range(random_.choice((1, 1, 20))):
        if changed:
            offset = width * random_.randrange(len(changed) // width)
            changed[offset : offset + width] = _extreme(dtype, random_)
    tensors[name] = Stored(dtype, shape, bytes(changed))


def _extreme(dtype: str, random_: random.Random) -> bytes:
    width = DTYPES[dtype]
    if dtype in ("F32", "F64"):
        return struct.pack("<f" if width == 4 else "<d", random_.choice(FLOATS))
    number = random_.choice((-1, -7, 2 ** (8 * width - 1) - 1, 6, 100))
    return (number % 2 ** (8 * width)).to_bytes(width, "little")


def _places(parent: Any) -> Any:
    pairs = list(parent.items() if isinstance(parent, dict) else enumerate(parent))
    for key, value in pairs:
        yield parent, key
        if isinstance(value, dict | list):
            yield from _places(value)


def _other(value: Any, random_: random.Random) -> Any:
    """A tensor of another shape, type or value; a list of other length; anything as a text."""
    import torch

    if not isinstance(value, torch.Tensor):
        return value[:-1] if isinstance(value, list) else str(value)
    poisoned = value.detach().clone()
    poisoned.view(-1)[:1] = float("nan")
    changed = (
        value.detach()[:-1] if value.dim() else value,
        value.detach().reshape(-1),
        value.detach()[None],
        value.detach().double(),
        value.detach().long(),
        value.detach().to("meta"),
        value.detach().to_sparse(),
        value.detach().T if value.dim() == 2 else value.expand(2, *value.shape),
        poisoned,
        torch.nn.Parameter(value.detach()[..., :0]),
    )
    return random_.choice(changed)


CHANGES = (_rename, _drop, _add, _reshape, _reshape, _cut, _retype, _poison, _poison)
