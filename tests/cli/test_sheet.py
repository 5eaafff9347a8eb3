"""The verb `sheet`: what its cells show, and what it refuses."""

import json
import shlex
from pathlib import Path

import pytest
import torch
from PIL import Image

from processes import complaint, run
from stylesplat.cli.batch import batch_verbs
from stylesplat.cli.sheet import VARIED
from stylesplat.figures.grid import CAPTION, HEAD, MARGIN
from stylesplat.figures.style_sheet import plan_sheet
from stylesplat.io.images import read_image
from stylesplat.stylization.config import PRESETS
from stylesplat.stylization.recipe import parse_variation
from stylesplat.verbs.sheet import CELL

pytestmark = pytest.mark.usefixtures("quick_painting")
PAINT = "stylesplat.verbs.sheet.stylize_unmeasured"
FAST = ("--features", "compact", "--steps", 2, "--device", "cpu")


@pytest.fixture
def draw(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """Draw a sheet of the scene; the answer, and the picture."""

    def draw(*arguments: object) -> tuple[dict, torch.Tensor]:
        out = tmp_path / "sheet.png"
        assert run("sheet", scene, "-o", out, *FAST, *arguments, "--json", "--overwrite") == 0
        return json.loads(capsys.readouterr().out), read_image(out)

    return draw


def cell(sheet: torch.Tensor, row: int, column: int) -> torch.Tensor:
    """Column 0 holds the object as it is."""
    top = MARGIN + row * (CELL + CAPTION + MARGIN)
    left = HEAD + 2 * MARGIN + column * (CELL + MARGIN)
    return sheet[top : top + CELL, left : left + CELL].float()


def size(sheet: torch.Tensor) -> tuple[int, int]:
    """Rows and columns."""
    height, width, _ = sheet.shape
    rows = (height - MARGIN) / (CELL + CAPTION + MARGIN)
    columns = (width - HEAD - 2 * MARGIN) / (CELL + MARGIN)
    assert rows.is_integer() and columns.is_integer()
    return int(rows), int(columns)


def test_columns_and_rows_are_the_two_settings(draw, scene: Path, style: Path):
    before = {p.name: p.read_bytes() for p in scene.iterdir()}
    styles = ("--style", f"3={style}")
    shown, sheet = draw(*styles, "--vary", "color=style,keep", "--vary", "stroke_size=1,3")
    assert size(sheet) == (2, 3)
    assert (shown["cells"], shown["repainted"]) == (4, 4)
    assert before == {p.name: p.read_bytes() for p in scene.iterdir()}
    whole = cell(sheet, 0, 0)
    red = (whole[..., 0] > whole[..., 1] + 60) & (whole[..., 0] > whole[..., 2] + 60)
    assert 0.2 < red.float().mean() < 0.7, "the red ball, and a margin around it"
    middle = slice(CELL // 2 - 20, CELL // 2 + 20)
    for row in range(2):
        own, styled = (cell(sheet, row, c)[middle, middle].mean(dim=(0, 1)) for c in (2, 1))
        assert own[0] > own[2] + 60, "its own hues are kept"
        assert abs(styled[0] - styled[2]) < own[0] - own[2], "the stripes are as blue as red"


def test_intensities_are_blends_of_one_result(draw, style: Path):
    shown, sheet = draw("--style", f"3={style}", "--vary", "intensity=0,0.5,1")
    assert (shown["cells"], shown["repainted"]) == (3, 1)
    before, none, half, full = (cell(sheet, 0, column) for column in range(4))
    assert torch.equal(before, none), "a fresh canvas fades with the paint that is on it"
    assert (full - none).abs().mean() > 6
    # Half of it if no blend; what shows through a fading canvas and clamped colours make it more
    assert (half - (none + full) / 2).abs().mean() < 0.35 * (full - none).abs().mean()


def test_several_styles_are_rows(draw, style: Path, tmp_path: Path):
    green = tmp_path / "green.png"
    Image.new("RGB", (64, 64), (20, 200, 20)).save(green)
    styles = ("--style", f"3={style}", "--style", f"3={green}")
    shown, sheet = draw(*styles)
    assert size(sheet) == (2, 2) and shown["repainted"] == 2
    first, second = (cell(sheet, row, 1).mean(dim=(0, 1)) for row in (0, 1))
    assert second[1] - second[0] > first[1] - first[0] + 20, "the second row is greener"
    edge = sheet[MARGIN + CELL + CAPTION + MARGIN :, : MARGIN + HEAD]
    assert (edge == torch.tensor([20, 200, 20])).all(dim=-1).any(), "the picture, in its row"


def test_settings_start_from_the_preset():
    kinds = parse_variation("preset=paper,default")
    plan = plan_sheet([(Path("a.png"),)], [kinds], settings={"preset": "default"})
    configs = [cell.style.config for cell in plan.cells]
    assert configs == [PRESETS["paper"], PRESETS["default"]]
    assert [style.network for style, _ in plan.runs()] == ["vgg16", "compact"]
    settings = {"preset": "paper", "steps": 9}
    plan = plan_sheet([(Path("a.png"),)], [("seed", (1, 2))], settings=settings)
    configs = [cell.style.config for cell in plan.cells]
    assert [(c.steps, c.seed, c.color) for c in configs] == [(9, seed, "free") for seed in (1, 2)]


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["--style", "3={style}", "--style", "7={style}"], "one object, got 3 and 7"),
        (["--style", "3={style}", "--vary", "sclae=1"], "no option of `stylize` to vary, 'sclae'"),
        (["--style", "3={style}", "--vary", "scale=big"], 'size cannot be "big"'),
        (["--style", "3={style}", "--pick", "2,1"], "no cell '2,1'. Use 1,1"),
        (["--style", "3={style}", "--vary", "scale"], "KEY=VALUE"),
        (["--style", "3={style}", "--vary", "scale=1,,2"], "no valid YAML"),
        (
            ["--style", "3={style}", "--vary", "scale=1", "--vary", "stroke-size=1"],
            "--vary stroke-size was",
        ),
        (
            ["--style", "3={style}"] * 2 + ["--vary", "scale=1"] + ["--vary", "steps=2"],
            "several styles and one",
        ),
        (["--style", "hat={style}"], "no object 'hat'"),
        (["--style", "3={tmp}/none.png"], "none.png"),
        (["--style", "3={style}", "-o", "{tmp}/x.txt"], ".png"),
        (["--style", "3={style}", "-o", "{style}"], "--overwrite"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_refusals_come_before_any_repainting(
    arguments: list[str], expected: str, scene: Path, style: Path, capsys, monkeypatch
):
    monkeypatch.setattr(PAINT, lambda *_, **__: pytest.fail("it started to paint"))
    places = {"style": style, "tmp": scene.parent}
    files = sorted(scene.parent.rglob("*"))
    filled = [argument.format(**places) for argument in arguments]
    output = [] if "-o" in filled else ["-o", scene.parent / "sheet.png"]
    assert expected in complaint(capsys, "sheet", scene, *output, *FAST[:2], *filled)
    assert sorted(scene.parent.rglob("*")) == files


def test_each_cell_has_a_command_that_paints_it(scene: Path, style: Path, tmp_path: Path, capsys):
    sheet = ("sheet", scene, "-o", tmp_path / "sheet.png", "--style", f"3={style}", "--steps", 9)
    vary = ("--vary", "stroke_size=0.5,1", "--vary", "region=null,[0,0,9,9]")
    assert run(*sheet, *vary, "--pick", "2,1") == 0
    words = shlex.split(capsys.readouterr().err.strip())
    assert words[:3] == ["stylesplat", "stylize", str(scene)]
    options = ["--style", f"3={style}", "--steps", "9", "--stroke-size", "0.5"]
    assert words[3:] == [*options, *"--region 0 0 9 9 -o".split(), f"{scene}-painted"]
    assert not (tmp_path / "sheet.png").exists()


def test_what_varies_is_an_option_of_stylize():
    options = batch_verbs()["stylize"].options
    assert {key.replace("_", "-") for key in VARIED} <= {*options}


def test_a_line_for_each_cell(scene: Path, style: Path, tmp_path: Path, capsys):
    assert run("sheet", scene, "-o", tmp_path / "a.png", "--style", f"3={style}", *FAST) == 0
    said = capsys.readouterr().err
    assert "a.png: 1 pictures, seen from" in said and "\n1,1:  stylesplat stylize " in said
