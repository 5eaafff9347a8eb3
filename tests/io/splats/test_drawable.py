"""Rows that cannot be drawn are left out with a line; limits of logits and logarithms are read."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from balls import CAMERAS, SPLATS, same
from ksplat_files import write_ksplat
from ply_files import Columns, columns_of, write_ply
from scenes import NAME, attributes, glb_of, glb_parts, random_splats
from stylesplat.errors import StyleSplatError
from stylesplat.io.scene_folder import open as open_scene
from stylesplat.io.scene_folder import save
from stylesplat.io.splats.splat_files import read_splats, write_splats
from stylesplat.rendering.render import rasterize
from stylesplat.scene.splats import Splats
from stylesplat.verbs.export import export
from stylesplat.verbs.import_ import import_

COUNT = 40
PLAIN = replace(random_splats(COUNT, sh_degree=1), identities=None)
INF, NAN = math.inf, math.nan


def changed(row: int, **values: float) -> Columns:
    columns = {name: values.copy() for name, values in columns_of(PLAIN).items()}
    for name, value in values.items():
        columns[name][row] = value
    return columns


def without(row: int) -> Splats:
    return PLAIN[torch.arange(COUNT) != row]


BAD = {
    "whose position is not finite": {"x": NAN},
    "whose position is not finite ": {"z": -INF},
    "whose position is out of range": {"y": 1e30},
    "whose size is not finite": {"scale_1": INF},
    "whose size is not finite ": {"scale_1": NAN},
    "whose size is out of range": {"scale_0": 25.0},
    "whose rotation is not finite": {"rot_2": NAN},
    "whose rotation is 0": dict.fromkeys(("rot_0", "rot_1", "rot_2", "rot_3"), 0.0),
    "whose opacity is not finite": {"opacity": NAN},
    "whose colour is not finite": {"f_dc_1": NAN},
    "whose colour is not finite ": {"f_rest_4": INF},
    "rows of zeros": dict.fromkeys(columns_of(PLAIN), 0.0),
}


@pytest.mark.parametrize("why", [*BAD])
def test_a_row_that_cannot_be_drawn_is_left_out(tmp_path: Path, said: list[str], why: str):
    path = write_ply(tmp_path / "a.ply", changed(7, **BAD[why]))
    assert same(read_splats(path), without(7))
    assert said == [
        f"{path}: 1 of {COUNT} Gaussians cannot be drawn and are left out (1 {why.strip()})."
    ]


def test_one_line_for_all_reasons(tmp_path: Path, said: list[str]):
    columns = changed(3, x=NAN, opacity=NAN)
    columns["scale_2"][5:9] = INF
    path = write_ply(tmp_path / "a.ply", columns)
    assert len(read_splats(path)) == COUNT - 5
    (line,) = said
    assert "5 of 40" in line
    assert "(1 whose position is not finite, 4 whose size is not finite)" in line


def test_nothing_that_can_be_drawn_is_refused(tmp_path: Path):
    path = write_ply(tmp_path / "a.ply", changed(0, x=NAN) | {"y": np.full(COUNT, NAN)})
    with pytest.raises(StyleSplatError, match=r"none of its 40 Gaussians can be drawn \(40 whose"):
        read_splats(path)


def test_our_own_scenes_are_as_strict_as_before(tmp_path: Path):
    save(import_(PLAIN), tmp_path / "scene")
    write_ply(tmp_path / "scene" / "splats.ply", changed(7, x=NAN))
    with pytest.raises(StyleSplatError, match="1 values of means are not finite"):
        open_scene(tmp_path / "scene")


@pytest.mark.parametrize("suffix", [".npy", ".npz", ".ply"])
def test_labels_go_with_the_rows_of_the_file(tmp_path: Path, suffix: str):
    labels = np.arange(COUNT) % 5
    path = write_ply(tmp_path / "a.ply", changed(7, x=NAN) | {"label": labels})
    if suffix == ".npy":
        np.save(tmp_path / "labels.npy", labels)
    elif suffix == ".npz":
        np.savez(tmp_path / "labels.npz", labels=labels)
    file = path if suffix == ".ply" else tmp_path / f"labels{suffix}"
    expected = import_(without(7), labels=torch.from_numpy(np.delete(labels, 7)))
    for given in (file, torch.from_numpy(labels), torch.from_numpy(np.delete(labels, 7))):
        found = import_(path, labels=given).splats
        assert same(found, expected.splats)
    with pytest.raises(StyleSplatError, match="41 labels"):
        import_(path, labels=torch.zeros(41, dtype=torch.int64) + 1)


# Limits


def image(splats: Splats) -> torch.Tensor:
    return rasterize(splats, CAMERAS[0])[0]


def balls_with(**values: np.ndarray) -> Columns:
    plain = replace(SPLATS, identities=None, classifier=None)
    return columns_of(plain) | values


def test_infinite_opacities_and_flat_gaussians_are_read(tmp_path: Path, said: list[str]):
    plain = replace(SPLATS, identities=None, classifier=None)
    opacities, scales = plain.opacities.numpy().copy(), plain.scales[:, 2].numpy().copy()
    opacities[:50], opacities[50:90], scales[100:200] = INF, -INF, -INF
    path = write_ply(tmp_path / "a.ply", balls_with(opacity=opacities, scale_2=scales))
    found = read_splats(path)
    assert not said and len(found) == len(plain)
    assert all(tensor.isfinite().all() for tensor in found.tensors().values())
    alphas = found.opacities.sigmoid()
    assert (alphas[:50] == 1).all() and (alphas[50:90] < 1 / 255).all()
    assert (found.scales[100:200, 2].exp().square() == 0).all()
    rest = torch.arange(200, len(plain))
    assert same(found[rest], plain[rest])
    expected = image(found[alphas > 0.001])
    assert image(found).isfinite().all() and torch.equal(image(found), expected)


@pytest.mark.parametrize("suffix", [".ply", ".compressed.ply", ".spz", ".splat", ".sog", ".glb"])
def test_limits_survive_other_formats(tmp_path: Path, suffix: str):
    splats = replace(SPLATS, identities=None, classifier=None)
    opacities, scales = splats.opacities.numpy().copy(), splats.scales[:, 2].numpy().copy()
    opacities[:50], opacities[50:90], scales[100:200] = INF, -INF, -INF
    path = write_ply(tmp_path / "a.ply", balls_with(opacity=opacities, scale_2=scales))
    found = read_splats(path)
    export(found, tmp_path / f"b{suffix}")
    again = read_splats(tmp_path / f"b{suffix}")
    assert len(again) == len(found)
    assert (image(again) - image(found)).abs().mean() < 0.01


def test_sizes_of_0_in_dot_splat(tmp_path: Path):
    path = tmp_path / "a.splat"
    write_splats(PLAIN, path)
    rows = np.frombuffer(path.read_bytes(), "u1").reshape(-1, 32).copy()
    rows[:, 20:24] = 0
    path.write_bytes(rows.tobytes())
    assert (read_splats(path).scales[:, 2].exp().square() == 0).all()


@pytest.mark.parametrize("level", [0, 1])
def test_sizes_of_0_in_ksplat(tmp_path: Path, level: int):
    flat = replace(PLAIN, scales=torch.full((COUNT, 3), -INF))[:30]
    found = read_splats(write_ksplat(tmp_path / "a.ksplat", [flat], level, 1))
    assert len(found) == 30 and (found.scales.exp().square() == 0).all()


def test_sizes_of_0_in_gltf(tmp_path: Path):
    path = tmp_path / "a.glb"
    write_splats(PLAIN, path)
    document, binary = glb_parts(path)
    view = document["bufferViews"][attributes(document)[f"{NAME}:SCALE"]]
    start, end = view["byteOffset"], view["byteOffset"] + view["byteLength"]
    path.write_bytes(glb_of(document, binary[:start] + bytes(end - start) + binary[end:]))
    assert (read_splats(path).scales.exp().square() == 0).all()


def test_rotations_of_any_length(tmp_path: Path):
    columns = columns_of(PLAIN)
    for row, size in ((0, 1e30), (1, 1e-20)):
        for i in range(4):
            columns[f"rot_{i}"] = columns[f"rot_{i}"].copy()
            columns[f"rot_{i}"][row] *= np.float32(size)
    found = read_splats(write_ply(tmp_path / "a.ply", columns))
    units = [torch.nn.functional.normalize(splats.quats, dim=1) for splats in (found, PLAIN)]
    torch.testing.assert_close(*units)
