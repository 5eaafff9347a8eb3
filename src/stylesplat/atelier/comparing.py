"""What the panel Compare does: how strong paintings are, and which others there were."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

from stylesplat.atelier.session import Session
from stylesplat.atelier.studio_state import State
from stylesplat.atelier.thumbnails import Thumbnail, object_thumbnail, portrait_camera
from stylesplat.stylization.bookkeeping import strengths
from stylesplat.verbs.adjust import adjust


@dataclass(frozen=True)
class Variant:
    """A painting that was finished."""

    title: str
    """The object and the picture."""
    bookmark: int
    """Of the history: everything as it was then."""
    thumbnail: Thumbnail
    """The object."""
    settings: Mapping[str, object]
    """All of them."""


def at_intensity(state: State, name: str, intensity: float) -> State:
    """A painting stronger or weaker.

    Raises:
        StyleSplatError: If there is no such painting, or the intensity is out of range.
    """
    if strengths(state.scene).get(name) == intensity:
        return state
    scene = adjust(state.scene, intensity, objects=name)
    note = f"{name} at {intensity:.0%}"
    return replace(state, scene=scene, glow=False, note=note)


def taken_back(state: State, name: str) -> State:
    """A painting taken back, the others staying as they are.

    Raises:
        StyleSplatError: If there is no such painting.
    """
    scene = adjust(state.scene, objects=name, undo=True)
    return replace(state, scene=scene, note=f"Took the paint of {name} back")


def variant_of(session: Session, name: str, title: str) -> Variant:
    """What was painted just now, to come back to."""
    state = session.state
    splats, picked = state.scene.splats, session.masks.of(state.scene, name)
    camera = portrait_camera(splats, state.scene.cameras, picked)
    painted = state.scene.painted
    settings = {p.name: p.settings for p in painted.paintings}[name] if painted else {}
    return Variant(
        title=f"{name}: {title}",
        bookmark=session.history.bookmark(),
        thumbnail=object_thumbnail(splats, camera, picked),
        settings=settings,
    )
