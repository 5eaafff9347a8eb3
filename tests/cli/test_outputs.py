"""Where nothing can be written is said before the work, whatever the verb."""

from importlib import import_module
from pathlib import Path

import pytest

from processes import complaint, needs_permissions, read_only

LONG = "a" * 250  # characters that a file's name may have, but not with what it has meanwhile
WORK = (
    "stylesplat.train",
    "stylesplat.stylize",
    "stylesplat.import_",
    "stylesplat.render",
    "stylesplat.verbs.sheet.sheet",
    "stylesplat.adjust",
    "stylesplat.mask",
    "stylesplat.check",
    "stylesplat.select",
    "stylesplat.export",
    "stylesplat.evaluate",
    "stylesplat.verbs.sfm.prepare",
    "stylesplat.figures.sheets.object_sheet",
    "stylesplat.demo.demo_run.copy_capture",
)
CALLS = {
    "train": ("train", "{capture}", "-o", "{out}"),
    "stylize": ("stylize", "{scene}", "--style", "3={style}", "-o", "{out}"),
    "import": ("import", "{scene}/splats.ply", "{capture}", "-o", "{out}"),
    "render": ("render", "{scene}", "-o", "{out}"),
    "adjust": ("adjust", "{scene}", "--intensity", "0.5", "-o", "{out}"),
    "sfm": ("sfm", "{capture}/images", "-o", "{out}"),
    "demo": ("demo", "-o", "{out}"),
    "video": ("render", "{scene}", "-o", "{out}.mp4"),
    "sheet": ("sheet", "{scene}", "--style", "3={style}", "-o", "{out}.png"),
    "check": ("check", "{capture}", "-o", "{out}.png"),
    "export": ("export", "{scene}", "{out}.ply"),
}
INTO_SCENES = {
    "select": ("select", "{scene}", "--name", "x", "--id", "3"),
    "objects": ("objects", "{scene}"),
    "evaluate": ("evaluate", "{scene}", "--capture", "{capture}"),
}


@pytest.fixture
def no_work(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object, **__: object) -> None:
        raise AssertionError("work has begun")

    for function in WORK:  # all first: what is loaded later would keep what it finds patched
        import_module(function.rpartition(".")[0])
    for function in WORK:
        monkeypatch.setattr(function, fail)


@pytest.mark.parametrize("verb", CALLS)
def test_outputs(
    verb: str, capture: Path, scene: Path, style: Path, tmp_path: Path, no_work: None, capsys
):
    (tmp_path / "file").touch()
    (tmp_path / "taken").touch()  # where a folder should be
    for suffix in (".mp4", ".png", ".ply"):
        (tmp_path / f"taken{suffix}").mkdir()  # where a file should be
    before = {*tmp_path.rglob("*")}
    places = {"scene": scene, "style": style, "capture": capture}
    for name, expected in (
        ("file/new", f"{tmp_path}/file is a file. Choose another folder."),
        (LONG, "File name too long. Choose a shorter name."),
        ("taken", "Choose another name"),
    ):
        call = [part.format(**places, out=tmp_path / name) for part in CALLS[verb]]
        assert expected in complaint(capsys, *call)
        assert {*tmp_path.rglob("*")} == before


@needs_permissions
@pytest.mark.parametrize("verb", [*CALLS, *INTO_SCENES])
def test_places_of_others(
    verb: str, capture: Path, scene: Path, style: Path, tmp_path: Path, no_work: None, capsys
):
    places = {"scene": scene, "style": style, "capture": capture, "out": tmp_path / "new"}
    arguments = [part.format(**places) for part in (CALLS | INTO_SCENES)[verb]]
    with read_only(tmp_path, scene):
        line = complaint(capsys, *arguments)
    assert "Permission denied. Choose a place that this user may write to." in line
    assert not (tmp_path / "new").exists()
