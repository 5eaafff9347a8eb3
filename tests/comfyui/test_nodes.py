"""Each node of ComfyUI does what its verb does; COMFYUI names a checkout to run in (see `host`)."""

import json
import struct
import sys
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
import torch
from scipy.spatial.transform import Rotation

import stylesplat as ss
from balls import RED, SPLATS, dense_ball
from comfy_host import COMFYUI, FOLDER, STUBS, WIDGETS, load_nodes, prompt_of
from stylesplat.errors import StyleSplatError

Run = Callable[..., tuple]
VIEW = {"view": 0, "width": 160, "height": 120}
SELECT = {"box": "", "point": "", "size": "group", "words": "", "ids": "", "grow": 0.0}
SELECT |= {"mode": "add", **VIEW}
STYLE = {"stroke_size": 2.0, "intensity": 1.0, "form": 1.0, "color": "style", "seed": 0}
COLORS = {"saturation": 1.0, "brightness": 1.0, "contrast": 1.0, "temperature": 0.0}
COLORS |= {"tint": "", "swap": ""}
FIELDS = "positions", "scales", "rotations", "opacities", "sh"


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("ComfyUI")


@pytest.fixture(scope="module")
def nodes(root: Path) -> Iterator[dict[str, Any]]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("stylesplat.scene.virtual_cameras.VIRTUAL_VIEWS", 12)
        for name in ("STYLESPLAT_KEEP_MALLOC", "STYLESPLAT_MODELS"):  # the nodes set them
            patch.setenv(name, "")
            patch.delenv(name)
        yield load_nodes(root)
    if COMFYUI is None:
        for name in [*STUBS, "comfyui", "comfyui.nodes", "comfyui.conversion"]:
            sys.modules.pop(name)


@pytest.fixture(scope="module")
def run(nodes: dict[str, Any]) -> Run:
    @torch.inference_mode()  # as ComfyUI runs nodes
    def run(name: str, **inputs: Any) -> tuple:
        return nodes[f"StyleSplat{name}"].execute(**inputs).args

    return run


@pytest.fixture(scope="module")
def loaded(run: Run, root: Path) -> tuple:
    ss.export(ss.import_(SPLATS), root / "input" / "balls.ply", sidecar=True)
    return run("Load", file="balls.ply")


def rows_of(splat: Any, rows: slice | torch.Tensor = slice(None)) -> list[torch.Tensor]:
    return [getattr(splat, name)[0][rows] for name in FIELDS]


def on_red() -> str:
    """A pixel of the red ball in the view."""
    camera = ss.import_(SPLATS).cameras.resize(160, 120)[0]
    place = torch.cat([SPLATS.means[RED].mean(dim=0), torch.ones(1)])
    x, y, z = (camera.Ks[0] @ (camera.viewmats[0] @ place)[:3]).tolist()
    return f"{x / z:.1f}, {y / z:.1f}"


def test_a_file_becomes_a_splat_of_comfyui_and_back(loaded: tuple, run: Run):
    splat, objects = loaded
    means, quats, scales, opacities, sh = SPLATS.activated()
    expected = means, scales, quats, opacities[:, None], sh
    for found, value in zip(rows_of(splat), expected, strict=True):
        torch.testing.assert_close(found[:, : value.shape[1]], value)  # .ply has 16 bands
    assert len(ss.objects(objects)) == 3 and all(
        each.dtype == torch.float32 for each in rows_of(splat)
    )
    (path,) = run("Save", splat=splat, filename_prefix="3d/again", format="ply")
    again = ss.import_(path).base
    torch.testing.assert_close(again.scales, SPLATS.scales)
    torch.testing.assert_close(again.opacities, SPLATS.opacities)


def test_places_ids_and_names_select_what_the_verb_does(loaded: tuple, run: Run):
    splat, objects = loaded
    point, mask = run("Select", splat=splat, **{**SELECT, "point": on_red()})
    assert mask.shape == (1, 120, 160) and 0.5 < mask.max() <= 1
    assert (point & RED).sum() > RED.sum() / 2
    named, _ = run("Select", splat=splat, objects=objects, **{**SELECT, "ids": "3"})
    verb = ss.select(objects, "it", id=3).objects["it"].mask
    assert torch.equal(named, verb)
    rest, _ = run(
        "Select",
        splat=splat,
        objects=objects,
        selection=torch.ones(len(SPLATS), dtype=torch.bool),
        **{**SELECT, "ids": "3", "mode": "subtract"},
    )
    assert torch.equal(rest, ~verb)


def test_a_box_in_the_picture_selects_the_object_in_it(run: Run, root: Path):
    ss.export(ss.Splats.cat([SPLATS, dense_ball(torch.ones(1500, 3))]), root / "input" / "b.ply")
    splat, _ = run("Load", file="b.ply")
    view = {"view": 0, "width": 320, "height": 240}
    *_, mask = run("Render", splat=splat, frames=1, background="#000000", **view)
    y, x = (mask[0] > 0.9).nonzero().float().quantile(torch.tensor([0.2, 0.8]), dim=0).T
    box = f"{x[0]},{y[0]},{x[1]},{y[1]}"
    found, shown = run("Select", splat=splat, **{**SELECT, **view, "box": box})
    assert 0 < found.sum() < len(found) and shown.max() > 0.5


@pytest.mark.parametrize(
    ("inputs", "fact"),
    [
        ({"point": "3"}, "x,y"),
        ({"box": "1,2,3,many"}, "x0,y0,x1,y1"),
        ({"ids": "1", "view": 36}, "view 36"),
        ({"words": "red ball"}, "objects|labels"),
        ({"point": "80,60", "mode": "subtract"}, "subtract"),
        ({}, "Nothing is selected"),
    ],
)
def test_what_is_wrong_with_a_selection_is_said_in_one_line(
    inputs: dict[str, Any], fact: str, loaded: tuple, run: Run
):
    with pytest.raises(StyleSplatError, match=fact) as error:
        run("Select", splat=loaded[0], **{**SELECT, **inputs})
    assert "\n" not in str(error.value)


@pytest.mark.usefixtures("quick_painting")
def test_paint_and_colours_change_what_is_selected_and_no_bit_of_the_rest(loaded: tuple, run: Run):
    splat, _ = loaded
    generator = torch.Generator().manual_seed(0)
    selected = RED.clone()
    painted, rows = run(
        "Stylize",
        splat=splat,
        style=torch.rand(2, 64, 64, 4, generator=generator),
        selection=selected,
        quality="draft",
        **STYLE,
    )
    (colored,) = run("Recolor", splat=painted, selection=rows, hue=90.0, strength=1.0, **COLORS)
    count = len(SPLATS)
    assert rows[:count].equal(selected) and rows[count:].all()
    for made in (painted, colored):
        assert made.positions.shape[1] == len(rows)
        for before, after in zip(rows_of(splat, ~selected), rows_of(made), strict=True):
            assert torch.equal(after[:count][~selected], before)
        assert not torch.equal(made.sh[0, :count][selected], splat.sh[0][selected])


def test_a_colour_is_swapped_for_another(loaded: tuple, run: Run):
    colors = COLORS | {"swap": "red=teal"}
    (splat,) = run("Recolor", splat=loaded[0], hue=0.0, strength=1.0, **colors)
    (before, after) = (each.sh[0, :, 0] for each in (loaded[0], splat))
    assert (after[RED].mean(dim=0) - before[RED].mean(dim=0))[0] < -0.5, "less red"


def test_the_colours_of_a_picture_are_matched(loaded: tuple, run: Run):
    green = torch.zeros(1, 40, 40, 3)
    green[..., 1] = torch.rand(40, 40, generator=torch.Generator().manual_seed(1))
    (splat,) = run("Recolor", splat=loaded[0], match=green, hue=0.0, strength=1.0, **COLORS)
    means = splat.sh[0, :, 0].mean(dim=0)
    assert means[1] > means[0] and means[1] > means[2]


def test_a_camera_of_comfyui_sees_what_the_same_view_does(loaded: tuple, run: Run):
    splat, _ = loaded
    camera = ss.import_(SPLATS).cameras.resize(160, 120)[0]
    flip = torch.diag(torch.tensor([1.0, -1.0, -1.0]))
    x, y, z = (camera.positions[0] @ flip).tolist()
    matrix = flip @ camera.viewmats[0, :3, :3].T @ flip  # columns: right, up, back
    x_y_z_w = Rotation.from_matrix(matrix.numpy()).as_quat().tolist()
    info = {
        "position": {"x": x, "y": y, "z": z},
        "quaternion": dict(zip("xyzw", x_y_z_w, strict=True)),
        "fov": float(2 * torch.rad2deg(torch.atan(60 / camera.Ks[0, 0, 0]))),
        "zoom": 1,
        "cameraType": "perspective",
    }
    shown = {"splat": splat, "frames": 1, "background": "#336699"}
    image, mask = run("Render", **shown, **VIEW)
    seen, seen_mask = run("Render", **shown, **{**VIEW, "view": 7}, camera_info=info)
    torch.testing.assert_close(seen, image, atol=2e-3, rtol=0)
    torch.testing.assert_close(seen_mask, mask, atol=2e-3, rtol=0)
    assert image.shape == (1, 120, 160, 3) and mask.shape == (1, 120, 160)
    with pytest.raises(StyleSplatError, match="orthographic"):
        run("Render", **shown, **VIEW, camera_info={**info, "cameraType": "orthographic"})


def test_frames_are_a_batch(loaded: tuple, run: Run):
    image, mask = run("Render", splat=loaded[0], frames=3, background="white", **VIEW)
    assert image.shape == (3, 120, 160, 3) and mask.shape == (3, 120, 160)
    assert not torch.equal(image[0], image[1])


def test_a_mesh_is_a_glb_file(run: Run, root: Path):
    ss.export(dense_ball(torch.ones(1500, 3)), root / "input" / "ball.ply")
    splat, _ = run("Load", file="ball.ply")
    (file,) = run("Mesh", splat=splat, faces=400, texture_size="64")
    magic, version, length = struct.unpack_from("<4sII", file.get_bytes())
    assert (magic, version, length, file.format) == (b"glTF", 2, len(file.get_bytes()), "glb")


def test_cancel_ends_the_node_and_the_next_prompt_runs(loaded: tuple, run: Run):
    management: Any = import_module("comfy.model_management")
    shown = {"splat": loaded[0], "frames": 2, "background": "#000000", **VIEW}
    management.interrupt_current_processing()
    with pytest.raises(management.InterruptProcessingException):
        run("Render", **shown)
    image, _ = run("Render", **shown)
    assert len(image) == 2


def test_a_bar_shows_how_far_the_work_is(loaded: tuple, run: Run, monkeypatch: pytest.MonkeyPatch):
    shown = []

    class Bar:
        def __init__(self, total: float) -> None:
            self.total, self.current = total, 0.0

        def update(self, value: float) -> None:
            self.current += value
            shown.append((self.current, self.total))

    monkeypatch.setattr(import_module("comfy.utils"), "ProgressBar", Bar)
    run("Render", splat=loaded[0], frames=3, background="#000000", **VIEW)
    assert shown[-3:] == [(1, 3), (2, 3), (3, 3)]


def test_a_batch_of_splats_and_a_selection_of_another_splat_are_refused(loaded: tuple, run: Run):
    splat, _ = loaded
    fields = (torch.cat([getattr(splat, name)] * 2) for name in FIELDS)
    with pytest.raises(StyleSplatError, match="batch of 2"):
        run("Save", splat=type(splat)(*fields), filename_prefix="x", format="ply")
    padded = [torch.cat([getattr(splat, name)] * 2, dim=1) for name in FIELDS]
    some = type(splat)(*padded, counts=torch.tensor([len(SPLATS)]))
    image = [
        run("Render", splat=each, frames=1, background="#000000", **VIEW)[0]
        for each in (some, splat)
    ]
    assert torch.equal(*image)
    more = torch.ones(len(SPLATS) + 1, dtype=torch.bool)
    with pytest.raises(StyleSplatError, match="Select in this splat"):
        run("Recolor", splat=splat, selection=more, hue=9.0, strength=1.0, **COLORS)


WORKFLOWS = sorted((FOLDER / "example_workflows").glob("*.json"))


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.stem)
def test_workflows_have_the_nodes_inputs_and_values_that_there_are(
    path: Path, nodes: dict[str, Any]
):
    workflow = json.loads(path.read_text())
    by_id = {node["id"]: node for node in workflow["nodes"]}
    assert {node["type"] for node in workflow["nodes"]} <= {*nodes, *WIDGETS}
    for _, source, slot, target, place, kind in workflow["links"]:
        assert by_id[source]["outputs"][slot]["type"] == kind
        assert by_id[target]["inputs"][place]["type"] == kind
    for node in workflow["nodes"]:
        if node["type"] in nodes:
            schema = nodes[node["type"]].define_schema()
            ports = {each.id for each in schema.inputs}
            assert {each["name"] for each in node["inputs"]} <= ports
            names = [each.display_name for each in schema.outputs]
            assert [each["name"] for each in node["outputs"]] == names
    assert len(prompt_of(workflow, nodes)) == len(by_id)
    assert path.with_suffix(".jpg").is_file()  # ComfyUI shows it in its list of templates
