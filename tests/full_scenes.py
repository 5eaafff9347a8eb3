"""A scene of six Gaussians that has everything, and whether two scenes are the same."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import torch

from stylesplat.scene.cameras import Cameras
from stylesplat.scene.paintings import Gone, Looks, Painted, Painting, Source
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
    return replace(
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
        painted=painted(),
    )


def painted() -> Painted:
    picture = Source(Path("/pictures/wave.jpg"), "12ab")
    settings = {"steps": 5, "scale": 2.0, "layers": [3], "intensity": 1.0}
    fox = Painting("fox", torch.arange(COUNT) < 2, (picture,), settings, 0.7, "compact")
    other = Painting(
        name="7",
        picked=torch.arange(COUNT) == 4,
        styles=(picture, Source(None, "34cd")),
        settings={**settings, "steps": 9},
        intensity=1.0,
        features="vgg19",
        weights=Source(Path("/nets/vgg19.pth"), "56ef"),
        upon={"fox": 0.5},
    )
    opacities = plain_scene().splats.opacities
    laid = torch.where(torch.arange(COUNT) == 1, -16.0, opacities)
    before = Looks(random(COUNT, 1, 3), random(COUNT, 15, 3), laid)
    full = Looks(random(COUNT, 1, 3) + 1, random(COUNT, 15, 3) + 1, opacities)
    gone = (Gone(replace(other, name="fox", picked=other.picked[:0], upon={}), 0),)
    return Painted((fox, other), before, full, origin=Path("/scenes/trained"), gone=gone)


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
