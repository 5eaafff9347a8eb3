"""The nodes: each calls one verb of StyleSplat."""

import logging
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

import comfy.model_management
import comfy.utils
import folder_paths
import torch
from comfy_api.latest import Types, io
from PIL import Image
from torch import Tensor

import stylesplat as ss
from stylesplat.functional import coverage, rasterize
from stylesplat.io.kinds import SPLATS
from stylesplat.meshes.mesh_config import MeshConfig
from stylesplat.progress import Observer, observed, track
from stylesplat.stylization.config import parse_color

from .conversion import (
    painted_splat,
    pictures_of,
    selection_for,
    splat_of,
    splats_of,
    with_views,
)

CATEGORY = "StyleSplat"
FORMATS = ("ply", "compressed.ply", "spz", "sog", "splat", "glb", "html")
SIDECAR = ".objects.npz"  # of `export --sidecar`: what the objects of a file are
WIDTH, HEIGHT = 960, 720
NAME, BEFORE = "selection", "before"  # of objects within a node

Objects = io.Custom("SPLAT_OBJECTS")  # a Scene: label ids and named objects of a splat
Selection = io.Custom("SPLAT_SELECTION")  # [N] bool: rows of a splat; later ones are not selected
Splat = io.Custom("SPLAT")


class Progress(Observer):
    """ComfyUI's progress bar, and its Cancel: where work advances a cancelled prompt ends."""

    def __init__(self) -> None:
        self.bar: comfy.utils.ProgressBar | None = None

    @contextmanager
    def task(self, what: str, total: float | None, unit: str, done: float) -> Iterator["Progress"]:
        """Shows a bar of its own for the work that begins."""
        comfy.model_management.throw_exception_if_processing_interrupted()
        outer, self.bar = self.bar, comfy.utils.ProgressBar(total) if total else None
        self.advance(done)
        try:
            yield self
        finally:
            self.bar = outer

    def advance(self, amount: float = 1) -> None:
        """Raises ComfyUI's own exception if the prompt was cancelled."""
        comfy.model_management.throw_exception_if_processing_interrupted()
        if self.bar is not None:
            self.bar.update(amount)

    def say(self, line: str) -> None:
        """Into ComfyUI's log."""
        logging.info("StyleSplat: %s", line)


def view_inputs() -> list:
    """What says from where: pixels of selections are those of pictures rendered so."""
    return [
        io.Int.Input(
            "view", default=0, min=0, max=35, tooltip="Views all around; each fourth is a close-up."
        ),
        io.Int.Input("width", default=WIDTH, min=64, max=4096),
        io.Int.Input("height", default=HEIGHT, min=64, max=4096),
        io.Load3DCamera.Input("camera_info", optional=True, tooltip="Replaces the view."),
    ]


def numbers(text: str, what: str, count: int) -> tuple[float, ...]:
    """The numbers of a box or a point. Raises a StyleSplatError for anything else."""
    try:
        found = tuple(float(each) for each in text.replace(",", " ").split())
    except ValueError:
        found = ()
    if len(found) != count:
        raise ss.StyleSplatError(f"Cannot read the {what} {text!r}. Write {count} numbers: {what}.")
    return found


def scene_of(splat: Any, selection: Tensor | None = None) -> ss.Scene:
    """A scene with a selection as its object."""
    scene = ss.import_(splats_of(splat))
    rows = selection_for(selection, len(scene.base))
    return ss.select(scene, NAME, rows=rows)


class LoadSplat(io.ComfyNode):
    """A file of the input folder."""

    @classmethod
    def define_schema(cls) -> io.Schema:
        """Inputs and outputs."""
        folder = Path(folder_paths.get_input_directory())
        files = sorted(
            each.relative_to(folder).as_posix()
            for each in folder.rglob("*")
            if each.suffix.lower() in SPLATS
        )
        return io.Schema(
            node_id="StyleSplatLoad",
            display_name="Load Splat (StyleSplat)",
            category=CATEGORY,
            description="PLY, compressed PLY, SPZ, .splat, .ksplat, SOG, glTF, USD, a checkpoint.",
            inputs=[io.Combo.Input("file", options=files, upload=io.UploadType.model)],
            outputs=[
                Splat.Output(display_name="splat"),
                Objects.Output(
                    display_name="objects",
                    tooltip=f"Label ids and names, if a {SIDECAR} lies beside the file.",
                ),
            ],
        )

    @classmethod
    def fingerprint_inputs(cls, file: str) -> float:
        """Changes when the file does."""
        return Path(folder_paths.get_annotated_filepath(file)).stat().st_mtime

    @classmethod
    def validate_inputs(cls, file: str) -> bool | str:
        """Also takes files that came after the list was made."""
        return folder_paths.exists_annotated_filepath(file) or f"There is no file {file}."

    @classmethod
    def execute(cls, file: str) -> io.NodeOutput:
        """Calls `import_`."""
        path = Path(folder_paths.get_annotated_filepath(file))
        beside = path.with_name(path.name + SIDECAR)
        with observed(Progress()):
            scene = ss.import_(path, labels=beside if beside.is_file() else None)
        return io.NodeOutput(splat_of(scene.base), scene)


class SelectSplat(io.ComfyNode):
    """Rows of a splat by places in a view, words, or label ids."""

    @classmethod
    def define_schema(cls) -> io.Schema:
        """Inputs and outputs."""
        return io.Schema(
            node_id="StyleSplatSelect",
            display_name="Select in Splat (StyleSplat)",
            category=CATEGORY,
            description="What is given is united: a box, a point, words, ids.",
            inputs=[
                Splat.Input("splat"),
                io.String.Input("box", default="", tooltip="x0,y0,x1,y1 in pixels of the view"),
                io.String.Input("point", default="", tooltip="x,y in pixels of the view"),
                io.Combo.Input(
                    "size", options=["object", "part", "group"], tooltip="What a point means."
                ),
                io.String.Input("words", default="", tooltip="Needs objects with label ids."),
                io.String.Input("ids", default="", tooltip="Label ids or names of the objects."),
                io.Float.Input("grow", default=0.0, min=-0.5, max=0.5, step=0.01),
                io.Combo.Input("mode", options=["add", "subtract"], tooltip="From the selection."),
                *view_inputs(),
                Objects.Input("objects", optional=True),
                Selection.Input("selection", optional=True),
            ],
            outputs=[
                Selection.Output(display_name="selection"),
                io.Mask.Output(display_name="mask", tooltip="Where it shows in the view."),
            ],
        )

    @classmethod
    def execute(
        cls,
        splat: Any,
        box: str,
        point: str,
        size: str,
        words: str,
        ids: str,
        grow: float,
        mode: str,
        view: int,
        width: int,
        height: int,
        camera_info: dict | None = None,
        objects: ss.Scene | None = None,
        selection: Tensor | None = None,
    ) -> io.NodeOutput:
        """Calls `mask` for a box, and `select`."""
        if mode == "subtract" and selection is None:
            raise ss.StyleSplatError("Nothing to subtract from. Connect a selection.")
        with observed(Progress()):
            count = len(item := splats_of(splat))
            scene = ss.import_(item) if objects is None else objects
            scene, name = with_views(scene, (width, height), view, camera_info)
            places: dict[str, Any] = {}
            if point:
                places |= {"point": (name, *numbers(point, "x,y", 2)), "size": size}
            if words:
                places["text"] = words
            named = [each for each in ids.replace(",", " ").split() if each]
            places["id"] = [int(each) for each in named if each.isdigit()]
            places["plus"] = [each for each in named if not each.isdigit()]
            if box:
                pixels = numbers(box, "x0,y0,x1,y1", 4)
                scene = ss.mask(scene, boxes={BEFORE: (name, *pixels)})
                places["plus"] = [*places["plus"], BEFORE]
            if grow:
                places["grow" if grow > 0 else "shrink"] = abs(grow)
            scene = ss.select(scene, NAME, **{key: each for key, each in places.items() if each})
            found = selection_for(scene.objects[NAME].mask.cpu(), count)
            if selection is not None:
                before = selection_for(selection, count)
                found = before | found if mode == "add" else before & ~found
            shown = coverage(item, scene.cameras[scene.cameras.index(name)], found)
        return io.NodeOutput(found, shown[None])


class StylizeSplat(io.ComfyNode):
    """Paint in the style of pictures."""

    @classmethod
    def define_schema(cls) -> io.Schema:
        """Inputs and outputs."""
        return io.Schema(
            node_id="StyleSplatStylize",
            display_name="Stylize Splat (StyleSplat)",
            category=CATEGORY,
            description="Repaints what is selected; the other Gaussians stay, to the bit.",
            inputs=[
                Splat.Input("splat"),
                io.Image.Input("style", tooltip="A batch is several pictures of one style."),
                io.Float.Input("stroke_size", default=2.0, min=0.1, max=20.0, step=0.1),
                io.Float.Input("intensity", default=1.0, min=0.0, max=1.5, step=0.05),
                io.Float.Input("form", default=1.0, min=0.0, max=1.5, step=0.05),
                io.Combo.Input("color", options=["style", "keep", "blend", "free"]),
                io.Combo.Input("quality", options=["normal", "draft", "high"]),
                io.Int.Input("seed", default=0, max=2**31 - 1, control_after_generate=True),
                Selection.Input("selection", optional=True, tooltip="All without one."),
            ],
            outputs=[
                Splat.Output(display_name="splat"),
                Selection.Output(
                    display_name="selection", tooltip="With the new Gaussians of the paint."
                ),
            ],
        )

    @classmethod
    def execute(
        cls, splat: Any, style: Tensor, selection: Tensor | None = None, **settings: Any
    ) -> io.NodeOutput:
        """Calls `stylize`."""
        settings["scale"] = settings.pop("stroke_size")
        with observed(Progress()):
            scene = scene_of(splat, selection)
            paint = ss.Style(*pictures_of(style), **settings)
            done = ss.stylize(scene, {NAME: paint}, measured=False)
        rows = done.to_splats(done.objects[NAME].mask).cpu()
        return io.NodeOutput(painted_splat(splat, scene.base, done.splats), rows)


class RecolorSplat(io.ComfyNode):
    """Other colours, in closed form."""

    @classmethod
    def define_schema(cls) -> io.Schema:
        """Inputs and outputs."""
        return io.Schema(
            node_id="StyleSplatRecolor",
            display_name="Recolor Splat (StyleSplat)",
            category=CATEGORY,
            inputs=[
                Splat.Input("splat"),
                io.Float.Input("hue", default=0.0, min=-180.0, max=180.0, step=1.0),
                io.Float.Input("saturation", default=1.0, min=0.0, max=4.0, step=0.05),
                io.Float.Input("brightness", default=1.0, min=0.0, max=4.0, step=0.05),
                io.Float.Input("contrast", default=1.0, min=0.0, max=4.0, step=0.05),
                io.Float.Input("temperature", default=0.0, min=-1.0, max=1.0, step=0.05),
                io.String.Input("tint", default="", tooltip="#rrggbb or the name of a colour"),
                io.String.Input(
                    "swap",
                    default="",
                    tooltip="Main colours that become others, shades and highlights kept: "
                    "#a02020=teal, gold=silver",
                ),
                io.Float.Input("strength", default=1.0, min=0.0, max=1.5, step=0.05),
                Selection.Input("selection", optional=True, tooltip="All without one."),
                io.Image.Input("match", optional=True, tooltip="Takes the colours of a picture."),
            ],
            outputs=[Splat.Output(display_name="splat")],
        )

    @classmethod
    def execute(
        cls,
        splat: Any,
        tint: str,
        swap: str,
        selection: Tensor | None = None,
        match: Tensor | None = None,
        **settings: float,
    ) -> io.NodeOutput:
        """Calls `recolor`."""
        with observed(Progress()), tempfile.TemporaryDirectory() as folder:
            swaps = tuple(swap.replace(",", " ").split())
            given: dict[str, Any] = {**settings, "tint": tint or None, "swap": swaps}
            if match is not None:
                pixels = (255 * pictures_of(match)[0]).round().byte().numpy()
                given["match"] = Path(folder) / "match.png"
                Image.fromarray(pixels).save(given["match"])
            scene = scene_of(splat, selection)
            done = ss.recolor(scene, NAME, **given)
        return io.NodeOutput(painted_splat(splat, scene.base, done.splats))


class RenderSplat(io.ComfyNode):
    """Pictures of a splat."""

    @classmethod
    def define_schema(cls) -> io.Schema:
        """Inputs and outputs."""
        return io.Schema(
            node_id="StyleSplatRender",
            display_name="Render Splat (StyleSplat)",
            category=CATEGORY,
            description="All bands of colour, as splats were trained. Several frames are a round.",
            inputs=[
                Splat.Input("splat"),
                io.Int.Input("frames", default=1, min=1, max=1000),
                io.String.Input("background", default="#000000"),
                *view_inputs(),
            ],
            outputs=[
                io.Image.Output(display_name="image"),
                io.Mask.Output(display_name="mask", tooltip="How opaque the splat is."),
            ],
        )

    @classmethod
    @torch.no_grad()
    def execute(
        cls,
        splat: Any,
        frames: int,
        background: str,
        view: int,
        width: int,
        height: int,
        camera_info: dict | None = None,
    ) -> io.NodeOutput:
        """Renders each view, as `render` does."""
        with observed(Progress()):
            scene = ss.import_(splats_of(splat))
            if frames > 1:
                cameras = ss.orbit(scene, frames=frames, size=(width, height))
            else:
                scene, name = with_views(scene, (width, height), view, camera_info)
                cameras = scene.cameras[[scene.cameras.index(name)]]
            behind = torch.tensor(parse_color(background))
            splats = scene.base.to(comfy.model_management.get_torch_device())
            found = [
                rasterize(splats, camera, background=behind.to(splats.means))[:2]
                for camera in track(cameras, "rendering")
            ]
        images, alphas = (torch.cat(each).cpu().clamp(0, 1) for each in zip(*found, strict=True))
        return io.NodeOutput(images, alphas[..., 0])


class MeshSplat(io.ComfyNode):
    """A textured mesh."""

    @classmethod
    def define_schema(cls) -> io.Schema:
        """Inputs and outputs."""
        return io.Schema(
            node_id="StyleSplatMesh",
            display_name="Mesh of Splat (StyleSplat)",
            category=CATEGORY,
            description="Needs `pip install 'stylesplat[mesh]'`.",
            inputs=[
                Splat.Input("splat"),
                io.Int.Input("faces", default=MeshConfig.faces, min=100, max=1_000_000),
                io.Combo.Input("texture_size", options=["2048", "1024", "4096", "512"]),
                Selection.Input("selection", optional=True, tooltip="All without one."),
            ],
            outputs=[io.Custom("FILE_3D_GLB").Output(display_name="model_3d")],
        )

    @classmethod
    def execute(
        cls, splat: Any, faces: int, texture_size: str, selection: Tensor | None = None
    ) -> io.NodeOutput:
        """Calls `export` with a mesh."""
        config = MeshConfig(faces=faces, texture_size=int(texture_size))
        with observed(Progress()), tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "mesh.glb"
            ss.export(scene_of(splat, selection), file, objects=[NAME], mesh=config)
            content = file.read_bytes()
        return io.NodeOutput(Types.File3D(BytesIO(content), file_format="glb"))


class SaveSplat(io.ComfyNode):
    """A file in the output folder."""

    @classmethod
    def define_schema(cls) -> io.Schema:
        """Inputs and outputs."""
        return io.Schema(
            node_id="StyleSplatSave",
            display_name="Save Splat (StyleSplat)",
            category=CATEGORY,
            description="html is a page that shows the splat in any browser, without a network.",
            is_output_node=True,
            inputs=[
                Splat.Input("splat"),
                io.String.Input("filename_prefix", default="3d/StyleSplat"),
                io.Combo.Input("format", options=list(FORMATS)),
            ],
            outputs=[io.String.Output(display_name="path")],
        )

    @classmethod
    def execute(cls, splat: Any, filename_prefix: str, format: str) -> io.NodeOutput:
        """Calls `export`."""
        folder, name, counter, _, _ = folder_paths.get_save_image_path(
            filename_prefix, folder_paths.get_output_directory()
        )
        path = Path(folder) / f"{name}_{counter:05}_.{format}"
        with observed(Progress()):
            ss.export(splats_of(splat), path)
        return io.NodeOutput(str(path), ui={"text": (str(path),)})


NODES = [
    LoadSplat,
    SelectSplat,
    StylizeSplat,
    RecolorSplat,
    RenderSplat,
    MeshSplat,
    SaveSplat,
]
