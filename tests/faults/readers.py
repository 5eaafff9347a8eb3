"""Who reads files from strangers, and all that happens afterwards to what was read.

A reader is tried on a folder in which one file is a mutant. Whatever it gives must be usable: so it
is rendered, decoded, written, taken as the input of the next step.
"""

import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import Tensor

import seeds
import stylesplat as ss
from scenes import random_splats, two_cameras
from stylesplat.io.captures.label_folder import write_label_maps
from stylesplat.io.captures.photos import read_image
from stylesplat.io.captures.sfm_file import read_sfm
from stylesplat.io.files import inside
from stylesplat.io.splats.splat_files import read_splats
from stylesplat.masks.models.found_so_far import open_progress
from stylesplat.rendering.rasterize import rasterize
from stylesplat.scene.capture import Capture
from stylesplat.scene.scene import Scene
from stylesplat.scene.splats import Splats
from stylesplat.structure_from_motion.prepare import prepare
from stylesplat.stylization.features.weights import load_weights
from stylesplat.stylization.style_image import read_style
from stylesplat.training.loop import fit

TINY = 24  # pixels of a rendered side


@dataclass(frozen=True)
class Reader:
    """A way into the program."""

    make: Callable[[Path], None]
    """Writes valid files into a folder that does not exist."""
    files: tuple[str, ...]
    """Patterns of those that mutants replace."""
    use: Callable[[Path, Path], None]
    """Reads the folder, and uses what it has read; may write into another."""


def use_scene(folder: Path, out: Path) -> None:
    scene = ss.open(folder / "scene")
    ss.objects(scene)
    for name in scene.objects:
        ss.select(scene, "again", plus=name)
    ss.select(scene, "round", sphere=(0.0, 0.0, 0.0, 10.0))
    ss.export(scene, out / "a.ply", overwrite=True)
    look_at(scene)
    views, _ = scene.working_views()
    assert len(views)
    if scene.layers:
        look_at(ss.adjust(scene, 0.5))
        look_at(ss.adjust(scene, undo=True))
        for name in scene.painted_objects:
            look_at(ss.adjust(scene, objects=name, undo=True))
    ss.save(scene, out / "scene")
    ss.open(out / "scene")


def look_at(scene: Scene) -> None:
    """Render what can be rendered."""
    small = replace(scene, cameras=scene.cameras.at_most(TINY))
    for what in ("color", "labels", "depth"):
        for _ in ss.render(small, what=what):
            pass
    for row in range(len(small.cameras)):
        image, _, _ = rasterize(scene.splats, small.cameras[row])
        check_finite("image", image)


def use_splats(folder: Path, out: Path) -> None:
    for name in ("a.ply", "b.ply", "a.spz", "a.splat", "a.glb", "a.gltf"):
        use_one_splat(read_splats(folder / name), out)


def use_sog(folder: Path, out: Path) -> None:
    for name in ("a.sog", "meta.json"):
        use_one_splat(read_splats(folder / name), out)


def use_one_splat(splats: Splats, out: Path) -> None:
    image, _, _ = rasterize(splats, two_cameras().at_most(TINY))
    check_finite("image", image)
    ss.export(splats, out / "a.ply", overwrite=True)
    read_splats(out / "a.ply")


def check_finite(what: str, tensor: Tensor) -> None:
    """Raise a ValueError, which is no answer, if something is not."""
    if not tensor.isfinite().all():
        raise ValueError(f"the {what} is not finite")


def use_row_labels(folder: Path, out: Path) -> None:
    for path in sorted(folder.iterdir()):
        scene = ss.import_(random_splats(seeds.COUNT), labels=path, device="cpu")
        ss.save(scene, out / path.suffix)


def use_object_lists(folder: Path, out: Path) -> None:
    splats = replace(random_splats(seeds.COUNT), identities=None)
    for path in sorted(folder.iterdir()):
        labels = path if path.stem == "a" else None
        scene = ss.import_(splats, labels=labels, device="cpu")
        scene = ss.select(scene, "vase", rows=path)
        ss.save(scene, out / path.name)


def use_paths(folder: Path, out: Path) -> None:
    for path in sorted(folder.iterdir()):
        cameras = ss.read_camera_path(path, two_cameras()).cameras
        check_finite("viewmats", cameras.viewmats)
        check_finite("Ks", cameras.Ks)
        assert len(set(cameras.names)) == len(cameras)


def use_capture(folder: Path, out: Path) -> None:
    look_through(ss.load(folder))
    look_through(ss.load(folder, downscale=2), out)


def look_through(capture: Capture, out: Path | None = None) -> None:
    """Decode all that a capture holds; write its label maps if somewhere is given."""
    for row in range(len(capture)):
        assert capture.photos[row].shape[2] == 3
        if capture.label_maps is not None:
            _ = capture.label_maps[row]
    for tensor in (capture.cameras.viewmats, capture.cameras.Ks, capture.points):
        if tensor is not None:
            check_finite("camera or point", tensor)
    if out is not None and capture.label_maps is not None:
        write_label_maps(capture, out / "object_mask")


def use_sfm(folder: Path, out: Path) -> None:
    read_sfm(folder)
    ss.check(ss.load(folder)).summary()


def use_prepared(folder: Path, out: Path) -> None:
    shutil.copytree(folder / "prepared", out / "prepared")
    prepared = prepare(folder / "photos", out / "prepared")
    for name in prepared.names:
        read_image(inside(out / "prepared", name))


def use_foreign(folder: Path, out: Path) -> None:
    capture = ss.load(folder / "capture")
    for number, source in enumerate(("by_object", "by_photo", "coco.json")):
        masked = ss.mask(capture, source=folder / source)
        write_label_maps(masked, out / str(number))


def use_recipe(folder: Path, out: Path) -> None:
    for name in ("recipe.yaml", "recipe.json"):
        for each in ss.read_recipe(folder / name).objects:
            each.style.read()


def use_checkpoint(folder: Path, out: Path) -> None:
    path = shutil.copy(folder / "checkpoint.pt", out)  # it goes on there
    state = fit(ss.load(folder / "capture"), seeds.RUNS, checkpoint=Path(path))
    use_one_splat(replace(state.splats.detach(), classifier=None), out)


def use_styles(folder: Path, out: Path) -> None:
    for path in sorted(folder.iterdir()):
        check_finite("picture", read_style(path))


def use_progress(folder: Path, out: Path) -> None:
    shutil.copytree(folder / "progress", out / "progress")
    found = open_progress(out / "progress", seeds.PROGRESS_SETTINGS)
    shape = torch.zeros(seeds.HEIGHT, seeds.WIDTH)
    for mask in found.proposals(0, list):
        assert mask.dim() == shape.dim()
    stretches, state = found.stands()
    if stretches:
        found.labels(0)
    found.save(1, {0: shape.long()}, state)


def use_weights(folder: Path, out: Path) -> None:
    network = load_weights("compact", folder / "compact.safetensors")
    (features,) = network(torch.zeros(TINY, TINY, 3))
    check_finite("features", features)


READERS = {
    "scene": Reader(seeds.scene, ("scene/*.*", "scene/layers/*"), use_scene),
    "splats": Reader(seeds.splats, ("*",), use_splats),
    "sog": Reader(seeds.sog, ("*",), use_sog),
    "labels": Reader(seeds.row_labels, ("*",), use_row_labels),
    "objects": Reader(seeds.object_lists, ("*",), use_object_lists),
    "paths": Reader(seeds.paths, ("*",), use_paths),
    "colmap": Reader(seeds.colmap, ("sparse/0/*", "images/*", "object_mask/*"), use_capture),
    "colmap_text": Reader(seeds.colmap_text, ("sparse/0/*",), use_capture),
    "sfm": Reader(seeds.sfm, ("sfm.json",), use_sfm),
    "prepared": Reader(seeds.prepared, ("prepared/.prepared.json",), use_prepared),
    "transforms": Reader(
        seeds.transforms,
        ("transforms.json", "points.ply", "images/*", "object_mask/*"),
        use_capture,
    ),
    "foreign": Reader(
        seeds.foreign, ("coco.json", "by_photo/001.png", "by_object/vase/001.png"), use_foreign
    ),
    "recipe": Reader(seeds.recipe, ("recipe.*", "wave.png"), use_recipe),
    "checkpoint": Reader(seeds.checkpoint, ("checkpoint.pt",), use_checkpoint),
    "styles": Reader(seeds.styles, ("*",), use_styles),
    "progress": Reader(seeds.progress, ("progress/*",), use_progress),
    "weights": Reader(seeds.weights, ("*",), use_weights),
}
