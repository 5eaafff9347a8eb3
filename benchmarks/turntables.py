"""Poses of objects that turn before real photographs of a room: how many, and how right are they?

    python benchmarks/turntables.py --scene SCENE --object NAME --backdrops PHOTO [PHOTO ...]

The object of a scene whose up is -y (as `sfm` and `train` make them) turns on a platter, in 36 and
in 72 steps, with a shadow and noise, before each backdrop, sharp and as a blank wall. Poses are
compared with the truth after a similarity that fits them best.
"""

import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import cv2
import numpy as np
import torch
import tyro
from bench import table
from jaxtyping import Float
from PIL import Image
from scipy.spatial.transform import Rotation
from torch import Tensor

import stylesplat as ss
from stylesplat.errors import StyleSplatError
from stylesplat.imaging.similarity import mask_iou
from stylesplat.io.label_maps import write_label_map
from stylesplat.io.mask_pictures import read_label_map
from stylesplat.rendering.render import render
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import resize_labels
from stylesplat.scene.splats import Splats
from stylesplat.selection.objects import cut_out
from stylesplat.selection.resolve import find_object

WIDTH, HEIGHT, FOCAL = 1000, 750, 1200.0
ELEVATION, FILLS = 20.0, 0.6  # degrees, and the share of the height that the object fills
NOISE, FLICKER = 2.0, 0.01  # grey levels, and a share of the exposure
LIGHT = (0.5, 1.0, 0.3)  # direction in which light falls in the room, whose y is down
NEAR = 3.0  # times the median distance from the middle: what is farther is stray
SOLID, WIDE = 0.0, 2.2  # logit of an opacity; times the median distance from the axis
SHADE, GRAIN = 0.6, 400  # how much of the light a shadow takes; cells of its map and of speckles


@dataclass(frozen=True)
class Turntable:
    """An object in a room whose y is down: at the origin, with what it stands on at `floor`."""

    splats: Splats
    radius: float
    floor: float

    @staticmethod
    def of(scene: ss.Scene, name: str) -> "Turntable":
        splats = cut_out(scene, find_object(scene, name)).base.detach()
        away = (splats.means - splats.means.median(dim=0).values).norm(dim=1)
        splats = splats[away < NEAR * away.median()]
        means = splats.means
        solid = means[splats.opacities.reshape(-1) > SOLID]
        low, high = solid.quantile(0.01, dim=0), solid.quantile(0.99, dim=0)
        middle = (low + high) / 2
        radius = WIDE * float((solid - middle)[:, [0, 2]].norm(dim=1).median())
        return Turntable(replace(splats, means=means - middle), radius, float(high[1] - middle[1]))

    def camera(self, angle: float, name: str) -> Cameras:
        """The camera that stands still, in the frame of the object turned by an angle."""
        size = max(2 * self.floor, 1.5 * self.radius)
        away = FOCAL * size / (FILLS * HEIGHT)
        pitch = Rotation.from_euler("x", -ELEVATION, degrees=True).as_matrix()
        turn = Rotation.from_euler("y", angle, degrees=True).as_matrix()
        view = np.eye(4)
        view[:3, :3] = pitch @ turn
        view[2, 3] = away
        K = torch.tensor([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1.0]])
        return Cameras(
            viewmats=torch.from_numpy(view).float()[None],
            Ks=K[None],
            sizes=torch.tensor([[WIDTH, HEIGHT]]),
            names=(name,),
        )

    def photos(
        self, backdrop: Float[np.ndarray, "H W 3"], steps: int, *, speckled: bool
    ) -> Iterator[tuple[Float[np.ndarray, "H W 3"], Float[np.ndarray, "H W"], Cameras]]:
        """Photos in 0..1 with noise, how opaque the object is in them, and their cameras."""
        rng = np.random.default_rng(0)
        grain = cv2.GaussianBlur(rng.random((GRAIN, GRAIN, 1)).astype(np.float32), (0, 0), 1.5)
        grain = (grain - grain.mean()) / grain.std() * (0.08 if speckled else 0.0)
        room = self.camera(0, "room")
        reach = 1.5 * self.radius
        # where the rays of pixels meet the floor, in the room
        rows, columns = np.mgrid[:HEIGHT, :WIDTH] + 0.5
        rays = np.stack(
            [(columns - WIDTH / 2) / FOCAL, (rows - HEIGHT / 2) / FOCAL, np.ones_like(rows)],
            axis=-1,
        )
        view = room.viewmats[0].double().numpy()
        origin, rays = -view[:3, :3].T @ view[:3, 3], rays @ view[:3, :3]
        along = (self.floor - origin[1]) / rays[..., 1]
        spots = (origin + along[..., None] * rays)[..., [0, 2]]
        on_floor = along > 0
        on_platter = on_floor & (np.linalg.norm(spots, axis=-1) < reach)
        means = self.splats.means.double().numpy()
        opaque = self.splats.opacities.detach().numpy().reshape(-1) > SOLID
        for step in range(steps):
            angle = 360 * step / steps
            turn = Rotation.from_euler("y", angle, degrees=True).as_matrix()
            camera = self.camera(angle, f"{step:03}.jpg")
            image, alpha = render(self.splats, camera)
            image, alpha = image.double().numpy().clip(0, 1), alpha[..., 0].double().numpy()
            placed = means[opaque] @ turn.T
            fall = (self.floor - placed[:, 1:2]) / LIGHT[1]
            shade = (placed + fall * np.array(LIGHT))[:, [0, 2]]
            cells = ((shade / (3 * reach) + 0.5) * GRAIN).astype(int).clip(0, GRAIN - 1)
            covered = np.zeros((GRAIN, GRAIN), np.float32)
            covered[cells[:, 1], cells[:, 0]] = 1
            covered = cv2.GaussianBlur(cv2.dilate(covered, np.ones((5, 5))), (0, 0), 4)
            place = (spots / (3 * reach) + 0.5) * GRAIN
            x, y = (place[..., i].astype(np.float32) for i in (0, 1))
            dark = np.where(on_floor, cv2.remap(covered, x, y, cv2.INTER_LINEAR), 0)
            turned = spots @ turn[[0, 2]][:, [0, 2]]  # in the platter's own frame
            place = (turned / (2 * reach) + 0.5) * GRAIN
            x, y = (place[..., i].astype(np.float32) for i in (0, 1))
            platter = 0.55 + cv2.remap(grain, x, y, cv2.INTER_LINEAR)[..., None]
            behind = np.where(on_platter[..., None], platter, backdrop)
            behind = behind * (1 - SHADE * dark[..., None])
            photo = image + (1 - alpha[..., None]) * behind
            photo = photo * (1 + FLICKER * rng.standard_normal())
            yield photo + rng.normal(0, NOISE / 255, photo.shape), alpha, camera


def write(
    turning: Turntable,
    folder: Path,
    backdrop: Float[np.ndarray, "H W 3"],
    steps: int,
    *,
    speckled: bool,
) -> None:
    """Write `photos/`, exact `masks/`, and `truth.pt`, the cameras in the object's frame."""
    (folder / "photos").mkdir(parents=True)
    (folder / "masks").mkdir()
    cameras = []
    for photo, alpha, camera in turning.photos(backdrop, steps, speckled=speckled):
        pixels = Image.fromarray((255 * photo.clip(0, 1)).round().astype(np.uint8))
        pixels.save(folder / "photos" / camera.names[0], quality=92)
        stem = Path(camera.names[0]).stem
        write_label_map(torch.from_numpy(alpha > 0.5).int(), folder / "masks" / f"{stem}.png")
        cameras.append(camera)
    truth = {
        "viewmats": torch.cat([each.viewmats for each in cameras]),
        "Ks": torch.cat([each.Ks for each in cameras]),
        "sizes": torch.cat([each.sizes for each in cameras]),
        "names": tuple(each.names[0] for each in cameras),
    }
    torch.save(truth, folder / "truth.pt")


def pose_errors(found: Cameras, truth: Cameras) -> Float[Tensor, " P"]:
    """Degrees between the turns of cameras, after the turn of the world that fits best."""
    rows = [truth.names.index(name) for name in found.names]
    relative = truth.viewmats[rows, :3, :3].mT.double() @ found.viewmats[:, :3, :3].double()
    mean = Rotation.from_matrix(relative.numpy()).mean()  # found world to true world
    left = Rotation.from_matrix(relative.numpy()) * mean.inv()
    return torch.from_numpy(np.degrees(left.magnitude()))


def backdrop_of(photo: Path, *, blank: bool) -> Float[np.ndarray, "H W 3"]:
    """A photo of a room, cut to the size of a turntable's; blank is what is left of it far away."""
    pixels = np.asarray(Image.open(photo).convert("RGB"), np.float64) / 255
    scale = max(WIDTH / pixels.shape[1], HEIGHT / pixels.shape[0])
    pixels = cv2.resize(pixels, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    top, left = (pixels.shape[0] - HEIGHT) // 2, (pixels.shape[1] - WIDTH) // 2
    pixels = pixels[top : top + HEIGHT, left : left + WIDTH]
    return cv2.GaussianBlur(pixels, (0, 0), 80) if blank else pixels


HEADS = ("turntable", "posed", "median", "worst", "arc", "mask", "seconds")


def measured(name: str, folder: Path) -> tuple[object, ...]:
    """One row of the table: errors are in degrees, masks compared by IoU."""
    truth = Cameras(**torch.load(folder / "truth.pt"))
    start = time.perf_counter()
    try:
        capture = ss.sfm(folder / "photos", folder / "capture", overwrite=True)
    except StyleSplatError as error:
        return name, str(error), *[""] * (len(HEADS) - 2)
    seconds = time.perf_counter() - start
    errors = pose_errors(capture.cameras, truth)
    found = list[float]()
    for row, own in enumerate(capture.cameras.names):
        labels = capture.labels(row)
        if labels is not None:
            mask = read_label_map(folder / "masks" / f"{Path(own).stem}.png") > 0
            found.append(mask_iou(labels > 0, resize_labels(mask, labels.shape)))
    posed = f"{len(capture)} of {len(truth)}"
    degrees = (f"{errors.median():.2f}", f"{errors.max():.2f}")
    arc = f"{ss.check(capture).coverage.arc:.0f}"
    mask = f"{np.mean(found):.3f}" if found else ""
    return name, posed, *degrees, arc, mask, f"{seconds:.0f}"


def main(
    scene: Path,
    object: str,
    backdrops: list[Path],
    *,
    steps: tuple[int, ...] = (36, 72),
    keep: Path | None = None,
) -> None:
    """Print a row for each turntable; `keep` is a folder for the photos."""
    turning, rows = Turntable.of(ss.open(scene), object), []
    with tempfile.TemporaryDirectory() as temporary:
        for photo, is_blank, speckled, count in product(
            backdrops, (False, True), (False, True), steps
        ):
            kinds = ("blank" if is_blank else "busy", "speckled" if speckled else "plain")
            name = "-".join((object, photo.stem, *kinds, str(count)))
            folder = (keep or Path(temporary)) / name
            if not folder.exists():
                write(turning, folder, backdrop_of(photo, blank=is_blank), count, speckled=speckled)
            rows.append(measured(name, folder))
            print(*rows[-1], flush=True)
    print(table(HEADS, rows))


if __name__ == "__main__":
    tyro.cli(main)
