"""Feature networks: VGG, cut after the layers that style transfer needs, and a slim student of it.

The student ships with the package. It works at half the picture's resolution from the start. Its
features are VGG19's in their principal directions: cosines and distances are the same there, with a
third of the numbers. `scripts/distill_features.py` trained it; `compact.md` says how good it is.
VGG's weights come from a file, a cache or a download.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import chain
from pathlib import Path

import torch
from jaxtyping import Float
from llvmlite.binding import get_host_cpu_features
from safetensors import safe_open
from safetensors.torch import save_file
from torch import Tensor
from torch.nn import functional as F

from stylesplat.errors import StyleSplatError
from stylesplat.io.atomic import atomic_path
from stylesplat.io.hub import fetch_tensors
from stylesplat.progress import say
from stylesplat.stylization.config import Network

LAYERS_PER_BLOCK = 3  # ReLU outputs of a block that are concatenated (ARF); blocks 1, 2 have two
DEPTHS = {  # convolutions of a block (Simonyan & Zisserman 2014)
    "vgg16": (2, 2, 3, 3, 3),
    "vgg19": (2, 2, 4, 4, 4),
    "compact": (1, 2, 3),  # they see as far as VGG19's do
}
NETWORK_FOLD = 2  # pixels along x and y that become channels of one in the compact network
COMPACT_GREY, COMPACT_CONTRAST = 0.5, 0.25  # its mean and standard deviation of colours
# Instructions with which convolutions are faster in bfloat16 than in float32: 128 channels on 48x48
# pixels took 2.6 ms in float32 and 8.2 ms in bfloat16 by AVX-512, 2.5 and 1.3 ms with its BF16
FAST_BFLOAT16 = ("amx-bf16", "avx512bf16")


@dataclass(frozen=True, eq=False)
class Convolution:
    """A convolution, its output as large as its input."""

    weight: Float[Tensor, "out in k k"]
    bias: Float[Tensor, " out"]

    def __call__(self, x: Float[Tensor, "B in H W"]) -> Float[Tensor, "B out H W"]:
        """Convolve images."""
        return F.conv2d(x, self.weight, self.bias, padding="same")

    def to(self, device: torch.device | str, dtype: torch.dtype) -> "Convolution":
        """The same convolution on another device and in another precision."""
        return Convolution(self.weight.to(device, dtype), self.bias.to(device, dtype))


@dataclass(frozen=True)
class Cells:
    """Where features lie in the image: cell `i` sees `[i * stride - before, +size)`."""

    stride: int
    """Pixels from one feature to the next."""
    size: int
    """Pixels of its receptive field."""
    before: int
    """How many of them lie before pixel `i * stride`."""

    def inside(self, length: int) -> slice:
        """The cells of an axis of `length` pixels whose receptive field is all in the image."""
        first = -(-self.before // self.stride)
        last = (length - self.size + self.before) // self.stride
        return slice(first, max(first, last + 1))


# A block-1 feature depends on the 6 pixels around its pair of pixels, the first or second of which
# it is: 2 before and 3 behind, or 3 before and 2 behind.
COMPACT_CELLS = (Cells(stride=1, size=7, before=3), Cells(2, 14, 6), Cells(4, 40, 18))


@dataclass(frozen=True, eq=False)
class FeatureNetwork:
    """VGG or the compact network: turns images into features, block by block.

    Features are the ReLU outputs of a block's first three layers, concatenated; every block has
    half the resolution of the last. The compact network has heads, and sees 2x2 pixels as one from
    the start, which the head of block 1 takes apart again.
    """

    blocks: tuple[tuple[Convolution, ...], ...]
    """Block 1 first; the last may be cut short."""
    mean: Float[Tensor, " 3"]
    """Colour in 0..1 that the first layer sees as zero."""
    std: Float[Tensor, " 3"]
    """Difference of colour that the first layer sees as one."""
    heads: tuple[Convolution, ...] = ()
    """Linear functions of the outputs of each block, to VGG19's features."""

    def __call__(
        self, image: Float[Tensor, "H W 3"], blocks: Sequence[int] = (3,)
    ) -> tuple[Float[Tensor, "_ _ _"], ...]:
        """For each block, counted from 1, an image of features, in the network's precision.

        Colours are in 0..1, which they may exceed, as renders do.
        """
        height, width = image.shape[:2]
        strides = [self.cells(block).stride for block in blocks]
        x = ((image - self.mean) / self.std).permute(2, 0, 1)[None]  # channels-last in memory
        found = zip(self.features(x.to(self.dtype), blocks), strides, strict=True)
        return tuple(
            f.squeeze(0)[:, : height // s, : width // s].permute(1, 2, 0) for f, s in found
        )

    def features(self, x: Float[Tensor, "B _ H W"], blocks: Sequence[int]) -> list[Tensor]:
        """The features [B,D,_,_] of images whose colours are normalised already."""
        if self.heads:
            odd = x.shape[3] % NETWORK_FOLD, x.shape[2] % NETWORK_FOLD
            x = F.pad(x, (0, odd[0], 0, odd[1])) if any(odd) else x
            x = F.pixel_unshuffle(x, NETWORK_FOLD).contiguous(memory_format=torch.channels_last)
        outputs = {}
        for number, block in enumerate(self.blocks[: max(blocks)], start=1):
            if number > (2 if self.heads else 1):  # folded pixels are pooled already
                x = F.max_pool2d(x, 2)
            layers = []
            for conv in block:
                x = F.relu_(conv(x))
                layers.append(x)
            if number in blocks:
                outputs[number] = torch.cat(layers[:LAYERS_PER_BLOCK], dim=1)
                if self.heads:
                    outputs[number] = self.heads[number - 1](outputs[number])
        if self.heads and 1 in outputs:
            outputs[1] = F.pixel_shuffle(outputs[1], NETWORK_FOLD)
        return [outputs[number] for number in blocks]

    def cells(self, block: int) -> Cells:
        """Where the features of a block, counted from 1, lie in the image."""
        if not 1 <= block <= self.depth:
            raise StyleSplatError(
                f"Features of block {block} were asked for, the network has blocks 1 to "
                f"{self.depth}. Choose among those, or use --features vgg16."
            )
        if self.heads:
            return COMPACT_CELLS[block - 1]
        size, before = 1, 0
        for number, convs in enumerate(self.blocks[:block], start=1):
            stride = 2 ** (number - 1)
            size += stride // 2  # the pooling before this block
            depth = len(convs) if number < block else len(convs[:LAYERS_PER_BLOCK])
            size, before = size + 2 * stride * depth, before + stride * depth
        return Cells(stride=2 ** (block - 1), size=size, before=before)

    @property
    def depth(self) -> int:
        """How many blocks it has."""
        return len(self.blocks)

    @property
    def dtype(self) -> torch.dtype:
        """The precision of the convolutions."""
        return self.blocks[0][0].weight.dtype

    def to(
        self, device: torch.device | str, dtype: torch.dtype = torch.float32
    ) -> "FeatureNetwork":
        """The same network on another device and in another precision."""
        return replace(
            self,
            blocks=tuple(tuple(conv.to(device, dtype) for conv in block) for block in self.blocks),
            mean=self.mean.to(device),
            std=self.std.to(device),
            heads=tuple(head.to(device, dtype) for head in self.heads),
        )


@cache
def fastest_dtype(device: str) -> torch.dtype:
    """bfloat16 on processors that have instructions for it, else float32.

    It depends on the hardware alone, never on how busy that is.
    """
    if device != "cpu":
        return torch.bfloat16 if torch.cuda.is_bf16_supported() else torch.float32
    features = get_host_cpu_features()
    fast = any(features.get(name, False) for name in FAST_BFLOAT16)
    return torch.bfloat16 if fast else torch.float32


HUB_URL = "https://huggingface.co/timm/{network}.tv_in1k/resolve/main/model.safetensors"
TORCHVISION_FILES = {"vgg16": "vgg16-397923af.pth", "vgg19": "vgg19-dcbb9e9d.pth"}
MEAN, STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
CAFFE_MEAN = (123.68, 116.779, 103.939)  # red, green, blue in 0..255; nothing is divided
PACKAGED = Path(__file__).with_name("compact.safetensors")
CONVOLUTION = re.compile(r"(features\.\d+|conv\d_\d|block\d\.(conv\d|head))\.(weight|bias)")
MARKS = {  # layers that the other network does not have
    "vgg16": ("features.17.weight",),
    "vgg19": ("features.16.weight", "conv3_4.weight"),
}


def load_weights(
    network: Network, path: Path | str | None = None, *, depth: int = 3, download: bool = True
) -> FeatureNetwork:
    """Load a feature network, of VGG up to the block `depth`, from .safetensors, .pth or .pt.

    VGG's convolutions are named as in torchvision (`features.0.weight`) or as in the original
    (`conv1_1.weight`), whose first layer expects colours in 0..255, blue first, unless the file's
    metadata say otherwise. Without a path, VGG is in torch's cache or, a few megabytes of it, is
    downloaded; `compact` ships with the package.
    """
    if network == "compact":
        path = Path(path or PACKAGED)
        return compact_from(_read(path)[0], path)
    path = Path(path) if path is not None else _cached(network, depth, download)
    tensors, metadata = _read(path)
    for other, marks in MARKS.items():
        if other != network and any(mark in tensors for mark in marks):
            raise StyleSplatError(f"{path} holds {other}, not {network}. Use --features {other}.")
    is_original = any(name.startswith("conv") for name in tensors)
    names = _original_names(network, depth) if is_original else _torchvision_names(network, depth)
    blocks = _blocks(tensors, names, 3, path)
    if not (is_original or "255" in metadata.get("input", "")):
        return FeatureNetwork(blocks, torch.tensor(MEAN), torch.tensor(STD))
    if "BGR" in metadata.get("input", "BGR"):
        (first, *block), *rest = blocks
        blocks = ((Convolution(first.weight.flip(1), first.bias), *block), *rest)
    return FeatureNetwork(blocks, torch.tensor(CAFFE_MEAN) / 255, torch.full((3,), 1 / 255))


def compact_from(tensors: Mapping[str, Tensor], source: Path | str) -> FeatureNetwork:
    """Assemble the compact network from tensors named `block1.conv1.weight`, and so on."""
    names = [
        [f"block{block}.conv{layer + 1}" for layer in range(count)]
        for block, count in enumerate(DEPTHS["compact"], start=1)
    ]
    blocks, heads = _blocks(tensors, names, 3 * NETWORK_FOLD**2, source), []
    for number, convs in enumerate(blocks, start=1):
        width = sum(len(conv.bias) for conv in convs)
        heads.append(_convolution(tensors, f"block{number}.head", (width, 1, 1), source))
    mean, std = torch.full((3,), COMPACT_GREY), torch.full((3,), COMPACT_CONTRAST)
    return FeatureNetwork(blocks, mean, std, tuple(heads))


def _cached(network: Network, depth: int, download: bool) -> Path:
    """A file of VGG in torch's cache, after a download if need be."""
    folder = Path(torch.hub.get_dir()) / "checkpoints"
    path = folder / f"{network}_to_block{depth}.safetensors"
    for known in (folder / TORCHVISION_FILES[network], path):
        if known.is_file():
            return known
    if not download:
        raise StyleSplatError(
            f"There is no file of {network}'s weights in {folder}. Style an object with "
            f"`--features {network}` to have it downloaded."
        )
    url = HUB_URL.format(network=network)
    say(f"Downloading {network}'s convolutions from {url} to {path}.")
    layers = chain.from_iterable(_torchvision_names(network, depth))
    names = [f"{layer}.{part}" for layer in layers for part in ("weight", "bias")]
    try:
        tensors = fetch_tensors(url, names, title=network)
    except StyleSplatError as error:
        raise StyleSplatError(
            f"{error} Pass a file of {network} with `--weights FILE`, or use --features compact."
        ) from error
    with atomic_path(path) as temporary:
        save_file(tensors, temporary, metadata={"architecture": network.upper()})
    return path


def _read(path: Path) -> tuple[dict[str, Tensor], dict[str, str]]:
    """The tensors of convolutions in a file, and its metadata."""
    metadata = {}
    try:
        if path.suffix == ".safetensors":
            with safe_open(path, "pt") as file:
                names = filter(CONVOLUTION.fullmatch, file.keys())
                tensors = {name: file.get_tensor(name).float() for name in names}
                metadata = file.metadata() or {}
        else:
            content = torch.load(path, map_location="cpu", weights_only=True)
            tensors = {n: content[n].float() for n in filter(CONVOLUTION.fullmatch, content)}
    except FileNotFoundError as error:
        raise StyleSplatError(f"There is no weights file {path}. Check the name.") from error
    except Exception as error:  # of safetensors, zip, pickle, or a file of something else
        raise StyleSplatError(
            f"Cannot read the weights file {path}. Pass a whole .safetensors or .pth file."
        ) from error
    for name, tensor in tensors.items():
        if not tensor.isfinite().all():
            raise StyleSplatError(f"{name} in {path} is not finite. Copy the weights again.")
    return tensors, metadata


def _torchvision_names(network: Network, depth: int) -> list[list[str]]:
    """The names of the layers of VGG that are needed, by blocks."""
    blocks, before = [], 0
    for layers, count in zip(_original_names(network, depth), DEPTHS[network], strict=False):
        blocks.append([f"features.{before + 2 * n}" for n in range(len(layers))])
        before += 2 * count + 1  # with ReLUs and a pooling
    return blocks


def _original_names(network: Network, depth: int) -> list[list[str]]:
    counts = [*DEPTHS[network][: depth - 1], min(DEPTHS[network][depth - 1], LAYERS_PER_BLOCK)]
    return [[f"conv{b}_{n + 1}" for n in range(count)] for b, count in enumerate(counts, start=1)]


def _blocks(
    tensors: Mapping[str, Tensor], names: list[list[str]], inputs: int, source: Path | str
) -> tuple[tuple[Convolution, ...], ...]:
    blocks = []
    for layers in names:
        convs = []
        for name in layers:
            convs.append(_convolution(tensors, name, (inputs, 3, 3), source))
            inputs = len(convs[-1].bias)
        blocks.append(tuple(convs))
    return tuple(blocks)


def _convolution(
    tensors: Mapping[str, Tensor], name: str, shape: tuple[int, int, int], source: Path | str
) -> Convolution:
    """The convolution of a name, of any number of filters of this shape."""
    weight, bias = tensors.get(f"{name}.weight"), tensors.get(f"{name}.bias")
    if weight is None or bias is None or weight.shape != (*bias.shape, *shape):
        raise StyleSplatError(
            f"{source} holds another network, or not all of it: {name} is missing or its filters "
            f"do not have the shape {[*shape]}. Choose the network of the file with --features, "
            "or leave out --weights."
        )
    return Convolution(weight.float().contiguous(memory_format=torch.channels_last), bias.float())
