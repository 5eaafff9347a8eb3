"""A scene with all that figures need of it: views, true masks, styles, a network."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import torch
from bench import VGG19, style_network
from torch import Tensor

import stylesplat as ss
from stylesplat.demo.demo_run import TRAINING, copy_capture
from stylesplat.io.captures.capture_folder import exact_masks
from stylesplat.io.style_pictures import read_style
from stylesplat.rendering.render import rasterize
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.capture import Capture, Labels, resize_labels
from stylesplat.scene.scene import Scene
from stylesplat.scene.sequences import evenly_spaced
from stylesplat.scene.splats import Splats
from stylesplat.selection.labels import object_ids, pick
from stylesplat.stylization.features import FeatureNetwork, load_weights

# Many Gaussians on the demo's objects carry the strokes.
JOINT_TRAINING = replace(TRAINING, object_growth=10.0)
MARGIN = 0.25  # of the object's size that pictures show around it


@dataclass(frozen=True)
class Effort:
    """How much is computed."""

    steps: int
    """Of each painting."""
    masked_steps: int
    """Of the loss masked in 2D and of the same loop in 3D."""
    side: int
    """Pixels of the longer side of the frames of these loops."""
    whole_grid: bool
    """All of Figure 6's grid; else a row and a column through its middle."""
    trained: bool
    """Train anew with each set of label maps; else lift these onto the Gaussians there are."""
    draft: bool
    """Whether our own paintings are drafts, which split nothing."""
    judged: int
    """Held-out views that are compared."""
    training_steps: int | None = None
    """Of joint training next to lifting; by default the scene's own."""


QUICK = Effort(
    60, 60, 384, whole_grid=False, trained=False, draft=True, judged=3, training_steps=300
)
MEDIUM = Effort(
    100, 60, 384, whole_grid=False, trained=False, draft=False, judged=4, training_steps=450
)
FULL = Effort(500, 500, 480, whole_grid=True, trained=True, draft=False, judged=8)
EFFORTS = {"quick": QUICK, "medium": MEDIUM, "full": FULL}


@dataclass(frozen=True)
class Subject:
    """A scene to make figures of."""

    name: str
    """In headings and folders."""
    scene: Scene
    """Trained, with objects."""
    capture: Capture
    """The photos and the label maps that it was trained with, at the size that it was made at."""
    exact: Capture | None
    """The same with exact label maps, if there are any."""
    styles: Mapping[str, Tensor]
    """Pictures, colours in 0..1."""
    network: FeatureNetwork
    """Whose features are matched."""
    effort: Effort
    """How much is computed."""

    @property
    def splats(self) -> Splats:
        """The Gaussians."""
        return self.scene.splats

    @property
    def joint(self) -> bool:
        """Whether identities were learned with the colours, rather than lifted afterwards."""
        return (self.scene.info["settings"].get("segment") or "joint") == "joint"

    @property
    def pattern(self) -> Tensor:
        """The picture that repeats itself: the last."""
        return [*self.styles.values()][-1]

    @cached_property
    def ids(self) -> tuple[int, ...]:
        """The objects' label ids, the one that its best view shows best first."""
        ids, maps = object_ids(self.splats), self.true_maps
        best = {id: max(shown(labels, id) for labels in maps) for id in ids}
        return tuple(sorted(best, key=lambda id: -best[id]))

    @property
    def truth(self) -> Capture:
        """What masks are compared with: exact ones, or else those that were given."""
        return self.exact or self.capture

    @cached_property
    def training(self) -> Cameras:
        """Views that were trained on."""
        return self.scene.working_views()[0]

    @cached_property
    def held_out(self) -> Cameras:
        """Views to judge in: some of those that were not trained on."""
        every = self.scene.working_views()[1]
        if every is None:
            raise SystemExit(f"{self.name} has no held-out views. Train it with --test-every 8.")
        return every[evenly_spaced(range(len(every)), self.effort.judged)]

    def true_map(self, camera: Cameras) -> Labels:
        """The true label map of one view, at its size."""
        maps = self.truth.label_maps
        assert maps is not None
        labels = maps[self.truth.cameras.index(camera.names[0])]
        if labels is None:
            raise SystemExit(f"{camera.names[0]} of {self.name} has no label map.")
        return resize_labels(labels, camera.size[::-1])

    @cached_property
    def true_maps(self) -> list[Labels]:
        """Those of the held-out views."""
        return [self.true_map(camera) for camera in each(self.held_out)]

    def picked(self, id: int) -> Tensor:
        """An object's Gaussians."""
        return pick(self.splats, object_id=id)

    def called(self, id: int) -> str:
        """An object's name."""
        for name, found in self.scene.objects.items():
            if found.selection.ids == (id,):
                return name
        return self.capture.object_names.get(id, f"object {id}")

    def best_view(self, *ids: int) -> Cameras:
        """The held-out view that shows an object best; of several, the worst shown."""
        worst = [min(shown(labels, id) for id in ids) for labels in self.true_maps]
        return self.held_out[worst.index(max(worst))]


def shown(labels: Labels, id: int) -> float:
    """How large an object is shown; much less where the picture's edge cuts it off."""
    mask = labels == id
    edge = sum(int(side.sum()) for side in (mask[0], mask[-1], mask[:, 0], mask[:, -1]))
    return int(mask.sum()) / (1 + edge)


def each(cameras: Cameras) -> list[Cameras]:
    """Cameras one by one."""
    return [cameras[row] for row in range(len(cameras))]


@torch.no_grad()
def shot(splats: Splats, camera: Cameras) -> Tensor:
    """What a camera sees, colours in 0..1."""
    return rasterize(splats, camera)[0][0].clamp(0, 1)


def cut(picture: Tensor, mask: Tensor) -> Tensor:
    """The part of a picture around a mask."""
    places = mask.nonzero()
    low, high = places.amin(dim=0), places.amax(dim=0) + 1
    margin = (MARGIN * (high - low).max()).long()
    (top, left), (bottom, right) = (low - margin).clamp(min=0).tolist(), (high + margin).tolist()
    return picture[top:bottom, left:right]


def open_subject(given: str, output: Path, effort: Effort, features: str | None) -> Subject:
    """A trained scene's folder, or `demo`, which is made in the output if it is not there.

    The network is VGG19 where its weights are on this machine and nothing else is asked for, or
    else the one that ships with the package.
    """
    folder = _demo(output) if given == "demo" else Path(given)
    scene = ss.open(folder)
    if scene.capture is None:
        raise SystemExit(f"{folder} knows no photos. Train it anew.")
    truth = exact_masks(scene.capture)
    photos = ss.load(scene.capture, downscale=scene.downscale)
    return Subject(
        name=given if given == "demo" else folder.name,
        scene=scene,
        capture=photos,
        exact=ss.load(scene.capture, downscale=scene.downscale, masks=truth) if truth else None,
        styles=_styles(scene.capture, output),
        network=_network(features),
        effort=effort,
    )


def _network(features: str | None) -> FeatureNetwork:
    if features == "vgg19" and VGG19.is_file():
        return style_network()
    return load_weights(features or "compact", depth=3)  # type: ignore[arg-type]


def _demo(output: Path) -> Path:
    folder = output / "demo-scene"
    if not (folder / "scene.json").is_file():
        photos = copy_capture(output / "demo-capture")
        ss.save(ss.train(ss.load(photos), JOINT_TRAINING, segment="joint"), folder)
    return folder


def _styles(capture: Path, output: Path) -> dict[str, Tensor]:
    """The capture's own pictures, or the demo's; the scales, which are tiles, are the last."""
    tiles = copy_capture(output / "demo-capture") / "styles" / "scales.jpg"
    folder = capture / "styles"
    found = sorted((folder if folder.is_dir() else tiles.parent).iterdir())
    paths = [path for path in found if path.stem != tiles.stem] + [tiles]
    return {path.stem.replace("_", " "): read_style(path) for path in paths}
