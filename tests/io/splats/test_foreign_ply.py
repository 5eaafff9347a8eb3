"""PLY files as other programs write them: headers, kinds of columns, what a comment declares."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from balls import same
from ply_files import columns_of, header_lines, rows_of, write_ply
from scenes import random_splats
from stylesplat.errors import StyleSplatError
from stylesplat.io.ply import read_ply_table
from stylesplat.io.splats.splat_files import read_splats, write_splats
from stylesplat.scene.splats import Splats
from stylesplat.verbs.import_ import Up, import_

COUNT = 30
C0 = 0.28209479177387814


def some(degree: int = 1) -> Splats:
    return replace(random_splats(COUNT, sh_degree=degree), identities=None)


SPLATS = some()
COLUMNS = columns_of(SPLATS)
LINES = header_lines(COLUMNS, {}, "binary_little_endian")
ROWS = rows_of(COLUMNS, {})


def joined(lines: list[str], end: str = "\n", encoding: str = "utf-8") -> bytes:
    return end.join(lines).encode(encoding)


def commented(text: str) -> list[str]:
    return [*LINES[:2], f"comment {text}", *LINES[2:]]


HEADERS = {
    "byte order mark": b"\xef\xbb\xbf" + joined(LINES),
    "CRLF": joined(LINES, "\r\n"),
    "CR": joined(LINES, "\r"),
    "blanks at ends": joined([f"{line}  \t" if line else "" for line in LINES]),
    "tabs": joined(LINES).replace(b" ", b"\t"),
    "empty lines": joined([LINES[0], "", *LINES[1:]]),
    "UTF-8": joined(commented("Büro …")),
    "Latin-1": joined(commented("B\xfcro \x85 end_header"), encoding="latin-1"),
    "obj_info": joined([*LINES[:2], "obj_info num_cols 30", *LINES[2:]]),
    "capital letters": joined(["PLY", *LINES[1:]]),
}


@pytest.mark.parametrize("kind", [*HEADERS])
def test_headers_of_all_systems(tmp_path: Path, kind: str):
    path = tmp_path / "a.ply"
    path.write_bytes(HEADERS[kind] + ROWS)
    assert same(read_splats(path), SPLATS)


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_rows_may_begin_with_what_ends_lines(tmp_path: Path, end: str):
    path, first = tmp_path / "a.ply", np.frombuffer(b"\n\r\n\n", "<f4")[0]
    columns = COLUMNS | {"x": np.full(COUNT, first, np.float32)}
    path.write_bytes(joined(LINES, end) + rows_of(columns, {}))
    assert (read_splats(path).means[:, 0] == first.item()).all()


def test_text(tmp_path: Path):
    path = tmp_path / "a.ply"
    table = np.column_stack([*COLUMNS.values()])
    rows = [" ".join(repr(float(number)) for number in row) for row in table]
    lines = header_lines(COLUMNS, {}, "ascii")
    for end in ("\n", "\r\n", "\r"):
        path.write_bytes(joined([*lines[:-1], "", *rows, ""], end))
        assert same(read_splats(path), SPLATS)
    rows[3] = rows[3].replace(rows[3].split()[0], "-nan", 1)
    path.write_bytes(joined([*lines[:-1], *rows, ""]))
    assert len(read_splats(path)) == COUNT - 1


@pytest.mark.parametrize("text", [False, True])
def test_elements_before_the_vertices_are_skipped(tmp_path: Path, said: list[str], text: bool):
    path = tmp_path / "a.ply"
    cameras = ["element camera 2", "property double focal", "property uchar id"]
    before, columns = bytes(18), {"x": np.arange(3), "y": np.arange(3.0)}
    lines = header_lines(columns, {"x": "i4"}, "ascii" if text else "binary_little_endian")
    lines = [*lines[:2], *cameras, *lines[2:]]
    body = rows_of(columns, {"x": "i4"})
    if text:
        before, body = b"0.5 1\n0.5 2\n", b"0 0\n1 1\n2 2\n"
    path.write_bytes(joined(lines) + before + body)
    table = read_ply_table(path)
    assert table["x"].tolist() == [0, 1, 2] and table["y"].tolist() == [0, 1, 2]
    path.write_bytes(joined([*LINES[:2], *cameras, *LINES[2:]]) + bytes(18) + ROWS)
    assert same(read_splats(path), SPLATS)
    assert said == [f"{path} has elements that splats do not have, left out: camera."]


@pytest.mark.parametrize("order", ["<", ">"])
def test_half_floats_in_columns_of_16_bits(tmp_path: Path, order: str):
    path, types = tmp_path / "a.ply", dict.fromkeys(COLUMNS, "u2")
    halves = {name: values.astype("f2") for name, values in COLUMNS.items()}
    encoding = "binary_little_endian" if order == "<" else "binary_big_endian"
    bits = {name: values.view("u2") for name, values in halves.items()}
    path.write_bytes(joined(header_lines(COLUMNS, types, encoding)) + rows_of(bits, types, order))
    found = read_splats(path)
    for name, values in columns_of(found).items():
        np.testing.assert_array_equal(values, halves[name].astype("f4"))


def test_some_columns_of_16_bits(tmp_path: Path):
    """Positions stay floats, as in files that save space where it does not show."""
    types = {name: "u2" for name in COLUMNS if name not in "xyz"}
    bits = {n: COLUMNS[n].astype("f2").view("u2") if n in types else COLUMNS[n] for n in COLUMNS}
    found = read_splats(write_ply(tmp_path / "a.ply", bits, types))
    assert torch.equal(found.means, SPLATS.means)
    assert torch.equal(found.scales, SPLATS.scales.half().float())


def plain_colors(kind: str, whole: float) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    columns = {n: v for n, v in COLUMNS.items() if not n.startswith("f_")}
    values = np.random.default_rng(0).uniform(0, whole, (3, COUNT)).astype(kind)
    rgb = dict(zip(("red", "green", "blue"), values, strict=True))
    return columns | rgb, dict.fromkeys(rgb, kind)


@pytest.mark.parametrize(("kind", "whole"), [("u1", 255), ("u2", 65535), ("f4", 1), ("i4", 255)])
def test_plain_colours(tmp_path: Path, kind: str, whole: int):
    columns, types = plain_colors(kind, whole)
    found = read_splats(write_ply(tmp_path / "a.ply", columns, types))
    rgb = np.stack([columns[name] for name in ("red", "green", "blue")], axis=1) / whole
    np.testing.assert_allclose(found.sh0[:, 0], (rgb - 0.5) / C0, atol=1e-5)
    assert found.sh_degree == 0


def test_flat_gaussians_of_2dgs(tmp_path: Path, said: list[str]):
    columns = {name: values for name, values in COLUMNS.items() if name != "scale_2"}
    found = read_splats(write_ply(tmp_path / "a.ply", columns))
    assert torch.equal(found.scales[:, :2], SPLATS.scales[:, :2])
    torch.testing.assert_close(found.scales[:, 2], torch.full((COUNT,), 1e-6).log())
    assert "flat, as those of 2DGS" in "".join(said)


@pytest.mark.parametrize("degree", [4, 5])
def test_bands_above_the_third_are_left_out(tmp_path: Path, said: list[str], degree: int):
    bands = (degree + 1) ** 2 - 1
    values = np.random.default_rng(0).normal(size=(3 * bands, COUNT)).astype("f4")
    rest = {f"f_rest_{i}": column for i, column in enumerate(values)}
    found = read_splats(write_ply(tmp_path / "a.ply", columns_of(some(0)) | rest))
    np.testing.assert_array_equal(found.shN[:, 14, 2], values[2 * bands + 14])
    assert found.sh_degree == 3
    assert said == [
        f"{tmp_path / 'a.ply'} has colours of degree {degree}: the bands above 3 are left out."
    ]


def test_mip_splattings_filter(tmp_path: Path, said: list[str]):
    """Its authors render scales and opacities of the blurred Gaussians."""
    sizes = np.linspace(0, 0.2, COUNT)
    found = read_splats(write_ply(tmp_path / "a.ply", COLUMNS | {"filter_3D": sizes}))
    before, after = SPLATS.scales.double().exp() ** 2, torch.from_numpy(sizes)[:, None] ** 2
    torch.testing.assert_close(found.scales.double().exp() ** 2, before + after)
    share = (before.prod(dim=1) / (before + after).prod(dim=1)).sqrt()
    alphas = SPLATS.opacities.double().sigmoid() * share
    torch.testing.assert_close(found.opacities.double().sigmoid(), alphas, rtol=1e-5, atol=1e-7)
    assert len(said) == 1 and "filter_3D" in said[0]


def test_other_columns_are_named(tmp_path: Path, said: list[str]):
    more = {"motion_0": np.ones(COUNT), "nx": np.ones(COUNT), "label": np.ones(COUNT)}
    assert same(read_splats(write_ply(tmp_path / "a.ply", COLUMNS | more)), SPLATS)
    assert said == [
        f"{tmp_path / 'a.ply'} has columns that splats do not have, left out: motion_0."
    ]


MARKS = {
    "SplatRenderMode: mip": True,
    "  SPLATRENDERMODE :MIP ": True,
    "SplatRenderMode: default": False,
    "SplatRenderMode: 2dgs": False,
    "antialiased 1": True,
    "antialiased 0": False,
    "made by somebody": False,
}


@pytest.mark.parametrize("comment", [*MARKS])
def test_marks_of_anti_aliasing(tmp_path: Path, said: list[str], comment: str):
    path = write_ply(tmp_path / "a.ply", COLUMNS, comments=["Exported from Brush", comment])
    assert read_splats(path).antialiased == MARKS[comment]
    assert not said
    read_splats(write_ply(path, COLUMNS, comments=["SplatRenderMode: bokeh"]))
    assert "'bokeh', which is unknown" in said[0]


def test_the_last_mark_counts(tmp_path: Path):
    comments = ["antialiased 1", "SplatRenderMode: default", "SplatRenderMode: mip"]
    assert read_splats(write_ply(tmp_path / "a.ply", COLUMNS, comments=comments)).antialiased
    assert not read_splats(
        write_ply(tmp_path / "a.ply", COLUMNS, comments=comments[:2])
    ).antialiased


AXES: dict[str, Up] = {"Vertical Axis: z": "z", "vertical axis: -Z": "-z", "Vertical axis: x": "x"}


@pytest.mark.parametrize("comment", [*AXES])
def test_views_stand_along_the_vertical_axis(tmp_path: Path, said: list[str], comment: str):
    path = write_ply(tmp_path / "a.ply", COLUMNS, comments=[comment])
    scene = import_(path)
    assert torch.equal(scene.cameras.viewmats, import_(path, up=AXES[comment]).cameras.viewmats)
    assert f"{path} says that {AXES[comment]} is up" in said[0]
    assert same(scene.splats, SPLATS), "the world is not turned"


def test_an_axis_without_a_sign_is_colmaps(tmp_path: Path, said: list[str]):
    """Brush writes y into every file, and its world is COLMAP's, whose y points down."""
    path = write_ply(tmp_path / "a.ply", COLUMNS, comments=["Vertical axis: y"])
    scene = import_(path)
    assert torch.equal(scene.cameras.viewmats, import_(path, up="-y").cameras.viewmats)
    assert not any("is up" in line for line in said)


REFUSED = {
    "a cloud of points or a mesh, without Gaussians": {
        name: values for name, values in COLUMNS.items() if name in "xyz"
    },
    "no column rot_3": {name: v for name, v in COLUMNS.items() if name != "rot_3"},
    "10 f_rest columns fit no degree": COLUMNS | {"f_rest_9": COLUMNS["x"]},
}


@pytest.mark.parametrize("expected", [*REFUSED])
def test_what_is_refused(tmp_path: Path, expected: str):
    with pytest.raises(StyleSplatError, match=rf"a\.ply as splats: .*{expected}"):
        read_splats(write_ply(tmp_path / "a.ply", REFUSED[expected]))


def test_numbers_that_a_codebook_explains_are_refused(tmp_path: Path):
    columns = COLUMNS | {"opacity": np.arange(COUNT)}
    with pytest.raises(StyleSplatError, match="column opacity has 8 bits"):
        read_splats(write_ply(tmp_path / "a.ply", columns, {"opacity": "u1"}))


# SuperSplat's compressed PLY, by hand


def compressed(
    path: Path, *, colors: bool = True, end: str = "\n", order: str = "<", comment: str = "a"
) -> Path:
    numbers = np.random.default_rng(0)
    packed = numbers.integers(0, 2**32, (COUNT, 4), dtype=np.uint64).astype(f"{order}u4")
    kinds = ("x", "y", "z", "scale_x", "scale_y", "scale_z", *("rgb" if colors else ""))
    bounds = {f"min_{kind}": 0.0 if kind in "rgb" else -4.0 for kind in kinds}
    bounds |= {f"max_{kind}": 1.0 if kind in "rgb" else -1.0 for kind in kinds}
    encoding = "binary_little_endian" if order == "<" else "binary_big_endian"
    lines = ["ply", f"format {encoding} 1.0", f"comment {comment}", "element chunk 1"]
    lines += [f"property float {name}" for name in bounds] + [f"element vertex {COUNT}"]
    names = ("position", "rotation", "scale", "color")
    lines += [f"property uint packed_{name}" for name in names] + ["end_header", ""]
    body = np.array([*bounds.values()], f"{order}f4").tobytes() + packed.tobytes()
    path.write_bytes(joined(lines, end) + body)
    return path


VARIANTS = {
    "12 bounds": {"colors": False},
    "CRLF": {"end": "\r\n"},
    "CR": {"end": "\r"},
    "big-endian": {"order": ">"},
    "UTF-8": {"comment": "Büro"},
}


@pytest.mark.parametrize("kind", [*VARIANTS])
def test_compressed_ply_of_all_ages(tmp_path: Path, kind: str):
    expected = read_splats(compressed(tmp_path / "a.compressed.ply"))
    assert same(read_splats(compressed(tmp_path / "b.compressed.ply", **VARIANTS[kind])), expected)


def test_compressed_ply_has_the_mark_too(tmp_path: Path):
    path = compressed(tmp_path / "a.ply", comment="SplatRenderMode: mip")
    assert read_splats(path).antialiased


def test_doubles_are_read_as_such(tmp_path: Path):
    path = write_ply(tmp_path / "a.ply", COLUMNS, dict.fromkeys(COLUMNS, "f8"))
    assert same(read_splats(path), SPLATS)
    write_splats(replace(SPLATS, antialiased=True), tmp_path / "b.ply")
    header = (tmp_path / "b.ply").read_bytes().partition(b"end_header")[0]
    assert b"\ncomment SplatRenderMode: mip\n" in header
