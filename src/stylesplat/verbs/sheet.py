"""`sheet`: one object in a grid of styles and settings, to choose from."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from jaxtyping import UInt8
from torch import Tensor

from stylesplat.errors import StyleSplatError, count_noun, noun_repr
from stylesplat.figures.best_views import close_up
from stylesplat.figures.grid import GridPicture, Row, draw_grid
from stylesplat.figures.pictures import render_picture, to_uint8
from stylesplat.io.style_pictures import Picture
from stylesplat.options import check_arguments
from stylesplat.progress import track
from stylesplat.rendering.render import pick_device
from stylesplat.scene.scene import Scene
from stylesplat.selection.resolve import find_object
from stylesplat.stylization.config import Network
from stylesplat.stylization.painting import Painting, check_paintings
from stylesplat.stylization.style import Style
from stylesplat.verbs.stylize import stylize

SHEET_CELL = 512  # pixels along a cell: strokes of a normal painting can be told apart
FIELDS = {"stroke_size": "scale"}  # options of `stylize` that settings call otherwise


@dataclass(frozen=True, eq=False)
class StyleSheet:
    """An object in a grid."""

    picture: UInt8[Tensor, "H W 3"]
    """The grid."""
    view: str
    """The photo that it is looked at from."""
    cells: int
    """Number of cells, without the object as it is."""
    repainted: int
    """Number of cells that were painted; the others are blends of these."""

    def __repr__(self) -> str:
        height, width, _ = self.picture.shape
        return noun_repr(
            self, count_noun(self.cells, "cell"), f"{width}x{height}", f"from {self.view}"
        )


@check_arguments
def sheet(
    scene: Scene,
    name: str,
    styles: Sequence[Picture | Sequence[Picture]],
    *,
    vary: Mapping[str, Sequence[Any]] | None = None,
    view: str | None = None,
    features: Network | None = None,
    weights: Path | str | None = None,
    device: str = "auto",
    **settings: Any,
) -> StyleSheet:
    """Repaint an object once for each cell, as `stylize` does, and draw the results.

    Cells that differ in nothing but intensity are blends of one result.

    Args:
        scene: Where the object is.
        name: The object.
        styles: Pictures, or several that make one style; alternatives are rows.
        vary: Settings, named as options of `stylize`, and the values to try: the first makes
            columns, a second rows.
        view: The photo to look from; by default one that shows most of the object and its detail.
        features: Network whose features are matched; by default that of the preset.
        weights: File of its weights.
        device: Where to compute.
        settings: Of all cells, such as `steps=150`, and their `preset`.

    Raises:
        StyleSplatError: If the object, a picture, the view or the weights file is unfit, or there
            is more than rows and columns can show.

    Example:
        >>> sheet(scene, "vase", ["wave.jpg"], vary={"stroke_size": (1, 2, 4)})  # doctest: +SKIP
    """
    grid = sheet_rows(styles, vary or {}, settings)
    runs = dict[object, tuple[Style, list[tuple[int, int, float]]]]()
    for row, (_, cells) in enumerate(grid):
        for column, (_, style) in enumerate(cells):
            config = replace(style.config, intensity=1.0)
            full = Style(*style.pictures, config=config, preset=style.preset)
            same = (*map(id, style.pictures), config, style.network)  # colours cannot be hashed
            place = row, column, style.config.intensity
            runs.setdefault(same, (full, []))[1].append(place)
    mask = find_object(scene, name)
    jobs = [Painting(name, mask, style.read(), style.config) for style, _ in runs.values()]
    check_paintings(jobs[:1])
    splats = scene.splats.to(pick_device(device))
    cameras = scene.cameras if view is None else scene.cameras[scene.cameras.index(view)]
    camera = close_up(splats, cameras, scene.to_splats(mask).to(splats.device), side=SHEET_CELL)
    # The paint that the object has stays in its place of the stack, without a message about it
    bare = replace(scene.with_strengths({name: 0.0}), path=scene.path)
    how = {"features": features, "weights": weights, "device": device, "measured": False}
    pictures = dict[tuple[int, int], GridPicture]()
    for style, places in track(runs.values(), name, unit="painting", total=len(runs)):
        painted = stylize(bare, {name: style}, **how)
        for row, column, intensity in places:
            blended = painted.with_strengths({name: intensity}).splats
            pictures[row, column] = render_picture(blended.to(splats.device), camera)
    rows, last = list[Row](), ()
    for row, (label, cells) in enumerate(grid):
        captioned = [
            (pictures[row, column], f"{row + 1},{column + 1}: {caption}")
            for column, (caption, _) in enumerate(cells)
        ]
        own = cells[0][1].pictures
        is_new = [*map(id, own)] != [*map(id, last)]  # style pictures lead where they change
        leading = [to_uint8(image) for image in Style(*own).read()] if is_new else []
        before = None if rows else (render_picture(splats, camera), "before")
        rows.append(Row([before, *captioned], label, leading))
        last = own
    return StyleSheet(draw_grid(rows), camera.names[0], len(pictures), len(runs))


def sheet_rows(
    styles: Sequence[Picture | Sequence[Picture]],
    vary: Mapping[str, Sequence[Any]],
    settings: Mapping[str, Any],
) -> list[tuple[str, list[tuple[str, Style]]]]:
    """The label of each row of a sheet, and the captions and styles of its cells.

    Raises:
        StyleSplatError: If there is more than rows and columns can show, or a value is out of
            range.
    """
    if not styles:
        raise StyleSplatError("A sheet shows at least one style. Pass --style OBJECT=IMAGE.")
    if len(vary) > (1 if len(styles) > 1 else 2):
        raise StyleSplatError(
            f"Got {len(styles)} styles and --vary {', '.join(vary)}. A sheet has rows and columns: "
            "one style and up to two --vary, or several styles and one."
        )
    varied = [FIELDS.get(key, key) for key in vary]
    for key in varied:
        if key in settings or varied.count(key) > 1:
            raise StyleSplatError(f"{key} is varied and given as well. Leave one of them out.")
    columns, lines = (_choices([*vary.items()][part]) for part in (slice(1), slice(1, 2)))
    rows = []
    for style in styles:
        pictures = (style,) if isinstance(style, str | Path | Tensor) else tuple(style)
        files = (Path(p).stem if isinstance(p, str | Path) else "picture" for p in pictures)
        title = " + ".join(files)
        for label, changed in lines:
            cells = [
                (caption or "styled", Style(*pictures, **{**settings, **changed, **more}))
                for caption, more in columns
            ]
            rows.append((label or title, cells))
    return rows


def _choices(vary: Sequence[tuple[str, Sequence[Any]]]) -> list[tuple[str, dict[str, Any]]]:
    """Captions and settings by value of a setting that varies; one without any if none does."""
    return [
        (f"{key.replace('_', ' ')} {_value_text(value)}", {FIELDS.get(key, key): value})
        for key, values in vary
        for value in values
    ] or [("", {})]


def _value_text(value: Any) -> str:
    if isinstance(value, tuple):
        return ", ".join(map(_value_text, value))
    return f"{value:g}" if isinstance(value, float) else str(value)
