"""Places that nothing can be written to are found before anything is made for them."""

import os
from pathlib import Path

import pytest

from stylesplat.errors import StyleSplatError
from stylesplat.io.folders import refuse_occupied
from stylesplat.io.places import refuse_file, refuse_unwritable
from unprivileged import as_nobody, public_folder

LONG = "a" * 250  # characters that a name may have, but not with a hidden one around it
needs_root = pytest.mark.skipif(os.getuid() != 0, reason="gives its rights away for a while")


@pytest.mark.parametrize("refuse", [refuse_unwritable, refuse_file])
def test_good_places_stay_as_they_are(refuse, tmp_path: Path):
    refuse(tmp_path / "new")
    refuse(tmp_path / "deep/er/new")
    refuse(tmp_path / "a name: with 'signs'.ply")
    assert not [*tmp_path.iterdir()]


def test_folders_that_are_there(tmp_path: Path):
    (tmp_path / "some/thing").mkdir(parents=True)
    refuse_unwritable(tmp_path / "some")
    refuse_unwritable(tmp_path / "some/thing/else")
    assert [*tmp_path.rglob("*")] == [tmp_path / "some", tmp_path / "some/thing"]


@pytest.mark.parametrize("refuse", [refuse_unwritable, refuse_file])
@pytest.mark.parametrize(
    ("place", "fault"),
    [
        ("file/scene", r"file is a file. Choose another folder"),
        ("file/deep/scene", r"file is a file. Choose another folder"),
        (LONG, r"File name too long. Choose a shorter name"),
        (f"new/{'b' * 300}/scene", r"File name too long. Choose a shorter name"),
    ],
)
def test_bad_places(refuse, place: str, fault: str, tmp_path: Path):
    (tmp_path / "file").touch()
    with pytest.raises(StyleSplatError, match=fault):
        refuse(tmp_path / place)
    assert [*tmp_path.iterdir()] == [tmp_path / "file"]


def test_what_is_of_the_other_kind(tmp_path: Path):
    (tmp_path / "file").touch()
    (tmp_path / "folder").mkdir()
    with pytest.raises(StyleSplatError, match=r"file is a file. Choose another name"):
        refuse_occupied(tmp_path / "file", marker="", overwrite=True)
    with pytest.raises(StyleSplatError, match=r"folder is a folder. Choose another name"):
        refuse_file(tmp_path / "folder", overwrite=True)
    with pytest.raises(StyleSplatError, match=r"file exists.*--overwrite.*overwrite=True"):
        refuse_file(tmp_path / "file")
    refuse_file(tmp_path / "file", overwrite=True)


@needs_root
def test_places_of_others():
    with public_folder() as folder:
        (folder / "own").mkdir()
        (folder / "own").chmod(0o777)
        (folder / "theirs").mkdir()
        with as_nobody():
            refuse_unwritable(folder / "own")  # nothing can be made beside it, but in it
            refuse_unwritable(folder / "own/new")
            for place in ("theirs", "theirs/new", "new"):
                with pytest.raises(StyleSplatError, match=r"denied. Choose a place that this"):
                    refuse_unwritable(folder / place)
            with pytest.raises(StyleSplatError, match="denied"):
                refuse_file(folder / "theirs/new.ply")
