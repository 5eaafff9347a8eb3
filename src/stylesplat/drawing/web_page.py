"""A web page that holds a splat and what draws it, for any browser, without a server or network."""

import json
import re
from base64 import b64encode
from collections.abc import Iterator
from html import escape
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Bool
from torch import Tensor

from stylesplat.drawing.first_view import first_view
from stylesplat.drawing.packed import pack
from stylesplat.errors import StyleSplatError
from stylesplat.rendering.constants import MIN_ALPHA
from stylesplat.scene.content import extent_of
from stylesplat.scene.scene import Scene
from stylesplat.scene.splats import Splats

PARTS = Path(__file__).with_name("viewer_page")
CODE = ("unpack.js", "sort.js", "draw.js", "camera.js", "hands.js", "main.js")


def page_of(what: Scene | Splats, *, title: str, sh_degree: int = 3) -> str:
    """A page that shows splats, from the first photo or from where all is in sight.

    Of a scene that is painted, a handle lies between the colours before and after; buttons bring
    each object into sight.

    Args:
        what: A scene, or splats alone, of which nobody knows what is up.
        title: Of the page.
        sh_degree: Up to which degree, 0 to 3, colours depend on where they are seen from.

    Raises:
        StyleSplatError: If nothing shows.
    """
    scene = what if isinstance(what, Scene) else None
    splats = (scene.splats if scene else what).detach().to("cpu")
    if not (torch.sigmoid(splats.opacities) >= MIN_ALPHA).any():
        raise StyleSplatError("These splats are empty, so there is nothing to show on a page.")
    before = scene.unpainted.detach().to("cpu") if scene else splats
    packed = pack(splats, before, sh_degree=sh_degree)
    view = first_view(splats, scene.cameras if scene else None)
    start = {name: getattr(view, name).tolist() for name in ("position", "target", "up")}
    about = packed.about | {
        "start": start | {"slopes": view.slopes},
        "objects": list(_objects(scene)) if scene else [],
    }
    return _filled(
        {
            "title": escape(title),
            "about": json.dumps(about).replace("<", r"\u003c"),
            "splats": b64encode(packed.content).decode(),
            "code": "\n".join(_part(name) for name in CODE),
        }
    )


def _objects(scene: Scene) -> Iterator[dict[str, Any]]:
    """What objects are called, and where they are."""
    painted = {each.name: each.picked for each in scene.painted.paintings} if scene.painted else {}
    named = {name: each.picked for name, each in scene.objects.items()}
    for name, picked in {**painted, **named}.items():
        if picked.any():
            yield _object(scene, name, picked) | {"painted": name in painted}


def _object(scene: Scene, name: str, picked: Bool[Tensor, " N"]) -> dict[str, Any]:
    extent = extent_of(scene.splats, picked)
    radius = float(extent.size.norm()) / 2
    return {"name": name, "centre": extent.centre.tolist(), "radius": radius}


def _filled(values: dict[str, str]) -> str:
    """The page, with values or files for the names between @ and @."""
    return re.sub(r"@([\w.]+)@", lambda found: values.get(found[1]) or _part(found[1]), _part("page.html"))


def _part(name: str) -> str:
    return (PARTS / name).read_text(encoding="utf-8")
