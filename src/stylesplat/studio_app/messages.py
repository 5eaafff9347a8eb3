"""What the page and the server tell each other: JSON over one WebSocket.

The page sends `Look` and the actions of `actions.py`; the field `do` names the kind. The server
sends `Hello` once, and after each change a whole `StateMessage`, `Progress` or `Note`. Pictures
are binary, see `pictures.py`.
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
    """A control of a painting, or of a recolouring."""

    name: str
    label: str
    value: Any
    """The default."""
    choices: tuple[str, ...] = ()
    low: float = 0.0
    high: float = 1.0
    step: float = 0.05


class Hello(Told, frozen=True, tag="hello"):
    """What stays as it is."""

    title: str
    readonly: bool
    start: dict[str, Any]
    """The first view: position, target, up, slopes."""
    photos: list[dict[str, Any]]
    """Name, position and target of each photo, and the corners of its picture there."""
    settings: tuple[Setting, ...]
    recolorings: tuple[Setting, ...]
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
    thumbnail: str
    """Its address; empty as long as there is none."""
    count: int | None = None
    """Of its Gaussians; None until they are found."""
    centre: Vector | None = None
    radius: float = 0.0


class LayerInfo(msgspec.Struct, frozen=True):
    name: str
    object: str
    title: str
    """Of the style picture."""
    strength: float
    form: float
    visible: bool
    locked: bool
    settings: str
    recolor: dict[str, Any] | None = None
    """The settings of a recolouring; None for paint."""


class Variant(msgspec.Struct, frozen=True):
    """A painting of an object that was finished, or stopped."""

    object: str
    title: str
    settings: str
    thumbnail: str
    """The address of a JPEG."""


class StyleInfo(msgspec.Struct, frozen=True):
    title: str
    size: tuple[int, int]
    url: str
    """The address of a JPEG."""
    preview: str
    """The address of a picture of what is picked in this style; empty without one."""


class StateMessage(Told, frozen=True, tag="state"):
    objects: list[ObjectInfo]
    layers: list[LayerInfo]
    """The lowest first."""
    variants: list[Variant]
    current: list[int]
    """The variants that show."""
    snapshots: list[str]
    styles: list[StyleInfo]
    waiting: list[tuple[int, str, str]]
    """Number, object and style of paintings that wait."""
    alone: bool
    painting: bool
    can_continue: bool
    undo: str
    """What undo takes back; empty if there is nothing."""
    redo: str
    note: str
    unsaved: bool
    folder: str
    command: str
    """What gives the saved scene once more; empty if nothing is painted."""
    compared: int | None
    box: tuple[Vector, Vector]
    """Around what is picked, or around the content."""


class Progress(Told, frozen=True, tag="progress"):
    """Long work; nothing is under way without `what`."""

    what: str = ""
    share: float = 0.0
    """How much of it is done, 0 to 1."""
    left: float | None = None
    """Estimated seconds that it still takes."""
    doing: str = ""
    """The preparation that is under way."""
    export: bool = False
    """Whether it is an export, which can be cancelled."""


class Note(Told, frozen=True, tag="note"):
    text: str
    failure: bool = False


class Download(Told, frozen=True, tag="download"):
    """A file is ready."""

    url: str
    name: str
