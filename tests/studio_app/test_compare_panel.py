from browser import quick_style
from stylesplat.studio_app.compare_panel import Variant, describe_variants, make_variant
from stylesplat.studio_app.paint_queue import PaintQueue
from stylesplat.studio_app.session import Session


def test_variants_tell_what_of_their_settings_is_unusual(session: Session):
    variants = list[Variant]()
    session.on_painted.append(
        lambda name, title: variants.append(make_variant(session, name, title))
    )
    PaintQueue(session, device="cpu").paint(("3", "7"), quick_style(), "stripes")
    assert session.worker.settle()
    first, second = describe_variants(variants).splitlines()
    assert first == "1. 3: stripes: steps 4, layers 1, object size 30"
    assert second.startswith("2. 7: stripes: ")


def test_undo_while_painting_takes_what_there_is_back_and_keeps_it_as_a_variant(session: Session):
    before, queue = session.state, PaintQueue(session, device="cpu")
    variants, undone, said = list[Variant](), list[float](), list[str]()
    session.on_painted.append(
        lambda name, title: variants.append(make_variant(session, name, title))
    )
    session.on_message.append(lambda line, failure: said.append(line))

    def undo_at_two() -> None:
        if session.progress is not None and session.progress.share >= 0.25 and not undone:
            undone.append(session.progress.share)
            session.step(1)  # nothing can be done again meanwhile
            session.step(-1)

    session.on_change.append(undo_at_two)
    queue.paint(("3", "7"), quick_style(), "stripes")
    assert session.worker.settle()
    assert session.state is before and not session.painting and session.preview is None
    assert "being painted" in said[-1] and not queue.waiting
    (variant,) = variants
    assert "to step" in variant.title
    early = session.history.at(variant.bookmark)
    session.step(1)
    assert session.worker.settle()
    assert session.state.note.startswith("Stopped at step")
    assert session.state.scene is early.scene


def test_undo_before_the_first_stroke_ends_the_painting_alone(session: Session):
    session.do(lambda state: type(state)(state.scene, note="one step"))
    assert session.worker.settle()
    before, queue, asked = session.state, PaintQueue(session, device="cpu"), list[int]()

    def undo() -> None:
        if not asked:
            asked.append(1)
            session.step(-1)

    session.on_progress.append(undo)
    queue.paint(("3",), quick_style(), "stripes")
    assert session.worker.settle()
    assert asked and session.state is before and not session.painting
