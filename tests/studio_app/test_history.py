"""A history that outlives its studio: steps, snapshots, bounds, damage."""

import signal
import subprocess
import sys
import textwrap
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from balls import CAMERAS, SPLATS
from processes import LIMIT
from stylesplat.io.scene_folder import open, revise, save
from stylesplat.scene.scene import Scene
from stylesplat.scene.splats import Splats
from stylesplat.studio_app import history, history_files
from stylesplat.studio_app.edits import adjust_layer, recolor_objects, remove_rows
from stylesplat.studio_app.history_files import HISTORY, HISTORY_INDEX, MOST_HISTORY_BYTES, NEAR
from stylesplat.studio_app.selecting import feather_picked, pick_names, rename_picked
from stylesplat.studio_app.session import Change, Session
from stylesplat.studio_app.studio import StudioServer, studio
from stylesplat.verbs.adjust import adjust


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    save(Scene(SPLATS, CAMERAS), tmp_path / "balls")
    return tmp_path / "balls"


@contextmanager
def opened(folder: Path) -> Iterator[StudioServer]:
    found = studio(folder, port=0, block=False)
    try:
        yield found
    finally:
        found.close()


def do(session: Session, *changes: Change) -> None:
    for change in changes:
        session.do(change)
    assert session.worker.wait_until_idle()


def red(state: history.StudioState) -> history.StudioState:
    return rename_picked(pick_names(state, ["3"]), "red")


def hue(value: float, name: str = "7") -> Change:
    return lambda state: recolor_objects(state, [name], "hue", value)


def removed(state: history.StudioState) -> history.StudioState:
    weights = torch.linspace(0, 1, len(state.scene.base))
    return remove_rows(state, "3", weights, "Removed a part")


def notes(session: Session) -> list[str]:
    return [each.note for each in session.history.steps]


def same(one: Splats, other: Splats) -> bool:
    pairs = zip(one.tensors().values(), other.tensors().values(), strict=True)
    return len(one) == len(other) and all(torch.equal(*pair) for pair in pairs)


def test_all_steps_and_snapshots_are_there_after_a_restart_to_the_bit(folder: Path):
    shown = list[Splats]()
    with opened(folder) as first:
        session = first.session
        for change in (red, hue(40), removed, lambda state: feather_picked(state, 0.2)):
            do(session, change)
            shown.append(session.state.scene.splats)
        assert session.state.selection is not None
        weights = session.state.selection.weights
        session.ask(lambda: session.history.keep_snapshot("first"))
        session.step(-2)
        assert session.worker.wait_until_idle()
        before = notes(session)
    with opened(folder) as again:
        session = again.session
        assert notes(session) == before and session.state.note == "Recoloured 7: hue 40"
        assert [each.note for each in session.history.snapshots] == ["first"]
        assert same(session.state.scene.splats, shown[1])
        session.step(2)
        assert session.worker.wait_until_idle() and session.state.selection is not None
        assert torch.equal(session.state.selection.weights, weights)
        for number, wanted in zip(range(2, 6), shown, strict=True):
            session.go_to(number)
            assert session.worker.wait_until_idle()
            assert same(session.state.scene.splats, wanted)
        session.go_to(1)
        assert session.worker.wait_until_idle() and not session.unsaved
        (kept,) = session.history.snapshots
        assert session.history.state_of(kept).scene.layers[-1].kind == "edit"


def test_a_killed_studio_loses_the_last_second_at_most(folder: Path, said: list[str]):
    program = f"""
        import sys, time
        from stylesplat.studio_app.edits import recolor_objects
        from stylesplat.studio_app.studio import studio
        session = studio({str(folder)!r}, port=0, block=False).session
        session.do(lambda state: recolor_objects(state, ["7"], "hue", 40.0))
        session.worker.wait_until_idle()
        time.sleep(1.0)
        print("done", flush=True)
        session.worker.wait_until_idle()
        time.sleep({LIMIT})
    """
    command = [sys.executable, "-c", textwrap.dedent(program)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    assert process.stdout is not None
    assert process.stdout.readline() == b"done\n"
    process.send_signal(signal.SIGKILL)
    process.communicate()
    with opened(folder) as again:
        assert again.session.state.note == "Recoloured 7: hue 40" and again.session.unsaved
        assert "Recovered" in said[-1]


def test_what_was_saved_is_not_unsaved_and_what_others_changed_is_a_step(folder: Path):
    with opened(folder) as first:
        do(first.session, red, hue(40))
        assert first.store is not None
        first.store.save()
        do(first.session, hue(80))
    with opened(folder) as again:
        assert again.session.unsaved
        again.session.step(-1)
        assert again.session.worker.wait_until_idle() and not again.session.unsaved
        again.session.step(1)
        assert again.session.worker.wait_until_idle() and again.session.unsaved
    before = open(folder)
    revise(before, adjust(before, 0.2, objects="7/recolor"), folder)
    with opened(folder) as last:
        session = last.session
        assert notes(session)[-2:] == ["Recoloured 7: hue 80", "Opened"]
        assert session.state.scene.layers[0].strength == 0.2 and not session.unsaved
        session.step(-1)
        assert session.worker.wait_until_idle()
        assert session.state.scene.layers[0].settings["hue"] == 80


def truncated(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-20])


@pytest.mark.parametrize(
    "damage",
    [truncated, lambda path: path.write_text("[]"), lambda path: path.write_bytes(b"\xff")],
)
def test_a_damaged_history_is_told_and_moved_aside(
    folder: Path, said: list[str], damage: Callable[[Path], object]
):
    with opened(folder) as first:
        do(first.session, red)
    damage(folder / HISTORY / HISTORY_INDEX)
    content = (folder / HISTORY / HISTORY_INDEX).read_bytes()
    with opened(folder) as again:
        assert not again.session.unsaved and notes(again.session) == ["Opened"]
        assert HISTORY_INDEX in said[-1] and f"{HISTORY}.1" in said[-1]
        do(again.session, red)
    assert (folder / f"{HISTORY}.1" / HISTORY_INDEX).read_bytes() == content
    with opened(folder) as last:
        assert notes(last.session) == ["Opened", "Named 3 red"]


def test_a_step_whose_file_is_lost_is_left_out_and_one_that_is_damaged_is_told(
    folder: Path, said: list[str]
):
    with opened(folder) as first:
        do(first.session, hue(40), removed, hue(80))
    files = {path.stat().st_size: path for path in (folder / HISTORY / "layers").iterdir()}
    content = files[max(files)].read_bytes()  # of what was removed
    files[max(files)].write_bytes(content[:-8])
    with opened(folder) as again:
        session = again.session
        assert "Cannot read" in said[-1] and session.state.note == "Opened"
        session.go_to(2)
        assert session.worker.wait_until_idle() and session.state.note == "Recoloured 7: hue 40"
        failures = list[str]()
        session.on_message.append(lambda line, *_: failures.append(line))
        session.go_to(3)
        assert session.worker.wait_until_idle()
        assert "Cannot read" in failures[-1] and session.state.note == "Recoloured 7: hue 40"
    files[max(files)].unlink()
    with opened(folder) as last:
        assert any("is missing" in line for line in said)
        assert "Removed a part" not in notes(last.session)
        assert last.session.state.note == "Recoloured 7: hue 40"


def test_a_history_of_other_gaussians_is_moved_aside(folder: Path, said: list[str]):
    with opened(folder) as first:
        do(first.session, red)
    kept = folder.parent / "kept"
    (folder / HISTORY).rename(kept)
    save(Scene(replace(SPLATS, sh0=SPLATS.sh0 + 1), CAMERAS), folder, overwrite=True)
    kept.rename(folder / HISTORY)
    with opened(folder) as again:
        assert "other Gaussians" in said[-1] and not again.session.unsaved


def test_files_are_bounded_and_shared(folder: Path, monkeypatch: pytest.MonkeyPatch):
    def names() -> list[str]:
        return sorted(path.name for path in (folder / HISTORY).glob("layers/*"))

    with opened(folder) as first:
        session = first.session
        do(session, hue(40))
        for strength in torch.linspace(0.1, 0.9, 2 * NEAR).tolist():
            do(session, lambda state, s=strength: adjust_layer(state, "7/recolor", s))
        assert first.kept is not None
        session.ask(first.kept.write)
        assert session.worker.wait_until_idle() and len(names()) == 1, "one file for all strengths"
        assert session.history.steps[1].kept is None, "what is far takes no memory"
        session.go_to(2)
        assert session.worker.wait_until_idle()
        assert session.state.scene.layers[0].strength == 1.0
        session.step(2 * NEAR)
        do(session, removed)
        session.ask(first.kept.write)
        assert session.worker.wait_until_idle()
        size = sum(path.stat().st_size for path in (folder / HISTORY).glob("*/*"))
        monkeypatch.setattr(history_files, "MOST_HISTORY_BYTES", size + 1000)
        assert MOST_HISTORY_BYTES > 1000 * size
        do(session, hue(80), hue(120), removed)
        session.ask(first.kept.write)
        assert session.worker.wait_until_idle()
        assert len(session.history.steps) < 4 and session.state.note == "Removed a part"
        own = sum(path.stat().st_size for path in (folder / HISTORY).glob("*/*"))
        assert own < size + 1000
    with opened(folder) as again:
        assert again.session.state.note == "Removed a part"


def test_the_oldest_steps_make_room(session: Session):
    for number in range(history.MOST_STEPS + 5):
        session.history.add(replace(session.state, note=str(number)))
    assert len(session.history.steps) == history.MOST_STEPS
    assert notes(session)[0] == "5" and notes(session)[-1] == session.state.note
    for number in range(history.MOST_SNAPSHOTS):
        session.history.keep_snapshot(str(number))
    with pytest.raises(Exception, match="Delete one first"):
        session.history.keep_snapshot("more")


def test_another_studio_of_the_same_scene_overwrites_nothing(folder: Path, said: list[str]):
    with opened(folder) as first:
        with opened(folder) as second:
            do(second.session, red)
        content = (folder / HISTORY / HISTORY_INDEX).read_bytes()
        do(first.session, hue(40))
    assert "Another studio has written" in said[-1]
    assert (folder / HISTORY / HISTORY_INDEX).read_bytes() == content


def test_a_scene_saved_elsewhere_takes_its_history_along(folder: Path):
    with opened(folder) as first:
        do(first.session, red)
        first.session.worker.ask(lambda: first.server.actions.save_as("other"))
        assert first.session.worker.wait_until_idle()
        do(first.session, hue(40))
    assert not (folder / HISTORY).exists()
    with opened(folder.with_name("other")) as again:
        assert notes(again.session) == ["Opened", "Named 3 red", "Recoloured 7: hue 40"]
        assert again.session.unsaved
