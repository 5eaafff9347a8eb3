"""Nodes of ComfyUI that select, paint and render 3D Gaussian splats: it imports this folder."""

import os
from pathlib import Path

import folder_paths
from comfy_api.latest import ComfyExtension

os.environ.setdefault("STYLESPLAT_KEEP_MALLOC", "1")  # malloc is that of ComfyUI's process
os.environ.setdefault("STYLESPLAT_MODELS", str(Path(folder_paths.models_dir) / "stylesplat"))

from .nodes import NODES


class StyleSplatExtension(ComfyExtension):
    """What ComfyUI asks for the nodes."""

    async def get_node_list(self) -> list:
        """The classes of the nodes."""
        return NODES


async def comfy_entrypoint() -> StyleSplatExtension:
    """ComfyUI calls it when it starts."""
    return StyleSplatExtension()
