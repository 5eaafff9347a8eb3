"""The verb `sheet`: what its cells show, and what it refuses."""

import shlex
from pathlib import Path

import pytest
import torch

from processes import complaint, result, run
from stylesplat.figures.grid import CAPTION, GRID_HEAD, GRID_MARGIN
from stylesplat.io.images import read_image
from stylesplat.stylization.config import STYLE_PRESETS
from stylesplat.stylization.recipe import parse_variation
from stylesplat.verbs.sheet import SHEET_CELL, sheet_rows

pytestmark = pytest.mark.usefixtures("quick_painting")
PAINT = "stylesplat.verbs.sheet.stylize"
FAST = ("--features", "compact", "--steps", 2, "--device", "cpu")


def cell(sheet: torch.Tensor, row: int, column: int) -> torch.Tensor:
    """Column 0 holds the object as it is."""
    top = GRID_MARGIN + row * (SHEET_CELL + CAPTION + GRID_MARGIN)
    left = GRID_HEAD + 2 * GRID_MARGIN + column * (SHEET_CELL + GRID_MARGIN)
    return sheet[top : top + SHEET_CELL, left : left + SHEET_CELL].float()


def test_columns_and_rows_are_settings(scene: Path, style: Path, tmp_path: Path, capsys):
    before = {p.name: p.read_bytes() for p in scene.iterdir()}
    vary = ("--vary", "quality=draft", "--vary", "intensity=0,0.5,1")
    call = ("sheet", scene, "-o", tmp_path / "sheet.png", "--style", f"3={style}", *FAST, *vary)
    shown, sheet = result(capsys, *call), read_image(tmp_path / "sheet.png")
    rows, columns = 3 * (SHEET_CELL + CAPTION + GRID_MARGIN), 2 * (SHEET_CELL + GRID_MARGIN)
    assert sheet.shape == (rows + GRID_MARGIN, columns + GRID_HEAD + 2 * GRID_MARGIN, 3)
    assert (shown["cells"], shown["repainted"]) == (3, 1), "intensities are blends of one result"
    assert before == {p.name: p.read_bytes() for p in scene.iterdir()}
    whole = cell(sheet, 0, 0)
    red = (whole[..., 0] > whole[..., 1] + 60) & (whole[..., 0] > whole[..., 2] + 60)
    assert 0.2 < red.float().mean() < 0.7, "the red ball, and a margin around it"
    none, half, full = (cell(sheet, row, 1) for row in range(3))
    assert torch.equal(whole, none)
    assert (full - none).abs().mean() > 6
    # Half of it if no blend; clamped colours make it more
    assert (half - (none + full) / 2).abs().mean() < 0.35 * (full - none).abs().mean()
    assert "--quality draft --intensity 0.5" in shown["commands"][1][0]
    assert len(shown["commands"]) == 3


def test_settings_start_from_the_preset():
    varied = dict([parse_variation("preset=paper,default")])
    ((_, cells),) = sheet_rows(["a.png"], varied, {})
    assert [style.config for _, style in cells] == [
        STYLE_PRESETS["paper"],
        STYLE_PRESETS["default"],
    ]
    assert [style.network for _, style in cells] == ["vgg16", "compact"]
    ((_, cells),) = sheet_rows(["a.png"], {"seed": (1, 2)}, {"preset": "paper", "steps": 9})
    configs = [style.config for _, style in cells]
    assert [(c.steps, c.seed, c.color) for c in configs] == [(9, seed, "free") for seed in (1, 2)]


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["--style", "3={style}", "--style", "7={style}"], "one object, got 3 and 7"),
        (["--style", "3={style}", "--vary", "sclae=1"], "no option of `stylize` to vary, 'sclae'"),
        (["--style", "3={style}", "--vary", "scale=big"], 'size cannot be "big"'),
        (["--style", "3={style}", "--pick", "2,1"], "no cell '2,1'. Use 1,1"),
        (["--style", "3={style}", "--vary", "scale"], "KEY=VALUE"),
        (
            ["--style", "3={style}", "--vary", "scale=1", "--vary", "stroke-size=1"],
            "--vary stroke-size was",
        ),
        (
            ["--style", "3={style}"] * 2 + ["--vary", "scale=1"] + ["--vary", "steps=2"],
            "several styles and one",
        ),
        (["--style", "hat={style}"], "no object 'hat'"),
        (["--style", "3={style}", "-o", "{tmp}/x.txt"], ".png"),
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
    green = ("--style", f"3={style.with_name('green.png')}")
    assert run(*sheet, *green, "--vary", "seed=1,2", "--pick", "2,1") == 0, "styles are rows"
    assert "green.png --steps 9 --seed 1 " in capsys.readouterr().err
    assert not (tmp_path / "sheet.png").exists()
