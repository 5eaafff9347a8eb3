import gc
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from weakref import ref

import pytest
import torch

from balls import CAMERAS, SPLATS
from browser import QUICK, quick_style, session_in, stripes, until
from stylesplat.cli import main
from stylesplat.errors import StyleSplatError
from stylesplat.io.scene_folder import open
from stylesplat.progress import track
from stylesplat.scene.objects import SceneObject
from stylesplat.scene.scene import strengths_of
from stylesplat.scene.splats import Splats
from stylesplat.selection.resolve import find_object
from stylesplat.studio_app.edits import adjust_layer
from stylesplat.studio_app.files import FORMATS, Exporter, SceneStore
from stylesplat.studio_app.history import replace_scene
from stylesplat.studio_app.paint_queue import PaintQueue, seconds_left
from stylesplat.studio_app.selecting import pick_names, rename_picked
from stylesplat.studio_app.session import Session
from stylesplat.stylization.config import plain_settings
from stylesplat.stylization.painter import paint
from stylesplat.verbs.export import export

pytestmark = pytest.mark.usefixtures("quick_painting")


@pytest.fixture
def said(session: Session) -> list[str]:
    lines = list[str]()
    session.on_message.append(lambda line, *_: lines.append(line))
    return lines


@pytest.fixture
def wanted(all_cores: None, tmp_path: Path) -> Splats:
    """What painting gives without a studio, whose thread has all cores."""
    scene = session_in(tmp_path / "wanted").state.scene  # of degree 3, as files are
    return paint(scene.splats, CAMERAS, find_object(scene, "3"), stripes(), config=QUICK)


def painted(session: Session, *names: str) -> PaintQueue:
    queue = PaintQueue(session, device="cpu")
    session.ask(lambda: queue.paint(names, quick_style(), "stripes"))
    assert session.worker.wait_until_idle()
    return queue


def test_painting_gives_what_stylize_gives_and_shows_it_on_the_way(
    session: Session, wanted: Splats
):
    before, seen = session.state.scene, list[torch.Tensor]()
    session.on_change.append(lambda: seen.append(session.display.splats.sh0))
    painted(session, "3")
    found = session.state.scene
    assert torch.equal(found.splats.sh0, wanted.sh0)
    (painting,) = found.layers
    assert painting.settings == plain_settings(QUICK) and painting.styles == quick_style().sources()
    assert not torch.equal(seen[0], before.splats.sh0), "the colours are there at once"
    assert len(seen) > 2 and session.preview is None and session.progress is None


def test_an_object_is_not_measured_again_while_what_is_below_its_layer_stays(
    session: Session, wanted: Splats
):
    measured = list[str]()

    def note() -> None:
        if session.progress is not None and session.progress.doing == "finding contours":
            measured.append(session.progress.what.split(" like ")[0])

    session.on_progress.append(note)
    queue = PaintQueue(session, device="cpu")

    def paint_anew(name: str) -> bool:
        """Whether it was measured for that."""
        measured.clear()
        session.ask(lambda: queue.paint([name], quick_style(), "stripes"))
        assert session.worker.wait_until_idle()
        assert {*measured} <= {f"Painting {name}"}
        return bool(measured)

    assert paint_anew("3") and not paint_anew("3")
    assert torch.equal(session.state.scene.splats.sh0, wanted.sh0), "as if it had been"
    assert paint_anew("7") and not paint_anew("7")
    session.do(partial(adjust_layer, name="3", strength=0.5))
    assert paint_anew("7"), "what is below is another now"


def test_several_are_queued_and_undo_takes_one_after_the_other_back(session: Session):
    painted(session, "3", "7")
    assert [*strengths_of(session.state.scene)] == ["3", "7"]
    session.step(-1)
    assert session.worker.wait_until_idle()
    assert [*strengths_of(session.state.scene)] == ["3"]
    session.step(-1)
    session.step(1)
    session.step(1)
    assert session.worker.wait_until_idle()
    assert [*strengths_of(session.state.scene)] == ["3", "7"]


def test_stop_keeps_what_there_is_and_continue_finishes_it(
    session: Session, said: list[str], wanted: Splats
):
    queue = PaintQueue(session, device="cpu")
    steps = list[int]()

    def stop_at_two() -> None:
        if session.progress is not None and session.progress.share >= 0.25 and not steps:
            steps.append(1)
            session.ask(queue.stop)

    session.on_change.append(stop_at_two)
    session.ask(lambda: queue.paint(("3",), quick_style(), "stripes"))
    assert session.worker.wait_until_idle()
    assert session.state.note.endswith(" steps"), said
    early = session.state.scene
    session.do(lambda state: pick_names(state, ["7"]))
    assert session.worker.wait_until_idle()
    assert early.layers and "3 like stripes" in queue.stopped_note
    session.ask(queue.resume)
    assert session.worker.wait_until_idle()
    assert torch.equal(session.state.scene.splats.sh0, wanted.sh0)
    assert not torch.equal(session.state.scene.splats.sh0, early.splats.sh0)
    assert session.state.picked == ("7",)
    assert not queue.stopped_note


@pytest.mark.parametrize("parts", [1, 4, 6])
def test_a_painting_that_is_stopped_between_its_stages_can_go_on(
    session: Session, said: list[str], wanted: Splats, parts: int
):
    """Stages are prepared within a step, in parts that give way to other work."""
    queue, done, listening = PaintQueue(session, device="cpu"), list[float](), session.listening

    def stop(share: float) -> None:
        if session.progress is not None and session.progress.share > 0:
            done.append(share)
            if len(done) == parts:
                queue.stop()

    def counted(stopped: Callable[[], bool] = lambda: False):
        return listening(stopped, stop)

    session.listening = counted  # type: ignore
    session.ask(lambda: queue.paint(("3",), quick_style(), "stripes"))
    assert session.worker.wait_until_idle()
    assert len(done) >= parts and session.state.scene.layers and queue.stopped_note
    session.ask(queue.resume)
    assert session.worker.wait_until_idle()
    assert torch.equal(session.state.scene.splats.sh0, wanted.sh0) and not said


def test_stop_before_the_first_stroke_ends_the_preparation(session: Session):
    queue, before = PaintQueue(session, device="cpu"), session.state
    prepared = list[str]()

    def stop() -> None:
        assert session.progress is not None
        prepared.append(session.progress.doing)
        session.ask(queue.stop)

    session.on_progress.append(stop)
    session.ask(lambda: queue.paint(("3", "7"), quick_style(), "stripes"))
    assert session.worker.wait_until_idle()
    assert prepared[0].startswith("finding") and len(prepared) < 3
    assert session.state is before and not session.painting and not queue.stopped_note
    assert session.preview is None and not queue.waiting
    painted(session, "3")
    assert strengths_of(session.state.scene) == {"3": 1.0}, "it can be painted afterwards"


def test_stop_between_the_order_and_its_first_step_ends_nothing_else(
    session: Session, said: list[str]
):
    queue, done = PaintQueue(session, device="cpu"), list[int]()

    def order_and_stop() -> None:
        queue.paint(("3",), quick_style(), "stripes")
        queue.stop()

    session.ask(order_and_stop)
    assert session.worker.wait_until_idle() and not session.painting
    session.ask(lambda: done.extend(track(range(3), "another job")))
    assert session.worker.wait_until_idle()
    assert done == [0, 1, 2] and not said


def test_stop_during_a_job_within_the_first_step_ends_the_painting_alone(
    session: Session, said: list[str]
):
    queue, before, done = PaintQueue(session, device="cpu"), session.state, list[int]()

    def other_job() -> None:
        queue.stop()
        done.extend(track(range(3), "another job"))

    def ask_once() -> None:
        if not asked:
            asked.append(True)
            session.ask(other_job)

    asked = list[bool]()
    session.on_progress.append(ask_once)
    session.ask(lambda: queue.paint(("3",), quick_style(), "stripes"))
    assert session.worker.wait_until_idle()
    assert done == [0, 1, 2] and not said
    assert session.state is before and not session.painting


def test_what_cannot_be_painted_is_told_and_changes_nothing(session: Session, said: list[str]):
    before = session.state
    painted(session)
    painted(session, "nobody")
    assert session.state is before and not session.painting
    assert "Nothing is picked" in said[0] and "nobody" in said[1]


def test_an_object_of_three_gaussians_is_told_to_be_too_small(session: Session, said: list[str]):
    three = {"few": SceneObject(torch.arange(len(SPLATS)) < 3)}
    scene = replace(session.state.scene, objects=three)
    session.do(lambda state: replace_scene(state, scene, "named"))
    painted(session, "few")
    assert session.state.scene is scene and not session.painting
    assert "3 Gaussians, too few" in said[-1]


def test_a_drag_of_a_slider_is_one_step_of_undo(session: Session):
    painted(session, "3")
    full = session.state
    for value in (0.8, 0.4, 0.0):
        session.do(
            lambda state, value=value: adjust_layer(state, "3", value),
            merge=lambda state: "slider",
            kind=f"slider {value}",
        )
    assert session.worker.wait_until_idle()
    assert strengths_of(session.state.scene) == {"3": 0.0}
    assert torch.equal(session.state.scene.splats.sh0, full.scene.base.sh0)
    assert session.history.undo_note == "Strength of 3: 0%" and not session.history.redo_note
    session.step(-1)
    assert session.worker.wait_until_idle()
    assert strengths_of(session.state.scene) == {"3": 1.0}
    assert session.history.redo_note == "Strength of 3: 0%"


def test_time_left_follows_the_last_painting_or_the_speed_of_late():
    assert seconds_left([(0.0, 0.0), (0.1, 1.0)], None) is None, "too early to say"
    assert seconds_left([(0.0, 0.0), (0.5, 10.0)], None) == pytest.approx(10)
    slow_end = [(0.0, 0.0), (0.5, 10.0), (1.0, 40.0)]
    assert seconds_left([(0.0, 0.0), (0.5, 5.0)], slow_end) == pytest.approx(15)


def test_history_keeps_layers_alone_and_composes_them_again(session: Session):
    first, steps = session.state, list[torch.Tensor]()
    painted(session, "3", "7")
    composed = ref(session.state.scene.splats)
    steps.append(session.state.scene.splats.sh0.clone())
    session.do(lambda state: adjust_layer(state, "3", 0.5))
    assert session.worker.wait_until_idle()
    session.preview = None
    gc.collect()
    assert composed() is None, "the splats of what is not displayed take no memory"
    session.step(-1)
    assert session.worker.wait_until_idle()
    assert torch.equal(session.state.scene.splats.sh0, steps[0])
    session.step(-2)
    assert session.worker.wait_until_idle()
    assert session.state.scene is first.scene and not session.unsaved
    session.step(1)
    session.do(lambda state: pick_names(state, ["3"]))
    session.step(1)
    assert session.worker.wait_until_idle()
    assert session.state.picked == ("3",), "what was undone is forgotten"


def test_saved_scenes_open_again(session: Session):
    store = SceneStore(session)
    session.do(lambda state: rename_picked(pick_names(state, ["3"]), "red"))
    assert session.worker.wait_until_idle() and session.unsaved
    store.save()
    assert not session.unsaved and [*open(session.folder).objects] == ["red"]
    painted(session, "red")
    store.save()
    assert strengths_of(open(session.folder)) == {"red": 1.0}
    session.step(-1)
    assert session.worker.wait_until_idle()
    store.save()
    assert not open(session.folder).layers, "saving after undo takes the paint back"


def test_save_refuses_what_others_changed_and_names_that_are_paths(session: Session):
    store = SceneStore(session)
    (session.folder / "objects.json").write_text("{}  ")
    with pytest.raises(StyleSplatError, match="Another program has changed"):
        store.save()
    for name in ("../out", ".hidden", ""):
        with pytest.raises(StyleSplatError, match=f"No folder can be called '{name}'"):
            store.save_as(name)
    with pytest.raises(StyleSplatError, match="balls already"):
        store.save_as("balls")
    store.save_as("elsewhere")
    assert open(session.folder.parent / "elsewhere").splats is not None


def test_save_goes_on_where_others_wrote_no_part_of_the_scene(session: Session):
    store, folder = SceneStore(session), session.folder
    session.do(lambda state: rename_picked(pick_names(state, ["3"]), "red"))
    assert session.worker.wait_until_idle()
    assert main(["objects", str(folder)]) == 0 and (folder / "objects.png").is_file()
    (folder / "metrics.json").write_text('{"evaluate": {}}')
    store.save()
    assert [*open(folder).objects] == ["red"] and open(folder).metrics == {"evaluate": {}}


def test_save_refuses_layers_that_others_changed(session: Session):
    painted(session, "3")
    store = SceneStore(session)
    store.save()
    (layer,) = (session.folder / "layers").iterdir()
    layer.write_bytes(layer.read_bytes() + b" ")
    with pytest.raises(StyleSplatError, match="Another program has changed"):
        store.save()


BEGIN = {".spz": b"ngsp", ".glb": b"gltf", ".sog": b"pk", ".html": b"<!doctype", ".splat": b""}


@pytest.mark.parametrize("ending", FORMATS)
def test_exports_are_files_of_their_kind(session: Session, ending: str):
    exporter, found = Exporter(session), list[bytes]()
    exporter.start("Exporting", partial(export, session.state.scene), ending, found.append)
    until(lambda: bool(found), "the export")
    (content,) = found
    assert len(content) > 1000 and content.lower().startswith(BEGIN.get(ending, b"ply"))
