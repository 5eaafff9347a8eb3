from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from scenes import (
    NAME,
    as_gltf,
    attributes,
    changed_glb,
    extension,
    glb_of,
    glb_parts,
    random_splats,
)
from stylesplat.io.splats.splat_files import read_splats, write_splats
from stylesplat.scene.frames import Frame, move_splats
from stylesplat.scene.splats import Splats, rgb_from_sh0

COUNT = 40
HALF_TURN = torch.diag(torch.tensor([-1.0, -1.0, 1.0], dtype=torch.float64))


def some(degree: int = 1) -> Splats:
    splats = replace(random_splats(COUNT, sh_degree=degree), identities=None)
    return replace(splats, quats=torch.nn.functional.normalize(splats.quats, dim=1))


def written(folder: Path, splats: Splats | None = None) -> Path:
    path = folder / "a.glb"
    write_splats(some() if splats is None else splats, path)
    return path


def assert_same(found: Splats, expected: Splats, tolerance: float = 1e-6) -> None:
    """All but rotations as numbers, opacities as what is seen; quaternions up to their sign."""
    for name in ("means", "scales", "sh0", "shN"):
        torch.testing.assert_close(
            getattr(found, name), getattr(expected, name), atol=tolerance, rtol=tolerance
        )
    alphas = [splats.opacities.sigmoid() for splats in (found, expected)]
    torch.testing.assert_close(*alphas, atol=1e-7, rtol=0)  # float32 near 1
    cosines = (found.quats * expected.quats).sum(dim=1).abs()
    torch.testing.assert_close(cosines, torch.ones(len(found)), atol=1e-6, rtol=0)


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
@pytest.mark.parametrize("degree", range(4))
def test_what_is_written_is_read_back(tmp_path: Path, degree: int, suffix: str):
    splats, path = some(degree), tmp_path / f"a{suffix}"
    write_splats(splats, path)
    found = read_splats(path)
    assert found.sh_degree == degree
    assert_same(found, splats)
    for name in ("means", "sh0", "shN"):  # stored as they are, and not turned
        assert torch.equal(getattr(found, name), getattr(splats, name))
    assert (found.quats - splats.quats).abs().max() < 1e-6
    assert [*tmp_path.iterdir()] == [path]


def test_the_json_is_what_the_specification_says(tmp_path: Path):
    splats = some(3)
    document, binary = glb_parts(written(tmp_path, splats))
    (primitive,) = document["meshes"][0]["primitives"]
    assert document["asset"]["version"] == "2.0" and document["extensionsUsed"] == [NAME]
    assert primitive["mode"] == 0 and primitive["extensions"][NAME]["kernel"] == "ellipse"
    for name, index in primitive["attributes"].items():
        accessor, view = document["accessors"][index], document["bufferViews"][index]
        kinds = {"COLOR_0": "VEC4", f"{NAME}:ROTATION": "VEC4", f"{NAME}:OPACITY": "SCALAR"}
        assert accessor["type"] == kinds.get(name, "VEC3") and accessor["count"] == COUNT
        assert accessor["componentType"] == (5123 if name == "COLOR_0" else 5126)
        assert view["byteOffset"] % 4 == 0 and view["target"] == 34962
    assert len(primitive["attributes"]) == 5 + 16
    places = document["accessors"][primitive["attributes"]["POSITION"]]
    assert places["min"] == splats.means.amin(dim=0).tolist()
    assert document["buffers"] == [{"byteLength": len(binary)}]
    assert document["nodes"] == [{"mesh": 0, "rotation": [0.0, 0.0, 1.0, 0.0]}]


def column(path: Path, name: str) -> np.ndarray:
    """The numbers of an attribute, by hand."""
    document, binary = glb_parts(path)
    (primitive,) = document["meshes"][0]["primitives"]
    accessor = document["accessors"][primitive["attributes"][name]]
    view = document["bufferViews"][accessor["bufferView"]]
    stretch = binary[view["byteOffset"] :][: view["byteLength"]]
    return np.frombuffer(stretch, {5126: "<f4", 5123: "<u2"}[accessor["componentType"]])


def test_the_numbers_are_what_the_specification_says(tmp_path: Path):
    splats = some(2)
    path = written(tmp_path, splats)
    quats = column(path, f"{NAME}:ROTATION").reshape(COUNT, 4)
    np.testing.assert_allclose(quats[:, [3, 0, 1, 2]], splats.quats, atol=1e-6)  # xyzw
    scales = column(path, f"{NAME}:SCALE").reshape(COUNT, 3)
    np.testing.assert_allclose(scales, splats.scales.exp(), rtol=1e-6)
    np.testing.assert_allclose(column(path, f"{NAME}:OPACITY"), splats.opacities.sigmoid())
    band = column(path, f"{NAME}:SH_DEGREE_2_COEF_1").reshape(COUNT, 3)
    np.testing.assert_array_equal(band, splats.shN[:, 4])


def test_points_have_linear_colours_for_who_knows_no_splats(tmp_path: Path):
    splats = some(0)
    path = written(tmp_path, splats)
    rgba = column(path, "COLOR_0").reshape(COUNT, 4) / 65535
    shown = rgb_from_sh0(splats.sh0[:, 0]).clamp(0, 1).numpy()
    again = np.where(  # the inverse of sRGB's decoding, from its standard
        rgba[:, :3] <= 0.0031308, 12.92 * rgba[:, :3], 1.055 * rgba[:, :3] ** (1 / 2.4) - 0.055
    )
    np.testing.assert_allclose(again, shown, atol=12.92 / 65535)  # half a step, at its steepest
    np.testing.assert_allclose(rgba[:, 3], splats.opacities.sigmoid(), atol=0.5 / 65535 + 1e-7)


def turned_by(transform: dict[str, list[float]], path: Path) -> None:
    """Put the splats of a file under a node of another transform."""
    changed_glb(path, lambda d: d.update(nodes=[{"mesh": 0, **transform}]))


def test_files_of_others_have_y_up(tmp_path: Path):
    path, splats = written(tmp_path), some()
    turned_by({}, path)
    found = read_splats(path)
    assert_same(found, move_splats(splats, Frame(HALF_TURN)))
    assert torch.equal(found.means, splats.means * torch.tensor([-1.0, -1, 1]))
    assert torch.equal(found.shN.abs(), splats.shN.abs())


@pytest.mark.parametrize("degree", [0, 3])
def test_nodes_turn_scale_and_shift(tmp_path: Path, degree: int):
    splats = some(degree)
    path = written(tmp_path, splats)
    rotation = Rotation.from_euler("xyz", [20, 130, -70], degrees=True)
    above = {"rotation": rotation.as_quat().tolist(), "scale": [2.0, 2.0, 2.0], "children": [1]}
    below = {"mesh": 0, "translation": [1.0, 2.0, 3.0]}
    changed_glb(path, lambda d: d.update(nodes=[above, below]))
    turn = HALF_TURN @ torch.from_numpy(rotation.as_matrix())
    shift = 2 * turn @ torch.tensor([1.0, 2.0, 3.0]).double()
    assert_same(read_splats(path), move_splats(splats, Frame(turn, 2.0, shift)), 1e-5)
    # The same as one matrix, column by column
    matrix = np.eye(4)
    matrix[:3, :3] = 2 * rotation.as_matrix()
    matrix[:3, 3] = matrix[:3, :3] @ [1, 2, 3]
    turned_by({"matrix": matrix.T.flatten().tolist()}, path)
    assert_same(read_splats(path), move_splats(splats, Frame(turn, 2.0, shift)), 1e-5)


def test_splats_that_no_node_shows_are_found(tmp_path: Path):
    path, splats = written(tmp_path), some()
    changed_glb(path, lambda d: [d.pop(name) for name in ("nodes", "scene", "scenes")])
    assert torch.equal(read_splats(path).means[:, 2], splats.means[:, 2])


INTEGERS = {  # what the extension allows for each attribute, and what a whole number stands for
    "ROTATION": [("<i1", 5120, 127)],
    "SCALE": [("<u2", 5123, 65535), ("<u1", 5121, 0)],
    "OPACITY": [("<u1", 5121, 255)],
}


@pytest.mark.parametrize(
    ("name", "dtype", "component", "whole"),
    [(name, *kind) for name, kinds in INTEGERS.items() for kind in kinds],
)
def test_integers_are_fractions_where_the_file_says_so(
    tmp_path: Path, name: str, dtype: str, component: int, whole: int
):
    """Rows lie 4 bytes apart or more, as the format demands."""
    path, width = written(tmp_path), {"ROTATION": 4, "SCALE": 3, "OPACITY": 1}[name]
    generator = np.random.default_rng(0)
    values = generator.integers(1, np.iinfo(dtype).max, (COUNT, width)).astype(dtype)
    stride = -(-width * values.itemsize // 4) * 4
    rows = np.zeros((COUNT, stride), np.uint8)
    rows[:, : width * values.itemsize] = values.view(np.uint8).reshape(COUNT, -1)
    document, binary = glb_parts(path)
    index = document["meshes"][0]["primitives"][0]["attributes"][f"{NAME}:{name}"]
    view = {"byteOffset": len(binary), "byteLength": rows.size, "byteStride": stride}
    document["bufferViews"][index] |= view
    document["accessors"][index] |= {"componentType": component, "normalized": bool(whole)}
    document["buffers"][0]["byteLength"] += rows.size
    path.write_bytes(glb_of(document, binary + rows.tobytes()))
    found, expected = read_splats(path), torch.from_numpy(values.astype(np.float64) / (whole or 1))
    if name == "ROTATION":
        torch.testing.assert_close(found.quats, expected[:, [3, 0, 1, 2]].float())
    elif name == "SCALE":
        torch.testing.assert_close(found.scales, expected.log().float())
    else:
        torch.testing.assert_close(found.opacities, expected[:, 0].logit().float())


def with_logarithms(path: Path, splats: Splats, generator: str | None) -> None:
    """Scales as the extension's first draft had them."""
    document, binary = glb_parts(path)
    view = document["bufferViews"][attributes(document)[f"{NAME}:SCALE"]]
    start, end = view["byteOffset"], view["byteOffset"] + view["byteLength"]
    scales = splats.scales.numpy().astype("<f4").tobytes()
    document["asset"] = {"version": "2.0"} | ({"generator": generator} if generator else {})
    path.write_bytes(glb_of(document, binary[:start] + scales + binary[end:]))


@pytest.mark.parametrize("generator", ["splat-transform 2.6.0", "splat-transform v1.10.2", None])
@pytest.mark.parametrize("large", [False, True])
def test_scales_of_the_first_draft(
    tmp_path: Path, said: list[str], generator: str | None, large: bool
):
    splats = some()
    if large and generator:  # nothing but the name tells these
        splats = replace(splats, scales=splats.scales.abs())
    path = written(tmp_path, splats)
    with_logarithms(path, splats, generator)
    assert_same(read_splats(path), splats)
    assert len(said) == 1 and "logarithms of scales" in said[0]


def test_linear_scales_of_splat_transform(tmp_path: Path, said: list[str]):
    path = written(tmp_path)
    for generator in ("splat-transform 2.7.0", "splat-transform 3.2.0"):
        changed_glb(path, lambda d, name=generator: d["asset"].update(generator=name))
        assert_same(read_splats(path), some())
    assert not said


def test_the_file_says_which_draft_it_follows(tmp_path: Path):
    document, _ = glb_parts(written(tmp_path))
    assert "linear scales" in document["asset"]["extras"][NAME]


def test_buffers_in_files_beside_it(tmp_path: Path):
    path, splats = written(tmp_path), some()
    _, binary = glb_parts(path)
    (tmp_path / "my data.bin").write_bytes(binary)
    assert_same(read_splats(as_gltf(path, "my%20data.bin")), splats)


def test_other_colours_are_told(tmp_path: Path, said: list[str]):
    path = written(tmp_path)
    changed_glb(path, lambda d: extension(d).update(colorSpace="lin_rec709_display"))
    read_splats(path)
    assert len(said) == 1 and "'lin_rec709_display': they are read as srgb" in said[0]
    changed_glb(path, lambda d: extension(d).update(sortingMethod="none"))
    read_splats(path)
    assert "sorting method 'none': left out" in said.pop()
    said.pop()
    changed_glb(path, lambda d: extension(d).update(sortingMethod="cameraDistance"))
    changed_glb(path, lambda d: extension(d).update(colorSpace="srgb_rec709_display"))
    changed_glb(path, lambda d: attributes(d).update({f"{NAME}:SH_DEGREE_4_COEF_0": 0}))
    assert read_splats(path).sh_degree == 1
    assert len(said) == 2 and "left out" in said[1]
