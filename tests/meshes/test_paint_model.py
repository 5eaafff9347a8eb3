"""Other people's meshes, painted in their textures: what changes, and what stays."""

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import trimesh
from PIL import Image

import stylesplat as ss
from glb_models import png, write_model_glb
from scenes import changed_glb, glb_of, glb_parts, random_splats
from stylesplat.errors import StyleSplatError
from stylesplat.io.models.model import base_colors, displayed
from stylesplat.io.models.model_files import read_model, write_model
from stylesplat.io.splats.gltf_file import open_gltf
from stylesplat.io.splats.splat_files import write_splats
from stylesplat.meshes.paint_model import in_unit_ball, lay_out, sample_discs
from stylesplat.meshes.surface import cameras_all_around
from stylesplat.scene.splats import rgb_from_sh0

SIZE = 128  # of textures
QUICK: dict[str, Any] = {"quality": "draft", "steps": 2}


@pytest.fixture
def picture(tmp_path: Path) -> Path:
    path = tmp_path / "wave.png"
    noise = np.random.default_rng(0).integers(0, 255, (48, 48, 3), np.uint8)
    Image.fromarray(noise).save(path)
    return path


def texture_of(document: Any, binary: bytes, material: int) -> np.ndarray:
    info = document["materials"][material]["pbrMetallicRoughness"]["baseColorTexture"]
    image = document["images"][document["textures"][info["index"]]["source"]]
    view = document["bufferViews"][image["bufferView"]]
    content = binary[view["byteOffset"] :][: view["byteLength"]]
    return np.asarray(Image.open(io.BytesIO(content)).convert("RGB"))


def test_discs_lie_on_the_surface_in_its_colours(tmp_path: Path):
    parts = read_model(write_model_glb(tmp_path)).parts
    places = in_unit_ball(parts)
    discs = sample_discs(parts, places, texture_size=SIZE, seed=0)
    assert 300 < len(discs) <= SIZE**2 // 8
    assert discs.means.norm(dim=1).max() <= 1 + 1e-5
    colors = rgb_from_sh0(discs.sh0[:, 0])
    is_red = colors[:, 0] > 0.5
    assert torch.allclose(colors[is_red], torch.tensor([1.0, 0, 0]), atol=0.02)
    assert torch.allclose(colors[~is_red], torch.tensor([0, 1.0, 0]), atol=0.02)
    share = is_red.float().mean()  # the red ball is twice as large
    assert abs(share - 0.8) < 0.03
    # glTF's x goes to the right; ours to the left, as the world is turned by half about z
    assert discs.means[is_red, 0].mean() > discs.means[~is_red, 0].mean()


def test_a_mesh_is_looked_at_from_all_sides(tmp_path: Path):
    parts = read_model(write_model_glb(tmp_path)).parts
    discs = sample_discs(parts, in_unit_ball(parts), texture_size=SIZE, seed=0)
    cameras = cameras_all_around(discs, length=64)
    outward = torch.nn.functional.normalize(cameras.positions, dim=1)
    sides = torch.cat([torch.eye(3), -torch.eye(3)])
    assert ((sides @ outward.T).amax(dim=1) > 0.9).all()


def test_painting_changes_base_colours_alone(tmp_path: Path, picture: Path):
    path, output = write_model_glb(tmp_path), tmp_path / "painted.glb"
    found = ss.stylize_mesh(path, ss.Style(picture, **QUICK), output, texture_size=SIZE)
    assert found["pictures"] == [SIZE, SIZE] and found["faces"] > found["unwrapped"] > 0
    (before, old), (after, new) = glb_parts(path), glb_parts(output)
    assert new[: len(old)] == old  # all bytes stay, others follow
    for key in ("asset", "nodes", "scenes", "skins", "samplers", "extensions", "extensionsUsed"):
        assert after[key] == before[key]
    for key in ("images", "textures", "accessors", "bufferViews", "materials"):
        assert len(after[key]) >= len(before[key])
    for key in ("images", "textures", "accessors", "bufferViews"):
        assert after[key][: len(before[key])] == before[key]
    red, green = after["materials"]
    assert red["normalTexture"] == {"index": 1} and red["name"] == "red paint"
    assert red["pbrMetallicRoughness"]["roughnessFactor"] == 0.4
    assert green["pbrMetallicRoughness"]["baseColorFactor"] == [1, 1, 1, 1]
    assert after["meshes"][0] == before["meshes"][0]  # it keeps its UVs
    for material, color in ((0, (255, 0, 0)), (1, (0, 255, 0))):
        texture = texture_of(after, new, material)
        assert texture.shape == (SIZE, SIZE, 3) and texture.std() > 5
        assert np.abs(texture.astype(int) - color).mean() > 20
    loaded = trimesh.load_scene(output)
    assert sum(len(each.faces) for each in loaded.geometry.values()) == found["faces"]


def repainted(
    source: Path,
    output: Path,
    names: tuple[str, ...] = (),
    size: int = SIZE,
    *,
    seed: int = 0,
    overwrite: bool = False,
) -> int:
    """Write a mesh with noise in the place of paint; returns how many faces got new UVs."""
    found = read_model(source)
    parts = [part for part in found.parts if not names or {*names} & {*part.names}]
    layout = lay_out(parts, in_unit_ball(parts), size)
    noise = np.random.default_rng(seed).random(layout.mesh.texture.shape, np.float32)
    write_model(found, layout.parts, layout.pictures(noise), output, overwrite=overwrite)
    return sum(len(each.part.faces) for each in layout.parts if each.unwrapped is not None)


def test_new_uvs_show_each_place_of_the_surface_once(tmp_path: Path):
    path, output = write_model_glb(tmp_path, shared_uvs=True), tmp_path / "painted.glb"
    assert repainted(path, output, ("red paint",)) == len(read_model(path).parts[0].faces)
    (given, _), (document, _) = glb_parts(path), glb_parts(output)
    (primitive,) = document["meshes"][0]["primitives"]
    info = document["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]
    assert info["texCoord"] == 1 and {"TEXCOORD_0", "TEXCOORD_1"} <= {*primitive["attributes"]}
    assert document["materials"][0]["normalTexture"] == {"index": 1}  # at the UVs it had
    assert document["materials"][1] == given["materials"][1]  # which has no paint
    assert document["meshes"][1] == given["meshes"][1]
    before, after = (read_model(each).parts[0] for each in (path, output))
    for one, other in zip(before.vertices[before.faces], after.vertices[after.faces], strict=True):
        assert np.array_equal(one, other)  # the same faces, in their order
    layout = lay_out([after], in_unit_ball([after]), SIZE)
    assert layout.parts[0].unwrapped is None


def corners(path: Path, name: str, *, target: bool = False) -> np.ndarray:
    """An attribute of the second ball, at the corners of its faces."""
    gltf = open_gltf(path)
    document, _ = glb_parts(path)
    (primitive,) = document["meshes"][1]["primitives"]
    index = (primitive["targets"][0] if target else primitive["attributes"])[name]
    rows = gltf.stored(index, name)
    if "indices" not in primitive:
        return rows
    return rows[gltf.stored(primitive["indices"], "indices")[:, 0]]


def test_a_glb_without_scenes_shows_all_that_no_node_holds(tmp_path: Path):
    path = write_model_glb(tmp_path)
    before = read_model(path).parts
    changed_glb(path, lambda d: d["nodes"].append({"name": "both", "children": [0, 1]}))
    changed_glb(path, lambda d: [d.pop(name) for name in ("scene", "scenes")])
    for found, part in zip(read_model(path).parts, before, strict=True):
        assert found.names == ("both", *part.names)
        assert np.array_equal(found.vertices, part.vertices)


def test_bones_and_morphs_follow_vertices_that_are_split(tmp_path: Path):
    path, output = write_model_glb(tmp_path), tmp_path / "painted.glb"
    assert repainted(path, output, ("right",)) > 0
    for name in ("POSITION", "NORMAL", "JOINTS_0", "WEIGHTS_0"):
        before, after = corners(path, name), corners(output, name)
        assert before.dtype == after.dtype and np.array_equal(before, after), name
    before, after = (corners(each, "POSITION", target=True) for each in (path, output))
    assert np.array_equal(before, after)


def test_ply_and_obj_are_read(tmp_path: Path):
    ball = trimesh.creation.icosphere(subdivisions=1)
    orange = np.tile([255, 128, 0, 255], (len(ball.vertices), 1))
    ball = trimesh.Trimesh(ball.vertices, ball.faces, vertex_colors=orange)
    ball.export(tmp_path / "a.ply")
    (part,) = read_model(tmp_path / "a.ply").parts
    assert part.faces.shape == (80, 3) and part.uvs is None
    weights = np.full((80, 3), 1 / 3)
    color = base_colors(part, np.arange(80), weights)
    assert color.shape == (80, 3)
    assert displayed(np.array([[0.0, 0.5, 1.0]]))[0, 1] == pytest.approx(0.735, abs=1e-3)
    (tmp_path / "b.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 4 3\n")
    assert sum(len(part.faces) for part in read_model(tmp_path / "b.obj").parts) == 2


def test_an_obj_reads_files_of_its_own_folder_alone(tmp_path: Path, said: list[str]):
    folder, text = tmp_path / "inner", "newmtl a\nKd 1 0 0\nmap_Kd a.png\n"
    folder.mkdir()
    for place in (folder, tmp_path):
        (place / "a.mtl").write_text(text)
        (place / "a.png").write_bytes(png((0, 0, 255)))
    shape = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl a\nf 1/1 2/2 3/3\n"
    (folder / "in.obj").write_text("mtllib a.mtl\n" + shape)
    (folder / "out.obj").write_text("mtllib ../a.mtl\n" + shape)
    (inside,), (outside,) = (read_model(folder / f"{each}.obj").parts for each in ("in", "out"))
    assert inside.picture is not None and inside.picture[0, 0].tolist() == [0, 0, 255, 255]
    assert outside.picture is None or (outside.picture[..., 2] < 255).all()  # trimesh's own grey
    assert len(said) == 1 and "../a.mtl" in said[0]
    (folder / "a.mtl").write_text("newmtl a\nmap_Kd none.png\n")
    read_model(folder / "in.obj")
    assert len(said) == 2 and "'none.png', which is not in its folder" in said[1]


MATERIAL = """# by hand
newmtl wood
Ns 8
Kd 0.5 0.5 0.5
map_Kd wood.png
map_Bump -bm 0.5 textures\\bent.png
map_Pr rough.png
map_Ks shine.png
illum 2

newmtl glass
Kd 0 1 0
d 0.25
"""
SQUARE = "v 0 0 {0}\nv 1 0 {0}\nv 1 1 {0}\nv 0 1 {0}\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
QUADS = f"""# two squares
mtllib two.mtl
{SQUARE.format(0)}o table
g top
usemtl wood
s off
f 1/1 2/2 3/3 4/4
{SQUARE.format(1)}usemtl glass
f 5/5 6/6 7/7 8/8
"""


def two_squares(folder: Path) -> Path:
    (folder / "textures").mkdir(parents=True)
    (folder / "two.obj").write_text(QUADS)
    (folder / "two.mtl").write_text(MATERIAL)
    for name, color in (
        ("wood.png", (200, 150, 90)),
        ("textures/bent.png", (128, 128, 255)),
        ("rough.png", (64, 64, 64)),
        ("shine.png", (9, 9, 9)),
    ):
        (folder / name).write_bytes(png(color))
    return folder / "two.obj"


def test_only_base_colours_of_an_obj_change(tmp_path: Path, said: list[str]):
    path, output = two_squares(tmp_path / "from"), tmp_path / "to" / "painted.obj"
    output.parent.mkdir()
    assert repainted(path, output, ("wood",), size=64) == 0
    assert output.read_text() == QUADS.replace("two.mtl", "painted.mtl")
    before = MATERIAL.replace("Kd 0.5 0.5 0.5\nmap_Kd wood.png\n", "")
    before = before.replace("newmtl wood\n", "newmtl wood\nKd 1 1 1\nmap_Kd painted-paint-0.png\n")
    before = before.replace("textures\\bent.png", "textures/bent.png")
    for name in ("textures/bent.png", "rough.png", "shine.png"):
        own = "painted-" + name.replace("/", "-")
        before = before.replace(name, own)
        assert (output.parent / own).read_bytes() == (path.parent / name).read_bytes()
    assert output.with_suffix(".mtl").read_text() == before
    wood = next(part for part in read_model(output).parts if "wood" in part.names)
    assert wood.picture is not None and wood.picture.shape == (64, 64, 4) and not said
    beside = path.with_name("beside.obj")  # where the other maps are they need no copy
    repainted(path, beside, ("wood",), size=64)
    assert "map_Pr rough.png" in beside.with_suffix(".mtl").read_text()


def pictures(path: Path) -> dict[str, np.ndarray]:
    """The pictures of a model's materials."""
    parts = read_model(path).parts
    return {part.names[-1]: part.picture for part in parts if part.picture is not None}


def test_painting_an_obj_replaces_no_other_file(tmp_path: Path):
    path, output = two_squares(tmp_path / "from"), tmp_path / "to" / "painted.obj"
    output.parent.mkdir()
    for name in ("painted-rough.png", "painted-paint-0.png"):
        (output.parent / name).write_text("somebody's")
    repainted(path, output, ("wood",), size=64)
    for name in ("painted-rough.png", "painted-paint-0.png"):
        assert (output.parent / name).read_text() == "somebody's"
    first = pictures(output)
    assert first["wood"].shape == (64, 64, 4)
    # painted again in its place: what it goes on using has the names that new pictures would have
    repainted(output, output, ("glass",), size=64, seed=1, overwrite=True)
    again = pictures(output)
    assert np.array_equal(again["wood"], first["wood"])
    assert not np.array_equal(again["glass"], again["wood"])
    before = {each: each.read_bytes() for each in path.parent.rglob("*.*")}
    path.rename(other := path.with_name("other.obj"))  # whose materials have the output's name
    repainted(other, path, ("wood",), size=64, overwrite=True)
    assert all(each.read_bytes() == before[each] for each in before if each != path)
    assert pictures(path)["wood"].shape == (64, 64, 4)


def test_an_obj_may_have_several_libraries(tmp_path: Path, said: list[str]):
    path, output = two_squares(tmp_path / "from"), tmp_path / "to" / "painted.obj"
    output.parent.mkdir()
    wood, glass = MATERIAL.split("\n\n")
    (path.parent / "two.mtl").write_text(wood)
    glass = glass + "map_Kd green.png\nmap_Pr ../rough.png\n"
    (path.parent / "textures" / "a glass.mtl").write_bytes(glass.replace("\n", "\r\n").encode())
    (path.parent / "textures" / "green.png").write_bytes(png((0, 255, 0)))
    text = QUADS.replace("two.mtl\n", "two.mtl\nmtllib textures\\a glass.mtl\n")
    path.write_bytes(text.replace("\n", "\r\n").encode())
    assert pictures(path)["glass"][0, 0].tolist() == [0, 255, 0, 255]
    repainted(path, output, ("wood",), size=64)
    written = QUADS.replace("two.mtl", "painted.mtl").replace("\n", "\r\n")
    assert output.read_bytes() == written.encode()
    assert pictures(output)["glass"][0, 0].tolist() == [0, 255, 0, 255] and not said
    named = QUADS.replace("two.mtl", "two.mtl none.mtl")
    path.write_text(named)
    assert "wood" in pictures(path) and "'none.mtl', which is not in its folder" in said[0]


def test_corners_of_an_obj_may_count_back(tmp_path: Path):
    last = "f -4/-4 -3/-3 -2/-2 -1/-1"
    (tmp_path / "a.obj").write_text(f"{SQUARE.format(0)}{last}\n{SQUARE.format(1)}{last}\n")
    (part,) = read_model(tmp_path / "a.obj").parts
    heights = part.vertices[part.faces][..., 2]
    assert sorted(heights[:, 0]) == [0, 0, 1, 1] and (heights == heights[:, :1]).all()
    (tmp_path / "a.obj").write_text(f"{SQUARE.format(0)}f -5 -4 -3\n")
    with pytest.raises(StyleSplatError, match="counts back 5 v, of 4"):
        read_model(tmp_path / "a.obj")


def test_names_of_an_obj_in_latin_1_stay(tmp_path: Path):
    path, output = two_squares(tmp_path / "from"), tmp_path / "painted.obj"
    path.write_bytes(QUADS.replace("wood", "bl\xe4tter").encode("latin-1"))
    path.with_suffix(".mtl").write_bytes(
        MATERIAL.replace("newmtl wood", "newmtl bl\xe4tter").encode("latin-1")
    )
    assert repainted(path, output, ("bl\xe4tter",), size=64) == 0
    assert b"newmtl bl\xe4tter\nKd 1 1 1" in output.with_suffix(".mtl").read_bytes()
    assert pictures(output)["bl\xe4tter"].shape == (64, 64, 4)


def test_a_damaged_picture_of_an_obj_is_named(tmp_path: Path):
    path = two_squares(tmp_path)
    (tmp_path / "wood.png").write_text("no picture")
    with pytest.raises(StyleSplatError, match=r"wood\.png"):
        read_model(path)


def test_a_glb_of_an_obj_has_its_maps(tmp_path: Path, said: list[str]):
    output = tmp_path / "painted.glb"
    repainted(two_squares(tmp_path / "from"), output, ("wood",), size=64)
    document, _ = glb_parts(output)
    wood, glass = sorted(document["materials"], key=lambda each: each["name"], reverse=True)
    assert {"normalTexture", "name"} <= {*wood} and wood["name"] == "wood"
    assert "metallicRoughnessTexture" in wood["pbrMetallicRoughness"]
    assert glass["alphaMode"] == "BLEND"
    assert glass["pbrMetallicRoughness"]["metallicFactor"] == 0
    assert glass["pbrMetallicRoughness"]["baseColorFactor"][3] == pytest.approx(0.25, abs=0.01)
    assert said == [f"{output} is without the maps map_ks of its materials."]


def test_an_obj_gets_its_material_and_picture(tmp_path: Path, picture: Path):
    trimesh.creation.box().export(tmp_path / "box.ply")
    output = tmp_path / "painted.obj"
    assert repainted(tmp_path / "box.ply", output, size=64) == 12
    (own,) = tmp_path.glob("painted-*.png")
    assert f"map_Kd {own.name}" in output.with_suffix(".mtl").read_text()
    again: Any = trimesh.load_mesh(output)
    texture = np.asarray(again.visual.material.image.convert("RGB"))
    assert texture.shape == (64, 64, 3) and texture.std() > 5
    assert len(again.faces) == 12 and len(again.visual.uv) == len(again.vertices)
    output.unlink()  # what lies beside is not replaced either
    with pytest.raises(StyleSplatError, match=r"painted\.mtl exists"):
        ss.stylize_mesh(tmp_path / "box.ply", picture, tmp_path / "painted.obj")


def no_faces(folder: Path) -> Path:
    (folder / "points.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n"
        "property float z\nend_header\n0 0 0\n"
    )
    return folder / "points.ply"


def splats_in(name: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        write_splats(random_splats(5), folder / name)
        return folder / name

    return make


def text_for_glb(folder: Path) -> Path:
    (folder / "text.glb").write_text("hello")
    return folder / "text.glb"


def without(folder: Path, key: str) -> Path:
    document, binary = glb_parts(write_model_glb(folder))
    document.pop(key)
    (folder / "bad.glb").write_bytes(glb_of(document, binary))
    return folder / "bad.glb"


def changed(folder: Path, **values: Any) -> Path:
    document, binary = glb_parts(write_model_glb(folder))
    (folder / "bad.glb").write_bytes(glb_of(document | values, binary))
    return folder / "bad.glb"


BAD = {
    "a cloud of points": (no_faces, "no faces"),
    "splats": (splats_in("splats.glb"), "stylesplat import"),
    "splats in a PLY": (splats_in("splats.ply"), "stylesplat import"),
    "compressed splats": (splats_in("splats.compressed.ply"), "stylesplat import"),
    "no buffers": (lambda folder: without(folder, "buffers"), "it has no 'buffers'"),
    "no GLB": (text_for_glb, "does not begin as a GLB"),
    "no meshes": (lambda folder: changed(folder, nodes=[{"name": "a"}, {"name": "b"}]), "no faces"),
    "compression": (
        lambda folder: changed(folder, extensionsUsed=["KHR_draco_mesh_compression"]),
        "KHR_draco",
    ),
    "another suffix": (lambda folder: folder / "a.fbx", ".fbx"),
    "nothing": (lambda folder: folder / "a.glb", "no mesh"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_cannot_be_painted_is_refused_in_one_line(tmp_path: Path, picture: Path, name: str):
    make, fact = BAD[name]
    path = make(tmp_path)
    with pytest.raises(StyleSplatError) as error:
        ss.stylize_mesh(path, picture, tmp_path / "painted.glb")
    assert fact in str(error.value) and path.name in str(error.value)
    assert not (tmp_path / "painted.glb").exists()


def test_names_that_mean_nothing_are_refused(tmp_path: Path, picture: Path):
    path = write_model_glb(tmp_path)
    with pytest.raises(StyleSplatError, match="red paint"):
        ss.stylize_mesh(path, {"blue": picture}, tmp_path / "a.glb")
    with pytest.raises(StyleSplatError, match="same faces"):
        ss.stylize_mesh(path, {"left": picture, "red paint": picture}, tmp_path / "a.glb")
    with pytest.raises(StyleSplatError, match=r"\.glb"):
        ss.stylize_mesh(path, picture, tmp_path / "a.obj")
