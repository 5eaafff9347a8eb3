"""A scene of six Gaussians that has everything, and whether two scenes are the same."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import torch

from plain_layers import SETTINGS, plain_layer
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.compose import with_layers
from stylesplat.scene.layer import Layer, Source
from stylesplat.scene.scene import Scene, SceneObject
from stylesplat.scene.splats import Classifier, Splats

COUNT = 6


def random(*shape: int) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(sum(shape)))


def plain_scene(dtype: torch.dtype = torch.float32) -> Scene:
    splats = Splats(
        means=random(COUNT, 3),
        quats=random(COUNT, 4),
        scales=random(COUNT, 3),
        opacities=random(COUNT),
        sh0=random(COUNT, 1, 3),
        shN=random(COUNT, 15, 3),
    )
    viewmats = torch.eye(4, dtype=dtype).repeat(2, 1, 1)
    viewmats[:, :3, :3] = torch.linalg.qr(random(2, 3, 3).to(dtype))[0]
    viewmats[:, :3] *= torch.linalg.det(viewmats[:, :3, :3])[:, None, None]  # no reflections
    viewmats[:, :3, 3] = random(2, 3).to(dtype) / 3
    Ks = torch.eye(3, dtype=dtype).repeat(2, 1, 1)
    Ks[:, 0, 0], Ks[:, 1, 1] = 700 / 3, 2000 / 3
    Ks[:, :2, 2] = random(2, 2).to(dtype) + 1000 / 3
    cameras = Cameras(
        viewmats=viewmats,
        Ks=Ks,
        sizes=torch.tensor([[640, 480], [500, 400]]),
        names=("a.jpg", "sub/b.png"),
    )
    return Scene(splats, cameras)


def full_scene() -> Scene:
    scene = plain_scene()
    classifier = Classifier(random(3, 16), random(3), ids=(0, 7, 70000))
    nothing = torch.zeros(COUNT, dtype=torch.bool)
    bare = replace(
        scene,
        splats=replace(
            scene.splats,
            identities=random(COUNT, 16),
            classifier=classifier,
            confidence=random(COUNT).sigmoid(),
        ),
        objects={
            "fox": SceneObject(torch.arange(COUNT) % 2 == 0, {"ids": [7], "count": 3}),
            "a name": SceneObject(nothing, {"count": 0}),
        },
        held_out=("a.jpg",),
        capture=Path("garden"),
        info={"settings": {"steps": 500}},
        metrics={"psnr": 30.5},
    )
    return with_layers(bare, layers(bare.splats))


def layers(base: Splats) -> tuple[Layer, ...]:
    fox = plain_layer(base, torch.arange(2), "fox", canvas=3, seed=4, strength=0.7, form=0.4)
    other = plain_layer(
        base,
        torch.tensor([4]),
        "7",
        seed=5,
        styles=(*fox.styles, Source(None, "34cd")),
        settings={**SETTINGS, "steps": 9},
        features="vgg19",
        weights=Source(Path("/nets/vgg19.pth"), "56ef"),
        precision="float32",
    )
    hidden = plain_layer(base, torch.arange(3, 6), "Brücke", canvas=2, seed=6)
    return fox, other, replace(hidden, visible=False, shN=0 * hidden.shN)


def contents(folder: Path) -> dict[str, bytes]:
    files = (path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def tensors_in(value: object) -> Iterator[torch.Tensor]:
    """All of a noun and of what it holds, in order."""
    if isinstance(value, torch.Tensor):
        yield value
    elif isinstance(value, dict):
        for item in value.values():
            yield from tensors_in(item)
    elif isinstance(value, tuple):
        for item in value:
            yield from tensors_in(item)
    elif hasattr(value, "__dataclass_fields__"):
        yield from tensors_in(vars(value))


def plain_in(value: object) -> object:
    """A noun without its tensors, as what can be compared."""
    if isinstance(value, torch.Tensor):
        return tuple(value.shape), value.dtype
    if isinstance(value, dict):
        return {name: plain_in(item) for name, item in value.items()}
    if isinstance(value, tuple):
        return tuple(map(plain_in, value))
    if hasattr(value, "__dataclass_fields__"):
        return type(value), plain_in(vars(value))
    return value


def assert_same(found: Scene, scene: Scene) -> None:
    """Everything is, but for the folder."""
    found, scene = replace(found, path=None), replace(scene, path=None)
    assert plain_in(found) == plain_in(scene)
    pairs = zip(tensors_in(found), tensors_in(scene), strict=True)
    assert all(torch.equal(one, other) for one, other in pairs)
