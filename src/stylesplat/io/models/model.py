"""The nouns of meshes that others made: their parts, and parts that were painted."""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int, UInt8

from stylesplat.io.models.obj import Obj

LINEAR_BELOW = 0.0031308  # of sRGB's curve, from its standard


@dataclass(frozen=True, eq=False)
class Part:
    """Triangles of one material in one place."""

    names: tuple[str, ...]
    """What it may be chosen by: its node, its mesh, its material; of an OBJ the material."""
    vertices: Float[np.ndarray, "V 3"]
    """In the model's world, y up."""
    faces: Int[np.ndarray, "F 3"]
    uvs: Float[np.ndarray, "V 2"] | None
    """From 0 to 1, v downwards; they may repeat beyond."""
    picture: UInt8[np.ndarray, "H W 4"] | None
    """Its base colour."""
    factors: Float[np.ndarray, "V 3"]
    """What multiplies the base colour in linear light, by vertex."""
    texture: Hashable
    """Parts with an equal value share the places of their texture."""
    place: Any
    """Where the file has it; its writer knows."""


@dataclass(frozen=True, eq=False)
class Unwrapped:
    """New places of a part in a texture."""

    origins: Int[np.ndarray, " U"]
    """The vertex of the part that each vertex is of; those at seams come twice."""
    faces: Int[np.ndarray, "F 3"]
    """The part's faces in their order, of these vertices."""
    uvs: Float[np.ndarray, "U 2"]


@dataclass(frozen=True, eq=False)
class PaintedPart:
    """A part with a new base colour."""

    part: Part
    picture: int
    """Its number among the pictures."""
    unwrapped: Unwrapped | None
    """None if it keeps its UVs."""


@dataclass(frozen=True, eq=False)
class Model:
    """A file of meshes, with what its writer needs to write it again."""

    parts: Sequence[Part]
    content: Any
    obj: Obj | None = None
    """What it was read from, if that was an OBJ."""
    left_out: frozenset[str] = frozenset()
    """Kinds of its maps that are not in the content."""


def displayed(linear: Float[np.ndarray, "*B 3"]) -> Float[np.ndarray, "*B 3"]:
    """Linear light as sRGB."""
    bounded = linear.clip(0, 1)
    curve = 1.055 * bounded ** (1 / 2.4) - 0.055
    return np.where(bounded < LINEAR_BELOW, 12.92 * bounded, curve)


def linear_light(colors: Float[np.ndarray, "*B 3"]) -> Float[np.ndarray, "*B 3"]:
    """The inverse of `displayed`."""
    curve = ((colors + 0.055) / 1.055) ** 2.4
    return np.where(colors < 12.92 * LINEAR_BELOW, colors / 12.92, curve)


def base_colors(
    part: Part, faces: Int[np.ndarray, " M"], weights: Float[np.ndarray, "M 3"]
) -> Float[np.ndarray, "M 3"]:
    """The base colour as sRGB at points of faces, given by the weights of their corners."""
    corners = part.faces[faces]
    linear = np.einsum("mkd,mk->md", part.factors[corners], weights)
    if part.picture is not None and part.uvs is not None:
        height, width = part.picture.shape[:2]
        uvs = np.einsum("mkd,mk->md", part.uvs[corners], weights) % 1
        columns = (uvs[:, 0] * width).astype(int).clip(0, width - 1)
        rows = (uvs[:, 1] * height).astype(int).clip(0, height - 1)
        linear = linear * linear_light(part.picture[rows, columns, :3] / 255)
    return displayed(linear)
