"""What was painted on a scene, in the scene's folder."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor

from stylesplat.errors import StyleSplatError, within
from stylesplat.io.declared import GAUSSIANS, PICKED, Declared
from stylesplat.io.json_files import write_json
from stylesplat.io.recipe_files import AGAIN, gone_in, paintings_in, read_recipe_json, recipe_of
from stylesplat.io.splats.splat_ply import FULL_BANDS, pad_bands
from stylesplat.io.tensors import read_named, read_tensors, write_tensors
from stylesplat.scene.paintings import Looks, Painted, Unsplit
from stylesplat.scene.scene import check_name_or_id
from stylesplat.scene.splats import Splats

COLORS = {"sh0": GAUSSIANS["sh0"], "shN": replace(GAUSSIANS["shN"], shape=("N", FULL_BANDS, 3))}
BASE_COLORS = "base_colors.safetensors"
STYLE_COLORS = "style_colors.safetensors"
OPACITIES = "opacities.safetensors"
UNSPLIT = "unsplit.safetensors"
PAINTINGS = "paintings.safetensors"
RECIPE = "recipe.json"


def write_painted(painted: Painted | None, folder: Path) -> None:
    """Write what was painted into a scene's folder; remove what it said of that before.

    Raises:
        StyleSplatError: If it cannot be written, or an object has a name that files cannot have.
    """
    for name in (BASE_COLORS, STYLE_COLORS, OPACITIES, UNSPLIT, PAINTINGS, RECIPE):
        (folder / name).unlink(missing_ok=True)  # an earlier state's
    if painted is None:
        return
    for name in painted.names:
        check_name_or_id(name)
    for looks, name in ((painted.before, BASE_COLORS), (painted.full, STYLE_COLORS)):
        write_tensors({"sh0": looks.sh0, "shN": pad_bands(looks.shN)}, folder / name)
    _write_opacities(painted, folder / OPACITIES)
    if painted.unsplit is not None:
        tensors = {**vars(painted.unsplit), "count": torch.tensor(painted.unsplit.count)}
        write_tensors(tensors, folder / UNSPLIT)
    rows = {str(number): each.picked for number, each in enumerate(painted.paintings)}
    write_tensors(rows, folder / PAINTINGS)
    write_json(recipe_of(painted), folder / RECIPE)


def read_painted(folder: Path, picks: Mapping[str, Tensor], splats: Splats) -> Painted | None:
    """Read what was painted; None if nothing was.

    Args:
        folder: Of the scene.
        picks: Named objects, which scenes of old took for what was painted.
        splats: The scene's, whose opacities are those of all looks where no canvas was laid.

    Raises:
        StyleSplatError: If a file is missing or damaged, or belongs to another scene.
    """
    if not (folder / BASE_COLORS).exists():
        return None
    recipe, count = read_recipe_json(folder / RECIPE), len(splats)
    if (folder / PAINTINGS).exists():
        found = read_named(folder / PAINTINGS, PICKED, N=count)
        if found.keys() != {str(number) for number in range(len(found))}:
            raise StyleSplatError(
                f"Cannot read {folder / PAINTINGS}: its paintings are not numbered from 0. {AGAIN}"
            )
        rows = [found[str(number)] for number in range(len(found))]
    else:  # as scenes were before they remembered what was painted
        rows = [picks[each.name] for each in recipe.objects if each.name in picks]
    with within(f"Cannot read {folder / RECIPE}"):
        paintings, gone = paintings_in(recipe, rows), gone_in(recipe)
    before, full = _read_opacities(folder / OPACITIES, splats.opacities)
    return Painted(
        paintings=paintings,
        before=Looks(**read_tensors(folder / BASE_COLORS, COLORS, N=count), opacities=before),
        full=Looks(**read_tensors(folder / STYLE_COLORS, COLORS, N=count), opacities=full),
        unsplit=_read_unsplit(folder / UNSPLIT, count),
        origin=Path(recipe.scene) if recipe.scene else None,
        gone=gone,
    )


def _write_opacities(painted: Painted, path: Path) -> None:
    """Those that differ between two looks, if there are any."""
    before, full = painted.before.opacities, painted.full.opacities
    rows = (before != full).nonzero()[:, 0]
    if len(rows):
        write_tensors({"rows": rows, "before": before[rows], "full": full[rows]}, path)


def _read_opacities(path: Path, known: Tensor) -> tuple[Tensor, Tensor]:
    """Before and at full intensity, known where they are the same."""
    if not path.exists():
        return known, known
    of_rows = replace(GAUSSIANS["opacities"], shape=("R",))
    rows = Declared(("R",), torch.int64, low=0, high=len(known) - 1, unique=True)
    tensors = read_tensors(path, {"rows": rows, "before": of_rows, "full": of_rows})
    before, full = (known.index_copy(0, tensors["rows"], tensors[k]) for k in ("before", "full"))
    return before, full


def _read_unsplit(path: Path, count: int) -> Unsplit | None:
    if not path.exists():
        return None
    tensors = read_tensors(path, _unsplit_of(count))
    before = int(tensors.pop("count"))
    if (tensors["rows"] >= before).any():
        raise StyleSplatError(f"Cannot read {path}: rows are not among the {before} first. {AGAIN}")
    return Unsplit(count=before, **tensors)


def _unsplit_of(count: int) -> dict[str, Declared]:
    """What undoes the splits of a scene of so many Gaussians."""
    return {
        "count": Declared((), torch.int64, low=1, high=count),
        "rows": Declared(("R",), torch.int64, low=0, high=count - 1, unique=True),
        "scales": replace(GAUSSIANS["scales"], shape=("R", 3)),
        "opacities": replace(GAUSSIANS["opacities"], shape=("R",)),
    }
