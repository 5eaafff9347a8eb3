"""The mistakes that a 2D segmenter makes, added to exact label maps.

Segment-and-track tools draw ragged borders, lose an object in some views, take two neighbours for
one, and leave scraps of one object on another. Training has to live with all of these.
"""

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

REFERENCE_WIDTH = 480  # the settings in pixels are for images of this width


@dataclass(frozen=True)
class FaultConfig:
    """How bad the label maps get."""

    border: float = 4.0
    """Largest displacement of a border, in pixels at a width of 480."""
    missing: float = 0.06
    """Chance that an object is not found in a view."""
    merged: float = 0.08
    """Chance that, in a view, one object is taken for a neighbour."""
    fragments: float = 0.25
    """Chance that, in a view, a patch of one object carries another's id."""


def corrupt_label_maps(
    label_maps: list[Int[Tensor, "H W"]],
    *,
    seed: int = 0,
    config: FaultConfig | None = None,
) -> list[Int[Tensor, "H W"]]:
    """Add a segmenter's typical mistakes to exact label maps.

    Args:
        label_maps: One per view; 0 is background.
        seed: Of all the chances.
        config: How many mistakes; the defaults are those of the demo.

    Returns:
        New maps of the same shape. No id appears that was not in the input.
    """
    config = config or FaultConfig()
    rng = np.random.default_rng(seed)
    return [torch.from_numpy(_corrupt(m.numpy(), config, rng)) for m in label_maps]


def _corrupt(
    labels: Int[np.ndarray, "H W"], config: FaultConfig, rng: np.random.Generator
) -> Int[np.ndarray, "H W"]:
    if rng.random() < config.merged:
        labels = _merge(labels, rng)
    if rng.random() < config.fragments:
        labels = _scatter(labels, rng)
    lost = [i for i in _ids(labels) if rng.random() < config.missing]
    labels = np.where(np.isin(labels, lost), 0, labels)
    return _fray(labels, config.border * labels.shape[1] / REFERENCE_WIDTH, rng)


def _ids(labels: Int[np.ndarray, "H W"]) -> list[int]:
    return [int(i) for i in np.unique(labels) if i != 0]


def _smooth_noise(
    shape: tuple[int, int], sigma: float, rng: np.random.Generator
) -> Float[np.ndarray, "H W"]:
    """Blurred white noise, scaled so that two standard deviations fill -1 .. 1."""
    field = cv2.GaussianBlur(rng.standard_normal(shape), (0, 0), max(sigma, 0.5))
    return np.clip(field / (2 * field.std()), -1, 1)


def _fray(
    labels: Int[np.ndarray, "H W"], reach: float, rng: np.random.Generator
) -> Int[np.ndarray, "H W"]:
    """Look each label up at a position displaced by up to `reach` pixels."""
    rows, columns = np.indices(labels.shape, dtype=np.float32)
    dy, dx = (reach / 2**0.5 * _smooth_noise(labels.shape, 1.2 * reach, rng) for _ in range(2))
    y = (rows + dy).round().astype(int).clip(0, labels.shape[0] - 1)
    x = (columns + dx).round().astype(int).clip(0, labels.shape[1] - 1)
    return labels[y, x]


def _merge(labels: Int[np.ndarray, "H W"], rng: np.random.Generator) -> Int[np.ndarray, "H W"]:
    """Give one object the id of an object that it touches in the image."""
    pairs = [
        (i, j)
        for i in _ids(labels)
        for j in _ids(cv2.dilate((labels == i).astype(np.uint8), np.ones((5, 5))) * labels)
        if i != j
    ]
    if not pairs:
        return labels
    taken, by = pairs[rng.integers(len(pairs))]
    return np.where(labels == taken, by, labels)


def _scatter(labels: Int[np.ndarray, "H W"], rng: np.random.Generator) -> Int[np.ndarray, "H W"]:
    """Give a patch of one object the id of another object in the view."""
    ids = _ids(labels)
    if len(ids) < 2:
        return labels
    host, guest = rng.choice(ids, 2, replace=False)
    places = np.argwhere(labels == host)
    centre = places[rng.integers(len(places))]
    radius = rng.uniform(0.25, 0.5) * np.sqrt(len(places) / np.pi)
    rows, columns = np.indices(labels.shape)
    distance = np.hypot(rows - centre[0], columns - centre[1])
    ragged = 1 + 0.5 * _smooth_noise(labels.shape, radius / 3, rng)
    return np.where((labels == host) & (distance < radius * ragged), guest, labels)
