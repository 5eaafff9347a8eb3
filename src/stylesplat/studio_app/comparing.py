"""What the panel Compare does: how strong paintings are, and which others there were."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from stylesplat.scene.compose import strengths_of
from stylesplat.studio_app.session import Session
from stylesplat.studio_app.studio_state import State
from stylesplat.studio_app.thumbnails import Thumbnail, object_thumbnail, portrait_camera
from stylesplat.stylization.config import StyleConfig, plain_settings
from stylesplat.verbs.adjust import adjust


@dataclass(frozen=True)
class Variant:
    """A painting that was finished, or stopped."""

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
    if strengths_of(state.scene).get(name) == intensity:
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
    settings = {layer.object: layer.settings for layer in state.scene.layers}.get(name, {})
    return Variant(
        title=f"{name}: {title}",
        bookmark=session.history.bookmark(),
        thumbnail=object_thumbnail(splats, camera, picked),
        settings=settings,
    )


def described(variants: Sequence[Variant]) -> str:
    """A line for each variant: its number, its title, and what of its settings is unusual."""
    usual = plain_settings(StyleConfig())
    lines = list[str]()
    for number, variant in enumerate(variants, 1):
        other = {key: value for key, value in variant.settings.items() if value != usual.get(key)}
        words = ", ".join(f"{key.replace('_', ' ')} {_word(other[key])}" for key in other)
        lines.append(f"{number}. {variant.title}: {words or 'usual settings'}")
    return "\n".join(lines)


def _word(value: object) -> str:
    if isinstance(value, list):
        return " ".join(map(str, value))
    return f"{value:g}" if isinstance(value, float) else str(value)
