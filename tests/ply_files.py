"""PLY files of splats as other programs write them, made by hand."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from stylesplat.scene.splats import Splats

TYPES = {"f4": "float", "f8": "double", "u1": "uchar", "u2": "ushort", "i4": "int"}
Columns = dict[str, np.ndarray]


def columns_of(splats: Splats) -> Columns:
    """INRIA's columns, without normals, with as many bands as the splats have."""
    columns = {name: splats.means[:, i].numpy() for i, name in enumerate("xyz")}
    columns |= {f"f_dc_{i}": splats.sh0[:, 0, i].numpy() for i in range(3)}
    rest = splats.shN.transpose(1, 2).flatten(1).numpy()
    columns |= {f"f_rest_{i}": rest[:, i] for i in range(rest.shape[1])}
    columns |= {"opacity": splats.opacities.numpy()}
    columns |= {f"scale_{i}": splats.scales[:, i].numpy() for i in range(3)}
    return columns | {f"rot_{i}": splats.quats[:, i].numpy() for i in range(4)}


def header_lines(
    columns: Columns, types: Mapping[str, str], encoding: str, comments: Sequence[str] = ()
) -> list[str]:
    count = len(next(iter(columns.values())))
    lines = ["ply", f"format {encoding} 1.0", *(f"comment {each}" for each in comments)]
    lines += [f"element vertex {count}"]
    lines += [f"property {TYPES[types.get(name, 'f4')]} {name}" for name in columns]
    return [*lines, "end_header", ""]


def rows_of(columns: Columns, types: Mapping[str, str], order: str = "<") -> bytes:
    count = len(next(iter(columns.values())))
    table = np.zeros(count, [(name, order + types.get(name, "f4")) for name in columns])
    for name, values in columns.items():
        table[name] = values
    return table.tobytes()


def write_ply(
    path: Path,
    columns: Columns,
    types: Mapping[str, str] | None = None,
    comments: Sequence[str] = (),
) -> Path:
    types = types or {}
    lines = header_lines(columns, types, "binary_little_endian", comments)
    path.write_bytes("\n".join(lines).encode() + rows_of(columns, types))
    return path
