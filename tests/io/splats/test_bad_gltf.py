import math
import struct
from pathlib import Path

import pytest

from scenes import (
    NAME,
    Json,
    as_gltf,
    attribute,
    attributes,
    changed_glb,
    extension,
    glb_of,
    glb_parts,
    places,
    random_splats,
)
from stylesplat.errors import StyleSplatError
from stylesplat.io.splats.splat_files import read_splats, write_splats
from stylesplat.scene.splats import Splats

COUNT = 40


def some() -> Splats:
    return random_splats(COUNT, sh_degree=1)


def written(folder: Path) -> Path:
    path = folder / "a.glb"
    write_splats(some(), path)
    return path


@pytest.mark.parametrize(
    "uri",
    [
        "%2e%2e/secret.bin",
        "{at}/secret.bin",
        "file://{at}/secret.bin",
        "C:\\secret.bin",
    ],
)
def test_nothing_is_read_outside_the_folder(tmp_path: Path, uri: str):
    path = written(tmp_path / "folder")
    (tmp_path / "secret.bin").write_bytes(glb_parts(path)[1])
    with pytest.raises(StyleSplatError, match=r"a\.gltf as splats: .* outside its folder"):
        read_splats(as_gltf(path, uri.format(at=tmp_path)))


def test_buffers_that_are_not_there(tmp_path: Path):
    path = written(tmp_path)
    with pytest.raises(StyleSplatError, match=r"nowhere\.bin: No such file"):
        read_splats(as_gltf(path, "nowhere.bin"))
    (tmp_path / "short.bin").write_bytes(bytes(10))
    with pytest.raises(StyleSplatError, match=r"buffer 0 should have \d+ bytes, but has 10"):
        read_splats(as_gltf(path, "short.bin"))
    with pytest.raises(StyleSplatError, match=r"base64|padding"):
        read_splats(as_gltf(path, "data:;base64,?"))
    changed_glb(path, lambda d: d["buffers"].insert(0, {"byteLength": 10**9}))
    with pytest.raises(StyleSplatError, match="should have 1000000000 bytes"):
        read_splats(path)


PACKED = "EXT_splats_compression"
DRAFT = "KHR_spz_gaussian_splats_compression"


def counts(document: Json, count: int) -> None:
    for each in document["accessors"]:
        each["count"] = count


def drawn(document: Json) -> Json:
    return document["meshes"][0]["primitives"][0]


def node(document: Json) -> Json:
    return document["nodes"][0]


REFUSED = {
    "1000000000000 rows of POSITION, 12 bytes": lambda d: counts(d, 10**12),
    "40 positions, but 39 KHR": lambda d: attribute(d, f"{NAME}:SCALE").update(count=39),
    "end at byte 1000000480, its buffer at 4000": lambda d: places(d).update(byteOffset=10**9),
    "no ellipses, but 'cube'": lambda d: extension(d).update(kernel="cube"),
    rf"compressed \({PACKED}\).* .spz": lambda d: extension(d).update(extensions={PACKED: {}}),
    "an ordinary model": lambda d: drawn(d).pop("extensions"),
    f"stored by {DRAFT}": lambda d: (d.update(extensionsUsed=[DRAFT]), drawn(d).pop("extensions")),
    "mirrors, shears or stretches": lambda d: node(d).update(scale=[1, 2, 1]),
    "its nodes are no tree": lambda d: node(d).update(children=[0]),
    "shows 360 Gaussians, which .* cannot hold": lambda d: d.update(
        nodes=[{"mesh": 0}] * 512, scenes=[{"nodes": [*range(512)]}]
    ),
    "There are no Gaussians": lambda d: counts(d, 0),
    "of version '1.0', not 2": lambda d: d["asset"].update(version="1.0"),
    "its splats have no .*SCALE": lambda d: attributes(d).pop(f"{NAME}:SCALE"),
    "have the wrong type: 'VEC2'": lambda d: attribute(d, f"{NAME}:SCALE").update(type="VEC2"),
    "left out or sparse": lambda d: attribute(d, f"{NAME}:SCALE").pop("bufferView"),
    "5 bytes apart, do not fit": lambda d: places(d).update(byteStride=5),
    "its buffer 1 is missing": lambda d: (
        d["buffers"].append({"byteLength": 1}),
        places(d).update(buffer=1),
    ),
    "a node shows mesh 7 of 1": lambda d: node(d).update(mesh=7),
}


@pytest.mark.parametrize("expected", [*REFUSED])
def test_what_cannot_be_read_is_told_in_one_line(tmp_path: Path, expected: str):
    path = written(tmp_path)
    changed_glb(path, REFUSED[expected])
    with pytest.raises(StyleSplatError, match=expected) as caught:
        read_splats(path)
    assert "\n" not in str(caught.value) and str(path) in str(caught.value)
    assert len(str(caught.value)) < 400


def test_hostile_containers(tmp_path: Path):
    path = written(tmp_path)
    content = path.read_bytes()
    huge = struct.pack("<I", 2**32 - 1)
    for changed, expected in (
        (content[:-3], r"a chunk should have \d+ bytes, but \d+ are left"),
        (content[:12] + huge + content[16:], "a chunk should have 4294967295 bytes"),
        (content[:4] + b"\1" + content[5:], "a GLB of version 1, not 2"),
        (content[:16] + b"BIN\0" + content[20:], "no chunk of JSON"),
        (b"ply\n" + content, "its header has no end_header"),
    ):
        path.write_bytes(changed)
        with pytest.raises(StyleSplatError, match=expected):
            read_splats(path)


@pytest.mark.parametrize("deep", ["[", '{"a":'])
def test_json_that_would_take_much_memory(tmp_path: Path, deep: str):
    path = tmp_path / "a.gltf"
    path.write_text('{"asset":{"version":"2.0"},"nodes":[' + "{}," * 2**20 + "{}]}")
    with pytest.raises(StyleSplatError, match="its JSON has 1048577 parts, more than 1048576"):
        read_splats(path)
    path.write_text('{"asset":{"version":"2.0"},"extras":' + deep * 10**5)
    with pytest.raises(StyleSplatError, match=r"Cannot read .*as splats"):
        read_splats(path)


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("POSITION", math.nan, "1 whose position is not finite"),
        (f"{NAME}:SCALE", -1e-3, "1 whose size is not finite"),
        (f"{NAME}:OPACITY", 1.5, "1 whose opacity is not finite"),
    ],
)
def test_numbers_that_cannot_be(
    tmp_path: Path, said: list[str], name: str, value: float, expected: str
):
    path = written(tmp_path)
    document, binary = glb_parts(path)
    changed = bytearray(binary)
    offset = document["bufferViews"][attributes(document)[name]]["byteOffset"]
    struct.pack_into("<f", changed, offset, value)
    path.write_bytes(glb_of(document, bytes(changed)))
    assert len(read_splats(path)) == COUNT - 1
    (line,) = said
    assert expected in line and f"1 of {COUNT} Gaussians" in line


def test_what_cannot_be_written(tmp_path: Path):
    with pytest.raises(StyleSplatError, match=r"no Gaussians, and glTF .*Export a \.ply"):
        write_splats(random_splats(0), tmp_path / "a.glb")
    splats = some()
    splats.means[3, 1] = math.nan
    for name in ("a.glb", "a.gltf"):
        with pytest.raises(StyleSplatError, match="1 values of means are not finite"):
            write_splats(splats, tmp_path / name)
    assert not any(tmp_path.iterdir())
