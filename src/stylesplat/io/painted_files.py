"""What was painted on a scene, in the scene's folder."""

from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor

from stylesplat.errors import StyleSplatError, within
from stylesplat.io.json_files import fitting, read_json, write_json
from stylesplat.io.recipe_files import paintings_in, recipe_of
from stylesplat.io.splats.splat_ply import pad_bands
from stylesplat.io.tensors import load_tensors, read_rows, write_tensors
from stylesplat.scene.paintings import Colors, Painted, Unsplit

BASE_COLORS = "base_colors.safetensors"
STYLE_COLORS = "style_colors.safetensors"
UNSPLIT = "unsplit.safetensors"
PAINTINGS = "paintings.safetensors"
RECIPE = "recipe.json"


def write_painted(painted: Painted | None, folder: Path) -> None:
    """Write what was painted into a scene's folder; remove what it said of that before.

    Raises:
        StyleSplatError: If it cannot be written.
    """
    for name in (BASE_COLORS, STYLE_COLORS, UNSPLIT, PAINTINGS, RECIPE):
        (folder / name).unlink(missing_ok=True)  # an earlier state's
    if painted is None:
        return
    for colors, name in ((painted.before, BASE_COLORS), (painted.full, STYLE_COLORS)):
        write_tensors({"sh0": colors.sh0, "shN": pad_bands(colors.shN)}, folder / name)
    if painted.unsplit is not None:
        tensors = {**vars(painted.unsplit), "count": torch.tensor(painted.unsplit.count)}
        write_tensors(tensors, folder / UNSPLIT)
    rows = {str(number): each.picked for number, each in enumerate(painted.paintings)}
    write_tensors(rows, folder / PAINTINGS)
    write_json(recipe_of(painted), folder / RECIPE)


def read_painted(folder: Path, picks: Mapping[str, Tensor], count: int) -> Painted | None:
    """Read what was painted; None if nothing was.

    Args:
        folder: Of the scene.
        picks: Named objects, which scenes of old took for what was painted.
        count: The number of Gaussians.

    Raises:
        StyleSplatError: If a file is missing or damaged, or belongs to another scene.
    """
    if not (folder / BASE_COLORS).exists():
        return None
    content = read_json(folder / RECIPE)
    if (folder / PAINTINGS).exists():
        found = read_rows(folder / PAINTINGS, count)
        rows = [found[name] for name in sorted(found, key=lambda name: (len(name), name))]
    else:  # as scenes were before they remembered what was painted
        names = [str(each.get("name")) for each in content.get("objects", [])]
        rows = [picks[name] for name in names if name in picks]
    with within(f"Cannot read {folder / RECIPE}"):
        paintings = paintings_in(content, rows)
        origin = fitting(content.get("scene"), str | None, "scene is wrong", "Style again.")
    return Painted(
        paintings=paintings,
        before=_read_colors(folder / BASE_COLORS, count),
        full=_read_colors(folder / STYLE_COLORS, count),
        unsplit=_read_unsplit(folder / UNSPLIT),
        origin=Path(origin) if origin else None,
    )


def _read_colors(path: Path, count: int) -> Colors:
    tensors = read_rows(path, count)
    try:
        return Colors(tensors["sh0"], tensors["shN"])
    except KeyError as error:
        raise StyleSplatError(f"Cannot read {path}: it has no {error}. Style again.") from error


def _read_unsplit(path: Path) -> Unsplit | None:
    if not path.exists():
        return None
    tensors = load_tensors(path)
    try:
        return Unsplit(count=int(tensors.pop("count")), **tensors)
    except (KeyError, TypeError) as error:
        raise StyleSplatError(f"Cannot read {path}: {error}. Style the scene again.") from error
