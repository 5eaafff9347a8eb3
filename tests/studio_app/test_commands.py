import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest
from PIL import Image

from studio_balls import QUICK, session_in, stripes
from stylesplat.figures.pictures import to_uint8
from stylesplat.io.scene_folder import open
from stylesplat.studio_app.commands import commands, held_by
from stylesplat.studio_app.comparing import taken_back
from stylesplat.studio_app.easel import Easel
from stylesplat.studio_app.keep_panel import recounted
from stylesplat.studio_app.keeping import Place
from stylesplat.studio_app.picking import pick_names, renamed
from stylesplat.studio_app.session import Session
from stylesplat.studio_app.studio_state import State
from stylesplat.stylization.style import Style


@pytest.fixture
def session(tmp_path: Path) -> Iterator[Session]:
    found = session_in(tmp_path)
    yield found
    found.close()


def painted(session: Session, name: str, picture: Path) -> None:
    Easel(session, device="cpu").paint((name,), Style(picture, config=QUICK), "stripes")
    assert session.worker.settle()


def test_after_save_as_the_commands_start_from_what_is_saved(session: Session, tmp_path: Path):
    picture = tmp_path / "stripes.png"
    Image.fromarray(to_uint8(stripes()).numpy()).save(picture)
    place, first = Place(session.folder), session.folder
    held = {first: held_by(session.saved)}
    session.do(lambda state: renamed(pick_names(state, ["3"]), "red"))
    painted(session, "red", picture)
    place.save_as(session, "elsewhere")
    held[place.folder] = held_by(session.saved)
    told = recounted(session.state, place.folder, held).splitlines()
    assert told[0] == f"# {place.folder} holds all of this"
    assert f"select {first}" in told[1], "and this is how it came about"
    painted(session, "7", picture)
    assert "red" not in recounted(session.state, place.folder, held), "that is saved"
    out = tmp_path / "out"
    lines = commands(session.state, place.folder, out, held[place.folder])
    assert lines is not None and len(lines) == 1
    (line,) = lines
    words = ["stylesplat", "stylize", str(place.folder), "--style", f"7={picture}"]
    assert shlex.split(line)[:5] == words and str(out) in line
    assert open(place.folder).painted_objects == ("red",), "on this the line goes on"


def test_what_is_recovered_has_the_commands_of_the_run_before(session: Session):
    place = Place(session.folder)
    session.do(lambda state: renamed(pick_names(state, ["3"]), "red"))
    assert session.worker.settle()
    place.save(session)
    session.do(lambda state: renamed(pick_names(state, ["7"]), "blue"))
    assert session.worker.settle() and place.autosave(session)
    kept = Place(session.folder).recovered(State(open(session.folder)))
    assert kept is not None and kept.commands == session.state.commands[-1:]
    (line,) = commands(kept, session.folder, session.folder) or []
    assert line.startswith("stylesplat select") and "--name blue" in line


def test_a_folder_that_holds_what_was_taken_back_leads_nowhere(session: Session, tmp_path: Path):
    picture = tmp_path / "stripes.png"
    Image.fromarray(to_uint8(stripes()).numpy()).save(picture)
    opened = held_by(session.saved)
    painted(session, "3", picture)
    Place(session.folder).save(session)
    held = {tmp_path / "first": opened, session.folder: held_by(session.saved)}
    painted(session, "7", picture)
    session.do(lambda state: taken_back(state, "3"))
    assert session.worker.settle()
    told = recounted(session.state, session.folder, held)
    assert told.startswith(f"# {session.folder} holds more than this")
    assert f"stylize {tmp_path / 'first'}" in told and "7=" in told and "3=" not in told


def test_what_is_saved_where_it_was_is_told_as_well(session: Session, tmp_path: Path):
    picture = tmp_path / "stripes.png"
    Image.fromarray(to_uint8(stripes()).numpy()).save(picture)
    painted(session, "3", picture)
    Place(session.folder).save(session)
    told = recounted(session.state, session.folder, {session.folder: held_by(session.saved)})
    first, second, line = told.splitlines()[:3]
    assert first == f"# {session.folder} holds all of this" and "like this" in second
    assert line.startswith(f"stylesplat stylize {session.folder}") and f"3={picture}" in told
