"""What the page and the server tell each other: JSON over one WebSocket.

The page sends `Look` and the actions of `actions.py`; the field `do` names the kind. The server
sends `Hello` once, and after each change a whole `StateMessage`, `ProgressMessage` or `Note`.
Pictures are binary, see `pictures.py`.
"""

from typing import Annotated, Any, Literal

import msgspec

Share = Annotated[float, msgspec.Meta(ge=0, le=1)]
Place = tuple[Share, Share]  # in a picture, from its top left corner
Text = Annotated[str, msgspec.Meta(max_length=200)]
Side = Annotated[int, msgspec.Meta(ge=1, le=16384)]
Vector = tuple[float, float, float]
How = Literal["new", "add", "away"]
Shape = Literal["rectangle", "lasso", "brush"]
Positive = Annotated[float, msgspec.Meta(gt=0)]
Line = Annotated[list[Place], msgspec.Meta(min_length=1, max_length=4000)]


class Look(msgspec.Struct, frozen=True, tag="look", tag_field="do", forbid_unknown_fields=True):
    """Where a browser's camera is."""

    number: int
    viewmat: Annotated[list[float], msgspec.Meta(min_length=16, max_length=16)]
    focal: Positive
    size: tuple[Side, Side]
    moving: bool = False
    before: bool = False
    """Whether the picture before painting is wanted, too."""
    draws: bool = False
    """Whether the browser draws the Gaussians itself while the camera moves."""


class Told(msgspec.Struct, frozen=True, tag_field="kind"):
    """What the server tells the page."""


class Setting(msgspec.Struct, frozen=True):
    """A control of the painting's settings."""

    name: str
    label: str
    value: Any
    """The default."""
    choices: tuple[str, ...] = ()
    low: float = 0.0
    high: float = 1.0
    step: float = 0.05
    hint: str = ""


class Hello(Told, frozen=True, tag="hello"):
    """What stays as it is."""

    title: str
    readonly: bool
    start: dict[str, Any]
    """The first view: position, target, up, slopes."""
    photos: list[dict[str, Any]]
    """Name, position and target of each photo, and the corners of its picture there."""
    settings: list[Setting]
    formats: tuple[str, ...]
    extent: float
    """Size of the content in world units."""
    gaussians: int
    max_bytes: int
    """Of an upload."""


class ObjectInfo(msgspec.Struct, frozen=True):
    name: str
    picked: bool
    hidden: bool
    named: bool
    painted: bool
    count: int
    thumbnail: int
    """Its version; 0 as long as there is none."""
    centre: Vector | None = None
    radius: float = 0.0


class LayerInfo(msgspec.Struct, frozen=True):
    object: str
    title: str
    """Of the style picture."""
    strength: float
    form: float
    visible: bool
    locked: bool
    settings: str


class VariantInfo(msgspec.Struct, frozen=True):
    number: int
    object: str
    title: str
    settings: str
    current: bool


class StyleInfo(msgspec.Struct, frozen=True):
    number: int
    title: str
    size: tuple[int, int]
    preview: int = 0
    """Version of the preview of this style on what is picked; 0 without one."""


class JobInfo(msgspec.Struct, frozen=True):
    number: int
    object: str
    title: str


class StateMessage(Told, frozen=True, tag="state"):
    objects: list[ObjectInfo]
    layers: list[LayerInfo]
    """The lowest first."""
    variants: list[VariantInfo]
    snapshots: list[tuple[int, str]]
    styles: list[StyleInfo]
    waiting: list[JobInfo]
    alone: bool
    painting: bool
    can_continue: bool
    undo: str
    """What undo takes back; empty if there is nothing."""
    redo: str
    note: str
    unsaved: bool
    folder: str
    commands: str
    compared: int | None
    box: tuple[Vector, Vector]
    """Around what is picked, or around the content."""


class ProgressMessage(Told, frozen=True, tag="progress"):
    """Long work; nothing is under way without `what`."""

    what: str = ""
    share: float = 0.0
    left: float | None = None
    doing: str = ""
    export: bool = False
    """Whether it is an export, which can be cancelled."""


class Note(Told, frozen=True, tag="note"):
    text: str
    failure: bool = False


class Download(Told, frozen=True, tag="download"):
    """A file is ready."""

    url: str
    name: str
