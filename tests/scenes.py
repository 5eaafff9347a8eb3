"""Small splats and scenes from a seed, whole ones with layers, and the files that hold them."""

import json
import math
import struct
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from stylesplat.scene.cameras import Cameras
from stylesplat.scene.content import Content
from stylesplat.scene.layers import Layer, Source, appearance_only
from stylesplat.scene.objects import SceneObject
from stylesplat.scene.projection import is_in_image
from stylesplat.scene.scene import Scene
from stylesplat.scene.selection import Selection
from stylesplat.scene.splats import Classifier, Splats


def random_splats(count: int = 200, *, seed: int = 0, sh_degree: int = 3) -> Splats:
    """A cloud around the origin with opaque and faint, round and long Gaussians."""
    generator = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=generator)

    return Splats(
        means=0.6 * normal(count, 3),
        quats=normal(count, 4),
        scales=0.5 * normal(count, 3) - 2.3,
        opacities=2 * normal(count) + 1,
        sh0=normal(count, 1, 3),
        shN=0.3 * normal(count, (sh_degree + 1) ** 2 - 1, 3),
        identities=normal(count, 16),
    )


def write_checkpoint(splats: Splats, path: Path) -> None:
    """The file of gsplat's `simple_trainer`."""
    names = ("means", "quats", "scales", "opacities", "sh0", "shN")
    torch.save({"step": 6999, "splats": {name: getattr(splats, name) for name in names}}, path)


def two_cameras() -> Cameras:
    """Two views of the origin whose sizes are no multiples of a tile."""
    viewmats = torch.eye(4).repeat(2, 1, 1)
    viewmats[:, 2, 3] = torch.tensor([3.0, 2.0])
    viewmats[1, 0, 3] = 0.2
    K = torch.tensor([[60.0, 0.0, 33.0], [0.0, 70.0, 25.0], [0.0, 0.0, 1.0]])
    sizes = torch.tensor([[70, 52], [70, 52]])
    return Cameras(viewmats, K.repeat(2, 1, 1), sizes, ("first.png", "second.png"))


def rand(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed))


def randn(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


def weigh_and_backward(*images: torch.Tensor) -> None:
    """Gradients of a loss that weighs every number of some images."""
    generator = torch.Generator().manual_seed(1)
    for image in images:
        weights = torch.randn(image.shape, generator=generator, dtype=torch.float64)
        (image * weights.to(image)).sum().backward(retain_graph=True)


def leaf(splats: Splats, dtype: torch.dtype) -> Splats:
    """Copies of the tensors that collect gradients."""
    tensors = {k: t.to(dtype, copy=True).requires_grad_() for k, t in splats.tensors().items()}
    return replace(splats, **tensors)


BACKENDS = [
    "cpu",
    pytest.param("cuda", marks=pytest.mark.emulated),
    pytest.param("gsplat", marks=pytest.mark.cuda),
]
"""The backends that are compared with the reference."""


def device_of(backend: str) -> str:
    """Where a backend's tensors are; without a GPU our kernels are emulated on the CPU."""
    on_gpu = backend in ("cuda", "gsplat") and torch.cuda.is_available()
    return "cuda" if on_gpu else "cpu"


# Splats of other programs, as they come without photos: things of several shapes.

UP = torch.tensor([0.0, 0.0, 1.0])


def cloud(points: torch.Tensor, sigma: float = 0.01, opacity: float = 2.0) -> Splats:
    """Round grey Gaussians at some places."""
    count = len(points)
    return Splats(
        means=points.float(),
        quats=torch.tensor([1.0, 0.0, 0.0, 0.0]).repeat(count, 1),
        scales=torch.full((count, 3), math.log(sigma)),
        opacities=torch.full((count,), opacity),
        sh0=torch.zeros(count, 1, 3),
        shN=torch.zeros(count, 0, 3),
    )


def joined(*splats: Splats) -> Splats:
    """All of them as one."""
    return Splats.cat(splats)


def box(count: int, low: list[float], high: list[float], seed: int = 0) -> torch.Tensor:
    """Points within a box."""
    corner, opposite = torch.tensor(low), torch.tensor(high)
    return corner + (opposite - corner) * rand(count, 3, seed=seed)


def shell(count: int, radius: float, seed: int = 0) -> torch.Tensor:
    """Points on a sphere around the origin."""
    return radius * torch.nn.functional.normalize(randn(count, 3, seed=seed), dim=1)


def guitar() -> Splats:
    """A body of 0.3 with most of the Gaussians, and a thin neck: 1 x 0.3 x 0.1 in all."""
    body = box(3000, [-0.15, -0.05, 0.0], [0.15, 0.05, 0.4])
    neck = box(250, [-0.02, -0.02, 0.4], [0.02, 0.02, 0.92], seed=1)
    head = box(50, [-0.05, -0.02, 0.92], [0.05, 0.02, 1.0], seed=2)
    return cloud(torch.cat([body, neck, head]))


def figure() -> Splats:
    """Upright, 1.8 tall and 0.5 wide."""
    return cloud(box(4000, [-0.25, -0.15, 0.0], [0.25, 0.15, 1.8], seed=3))


def floaters() -> Splats:
    """Far and opaque: single ones everywhere, and a clump of them."""
    clump = box(200, [29.8, -0.1, 4.9], [30.0, 0.1, 5.1], seed=4)
    return cloud(torch.cat([box(300, [-60] * 3, [60] * 3, seed=5), clump]), 0.2, opacity=6.0)


def painting() -> Splats:
    """Flat: 1.6 x 1 on a wall."""
    return cloud(box(3000, [-0.8, -0.002, 0.0], [0.8, 0.002, 1.0], seed=6))


def room() -> Splats:
    """Things on a table of 1 x 1 in a room of 6 x 6 x 3, whose walls are blurred."""
    things = box(6000, [-0.5, -0.5, 0.0], [0.5, 0.5, 0.4], seed=7)
    walls = box(1500, [-3.0, -3.0, -1.0], [3.0, 3.0, 2.0], seed=8)
    side, axis = torch.arange(len(walls)) % 2, torch.arange(len(walls)) // 2 % 3
    ends = torch.tensor([[-3.0, -3.0, -1.0], [3.0, 3.0, 2.0]])
    walls[torch.arange(len(walls)), axis] = ends[side, axis]
    return joined(cloud(things), cloud(walls, 0.2, opacity=4.0))


def shares(
    cameras: Cameras, points: torch.Tensor, weights: torch.Tensor | None = None
) -> list[float]:
    """The share of some points' weight that lies inside each view."""
    weights = torch.ones(len(points)) if weights is None else weights
    points = points.double()
    return [
        float(weights[is_in_image(points, cameras[row])].sum() / weights.sum())
        for row in range(len(cameras))
    ]


def reaches(content: Content) -> list[float]:
    """The corners of the box around content."""
    return [*content.extent.low.tolist(), *content.extent.high.tolist()]


# Layers of random paint, made without painting.

SETTINGS = {"steps": 5, "scale": 2.0, "layers": [3], "intensity": 1.0}


def plain_layer(
    base: Splats, rows: torch.Tensor, name: str, *, surfels: int = 0, seed: int = 0, **fields: Any
) -> Layer:
    """A layer on some rows, with so many new Gaussians, half of whose rows fade."""
    generator = torch.Generator().manual_seed(seed)
    bands, count = base.shN.shape[1:], len(rows)

    def noise(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=generator)

    factors = torch.rand(count, generator=generator)
    new = appearance_only(random_splats(surfels, seed=seed + 1))
    new = replace(new, shN=0.1 * noise(surfels, *bands))
    picks = torch.randint(count, (surfels,), generator=generator)
    layer = Layer(
        object=name,
        rows=rows,
        shares=torch.rand(count, generator=generator),
        sh0=noise(count, 1, 3),
        shN=noise(count, *bands),
        opacity_factors=torch.where(torch.arange(count) % 2 == 0, factors, 1.0),
        surfels=new,
        surfels_sh0=noise(surfels, 1, 3),
        parents=rows[picks],
        relief=noise(count + surfels).clamp(-1, 1) / 5,
        styles=(Source(Path("/pictures/wave.jpg"), "12ab"),),
        settings=SETTINGS,
    )
    return replace(layer, **fields)


def layer_towards(base: Splats, shown: Splats, picked: torch.Tensor, name: str) -> Layer:
    """The layer that gives picked rows the colours and opacities of other splats."""
    rows = picked.nonzero()[:, 0]
    nothing = appearance_only(base[rows[:0]])
    factors = torch.sigmoid(shown.opacities[rows]) / torch.sigmoid(base.opacities[rows])
    return Layer(
        object=name,
        rows=rows,
        shares=torch.ones(len(rows)),
        sh0=shown.sh0[rows],
        shN=shown.shN[rows],
        opacity_factors=factors.clamp(max=1),
        surfels=nothing,
        surfels_sh0=nothing.sh0,
        parents=rows[:0],
        relief=torch.zeros(len(rows)),
    )


# A scene of six Gaussians that has everything, and whether two scenes are the same.

COUNT = 6


def random(*shape: int) -> torch.Tensor:
    return randn(*shape, seed=sum(shape))


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
        base=replace(
            scene.base,
            identities=random(COUNT, 16),
            classifier=classifier,
            confidence=random(COUNT).sigmoid(),
        ),
        objects={
            "fox": SceneObject(torch.arange(COUNT) % 2 == 0, Selection(ids=(7,))),
            "a name": SceneObject(nothing),
        },
        held_out=("a.jpg",),
        capture=Path("garden"),
        info={"settings": {"steps": 500}},
        metrics={"psnr": 30.5},
    )
    return bare.with_layers(layers(bare.base))


def layers(base: Splats) -> tuple[Layer, ...]:
    fox = plain_layer(base, torch.arange(2), "fox", surfels=3, seed=4, strength=0.7, form=0.4)
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
    hidden = plain_layer(base, torch.arange(3, 6), "Brücke", surfels=2, seed=6)
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
    looks = zip(tensors_in(found.splats), tensors_in(scene.splats), strict=True)
    assert all(torch.equal(one, other) for one, other in looks)
    found, scene = (replace(each, path=None, composed=None) for each in (found, scene))
    assert plain_in(found) == plain_in(scene)
    pairs = zip(tensors_in(found), tensors_in(scene), strict=True)
    assert all(torch.equal(one, other) for one, other in pairs)


# GLB files taken apart, changed and put together again.

Json = dict[str, Any]
NAME = "KHR_gaussian_splatting"


def glb_parts(path: Path) -> tuple[Json, bytes]:
    """The JSON of a GLB and its bytes."""
    content = path.read_bytes()
    (size,) = struct.unpack_from("<I", content, 12)
    return json.loads(content[20 : 20 + size]), content[28 + size :]


def glb_of(document: Json, binary: bytes) -> bytes:
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<4sIIII", b"glTF", 2, 28 + len(text) + len(binary), len(text), 0x4E4F534A)
    return head + text + struct.pack("<II", len(binary), 0x004E4942) + binary


def changed_glb(path: Path, change: Callable[[Json], object]) -> None:
    """Write a GLB anew with another JSON."""
    document, binary = glb_parts(path)
    change(document)
    path.write_bytes(glb_of(document, binary))


def as_gltf(path: Path, uri: str, change: Callable[[Json], object] = lambda _: None) -> Path:
    """The same file as JSON, its buffer under another name; that buffer is not written."""
    document, _ = glb_parts(path)
    document["buffers"][0]["uri"] = uri
    change(document)
    parted = path.with_suffix(".gltf")
    parted.write_text(json.dumps(document))
    return parted


def attributes(document: Json) -> Json:
    """The accessors of the splats' attributes."""
    return document["meshes"][0]["primitives"][0]["attributes"]


def attribute(document: Json, name: str) -> Json:
    """An accessor."""
    return document["accessors"][attributes(document)[name]]


def places(document: Json) -> Json:
    """Where the bytes of POSITION lie."""
    return document["bufferViews"][attribute(document, "POSITION")["bufferView"]]


def extension(document: Json) -> Json:
    """What makes the points splats."""
    return document["meshes"][0]["primitives"][0]["extensions"][NAME]
