"""The nodes of `comfyui/` within ComfyUI, or within a stub of the interfaces that it documents.

The environment variable COMFYUI names a checkout of ComfyUI, whose requirements are installed. What
releases before June 2026 lack, SPLAT and File3D, is added to it.
"""

import importlib
import importlib.util
import os
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

COMFYUI = os.environ.get("COMFYUI")
FOLDER = Path(__file__).parents[1] / "comfyui"


class SPLAT:
    """`comfy_api.latest.Types.SPLAT`."""

    def __init__(self, positions, scales, rotations, opacities, sh, counts=None):
        self.positions, self.scales, self.rotations = positions, scales, rotations
        self.opacities, self.sh, self.counts = opacities, sh, counts


class File3D:
    """`comfy_api.latest.Types.File3D`, of a stream."""

    def __init__(self, source, file_format=""):
        self.source, self.format = source, file_format

    def get_bytes(self):
        return self.source.getvalue()


class Cancelled(BaseException):
    """`comfy.model_management.InterruptProcessingException` of the stub."""


class Bar:
    """`comfy.utils.ProgressBar` of the stub."""

    def __init__(self, total: float) -> None:
        self.total = total

    def update(self, value: float) -> None:
        pass


class Port:
    """An input or output of a schema."""

    def __init__(self, io_type: str, is_widget: bool, id: str = "", **options: Any) -> None:
        self.io_type, self.is_widget, self.id, self.options = io_type, is_widget, id, options
        self.display_name = options.get("display_name")
        self.optional = options.get("optional", False)


def _kind(io_type: str, is_widget: bool = False) -> Any:
    def port(id: str = "", **options: Any) -> Port:
        return Port(io_type, is_widget, id, **options)

    return SimpleNamespace(Input=port, Output=port)


class NodeOutput:
    """What a node returns."""

    def __init__(self, *args: Any, ui: Any = None) -> None:
        self.args, self.ui = args, ui


STUBS = ["comfy_api", "comfy_api.latest", "comfy", "comfy.utils", "comfy.model_management"]
STUBS.append("folder_paths")


def _module(name: str, **names: Any) -> ModuleType:
    module = sys.modules.setdefault(name, ModuleType(name))
    for key, value in names.items():
        setattr(module, key, value)
    return module


def _install_stub(root: Path) -> None:
    widgets = {"Int": "INT", "Float": "FLOAT", "String": "STRING", "Combo": "COMBO"}
    sockets = {"Image": "IMAGE", "Mask": "MASK", "Load3DCamera": "LOAD3D_CAMERA"}
    io = SimpleNamespace(
        **{name: _kind(io_type, True) for name, io_type in widgets.items()},
        **{name: _kind(io_type) for name, io_type in sockets.items()},
        Custom=_kind,
        ComfyNode=object,
        NodeOutput=NodeOutput,
        Schema=SimpleNamespace,
        UploadType=SimpleNamespace(model="file_upload"),
    )
    state = SimpleNamespace(is_cancelled=False)

    def check() -> None:
        if state.is_cancelled:
            state.is_cancelled = False
            raise Cancelled

    def save_path(prefix: str, folder: str) -> tuple[str, str, int, str, str]:
        place = Path(folder, prefix)
        place.parent.mkdir(parents=True, exist_ok=True)
        return str(place.parent), place.name, 1, "", prefix

    _module("comfy_api")
    types = SimpleNamespace(SPLAT=SPLAT, File3D=File3D)
    _module("comfy_api.latest", io=io, Types=types, ComfyExtension=object)
    utils = _module("comfy.utils", ProgressBar=Bar)
    management = _module(
        "comfy.model_management",
        throw_exception_if_processing_interrupted=check,
        interrupt_current_processing=lambda: setattr(state, "is_cancelled", True),
        InterruptProcessingException=Cancelled,
        get_torch_device=lambda: "cpu",
    )
    _module("comfy", utils=utils, model_management=management)
    _module(
        "folder_paths",
        models_dir=str(root / "models"),
        get_input_directory=lambda: str(root / "input"),
        get_output_directory=lambda: str(root / "output"),
        get_annotated_filepath=lambda name: str(root / "input" / name),
        exists_annotated_filepath=lambda name: (root / "input" / name).exists(),
        get_save_image_path=save_path,
    )


def _install_real(root: Path) -> None:
    assert COMFYUI is not None
    sys.path.insert(0, COMFYUI)
    sys.argv[1:] = ["--cpu", "--base-directory", str(root)]
    importlib.import_module("comfy.options").enable_args_parsing()
    latest: Any = importlib.import_module("comfy_api.latest")
    for added in (SPLAT, File3D):
        if not hasattr(latest.Types, added.__name__):
            setattr(latest.Types, added.__name__, added)


def load_nodes(root: Path) -> dict[str, Any]:
    """The classes of the nodes by id, in a ComfyUI whose folders are in `root`."""
    (root / "input").mkdir(parents=True, exist_ok=True)
    (_install_real if COMFYUI else _install_stub)(root)
    spec = importlib.util.spec_from_file_location(
        "comfyui", FOLDER / "__init__.py", submodule_search_locations=[str(FOLDER)]
    )
    assert spec is not None and spec.loader is not None
    sys.modules["comfyui"] = module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    nodes = sys.modules["comfyui.nodes"].NODES
    return {node.define_schema().node_id: node for node in nodes}


WIDGETS = {"LoadImage": ("image",), "PreviewImage": ()}  # of nodes of ComfyUI itself


def prompt_of(workflow: dict[str, Any], nodes: dict[str, Any]) -> dict[str, Any]:
    """The form in which ComfyUI runs a workflow: inputs by name."""
    links = {number: [str(node), slot] for number, node, slot, *_ in workflow["links"]}
    prompt = {}
    for node in workflow["nodes"]:
        inputs = {each["name"]: links[each["link"]] for each in node["inputs"] if each["link"]}
        values = [each for each in node["widgets_values"] if each not in ("fixed", "file")]
        if node["type"] in WIDGETS:
            inputs |= dict(zip(WIDGETS[node["type"]], values, strict=False))
        else:
            names = [each.id for each in nodes[node["type"]].define_schema().inputs]
            sockets = {each["name"] for each in node["inputs"]}
            inputs |= dict(zip((n for n in names if n not in sockets), values, strict=True))
        prompt[str(node["id"])] = {"class_type": node["type"], "inputs": inputs}
    return prompt


def schema_of_server(object_info: dict[str, Any]) -> dict[str, Any]:
    """What `prompt_of` asks of nodes, from a server's description of them."""
    found = {}
    for name, node in object_info.items():
        order = node.get("input_order", {})
        ids = [each for part in ("required", "optional") for each in order.get(part, ())]
        schema = SimpleNamespace(inputs=[SimpleNamespace(id=each) for each in ids])
        found[name] = SimpleNamespace(define_schema=lambda schema=schema: schema)
    return found
