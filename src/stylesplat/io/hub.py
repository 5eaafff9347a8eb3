"""Pretrained models from a folder, the user's cache or the Hugging Face Hub; single tensors."""

import json
import os
import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from errno import ENOSPC
from fnmatch import fnmatch
from functools import partial
from http.client import HTTPException
from importlib.util import find_spec
from os.path import expanduser
from pathlib import Path
from shutil import disk_usage
from typing import Any
from urllib.request import Request, urlopen

import torch
from torch import Tensor

from stylesplat.errors import StyleSplatError, format_duration
from stylesplat.io.files import FILE_DISK_FULL, reason
from stylesplat.io.json_yaml import read_json
from stylesplat.progress import Task, say, task

MODELS_VARIABLE = "STYLESPLAT_MODELS"  # environment variable
DTYPES = {"F32": torch.float32, "F16": torch.float16, "BF16": torch.bfloat16}
LENGTH_BYTES = 8  # the file begins with the header's length, little-endian
HUB_MAX_HEADER = 2**24  # a longer header is no header
TIMEOUT = 30  # seconds
HUB_CHUNK = 2**18  # bytes between two updates of the progress bar


def fetch_tensors(url: str, names: Iterable[str], *, title: str) -> dict[str, Tensor]:
    """Download some tensors of a remote safetensors file, as float32, and nothing else of it."""
    try:
        start, header = _read_header(url)
        missing = [name for name in names if name not in header]
        if missing:
            raise StyleSplatError(f"{url} lacks {', '.join(missing)}. Pass another weights file.")
        total = sum(b - a for a, b in (header[name]["data_offsets"] for name in names))
        with task(title, total, unit="B") as bar:
            return {name: _read_tensor(url, start, header[name], bar) for name in names}
    except (OSError, HTTPException, ValueError, KeyError) as error:
        reason = getattr(error, "reason", error)
        raise StyleSplatError(f"Cannot download from {url}: {reason}.") from error


def _read_header(url: str) -> tuple[int, dict]:
    length = int.from_bytes(_read_range(url, 0, LENGTH_BYTES), "little")
    if length > HUB_MAX_HEADER:
        raise ValueError("it is no safetensors file")
    start = LENGTH_BYTES + length
    return start, json.loads(_read_range(url, LENGTH_BYTES, start))


def _read_tensor(url: str, start: int, entry: dict, bar: Task) -> Tensor:
    begin, end = entry["data_offsets"]
    content = _read_range(url, start + begin, start + end, bar)
    tensor = torch.frombuffer(content, dtype=DTYPES[entry["dtype"]]).float()
    return tensor.reshape(entry["shape"])


def _read_range(url: str, begin: int, end: int, bar: Task | None = None) -> bytearray:
    request = Request(url, headers={"Range": f"bytes={begin}-{end - 1}"})
    content = bytearray()
    with urlopen(request, timeout=TIMEOUT) as response:
        if response.status != 206:
            raise ValueError("the server sends whole files only")
        while chunk := response.read(HUB_CHUNK):
            content += chunk
            if bar is not None:
                bar.advance(len(chunk))
    if len(content) != end - begin:
        raise ValueError("the connection broke off")
    return content


CONFIG = "config.json"
# No pickled weights, which can run code, and no copies for other programs
FILES = ["*.json", "*.txt", "model*.safetensors"]
WEIGHTS_FILE, INDEX = "model.safetensors", "model.safetensors.index.json"  # in one file or several
PROCESSORS = ("processor_config.json", "preprocessor_config.json")  # either suffices
TOKENIZERS = (("tokenizer.json",), ("vocab.txt",), ("vocab.json", "merges.txt"))  # any
LINE_SPEED = 1e8  # bits a second, for a duration that users can scale to their line
HUB_NAME = re.compile(r"[A-Za-z0-9][\w.-]*/[\w.-]+")  # OWNER/MODEL
INSTALL = "Run `pip install 'stylesplat[segment]'`."


@dataclass(frozen=True)
class ModelFolder:
    """A model on disk, not yet loaded; `model_type` is that of its `config.json`."""

    path: Path
    model_type: str


def find_model(name: str, types: Collection[str], *, job: str) -> ModelFolder:
    """Find a model of one of the `types`, or download it; `job` is for messages.

    A line names the size and the licence before the download.
    """
    if find_spec("transformers") is None:
        raise StyleSplatError(f"Cannot {job} without `transformers`. {INSTALL}")
    folder = _local_folder(name)
    if folder is None and HUB_NAME.fullmatch(name):
        folder = _download(name, types, job)
    if folder is None or not (folder / CONFIG).is_file():
        raise StyleSplatError(
            f"{name} is no model: there is no folder of that name with a {CONFIG}. Pass the folder "
            "that `hf download OWNER/MODEL --local-dir FOLDER` filled, or a name on the Hugging "
            "Face Hub, OWNER/MODEL."
        )
    return ModelFolder(folder, _check_type(folder / CONFIG, name, types, job))


def is_at_hand(name: str) -> bool:
    """Whether a model is on this machine, so that nothing would be downloaded."""
    return _local_folder(name) is not None


def load_model(
    source: ModelFolder, kind: Any, *, device: torch.device | str, dtype: torch.dtype
) -> Any:
    """Load a model for inference, by a class of `transformers`."""
    options = {"dtype": dtype, "use_safetensors": True, "output_loading_info": True}
    model, report = _from_pretrained(source, kind, **options)
    # Transformers initialises missing weights at random. Superfluous ones do no harm, as one
    # checkpoint serves several models; integers, such as counters, follow from the configuration
    state = model.state_dict()
    missing = sorted(name for name in report["missing_keys"] if state[name].is_floating_point())
    if missing:
        raise StyleSplatError(
            f"The weights in {source.path} lack {len(missing)} of the tensors that "
            f"{type(model).__name__} needs, such as {missing[0]}. Pass the whole model."
        )
    return model.to(device).eval().requires_grad_(False)


def load_processor(source: ModelFolder, kind: Any) -> Any:
    """Load the preprocessing of a model, by a class of `transformers`."""
    return _from_pretrained(source, kind)


def _from_pretrained(source: ModelFolder, kind: Any, **options: Any) -> Any:
    """Load without the library's log and bars, without others' code, and with short errors."""
    from transformers.utils import logging

    logging.set_verbosity_error()
    logging.disable_progress_bar()
    remedy = "Pass or download the whole model."
    with _short_errors(f"Cannot load the model in {source.path}", remedy):
        return kind.from_pretrained(
            source.path, local_files_only=True, trust_remote_code=False, **options
        )


def _local_folder(name: str) -> Path | None:
    """The folder of a name, or its snapshot in the hub's cache if all necessary files are there."""
    folder = Path(expanduser(name))  # noqa: PTH111  (pathlib raises where there is no home)
    if folder.exists():
        return folder
    if not HUB_NAME.fullmatch(name) or find_spec("huggingface_hub") is None:
        return None
    from huggingface_hub import try_to_load_from_cache

    try:
        config = try_to_load_from_cache(name, CONFIG, cache_dir=models_folder())
    except ValueError:  # an impossible name
        return None
    folder = Path(config).parent if isinstance(config, str) else None
    return folder if folder is not None and _is_whole(folder) else None


def models_folder() -> str:
    """Where models are kept: STYLESPLAT_MODELS of the environment, or the hub's cache."""
    from huggingface_hub import constants

    return os.environ.get(MODELS_VARIABLE) or constants.HF_HUB_CACHE


def _is_whole(folder: Path) -> bool:
    """Whether a download came to its end: the hub's cache does not say."""
    needed = [((CONFIG,),), tuple((name,) for name in PROCESSORS)]
    try:
        if not (folder / WEIGHTS_FILE).is_file():
            shards = read_json(folder / INDEX).get("weight_map", {})
            needed += [(tuple({*shards.values()}) or (WEIGHTS_FILE,),)]
        if _reads_text(read_json(folder / CONFIG)):
            needed += [TOKENIZERS]
    except StyleSplatError:  # a file is missing or damaged
        return False
    return all(
        any(all((folder / file).is_file() for file in files) for files in choices)
        for choices in needed
    )


def _reads_text(config: Mapping[str, Any]) -> bool:
    """Whether a model, or a part of it, takes words, so that it needs a tokenizer."""
    parts = (each for each in config.values() if isinstance(each, dict))
    return "text_config" in config or any(map(_reads_text, parts))


def _check_type(config: Path, name: str, types: Collection[str], job: str) -> str:
    model_type = read_json(config).get("model_type")
    if model_type not in types:
        known = f"is of the type {model_type}" if model_type else f"has no model_type in {CONFIG}"
        raise StyleSplatError(
            f"The model {name} {known}. To {job}, pass one of the type "
            f"{' or '.join(sorted(types))}."
        )
    return str(model_type)


def _download(name: str, types: Collection[str], job: str) -> Path:
    from huggingface_hub import hf_hub_download, is_offline_mode, snapshot_download

    if is_offline_mode():
        raise StyleSplatError(
            f"{name} is not in the cache, and HF_HUB_OFFLINE is set. {_by_hand(name)}"
        )
    size = None
    try:
        size, licence = _describe(name)
        config = Path(hf_hub_download(name, CONFIG, cache_dir=models_folder()))
        _check_type(config, name, types, job)  # before gigabytes of the wrong model
        if size > _free_bytes():
            raise OSError(ENOSPC, "No space left on device")
        say(
            f"Downloading {name} to {models_folder()}: {size / 1e9:.2f} GB, about "
            f"{format_duration(8 * size / LINE_SPEED)} at 100 Mbit/s; licence: {licence}."
        )
        return Path(snapshot_download(name, allow_patterns=FILES, cache_dir=models_folder()))
    except StyleSplatError:
        raise
    except Exception as error:
        raise _cannot_download(name, error, size) from error


def _describe(name: str) -> tuple[int, str]:
    """The bytes of a model that are not in the cache yet, and its licence."""
    from huggingface_hub import model_info, try_to_load_from_cache

    cached = partial(try_to_load_from_cache, cache_dir=models_folder())
    info = model_info(name, files_metadata=True, timeout=TIMEOUT)
    size = sum(
        file.size or 0
        for file in info.siblings or ()
        if any(fnmatch(file.rfilename, pattern) for pattern in FILES)
        and not isinstance(cached(name, file.rfilename, revision=info.sha), str)
    )
    card: Mapping[str, Any] = info.card_data.to_dict() if info.card_data else {}
    return size, card.get("license_name") or card.get("license") or f"see {_page(name)}"


def _cannot_download(name: str, error: Exception, size: int | None = None) -> StyleSplatError:
    """Why a model of `size` bytes, which the hub has said if it answered, cannot be had."""
    from huggingface_hub import constants
    from huggingface_hub.errors import (
        GatedRepoError,
        HfHubHTTPError,
        HFValidationError,
        RemoteEntryNotFoundError,
        RepositoryNotFoundError,
    )

    what = reason(error.__cause__ if isinstance(error.__cause__, Exception) else error)
    match error:
        case GatedRepoError():
            cause = (
                f"it is gated. Ask for access on {_page(name)}, then run `hf auth login`, or pass "
                "another --model"
            )
        case RepositoryNotFoundError() | HFValidationError():
            cause = (
                "the Hugging Face Hub has no public model of that name. Check it, OWNER/MODEL; for "
                "a private one run `hf auth login`"
            )
        case RemoteEntryNotFoundError():
            cause = f"it has no {CONFIG}, which `transformers` needs. Pass another model"
        case HfHubHTTPError() if error.response.status_code == 401:
            cause = "the Hugging Face Hub refuses your token. Run `hf auth login`"
        case HfHubHTTPError():
            cause = f"the Hugging Face Hub answered: {reason(error).rstrip('.:')}. Try again later"
        case OSError(errno=code) if size is not None and code in FILE_DISK_FULL:
            cause = (
                f"it needs {size / 1e9:.2f} GB, and {_free_bytes() / 1e9:.2f} GB are free in "
                f"{models_folder()}. Free some, or set {MODELS_VARIABLE} to one on another disk"
            )
        case _ if size is None:
            cause = f"{constants.ENDPOINT} cannot be reached ({what}). {_by_hand(name)}"
        case _:
            cause = (
                f"the download broke off ({what}). Run the same command again: files that have "
                "come whole are kept"
            )
    return StyleSplatError(f"Cannot download {name}: {cause.rstrip('.')}.")


def _by_hand(name: str) -> str:
    return (
        f"Run `hf download {name} --local-dir FOLDER` on a machine with network, then pass "
        "`--model FOLDER`."
    )


def _page(name: str) -> str:
    from huggingface_hub import constants

    return f"{constants.ENDPOINT}/{name}"


def _free_bytes() -> int:
    """Of the disk with the hub's cache, which need not exist yet."""

    cache = Path(models_folder()).absolute()
    return disk_usage(next(each for each in (cache, *cache.parents) if each.exists())).free


@contextmanager
def _short_errors(failure: str, remedy: str) -> Iterator[None]:
    """Turn any library's error into one line: the failure, its first line, the remedy."""
    try:
        yield
    except Exception as error:
        remedy = INSTALL if isinstance(error, ImportError) else remedy
        raise StyleSplatError(f"{failure}: {reason(error).rstrip('.:')}. {remedy}") from error
