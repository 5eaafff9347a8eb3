"""Models that others trained: from a folder, from the user's cache, or downloaded into it."""

import re
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import version
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
FILES = ("*.json", "*.txt", "model*.safetensors")
WEIGHTS = ("model.safetensors", "model.safetensors.index.json")  # whole, or in parts
PROCESSORS = ("processor_config.json", "preprocessor_config.json")
HUB_NAME = re.compile(r"[A-Za-z0-9][\w.-]*/[\w.-]+")  # OWNER/MODEL
OLDEST = 5  # of `transformers`: SAM 2, SAM 3 and EdgeTAM came after 4
INSTALL = "Run `pip install 'stylesplat[segment]'`."


@dataclass(frozen=True)
class ModelFolder:
    """A model on disk, not yet loaded."""

    path: Path
    """Holds `config.json`, the weights, and how pictures and words are prepared for them."""
    model_type: str
    """What `config.json` calls it."""


def find_model(name: str, types: Collection[str], *, job: str) -> ModelFolder:
    """Find a model that is fit for a job, and download it if it is nowhere on this machine.

    Args:
        name: Its folder, or its name on the Hugging Face Hub. There, what the user's cache holds
            is taken as it is; a download is announced on stderr.
        types: The `model_type`s of `config.json` that can do the job.
        job: What that is, such as `propose masks`.

    Raises:
        StyleSplatError: If there is no such folder or model, it is of another type, it cannot be
            downloaded, or `transformers` is not installed.
    """
    if find_spec("transformers") is None:
        raise StyleSplatError(f"Cannot {job} without `transformers`. {INSTALL}")
    installed = version("transformers")
    if int(installed.split(".")[0]) < OLDEST:
        raise StyleSplatError(
            f"Cannot {job} with `transformers` {installed}: it takes {OLDEST} or newer. {INSTALL}"
        )
    # As it is where nobody knows whose home it means: pathlib raises RuntimeError then
    folder = Path(expanduser(name))  # noqa: PTH111
    if not folder.exists() and HUB_NAME.fullmatch(name):
        folder = _from_hub(name, lambda config: _check_type(config, name, types, job))
    elif not folder.is_dir():
        what = "is a file" if folder.exists() else "does not exist"
        raise StyleSplatError(
            f"The model folder {name} {what}. Pass the folder that holds {CONFIG} and "
            f"{WEIGHTS[0]}, or a name on the Hugging Face Hub, OWNER/MODEL."
        )
    if not (folder / CONFIG).is_file():
        raise StyleSplatError(
            f"The folder {name} is no model: it has no {CONFIG}. Pass the folder that "
            "`hf download OWNER/MODEL --local-dir FOLDER` or `save_pretrained` filled."
        )
    return ModelFolder(folder, _check_type(folder / CONFIG, name, types, job))


def is_at_hand(name: str) -> bool:
    """Whether a model is on this machine: nothing would be downloaded."""
    folder = Path(expanduser(name))  # noqa: PTH111
    if folder.exists() or find_spec("huggingface_hub") is None:
        return folder.exists()
    return _cached(name) is not None


def load_model(
    source: ModelFolder, kind: Any, *, device: torch.device | str, dtype: torch.dtype
) -> Any:
    """Load a model to run it only.

    Args:
        source: What `find_model` found.
        kind: The class of `transformers` that has `from_pretrained`.
        device: Where the model shall compute.
        dtype: What in.

    Raises:
        StyleSplatError: If the weights are missing, damaged, of other shapes than `config.json`
            says, or not all there.
    """
    if not any((source.path / name).is_file() for name in WEIGHTS):
        raise StyleSplatError(
            f"{source.path} has no weights: there is no {WEIGHTS[0]} in it. Pass the whole model."
        )
    with _reading(source), _quiet():
        model, report = kind.from_pretrained(
            source.path,
            dtype=dtype,
            local_files_only=True,
            trust_remote_code=False,  # nor ask for it
            use_safetensors=True,
            ignore_mismatched_sizes=True,  # they are in the report, and refused below
            output_loading_info=True,
        )
    _check_complete(model, report, source)
    return model.to(device).eval().requires_grad_(False)


def load_processor(source: ModelFolder, kind: Any) -> Any:
    """Load what prepares pictures, and words, for a model.

    Args:
        source: What `find_model` found.
        kind: The class of `transformers` that has `from_pretrained`.

    Raises:
        StyleSplatError: If its files are missing or damaged.
    """
    if not any((source.path / name).is_file() for name in PROCESSORS):
        raise StyleSplatError(
            f"{source.path} does not say how to prepare its input: there is no {PROCESSORS[0]} or "
            f"{PROCESSORS[1]} in it. Copy it from where the weights come from."
        )
    with _reading(source), _quiet():
        return kind.from_pretrained(source.path, local_files_only=True, trust_remote_code=False)


def _check_type(config: Path, name: str, types: Collection[str], job: str) -> str:
    model_type = read_json(config).get("model_type")
    if model_type not in types:
        known = f"is of the type {model_type}" if model_type else f"has no model_type in {CONFIG}"
        raise StyleSplatError(
            f"The model {name} {known}. To {job}, pass one of the type "
            f"{' or '.join(sorted(types))}."
        )
    return str(model_type)


def _from_hub(name: str, check: Callable[[Path], str]) -> Path:
    """The model's folder in the user's cache, filled first if need be."""
    from huggingface_hub import constants, hf_hub_download, is_offline_mode, snapshot_download
    from huggingface_hub.errors import GatedRepoError, HFValidationError, RepositoryNotFoundError

    cached = _cached(name)
    if cached is not None:
        return cached
    by_hand = (
        f"Run `hf download {name} --local-dir FOLDER` on a machine with network, then pass "
        "`--model FOLDER`."
    )
    if is_offline_mode():
        raise StyleSplatError(f"{name} is not in the cache, and HF_HUB_OFFLINE is set. {by_hand}")
    say(f"Downloading the model {name} to {constants.HF_HUB_CACHE}.")
    try:
        check(Path(hf_hub_download(name, CONFIG)))  # before gigabytes of the wrong model
        bars = _terminal_bars()
        return Path(snapshot_download(name, allow_patterns=[*FILES], tqdm_class=bars))
    except GatedRepoError as error:
        raise StyleSplatError(
            f"{name} is given only to those who accept its terms. Do so on its page, run "
            "`hf auth login`, and try again."
        ) from error
    except (RepositoryNotFoundError, HFValidationError) as error:
        raise StyleSplatError(
            f"There is neither a folder {name} nor a model of that name on the Hugging Face Hub. "
            "Check the name; a private model needs `hf auth login`."
        ) from error
    except StyleSplatError:
        raise
    except Exception as error:  # of the network, the hub or the disk
        raise StyleSplatError(f"Cannot download {name}: {_first_line(error)} {by_hand}") from error


def _terminal_bars() -> type[Any]:
    """The hub's progress bars, drawn on terminals only: in a log they are a flood."""
    from huggingface_hub.utils import tqdm

    class Bars(tqdm):
        def __init__(self, *arguments: Any, **options: Any) -> None:
            super().__init__(*arguments, **{**options, "disable": options.get("disable") or None})

    return Bars


def _cached(name: str) -> Path | None:
    """The model's folder in the user's cache, if all that it takes to load it is there."""
    from huggingface_hub import snapshot_download

    try:
        folder = Path(snapshot_download(name, allow_patterns=[*FILES], local_files_only=True))
    except (OSError, ValueError):  # not there, not whole, or no name that could be
        return None
    needed = (CONFIG,), WEIGHTS, PROCESSORS
    whole = all(any((folder / file).is_file() for file in choice) for choice in needed)
    return folder if whole else None


def _check_complete(model: Any, report: dict[str, Any], source: ModelFolder) -> None:
    """Refuse weights that leave a part of the model as chance made it: results would be noise.

    Superfluous weights are none of our business: one checkpoint serves several models. Counters
    and indices (integers) follow from the configuration.
    """
    if report["mismatched_keys"]:
        name, found, expected = min(report["mismatched_keys"])
        raise StyleSplatError(
            f"The weights in {source.path} do not fit its {CONFIG}: {name} has the shape "
            f"{[*found]}, expected {[*expected]}. Download the model again."
        )
    state = model.state_dict()
    missing = sorted(name for name in report["missing_keys"] if state[name].is_floating_point())
    if missing:
        raise StyleSplatError(
            f"The weights in {source.path} lack {len(missing)} of the tensors that "
            f"{type(model).__name__} needs, such as {missing[0]}. Pass the whole model."
        )
    if report["error_msgs"]:
        raise _unreadable(source, report["error_msgs"][0])


@contextmanager
def _reading(source: ModelFolder) -> Iterator[None]:
    """One line for whatever the many libraries behind `transformers` raise at damaged files."""
    try:
        yield
    except ImportError as error:
        raise StyleSplatError(
            f"The model in {source.path} needs a package that is missing: {_first_line(error)} "
            f"{INSTALL}"
        ) from error
    except Exception as error:
        raise _unreadable(source, error) from error


def _unreadable(source: ModelFolder, reason: object) -> StyleSplatError:
    return StyleSplatError(
        f"Cannot load the model in {source.path}: {_first_line(reason)} Download it again."
    )


def _first_line(reason: object) -> str:
    """The first line of a message that may have many, as a sentence."""
    line = next((line.strip() for line in str(reason).splitlines() if line.strip()), "")
    return f"{line.rstrip('.:') or type(reason).__name__}."


@contextmanager
def _quiet() -> Iterator[None]:
    """Without the log and progress bars of `transformers`: what matters is checked here."""
    from transformers.utils import logging

    verbosity, bars = logging.get_verbosity(), logging.is_progress_bar_enabled()
    logging.set_verbosity_error()
    logging.disable_progress_bar()
    try:
        yield
    finally:
        logging.set_verbosity(verbosity)
        if bars:
            logging.enable_progress_bar()
