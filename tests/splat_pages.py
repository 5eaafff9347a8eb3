"""The balls with two of them painted, and what is in a page of them."""

import base64
import json
import re
import zlib
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch

from balls import CAMERAS, SPLATS
from painted_balls import PICKS
from plain_layers import layer_towards
from stylesplat.rendering.sh import sh0_from_rgb
from stylesplat.scene.compose import with_layers
from stylesplat.scene.layer import without_identities
from stylesplat.scene.scene import Scene, SceneObject
from stylesplat.scene.splats import Splats

TIMES = 5  # so many Gaussians for one: more than a line of a texture or an instance holds
PICKED = {name: PICKS[name].repeat(TIMES) for name in ("red", "green", "blue")}


def scene() -> Scene:
    """2,200 Gaussians of all sizes, shapes and turns, whose colours depend on the view."""
    generator = torch.Generator().manual_seed(3)

    def noise(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=generator)

    rows = torch.arange(len(SPLATS)).repeat(TIMES)
    count = len(rows)
    before = replace(
        SPLATS[rows],
        means=SPLATS.means[rows] + 0.03 * noise(count, 3),
        quats=noise(count, 4),
        scales=SPLATS.scales[rows]
        - torch.where(rows % 3 == 0, 3.5, 0.5)[:, None]
        + 0.4 * noise(count, 3),
        opacities=0.5 + noise(count),
        shN=(0.1 * noise(300, 15, 3))[torch.arange(count) % 300],  # more than a palette holds
    )
    painted = PICKED["red"] | PICKED["blue"]
    sh0 = torch.where(painted[:, None, None], sh0_from_rgb(before.sh0.abs() % 1), before.sh0)
    shN = torch.where(painted[:, None, None], 0 * before.shN, before.shN)
    faded = torch.where(painted & (torch.arange(count) % 7 == 0), -16.0, before.opacities)
    after = replace(before, sh0=sh0, shN=shN, opacities=faded)
    scene = Scene(
        splats=before,
        cameras=CAMERAS,
        objects={name: SceneObject(picked) for name, picked in PICKED.items()},
    )
    layers = [layer_towards(before, after, PICKED[name], name) for name in ("red", "blue")]
    rows = PICKED["red"].nonzero()[::7, 0]
    canvas = replace(after[rows], means=after.means[rows] + 0.01, opacities=before.opacities[rows])
    canvas = without_identities(canvas)
    colors = {"canvas": canvas, "canvas_sh0": before.sh0[rows], "parents": rows}
    relief = torch.zeros(len(layers[0].rows) + len(rows))
    layers[0] = replace(layers[0], **colors, relief=relief)
    return with_layers(scene, layers)


@dataclass(frozen=True)
class Read:
    """What a page holds, its numbers as they are meant."""

    about: dict[str, Any]
    splats: Splats
    before: Splats


def element(page: str, name: str) -> str:
    found = re.search(rf'<script type="[^"]*" id="{name}">(.*?)</script>', page, re.DOTALL)
    assert found is not None
    return found[1]


def read(page: str) -> Read:
    """The same as `unpack.js` does."""
    about = json.loads(element(page, "about"))
    content = zlib.decompress(base64.b64decode(element(page, "splats")))
    columns = _Columns(np.frombuffer(content, np.uint8).astype(np.float64))
    count, painted, bands = about["count"], about["painted"], about["bands"]
    high_low = columns.take(3, 2, count)
    low, high = np.array(about["means"]).T[:, :, None]
    places = low + (high - low) * (256 * high_low[:, 0] + high_low[:, 1]) / 65535
    means = np.array(about["middle"])[:, None] + about["reach"] * np.sinh(places)
    scales = _between(columns.take(3, count), about["scales"])
    largest, others = columns.take(count).astype(int), columns.take(3, count)
    opacities = columns.take(count) / 255
    after = _between(columns.take(3, count), about["colors"])
    is_painted = columns.take(count) > 0
    before = after.copy()
    before[:, is_painted] = _between(columns.take(3, painted), about["colors"])
    earlier_opacities = opacities.copy()
    earlier_opacities[is_painted] = columns.take(painted) / 255
    strongest = np.array(about["strongest"])[:, None, None, None]
    palettes = (columns.take(2, bands, 256, 3) - 128) / 127 * strongest
    entries = columns.take(2, count).astype(int) if bands else np.zeros((2, count), int)
    earlier = entries.copy()
    earlier[:, is_painted] = columns.take(2, painted) if bands else 0
    assert columns.start == len(content), "nothing follows"
    quats = [
        np.insert(turn, place, np.sqrt(max(0, 1 - turn @ turn)))
        for turn, place in zip((others.T / 255 * 2 - 1) * 0.5**0.5, largest, strict=True)
    ]
    splats = Splats(
        means=_tensor(means.T),
        quats=_tensor(np.array(quats)),
        scales=_tensor(scales.T),
        opacities=_tensor(opacities).logit(),
        sh0=sh0_from_rgb(_tensor(after.T))[:, None],
        shN=_tensor(sum(palettes[level][:, entries[level]] for level in (0, 1))).transpose(0, 1),
    )
    shN = _tensor(sum(palettes[level][:, earlier[level]] for level in (0, 1))).transpose(0, 1)
    earlier_splats = replace(
        splats,
        sh0=sh0_from_rgb(_tensor(before.T))[:, None],
        shN=shN,
        opacities=_tensor(earlier_opacities).logit(),
    )
    return Read(about, splats, earlier_splats)


class _Columns:
    def __init__(self, values: np.ndarray):
        self.values, self.start = values, 0

    def take(self, *shape: int) -> np.ndarray:
        count = int(np.prod(shape))
        self.start += count
        return self.values[self.start - count : self.start].reshape(shape)


def _between(values: np.ndarray, bounds: list[float]) -> np.ndarray:
    return bounds[0] + (bounds[1] - bounds[0]) * values / 255


def _tensor(values: Any) -> torch.Tensor:
    return torch.from_numpy(np.asarray(values, np.float32))
