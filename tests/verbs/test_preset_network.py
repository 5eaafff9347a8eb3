"""The paper's preset takes VGG16 unless told otherwise, and says what to do where there is none."""

from pathlib import Path

import pytest
import torch

from balls import TRAINED, write_pictures
from stylesplat.errors import StyleSplatError
from stylesplat.stylization.recipe import read_recipe
from stylesplat.stylization.style import Recipe, Style
from stylesplat.verbs.stylize import stylize

pytestmark = pytest.mark.usefixtures("quick_painting")
QUICK = {"steps": 1, "layers": (1,), "object_size": 30}


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where weights are kept, and none can be downloaded."""
    for name in ("TORCH_HOME", "XDG_CACHE_HOME"):
        monkeypatch.setenv(name, str(tmp_path))
    monkeypatch.setenv("https_proxy", "http://127.0.0.1:9")
    return tmp_path


def write_vgg16(folder: Path) -> None:
    """Its first block with random weights, where torchvision keeps it."""
    generator = torch.Generator().manual_seed(0)
    tensors = {}
    for name, inputs in (("features.0", 3), ("features.2", 64)):
        tensors[f"{name}.weight"] = torch.randn(64, inputs, 3, 3, generator=generator)
        tensors[f"{name}.bias"] = torch.randn(64, generator=generator)
    checkpoints = folder / "hub" / "checkpoints"
    checkpoints.mkdir(parents=True)
    torch.save(tensors, checkpoints / "vgg16-397923af.pth")


def networks(recipe: Recipe | dict[str, Style], **options) -> list[str]:
    """Those that objects were painted with."""
    painted = stylize(TRAINED, recipe, device="cpu", **options).layers
    return [layer.features for layer in painted]


def test_the_papers_network_is_vgg16_unless_told(home: Path):
    write_vgg16(home)
    picture, _ = write_pictures(home)
    style = Style(picture, preset="paper", **QUICK)
    assert networks({"red": style}) == ["vgg16"]
    assert networks({"red": style}, features="compact") == ["compact"]
    own = "steps: 1\nlayers: [1]\nobject_size: 30\nobjects:\n  red: {style: wave.png}\n"
    (home / "r.yaml").write_text(own)
    assert networks(read_recipe(home / "r.yaml", preset="paper")) == ["vgg16"]
    (home / "r.yaml").write_text("preset: paper\nfeatures: compact\n" + own)
    assert networks(read_recipe(home / "r.yaml")) == ["compact"]


def test_missing_weights_are_told_in_one_line(home: Path):
    picture, _ = write_pictures(home)
    with pytest.raises(StyleSplatError, match=r"vgg16.*--weights") as told:
        networks({"red": Style(picture, preset="paper", **QUICK)})
    assert "\n" not in str(told.value)
