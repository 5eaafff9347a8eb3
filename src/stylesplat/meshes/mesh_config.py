"""Settings of meshes."""

from dataclasses import dataclass

from stylesplat.errors import StyleSplatError

FEWEST_FACES = 100
LARGEST_TEXTURE = 8192


@dataclass(frozen=True)
class MeshConfig:
    """What a mesh is to be like."""

    faces: int = 50_000
    """Triangles at most."""
    texture_size: int = 2048
    """Pixels of a side of the texture, a power of two."""
    repaint: bool = False
    """Paint the texture anew in the object's style: its strokes are finer than Gaussians."""

    def __post_init__(self) -> None:
        if self.faces < FEWEST_FACES:
            raise StyleSplatError(
                f"Cannot make a mesh of {self.faces} faces: ask for {FEWEST_FACES} or more."
            )
        size = self.texture_size
        if not (0 < size <= LARGEST_TEXTURE) or size & (size - 1):
            raise StyleSplatError(
                f"Cannot make a texture of {size} pixels: use a power of two, "
                f"{LARGEST_TEXTURE} at most."
            )
