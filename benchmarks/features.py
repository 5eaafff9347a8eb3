"""The compact feature network against its teacher, VGG19, on pictures it has never seen.

    .venv/bin/python benchmarks/features.py [--weights FILE]

Photos of fox and desk, renders of fox as styles are matched on them, and three paintings. Targets:
mean cosine to VGG19's features of .90 in every block; nearest style features that reach 97 % of the
cosine of VGG19's own choice; 85 % of the way from unstyled to VGG19-styled in VGG19's loss; forward
and backward 4 times faster, stylisation 2 times.
"""

import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch
import tyro
from bench import (
    DATA,
    STYLES,
    VGG19,
    calibration_ms,
    machine,
    median_ms,
    style_network,
    table,
    trained_scene,
)
from safetensors.torch import load_file
from torch import Tensor
from torch.nn import functional as F

import stylesplat as ss
from stylesplat.evaluation.style import measure_style
from stylesplat.io.style_pictures import read_style, resize
from stylesplat.rendering.render import rasterize
from stylesplat.scene.sequences import evenly_spaced
from stylesplat.selection.labels import pick
from stylesplat.stylization.config import PATTERN_LENGTH, Network, StyleConfig
from stylesplat.stylization.features import PACKAGED, FeatureNetwork, fastest_dtype, load_weights
from stylesplat.stylization.matching import most_similar
from stylesplat.stylization.painter import paint_setup, paint_steps
from stylesplat.stylization.painting import Painting
from stylesplat.stylization.style import style_features
from stylesplat.stylization.views import ObjectView, object_views, require_boxes

FOX = 1  # label id
MEDIUM = PATTERN_LENGTH  # pixels of an object when its style is matched last
COARSE = 0.6  # share of it in the coarse stages
BLOCKS = (1, 2, 3)
PHOTO_SIZE = 256  # pixels of photos and paintings whose features are compared
PHOTOS = 6  # of each scene
VIEWS = 6  # of the fox


@dataclass(frozen=True)
class Options:
    """What to measure."""

    weights: Path = PACKAGED
    """Of the compact network."""


@dataclass(frozen=True)
class Bench:
    """Both networks, the scene and the paintings."""

    weights: Path
    compact: FeatureNetwork
    vgg19: FeatureNetwork
    to_vgg19: Sequence[Tensor]
    scene: ss.Scene
    paintings: dict[str, Tensor]

    def job(self, painting: str) -> Painting:
        """The fox in a painting."""
        picked = pick(self.scene.splats, object_id=FOX)
        return Painting(painting, picked, (self.paintings[painting],), StyleConfig())


def photos(scene: str) -> list[Tensor]:
    """Some photos of a scene."""
    paths = evenly_spaced(sorted((DATA / scene / "images").iterdir()), PHOTOS)
    return [resize(read_style(path), PHOTO_SIZE) for path in paths]


def fox_views(bench: Bench, length: float) -> tuple[list[ObjectView], list[Tensor]]:
    """Views of the fox at some size, and their renders."""
    training, _ = bench.scene.working_views()
    studio = paint_setup(bench.scene.splats, training, bench.vgg19)
    job = bench.job(next(iter(bench.paintings)))
    views = evenly_spaced(object_views(studio, job, require_boxes(studio, job), length), VIEWS)
    images = [rasterize(bench.scene.splats, view.camera)[0][0].clamp(0, 1) for view in views]
    return views, images


@torch.no_grad()
def cosine(bench: Bench, images: Sequence[Tensor], block: int) -> float:
    """The mean cosine of the student's features, as VGG19's, to VGG19's."""
    found = []
    for image in images:
        cells = bench.compact.cells(block)
        rows, columns = (cells.inside(length) for length in image.shape[:2])
        own, theirs = (n(image, [block])[0][rows, columns] for n in (bench.compact, bench.vgg19))
        found.append(F.cosine_similarity(own @ bench.to_vgg19[block - 1].T, theirs, dim=-1).mean())
    return float(torch.stack(found).mean())


def cosines(bench: Bench) -> str:
    """Agreement of the features themselves."""
    kinds = {
        "fox, photos": photos("fox"),
        "desk, photos": photos("desk"),
        "fox, renders": fox_views(bench, MEDIUM)[1],
        "paintings": [resize(picture, PHOTO_SIZE) for picture in bench.paintings.values()],
    }
    rows = [
        [kind, *(f"{cosine(bench, images, block):.3f}" for block in BLOCKS)]
        for kind, images in kinds.items()
    ]
    return table(["cosine to VGG19", *(f"block {block}" for block in BLOCKS)], rows)


@torch.no_grad()
def agreement(bench: Bench) -> str:
    """Of the cosine that VGG19's choice of a style feature reaches, what the student's reaches."""
    rows = []
    for length in (COARSE * MEDIUM, MEDIUM):
        views, images = fox_views(bench, length)
        for name, painting in bench.paintings.items():
            reached = [
                _reached(bench, view, image, painting, length)
                for view, image in zip(views, images, strict=True)
            ]
            ours, theirs = (sum(column) for column in zip(*reached, strict=True))
            rows.append(
                [
                    name,
                    f"{length:.0f}",
                    f"{ours / VIEWS:.3f}",
                    f"{theirs / VIEWS:.3f}",
                    f"{100 * ours / theirs:.1f} %",
                ]
            )
    heads = ["nearest style feature", "fox, px", "cosine, compact's", "VGG19's", "reached"]
    return table(heads, rows)


def _reached(
    bench: Bench, view: ObjectView, image: Tensor, painting: Tensor, length: float
) -> tuple[float, float]:
    """The mean cosine in VGG19's space of the student's and of VGG19's choice."""
    chosen, queries, styles = [], None, None
    for network in (bench.compact, bench.vgg19):
        queries = network(image)[0][view.cells]
        styles = style_features(painting, network, 3, length=StyleConfig().scale * length)
        chosen.append(most_similar(queries, F.normalize(styles, dim=1)))
    assert queries is not None
    assert styles is not None
    ours, theirs = (float(F.cosine_similarity(queries, styles[c], dim=1).mean()) for c in chosen)
    return ours, theirs


def equivalence(bench: Bench) -> str:
    """VGG19's loss of the fox before, styled with either network, and the share of the way."""
    training, held_out = bench.scene.working_views()
    rows = []
    for name in bench.paintings:
        job, losses = bench.job(name), {}
        for title, network in (("vgg19", bench.vgg19), ("compact", bench.compact)):
            studio = paint_setup(bench.scene.splats, training, network, held_out=held_out)
            *_, last = paint_steps(studio, job)
            judged = replace(studio, network=bench.vgg19, cameras=held_out or training)
            found = measure_style(judged, job, last.splats)
            losses |= {"before": found["nnfm_before"], title: found["nnfm_after"]}
        share = (losses["before"] - losses["compact"]) / (losses["before"] - losses["vgg19"])
        numbers = [f"{losses[title]:.4f}" for title in ("before", "vgg19", "compact")]
        rows.append([name, *numbers, f"{100 * share:.0f} %"])
    return table(["VGG19's NNFM", "before", "with VGG19", "with compact", "of the way"], rows)


def speed(bench: Bench) -> str:
    """Milliseconds of forward and backward, seconds of the whole command's work."""
    _, images = fox_views(bench, MEDIUM)
    dtype = fastest_dtype("cpu")
    ready = bench.compact.to("cpu", dtype), bench.vgg19.to("cpu", dtype)
    forwards = {
        "compact": lambda image: ready[0](image)[0],
        "vgg19": lambda image: ready[1](image)[0],
    }
    times = {title: _backward_ms(forward, images[0]) for title, forward in forwards.items()}
    runs: tuple[tuple[Network, Path], ...] = (
        ("compact", bench.weights),  # compiles
        ("vgg19", VGG19),
        ("compact", bench.weights),
    )
    seconds = {name: _styling_seconds(bench, name, weights) for name, weights in runs}
    size = "x".join(map(str, images[0].shape[1::-1]))
    precision = str(dtype).removeprefix("torch.")
    rows = [
        _ratio(f"to conv3_3, {size}, {precision}, ms", times["compact"], times["vgg19"]),
        _ratio("stylize fox, 300 steps, s", seconds["compact"], seconds["vgg19"]),
    ]
    return table(["", "compact", "VGG19", "times faster"], rows)


def _backward_ms(forward: Callable[[Tensor], Tensor], image: Tensor) -> float:
    def work() -> None:
        forward(image.clone().requires_grad_()).float().square().mean().backward()

    return median_ms(work)


def _ratio(what: str, ours: float, theirs: float) -> list[str]:
    return [what, f"{ours:.1f}", f"{theirs:.1f}", f"{theirs / ours:.2f}"]


def _styling_seconds(bench: Bench, features: Network, weights: Path) -> float:
    painting = STYLES / f"{next(iter(bench.paintings))}.jpg"
    with tempfile.TemporaryDirectory() as folder:
        start = time.perf_counter()
        path = trained_scene("fox", downscale=1, gaussians=100_000)
        scene = ss.open(path)
        styled = ss.stylize(scene, {str(FOX): painting}, features=features, weights=weights)
        ss.save(styled, Path(folder) / "styled")
        return time.perf_counter() - start


def main(options: Options) -> None:
    """Print the tables."""
    tensors = load_file(options.weights)
    bench = Bench(
        weights=options.weights,
        compact=load_weights("compact", options.weights),
        vgg19=style_network(),
        to_vgg19=[tensors[f"block{block}.to_vgg19"].float() for block in BLOCKS],
        scene=ss.open(trained_scene("fox", downscale=1, gaussians=100_000)),
        paintings={path.stem: read_style(path) for path in sorted(STYLES.glob("*.jpg"))},
    )
    print(f"{machine()}, calibration {calibration_ms():.0f} ms\n")
    for measure in (cosines, agreement, speed, equivalence):
        print(measure(bench), end="\n\n", flush=True)


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
