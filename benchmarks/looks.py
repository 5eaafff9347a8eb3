"""How good are the pictures? Test objects in test paintings, on one page, with figures beside them.

    .venv/bin/python benchmarks/looks.py --all -o DIR
    .venv/bin/python benchmarks/looks.py -o DIR --objects fox face --paintings night lines

`DIR/index.html` has full-size crops of every object before and after, in held-out views; each row
of them is a picture in `DIR/crops`, too. `DIR/table.md` is the table. What is done is kept in
`DIR/cells`, so that a page can be extended, and is not done again (`--again` does); a painted scene
is not kept. Scenes are made once, into `benchmarks/out/test_objects`.

The figures (`judge.py`):

- kept: features kept, the correlation inside the object of the luminance between 1 and 8 % of its
  extent, painted against unpainted; 1 is all. Local: the mean of the correlations around each place
- compact, vgg19 full, half: exact NNFM by that network at the photos' size and half of it
- SSIM: of the luminance, painted against unpainted
- spill, missed %: against outlines by hand (fox) or exact label maps (demo, face, sign)
- stain px: the largest changed place beside the object: by the same, or by the capture's label maps
- near ratio: how far neighbouring views are from each other, painted over unpainted
- way full, half: with `--target-steps 150`, the share of the way from before to the best that any
  3D result could do in a view, its pixels optimised for the same loss (`target_2d.py`); by the last
  network, and slow: minutes for each object and painting, once
- s: of painting alone, by the clock; call s, CPU s: of the whole call, measuring included
"""

import json
import re
import subprocess
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from statistics import mean
from typing import Annotated, Any
from urllib.parse import quote

import numpy as np
import torch
import tyro
from bench import OUT, VGG19, machine, table
from judge import (
    SIZES,
    Figures,
    Networks,
    Sight,
    find_sights,
    judge,
    nnfm_of_views,
    outline_figures,
    painting_features,
    resized,
)
from painted_objects import OBJECTS, Name, Outlines, find_outlines, find_scene, photos_of
from paintings import DRAWN, SHIPPED, find_painting
from target_2d import target_2d
from torch import Tensor

import stylesplat as ss
from stylesplat.evaluation.changes import largest_stain
from stylesplat.figures.pictures import to_uint8
from stylesplat.io.images import write_image
from stylesplat.io.json_yaml import write_json
from stylesplat.io.style_pictures import read_style
from stylesplat.rendering.render import render
from stylesplat.scene.capture import Capture
from stylesplat.scene.scene import Scene
from stylesplat.scene.sequences import evenly_spaced
from stylesplat.selection.resolve import find_object
from stylesplat.stylization.features import load_weights

COLUMNS = (
    "kept",
    "kept local",
    "compact full",
    "compact half",
    "vgg19 full",
    "vgg19 half",
    "SSIM",
    "spill %",
)
COLUMNS += ("missed %", "stain px", "near ratio", "way full", "way half", "s", "call s", "CPU s")
KEYS = ("object", "painting", "quality", "seed", "settings")
TARGET_SIZES = (1.0, 0.5, 0.25)  # of the photos
THUMBNAIL = 300  # pixels
GAP = 6  # pixels between crops
PAGE = 0x22 / 0xFF  # its background
HEAD = """<!doctype html><meta charset="utf-8"><title>Looks</title><style>
body{font:15px sans-serif;margin:1em;background:#222;color:#ddd} img{vertical-align:top}
table{border-collapse:collapse;font-size:13px} td,th{padding:2px 8px;text-align:right}
td:first-child,td:nth-child(2){text-align:left} tr:nth-child(even){background:#2c2c2c}
.row{overflow-x:auto;white-space:nowrap} a{color:#9cf}</style><h1>Looks</h1>"""


@dataclass(frozen=True)
class Options:
    """What to paint, and how."""

    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder of the page."""
    all: bool = False
    """All objects and paintings that are not narrowed down."""
    objects: tuple[Name, ...] = ()
    """By default fox."""
    paintings: tuple[str, ...] = ()
    """Some of night, kandinsky, hassam, monet, raiko, lines, dots, flat, or files; by default
    night."""
    seeds: tuple[int, ...] = (0,)
    """Each paints every object."""
    quality: str = "normal"
    """Of `stylize`."""
    settings: str = "{}"
    """More settings of the style, as JSON: '{"content": 0.5}'."""
    views: int = 4
    """Held-out views that are judged and shown."""
    target_steps: int = 0
    """Steps for the pixels of the best picture; 0 leaves `way` out."""
    target_views: int = 2
    """Views that it is made in."""
    again: bool = False
    """Paint again what is in the folder."""
    scenes: Path = OUT / "test_objects"
    """Folder of the test scenes."""


@dataclass(frozen=True)
class Subject:
    """An object to paint, opened."""

    key: Name
    """One of `OBJECTS`."""
    scene: Scene
    """Nothing in it is painted."""
    picked: Tensor
    """The object's Gaussians."""
    sights: list[Sight]
    """Where it is judged."""
    capture: Capture | None
    """The photos."""
    outlines: Outlines | None
    """Where it exactly is."""

    @property
    def name(self) -> str:
        """What the scene calls it."""
        return OBJECTS[self.key].name


def main(options: Options) -> None:
    """Paint, judge, write the page."""
    settings = json.loads(options.settings)
    networks = judges()
    for key in options.objects or (tuple(OBJECTS) if options.all else ("fox",)):
        cells = list(wanted(key, options, settings))
        missing = [cell for cell in cells if options.again or not _file(options, cell).is_file()]
        if not missing:
            continue
        try:
            subject = opened(key, options)
        except FileNotFoundError as error:
            print(f"{key} is left out: {error}.")
            continue
        write_image(
            strip([sight.before for sight in subject.sights]),
            options.output / "crops" / f"{key}_before.png",
        )
        for cell in missing:
            print(_title(cell), flush=True)
            found = painted(subject, cell, options, settings, networks)
            write_json({**cell, **found}, _file(options, cell))
            write_page(options.output)
    write_page(options.output)
    print(f"\n{(options.output / 'table.md').read_text()}\n{options.output / 'index.html'}")


def judges() -> Networks:
    """The networks that NNFM goes by: VGG19 only where its weights are."""
    networks = {"compact": load_weights("compact", depth=3)}
    return networks | ({"vgg19": load_weights("vgg19", VGG19)} if VGG19.is_file() else {})


def wanted(key: Name, options: Options, settings: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """What is to be on the page of an object."""
    names = options.paintings or ((*SHIPPED, *DRAWN) if options.all else ("night",))
    more = " ".join(f"{name}={value}" for name, value in settings.items())
    for painting in names:
        for seed in options.seeds:
            values = (key, painting, options.quality, seed, more)
            yield dict(zip(KEYS, values, strict=True))


def opened(key: Name, options: Options) -> Subject:
    """An object of a test scene, which is made if it has to be."""
    scene = find_scene(OBJECTS[key].scene, options.scenes)
    picked = scene.to_splats(find_object(scene, OBJECTS[key].name))
    training, held_out = scene.working_views()
    sights = find_sights(scene.splats, held_out or training, picked, options.views)
    capture = photos_of(scene)
    return Subject(key, scene, picked, sights, capture, find_outlines(key, scene, capture))


def painted(
    subject: Subject,
    cell: Mapping[str, Any],
    options: Options,
    settings: Mapping[str, Any],
    networks: Networks,
) -> dict[str, Any]:
    """Paint an object, keep its crops, and judge them."""
    file = find_painting(cell["painting"], options.output / "paintings")
    style = ss.Style(file, quality=options.quality, seed=cell["seed"], **settings)
    start, processor = time.perf_counter(), time.process_time()
    after = ss.stylize(subject.scene, {subject.name: style})
    spent = {
        "s": after.metrics["seconds"],
        "call s": time.perf_counter() - start,
        "CPU s": time.process_time() - processor,
    }
    before, picture = subject.scene.splats, read_style(file)
    images = [sight.shows(after.splats) for sight in subject.sights]
    write_image(strip(images), options.output / "crops" / f"{_slug(cell)}.png")
    training, held_out = subject.scene.working_views()
    rest = (images, picture, held_out or training, networks)
    figures = judge(before, after.splats, subject.picked, subject.sights, *rest)
    place = options.output / "crops" / f"{_slug(cell)}_stain.png"
    place.unlink(missing_ok=True)
    if subject.outlines is not None:
        figures |= outline_figures(before, after.splats, *subject.outlines)
    else:
        figures |= stain(subject, after, place)
    if options.target_steps:
        figures |= way(subject, cell["painting"], images, picture, options, networks)
    return {"commit": commit(), "machine": machine(), "figures": figures | spent}


def stain(subject: Subject, after: Scene, place: Path) -> Figures:
    """How large the largest stain is; where there is one, its view before and after is kept."""
    if subject.capture is None:
        return {}
    before = subject.scene
    device = before.splats.device
    found = largest_stain(before, after, [subject.name], subject.capture, device)
    if "stain_view" in found:
        cameras = before.cameras.downscale(before.downscale)
        camera = cameras[cameras.index(str(found["stain_view"]))]
        pair = [render(each.splats, camera)[0].clamp(0, 1) for each in (before, after)]
        write_image(strip(pair), place)
    return {"stain px": int(found["stain_pixels"])} if found else {}


def way(
    subject: Subject,
    painting: str,
    images: Sequence[Tensor],
    picture: Tensor,
    options: Options,
    networks: Networks,
) -> Figures:
    """The share of the way from before to the best pixels that is done, at each size."""
    network = list(networks.values())[-1]
    rows = evenly_spaced(range(len(subject.sights)), options.target_views)
    sights = [subject.sights[row] for row in rows]
    best = targets(subject, painting, sights, picture, options, networks)
    found = {}
    for size, share in SIZES.items():
        before, after, there = (
            mean(nnfm_of_views(sights, shown, picture, network, share))
            for shown in ([s.before for s in sights], [images[row] for row in rows], best)
        )
        found[f"way {size}"] = (before - after) / (before - there)
    return found


def targets(
    subject: Subject,
    painting: str,
    sights: Sequence[Sight],
    picture: Tensor,
    options: Options,
    networks: Networks,
) -> list[Tensor]:
    """The best pixels of some views, which are kept beside the scenes: they cost minutes."""
    name, network = list(networks.items())[-1]
    found = []
    for number, sight in enumerate(sights):
        stem = f"{subject.key}_{Path(painting).stem}_{name}_{options.target_steps}_{number}"
        path = OUT / "targets" / f"{stem}.npy"
        if not path.is_file():
            sizes = [(z, painting_features(sights, picture, network, z)) for z in TARGET_SIZES]
            palette = resized(picture, min(1.0, 200 / max(picture.shape[:2]))).reshape(-1, 3)
            pixels = target_2d(sight, palette, sizes, network, options.target_steps)
            path.parent.mkdir(parents=True, exist_ok=True)
            np.save(path, pixels.half().numpy())
        found.append(torch.from_numpy(np.load(path)).float())
    return found


def strip(images: Sequence[Tensor]) -> Tensor:
    """Pictures beside each other, as bytes."""
    height = max(len(image) for image in images)
    parts = []
    for image in images:
        part = torch.full((height, image.shape[1] + GAP, 3), PAGE)
        part[: len(image), : image.shape[1]] = image
        parts.append(part)
    return to_uint8(torch.cat(parts, dim=1))


def commit() -> str:
    """What of the program this is."""
    command = ["git", "describe", "--always", "--dirty"]
    found = subprocess.run(command, cwd=Path(__file__).parent, capture_output=True, text=True)
    return found.stdout.strip()


def write_page(folder: Path) -> None:
    """Write the page and the table of all that the folder has."""
    files = sorted((folder / "cells").glob("*.json"))
    cells = [json.loads(file.read_text(encoding="utf-8")) for file in files]
    order = {key: number for number, key in enumerate(OBJECTS)}
    cells.sort(key=lambda cell: (order.get(cell["object"], len(order)), *map(str, _key(cell))))
    heads, rows = columns(cells)
    (folder / "table.md").write_text(table(heads, rows) + "\n", encoding="utf-8")
    parts = [HEAD, _html_table(heads, rows)]
    for key in dict.fromkeys(cell["object"] for cell in cells):
        parts.append(
            f'<h2>{escape(key)}</h2><div class="row">{_image(f"crops/{key}_before.png")}</div>'
        )
        for cell in cells:
            if cell["object"] == key:
                parts += [*_cell_parts(folder, cell)]
    (folder / "index.html").write_text("\n".join(parts), encoding="utf-8")


def columns(cells: Sequence[Mapping[str, Any]]) -> tuple[list[str], list[list[str]]]:
    """The table's heads and rows, without what no cell says; the last row has the means."""
    keys = [k for k in KEYS if k in KEYS[:2] or len({cell[k] for cell in cells}) > 1]
    names = [n for n in COLUMNS if any(n in cell["figures"] for cell in cells)]
    rows = [
        [*(str(cell[k]) for k in keys), *(digits(cell["figures"].get(n)) for n in names)]
        for cell in cells
    ]
    if len(cells) > 1:
        known = [[c["figures"][n] for c in cells if n in c["figures"]] for n in names]
        rows.append(["mean", *[""] * (len(keys) - 1), *(digits(mean(each)) for each in known)])
    return [*keys, *names], rows


def digits(value: float | None) -> str:
    """Three digits; what is not known is left empty."""
    return "" if value is None else f"{value:.3g}" if abs(value) < 100 else f"{value:.0f}"


def _cell_parts(folder: Path, cell: Mapping[str, Any]) -> Iterator[str]:
    """What the page says of one painted object."""
    heads, rows = columns([cell])
    yield f"<h3>{escape(_title(cell))}</h3>{_html_table(heads[2:], [row[2:] for row in rows])}"
    yield f"<p>{escape(cell['commit'])}; {escape(cell['machine'])}</p>"
    yield f'<div class="row">{_image(_thumbnail(folder, cell["painting"]))}</div>'
    yield f'<div class="row">{_image(f"crops/{_slug(cell)}.png")}</div>'
    place = f"crops/{_slug(cell)}_stain.png"
    if (folder / place).is_file():
        yield f'<p>The view with the largest stain:</p><div class="row">{_image(place)}</div>'


def _thumbnail(folder: Path, painting: str) -> str:
    """The place in the folder of a small picture of a painting."""
    place = f"paintings/{Path(painting).stem}_small.png"
    if not (folder / place).is_file():
        picture = read_style(find_painting(painting, folder / "paintings"))
        small = resized(picture, min(1.0, THUMBNAIL / max(picture.shape[:2])))
        write_image(to_uint8(small), folder / place)
    return place


def _image(place: str) -> str:
    return f'<img loading="lazy" src="{quote(place)}">'


def _html_table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = ["".join(f"<th>{escape(head)}</th>" for head in heads)]
    lines += ["".join(f"<td>{escape(value)}</td>" for value in row) for row in rows]
    return f"<table>{''.join(f'<tr>{line}</tr>' for line in lines)}</table>"


def _key(cell: Mapping[str, Any]) -> list[Any]:
    return [cell[key] for key in KEYS]


def _title(cell: Mapping[str, Any]) -> str:
    return f"{cell['object']}, {cell['painting']}, {cell['quality']}, seed {cell['seed']}" + (
        f", {cell['settings']}" if cell["settings"] else ""
    )


def _slug(cell: Mapping[str, Any]) -> str:
    """A file's name that tells the cell from others."""
    words = [Path(cell["painting"]).stem if k == "painting" else str(cell[k]) for k in KEYS]
    return re.sub(r"[^\w.-]+", "-", "_".join(filter(None, words)))


def _file(options: Options, cell: Mapping[str, Any]) -> Path:
    return options.output / "cells" / f"{_slug(cell)}.json"


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
