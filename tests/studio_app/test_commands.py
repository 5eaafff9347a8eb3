import shlex
from pathlib import Path

from PIL import Image

from browser import QUICK, stripes
from stylesplat.figures.pictures import to_uint8
from stylesplat.io.scene_folder import open
from stylesplat.studio_app.autosave import SceneStore
from stylesplat.studio_app.commands import command_lines, commands_text
from stylesplat.studio_app.history import StudioState
from stylesplat.studio_app.layers import remove_paint
from stylesplat.studio_app.paint_queue import PaintQueue
from stylesplat.studio_app.picking import pick_names, rename_picked
from stylesplat.studio_app.session import Session
from stylesplat.stylization.style import Style


def painted(session: Session, name: str, picture: Path) -> None:
    PaintQueue(session, device="cpu").paint((name,), Style(picture, config=QUICK), "stripes")
    assert session.worker.settle()


def test_after_save_as_the_commands_start_from_what_is_saved(session: Session, tmp_path: Path):
    picture = tmp_path / "stripes.png"
    Image.fromarray(to_uint8(stripes()).numpy()).save(picture)
    store, first = SceneStore(session.folder), session.folder
    held = {first: session.saved}
    session.do(lambda state: rename_picked(pick_names(state, ["3"]), "red"))
    painted(session, "red", picture)
    store.save_as(session, "elsewhere")
    held[store.folder] = session.saved
    told = commands_text(session.state, store.folder, held).splitlines()
    assert told[0] == f"# {store.folder} holds all of this"
    assert f"select {first}" in told[1], "and this is how it came about"
    painted(session, "7", picture)
    assert "red" not in commands_text(session.state, store.folder, held), "that is saved"
    out = tmp_path / "out"
    lines = command_lines(session.state, store.folder, out, held[store.folder])
    assert lines is not None and len(lines) == 1
    (line,) = lines
    words = ["stylesplat", "stylize", str(store.folder), "--style", f"7={picture}"]
    assert shlex.split(line)[:5] == words and str(out) in line
    assert open(store.folder).painted_objects == ("red",), "on this the line goes on"


def test_what_is_recovered_has_the_commands_of_the_run_before(session: Session):
    store = SceneStore(session.folder)
    session.do(lambda state: rename_picked(pick_names(state, ["3"]), "red"))
    assert session.worker.settle()
    store.save(session)
    session.do(lambda state: rename_picked(pick_names(state, ["7"]), "blue"))
    assert session.worker.settle() and store.autosave(session)
    kept = SceneStore(session.folder).recover(StudioState(open(session.folder)))
    assert kept is not None and kept.commands == session.state.commands[-1:]
    (line,) = command_lines(kept, session.folder, session.folder) or []
    assert line.startswith("stylesplat select") and "--name blue" in line


def test_a_folder_that_holds_what_was_taken_back_leads_nowhere(session: Session, tmp_path: Path):
    picture = tmp_path / "stripes.png"
    Image.fromarray(to_uint8(stripes()).numpy()).save(picture)
    opened = session.saved
    painted(session, "3", picture)
    SceneStore(session.folder).save(session)
    held = {tmp_path / "first": opened, session.folder: session.saved}
    painted(session, "7", picture)
    session.do(lambda state: remove_paint(state, "3"))
    assert session.worker.settle()
    told = commands_text(session.state, session.folder, held)
    assert told.startswith(f"# {session.folder} holds more than this")
    assert f"stylize {tmp_path / 'first'}" in told and "7=" in told and "3=" not in told


def test_what_is_saved_where_it_was_is_told_as_well(session: Session, tmp_path: Path):
    picture = tmp_path / "stripes.png"
    Image.fromarray(to_uint8(stripes()).numpy()).save(picture)
    painted(session, "3", picture)
    SceneStore(session.folder).save(session)
    told = commands_text(session.state, session.folder, {session.folder: session.saved})
    first, second, line = told.splitlines()[:3]
    assert first == f"# {session.folder} holds all of this" and "like this" in second
    assert line.startswith(f"stylesplat stylize {session.folder}") and f"3={picture}" in told
