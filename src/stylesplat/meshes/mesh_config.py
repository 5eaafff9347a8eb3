"""Settings of meshes."""

from dataclasses import dataclass
from typing import Annotated, ClassVar

from stylesplat.errors import StyleSplatError
from stylesplat.options import MANY, Config, Option


@dataclass(frozen=True)
class MeshConfig(Config):
    """What a mesh is to be like."""

    verb: ClassVar = "make a mesh"
    faces: Annotated[int, Option(100, MANY)] = 50_000
    """Triangles at most."""
    texture_size: Annotated[int, Option(1, 8192)] = 2048
    """Pixels of a side of the texture, a power of two."""
    repaint: bool = False
    """Paint the texture anew in the object's style: its strokes are finer than Gaussians."""

    def __post_init__(self) -> None:
        super().__post_init__()
        size = self.texture_size
        if size & (size - 1):
            raise StyleSplatError(f"Cannot make a texture of {size} pixels: use a power of two.")
