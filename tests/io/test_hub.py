import json
import os
import shutil
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from huggingface_hub import constants
from safetensors.torch import load_file, save_file

from hub_server import COMMIT, Hub, point_to, serve
from stylesplat.errors import StyleSplatError
from stylesplat.io import hub
from stylesplat.io.hub import find_model, is_at_hand, load_model, load_processor

Models = Callable[[str], Path]
NAME = "owner/tiny"
TYPES = ("sam2_video",)


@pytest.fixture
def folder(tiny_model: Models, tmp_path: Path) -> Path:
    """A whole model that may be broken."""
    return shutil.copytree(tiny_model("sam2"), tmp_path / "model")


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache, and no network."""
    monkeypatch.setattr(constants, "HF_HUB_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", True)
    return tmp_path / "cache"


def find(name: str | Path) -> hub.ModelFolder:
    return find_model(str(name), TYPES, job="follow objects")


def load(folder: Path) -> Any:
    from transformers import Sam2VideoModel

    return load_model(find(folder), Sam2VideoModel, device="cpu", dtype=torch.float32)


def refuse(folder: Path, match: str) -> None:
    with pytest.raises(StyleSplatError, match=match) as refused:
        load(folder)
    assert "\n" not in str(refused.value)


def put_into_cache(folder: Path, cache: Path, *, without: str = "") -> None:
    """Lay files out as huggingface_hub does after a download."""
    repository = cache / f"models--{NAME.replace('/', '--')}"
    leave_out = shutil.ignore_patterns(without)
    shutil.copytree(folder, repository / "snapshots" / ("0" * 40), ignore=leave_out)
    (repository / "refs").mkdir()
    (repository / "refs" / "main").write_text("0" * 40)


def change_config(folder: Path, **entries: Any) -> None:
    config = json.loads((folder / "config.json").read_text())
    (folder / "config.json").write_text(json.dumps(config | entries))


def test_a_folder_is_loaded_for_inference(folder: Path, recwarn, capfd):
    model = load(folder)
    assert not model.training and not any(p.requires_grad for p in model.parameters())
    assert {p.dtype for p in model.parameters()} == {torch.float32}
    from transformers import Sam2VideoProcessor

    assert load_processor(find(folder), Sam2VideoProcessor).target_size == 64
    assert capfd.readouterr() == ("", "") and not recwarn.list


@pytest.mark.parametrize("name", ["{tmp}/none", "none", "a/b/c", "{tmp}/file", "{tmp}"])
def test_not_a_model(name: str, tmp_path: Path):
    (tmp_path / "file").touch()
    with pytest.raises(StyleSplatError, match=r"is no model: .*config\.json.*hf download"):
        find(name.format(tmp=tmp_path))


def test_a_model_of_another_type(folder: Path):
    match = r"is of the type sam2_video\. To sing, pass one of the type opera or x"
    with pytest.raises(StyleSplatError, match=match):
        find_model(str(folder), ["x", "opera"], job="sing")
    (folder / "config.json").write_text("{}")
    with pytest.raises(StyleSplatError, match=r"has no model_type in config\.json"):
        find(folder)


def test_the_cache_needs_no_network(folder: Path, cache: Path, said: list[str]):
    assert is_at_hand(str(folder)) and not is_at_hand(NAME)
    put_into_cache(folder, cache)
    assert is_at_hand(NAME)
    assert find(NAME).path.is_relative_to(cache)
    assert said == []


@pytest.mark.parametrize(
    "missing", ["config.json", "model.safetensors", "processor_config.json", "everything"]
)
def test_half_a_model_in_the_cache_is_none(
    missing: str, folder: Path, cache: Path, said: list[str]
):
    if missing != "everything":
        put_into_cache(folder, cache, without=missing)
    with pytest.raises(StyleSplatError, match=r"is not in the cache.*--model FOLDER"):
        find(NAME)
    assert said == [], "no download is announced that is not tried"


@pytest.mark.parametrize("missing", ["model-00002-of-00002.safetensors", "every tokenizer"])
def test_a_download_that_ended_early_is_no_model(missing: str, folder: Path, cache: Path):
    shards = [f"model-0000{n}-of-00002.safetensors" for n in (1, 2)]
    (folder / "model.safetensors").rename(folder / shards[0])
    (folder / shards[1]).touch()
    index = {"weight_map": dict(zip("ab", shards, strict=True))}
    (folder / "model.safetensors.index.json").write_text(json.dumps(index))
    change_config(folder, detector_config={"text_config": {}})
    for name in ("tokenizer.json", "vocab.json", "merges.txt"):
        (folder / name).touch()
    put_into_cache(folder, cache)
    assert is_at_hand(NAME)
    names = ("vocab.json", "tokenizer.json") if missing == "every tokenizer" else (missing,)
    for name in names:
        (cache / "models--owner--tiny/snapshots" / ("0" * 40) / name).unlink()
    assert not is_at_hand(NAME)


@pytest.fixture
def online(folder: Path, cache: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Hub]:
    """A hub with the model, and an empty cache."""
    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", False)
    monkeypatch.setattr(constants, "HF_HUB_DISABLE_XET", True)
    hub = Hub(NAME, folder, {"license": "apache-2.0"})
    with serve(hub, monkeypatch):
        yield hub


def test_a_download_is_announced_and_found_again_without_network(
    online: Hub, cache: Path, monkeypatch: pytest.MonkeyPatch, said: list[str]
):
    (online.folder / "pytorch_model.bin").touch()
    (online.folder / "notes.json").write_text("{}")
    with pytest.raises(StyleSplatError, match="pass one of the type opera"):
        find_model(NAME, ["opera"], job="sing")
    assert online.fetched == ["config.json"] * 2 and not said, "HEAD and GET, and nothing else"
    found = find(NAME).path
    assert "model.safetensors" in online.fetched and "pytorch_model.bin" not in online.fetched
    (line,) = said
    assert line.startswith(f"Downloading {NAME} to {cache}: 0.00 GB, about 0 s at 100 Mbit/s")
    assert line.endswith("licence: apache-2.0.")
    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", True)
    assert is_at_hand(NAME) and find(NAME).path == found
    assert found == cache / "models--owner--tiny" / "snapshots" / COMMIT
    assert (found / "model.safetensors").is_symlink(), "to a file by its hash, as the hub's are"
    load(found)
    (found / "notes.json").unlink()
    assert is_at_hand(NAME), "nothing reads it, although the library knows that it belongs there"


def test_the_size_is_that_of_what_is_not_there_yet(online: Hub, said: list[str], monkeypatch):
    monkeypatch.setattr(hub, "disk_usage", lambda _: SimpleNamespace(free=10**12))
    online.card = {"license": "other", "license_name": "sam-license"}
    online.sizes = {"config.json": 10**9, "model.safetensors": 2_440_000_000}
    online.breaks = "model.safetensors"
    with pytest.raises(StyleSplatError, match="download broke off"):
        find(NAME)
    online.breaks = ""
    find(NAME)
    assert ": 3.44 GB, about 5 min at 100 Mbit/s; licence: sam-license." in said[0]
    assert ": 2.44 GB, about 3 min" in said[1]


@pytest.mark.parametrize(
    ("failure", "match"),
    [
        (
            "gated",
            r"it is gated\. Ask for access on http://.*/owner/tiny, then run `hf auth login`",
        ),
        ("missing", r"has no public model of that name\. Check it, OWNER/MODEL"),
        ("token", r"refuses your token\. Run `hf auth login`"),
        ("no config", r"has no config\.json, which `transformers` needs"),
        ("down", r"answered: .*503.*\. Try again later\."),
        (
            "unreachable",
            r"http://127.0.0.1:9 cannot be reached \(.*refused.*`hf download owner/tiny",
        ),
        (
            "disk full",
            r"needs 9000\.00 GB, and \d+\.\d\d GB are free in .*cache\. .*STYLESPLAT_MODELS",
        ),
        ("broken", r"the download broke off \(.*\)\. Run the same command again"),
    ],
)
def test_why_a_model_cannot_be_had(
    failure: str, match: str, online: Hub, cache: Path, monkeypatch: pytest.MonkeyPatch
):
    """One line each, for the errors that the library itself raises."""
    name = "owner/other" if failure == "missing" else NAME
    if failure == "gated":
        online.gated = True
    elif failure in ("token", "down"):
        online.status = 401 if failure == "token" else 503
    elif failure == "no config":
        (online.folder / "config.json").unlink()
    elif failure == "unreachable":
        point_to("http://127.0.0.1:9", monkeypatch)
    elif failure == "disk full":
        online.sizes = {"model.safetensors": 9 * 10**12}
    elif failure == "broken":
        online.breaks = "model.safetensors"
    with pytest.raises(StyleSplatError, match=f"^Cannot download {name}: .*{match}") as refused:
        find(name)
    assert "\n" not in str(refused.value)
    assert not is_at_hand(name)


def test_packages_that_are_missing(folder: Path, monkeypatch):
    class Needy:
        @staticmethod
        def from_pretrained(*args: Any, **options: Any) -> None:
            raise ImportError("\nNeedy requires the timm library\nand more\n")

    with pytest.raises(StyleSplatError, match=r"requires the timm library\. Run `pip install 's"):
        load_processor(find(folder), Needy)
    monkeypatch.setitem(sys.modules, "transformers", None)
    match = r"Cannot follow objects without `transformers`\. .*stylesplat\[segment\]"
    with pytest.raises(StyleSplatError, match=match):
        find(folder)


def test_damaged_weights(folder: Path):
    change_config(folder, memory_fuser_intermediate_dim=24)
    refuse(folder, r"Cannot load the model in .*whole model")
    change_config(folder, num_maskmem="seven")
    refuse(folder, "Cannot load the model in .*num_maskmem")
    weights = folder / "model.safetensors"
    os.truncate(weights, weights.stat().st_size // 2)
    refuse(folder, "Cannot load the model in ")
    weights.unlink()
    (folder / "pytorch_model.bin").touch()
    refuse(folder, "Cannot load the model in ")


@pytest.mark.parametrize("part", ["memory_encoder.", "shared_image_embedding.positional_embedding"])
def test_weights_that_are_not_all_there(folder: Path, part: str):
    """Transformers warns, fills the gap by chance, and goes on."""
    path = folder / "model.safetensors"
    rest = {name: t for name, t in load_file(path).items() if not name.startswith(part)}
    save_file(rest, path, metadata={"format": "pt"})
    refuse(folder, rf"lack \d+ of the tensors that Sam2VideoModel needs, such as .*{part[:14]}")


def test_code_beside_a_model_is_not_run(folder: Path, tmp_path: Path):
    from transformers import AutoImageProcessor, AutoModelForMaskGeneration

    (folder / "theirs.py").write_text(f"open({str(tmp_path / 'ran')!r}, 'w')\nclass Theirs: pass\n")
    theirs = {"AutoModelForMaskGeneration": "theirs.Theirs", "AutoImageProcessor": "theirs.Theirs"}
    change_config(folder, auto_map=theirs)
    for name in hub.PROCESSORS:
        (folder / name).write_text(json.dumps({"auto_map": theirs}))
    source = hub.ModelFolder(folder, "sam2_video")
    with suppress(StyleSplatError):  # or the library's own class is taken
        load_processor(source, AutoImageProcessor)
    with suppress(StyleSplatError):
        load_model(source, AutoModelForMaskGeneration, device="cpu", dtype=torch.float32)
    assert not (tmp_path / "ran").exists()
