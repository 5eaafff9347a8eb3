"""Options are declared once: every surface offers them, and refuses what is out of range."""

import math
from pathlib import Path
from typing import Any, get_type_hints

import pytest

from processes import planned
from stylesplat.cli import VERBS
from stylesplat.cli.arguments import read_command, settings_of
from stylesplat.errors import StyleSplatError
from stylesplat.meshes.mesh_config import MeshConfig
from stylesplat.options import Config, Option, options_of, with_settings
from stylesplat.structure_from_motion.config import SfmConfig
from stylesplat.studio_app.messages import page_settings as studio_settings
from stylesplat.stylization.config import RecolorConfig, StyleConfig
from stylesplat.stylization.recipe import read_recipe
from stylesplat.training.config import TrainConfig

COMMANDS: dict[str, tuple[type[Config], tuple[str, ...]]] = {
    "train": (TrainConfig, ("photos", "-o", "scene")),
    "stylize": (StyleConfig, ("garden", "-o", "wave")),
    "recolor": (RecolorConfig, ("garden",)),
    "export": (MeshConfig, ("garden", "vase.glb", "--mesh")),
    "sfm": (SfmConfig, ("photos", "-o", "garden")),
}
OPTIONS = [(verb, *each) for verb, (c, _) in COMMANDS.items() for each in options_of(c).items()]
RANGES = [each for each in OPTIONS if each[2].low is not None]
OFFERED = [each for each in RANGES if not each[2].research]
IN_JOBS = [each for each in OFFERED if each[0] != "sfm"]
IN_RECIPES = [each for each in RANGES if each[0] in ("stylize", "recolor")]
RECIPE = "{name}: {value}\nobjects: {{a: {{style: wave.jpg}}}}\n"


def ids(value: Any) -> str | None:
    return value if isinstance(value, str) else ""


def beyond(option: Option) -> list[float | int]:
    assert option.low is not None and option.high is not None
    return [option.low - 1, option.high + 1 if option.high < 10**9 else 2 * option.high]


@pytest.mark.parametrize("verb", COMMANDS)
def test_the_command_line_offers_all_but_those_for_research(verb: str):
    (settings,) = settings_of(VERBS[verb]).values()
    options = options_of(COMMANDS[verb][0])
    assert {*get_type_hints(settings)} == {n for n, each in options.items() if not each.research}


@pytest.mark.parametrize(("verb", "name", "option"), OPTIONS, ids=ids)
def test_numbers_have_ranges_and_defaults_fit(verb: str, name: str, option: Option):
    numbers = (int, float, int | None, float | None)
    assert (option.kind in numbers) == (option.low is not None)
    assert option.convert(option.default) == option.default
    assert getattr(COMMANDS[verb][0](), name) == option.default


@pytest.mark.parametrize(("verb", "name", "option"), RANGES, ids=ids)
def test_python_refuses_what_is_out_of_range(verb: str, name: str, option: Option):
    config = COMMANDS[verb][0]()
    assert (option.convert(option.low), option.convert(option.high)) == (option.low, option.high)
    for value in (*beyond(option), math.nan, True, "1", [1]):
        with pytest.raises(StyleSplatError, match=f"Cannot {config.verb} with {name} "):
            with_settings(config, {name: value})


@pytest.mark.parametrize(("verb", "name", "option"), OFFERED, ids=ids)
def test_the_command_line_refuses_it(verb: str, name: str, option: Option):
    flag = (option.name or name).replace("_", "-")
    for value in beyond(option):
        words = (*COMMANDS[verb][1], f"--{flag}={value}")
        with pytest.raises(StyleSplatError, match=f"with {name} "):
            read_command(VERBS[verb], words, verb)


@pytest.mark.parametrize(("verb", "name", "option"), IN_JOBS, ids=ids)
def test_a_job_file_refuses_it(verb: str, name: str, option: Option, tmp_path: Path):
    (tmp_path / "photos" / "images").mkdir(parents=True)
    (tmp_path / "photos" / "transforms.json").write_text("{}")
    scene = "photos" if verb == "train" else "garden"
    more = {"stylize": "style: {a: wave.jpg}, ", "export": "output: a.glb, mesh: true, "}
    for value in beyond(option):
        job = f"{verb}: {{{more.get(verb, '')}{name}: {value}}}"
        with pytest.raises(StyleSplatError, match=f"line 3: .*with {name} "):
            planned(tmp_path, f"scenes: [{scene}]\njobs:\n  - {job}\n")


@pytest.mark.parametrize(("verb", "name", "option"), IN_RECIPES, ids=ids)
def test_a_recipe_refuses_it(verb: str, name: str, option: Option, tmp_path: Path):
    text = RECIPE if verb == "stylize" else "objects: {{a: {{recolor: {{{name}: {value}}}}}}}"
    (tmp_path / "wave.jpg").touch()
    for value in beyond(option):
        (tmp_path / "r.yaml").write_text(text.format(name=name, value=value))
        with pytest.raises(StyleSplatError, match=f"{name} .*use"):
            read_recipe(tmp_path / "r.yaml")


@pytest.mark.parametrize("config", [StyleConfig, RecolorConfig])
def test_the_studio_offers_the_same_defaults_within_the_ranges(config: type[Config]):
    options = options_of(config)
    for each in studio_settings(config):
        option = options[each.name]
        assert (each.value, each.choices) == (option.default, option.choices)
        for value in option.choices or option.slider:
            assert option.convert(value) == value
