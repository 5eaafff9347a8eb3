"""Pretrained models of `transformers`: from a folder, the user's cache, or the Hugging Face Hub."""

import re
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from os.path import expanduser
from pathlib import Path
from typing import Any

import torch

from stylesplat.errors import StyleSplatError
from stylesplat.io.json_files import read_json
from stylesplat.progress import say

CONFIG = "config.json"
# No pickled weights, which can run code, and no copies for other programs
FILES = ["*.json", "*.txt", "model*.safetensors"]
WEIGHTS = ("model.safetensors", "model.safetensors.index.json")  # whole, or in parts
PROCESSORS = ("processor_config.json", "preprocessor_config.json")
HUB_NAME = re.compile(r"[A-Za-z0-9][\w.-]*/[\w.-]+")  # OWNER/MODEL
INSTALL = "Run `pip install 'stylesplat[segment]'`."


@dataclass(frozen=True)
class ModelFolder:
    """A model on disk, not yet loaded."""

    path: Path
    """Holds `config.json`, the weights, and the settings of the processor."""
    model_type: str
    """Of `config.json`."""


def find_model(name: str, types: Collection[str], *, job: str) -> ModelFolder:
    """Find a model, and download it if it is nowhere on this machine.

    Args:
        name: Its folder, or its name on the Hugging Face Hub.
        types: The `model_type`s of `config.json` that can do the job.
        job: What it is for, such as `propose masks`.

    Raises:
        StyleSplatError: If there is no such model, it is of another type, it cannot be downloaded,
            or `transformers` is not installed.
    """
    if find_spec("transformers") is None:
        raise StyleSplatError(f"Cannot {job} without `transformers`. {INSTALL}")
    folder = _folder(name)
    if not folder.exists() and HUB_NAME.fullmatch(name):
        folder = _cached(name) or _download(name, types, job)
    if not (folder / CONFIG).is_file():
        raise StyleSplatError(
            f"{name} is no model: there is no folder of that name with a {CONFIG}. Pass the folder "
            "that `hf download OWNER/MODEL --local-dir FOLDER` filled, or a name on the Hugging "
            "Face Hub, OWNER/MODEL."
        )
    return ModelFolder(folder, _check_type(folder / CONFIG, name, types, job))


def is_at_hand(name: str) -> bool:
    """Whether a model is on this machine: nothing would be downloaded."""
    if _folder(name).exists() or find_spec("huggingface_hub") is None:
        return _folder(name).exists()
    return _cached(name) is not None


def load_model(
    source: ModelFolder, kind: Any, *, device: torch.device | str, dtype: torch.dtype
) -> Any:
    """Load a model for inference, by a class of `transformers`."""
    with _reading(source):
        model, report = kind.from_pretrained(
            source.path,
            dtype=dtype,
            local_files_only=True,
            trust_remote_code=False,  # nor ask for it
            use_safetensors=True,
            output_loading_info=True,
        )
    # Transformers fills gaps at random. Superfluous weights are no fault: one checkpoint serves
    # several models. Integers, such as counters, follow from the configuration
    state = model.state_dict()
    missing = sorted(name for name in report["missing_keys"] if state[name].is_floating_point())
    if missing:
        raise StyleSplatError(
            f"The weights in {source.path} lack {len(missing)} of the tensors that "
            f"{type(model).__name__} needs, such as {missing[0]}. Pass the whole model."
        )
    return model.to(device).eval().requires_grad_(False)


def load_processor(source: ModelFolder, kind: Any) -> Any:
    """Load what prepares pictures and words for a model, by a class of `transformers`."""
    with _reading(source):
        return kind.from_pretrained(source.path, local_files_only=True, trust_remote_code=False)


def _folder(name: str) -> Path:
    # Unlike pathlib's, this leaves the name as it is where the user's home is not known
    return Path(expanduser(name))  # noqa: PTH111


def _check_type(config: Path, name: str, types: Collection[str], job: str) -> str:
    model_type = read_json(config).get("model_type")
    if model_type not in types:
        known = f"is of the type {model_type}" if model_type else f"has no model_type in {CONFIG}"
        raise StyleSplatError(
            f"The model {name} {known}. To {job}, pass one of the type "
            f"{' or '.join(sorted(types))}."
        )
    return str(model_type)


def _cached(name: str) -> Path | None:
    """The model's folder in the user's cache, if every file that it needs is there."""
    from huggingface_hub import snapshot_download

    try:
        folder = Path(snapshot_download(name, allow_patterns=FILES, local_files_only=True))
    except (OSError, ValueError):  # not there, incomplete, or no name that could be
        return None
    needed = (CONFIG,), WEIGHTS, PROCESSORS
    whole = all(any((folder / file).is_file() for file in choice) for choice in needed)
    return folder if whole else None


def _download(name: str, types: Collection[str], job: str) -> Path:
    """Download a model into the user's cache."""
    from huggingface_hub import constants, hf_hub_download, is_offline_mode, snapshot_download

    by_hand = (
        f"Run `hf download {name} --local-dir FOLDER` on a machine with network, then pass "
        "`--model FOLDER`."
    )
    if is_offline_mode():
        raise StyleSplatError(f"{name} is not in the cache, and HF_HUB_OFFLINE is set. {by_hand}")
    say(f"Downloading the model {name} to {constants.HF_HUB_CACHE}.")
    try:
        config = Path(hf_hub_download(name, CONFIG))
        _check_type(config, name, types, job)  # before gigabytes of the wrong model
        return Path(snapshot_download(name, allow_patterns=FILES))
    except StyleSplatError:
        raise
    except Exception as error:  # of the network, the hub or the disk
        raise StyleSplatError(
            f"Cannot download {name}: {_first_line(error)} Check the name. For a gated or private "
            f"model accept the terms on its page and run `hf auth login`. {by_hand}"
        ) from error


@contextmanager
def _reading(source: ModelFolder) -> Iterator[None]:
    """Errors of any library behind `transformers` in one line, and none of its log and bars."""
    from transformers.utils import logging

    logging.set_verbosity_error()
    logging.disable_progress_bar()
    try:
        yield
    except Exception as error:
        remedy = INSTALL if isinstance(error, ImportError) else "Pass or download the whole model."
        raise StyleSplatError(
            f"Cannot load the model in {source.path}: {_first_line(error)} {remedy}"
        ) from error


def _first_line(error: Exception) -> str:
    """The first line of a message that may have many, as a sentence."""
    line = next((line.strip() for line in str(error).splitlines() if line.strip()), "")
    return f"{line.rstrip('.:') or type(error).__name__}."
