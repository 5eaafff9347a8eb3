"""Valid files of every kind that is read, small, to make mutants of."""

import json
import shutil
import zipfile
from dataclasses import asdict, replace
from pathlib import Path

import gsply
import numpy as np
import torch
from PIL import Image

import stylesplat as ss
from ball_photos import write_ball_capture
from balls import CAMERAS, CLASSIFIER
from glb_files import as_gltf, glb_parts
from pictures_of_walks import walk
from plain_layers import plain_layer
from scenes import random_splats, two_cameras
from stylesplat.io.captures.sfm_file import SfmRecord, write_sfm
from stylesplat.io.gaussian_lists import SUFFIXES, write_objects
from stylesplat.io.label_maps import write_label_map
from stylesplat.io.ply import write_ply_table
from stylesplat.masks.checkpoint import open_checkpoint
from stylesplat.masks.tracking import TrackingState
from stylesplat.scene.compose import with_layers
from stylesplat.scene.scene import ListedObject, ListedObjects, Scene, SceneObject
from stylesplat.structure_from_motion.prepare import prepare
from stylesplat.stylization.features.weights import PACKAGED
from stylesplat.training.loop import fit
from stylesplat.training.train_config import TrainConfig
from stylesplat.verbs.export import export
from tiny_captures import HEIGHT, WIDTH, save_noise, write_capture

COUNT = 6
RUNS = TrainConfig(steps=2, max_gaussians=100, coarse_to_fine=False, test_every=0)
PROGRESS_SETTINGS = {"method": "sam", "sizes": [[WIDTH, HEIGHT]]}
NAMES = ("001.png", "002.png", "003.png")  # of the photos of COLMAP's capture


def scene(folder: Path) -> None:
    """A styled scene that has everything, of six Gaussians that two cameras see."""
    splats = random_splats(COUNT)
    picked = torch.arange(COUNT) < 3
    bare = Scene(
        splats=replace(splats, classifier=CLASSIFIER, confidence=torch.rand(COUNT)),
        cameras=two_cameras(),
        held_out=("first.png",),
        objects={"fox": SceneObject(picked, {"ids": [3]}), "pot": SceneObject(~picked, {})},
        capture=folder / "capture",
        info={"settings": {"steps": 5}, "libraries": {"torch": "2"}},
        metrics={"psnr": 30.5},
    )
    rows = torch.arange(COUNT)
    fox = plain_layer(splats, rows[:2], "fox", canvas=3, strength=0.7)
    pot = plain_layer(splats, rows[3:], "pot", seed=1, features="vgg19")
    ss.save(with_layers(bare, (fox, pot)), folder / "scene")


def splats(folder: Path) -> None:
    """A file of each format."""
    folder.mkdir(parents=True)
    whole = random_splats(COUNT)
    for name in ("a.ply", "a.spz", "a.splat", "a.glb"):
        export(whole, folder / name)
    _, binary = glb_parts(folder / "a.glb")
    (folder / "a.bin").write_bytes(binary)
    as_gltf(folder / "a.glb", "a.bin")
    data = gsply.GSData(
        means=whole.means.numpy(),
        scales=whole.scales.numpy(),
        quats=torch.nn.functional.normalize(whole.quats, dim=1).numpy(),
        opacities=whole.opacities.numpy(),
        sh0=whole.sh0[:, 0].numpy(),
        shN=whole.shN.numpy(),
    )
    gsply.plywrite(folder / "b.ply", data, compressed=True)
    (folder / "b.compressed.ply").replace(folder / "b.ply")


def sog(folder: Path) -> None:
    """A bundle, and the same as a folder."""
    folder.mkdir(parents=True)
    export(random_splats(COUNT), folder / "a.sog")
    with zipfile.ZipFile(folder / "a.sog") as bundle:
        bundle.extractall(folder)


def row_labels(folder: Path) -> None:
    """Labels of six Gaussians in each format."""
    folder.mkdir(parents=True)
    labels = np.arange(COUNT) % 3
    np.save(folder / "a.npy", labels)
    np.savez(folder / "a.npz", labels=labels, scores=np.ones(COUNT))
    (folder / "a.json").write_text(json.dumps({"labels": labels.tolist()}))
    table = np.zeros(COUNT, [("x", "f4"), ("label", "u1")])
    table["label"] = labels
    write_ply_table(table, folder / "a.ply")


def paths(folder: Path) -> None:
    """Nerfstudio's camera path, and key frames of our own."""
    folder.mkdir(parents=True)
    pose = [1.0, 0, 0, 0, 0, -1, 0, 0, 0, 0, -1, -3, 0, 0, 0, 1]
    frames = [{"camera_to_world": pose, "fov": 50.0, "aspect": 1.5}] * 2
    size = {"render_width": 12, "render_height": 8}
    theirs = {"camera_path": frames, "camera_type": "perspective", "fps": 24, **size}
    (folder / "nerfstudio.json").write_text(json.dumps(theirs))
    place = {"position": [0, 1, -3], "look_at": [0, 0, 0], "fov": 60}
    ours = {"keyframes": [place, {"view": "first.png"}], "seconds": 1, "fps": 4, "closed": True}
    (folder / "keys.json").write_text(json.dumps(ours))


def object_lists(folder: Path) -> None:
    """Two objects of six Gaussians in each format, and rows of one alone."""
    folder.mkdir(parents=True)
    shares = torch.tensor([1.0, 0.5])
    objects = {
        "vase": ListedObject(torch.tensor([0, 4]), shares, (3,)),
        "pot": ListedObject(torch.tensor([1]), None, ()),
    }
    for suffix in SUFFIXES:
        listed = ListedObjects(COUNT, objects, 3 * (torch.arange(COUNT) % 2))
        write_objects(listed, folder / f"a{suffix}")
    np.save(folder / "b.npy", np.array([1, 2]))
    (folder / "b.json").write_text("[1, 2, 5]")
    table = np.zeros(COUNT, [("x", "f4"), ("state", "u1")])
    table["state"] = 1
    write_ply_table(table, folder / "b.ply")


def colmap(folder: Path) -> None:
    """COLMAP's binary files, with photos and label maps."""
    write_capture(folder)
    _labelled(folder)


def colmap_text(folder: Path) -> None:
    """The same as texts."""
    write_capture(folder, "OPENCV", (60.0, 62.0, 31.0, 25.0, 0.1, 0.0, 0.0, 0.0), text=True)


def sfm(folder: Path) -> None:
    """A capture with what became of each photo."""
    write_capture(folder)
    record = SfmRecord(
        source="photos",
        digest="12ab",
        given=5,
        registered=3,
        left_out={"004.png": "blurred"},
        unregistered={"005.png": "sees another place"},
        origins={"001.png": "sub/001.heic"},
        frame={"up": [0, -1, 0]},
        settings={"seed": 0},
        numbers={"points": 4},
        libraries={"pycolmap": "4"},
    )
    write_sfm(record, folder)


def prepared(folder: Path) -> None:
    """Photos that are prepared for structure from motion."""
    walk(folder / "photos", 3)
    prepare(folder / "photos", folder / "prepared")


def transforms(folder: Path) -> None:
    """Nerfstudio's layout, with JPEG photos, points, label maps and names."""
    write_ball_capture(folder, CAMERAS[:3])
    (folder / "object_mask/names.json").write_text('{"3": "red", "7": "green", "300": "blue"}')


def _labelled(folder: Path) -> None:
    for row, name in enumerate(NAMES):
        ids = torch.arange(HEIGHT)[:, None] // 16 * (1, 300, 70_000)[row]
        write_label_map(ids.expand(HEIGHT, WIDTH), folder / "object_mask" / name)


def foreign(folder: Path) -> None:
    """Masks of a capture's photos as other programs write them, beside it."""
    write_capture(folder / "capture")
    half = np.arange(HEIGHT * WIDTH).reshape(HEIGHT, WIDTH) < HEIGHT * WIDTH // 2
    for name in NAMES:
        for place in (folder / "by_object" / "vase", folder / "by_object" / "pot"):
            place.mkdir(parents=True, exist_ok=True)
            Image.fromarray(half).save(place / name)
        ids = torch.from_numpy(300 * half.astype(np.int64))
        write_label_map(ids, folder / "by_photo" / name)
    (folder / "coco.json").write_text(json.dumps(_coco()))


def _coco() -> dict[str, object]:
    pixels = HEIGHT * WIDTH
    plain = {"size": [HEIGHT, WIDTH], "counts": [pixels // 2, pixels // 2]}
    packed = {"size": [HEIGHT, WIDTH], "counts": "P`1P`1"}  # 1536 twice, 5 bits a letter
    masks = [(row, mask) for row in range(3) for mask in (plain, packed)]
    return {
        "images": [{"id": row, "file_name": name} for row, name in enumerate(NAMES)],
        "categories": [{"id": 1, "name": "vase"}, {"id": 2, "name": "pot"}],
        "annotations": [
            {"image_id": row, "category_id": 1 + (mask is packed), "segmentation": mask}
            for row, mask in masks
        ],
    }


def recipe(folder: Path) -> None:
    """Recipes as a user writes them, and as we do."""
    scene(folder)
    save_noise(folder / "wave.png")
    shutil.copy(folder / "scene/recipe.json", folder / "recipe.json")
    shutil.rmtree(folder / "scene")
    content = json.loads((folder / "recipe.json").read_text())
    for entry in content["objects"]:
        entry |= {"style": "wave.png", "sha256": None}
    (folder / "recipe.json").write_text(json.dumps(content))
    (folder / "recipe.yaml").write_text(
        "steps: 300\npreset: default\nobjects:\n  vase:\n    style: wave.png\n    scale: 1.5\n"
        "  pot: {style: [wave.png], color: keep, region: [0, 0, 40, 40]}\n"
    )


def checkpoint(folder: Path) -> None:
    """A training that stopped after its first step, and what it trains on."""
    transforms(folder / "capture")
    capture = ss.load(folder / "capture")
    path = folder / "checkpoint.pt"
    fit(capture, replace(RUNS, steps=1), checkpoint=path)
    content = torch.load(path, weights_only=True)
    torch.save(content | {"config": asdict(RUNS)}, path)


def styles(folder: Path) -> None:
    """Pictures of each format."""
    for name in ("wave.png", "wave.jpg", "wave.tif", "wave.webp"):
        save_noise(folder / name)


def progress(folder: Path) -> None:
    """What `mask` has found so far."""
    found = open_checkpoint(folder / "progress", PROGRESS_SETTINGS)
    half = torch.arange(HEIGHT * WIDTH).reshape(HEIGHT, WIDTH) % 2
    found.proposals(0, lambda: [half.bool()])
    found.save(1, {0: half}, TrackingState(half, {1: 2}, 2))


def weights(folder: Path) -> None:
    """A feature network's."""
    folder.mkdir(parents=True)
    shutil.copy(PACKAGED, folder / "compact.safetensors")
