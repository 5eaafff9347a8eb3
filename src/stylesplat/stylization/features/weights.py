"""Where a feature network comes from: the package, a file, a cache or a download."""

import os
import pickle
import re
import struct
import zipfile
from pathlib import Path
from typing import Literal

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from stylesplat.errors import StyleSplatError
from stylesplat.io.atomic import atomic_path
from stylesplat.models.safetensors_http import fetch_tensors
from stylesplat.progress import say
from stylesplat.stylization.config import Network
from stylesplat.stylization.features.compact import compact_from
from stylesplat.stylization.features.network import Convolution, FeatureNetwork
from stylesplat.stylization.features.vgg import Vgg, layer_widths

VggNetwork = Literal["vgg16", "vgg19"]
Preprocessing = Literal["torchvision", "caffe-rgb", "caffe-bgr"]

HUB_URL = "https://huggingface.co/timm/{network}.tv_in1k/resolve/main/model.safetensors"
TORCHVISION_FILES = {"vgg16": "vgg16-397923af.pth", "vgg19": "vgg19-dcbb9e9d.pth"}
TORCHVISION_MEAN, TORCHVISION_STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
CAFFE_MEAN = (123.68, 116.779, 103.939)  # red, green, blue in 0..255; nothing is divided
PACKAGED = Path(__file__).with_name("compact.safetensors")
CONVOLUTION = re.compile(r"(features\.\d+|conv\d_\d|block\d\.(conv\d|head))\.(weight|bias)")
MARKS = {  # layers that the other network does not have
    "vgg16": ("features.17.weight",),
    "vgg19": ("features.16.weight", "conv3_4.weight"),
}
UNREADABLE = (
    SafetensorError,
    pickle.UnpicklingError,
    zipfile.BadZipFile,
    struct.error,
    EOFError,
    LookupError,
    OSError,
    RuntimeError,
    ValueError,
)


def load_weights(
    network: Network, path: Path | str | None = None, *, depth: int = 3, download: bool = True
) -> FeatureNetwork:
    """Load a feature network as deep as needed.

    Args:
        network: Which one; `compact` ships with the package.
        path: Its file; by default the package's own, and for VGG as `load_vgg` says.
        depth: The deepest block of features that is needed.
        download: Whether to, if there is no file of VGG.

    Raises:
        StyleSplatError: As `load_vgg` does.
    """
    if network == "compact":
        return _load_compact(Path(path) if path is not None else PACKAGED, depth)
    return load_vgg(network, path, depth=depth, download=download)


def load_vgg(
    network: VggNetwork,
    path: Path | str | None = None,
    *,
    depth: int = 3,
    preprocessing: Preprocessing | None = None,
    download: bool = True,
) -> Vgg:
    """Load VGG's convolutions as deep as needed.

    Args:
        network: Which one.
        path: A .safetensors, .pth or .pt file that holds at least the convolutions, named as
            in torchvision (`features.0.weight`) or as in the original (`conv1_1.weight`). By
            default what torchvision or we have cached, or else a download of a few megabytes,
            announced on stderr.
        depth: The deepest block of features that is needed.
        preprocessing: What the first layer expects: `torchvision`, or colours in 0..255 minus
            the original mean in either order. By default the file's metadata decide, or else
            the layers' names: the original order is blue first.
        download: Whether to, if there is no file.

    Raises:
        StyleSplatError: If the file is missing, unreadable or of another network, or if there
            is none and it cannot or must not be downloaded.
    """
    layer_widths(network, depth)  # refuses a depth that the network does not have
    path = Path(path) if path is not None else _cached(network, depth, download)
    tensors, metadata = _read(path)
    blocks = _assemble(tensors, network, depth, path)
    if preprocessing is None:
        preprocessing = _told(tensors, metadata)
    if preprocessing == "torchvision":
        return Vgg(blocks, torch.tensor(TORCHVISION_MEAN), torch.tensor(TORCHVISION_STD))
    if preprocessing == "caffe-bgr":
        (first, *block), *rest = blocks
        first = Convolution(first.weight.flip(1), first.bias)
        blocks = ((first, *block), *rest)
    return Vgg(blocks, torch.tensor(CAFFE_MEAN) / 255, torch.full((3,), 1 / 255))


def _load_compact(path: Path, depth: int) -> FeatureNetwork:
    network = compact_from(_read(path)[0], path)
    if depth > network.depth:
        raise StyleSplatError(
            f"Block {depth} of compact was asked for, it has blocks 1 to {network.depth}. "
            "Use --features vgg16."
        )
    return network


def cache_folder() -> Path:
    """Where downloads are kept: `$XDG_CACHE_HOME/stylesplat`, by default in `~/.cache`.

    Raises:
        StyleSplatError: If the user has no home.
    """
    try:
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "stylesplat"
    except RuntimeError as error:
        raise StyleSplatError(
            "There is no home folder to keep weights in. Set XDG_CACHE_HOME, or pass --weights."
        ) from error


def _cached(network: VggNetwork, depth: int, download: bool) -> Path:
    """A file of the network that is there, or that is there now."""
    torchvision = Path(torch.hub.get_dir()) / "checkpoints" / TORCHVISION_FILES[network]
    if torchvision.is_file():
        return torchvision
    path = cache_folder() / f"{network}_to_block{depth}.safetensors"
    if not path.is_file():
        if not download:
            raise StyleSplatError(
                f"There is no file of {network}'s weights in {path.parent}. Style an object with "
                f"`--features {network}` to have it downloaded."
            )
        _download(network, depth, path)
    return path


def _download(network: VggNetwork, depth: int, path: Path) -> None:
    url = HUB_URL.format(network=network)
    say(f"Downloading {network}'s convolutions from {url} to {path}.")
    widths = layer_widths(network, depth)
    layers = [_names(widths, b, i)[0] for b in range(depth) for i in range(len(widths[b]))]
    names = [f"{layer}.{part}" for layer in layers for part in ("weight", "bias")]
    try:
        tensors = fetch_tensors(url, names, title=network)
    except StyleSplatError as error:
        raise StyleSplatError(
            f"{error} Pass a file of {network} with `--weights FILE`, or use --features compact."
        ) from error
    with atomic_path(path) as temporary:
        save_file(tensors, temporary, metadata={"architecture": network.upper()})


def _names(widths: tuple[tuple[int, ...], ...], block: int, layer: int) -> tuple[str, str]:
    """Torchvision's and the original name of a layer, all counted from 0."""
    before = sum(2 * len(b) + 1 for b in widths[:block])  # convolutions, ReLUs and a pooling
    return f"features.{before + 2 * layer}", f"conv{block + 1}_{layer + 1}"


def _read(path: Path) -> tuple[dict[str, Tensor], dict[str, str]]:
    """The tensors of convolutions in a file, and its metadata."""
    tensors, metadata = _stored(path)
    for name, tensor in tensors.items():
        if not tensor.isfinite().all():
            raise StyleSplatError(f"{name} in {path} is not finite. Copy the weights again.")
    return tensors, metadata


def _stored(path: Path) -> tuple[dict[str, Tensor], dict[str, str]]:
    """The same, unchecked."""
    try:
        if path.suffix == ".safetensors":
            with safe_open(path, "pt") as file:
                names = filter(CONVOLUTION.fullmatch, file.keys())
                return {n: file.get_tensor(n).float() for n in names}, file.metadata() or {}
        content = torch.load(path, map_location="cpu", weights_only=True)
        names = filter(CONVOLUTION.fullmatch, content)
        return {n: content[n].float() for n in names}, {}
    except FileNotFoundError as error:
        raise StyleSplatError(f"There is no weights file {path}. Check the name.") from error
    except (*UNREADABLE, AttributeError, TypeError) as error:
        raise StyleSplatError(
            f"Cannot read the weights file {path}. Pass a whole .safetensors or .pth file."
        ) from error


def _assemble(
    tensors: dict[str, Tensor], network: VggNetwork, depth: int, path: Path
) -> tuple[tuple[Convolution, ...], ...]:
    for other, marks in MARKS.items():
        if other != network and any(mark in tensors for mark in marks):
            raise StyleSplatError(f"{path} holds {other}, not {network}. Use --features {other}.")
    widths = layer_widths(network, depth)
    inputs, blocks = 3, []
    for block, outputs in enumerate(widths):
        convs = []
        for layer, width in enumerate(outputs):
            names = _names(widths, block, layer)
            convs.append(_convolution(tensors, names, (width, inputs, 3, 3), path))
            inputs = width
        blocks.append(tuple(convs))
    return tuple(blocks)


def _convolution(
    tensors: dict[str, Tensor], names: tuple[str, str], shape: tuple[int, ...], path: Path
) -> Convolution:
    for name in names:
        weight, bias = tensors.get(f"{name}.weight"), tensors.get(f"{name}.bias")
        if weight is not None and bias is not None:
            if weight.shape == shape and bias.shape == shape[:1]:
                return Convolution(weight.contiguous(memory_format=torch.channels_last), bias)
            raise StyleSplatError(
                f"{path} holds another network: {name}.weight should have the shape "
                f"{list(shape)}, it has {list(weight.shape)}. Choose the network with --features."
            )
    raise StyleSplatError(
        f"{path} lacks {names[0]}.weight (or {names[1]}.weight) of the shape {list(shape)} and "
        f"its bias. Pass a file of the network chosen with --features, or choose fewer blocks."
    )


def _told(tensors: dict[str, Tensor], metadata: dict[str, str]) -> Preprocessing:
    """The preprocessing that a file says it needs."""
    expected = metadata.get("input", "")
    if "255" in expected:
        return "caffe-bgr" if "BGR" in expected else "caffe-rgb"
    return "caffe-bgr" if any(name.startswith("conv") for name in tensors) else "torchvision"
