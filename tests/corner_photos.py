"""Photos of a textured corner, three walls, from known places."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import torch
from PIL import Image

from stylesplat.scene.poses import look_at
from stylesplat.structure_from_motion.photo_folder import PreparedPhotos

WIDTH, HEIGHT, FOCAL = 320, 240, 330.0
TEXTURE = 512  # pixels a side
K = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]])


def places_around(count: int, spread: float = 1.0) -> np.ndarray:
    """Places on an arc in front of the corner, at changing heights."""
    angles = np.pi / 4 + spread * np.linspace(-0.45, 0.45, count)
    heights = 1.1 + 0.35 * spread * np.sin(3 * np.arange(count))
    return np.stack([2.6 * np.cos(angles), 2.6 * np.sin(angles), heights], axis=1)


def towards(places: np.ndarray, target: Sequence[float] = (0.35, 0.35, 0.45)) -> np.ndarray:
    """World to camera, for cameras that look at one point."""
    up = torch.tensor([0.0, 0.0, 1.0])
    aim = torch.tensor([float(x) for x in target])
    mats = look_at(torch.from_numpy(places).float(), aim, up)
    return mats.double().numpy()


def turned(count: int) -> np.ndarray:
    """World to camera, for cameras that turn in one place."""
    place = np.array([1.9, 1.9, 1.1])
    targets = [(0.9 - 1.3 * s, -0.4 + 1.3 * s, 0.45) for s in np.linspace(0, 1, count)]
    return np.concatenate([towards(place[None], target) for target in targets])


def photograph_corner(viewmat: np.ndarray, seed: int = 0) -> np.ndarray:
    """What one camera sees: each pixel's ray meets the nearest of three walls."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    pixels = np.stack([columns, rows, np.ones_like(rows)], axis=-1)
    rays = pixels @ np.linalg.inv(K).T @ viewmat[:3, :3]
    eye = -viewmat[:3, :3].T @ viewmat[:3, 3]
    picture, nearest = np.full((HEIGHT, WIDTH), 128.0, np.float32), np.full((HEIGHT, WIDTH), 1e9)
    for axis in range(3):
        t = -eye[axis] / rays[..., axis]
        hits = np.delete(eye + t[..., None] * rays, axis, axis=-1).astype(np.float32) * 150
        seen = (t > 0) & (t < nearest)
        wall = cv2.remap(
            _texture(seed, axis),
            hits[..., 0] + 150,
            hits[..., 1] + 150,
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REFLECT,
        )
        picture[seen], nearest[seen] = wall[seen], t[seen]
    return picture.clip(0, 255).astype(np.uint8)


def _texture(seed: int, axis: int) -> np.ndarray:
    rng = np.random.default_rng([seed, axis])
    layers = [
        cv2.resize(rng.uniform(-1, 1, (n, n)).astype(np.float32), (TEXTURE, TEXTURE))
        for n in (16, 48, 128)
    ]
    return 128 + 75 * np.sum(layers, axis=0)


def write_photos(
    folder: Path, pictures: dict[str, np.ndarray], sharpness: dict[str, float] | None = None
) -> PreparedPhotos:
    """Write pictures by name."""
    for name, picture in pictures.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(picture).convert("RGB").save(path, quality=95)
    names = tuple(pictures)
    usual = dict.fromkeys(names, 1.0)
    own = dict(zip(names, names, strict=True))
    return PreparedPhotos(names, ordered=False, origins=own, sharpness=usual | (sharpness or {}))


def corner(count: int = 10, *, seed: int = 0, prefix: str = "") -> dict[str, np.ndarray]:
    """Photos of the corner from an arc, by name."""
    mats = towards(places_around(count, spread=count / 10))
    return {f"{prefix}{i:02}.jpg": photograph_corner(m, seed) for i, m in enumerate(mats)}
