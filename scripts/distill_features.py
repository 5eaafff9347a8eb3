"""Train the compact feature network to give VGG19's features, and write it into the package.

    .venv/bin/pip install -e '.[photos,distill]' -c constraints.txt
    .venv/bin/python scripts/distill_features.py --teacher VGG19.safetensors

The student sees pictures that are free or made here (`training_pictures.py`) and learns, in each of
three blocks, the ReLU outputs of VGG19's first three layers in their principal directions: cosines
there are cosines of the features themselves. The loss is 1 minus the cosine plus a share of the
squared error; matrices learn with Muon (Jordan 2024), the biases with Adam, at a rate that falls to
0. An hour on two cores; `benchmarks/features.py` measures what came of it.
"""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
import tyro
from jaxtyping import Float, UInt8
from safetensors.torch import save_file
from torch import Tensor
from torch.nn import functional as F
from tqdm import tqdm

from stylesplat.stylization.features import (
    COMPACT_CELLS,
    DEPTHS,
    NETWORK_FOLD,
    PACKAGED,
    FeatureNetwork,
    compact_from,
    fastest_dtype,
    load_weights,
)
from training_pictures import SIZE, training_pictures

WIDTHS = (32, 64, 128)  # filters of a layer, block by block
TEACHER_WIDTHS = (128, 256, 768)
DIRECTIONS = (64, 128, 256)  # that are kept of those: 99.9, 98 and 98 % of their energy
BASIS_BATCHES = 60  # that these are found from
BLOCKS = (1, 2, 3)
IMPORTANCE = (0.05, 0.2, 1.0)  # of the blocks in the loss; styles are matched in the third
SQUARED = 0.2  # weight of the squared error beside the cosine's distance
STEPS_ASIDE = (3, 2, 1)  # every n-th feature of a block is compared: they are many and alike
EDGE = 12  # pixels at the border that are not compared, as when styles are matched
MUON_RATE, ADAM_RATE = 0.025, 3e-3
WARM_UP = 30  # steps
REPLAY = 2  # times that a batch is used, on average; the teacher costs as much as the student
MEMORY = 400  # batches that may be used again
SCALE = 10.0  # of the targets: what filters of a usual size give


@dataclass(frozen=True)
class Options:
    """What to train with."""

    teacher: Path
    """VGG19's weights down to conv3_3 or deeper (.safetensors, .pth)."""
    output: Path = PACKAGED
    """File to write."""
    steps: int = 12_000
    """Optimiser steps."""
    batch: int = 4
    """Pictures per step."""
    crop: int = 128
    """Pixels along their sides."""
    pictures: int = 2400
    """Pictures to make."""
    seed: int = 0
    """Of pictures, parts and first weights."""
    device: str = "cpu"
    """Where to compute."""


@dataclass(frozen=True)
class Batch:
    """Pictures and what the student should make of them."""

    pictures: Float[Tensor, "B S S 3"]
    """Colours in 0..1."""
    targets: tuple[Float[Tensor, "_ _"], ...]
    """For each block the features that are compared, in their principal directions."""
    energies: tuple[Float[Tensor, " _"], ...]
    """Their squared lengths in all directions."""


@dataclass(frozen=True)
class Teacher:
    """VGG19, its features scaled and turned."""

    network: FeatureNetwork
    """In the fastest precision."""
    bases: tuple[Float[Tensor, "_ _"], ...]
    """The principal directions of each block, one a column."""
    scales: tuple[float, ...]
    """What makes the features `SCALE` long."""

    @torch.no_grad()
    def teach(self, pictures: Float[Tensor, "B S S 3"]) -> Batch:
        """The targets of some pictures."""
        rows = teacher_rows(self.network, pictures)
        feats = [f * scale for f, scale in zip(rows, self.scales, strict=True)]
        targets = tuple(f @ basis for f, basis in zip(feats, self.bases, strict=True))
        return Batch(pictures, targets, tuple(f.square().sum(dim=1) for f in feats))


def teacher_rows(network: FeatureNetwork, pictures: Float[Tensor, "B S S 3"]) -> list[Tensor]:
    """The features of each block that are compared, one a row."""
    found = [network(picture, BLOCKS) for picture in pictures]
    stacked = [torch.stack(block) for block in zip(*found, strict=True)]
    return [compared(feats, block) for block, feats in zip(BLOCKS, stacked, strict=True)]


def compared(feats: Float[Tensor, "B H W D"], block: int) -> Float[Tensor, "P D"]:
    """Some of a block's features, away from the border, one a row."""
    margin = EDGE // COMPACT_CELLS[block - 1].stride
    inner = slice(margin, -margin, STEPS_ASIDE[block - 1])
    return feats[:, inner, inner].float().flatten(0, 2)


def find_teacher(network: FeatureNetwork, batches: Iterator[Tensor]) -> Teacher:
    """Look up the scales and principal directions of VGG19's features."""
    moments = [torch.zeros(w, w) for w in TEACHER_WIDTHS]
    squares = torch.zeros(len(BLOCKS))
    pictures = next(batches)
    with torch.no_grad():
        for _ in tqdm(range(BASIS_BATCHES), desc="principal directions"):
            for i, rows in enumerate(teacher_rows(network, pictures)):
                squares[i] += rows.square().sum(dim=1).mean().cpu() / BASIS_BATCHES
                directions = F.normalize(rows, dim=1)
                moments[i] += (directions.T @ directions).cpu() / len(rows)
            pictures = next(batches)
    bases = []
    for moment, count in zip(moments, DIRECTIONS, strict=True):
        energies, vectors = torch.linalg.eigh(moment)  # ascending
        bases.append(vectors[:, -count:].contiguous().to(pictures.device))
        tqdm.write(f"{count} directions hold {energies[-count:].sum() / energies.sum():.4f}")
    scales = tuple((SCALE / squares.sqrt()).tolist())
    return Teacher(network, tuple(bases), scales)


def first_weights(generator: torch.Generator) -> dict[str, Tensor]:
    """Random weights, the matrices as [out, in * k * k] with the inputs last."""
    params, inputs = {}, 3 * NETWORK_FOLD**2
    outputs = (DIRECTIONS[0] * NETWORK_FOLD**2, *DIRECTIONS[1:])
    for block, (width, depth) in enumerate(zip(WIDTHS, DEPTHS["compact"], strict=True)):
        shapes = {}
        for layer in range(depth):
            shapes[f"conv{layer + 1}"] = (width, 9 * inputs, 2.0)
            inputs = width
        shapes["head"] = (outputs[block], depth * width, 1.0)
        for name, (rows, columns, gain) in shapes.items():
            matrix = torch.randn(rows, columns, generator=generator) * (gain / columns) ** 0.5
            params[f"block{block + 1}.{name}.weight"] = matrix
            params[f"block{block + 1}.{name}.bias"] = torch.zeros(rows)
    return params


def as_filters(params: dict[str, Tensor]) -> dict[str, Tensor]:
    """The same weights as convolutions [out, in, k, k]."""
    filters = {}
    for name, value in params.items():
        if value.ndim == 2:
            side = 1 if ".head." in name else 3
            value = value.view(len(value), side, side, -1).permute(0, 3, 1, 2)
        filters[name] = value
    return filters


def parts(
    pictures: UInt8[Tensor, "P S S 3"], options: Options, generator: torch.Generator
) -> Iterator[Float[Tensor, "B C C 3"]]:
    """Endless batches of parts of pictures, of other sizes, turns, colours and grain."""
    while True:
        chosen = torch.randint(len(pictures), (options.batch,), generator=generator)
        found = [part(pictures[i].numpy(), options.crop, generator) for i in chosen]
        yield torch.stack(found).to(options.device)


def part(
    picture: UInt8[np.ndarray, "S S 3"], size: int, generator: torch.Generator
) -> Float[Tensor, "C C 3"]:
    """A square of a picture, shrunk or grown to `size` pixels."""
    zoom, x, y, flip, turn, colors, gain, shift, grain, loud = torch.rand(
        10, generator=generator
    ).tolist()
    side = min(SIZE, round(0.7 * size * (SIZE / (0.7 * size)) ** zoom))
    left, top = (round(at * (SIZE - side)) for at in (x, y))
    square = picture[top : top + side, left : left + side, :][:, :: -1 if flip < 0.5 else 1]
    square = np.ascontiguousarray(np.rot90(square) if turn < 0.25 else square)
    how = cv2.INTER_AREA if side > size else cv2.INTER_CUBIC
    image = torch.from_numpy(cv2.resize(square, (size, size), interpolation=how)).float() / 255
    if colors < 0.5:
        mix = torch.eye(3) + 0.25 * torch.randn(3, 3, generator=generator)
        mixed = image @ (mix / mix.sum(dim=1, keepdim=True).clamp(min=0.3)).T
        image = ((mixed - 0.5) * (0.6 + 0.8 * gain) + 0.5 + 0.25 * (shift - 0.5)).clamp(0, 1)
    if grain < 0.15:
        image = image + 0.08 * loud * torch.randn(image.shape, generator=generator)
    return image


def loss_of(student: FeatureNetwork, batch: Batch) -> tuple[Tensor, float]:
    """The loss, and the mean cosine of block 3."""
    x = (batch.pictures - student.mean) / student.std
    found = student.features(x.permute(0, 3, 1, 2).to(student.dtype), BLOCKS)
    total, cosine = torch.zeros(()), torch.zeros(())
    for i, feats in enumerate(found):
        own, target, energy = (
            compared(feats.permute(0, 2, 3, 1), i + 1),
            batch.targets[i],
            batch.energies[i],
        )
        lengths = own.norm(dim=1) * energy.sqrt() + 1e-3 * SCALE  # black has no direction
        cosine = ((own * target).sum(dim=1) / lengths).mean()
        squared = (own - target).square().sum(dim=1).mean() / energy.mean()
        total = total + IMPORTANCE[i] * (1 - cosine + SQUARED * squared)
    return total, float(cosine.detach())


def lessons(
    teacher: Teacher, batches: Iterator[Tensor], generator: torch.Generator
) -> Iterator[Batch]:
    """Batches to learn from, new ones and some of the last again."""
    memory: list[Batch] = []
    for pictures in batches:
        newest = teacher.teach(pictures)
        memory = [*memory[1 - MEMORY :], newest]
        yield newest
        for _ in range(REPLAY - 1):
            yield memory[int(torch.randint(len(memory), (), generator=generator))]


def train(
    params: dict[str, Tensor], batches: Iterator[Batch], options: Options, dtype: torch.dtype
) -> float:
    """Optimise the weights in place; returns the mean cosine of block 3 over the last steps."""
    matrices = [p.requires_grad_() for p in params.values() if p.ndim == 2]
    biases = [p.requires_grad_() for p in params.values() if p.ndim == 1]
    optimizers = (
        torch.optim.Muon(matrices, lr=MUON_RATE, weight_decay=0.0),
        torch.optim.Adam(biases, lr=ADAM_RATE),
    )
    schedules = [
        torch.optim.lr_scheduler.LambdaLR(
            o, lambda step: min(1, (step + 1) / WARM_UP) * (1 - step / options.steps)
        )
        for o in optimizers
    ]
    recent = 0.0
    bar = tqdm(range(options.steps), desc="training")
    for number in bar:
        student = compact_from(as_filters(params), "training").to(options.device, dtype)
        loss, cosine = loss_of(student, next(batches))
        for optimizer in optimizers:
            optimizer.zero_grad()
        loss.backward()
        for each in (*optimizers, *schedules):
            each.step()
        recent += (cosine - recent) / min(number + 1, 200)
        bar.set_postfix(cosine=f"{recent:.4f}", refresh=False)
    return recent


def main(options: Options) -> None:
    """Make pictures, train, write."""
    torch.manual_seed(options.seed)
    start = time.monotonic()
    generator = torch.Generator().manual_seed(options.seed)
    pictures = training_pictures(options.pictures, options.seed)
    dtype = fastest_dtype(torch.device(options.device).type)
    vgg19 = load_weights("vgg19", options.teacher).to(options.device, dtype)
    batches = parts(pictures, options, generator)
    teacher = find_teacher(vgg19, batches)
    params = first_weights(generator)
    cosine = train(params, lessons(teacher, batches, generator), options, dtype)
    tensors = {name: value.detach() for name, value in as_filters(params).items()}
    for block, basis, scale in zip(BLOCKS, teacher.bases, teacher.scales, strict=True):
        tensors[f"block{block}.to_vgg19"] = basis / scale
    metadata = {"steps": str(options.steps), "seed": str(options.seed), "format": "pt"}
    packed = {name: value.to("cpu", torch.float16).contiguous() for name, value in tensors.items()}
    save_file(packed, options.output, metadata=metadata)
    minutes = (time.monotonic() - start) / 60
    print(f"{options.output}: cosine {cosine:.4f} in training, {minutes:.0f} minutes")


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
