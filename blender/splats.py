"""The Gaussians of an object: Blender 5.3's point clouds, and vertices as add-ons import them.

A point cloud of the type GAUSSIAN_SPLAT has the attributes `position`, `scale` (linear), `rotation`
(wxyz), `radiance:base` (constant band of colour, opacity in 0..1) and `radiance:sh_0` to
`radiance:sh_14`. Below 5.3 the PLY importer, and with it 3DGS Render by KIRI Engine, gives a mesh
whose vertices have the columns of the file: `f_dc_0`, `opacity` (logit), `scale_0` (log), `rot_0`.
"""

from pathlib import Path

import bpy
import numpy as np

DC = [f"f_dc_{n}" for n in range(3)]
SCALES, ROTATION = [f"scale_{n}" for n in range(3)], [f"rot_{n}" for n in range(4)]
BANDS = 15  # of colour besides the constant one, in a file
REST = [f"f_rest_{n}" for n in range(3 * BANDS)]  # channel-major
COLUMNS = ["x", "y", "z", "nx", "ny", "nz", *DC, *REST, "opacity", *SCALES, *ROTATION]
POINTS, VERTICES = "points", "vertices"
BASE, BAND = "radiance:base", "radiance:sh_{}"
BEFORE = "before:"  # of attributes that keep what a layer covers
FIELDS = {"FLOAT": ("value", 1), "FLOAT_VECTOR": ("vector", 3), "FLOAT4": ("vector", 4)}
FIELDS |= {"QUATERNION": ("value", 4)}
OPACITY_END = 2.0**-24  # of 0 and 1, which have no logit
TINY = 1e-30  # the least scale, which has a logarithm


def kind_of(thing: bpy.types.Object | None) -> str | None:
    """`points` or `vertices` of an object that is a splat, None of any other."""
    attributes = getattr(getattr(thing, "data", None), "attributes", {})
    if thing is not None and thing.type == "POINTCLOUD" and BASE in attributes:
        return POINTS
    needed = (*DC, "opacity", *SCALES, *ROTATION)
    is_splat = thing is not None and thing.type == "MESH" and all(n in attributes for n in needed)
    return VERTICES if is_splat else None


def get(data: bpy.types.ID, name: str) -> np.ndarray:
    """The values [N, D] of an attribute."""
    attribute = data.attributes[name]
    field, width = FIELDS[attribute.data_type]
    values = np.empty(len(attribute.data) * width, np.float32)
    attribute.data.foreach_get(field, values)
    return values.reshape(-1, width)


def put(data: bpy.types.ID, name: str, values: np.ndarray, data_type: str) -> None:
    """Set the values [N, D] of an attribute, which is made if there is none."""
    if name not in data.attributes:
        data.attributes.new(name, data_type, "POINT")
    attribute = data.attributes[name]
    attribute.data.foreach_set(
        FIELDS[data_type][0], np.ascontiguousarray(values, np.float32).ravel()
    )


def places(data: bpy.types.ID) -> np.ndarray:
    """The positions [N, 3]."""
    return get(data, "position")


def selected(thing: bpy.types.Object) -> np.ndarray:
    """Which Gaussians [N] are selected in edit mode; those of a point cloud all are at first."""
    data = thing.data
    if thing.type == "MESH":
        mask = np.empty(len(data.vertices), bool)
        data.vertices.foreach_get("select", mask)
        return mask
    mask = np.ones(len(data.points), bool)
    if ".selection" in data.attributes:
        data.attributes[".selection"].data.foreach_get("value", mask)
    return mask


def table_of(thing: bpy.types.Object) -> np.ndarray:
    """The columns of INRIA's PLY [N, 62]: scales are logarithms, opacities logits."""
    data = thing.data
    table = np.zeros((len(data.attributes["position"].data), len(COLUMNS)), np.float32)
    table[:, :3] = places(data)
    if kind_of(thing) == VERTICES:
        for number, name in enumerate(COLUMNS):
            if name in data.attributes and number > 5:
                table[:, number] = get(data, name)[:, 0]
        return table
    base = get(data, BASE)
    opacity = base[:, 3].astype(float).clip(OPACITY_END, 1 - OPACITY_END)
    at = COLUMNS.index
    table[:, at("f_dc_0") : at("f_dc_2") + 1] = base[:, :3]
    table[:, at("opacity")] = np.log(opacity / (1 - opacity))
    scales = get(data, "scale").astype(float).clip(TINY)
    table[:, at("scale_0") : at("scale_2") + 1] = np.log(scales)
    table[:, at("rot_0") : at("rot_3") + 1] = get(data, "rotation")
    for band in range(BANDS):
        if BAND.format(band) in data.attributes:
            columns = [at(f"f_rest_{channel * BANDS + band}") for channel in range(3)]
            table[:, columns] = get(data, BAND.format(band))
    return table


def write_ply(table: np.ndarray, path: Path) -> None:
    """Write the columns as little-endian floats."""
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(table)}"]
    lines += [f"property float {name}" for name in COLUMNS]
    head = "\n".join([*lines, "end_header", ""]).encode()
    path.write_bytes(head + table.astype("<f4").tobytes())


def read_ply(path: Path) -> np.ndarray:
    """What StyleSplat writes: the same columns."""
    head, _, content = path.read_bytes().partition(b"end_header\n")
    names = [line.split()[2].decode() for line in head.splitlines() if line.startswith(b"property")]
    if names != COLUMNS:
        raise ValueError(f"{path} has other columns than a splat")
    return np.frombuffer(content, "<f4").reshape(-1, len(COLUMNS))


def attributes_of(table: np.ndarray, kind: str) -> dict[str, tuple[str, np.ndarray]]:
    """The attributes of rows of a table: their types and values [N, D]."""
    at = COLUMNS.index
    if kind == VERTICES:
        columns = {name: ("FLOAT", table[:, [at(name)]]) for name in COLUMNS[6:]}
        return {"position": ("FLOAT_VECTOR", table[:, :3]), **columns}
    wide = table.astype(float)
    opacity = 1 / (1 + np.exp(-wide[:, at("opacity")]))
    rotation = wide[:, at("rot_0") :]
    norms = np.linalg.norm(rotation, axis=1, keepdims=True).clip(TINY)
    rest = table[:, at("f_rest_0") : at("f_rest_0") + len(REST)].reshape(-1, 3, BANDS)
    return {
        "position": ("FLOAT_VECTOR", table[:, :3]),
        BASE: ("FLOAT4", np.column_stack([table[:, at("f_dc_0") : at("f_dc_2") + 1], opacity])),
        "scale": ("FLOAT_VECTOR", np.exp(wide[:, at("scale_0") : at("scale_2") + 1])),
        "rotation": ("QUATERNION", rotation / norms),
        **{BAND.format(n): ("FLOAT_VECTOR", rest[:, :, n]) for n in range(BANDS)},
    }


def apply(data: bpy.types.ID, kind: str, before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Put rows that differ into an object's data, which gets more points if there are more rows.

    Values of other rows are not touched. Returns which rows [N] of those before have changed.
    """
    count, more = len(before), len(after) - len(before)
    changed = (before != after[:count]).any(axis=1)
    if more:
        data.vertices.add(more) if kind == VERTICES else data.resize(len(after))
    rows = np.concatenate([changed, np.ones(more, bool)])
    for name, (data_type, values) in attributes_of(after, kind).items():
        if name not in data.attributes and not values.any():
            continue  # a band that is nowhere
        there = np.zeros((len(after), values.shape[1]), np.float32)
        if name in data.attributes:
            there = get(data, name)
        there[rows] = values[rows]
        put(data, name, there, data_type)
    if kind == POINTS:
        data.type = "GAUSSIAN_SPLAT"
    data.update_tag()
    return changed


def keep(data: bpy.types.ID, kind: str, before: np.ndarray) -> None:
    """Copy what a layer covers to attributes of other names, unless an earlier layer did."""
    for name in attributes_of(before[:1], kind):
        if name in data.attributes and name != "position" and BEFORE + name not in data.attributes:
            data_type = data.attributes[name].data_type
            put(data, BEFORE + name, get(data, name), data_type)


def restore(data: bpy.types.ID) -> bool:
    """Put back what `keep` copied, to the bit. Returns whether there was any."""
    names = [each.name for each in data.attributes if each.name.startswith(BEFORE)]
    for name in names:
        data_type = data.attributes[name].data_type
        put(data, name.removeprefix(BEFORE), get(data, name), data_type)
        data.attributes.remove(data.attributes[name])
    data.update_tag()
    return bool(names)
