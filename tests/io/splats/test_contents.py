"""Files of splats are told by what they hold, whatever their names say."""

import gzip
import io
import json
import shutil
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from ksplat_files import write_ksplat
from scenes import random_splats, write_checkpoint
from stylesplat.errors import StyleSplatError
from stylesplat.io.splats.splat_files import read_splats, write_splats

KINDS = [
    *(".ply", ".compressed.ply", ".spz", ".splat", ".ksplat", ".sog", ".glb", ".gltf"),
    *(".usdc", ".usda", ".usdz", ".pt"),
]


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder, splats = tmp_path_factory.mktemp("splats"), random_splats(20, sh_degree=1)
    for kind in KINDS:
        if kind == ".ksplat":
            write_ksplat(folder / f"a{kind}", [splats], 1, 1)
        elif kind == ".pt":
            write_checkpoint(splats, folder / f"a{kind}")
        else:
            write_splats(splats, folder / f"a{kind}")
    return folder


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", ["b.splat", "b.ply", "b.sog", "b.glb", "b", "b.zip", "b.bin"])
def test_wrong_names_are_read_with_a_line(
    written: Path, tmp_path: Path, said: list[str], kind: str, name: str
):
    expected, path = read_splats(written / f"a{kind}"), tmp_path / name
    shutil.copy(written / f"a{kind}", path)
    assert torch.equal(read_splats(path).means, expected.means)
    is_right = kind.endswith(path.suffix or "?") or {kind, path.suffix} == {".glb", ".gltf"}
    assert len(said) == (0 if is_right else 1)
    assert is_right or f"{path} holds " in said[0]


def test_spz_without_compression(written: Path, tmp_path: Path):
    write_splats(random_splats(20), tmp_path / "a.spz", spz_version=3)
    path = tmp_path / "b.spz"
    path.write_bytes(gzip.decompress((tmp_path / "a.spz").read_bytes()))
    assert torch.equal(read_splats(path).means, read_splats(tmp_path / "a.spz").means)


def test_sog_in_a_folder_of_its_bundle(written: Path, tmp_path: Path):
    path = tmp_path / "a.sog"
    with zipfile.ZipFile(written / "a.sog") as found, zipfile.ZipFile(path, "w") as bundle:
        for name in found.namelist():
            bundle.writestr(f"garden/{name}", found.read(name))
    assert torch.equal(read_splats(path).means, read_splats(written / "a.sog").means)


def zipped(**files: bytes) -> bytes:
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        for name, each in files.items():
            archive.writestr(name.replace("_", "."), each)
    return content.getvalue()


def picture() -> bytes:
    content = io.BytesIO()
    Image.new("RGB", (4, 4)).save(content, "PNG")
    return content.getvalue()


def array() -> bytes:
    content = io.BytesIO()
    np.save(content, np.arange(100))
    return content.getvalue()


POINTER = b"version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 12345\n"
OTHERS = {
    "a page of HTML": b"\n<!DOCTYPE html>\n<html><body>404</body></html>",
    r"a pointer of Git LFS.*git lfs pull": POINTER,
    r"a ZIP archive of scene\.ply, and no SOG.*Unpack it": zipped(scene_ply=b"ply\n"),
    "a gzip archive.*Unpack it": gzip.compress(b"ply\nformat ascii 1.0\n"),
    "a PNG picture": picture(),
    "an array of NumPy": array(),
    "text, which begins 'Access denied'": b"Access denied\n",
    "text, which begins 'Büro": "Büro ".encode() * 2000,
    "text, which begins '{": json.dumps({"cameras": []}).encode(),
    "nothing but zeros": bytes(320),
    "empty": b"",
    "of no format": bytes(range(255, 0, -1)) * 3,
}


@pytest.mark.parametrize("expected", [*OTHERS])
@pytest.mark.parametrize("suffix", [".ply", ".spz", ".sog", ".glb"])
def test_what_is_no_splats_is_named(tmp_path: Path, expected: str, suffix: str):
    path = tmp_path / f"a{suffix}"
    path.write_bytes(OTHERS[expected])
    with pytest.raises(StyleSplatError, match=f"it is {expected}") as caught:
        read_splats(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("first", [b"\x1f\x8b", b"PK", b"\x80\x02"])
def test_dot_splats_that_begin_like_other_files(tmp_path: Path, said: list[str], first: bytes):
    path = tmp_path / "a.splat"
    write_splats(random_splats(200), path)
    path.write_bytes(first + path.read_bytes()[2:])
    assert len(read_splats(path)) == 200
    path.write_bytes(bytes(32 * 200) + path.read_bytes())
    assert len(read_splats(path)) == 200
    assert len(said) == 1 and "200 of 400 Gaussians cannot be drawn" in said[0]


@pytest.mark.parametrize("expected", [e for e in OTHERS if e != "of no format"])
def test_nor_is_it_a_dot_splat(tmp_path: Path, expected: str):
    """A .splat has no mark: pages and pictures of a multiple of 32 bytes would be read."""
    path, content = tmp_path / "a.splat", OTHERS[expected]
    path.write_bytes(content + content[-1:] * (-len(content) % 32))
    with pytest.raises(StyleSplatError, match=f"it is {expected}"):
        read_splats(path)
    path.write_bytes(bytes(range(255, 0, -1)))
    with pytest.raises(StyleSplatError, match="255 bytes are no whole number of rows of 32"):
        read_splats(path)
