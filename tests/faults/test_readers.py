"""Whatever a file holds, its reader gives something usable or says in one line what is wrong."""

import json
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from beartype.roar import BeartypeCallHintViolation
from damage import damaged
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

import stylesplat as ss
from balls import CAMERAS
from capture_files import save_noise, write_ball_capture, write_capture
from glb_models import write_model_glb
from ksplat_files import write_ksplat
from processes import VERBS, write_jobs
from scenes import COUNT, full_scene, random_splats, write_checkpoint
from stylesplat.batch_jobs.job_file import plan_batch
from stylesplat.io.gaussian_lists import read_objects
from stylesplat.io.models.model_files import read_model
from stylesplat.io.splats import splat_files
from stylesplat.meshes.paint_model import in_unit_ball, sample_discs

CONTROL = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029]")
LONGEST = 2000  # characters of a line that somebody is to read


@dataclass(frozen=True)
class Format:
    """A way into the program."""

    write: Callable[[Path], object]
    """Writes valid files into a folder that does not exist."""
    damage: tuple[str, ...]
    """Patterns of those that are damaged."""
    read: Callable[[Path], object]
    """Reads the folder, and looks at all that it has read."""


def write_splats(folder: Path, suffix: str) -> None:
    folder.mkdir(parents=True)
    if suffix == "ksplat":  # which is read only
        write_ksplat(folder / "a.ksplat", [random_splats(COUNT)], 1, 1)
    elif suffix == "pt":
        write_checkpoint(random_splats(COUNT), folder / "a.pt")
    else:
        ss.export(random_splats(COUNT), folder / f"a.{suffix}")


def read_splats(folder: Path, suffix: str) -> None:
    """All formats meet in `import_`, whose views take longest: one of them goes there."""
    path = folder / f"a.{suffix}"
    found = ss.import_(path).splats if suffix == "ply" else splat_files.read_splats(path)
    finite(*found.tensors().values())


def finite(*tensors: torch.Tensor | None) -> None:
    """Raise an error, which is no answer, if something read is not finite."""
    assert all(tensor is None or tensor.isfinite().all() for tensor in tensors)


def write_mesh(folder: Path) -> None:
    folder.mkdir(parents=True)
    write_model_glb(folder)


def read_mesh(folder: Path) -> None:
    """Read all that painting reads."""
    parts = read_model(folder / "model.glb").parts
    sample_discs(parts, in_unit_ball(parts), texture_size=32, seed=0)


def read_scene(folder: Path) -> None:
    scene = ss.open(folder / "scene")
    finite(scene.splats.means, scene.cameras.viewmats, scene.cameras.Ks)
    ss.save(scene, folder / "copy", overwrite=True)
    if scene.layers:
        ss.adjust(scene, 0.5)
        ss.adjust(scene, undo=True)


def write_colmap(folder: Path, *, text: bool = False) -> None:
    write_capture(folder, "OPENCV", (60.0, 62.0, 31.0, 25.0, 0.1, 0.0, 0.0, 0.0), text=text)


def read_capture(folder: Path) -> None:
    for capture in (ss.load(folder), ss.load(folder, downscale=2.0)):
        finite(capture.cameras.viewmats, capture.cameras.Ks, capture.points)
        for row in range(len(capture)):
            assert capture.photos[row].shape[2] == 3
            _ = capture.label_maps[row] if capture.label_maps is not None else None


RECIPE = """steps: 300
preset: default
objects:
  vase: {style: wave.png, scale: 1.5}
  pot: {style: [wave.png], color: keep, region: [0, 0, 40, 40]}
"""


def write_recipe(folder: Path) -> None:
    save_noise(folder / "wave.png")
    (folder / "recipe.yaml").write_text(RECIPE)


def read_recipe(folder: Path) -> None:
    for painted in ss.read_recipe(folder / "recipe.yaml").objects:
        painted.style.read()


JOBS = """scenes: {garden: garden, desk: desk}
jobs:
  - stylize: {style: {vase: [wave.jpg, night.jpg]}, steps: [100, 200], seed: 3}
    name: painted
    needs: {cpus: 2, memory: 3.5}
    then:
      - export: {output: a.ply}
"""


def write_job_file(folder: Path) -> None:
    folder.mkdir(parents=True)
    write_jobs(folder, JOBS)


def write_labels(folder: Path) -> None:
    """Labels of Gaussians and masks of another program."""
    write_capture(folder / "capture")
    labels = np.arange(COUNT) % 3
    np.save(folder / "a.npy", labels)
    np.savez(folder / "a.npz", labels=labels)
    mask = {"size": [48, 64], "counts": [1536, 1536]}
    packed = {"size": [48, 64], "counts": "P`1P`1"}  # the same, 5 bits a letter
    masks = [{"image_id": 0, "category_id": 1, "segmentation": each} for each in (mask, packed)]
    coco = {"images": [{"id": 0, "file_name": "001.png"}], "annotations": masks}
    coco["categories"] = [{"id": 1, "name": "vase"}]
    (folder / "coco.json").write_text(json.dumps(coco))


def read_labels(folder: Path) -> None:
    for suffix in ("npy", "npz"):
        found = read_objects(folder / f"a.{suffix}", COUNT).labels
        assert found is None or (len(found) == COUNT and found.min() >= 0)
    maps = ss.mask(ss.load(folder / "capture"), source=folder / "coco.json").label_maps
    assert maps is not None and all(labels is None or labels.min() >= 0 for labels in maps)


def write_pictures(folder: Path) -> None:
    for suffix in ("png", "jpg", "tif", "webp"):
        save_noise(folder / f"wave.{suffix}")


FORMATS = {
    **{
        suffix: Format(
            partial(write_splats, suffix=suffix),
            (f"a.{suffix}",),
            partial(read_splats, suffix=suffix),
        )
        for suffix in (
            *("ply", "compressed.ply", "spz", "splat", "ksplat", "sog", "glb", "gltf"),
            *("usda", "usdc", "usdz", "pt"),
        )
    },
    "mesh": Format(write_mesh, ("model.glb",), read_mesh),
    "scene": Format(
        lambda folder: ss.save(full_scene(), folder / "scene"),
        ("scene/*.*", "scene/layers/*"),
        read_scene,
    ),
    "COLMAP": Format(write_colmap, ("sparse/0/*",), read_capture),
    "COLMAP text": Format(
        lambda folder: write_colmap(folder, text=True), ("sparse/0/*",), read_capture
    ),
    "transforms": Format(
        partial(write_ball_capture, cameras=CAMERAS[:3]),
        ("transforms.json", "points.ply", "images/0000.jpg", "object_mask/*"),
        read_capture,
    ),
    "recipe": Format(write_recipe, ("recipe.yaml", "wave.png"), read_recipe),
    "jobs": Format(
        write_job_file, ("jobs.yaml",), lambda folder: plan_batch(folder / "jobs.yaml", VERBS)
    ),
    "labels": Format(write_labels, ("a.*", "coco.json"), read_labels),
    "pictures": Format(
        write_pictures, ("*",), lambda folder: ss.Style(*sorted(folder.iterdir())).read()
    ),
}


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", FORMATS)
def test_a_damaged_file_is_read_or_refused_in_one_line(name: str, tmp_path: Path):
    tried, folder = FORMATS[name], tmp_path / "given"
    tried.write(folder)
    tried.read(folder)
    found = {path for each in tried.damage for path in folder.glob(each)}
    files = sorted(path for path in found if path.is_file())
    refused = []

    @settings(
        max_examples=80,
        deadline=None,
        derandomize=True,
        phases=[Phase.generate],  # shrinking takes longer than a test may
        suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
    )
    @given(st.data())
    def read(data: st.DataObject) -> None:
        path = data.draw(st.sampled_from(files), label="file")
        content = path.read_bytes()
        path.write_bytes(data.draw(damaged(path), label="content"))
        try:
            tried.read(folder)
        except (ss.StyleSplatError, BeartypeCallHintViolation) as error:
            refusal: BaseException | None = error
            while isinstance(
                refusal, BeartypeCallHintViolation
            ):  # it looked into a list of label maps
                refusal = refusal.__cause__ or refusal.__context__
            assert isinstance(refusal, ss.StyleSplatError), error
            assert not CONTROL.search(str(refusal)) and len(str(refusal)) <= LONGEST
            refused.append(path)
        finally:
            path.write_bytes(content)

    read()
    assert refused, "the damage is too tame"
