"""Textured meshes beside the splats that they were made of.

    .venv/bin/python benchmarks/meshes.py    # demo's vase and teapot, painted, a fox and a bottle
    .venv/bin/python benchmarks/meshes.py --objects demo/styled:vase --repaint

Of each mesh: PSNR of its renders against the splat's in held-out views, inside the object's mask,
and where the splat covers 0.9 or more; whether it is watertight; how many of its edges lie not
between two faces; pairs of faces that cut each other, in a sample; seconds of processors (twice
those of the clock on two), and the process's peak memory. A picture of four sides, splat above
mesh, lies beside it.

Both are the mean of 3x3 samples in a pixel, before the rest of the scene: at one sample in a pixel
a splat differs from itself, by 26 dB for the demo's vase and teapot, as a low-pass filter makes
each Gaussian larger. The rim of the mask is half transparent, which no mesh is.
"""

import math
import time
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
import trimesh
import tyro
from bench import MIB, OUT, peak_memory, table
from PIL import Image
from scipy.spatial import KDTree

import stylesplat as ss
from stylesplat.meshes.mesh import make_mesh
from stylesplat.meshes.mesh_config import MeshConfig
from stylesplat.meshes.mesh_files import write_mesh
from stylesplat.meshes.rasterize import NOTHING, draw_mesh
from stylesplat.meshes.texture import TexturedMesh
from stylesplat.rendering.render import render
from stylesplat.rendering.weights import COVERED, coverage
from stylesplat.scene.cameras import Cameras, look_at, up_vector
from stylesplat.scene.content import extent_of
from stylesplat.scene.scene import Scene
from stylesplat.scene.splats import Splats
from stylesplat.scene.virtual_cameras import centred_K, level_axes
from stylesplat.selection.resolve import find_object

OBJECTS = ("demo/styled:vase", "demo/styled:teapot", "fox:1", "desk:1")
FINER = 3  # samples of a pixel's side
OPAQUE = 0.9  # coverage
SIDES, SIDE, AWAY = 4, 512, 3.0
SAMPLE = 2000  # faces that are looked at for cuts


@dataclass(frozen=True)
class Options:
    """What to measure."""

    scenes: Path = OUT / "test_objects"
    output: Path = OUT / "meshes"
    faces: int = 50_000
    texture_size: int = 2048
    repaint: bool = False
    objects: tuple[str, ...] = OBJECTS
    """A folder in `scenes`, and the name or label id of an object."""


def psnr_in_place(mesh: TexturedMesh, scene: Scene, picked: torch.Tensor) -> np.ndarray:
    """Mean over the held-out views: inside the mask, and where it is opaque."""
    found, own, rest = [], scene.splats[picked], scene.splats[~picked]
    for camera in scene.working_views()[1] or scene.working_views()[0]:
        mask = (coverage(scene.splats, camera, picked) > COVERED).numpy()
        if not mask.any():
            continue
        width, height = camera.size
        finer = camera.resize(FINER * width, FINER * height)
        wanted, covered = map(pixel_means, render(own, finer))
        image, share = supersampled(mesh, camera)
        behind = render(rest, camera)[0].clamp(0, 1).numpy()
        error = np.square(image - wanted + (covered - share) * behind).mean(axis=2)
        opaque = mask & (covered[..., 0] > OPAQUE)
        found.append([-10 * math.log10(error[each].mean()) for each in (mask, opaque)])
    return np.mean(found, axis=0)


def pixel_means(samples: torch.Tensor) -> np.ndarray:
    """Of `FINER` samples by side."""
    height, width, channels = samples.shape
    shape = height // FINER, FINER, width // FINER, FINER, channels
    return samples.view(shape).mean(dim=(1, 3)).numpy()


def draw(mesh: TexturedMesh, camera: Cameras) -> tuple[np.ndarray, np.ndarray]:
    """The mesh before black, and where it shows."""
    fragments = draw_mesh(mesh.vertices, mesh.faces, camera)
    shown = fragments.faces != NOTHING
    places = np.zeros((*shown.shape, 2), np.float32)
    places[shown] = fragments.of_corners(mesh.uvs, mesh.faces) * len(mesh.texture) - 0.5
    x, y = cv2.split(places)
    image = cv2.remap(mesh.texture, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return image * shown[..., None], shown


def supersampled(mesh: TexturedMesh, camera: Cameras) -> tuple[np.ndarray, np.ndarray]:
    """The mesh before black, and its share of each pixel."""
    width, height = camera.size
    image, shown = draw(mesh, camera.resize(FINER * width, FINER * height))
    both = np.concatenate([image, shown[..., None]], axis=2)
    both = pixel_means(torch.from_numpy(both))
    return both[..., :3], both[..., 3:]


def four_sides(mesh: TexturedMesh, own: Splats, up: torch.Tensor) -> np.ndarray:
    """The splat above the mesh."""
    extent = extent_of(own, torch.ones(len(own), dtype=torch.bool))
    side, ahead = level_axes(up)
    columns, radius = [], float(extent.size.norm()) / 2
    for turn in range(SIDES):
        angle = 2 * math.pi * turn / SIDES
        outward = math.cos(angle) * side + math.sin(angle) * ahead + 0.3 * up
        outward = AWAY * radius * outward / outward.norm()
        camera = Cameras(
            look_at((extent.centre + outward)[None], extent.centre, up).float(),
            centred_K(1.3 * SIDE, (SIDE, SIDE))[None],
            torch.tensor([[SIDE, SIDE]]),
            ("side",),
        )
        white = torch.ones(3)
        splat = render(own, camera, background=white)[0].clamp(0, 1).numpy()
        image, share = supersampled(mesh, camera)
        columns.append(np.concatenate([splat, image + 1 - share]))
    return np.concatenate(columns, axis=1)


def cuts(mesh: trimesh.Trimesh) -> int:
    """Edges of some faces that pass through faces nearby which share no corner with them."""
    rows = np.random.default_rng(0).permutation(len(mesh.faces))[:SAMPLE]
    centres = mesh.triangles_center
    near = np.asarray(KDTree(centres).query(centres[rows], k=24)[1])
    edges = np.stack([mesh.triangles[rows], np.roll(mesh.triangles[rows], -1, axis=1)], axis=2)
    total = 0
    for one, row, others in zip(edges, rows, near, strict=True):
        apart = others[~np.isin(mesh.faces[others], mesh.faces[row]).any(axis=1)]
        a, b, c = mesh.triangles[apart].transpose(1, 0, 2)
        normal = np.cross(b - a, c - a)
        for start, end in one:
            height = ((start - a) * normal).sum(1)
            fall = ((start - end) * normal).sum(1)
            share = np.divide(height, fall, out=np.full_like(height, -1), where=fall != 0)
            point = start + share[:, None] * (end - start)
            inside = (share > 0) & (share < 1)
            for one_end, other_end in ((a, b), (b, c), (c, a)):
                turned = np.cross(other_end - one_end, point - one_end)
                inside &= (turned * normal).sum(1) > 0
            total += int(inside.sum())
    return total


def measure(options: Options, object: str) -> list[str]:
    """A row of the table."""
    folder, name = object.split(":")
    scene = ss.open(options.scenes / folder)
    mask = find_object(scene, name)
    picked = scene.to_splats(mask)
    own, start = scene.splats[picked], time.process_time()
    config = MeshConfig(options.faces, options.texture_size, options.repaint)
    paint = None
    if options.repaint:
        (layer,) = (each for each in scene.layers if each.object == name)
        paint = layer, scene.base[mask]
    path, made = options.output / f"{folder.replace('/', '_')}_{name}.glb", list[TexturedMesh]()

    def work() -> None:
        made.append(make_mesh(own, scene.working_views()[0], config, name=name, paint=paint))
        write_mesh(made[0], path)

    peak = peak_memory(work)
    (mesh,) = made
    seconds = time.process_time() - start
    with torch.no_grad():
        psnr = psnr_in_place(mesh, scene, picked)
        sides = four_sides(mesh, own, up_vector(scene.cameras))
    Image.fromarray((sides * 255).clip(0, 255).astype(np.uint8)).save(path.with_suffix(".png"))
    loaded = trimesh.load_mesh(path)
    loaded.merge_vertices(merge_tex=True, merge_norm=True)
    counts = np.unique(loaded.edges_sorted, axis=0, return_counts=True)[1]
    return [
        object,
        *(f"{each:.1f}" for each in psnr),
        str(loaded.is_watertight),
        str((counts != 2).sum()),
        str(cuts(loaded)),
        f"{len(loaded.faces):,}",
        f"{seconds:.0f}",
        f"{peak / MIB:.0f}",
    ]


def main(options: Options) -> None:
    options.output.mkdir(parents=True, exist_ok=True)
    rows = [measure(options, each) for each in options.objects]
    heads = ["object", "PSNR", "opaque", "closed", "other edges", "cuts", "faces", "CPU s", "MiB"]
    print(table(heads, rows))


if __name__ == "__main__":
    main(tyro.cli(Options))
