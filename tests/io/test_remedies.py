"""Every refusal ends with what to do about it."""

import errno
import re
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from stylesplat.errors import StyleSplatError
from stylesplat.io.files import cannot_write, read_bytes
from stylesplat.io.json_files import read_json
from stylesplat.io.label_maps import write_label_map
from stylesplat.io.plain_yaml import MAX_YAML, parse_yaml
from stylesplat.io.ply import read_ply_table
from stylesplat.io.splats.splat_files import read_splats
from stylesplat.io.video import write_video

TWO_SENTENCES = re.compile(r".+\. [A-Z].+\.")


def frames(*heights: int) -> list[torch.Tensor]:
    return [torch.zeros(height, 20, 3, dtype=torch.uint8) for height in heights]


def json_of(text: str) -> Callable[[Path], object]:
    def read(folder: Path) -> object:
        (folder / "a.json").write_text(text)
        return read_json(folder / "a.json")

    return read


def ply_of(content: bytes) -> Callable[[Path], object]:
    def read(folder: Path) -> object:
        (folder / "a.ply").write_bytes(content)
        return read_ply_table(folder / "a.ply")

    return read


def raises(error: StyleSplatError) -> Callable[[Path], object]:
    def act(_: Path) -> object:
        raise error

    return act


REFUSALS: dict[str, Callable[[Path], object]] = {
    "no file": lambda folder: read_bytes(folder / "lost"),
    "long name": lambda folder: read_bytes(folder / ("a" * 300)),
    "no name": lambda folder: read_bytes(folder / "a\0b"),
    "a folder": lambda folder: read_bytes(folder),
    "no text": json_of("{"),
    "a list": json_of("[]"),
    "deep": json_of("[" * 200 + "]" * 200),
    "deep object": json_of('{"a":' * 200 + "1" + "}" * 200),
    "YAML": lambda _: parse_yaml("a: ["),
    "long YAML": lambda _: parse_yaml("a" * (MAX_YAML + 1)),
    "no YAML": lambda _: parse_yaml("\x00"),
    "no PLY": ply_of(b"text"),
    "PLY of nothing": ply_of(b"ply\nformat ascii 1.0\nend_header\n"),
    "short PLY": ply_of(b"ply\nformat ascii 1.0\nelement vertex 2\nproperty int x\nend_header\n"),
    "no splats": lambda folder: read_splats(folder / "a.obj"),
    "ids": lambda folder: write_label_map(torch.tensor([[-1]]), folder / "a.png"),
    "frames": lambda folder: write_video(frames(20, 30), folder / "a.mp4"),
    "no frames": lambda folder: write_video(frames(), folder / "a.mp4"),
    "read-only": raises(cannot_write(Path("a"), OSError(errno.EROFS, "Read-only file system"))),
}


@pytest.mark.parametrize("name", REFUSALS)
def test_refusals_name_a_remedy(name: str, tmp_path: Path):
    with pytest.raises(StyleSplatError) as caught:
        REFUSALS[name](tmp_path)
    assert TWO_SENTENCES.fullmatch(str(caught.value)), str(caught.value)
