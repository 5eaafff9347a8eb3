"""What was made is not lost because its place fails in the end."""

from pathlib import Path

import pytest

from balls import CAMERAS, SPLATS
from scenes import assert_same
from stylesplat.cli.results import save_or_rescue
from stylesplat.errors import StyleSplatError
from stylesplat.io.scene_folder import open, save
from stylesplat.scene.scene import Scene

SCENE = Scene(SPLATS, CAMERAS)


@pytest.fixture
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The temporary directory."""
    place = tmp_path / "elsewhere"
    place.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(place))
    return place


def test_in_its_place(tmp_path: Path, elsewhere: Path):
    save_or_rescue(SCENE, tmp_path / "scene", overwrite=False)
    assert (tmp_path / "scene" / "scene.json").is_file() and not [*elsewhere.iterdir()]


def test_in_the_temporary_directory(tmp_path: Path, elsewhere: Path):
    (tmp_path / "file").touch()
    with pytest.raises(StyleSplatError, match=r"Cannot write|is a file") as raised:
        save_or_rescue(SCENE, tmp_path / "file" / "garden", overwrite=False)
    (place,) = elsewhere.iterdir()
    assert f"The scene is in {place / 'garden'}: move it from there." in str(raised.value)
    save(SCENE, tmp_path / "straight")
    assert_same(open(place / "garden"), open(tmp_path / "straight"))


def test_nowhere(tmp_path: Path, elsewhere: Path, monkeypatch: pytest.MonkeyPatch):
    def refuse(*_: object, **__: object) -> None:
        raise StyleSplatError("disk full.")

    monkeypatch.setattr("stylesplat.io.scene_folder.save", refuse)
    with pytest.raises(StyleSplatError, match=r"^disk full\.$"):
        save_or_rescue(SCENE, tmp_path / "scene", overwrite=False)
    assert not [*elsewhere.iterdir()]
