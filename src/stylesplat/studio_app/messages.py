"""What the page and the server tell each other: JSON over one WebSocket.

The page sends `ViewRequest` and the actions of `actions.py`; the field `do` names the kind. The
server sends `Hello` once, and after each change a whole `StateMessage`, `Progress` or `Note`.
Pictures are binary, see `pictures.py`.
"""

from typing import Annotated, Any, Literal

import msgspec

from stylesplat.options import options_of
from stylesplat.scene.layers import Blend, LayerKind
from stylesplat.studio_app.gallery import StylePicture

Share = Annotated[float, msgspec.Meta(ge=0, le=1)]
PicturePoint = tuple[Share, Share]  # in a picture, from its top left corner
ShortText = Annotated[str, msgspec.Meta(max_length=200)]
FileText = Annotated[str, msgspec.Meta(max_length=4096)]
PictureSide = Annotated[int, msgspec.Meta(ge=1, le=16384)]
Bounded = Annotated[float, msgspec.Meta(ge=-1e9, le=1e9)]  # float32 squares it
ViewVector = tuple[Bounded, Bounded, Bounded]
How = Literal["new", "add", "away", "within"]
Extreme = Literal["size", "opacity", "distance"]
Shape = Literal["rectangle", "lasso", "brush"]
Positive = Annotated[float, msgspec.Meta(gt=0, le=1e9)]
GuideReach = Annotated[float, msgspec.Meta(ge=0.01, le=1)]
DrawnLine = Annotated[list[PicturePoint], msgspec.Meta(min_length=1, max_length=4000)]


class ViewRequest(
    msgspec.Struct, frozen=True, tag="look", tag_field="do", forbid_unknown_fields=True
):
    number: int
    viewmat: Annotated[list[Bounded], msgspec.Meta(min_length=16, max_length=16)]
    focal: Annotated[float, msgspec.Meta(ge=1e-3, le=1e9)]  # pixels
    size: tuple[PictureSide, PictureSide]
    moving: bool = False
    before: bool = False  # whether the picture before painting is wanted, too
    draws: bool = False  # whether the browser draws the Gaussians itself while the camera moves


class Ping(msgspec.Struct, frozen=True, tag="ping", tag_field="do", forbid_unknown_fields=True):
    """Asks whether the server answers, while the worker may be busy."""


class Interrupt(
    msgspec.Struct, frozen=True, tag="interrupt", tag_field="do", forbid_unknown_fields=True
):
    """Ends what the worker does for the page that says so."""


class ServerMessage(msgspec.Struct, frozen=True, tag_field="kind"):
    """What the server tells the page."""


class Setting(msgspec.Struct, frozen=True):
    name: str
    label: str
    value: Any
    choices: tuple[str, ...]
    low: float
    high: float
    step: float


def page_settings(config: type) -> tuple[Setting, ...]:
    """The options of a config that the page offers."""
    return tuple(
        Setting(name, each.label, each.default, each.choices, *each.slider, each.step)
        for name, each in options_of(config).items()
        if each.label
    )


class Hello(ServerMessage, frozen=True, tag="hello"):
    title: str
    readonly: bool
    start: dict[str, Any]  # the first view: position, target, up, slopes
    photos: list[dict[str, Any]]
    settings: tuple[Setting, ...]
    recolorings: tuple[Setting, ...]
    formats: tuple[str, ...]
    extent: float  # size of the content in world units
    gaussians: int
    max_bytes: int


class ObjectInfo(msgspec.Struct, frozen=True):
    name: str
    picked: bool
    hidden: bool
    named: bool
    painted: bool
    thumbnail: str
    count: int | None = None  # of its Gaussians; None until they are found
    centre: ViewVector | None = None
    sides: ViewVector | None = None  # of the box around it, along the world's axes


class SelectionInfo(msgspec.Struct, frozen=True):
    count: int
    soft: bool
    origin: str  # the object that it began as
    centre: ViewVector
    sides: ViewVector


class LayerInfo(msgspec.Struct, frozen=True):
    name: str
    object: str
    kind: LayerKind
    title: str
    strength: float
    form: float
    visible: bool
    locked: bool
    solo: bool  # whether it is shown alone
    blend: Blend
    masked: bool
    settings: str
    values: dict[str, Any]  # of the settings that can be changed in place
    recolor: dict[str, Any] | None = None  # the settings of a recolouring; None for paint
    guides: list[list[ViewVector]] = []  # the lines that its strokes follow


class Variant(msgspec.Struct, frozen=True):
    """A painting of an object that was finished or stopped, or a draft of Try all."""

    id: str
    object: str
    title: str
    settings: str
    thumbnail: str
    starred: bool = False


class StepCard(msgspec.Struct, frozen=True):
    """A step of the history, or a snapshot."""

    number: int
    note: str
    picture: str  # its address; empty until there is one


class ViewCard(msgspec.Struct, frozen=True, omit_defaults=True):
    """A kept view, or a photo's own."""

    name: str
    url: str  # of its picture; empty until there is one
    position: ViewVector | None = None
    target: ViewVector | None = None
    photo: int | None = None  # the row of the photo


class StateMessage(ServerMessage, frozen=True, tag="state"):
    objects: list[ObjectInfo]
    selection: SelectionInfo | None
    again: bool  # whether another size or reach of the last click takes its place
    layers: list[LayerInfo]  # the lowest first
    views: list[ViewCard]  # those that are kept, then photos
    up: ViewVector | None  # as it was set by hand
    variants: list[Variant]
    current: list[str]  # the ids of the variants that are shown
    history: list[StepCard]  # the first one first
    now: int  # the number of the present step
    snapshots: list[StepCard]
    styles: list[StylePicture]
    previews: dict[str, str]  # the addresses of pictures of what is picked, by the titles of styles
    waiting: list[tuple[int, str, str]]  # number, object and style of paintings that wait
    painting: bool
    stopped: str  # the painting that can go on; empty if none can
    undo: str
    redo: str
    note: str
    unsaved: bool
    folder: str
    command: str  # what gives the saved scene once more; empty if nothing is painted
    compared: str | None  # the id of the variant on the left of the handle
    box: tuple[ViewVector, ViewVector]  # around what is picked, or around the content


class Progress(ServerMessage, frozen=True, tag="progress"):
    """Long work; nothing is under way without `what`."""

    what: str = ""
    share: float = 0.0
    left: float | None = None  # estimated seconds that it still takes
    doing: str = ""  # the preparation that is under way
    export: bool = False  # whether it is an export, which can be cancelled


class Busy(ServerMessage, frozen=True, tag="busy"):
    """What a page asked for and takes long; empty when it is done."""

    what: str = ""
    cancel: bool = False  # whether `Interrupt` ends it


class Pong(ServerMessage, frozen=True, tag="pong"):
    """The answer to `Ping`."""


class Note(ServerMessage, frozen=True, tag="note"):
    text: str
    failure: bool = False


class Flight(ServerMessage, frozen=True, tag="flight"):
    """A path that the page is to fly along."""

    seconds: float
    places: list[tuple[ViewVector, ViewVector]]  # positions, and what they look at


class Download(ServerMessage, frozen=True, tag="download"):
    url: str
    name: str
