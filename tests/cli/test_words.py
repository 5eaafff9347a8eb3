"""What verbs say at the end: what was made, a picture, what to do next."""

import re
import shlex
from dataclasses import replace
from pathlib import Path

import pytest
from PIL import Image

import stylesplat as ss
from balls import CAMERAS, PLAIN, SPLATS, agreement
from capture_files import write_ball_capture
from processes import run
from stylesplat.figures.grid import CAPTION, GRID_MARGIN
from stylesplat.io.scene_folder import save
from stylesplat.selection.labels import render_labels


@pytest.fixture
def said(capsys: pytest.CaptureFixture[str]):
    """The lines that a command which succeeds says."""

    def said(*arguments: object) -> list[str]:
        capsys.readouterr()
        assert run(*arguments) == 0
        return capsys.readouterr().err.splitlines()

    return said


pytestmark = pytest.mark.usefixtures("quick_painting")
EXPORT = "stylesplat export"


def test_a_painted_scene_and_its_picture(styled: Path, said):
    with Image.open(styled / "before_after.png") as picture:
        assert picture.size == (2 * 48 + 3 * GRID_MARGIN, 36 + CAPTION + 2 * GRID_MARGIN)
    before = (styled / "before_after.png").read_bytes()
    lines = said("adjust", styled, "--intensity", 1)
    assert f"{styled}: 3 at 100 %, 7 at 100 % of the style." in lines
    assert any(x.startswith(f"Picture: {styled / 'before_after.png'} (view 000") for x in lines)
    assert f"Next: stylesplat export {styled} -o {styled}.ply" in lines
    assert (styled / "before_after.png").read_bytes() != before, "it is drawn anew"
    assert not any("Picture" in x for x in said("adjust", styled, "--intensity", 1, "--no-picture"))
    assert not (styled / "before_after.png").exists(), "it would show another strength"
    out = styled.with_name("plain")
    lines = said("adjust", styled, "--undo", "-o", out)
    assert lines == [f"{out}: as before it was painted.", f"Next: {EXPORT} {out} -o {out}.ply"]
    assert not (out / "before_after.png").exists()


def test_objects_names_nothing_twice(scene: Path, said):
    select = ("select", scene, "--no-picture", "--name")
    said(*select, "red", "--id", 3)
    said(*select, "both", "--id", 3, 7, "--keep-outliers")
    said(*select, "all red", "--id", 3, "--keep-outliers")
    said(*select, "barely red", "--id", 3, "--threshold", 1e-6)
    lines = said("objects", scene)
    assert f"Picture: {scene / 'objects.png'}" in lines and ", --box3d=" in lines[1]
    assert lines[-1].startswith(f"Next: stylesplat stylize {scene} --style red=")
    assert [re.sub(r"\d+ its own, --box3d.*|, --box3d.*", "", line) for line in lines[:-2]] == [
        "id 3, red, all red: 80 Gaussians, ",
        "id 7: 80 Gaussians, ",
        "id 300: 80 Gaussians, ",
        "both: 160 Gaussians",
        "barely red (id 3): 240 Gaussians",
        "all content",
    ]


def test_import_shows_a_photo_or_a_view(scene: Path, capture: Path, tmp_path: Path, said):
    splat = scene / "splats.ply"
    lines = said("import", splat, capture, "-o", tmp_path / "with photos", "--device", "cpu")
    assert any("dB from the photos" in line for line in lines)
    assert (tmp_path / "with photos" / "photo_and_render.png").is_file()
    assert lines[-2] == f"Next: stylesplat objects '{tmp_path / 'with photos'}'"
    lines = said("import", splat, "-o", tmp_path / "all alone", "--device", "cpu")
    assert (tmp_path / "all alone" / "view.png").is_file()
    start = "If it lies on its side: stylesplat "
    (again,) = (line.removeprefix(start) for line in lines if line.startswith(start))
    assert again.endswith(" --up z --overwrite")
    assert not any(line.startswith(start) for line in said(*shlex.split(again)))


def test_a_scene_of_photos_without_labels_names_a_click(scene: Path, tmp_path: Path, said):
    photos, out = write_ball_capture(tmp_path / "photos", masks=False), tmp_path / "out"
    save(replace(ss.open(scene), base=PLAIN), scene, overwrite=True)
    lines = said("import", scene / "splats.ply", photos, "-o", out, "--device", "cpu")
    look, click = (line[6:] for line in lines[-2:])
    assert click == f"stylesplat select {out} --name NAME --point VIEW:x,y"
    said(*shlex.split(look)[1:])
    view = CAMERAS.names[2]
    with Image.open(out.with_name("out-views") / view.replace("jpg", "png")) as picture:
        assert picture.size == CAMERAS[2].size, "pixels of what is looked at are those of a click"
    y, x = (render_labels(SPLATS, CAMERAS[2]) == 7).nonzero().median(dim=0).values.tolist()
    place = click.replace("VIEW:x,y", f"{view}:{x},{y}")
    said(*shlex.split(place)[1:], "--size", "part", "--no-picture")  # balls too coarse for objects
    assert agreement(ss.open(out).objects["NAME"].mask, 7) > 0.5
