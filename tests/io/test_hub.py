import json
import os
import shutil
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import huggingface_hub
import pytest
import torch
from huggingface_hub import constants
from safetensors.torch import load_file, save_file

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


def test_a_download_is_announced_and_starts_with_the_type(
    folder: Path, cache: Path, monkeypatch, said: list[str]
):
    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", False)
    fetched = []

    def snapshot(name: str, *, allow_patterns: list[str], local_files_only: bool = False) -> str:
        if local_files_only:
            raise FileNotFoundError
        fetched.append(allow_patterns)
        return str(folder)

    monkeypatch.setattr(huggingface_hub, "hf_hub_download", lambda name, file: folder / file)
    monkeypatch.setattr(huggingface_hub, "snapshot_download", snapshot)
    with pytest.raises(StyleSplatError, match="pass one of the type sam"):
        find_model(NAME, ["sam"], job="sing")
    assert fetched == []
    assert find(NAME).path == folder
    assert fetched == [["*.json", "*.txt", "model*.safetensors"]]
    assert said[-1] == f"Downloading the model {NAME} to {cache}."


def test_the_hub_refuses(cache: Path, monkeypatch):
    def download(name: str, file: str) -> str:
        raise OSError("[Errno 28] No space left on device\nsecond line")

    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", False)
    monkeypatch.setattr(huggingface_hub, "hf_hub_download", download)
    match = r"^Cannot download owner/tiny: .*No space left on device\..*hf auth login.*FOLDER`\.$"
    with pytest.raises(StyleSplatError, match=match):
        find(NAME)


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
