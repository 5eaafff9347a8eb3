from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path

import pytest

from stylesplat.errors import StyleSplatError
from stylesplat.scene.layers import Source
from stylesplat.stylization.config import STYLE_PRESETS, StyleConfig
from stylesplat.stylization.recipe import read_recipe
from stylesplat.stylization.style import Recipe

DEFAULTS = StyleConfig()

Read = Callable[[str], Recipe]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two pictures; nothing looks into them."""
    (tmp_path / "wave.jpg").write_bytes(b"wave")
    (tmp_path / "night.jpg").write_bytes(b"night")
    return tmp_path


@pytest.fixture
def read(folder: Path) -> Read:
    """Read a text as a recipe in that folder."""

    def read(text: str) -> Recipe:
        (folder / "r.yaml").write_text(text, encoding="utf-8")
        return read_recipe(folder / "r.yaml")

    return read


def config_of(recipe: Recipe) -> StyleConfig:
    return recipe.objects[0].style.config


def test_an_object_has_the_settings_of_all_and_its_own(read: Read, folder: Path):
    recipe = read(
        """
        steps: 20
        features: vgg19
        weights: nets/vgg19.safetensors
        objects:
          vase:
            style: [wave.jpg, night.jpg]
            scale: 3   # whole, and becomes a float
          pear: &pear {style: night.jpg, steps: 30, settings: {layers: [2], steps: 40}}
          apple: {<<: *pear, steps: 8}
        """
    )
    vase, pear, apple = recipe.objects
    assert (vase.name, pear.name) == ("vase", "pear")
    assert apple.style.config == replace(pear.style.config, steps=8)
    assert apple.style.pictures == pear.style.pictures
    assert vase.style.pictures == (folder / "wave.jpg", folder / "night.jpg")
    assert pear.style.pictures == (folder / "night.jpg",)
    assert vase.style.config == replace(DEFAULTS, steps=20, scale=3.0)
    assert isinstance(vase.style.config.scale, float)
    assert pear.style.config == replace(DEFAULTS, steps=30, block=2)
    for each in recipe.objects:
        assert each.features == "vgg19"
        assert each.weights == Source(folder / "nets" / "vgg19.safetensors")


def test_a_preset_takes_the_place_of_the_defaults(read: Read):
    recipe = read("{preset: paper, seed: 1, objects: {vase: {style: wave.jpg}}}")
    assert config_of(recipe) == replace(STYLE_PRESETS["paper"], seed=1)
    (vase,) = recipe.objects
    assert (vase.features, vase.weights, vase.intensity, vase.form) == (None, None, None, None)
    assert vase.style.network == "vgg16"


def test_every_setting_refuses_what_it_cannot_be(read: Read):
    for field in fields(StyleConfig):
        fault = rf"r\.yaml: {field.name} cannot be \[\[\]\]: .+\."
        with pytest.raises(StyleSplatError, match=fault):
            read(f"{field.name}: [[]]\nobjects: {{a: {{style: wave.jpg}}}}")


@pytest.mark.parametrize(
    "text",
    [
        "{{steps: 3, {gone}, objects: {{a: {{style: wave.jpg}}}}}}",
        "{{settings: {{steps: 3, {gone}}}, objects: {{a: {{style: wave.jpg}}}}}}",
        "{{objects: {{a: {{style: wave.jpg, steps: 3, {gone}}}}}}}",
    ],
    ids=["of all", "of a scene", "of one"],
)
def test_settings_that_are_gone_are_read_and_told(text: str, read: Read, said: list[str]):
    """Recipes of before may have them; a name is told once, whatever else is asked for."""
    gone = "texture: soften, smoothness: 2.5"
    assert config_of(read(text.format(gone=gone))) == replace(DEFAULTS, steps=3)
    for name in ("texture", "smoothness"):
        assert sum(name in line for line in said) == 1


OBJECTS = "objects: {vase: {style: wave.jpg}}\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (OBJECTS + "stepps: 3", "there is no key 'stepps'. Did you mean 'steps'?"),
        (OBJECTS + "steps: many", 'steps cannot be "many": it must be int or None.'),
        (OBJECTS + "features: vgg", ": it must be compact or vgg16 or vgg19."),
        ("objects: {vase: {steps: 3}}", "vase: it has no picture. Add `style: IMAGE`."),
        (
            "objects: {vase: {style: [wave.jpg, null], sha256: [abc, abd]}}",
            "vase: it was painted with colours that were never a file. Save them, add",
        ),
        ("objects: {vase: wave.jpg}", "vase must be KEY: VALUE. Write vase: {style: IMAGE}."),
        ("objects: {vase: {style: lost.jpg}}", "lost.jpg. Paths are relative to the recipe's"),
        ("objects: {}", "it names no objects. Add `objects:`"),
        ("objects: [{style: wave.jpg}]", "a name must not be empty"),
        ("steps: 3\nobjects:\n  vase: [", "line 3 is no valid YAML: "),
        (
            "objects:\n  vase: {style: wave.jpg}\n  pear: {style: wave.jpg}\n"
            "  vase: {style: night.jpg}",
            "line 4 is no valid YAML: vase is listed twice.",
        ),
        (
            "objects: {vase: {style: wave.jpg, sha256: abc}}",
            "wave.jpg is another picture than the recipe's: its digest differs. Put",
        ),
        (
            "objects: {vase: {style: [wave.jpg, night.jpg], sha256: abc}}",
            "vase: sha256 must have 2 digests, not 1.",
        ),
    ],
)
def test_faults_are_named_in_one_line(text: str, message: str, read: Read, folder: Path):
    with pytest.raises(StyleSplatError) as raised:
        read(text)
    line = str(raised.value)
    assert line.startswith(f"Cannot use the recipe {folder / 'r.yaml'}: ")
    assert message in line and "\n" not in line


def test_files_that_are_no_recipe(folder: Path):
    (folder / "night.jpg").write_bytes(b"\xff\xd8\xff\xe0")
    for file, fault in (
        ("lost.yaml", r"lost\.yaml: No such file or directory"),
        (".", r"it is no recipe. Give a YAML file, or the recipe.json"),
        ("night.jpg", r"night\.jpg: it is no YAML text: unacceptable"),
    ):
        with pytest.raises(StyleSplatError, match=fault):
            read_recipe(folder / file)
