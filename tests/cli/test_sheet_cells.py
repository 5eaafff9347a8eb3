"""`sheet --cells`: the cells as jobs, kept, and the same picture as without."""

import json
from pathlib import Path

import pytest
import torch

from command_line import complaint, run
from stylesplat.cli.sheet_cells import Cells
from stylesplat.figures.style_sheet import plan_sheet
from stylesplat.io.images import read_image
from stylesplat.io.scene_folder import open
from stylesplat.stylization.recipe import parse_variation

FAST = ("--steps", 2, "--device", "cpu")
SCENE = "scene.json"


@pytest.mark.parametrize(
    "vary",
    [
        ["scale=1,2,4", "color=style,keep"],
        ["form=0,1", "scale=1,1.0,3"],
        ["steps=5,7", "content=0,0.5"],
        ["rotate=0,90", "intensity=0.5,1"],
        ["preset=default,paper", "quality=draft"],
        ["region=null,[0,0,9,9]"],
        [],
    ],
    ids=" ".join,
)
def test_jobs_are_what_a_sheet_paints_in_its_order(vary: list[str], scene: Path, style: Path):
    variations = dict(map(parse_variation, vary))
    settings = {"preset": "default", "steps": 7}
    plan = plan_sheet([(style,)], [*variations.items()], settings=settings)
    jobs = Cells(scene, "3", [(style,)], variations, settings).jobs()
    assert len(jobs) == len(plan.runs()), "intensities are blends"
    for job, (styled, _) in zip(jobs, plan.runs(), strict=True):
        words = job.words(scene, scene)
        assert f"--style=3={style}" in words
        for key in variations.keys() - {"preset", "region", "intensity"}:
            assert f"--{key.replace('_', '-')}={getattr(styled.config, key)}" in words
        assert f"--preset={'paper' if styled.config.lr < 0.1 else 'default'}" in words
        assert ("--region" in words) == (styled.config.region is not None)


def test_rows_of_styles_have_names_of_their_own(scene: Path, style: Path, tmp_path: Path):
    other = tmp_path / "other" / style.name
    other.parent.mkdir()
    other.write_bytes(style.read_bytes())
    styles = [(style,), (other,), (style, other), (style,)]
    jobs = Cells(scene, "3", styles, {"scale": (1.0, 2.0)}, {}).jobs()
    assert len({job.name for job in jobs}) == len(jobs) == 3 * 2
    assert len(plan_sheet(styles, [("scale", (1.0, 2.0))], settings={}).runs()) == len(jobs)


def test_cells_are_kept_and_show_what_a_sheet_shows(
    scene: Path, style: Path, tmp_path: Path, capsys
):
    cells, one, other = tmp_path / "cells", tmp_path / "one.png", tmp_path / "other.png"
    say = ("sheet", scene, *FAST, "--style", f"3={style}", "--vary", "intensity=0.5,1", "--json")
    assert run(*say, "-o", one) == 0
    shown = json.loads(capsys.readouterr().out)
    assert run(*say, "-o", other, "--cells", cells) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["cells"], found["repainted"]) == (shown["cells"], shown["repainted"]) == (2, 1)
    first, second = (read_image(path).float() for path in (one, other))
    # threads add in another order, and two steps make little of that
    assert first.shape == second.shape and (first - second).abs().mean() < 0.2
    (made,) = cells.glob(f"*/{SCENE}")
    assert made.parent.name == f"{scene.name}-3-{style.stem}" and open(made.parent).layers

    before = made.stat().st_mtime_ns
    assert run(*say, "-o", other, "--cells", cells, "--overwrite", "--workers", 2) == 0
    assert made.stat().st_mtime_ns == before
    assert torch.equal(read_image(other).float(), second)


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["--workers", "2"], "--workers means nothing without --cells"),
        (["--cells", "{tmp}/cells", "--workers", "0"], "at least one worker"),
        (
            ["--cells", "{tmp}/cells", "--vary", "lr=0.1,0.2"],
            "no option that says all values of lr",
        ),
        (["--cells", "{tmp}/cells", "--vary", "layers=[3],[2,3]"], "values of layers"),
        (["--cells", "{tmp}/cells", "--vary", "region=null", "--preset", "paper"], "of region"),
        (["--cells", "{tmp}"], "holds something that is no result of jobs"),
        (["--cells", "{tmp}/cells", "--view", "lost.jpg"], "No view is called"),
        (["--cells", "{tmp}/cells", "--style", "3={tmp}/no.png"], "no.png"),
    ],
)
def test_refusals(arguments: list[str], expected: str, scene: Path, style: Path, capsys):
    filled = [each.format(tmp=scene.parent) for each in arguments]
    styles = [] if "--style" in filled else ["--style", f"3={style}"]
    line = complaint(capsys, "sheet", scene, "-o", scene.parent / "sheet.png", *styles, *filled)
    assert expected in line and not (scene.parent / "sheet.png").exists()


def test_what_cannot_be_painted_is_told(scene: Path, style: Path, tmp_path: Path, capsys):
    out = ("-o", tmp_path / "sheet.png", "--cells", tmp_path / "cells", *FAST)
    network = ("--features", "vgg16", "--weights", style)
    line = complaint(capsys, "sheet", scene, "--style", f"3={style}", *network, *out)
    assert "1 of 1 jobs failed" in line
