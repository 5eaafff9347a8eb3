"""Where a feature network comes from: the package, a file, a cache or a download."""

import re
from collections.abc import Mapping
from itertools import chain
from pathlib import Path

import torch
from safetensors import safe_open
from safetensors.torch import save_file
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.io.atomic import atomic_path
from stylesplat.models.safetensors_http import fetch_tensors
from stylesplat.progress import say
from stylesplat.stylization.config import Network
from stylesplat.stylization.features.network import (
    COMPACT_CONTRAST,
    COMPACT_GREY,
    DEPTHS,
    FOLD,
    LAYERS_PER_BLOCK,
    Convolution,
    FeatureNetwork,
)

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
    """Load a feature network as deep as needed.

    Args:
        network: Which one; `compact` ships with the package.
        path: A .safetensors, .pth or .pt file. Of VGG it holds at least the convolutions, named as
            in torchvision (`features.0.weight`) or as in the original (`conv1_1.weight`), whose
            first layer expects colours in 0..255, blue first, unless the file's metadata say
            otherwise. By default the package's own; of VGG what is in torch's cache, or else a
            download of a few megabytes into it, announced on stderr.
        depth: The deepest block of features that is needed.
        download: Whether to, if there is no file of VGG.

    Raises:
        StyleSplatError: If the file is missing, unreadable or of another network, if there is none
            and it cannot or must not be downloaded, or if the network is not that deep.
    """
    most = len(DEPTHS[network])
    if not 1 <= depth <= most:
        remedy = " Use --features vgg16." if network == "compact" else ""
        raise StyleSplatError(
            f"Block {depth} of {network} was asked for, it has blocks 1 to {most}.{remedy}"
        )
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
    """Assemble the compact network from tensors named `block1.conv1.weight`, and so on.

    Raises:
        StyleSplatError: If one is missing or does not fit the one before.
    """
    names = [
        [f"block{block}.conv{layer + 1}" for layer in range(count)]
        for block, count in enumerate(DEPTHS["compact"], start=1)
    ]
    blocks, heads = _blocks(tensors, names, 3 * FOLD**2, source), []
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
