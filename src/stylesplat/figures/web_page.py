"""A web page that holds a splat and what draws it, for any browser, without a server or network."""

import json
import re
from base64 import b64encode
from collections.abc import Iterator
from html import escape
from pathlib import Path
from typing import Any

import torch

from stylesplat.errors import StyleSplatError, check_choice
from stylesplat.figures.orbits import first_view
from stylesplat.figures.packed import pack
from stylesplat.io.atomic import atomic_path, refuse_file
from stylesplat.io.splats.splat_files import say_left_out
from stylesplat.rendering.gaussians import MIN_ALPHA
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.compose import mask_of, splats_without_paint
from stylesplat.scene.content import extent_of
from stylesplat.scene.scene import Scene
from stylesplat.scene.splats import Splats

PARTS = Path(__file__).with_name("viewer_page")
SUFFIX = ".html"
MAX_DEGREE = 3
MODULAR = re.compile(r"^(import .*\n|export )", re.MULTILINE)  # needless in one script
CODE = ("unpack.js", "sort.js", "draw.js", "camera.js", "hands.js", "main.js")


def write_page(
    what: Scene | Splats, path: Path, *, overwrite: bool = False, sh_degree: int | None = None
) -> None:
    """Write the page of `page_of`, called like its file."""
    degree = MAX_DEGREE if sh_degree is None else sh_degree
    check_choice(degree, "degree of colour", range(MAX_DEGREE + 1))
    refuse_file(path, overwrite=overwrite)
    page = page_of(what, title=path.stem, sh_degree=degree)
    with atomic_path(path) as temporary:
        temporary.write_text(page, encoding="utf-8")
    say_left_out(what.splats if isinstance(what, Scene) else what, path)


def page_of(what: Scene | Splats, *, title: str, sh_degree: int = MAX_DEGREE) -> str:
    """A page that shows splats, from the first photo or from where all is in sight.

    Of a scene that is painted, a handle lies between before and after; buttons bring each object
    into sight. Colours depend on the direction of view up to `sh_degree`, 0 to 3.
    """
    scene = what if isinstance(what, Scene) else None
    splats = (what.splats if isinstance(what, Scene) else what).detach().to("cpu")
    if not (torch.sigmoid(splats.opacities) >= MIN_ALPHA).any():
        raise StyleSplatError("No Gaussian shows, so a page would be black. Choose another scene.")
    before = splats_without_paint(scene).detach().to("cpu") if scene else splats
    packed = pack(splats, before, sh_degree=sh_degree)
    about = packed.about | {
        "start": start_of(splats, scene.cameras if scene else None),
        "objects": list(_objects(scene)) if scene else [],
    }
    return _filled(
        {
            "title": escape(title),
            "about": json.dumps(about).replace("<", r"\u003c"),
            "splats": b64encode(packed.content).decode(),
            "code": "\n".join(MODULAR.sub("", _part(name)) for name in CODE),
        }
    )


def start_of(splats: Splats, cameras: Cameras | None) -> dict[str, Any]:
    """The first view as `camera.js` takes it."""
    view = first_view(splats, cameras)
    places = {"position": view.position, "target": view.target, "up": view.up}
    return {name: place.tolist() for name, place in places.items()} | {"slopes": view.slopes}


def _objects(scene: Scene) -> Iterator[dict[str, Any]]:
    """What objects are called, and where they are."""
    painted = {layer.object: mask_of(layer, scene) for layer in scene.layers}
    named = {name: each.picked for name, each in scene.objects.items()}
    for name, picked in {**painted, **named}.items():
        if picked.any():
            extent = extent_of(scene.splats, picked)
            radius, is_painted = float(extent.size.norm()) / 2, name in painted
            yield {
                "name": name,
                "centre": extent.centre.tolist(),
                "radius": radius,
                "painted": is_painted,
            }


def _filled(values: dict[str, str]) -> str:
    """The page, with values or files in the place of names between @ and @."""

    def value(found: re.Match[str]) -> str:
        return values[found[1]] if found[1] in values else _part(found[1])

    return re.sub(r"@([\w.]+)@", value, _part("page.html"))


def _part(name: str) -> str:
    return (PARTS / name).read_text(encoding="utf-8")
