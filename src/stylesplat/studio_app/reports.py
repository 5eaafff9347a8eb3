"""What the page is told of the things in a scene: objects, layers, the selection, photos."""

from collections.abc import Iterable, Iterator
from typing import Any

import torch

from stylesplat.scene.content import Extent
from stylesplat.scene.layers import Layer
from stylesplat.scene.scene import Scene
from stylesplat.scene.world_offset import from_world
from stylesplat.studio_app import messages as m
from stylesplat.studio_app.edits import describe_settings, recoloring_of
from stylesplat.studio_app.gallery import Files, style_title
from stylesplat.studio_app.history import Selected, Step, StudioState
from stylesplat.studio_app.session import Session
from stylesplat.studio_app.thumbnails import ObjectThumbnails
from stylesplat.stylization.config import parse_guide

STUDIO_NEAREST = 0.1  # world units from a photo's camera to its target, at least
IN_PLACE = ("scale", "color", "quality", "guide_reach")  # settings of paint that a layer shows
EDITS = {"recolour": "recoloured"}


def object_info(session: Session, thumbnails: ObjectThumbnails, name: str) -> m.ObjectInfo:
    """What the page shows of an object."""
    state = session.state
    found = session.masks.has(state.scene, name)
    extent = session.masks.extent(state.scene, (name,)) if found else None
    return m.ObjectInfo(
        name=name,
        picked=name in state.picked,
        hidden=name in state.hidden,
        named=name in state.scene.objects,
        painted=name in state.scene.painted_objects,
        thumbnail=thumbnails.url(name) if found else "",
        count=int(session.masks.of(state.scene, name).sum()) if found else None,
        centre=vector(extent.centre) if extent else None,
        sides=vector(extent.size) if extent else None,
    )


def selection_info(selection: Selected, count: int, box: Extent) -> m.SelectionInfo:
    """What the page shows of a selection that is no object."""
    return m.SelectionInfo(
        count=count,
        soft=selection.is_soft,
        origin=selection.origin,
        centre=vector(box.centre),
        sides=vector(box.size),
    )


def layer_info(state: StudioState, layer: Layer) -> m.LayerInfo:
    """What the page shows of a layer."""
    is_paint, title = layer.kind == "paint", layer_title(layer)
    return m.LayerInfo(
        name=layer.name,
        object=layer.object,
        kind=layer.kind,
        title=title if is_paint else EDITS.get(layer.kind, layer.label or layer.object),
        strength=layer.strength,
        form=layer.form,
        visible=layer.visible,
        locked=layer.name in state.locked,
        solo=state.solo is not None and state.solo[0] == layer.name,
        blend=layer.blend,
        masked=layer.mask is not None,
        settings=describe_settings(layer.settings),
        values={k: v for k, v in layer.settings.items() if k in IN_PLACE} if is_paint else {},
        guides=guide_lines(state, layer),
        recolor={**recoloring_of(layer), "match": title} if layer.kind == "recolour" else None,
    )


def guide_lines(state: StudioState, layer: Layer) -> list[list[m.ViewVector]]:
    """The lines that a layer's strokes follow, for the page's camera."""
    lines = list[list[m.ViewVector]]()
    for guide in layer.settings.get("guides", ()):
        line = torch.tensor(parse_guide(guide), dtype=torch.float64).view(-1, 3)
        lines.append([vector(each) for each in from_world(line, state.scene.world_offset)])
    return lines


def layer_title(layer: Layer) -> str:
    """The names of the pictures whose style a layer has."""
    return ", ".join(style_title(each.path) for each in layer.styles)


def step_cards(files: Files, steps: Iterable[Step]) -> list[m.StepCard]:
    """What the page shows of steps."""
    return [
        m.StepCard(each.number, each.note, files.add(each.picture) if each.picture else "")
        for each in steps
    ]


def photo_views(scene: Scene, middle: torch.Tensor) -> Iterator[dict[str, Any]]:
    """Where each photo was taken, and how its camera stood."""
    for camera in (scene.cameras[row] for row in range(len(scene.cameras))):
        position, axes = camera.positions[0].double(), camera.viewmats[0, :3, :3].double()
        distance = max(float((middle - position) @ axes[2]), STUDIO_NEAREST)
        places = {"position": position, "target": position + distance * axes[2]}
        places |= {"right": axes[0], "down": axes[1]}
        places["slopes"] = camera.sizes[0] / camera.Ks[0].diagonal()[:2]
        yield {"name": camera.names[0], **{key: each.tolist() for key, each in places.items()}}


def vector(values: torch.Tensor) -> m.ViewVector:
    x, y, z = values.tolist()
    return x, y, z
