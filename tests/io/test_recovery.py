"""What killed processes leave, and who finds it."""

import errno
import os
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from filelock import FileLock

from full_scenes import assert_same, contents, full_scene, plain_scene
from stylesplat.errors import StyleSplatError
from stylesplat.io import folders, journal, recovery, scene_folder
from stylesplat.io.captures.lens import Lens
from stylesplat.io.captures.photos import Photo
from stylesplat.io.folders import claim_directory
from stylesplat.io.journal import replace_files
from stylesplat.io.label_maps import match_label_maps, write_label_map
from stylesplat.io.recovery import changing, ensure_whole, settled

HEX = "0123456789ab"


def fill(folder: Path, **files: str) -> Path:
    for name, text in files.items():
        path = folder / name.replace("__", "/").replace("_", ".")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return folder


def texts(folder: Path) -> dict[str, str]:
    return {name: each.decode() for name, each in contents(folder).items()}


def begun(folder: Path, monkeypatch: pytest.MonkeyPatch, **files: str) -> Path:
    """A folder whose change was decided, and not one file of it done."""
    new = fill(folder.with_name("new"), **files)
    with monkeypatch.context() as patch:
        patch.setattr(journal, "finish", lambda path: None)
        replace_files(folder, new, [Path("old.txt")])
    return folder


def test_what_was_moved_away_is_put_back(tmp_path: Path, said: list[str]):
    fill(tmp_path / f".scene.{HEX}.old", scene_json="old")
    fill(tmp_path / f".scene.{HEX}.new", scene_json="half")
    with changing(tmp_path / "scene"):
        assert texts(tmp_path / "scene") == {"scene.json": "old"}
    assert [path.name for path in tmp_path.iterdir()] == ["scene"]
    assert len(said) == 2 and "back, which a process" in said[0] and "Removed 1" in said[1]


def test_leftovers_go_and_nothing_else(tmp_path: Path, said: list[str]):
    scene = fill(tmp_path / "scene", scene_json="it", splats_ply="it")
    ours = [
        f".scene.{HEX}.new/a",
        f".scene.{HEX}.old/a",
        f".scene.{HEX}/a",  # as earlier versions called both
        f"scene/.splats.{HEX}.ply",
        f"scene/.replacing.{HEX}/files/a",
    ]
    others = [
        f".scenery.{HEX}.new/a",
        ".scene.new/a",
        ".scene.012345.new/a",
        f".scene.{HEX}.backup/a",
        f"scene/.{HEX}",
        f"scene/.config.{HEX}.ply",
        f"scene/sub/.splats.{HEX}.ply",
        "scene/.replacing.mine/a",
    ]
    for name in (*ours, *others):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    with changing(scene):
        assert (tmp_path / ".scene.lock").exists()
    assert {*contents(tmp_path)} == {"scene/scene.json", "scene/splats.ply", *others}
    assert len(said) == 1 and said[0].startswith("Removed 5 ")


def test_without_a_lock_nothing_is_known_to_be_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """Another process may be writing it."""

    def acquire(*_: object, **__: object) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(FileLock, "acquire", acquire)
    fill(tmp_path / "scene", scene_json="it")
    fill(tmp_path / f".scene.{HEX}.new", scene_json="draft")
    before = texts(tmp_path)
    with changing(tmp_path / "scene"):
        pass
    assert texts(tmp_path) == before


def test_a_lone_folder_of_an_earlier_version_stays(tmp_path: Path):
    """Nobody knows whether it is the old or the new."""
    fill(tmp_path / f".scene.{HEX}", scene_json="it")
    with changing(tmp_path / "scene"):
        pass
    assert texts(tmp_path) == {f".scene.{HEX}/scene.json": "it"}


def test_readers_finish_what_was_begun(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, said: list[str]
):
    folder = begun(
        fill(tmp_path / "f", a_txt="1", old_txt="1", b_txt="1"),
        monkeypatch,
        a_txt="2",
        sub__c_txt="2",
    )
    assert texts(folder)["a.txt"] == "1"
    ensure_whole(folder)
    assert texts(folder) == {"a.txt": "2", "b.txt": "1", "sub/c.txt": "2"}
    assert len(said) == 1 and said[0].startswith(f"Finished the change of {folder}")


def test_a_scene_is_finished_by_who_opens_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    scene_folder.save(full_scene(), tmp_path / "scene")
    monkeypatch.setattr(folders, "_has_room_beside", lambda path: False)
    with monkeypatch.context() as patch:
        patch.setattr(journal, "finish", lambda path: None)
        scene_folder.save(plain_scene(), tmp_path / "scene", overwrite=True)
    assert (tmp_path / "scene" / "recipe.json").exists()
    assert_same(scene_folder.open(tmp_path / "scene"), plain_scene())
    assert not (tmp_path / "scene" / "recipe.json").exists()


def test_a_scene_that_was_moved_away_is_opened(tmp_path: Path):
    scene_folder.save(full_scene(), tmp_path / "scene")
    (tmp_path / "scene").rename(tmp_path / f".scene.{HEX}.old")
    assert_same(scene_folder.open(tmp_path / "scene"), full_scene())


def test_label_maps_are_finished_by_who_reads_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    import torch

    for folder, id in (("maps", 1), ("new", 2)):
        write_label_map(torch.full((4, 4), id), tmp_path / folder / "a.png")
    begun(tmp_path / "maps", monkeypatch)
    lens = Lens("PINHOLE", 4, 4, (1.0, 1.0, 2.0, 2.0))
    (labels,) = match_label_maps(tmp_path / "maps", ["a.jpg"], [Photo(Path(), True, lens, (4, 4))])
    assert labels is not None and labels.unique().tolist() == [2]


def test_who_may_not_finish_it_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    folder = begun(fill(tmp_path / "f", a_txt="1"), monkeypatch, a_txt="2")
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    with pytest.raises(StyleSplatError, match=r"f is half changed: .* Let somebody open it who"):
        ensure_whole(folder)


def test_nothing_is_written_through_a_link_that_leads_outside(tmp_path: Path):
    victim, folder = fill(tmp_path / "victim", a_txt="precious"), fill(tmp_path / "f", b_txt="1")
    (folder / "sub").symlink_to(victim)
    with (
        pytest.raises(StyleSplatError, match=r"a\.txt: .*sub leads outside .*f\. Remove it"),
        claim_directory(folder, overwrite=True, marker="") as new,
    ):
        fill(new, sub__a_txt="2", b_txt="2")
    assert texts(victim) == {"a.txt": "precious"} and (folder / "b.txt").read_text() == "1"
    assert sorted(path.name for path in folder.iterdir()) == ["b.txt", "sub"]


def test_a_file_does_not_replace_a_folder(tmp_path: Path):
    folder = fill(tmp_path / "f", a__b_txt="1")
    for name in ("a", "a__b_txt__c_txt"):
        with (
            pytest.raises(StyleSplatError, match=r"is in the way\. Move it elsewhere"),
            claim_directory(folder, overwrite=True, marker="") as new,
        ):
            fill(new, **{name: "2"})
    assert texts(tmp_path) == {"f/a/b.txt": "1"}


HOSTILE: list[Callable[[Path, Path], object]] = [
    lambda folder, victim: (folder / ".replacing").symlink_to(victim),
    lambda folder, victim: link(folder / ".replacing" / "files", victim / "files"),
    lambda folder, victim: [
        (folder / "sub").symlink_to(victim),
        fill(folder / ".replacing" / "gone" / "sub", a_txt=""),
    ],
    lambda folder, victim: [
        (folder / "sub").symlink_to(victim),
        fill(folder / ".replacing" / "files" / "sub", a_txt="2"),
    ],
]


def link(path: Path, target: Path) -> None:
    path.parent.mkdir(parents=True)
    path.symlink_to(target)


@pytest.mark.parametrize("prepare", HOSTILE)
def test_a_stranger_s_journal_changes_nothing_outside(
    prepare: Callable[[Path, Path], object], tmp_path: Path
):
    victim = fill(tmp_path / "victim", a_txt="precious", files__a_txt="precious")
    folder = fill(tmp_path / "f", b_txt="1")
    prepare(folder, victim)
    with pytest.raises(StyleSplatError, match=r"Remove it\."):
        ensure_whole(folder)
    assert texts(victim) == {"a.txt": "precious", "files/a.txt": "precious"}


def test_links_stay_links(tmp_path: Path):
    scene_folder.save(full_scene(), tmp_path / "scene")
    (tmp_path / "scene" / "photos").symlink_to(tmp_path)
    (tmp_path / "scene" / "gone").symlink_to("nowhere")
    scene = scene_folder.open(tmp_path / "scene")
    scene_folder.revise(scene, replace(scene, metrics={}), tmp_path / "scene")
    assert (tmp_path / "scene" / "photos").readlink() == tmp_path
    assert (tmp_path / "scene" / "gone").readlink() == Path("nowhere")


@pytest.mark.parametrize("swap", [True, False], ids=["swapped", "file by file"])
def test_a_reader_never_mixes_two_states(
    swap: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    folder = tmp_path / "scene"
    scene_folder.save(full_scene(), folder)
    monkeypatch.setattr(folders, "_has_room_beside", lambda path: swap)
    read, times = scene_folder.read_cameras, 0

    def meanwhile(path: Path):
        nonlocal times
        times += 1
        if times == 1:  # another process, after splats and before objects are read
            scene_folder.save(plain_scene(), folder, overwrite=True)
        return read(path)

    monkeypatch.setattr(scene_folder, "read_cameras", meanwhile)
    assert_same(scene_folder.open(folder), plain_scene())
    assert times == 2


def test_what_never_rests_is_not_read_for_ever(tmp_path: Path):
    folder, times = fill(tmp_path / "f", a_txt="1"), []

    def read(path: Path) -> None:
        times.append(path)
        (path / str(len(times))).touch()
        os.utime(path, ns=(len(times), len(times)))

    with pytest.raises(StyleSplatError, match="was changed all 5 times"):
        settled(folder, read)
    assert len(times) == recovery.ATTEMPTS == 5


def test_readers_wait_for_who_is_at_it(tmp_path: Path):
    """Between two renames there is no folder, which is not the end of it."""
    fill(tmp_path / f".f.{HEX}.old", a_txt="1")
    entered, leave = threading.Event(), threading.Event()

    def writer() -> None:
        with recovery.locked(tmp_path / "f"):
            entered.set()
            leave.wait(5)
            (tmp_path / f".f.{HEX}.old").rename(tmp_path / "f")

    thread = threading.Thread(target=writer)
    thread.start()
    entered.wait(5)
    threading.Timer(0.2, leave.set).start()
    assert settled(tmp_path / "f", texts) == {"a.txt": "1"}
    thread.join()
