"""Scenes of Gaussian balls whose objects are known exactly: bare, striped, stretched, painted."""

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from PIL import Image
from torch import Tensor
from torch.nn import functional as F

from scenes import cloud, randn
from stylesplat.imaging.similarity import mask_iou
from stylesplat.io import scene_folder
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.layers import Layer
from stylesplat.scene.objects import SceneObject
from stylesplat.scene.scene import Scene
from stylesplat.scene.splats import IDENTITY_SIZE, Classifier, Splats, sh0_from_rgb
from stylesplat.scene.virtual_cameras import ring_cameras
from stylesplat.selection.labels import render_labels
from stylesplat.stylization.config import PLANS, StyleConfig
from stylesplat.stylization.features import FeatureNetwork
from stylesplat.stylization.painting import Painting, paint_setup
from stylesplat.stylization.style import Style
from stylesplat.stylization.views import ObjectBox, ObjectView, object_views
from stylesplat.verbs.stylize import stylize

BALLS = {  # label id: centre (x right, y forward, z up) and colour
    3: ((-0.7, 0.0, 0.3), (0.9, 0.1, 0.1)),
    7: ((0.7, 0.0, 0.3), (0.1, 0.8, 0.1)),
    300: ((0.0, 0.8, 0.3), (0.1, 0.2, 0.9)),
}
BALL_RADIUS = 0.3
SHARPNESS = 12.0  # logit of a Gaussian's own class; background wins where nothing is
CLASSIFIER = Classifier(
    weight=SHARPNESS * torch.eye(IDENTITY_SIZE)[: len(BALLS) + 1],
    bias=torch.tensor([SHARPNESS / 2] + [0.0] * len(BALLS)),
    ids=(0, *BALLS),
)


def viewmat_from(position: tuple[float, float, float]) -> torch.Tensor:
    """World to camera, OpenCV axes, looking at the origin with z up."""
    origin = torch.tensor(position)
    forward = -origin / origin.norm()
    right = torch.linalg.cross(forward, torch.tensor([0.0, 0.0, 1.0]))
    right = right / right.norm()
    viewmat = torch.eye(4)
    viewmat[:3, :3] = torch.stack([right, torch.linalg.cross(forward, right), forward])
    viewmat[:3, 3] = -viewmat[:3, :3] @ origin
    return viewmat


def _cameras() -> Cameras:
    """Eight cameras on a circle of radius 3 at height 1.5, 48x36 pixels."""
    angles = [2 * math.pi * i / 8 for i in range(8)]
    viewmats = [viewmat_from((-3 * math.sin(a), -3 * math.cos(a), 1.5)) for a in angles]
    K = torch.tensor([[50.0, 0.0, 24.0], [0.0, 50.0, 18.0], [0.0, 0.0, 1.0]])
    return Cameras(
        viewmats=torch.stack(viewmats),
        Ks=K.expand(8, 3, 3).clone(),
        sizes=torch.tensor([48, 36]).expand(8, 2).clone(),
        names=tuple(f"{i:04d}.jpg" for i in range(8)),
    )


def enlarged(cameras: Cameras, factor: int) -> Cameras:
    """The same views with so many times more pixels each way."""
    Ks = cameras.Ks.clone()
    Ks[:, :2] *= factor
    return replace(cameras, Ks=Ks, sizes=factor * cameras.sizes)


def _splats() -> Splats:
    """A grey table (background) and three balls; class k has the k-th unit vector as identity."""
    generator = torch.Generator().manual_seed(0)
    table = torch.rand(200, 3, generator=generator) * torch.tensor([2.4, 2.4, 0.0]) - 1.2
    table[:, 2] = 0.0
    means, colors, classes = [table], [torch.full((200, 3), 0.5)], [torch.zeros(200)]
    for number, (centre, color) in enumerate(BALLS.values(), start=1):
        dirs = torch.nn.functional.normalize(torch.randn(80, 3, generator=generator), dim=-1)
        means.append(torch.tensor(centre) + BALL_RADIUS * dirs)
        colors.append(torch.tensor(color).expand(80, 3))
        classes.append(torch.full((80,), float(number)))
    labels = torch.cat(classes).long()
    return replace(
        cloud(torch.cat(means), 0.07, opacity=3.0),
        sh0=sh0_from_rgb(torch.cat(colors))[:, None],
        identities=torch.eye(IDENTITY_SIZE)[labels],
        classifier=CLASSIFIER,
    )


SPLATS, CAMERAS = _splats(), _cameras()
ROWS = torch.arange(len(SPLATS))
TABLE, BALL = 200, 80  # Gaussians before the balls, and of each


def ball(number: int) -> torch.Tensor:
    return (ROWS >= TABLE + BALL * number) & (ROWS < TABLE + BALL * (number + 1))


RED, GREEN, BLUE = ball(0), ball(1), ball(2)


def class_probabilities(splats: Splats) -> Tensor:
    """The softmax of each Gaussian over the classes of the classifier."""
    assert splats.identities is not None and splats.classifier is not None
    return splats.classifier.logits(splats.identities).softmax(dim=-1)


# The balls as a splat that came without photos, and boxes around them in its views.

PLAIN = replace(SPLATS, identities=None, classifier=None)
VIEWS = ring_cameras(SPLATS, torch.tensor([0.0, 0.0, 1.0])).downscale(8)  # 120x90
BARE = Scene(PLAIN, VIEWS)


def box_around(mask: Tensor, margin: int) -> tuple[float, float, float, float]:
    """The edges of a box around a mask, some pixels apart, within the picture."""
    places = mask.nonzero()
    low = (places.amin(dim=0) - margin).clamp(min=0)
    high = torch.minimum(places.amax(dim=0) + 1 + margin, torch.tensor(mask.shape))
    return float(low[1]), float(low[0]), float(high[1]), float(high[0])


def around(id: int, view: str) -> tuple[str, tuple[float, float, float, float]]:
    """A box around a ball in a view."""
    return view, box_around(render_labels(SPLATS, VIEWS[VIEWS.index(view)]) == id, 3)


def agreement(picked: torch.Tensor, id: int) -> float:
    return mask_iou(picked, ball([*BALLS].index(id)))


# The still life with a ball of small Gaussians in its midst, finer than what is painted on it.

COUNT = 1500  # Gaussians of the ball
CENTRE = torch.tensor([0.0, 0.0, 0.4])
WAYS = F.normalize(randn(COUNT, 3), dim=1)
LIGHT = 0.5 + 0.2 * WAYS[:, 2:].expand(-1, 3)  # from above
PICKED = torch.arange(len(SPLATS) + COUNT) >= len(SPLATS)


def dense_ball(colors: Tensor) -> Splats:
    """The still life with the ball in some colours, one for each of its Gaussians."""
    alike = SPLATS[ROWS.repeat(4)[:COUNT]]
    scales = torch.full((COUNT, 3), 0.02).log()
    means, sh0 = 0.4 * WAYS + CENTRE, sh0_from_rgb(colors)[:, None]
    return Splats.cat([SPLATS, replace(alike, means=means, scales=scales, sh0=sh0)])


# The balls with colours that depend on the view, and how one of them is quickly painted.

FAST = StyleConfig(steps=12, block=2, scale=1.5, object_size=24, quality="draft")
STRIPED_SCENE = replace(SPLATS, shN=0.1 * randn(len(SPLATS), 3, 3))


def same(one: Splats, other: Splats) -> bool:
    return all(torch.equal(t, other.tensors()[name]) for name, t in one.tensors().items())


def cropped(
    splats: Splats,
    boxes: Sequence[ObjectBox],
    mask: Tensor,
    network: FeatureNetwork,
    **options: Any,
) -> list[ObjectView]:
    """Views of some Gaussians, for the features of one block."""
    config = StyleConfig(block=options.pop("block", 2))
    painting = Painting("object", mask, (), config)
    setup = paint_setup(splats, CAMERAS, network)
    return object_views(setup, painting, boxes, options.pop("zoom", 1.0), **options)


def with_settings(job: Painting, **settings) -> Painting:
    return replace(job, config=replace(job.config, **settings))


# The balls with named objects, and quick ways to paint them.

PAINTED_FAST = StyleConfig(steps=3, block=1, object_size=30, intensity=0.6)
PICKS = {"red": RED, "green": GREEN, "blue": BLUE, "both": RED | GREEN}
TRAINED = Scene(
    base=replace(
        SPLATS,
        shN=0.1 * randn(len(SPLATS), 15, 3),
        confidence=ROWS / len(SPLATS),
    ),
    cameras=CAMERAS,
    held_out=CAMERAS.names[:1],
    objects={name: SceneObject(picked) for name, picked in PICKS.items()},
    metrics={"psnr": 30.0},
)


def write_pictures(folder: Path) -> tuple[Path, Path]:
    """Two pictures to paint with."""
    generator = torch.Generator().manual_seed(1)
    paths = folder / "wave.png", folder / "night.png"
    for number, path in enumerate(paths):
        pixels = torch.rand(64, 80, 3, generator=generator) * torch.tensor([1, number, 0.5])
        Image.fromarray((255 * pixels).byte().numpy()).save(path)
    return paths


def painted(
    scene: Scene,
    name: str,
    pictures: Sequence[Path | str] | Path | str,
    network: Any = None,
    *,
    measured: bool = True,
    **settings: Any,
) -> Scene:
    """A scene with one more object painted."""
    files = [pictures] if isinstance(pictures, Path | str) else pictures
    style = Style(*files, config=PAINTED_FAST, **settings)
    rest = {"device": "cpu", "measured": measured, **(network or {})}
    return stylize(scene, {name: style}, **rest)


QUICKLY = {
    "evaluation.style.LOOK_LENGTH": 30.0,  # pixels
    "stylization.canvas.CANVAS_STEPS": 4,
    "stylization.config.PATTERN_LENGTH": 48.0,  # pixels
    "stylization.config.PLANS": {
        quality: tuple(replace(row, steps=row.steps // 5) for row in rows)
        for quality, rows in PLANS.items()
    },
    "stylization.config.WINDOW": 64,  # pixels
    "stylization.form.FORM_ROUNDS": 1,
    "stylization.painter.BLUR_VIEWS": 2,
    "stylization.painter.WHOLE_VIEWS": 2,
    "stylization.views.WHOLE_VIEWS": 2,
}


@contextmanager
def painting_quickly() -> Iterator[None]:
    """All stages of painting at small sizes, with few views of the whole object."""
    with pytest.MonkeyPatch.context() as patch:
        for name, value in QUICKLY.items():
            patch.setattr(f"stylesplat.{name}", value)
        yield


def contents(folder: Path, *but: str) -> dict[str, bytes]:
    """The files of a scene, without some."""
    files = (path for path in folder.rglob("*") if path.is_file() and path.name not in but)
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def save_scene(folder: Path) -> Path:
    """Write the balls as a scene that is trained, with the first view held out."""
    scene = Scene(SPLATS, CAMERAS, held_out=CAMERAS.names[:1], metrics={"psnr": 30.0})
    scene_folder.save(scene, folder)
    return folder


def opened(path: Path) -> Scene:
    return scene_folder.open(path)


def layer_of(scene: Scene, name: str) -> Layer:
    """The layer of an object."""
    (found,) = (layer for layer in scene.layers if layer.object == name)
    return found


def own_rows(scene: Scene, name: str) -> torch.Tensor:
    """The Gaussians of a scene that belong to what a layer covers."""
    return scene.to_splats(layer_of(scene, name).covered(len(scene.base)))


def assert_same_layers(one: Scene, other: Scene) -> None:
    """To the bit."""
    assert len(one.layers) == len(other.layers)
    for mine, its in zip(one.layers, other.layers, strict=True):
        for name, value in vars(mine).items():
            found = getattr(its, name)
            if isinstance(value, torch.Tensor):
                assert torch.equal(value, found), name
            elif isinstance(value, Splats):
                assert_same_splats(value, found)
            else:
                assert value == found, name


def assert_same_splats(one: Splats, other: Splats) -> None:
    """To the bit."""
    assert one.tensors().keys() == other.tensors().keys()
    for name, tensor in one.tensors().items():
        assert torch.equal(tensor, other.tensors()[name]), name
    a, b = one.classifier, other.classifier
    assert (a is None) == (b is None)
    if a is not None and b is not None:
        assert a.ids == b.ids
        assert torch.equal(a.weight, b.weight) and torch.equal(a.bias, b.bias)


def assert_same_objects(one: Scene, other: Scene) -> None:
    """Names, Gaussians and how they were found."""
    assert one.objects.keys() == other.objects.keys()
    for name, each in one.objects.items():
        assert torch.equal(each.mask, other.objects[name].mask), name
        assert each.selection == other.objects[name].selection
