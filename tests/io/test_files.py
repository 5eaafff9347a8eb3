import errno
import json
import os
from pathlib import Path
from string import ascii_lowercase, digits

import pytest

from stylesplat.errors import StyleSplatError
from stylesplat.io import folders
from stylesplat.io.files import atomic_path, file_stem
from stylesplat.io.folders import claim_directory, refuse_occupied
from stylesplat.io.json_files import read_json, write_json

MARKER = "scene.json"


def tree(folder: Path) -> dict[str, str]:
    return {
        p.relative_to(folder).as_posix(): p.read_text() for p in folder.rglob("*") if p.is_file()
    }


def fill(folder: Path, **files: str) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        (folder / name.replace("_", ".")).write_text(text)
    return folder


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path: Path):
    target = fill(tmp_path, a_txt="old") / "a.txt"
    with pytest.raises(KeyError), atomic_path(target) as temporary:
        temporary.write_text("half")
        raise KeyError
    assert tree(tmp_path) == {"a.txt": "old"}


def test_a_write_replaces_the_file_and_makes_folders(tmp_path: Path):
    for text in ("first", "second"):
        with atomic_path(tmp_path / "deep" / "a.txt") as temporary:
            assert temporary.parent == tmp_path / "deep" and temporary.suffix == ".txt"
            temporary.write_text(text)
    assert tree(tmp_path) == {"deep/a.txt": "second"}


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT])
def test_disk_full_is_said(tmp_path: Path, number: int):
    with (
        pytest.raises(StyleSplatError, match=r"a\.txt: disk full\. Free some space"),
        atomic_path(tmp_path / "a.txt"),
    ):
        raise OSError(number, "No space left")
    with (
        pytest.raises(StyleSplatError, match="scene: disk full"),
        claim_directory(tmp_path / "scene", overwrite=False, marker=MARKER) as folder,
    ):
        fill(folder, a_txt="half")
        raise OSError(number, "No space left")
    assert tree(tmp_path) == {}


def test_a_place_that_cannot_be_written_to(tmp_path: Path):
    fill(tmp_path, a_txt="a file")
    with (
        pytest.raises(
            StyleSplatError, match=r"Cannot write .*b\.txt: (File exists|Not a directory)"
        ),
        atomic_path(tmp_path / "a.txt" / "b.txt"),
    ):
        pass


@pytest.mark.parametrize("before", [None, {}])
def test_a_new_or_empty_folder_is_claimed(tmp_path: Path, before: dict[str, str] | None):
    target = tmp_path / "deep" / "scene"
    if before is not None:
        fill(target, **before)
    with claim_directory(target, overwrite=False, marker=MARKER) as folder:
        fill(folder, scene_json="new")
        assert not target.exists() or tree(target) == {}
    assert tree(tmp_path) == {"deep/scene/scene.json": "new"}


@pytest.mark.parametrize(
    ("name", "found"), [("note_txt", "something else"), ("scene_json", "an earlier result")]
)
def test_an_occupied_folder_needs_overwrite(tmp_path: Path, name: str, found: str):
    fill(tmp_path / "out", **{name: "old"})
    with (
        pytest.raises(StyleSplatError, match=rf"holds {found}.*`--overwrite`"),
        claim_directory(tmp_path / "out", overwrite=False, marker=MARKER),
    ):
        pytest.fail("the block must not run")
    assert tree(tmp_path / "out") == {name.replace("_", "."): "old"}


def test_overwrite_replaces_our_own_folder_as_a_whole(tmp_path: Path):
    target = fill(tmp_path / "out", scene_json="old", stale_txt="old")
    with claim_directory(target, overwrite=True, marker=MARKER) as folder:
        fill(folder, scene_json="new")
    assert tree(tmp_path) == {"out/scene.json": "new"}


def test_overwrite_keeps_the_other_files_of_a_foreign_folder(tmp_path: Path):
    target = fill(tmp_path / "home", thesis_txt="precious", a_txt="old")
    with claim_directory(target, overwrite=True, marker=MARKER) as folder:
        fill(folder, scene_json="new", a_txt="new")
    assert tree(tmp_path) == {
        "home/thesis.txt": "precious",
        "home/a.txt": "new",
        "home/scene.json": "new",
    }


def test_a_failed_overwrite_keeps_the_old_folder(tmp_path: Path):
    target = fill(tmp_path / "out", scene_json="old")
    with (
        pytest.raises(KeyboardInterrupt),
        claim_directory(target, overwrite=True, marker=MARKER) as folder,
    ):
        fill(folder, scene_json="half")
        raise KeyboardInterrupt
    assert tree(tmp_path) == {"out/scene.json": "old"}


def test_a_failed_swap_puts_the_old_folder_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    target = fill(tmp_path / "out", scene_json="old")
    rename, calls = Path.rename, []

    def second_fails(self: Path, to: Path) -> Path:
        calls.append(to)
        if len(calls) == 2:
            raise OSError(errno.EIO, "Input/output error")
        return rename(self, to)

    monkeypatch.setattr(Path, "rename", second_fails)
    monkeypatch.setattr(folders, "_exchanged", lambda one, other: False)
    with (
        pytest.raises(StyleSplatError, match="Input/output error"),
        claim_directory(target, overwrite=True, marker=MARKER) as folder,
    ):
        fill(folder, scene_json="new")
    assert len(calls) == 3 and tree(tmp_path) == {"out/scene.json": "old"}


@pytest.mark.parametrize("overwrite", [False, True])
def test_a_file_is_no_folder(tmp_path: Path, overwrite: bool):
    target = fill(tmp_path, out_txt="old") / "out.txt"
    with (
        pytest.raises(StyleSplatError, match=r"out\.txt is a file"),
        claim_directory(target, overwrite=overwrite, marker=MARKER),
    ):
        pytest.fail("the block must not run")
    assert tree(tmp_path) == {"out.txt": "old"}


def test_a_free_folder_is_not_refused(tmp_path: Path):
    refuse_occupied(tmp_path, marker=MARKER)
    refuse_occupied(tmp_path / "none", marker=MARKER)


def test_json_round_trip(tmp_path: Path):
    content = {"text": "ä", "list": [1, 0.1, None], "nested": {"yes": True}}
    write_json(content, tmp_path / "a.json")
    assert read_json(tmp_path / "a.json") == content


def test_json_is_strict(tmp_path: Path):
    write_json({"psnr": float("inf"), "list": (float("nan"),), "path": Path("a/b")}, tmp_path / "a")
    assert json.loads((tmp_path / "a").read_text()) == {"psnr": None, "list": [None], "path": "a/b"}


@pytest.mark.parametrize(
    ("text", "match"),
    [
        (None, "No such file"),
        ("{", "not valid JSON"),
        ("[1]", "expected a JSON object"),
        ("\xff", "not valid JSON"),
    ],
)
def test_bad_json(tmp_path: Path, text: str | None, match: str):
    if text is not None:
        (tmp_path / "a.json").write_bytes(text.encode("latin-1"))
    with pytest.raises(StyleSplatError, match=rf"Cannot read .*a\.json: .*{match}"):
        read_json(tmp_path / "a.json")


def test_file_stems_are_safe_and_differ():
    names = [
        "vase",
        "Vase",
        "VASE",
        "a/b",
        "a\\b",
        "a-b",
        "..",
        "",
        "\u00e9",
        "e\u0301",
        "x" * 48,
        "x" * 99,
    ]
    stems = [file_stem(name) for name in names]
    assert len({stem.lower() for stem in stems}) == len(names)
    assert stems[0] == "vase" and stems[5] == "a-b"
    for stem in stems:
        assert len(stem) < 80 and set(stem) <= set(ascii_lowercase + digits + "_-~")
        again = file_stem(stem)
        assert again == stem or again not in stems, "a name cannot be another's stem"


def test_a_file_is_on_the_disk_before_it_gets_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    done: list[str] = []
    fsync, replace = os.fsync, os.replace
    monkeypatch.setattr(os, "fsync", lambda file: (done.append("sync"), fsync(file)))
    monkeypatch.setattr(os, "replace", lambda *paths: (done.append("name"), replace(*paths)))
    with atomic_path(tmp_path / "a.txt") as temporary:
        temporary.write_text("new")
    assert done == ["sync", "name", "sync"], "the file, its name, its folder"


def test_a_disk_that_is_full_only_at_the_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    target = fill(tmp_path, a_txt="old") / "a.txt"

    def full(file: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with (
        pytest.raises(StyleSplatError, match=r"a\.txt: disk full\. Free some space"),
        atomic_path(target) as temporary,
    ):
        temporary.write_text("new")
    assert tree(tmp_path) == {"a.txt": "old"}
