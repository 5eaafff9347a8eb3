"""Files and folders are written whole or not at all, by one process at a time."""

import errno
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

import pytest
from filelock import FileLock

from processes import needs_permissions, read_only
from stylesplat.errors import StyleSplatError
from stylesplat.io import atomic
from stylesplat.io.atomic import (
    atomic_folder,
    atomic_path,
    locked_folder,
    refuse_file,
    refuse_unwritable,
    revise_folder,
)

MARKER = "scene.json"
Writer = Callable[[Path], AbstractContextManager[Path]]


def claim(path: Path) -> AbstractContextManager[Path]:
    return atomic_folder(path, overwrite=True, marker=MARKER)


def fill(folder: Path, **files: str) -> Path:
    """Files by name, in which `_` stands for a dot and `__` for a slash."""
    for name, text in files.items():
        path = folder / name.replace("__", "/").replace("_", ".")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return folder


def tree(folder: Path) -> dict[str, str]:
    files = (p for p in folder.rglob("*") if p.is_file() and not p.is_symlink())
    return {p.relative_to(folder).as_posix(): p.read_text() for p in files}


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_a_write_replaces_the_file_and_makes_folders(tmp_path: Path):
    for text in ("first", "second"):
        with atomic_path(tmp_path / "deep" / "a.txt") as draft:
            assert draft.parent == tmp_path / "deep" and draft.suffix == ".txt"
            draft.write_text(text)
    assert tree(tmp_path) == {"deep/a.txt": "second"}


@pytest.mark.parametrize("error", [KeyError, KeyboardInterrupt])
def test_a_failed_write_changes_nothing(error: type[BaseException], tmp_path: Path):
    fill(tmp_path, a_txt="old", out__scene_json="old")
    with pytest.raises(error), atomic_path(tmp_path / "a.txt") as draft:
        draft.write_text("half")
        raise error
    for writer in (claim, revise_folder):
        with pytest.raises(error), writer(tmp_path / "out") as draft:
            fill(draft, b_txt="half")
            raise error
    assert tree(tmp_path) == {"a.txt": "old", "out/scene.json": "old"}


@pytest.mark.parametrize("writer", [atomic_path, claim])
def test_a_full_disk_has_a_message(writer: Writer, tmp_path: Path):
    with (
        pytest.raises(StyleSplatError, match=r"out: disk full\. Free some"),
        writer(tmp_path / "out"),
    ):
        raise OSError(errno.ENOSPC, "No space left")
    assert tree(tmp_path) == {}


@pytest.mark.parametrize("exists", [False, True])
def test_a_new_or_empty_folder(exists: bool, tmp_path: Path):
    target = tmp_path / "deep" / "scene"
    if exists:
        target.mkdir(parents=True)
    with atomic_folder(target, overwrite=False, marker=MARKER) as draft:
        fill(draft, scene_json="new")
        assert not target.exists() or tree(target) == {}
    assert tree(tmp_path) == {"deep/scene/scene.json": "new"}


@pytest.mark.parametrize(
    ("name", "found"), [("note_txt", "something else"), ("scene_json", "an earlier result")]
)
def test_an_occupied_folder_needs_overwrite(name: str, found: str, tmp_path: Path):
    fill(tmp_path / "out", **{name: "old"})
    with (
        pytest.raises(StyleSplatError, match=rf"holds {found}.*`--overwrite`"),
        atomic_folder(tmp_path / "out", overwrite=False, marker=MARKER),
    ):
        pytest.fail("the block must not run")
    assert list(tree(tmp_path / "out").values()) == ["old"]


@pytest.mark.parametrize("exchange", [True, False])
@pytest.mark.parametrize("inside", [True, False])
def test_overwrite_replaces_our_own_folder_as_a_whole(
    exchange: bool, inside: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    target = fill(tmp_path / "out", scene_json="old", stale_txt="old", sub__stale_txt="old")
    if not exchange:  # where the system cannot swap two names
        monkeypatch.setattr(atomic, "_exchange", lambda one, other: False)
    if inside:  # where the shell stands in the folder, which therefore has to stay
        monkeypatch.chdir(target)
    inode = target.stat().st_ino
    with claim(target) as draft:
        fill(draft, scene_json="new", more__b_txt="new")
    assert tree(tmp_path) == {"out/scene.json": "new", "out/more/b.txt": "new"}
    assert inside == (target.stat().st_ino == inode)


def test_overwrite_keeps_the_other_files_of_a_foreign_folder(tmp_path: Path):
    target = fill(tmp_path / "home", thesis_txt="precious", a_txt="old", sub__gone_txt="old")
    stale = ["sub/gone.txt", "never.txt"]
    with atomic_folder(target, overwrite=True, marker=MARKER, stale=stale) as draft:
        fill(draft, scene_json="new", a_txt="new")
    assert tree(target) == {"thesis.txt": "precious", "a.txt": "new", "scene.json": "new"}
    assert names(tmp_path) == ["home"] and not (target / "sub").exists()


@pytest.mark.parametrize("name", ["a", "a__b_txt__c_txt", "sub__a_txt"])
def test_what_is_in_the_way_stays(name: str, tmp_path: Path):
    """A folder where a file should be, a file where a folder should be, a link to elsewhere."""
    victim, folder = fill(tmp_path / "victim", a_txt="precious"), fill(tmp_path / "f", a__b_txt="1")
    (folder / "sub").symlink_to(victim)
    with (
        pytest.raises(StyleSplatError, match=r"is in the way\. Move it elsewhere"),
        claim(folder) as draft,
    ):
        fill(draft, **{"0_txt": "2", name: "2"})
    assert tree(victim) == {"a.txt": "precious"} and tree(folder) == {"a/b.txt": "1"}
    assert names(folder) == ["a", "sub"]


@pytest.mark.parametrize("inside", [True, False])
def test_a_revision_keeps_links_and_what_it_does_not_change(
    inside: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    folder = fill(tmp_path / "scene", a_txt="1", b_txt="1", sub__c_txt="1")
    (folder / "photos").symlink_to(tmp_path)
    (folder / "gone").symlink_to("nowhere")
    if inside:
        monkeypatch.chdir(folder)
    inode = (folder / "a.txt").stat().st_ino
    with revise_folder(folder) as draft, atomic_path(draft / "b.txt") as file:
        file.write_text("2")
        (draft / "sub" / "c.txt").unlink()
    assert tree(folder) == {"a.txt": "1", "b.txt": "2"}
    assert (folder / "a.txt").stat().st_ino == inode and (folder / "a.txt").stat().st_nlink == 1
    assert (folder / "photos").readlink() == tmp_path
    assert (folder / "gone").readlink() == Path("nowhere")
    assert names(tmp_path) == ["scene"]


@needs_permissions
def test_places_of_others(tmp_path: Path):
    (tmp_path / "own").mkdir()
    (tmp_path / "theirs").mkdir()
    with read_only(tmp_path, tmp_path / "theirs"):
        refuse_unwritable(tmp_path / "own")  # nothing can be made beside it, but in it
        refuse_unwritable(tmp_path / "own/new")
        for place in ("theirs", "theirs/new", "new"):
            with pytest.raises(StyleSplatError, match=r"denied. Choose a place that this"):
                refuse_unwritable(tmp_path / place)
        with pytest.raises(StyleSplatError, match="denied"):
            refuse_file(tmp_path / "theirs/new.ply")


def test_a_lock_lies_beside_and_goes(tmp_path: Path):
    with locked_folder(tmp_path / "scene"):
        assert names(tmp_path) == [".scene.lock"]
        with locked_folder(tmp_path / "x" / ".." / "scene"):
            assert names(tmp_path) == [".scene.lock"]
        assert names(tmp_path) == [".scene.lock"], "the inner one does not give it back"
    with locked_folder(tmp_path / "a" / "b" / "scene"):
        assert names(tmp_path / "a" / "b") == [".scene.lock"]
        (tmp_path / "a" / "kept").touch()
    assert names(tmp_path / "a") == ["kept"]


def test_another_process_is_waited_for_and_then_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, said: list[str]
):
    monkeypatch.setattr(atomic, "ATOMIC_PATIENCE", 0.1)
    with (
        FileLock(tmp_path / ".scene.lock"),  # another lock of the same file, as of a process
        pytest.raises(StyleSplatError, match=r"scene: another stylesplat is at work on it"),
        locked_folder(tmp_path / "scene"),
    ):
        pytest.fail("the block must not run")
    assert said == [f"Waiting for another stylesplat that changes {tmp_path / 'scene'}."]
    with locked_folder(tmp_path / "scene"):
        pass
    assert names(tmp_path) == [] and len(said) == 1


def test_without_locks_it_goes_on_and_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, said: list[str]
):
    def acquire(*_: object, **__: object) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(FileLock, "acquire", acquire)
    for _ in range(2):
        with locked_folder(tmp_path / "scene"):
            pass
    assert len(said) == 1 and said[0].startswith(f"{tmp_path} is on a file system without locks")


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="there is no such file system")
def test_a_folder_that_takes_no_files_is_not_taken_for_one_at_work():
    with pytest.raises(StyleSplatError, match=r"Cannot write /proc/out\.ply") as refused:
        with locked_folder(Path("/proc/out.ply")), atomic_path(Path("/proc/out.ply")) as draft:
            draft.touch()
    assert "another stylesplat" not in str(refused.value)
