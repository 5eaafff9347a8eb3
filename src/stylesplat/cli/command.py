"""The base of all commands, options that several share, and how commands end."""

import os
import re
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from tyro.conf import Positional, arg

import stylesplat as ss
from stylesplat.errors import StyleSplatError, shell_command
from stylesplat.interrupts import WHOLE, report_interruption
from stylesplat.io.atomic import refuse_file
from stylesplat.io.files import FILE_DISK_FULL, file_stem, reason, resolve_within
from stylesplat.progress import say, write_lines
from stylesplat.stylization.config import Network

if TYPE_CHECKING:
    from stylesplat.scene.scene import Scene

SceneFolder = Annotated[Positional[Path], arg(help="Folder of the scene.")]
Output = Annotated[Path, arg(aliases=["-o"])]
OptionalOutput = Annotated[Path | None, arg(aliases=["-o"])]
Device = Annotated[
    Literal["auto", "cpu", "cuda"],
    arg(help="Where to compute; auto uses an NVIDIA GPU if there is one."),
]
StylePreset = Annotated[
    Literal["default", "paper"],
    arg(help="Settings to start from; paper is the method as published, with --features vgg16."),
]
Features = Annotated[
    Network | None,
    arg(
        help="Network whose features are matched: by default compact, which ships with the "
        "package, or vgg16 with --preset paper."
    ),
]
Weights = Annotated[
    Path | None,
    arg(
        help="File of the network's weights (.safetensors, .pth); without it VGG's are downloaded "
        "once."
    ),
]
COMMAND_PICTURES = (".png", ".jpg", ".jpeg", ".webp")
COMMAND_NAMES = {"source": "from"}  # of options that are no names in Python
CONTINUES = "The same command goes on where it stopped."  # after Ctrl-C


@dataclass(frozen=True)
class Answer:
    """What a command has made or found."""

    values: dict[str, Any]
    """What `--json` prints."""
    lines: Sequence[str] = ()
    """For people: what was made."""
    following: Sequence[str] = ()
    """Commands that may follow."""

    def text(self) -> list[str]:
        """The lines for people."""
        heads = ["Next: "] + ["      "] * len(self.following)
        return [*self.lines, *map(str.__add__, heads, self.following)]


@dataclass(frozen=True, kw_only=True)
class Command:
    """A verb of the command line: its fields are its options."""

    json: Annotated[bool, arg(help="Print the result as JSON on stdout.")] = False
    serves: ClassVar[bool] = False
    """Whether it waits for somebody rather than works."""

    def run(self) -> Answer:
        """Run the verb."""
        raise NotImplementedError

    def after_answer(self, values: dict[str, Any]) -> None:
        """Do what nobody has to wait for: the answer with these values is printed already."""

    def refuse_given(self, names: tuple[str, ...], why: str) -> None:
        """Raise a StyleSplatError if an option is given that would change nothing."""
        for name in names:
            if getattr(self, name):
                option = COMMAND_NAMES.get(name, name).replace("_", "-")
                raise StyleSplatError(f"--{option} means nothing with {why}. Leave it out.")


@dataclass(frozen=True, kw_only=True)
class MakingCommand(Command):
    """A verb that makes files."""

    overwrite: Annotated[bool, arg(help="Replace what the output holds.")] = False

    def refuse_picture(self, output: Path) -> None:
        """Raise a StyleSplatError if no picture can be written to a file."""
        if output.suffix.lower() not in COMMAND_PICTURES:
            names = ", ".join(COMMAND_PICTURES)
            raise StyleSplatError(f"Cannot draw into {output}: use a name in {names}.")
        refuse_file(output, overwrite=self.overwrite)


@dataclass(frozen=True)
class EditingCommand(MakingCommand):
    """A verb that changes a scene, or makes another one of it."""

    scene: SceneFolder
    output: Annotated[
        OptionalOutput, arg(help="Folder of a scene to make; without it the scene itself changes.")
    ] = field(default=None, kw_only=True)

    @property
    def folder(self) -> Path:
        """Of the scene that changes, or is made."""
        return self.output or self.scene

    def rewrite(self, change: "Callable[[Scene], Scene]") -> "Scene":
        """Open the scene, change it, and save it."""
        return rewrite_scene(self.scene, self.output, change, overwrite=self.overwrite)


BEFORE_AFTER = "before_after.png"  # in the folder of a painted scene
ENDINGS = {"stylize": "-painted", "train": "-scene", "export": ".ply", "render": ".mp4"}
COMMAND_PICTURE = "PICTURE.jpg"  # stands for any picture of the user's
PIPE_CLOSED = 141  # as shells report it, after `| head`
# Words of torch, OpenCV and CUDA, in errors of many kinds
COMMAND_NO_MEMORY = ("allocate memory", "not enough memory", "out of memory", "insufficient memory")
OUT_OF_MEMORY = (
    "Out of memory. Close other programs, or work on less: smaller photos, fewer views or fewer "
    "Gaussians."
)
# What torch says of a GPU: how much it lacked, has, and has free
OUT_OF_GPU_MEMORY = re.compile(
    r"Tried to allocate ([\d.]+ \w+)\..*capacity of ([\d.]+ \w+) of which ([\d.]+ \w+) is free"
)
BUG = "This is a mistake in stylesplat. Please report it, with all these lines."


@contextmanager
def new_scene(output: Path, *, overwrite: bool) -> "Iterator[Callable[[ss.Scene], None]]":
    """Check and lock the place of a scene before the work; yields what saves it there."""
    from stylesplat.io.atomic import locked_folder, refuse_occupied
    from stylesplat.io.kinds import SCENE
    from stylesplat.io.scene_folder import save

    def save_or_rescue(scene: "ss.Scene") -> None:
        try:
            save(scene, output, overwrite=overwrite)
        except StyleSplatError as error:
            rescued = Path(tempfile.mkdtemp(prefix="stylesplat-")) / output.resolve().name
            try:
                save(scene, rescued)
            except StyleSplatError:
                shutil.rmtree(rescued.parent, ignore_errors=True)
                raise error from None
            fact = f"{error} The scene is in {rescued}: move it from there."
            raise StyleSplatError(fact) from error

    with locked_folder(output):
        refuse_occupied(output, marker=SCENE, overwrite=overwrite)
        yield save_or_rescue


def rewrite_scene(
    source: Path, output: Path | None, change: "Callable[[ss.Scene], ss.Scene]", *, overwrite: bool
) -> "ss.Scene":
    """Open a scene, change it, and save it to `output`, or without that in its own folder."""
    from stylesplat.io.atomic import locked_folder, refuse_unwritable
    from stylesplat.io.scene_folder import revise

    if output is not None:
        with new_scene(output, overwrite=overwrite) as save:
            save(after := change(ss.open(source)))
        return after
    with locked_folder(source):  # from reading on, so that no other process's change is lost
        before = ss.open(source)
        refuse_unwritable(source)
        after = change(before)
        revise(before, after, source)
        with suppress(StyleSplatError):
            _update_pictures(before, after, source)
    return after


def _update_pictures(before: "ss.Scene", after: "ss.Scene", folder: Path) -> None:
    """Move the pictures of renamed selections, and delete those that show something else now."""
    for name in {**after.objects, **before.objects}:  # new names first
        was = before.objects.get(name)
        if after.objects.get(name) is not was:
            picture = selection_file(folder, name)
            now = [other for other, each in after.objects.items() if each is was]
            with suppress(OSError):
                picture.replace(selection_file(folder, now[0])) if now else picture.unlink()


def selection_file(scene: Path, name: str) -> Path:
    """The picture of a selection."""
    return resolve_within(scene, f"selections/{file_stem(name)}.png")


def draw_before_after(scene: "ss.Scene", folder: Path, *, device: str = "auto") -> Answer:
    """Draw a painted scene before and after, in the view that shows most of its objects."""
    from stylesplat.figures.sheets import before_after
    from stylesplat.io.images import write_image

    target = folder / BEFORE_AFTER
    with optional_picture():
        target.unlink(missing_ok=True)  # it shows an earlier painting
        found = before_after(scene, device=device)
        if found is not None:
            view, picture = found
            write_image(picture, target)
            values = {"before_after": target, "before_after_view": view}
            return Answer(values, [f"Picture: {target} (view {view})"])
    return Answer({"before_after": None})


def describe_scene(
    scene: "ss.Scene",
    capture: "ss.Capture | None",
    folder: Path,
    *,
    device: str = "auto",
    photos: bool = True,
) -> Answer:
    """Describe a new scene, and draw one of its views beside the photo, a held-out one if any.

    `photos` says whether it was made from photos; without them its views can be masked.
    """
    from stylesplat.figures.sheets import beside_photo, one_view
    from stylesplat.io.images import write_image

    views = scene.held_out or scene.cameras.names
    view = views[len(views) // 2]
    target = folder / ("view.png" if capture is None else "photo_and_render.png")
    labelled, names = scene.splats.classifier is not None, sorted(scene.objects)
    values = {"scene": folder, "picture": None, "objects": names, "labelled": labelled}
    lines = [f"Objects: {', '.join(names)}."] if names else []
    with optional_picture():
        if capture is None:
            picture = one_view(scene, view, device=device)
        else:
            picture = beside_photo(scene, capture, view, device=device)
        write_image(picture, target)
        values["picture"] = target
        lines = [f"Picture: {target}", *lines]
    commands = object_commands(folder, names, labelled=labelled, photos=photos)
    return Answer(values, lines, commands)


@contextmanager
def optional_picture(of: str = "") -> Iterator[None]:
    """Draw a picture within the block; if that fails, say so and go on."""
    try:
        yield
    except (StyleSplatError, MemoryError, RuntimeError, OSError) as error:  # RuntimeError: CUDA
        what = f"There is no picture of {of}" if of else "There is no picture"
        say(f"{what}: {user_message(error) or reason(error)}")


def unused(near: Path, ending: str) -> Path:
    """A path beside a file or folder, such as `garden-scene`, that does not exist."""
    stem, dot, suffix = ending.partition(".")
    folder = near if near.name else near.resolve()  # `.` and `..` have no name of their own
    place, number = folder.with_name(f"{folder.name}{ending}"), 2
    while place.exists():
        place = folder.with_name(f"{folder.name}{stem}-{number}{dot}{suffix}")
        number += 1
    return place


def next_command(verb: str, source: Path, *options: object, ending: str = "") -> str:
    """A command whose result lies beside what it works on, by a name that is free."""
    return shell_command(verb, source, *options, "-o", unused(source, ending or ENDINGS[verb]))


def stylize_command(scene: Path, name: str) -> str:
    return next_command("stylize", scene, "--style", f"{name}={COMMAND_PICTURE}")


def mask_command(capture: Path, view: str = "PHOTO") -> str:
    return shell_command("mask", capture, "--box", f"NAME={view}:x0,y0,x1,y1")


def object_commands(
    scene: Path, names: Sequence[str], *, labelled: bool, photos: bool = True
) -> list[str]:
    """The way to an object to paint, which has a name, a label id, or neither."""
    if names:
        return [stylize_command(scene, names[0])]
    if labelled:
        return [
            shell_command("objects", scene),
            shell_command("select", scene, "--name", "NAME", "--id", "ID"),
        ]
    click = shell_command("select", scene, "--name", "NAME", "--point", "VIEW:x,y")
    look = next_command("render", scene, ending="-views")
    return [look, click if photos else mask_command(scene, "VIEW")]


def exit_status(error: BaseException, command: object = None) -> int | None:
    """Say why a command failed, and what to do about it; None if the error is a bug."""
    if isinstance(error, KeyboardInterrupt):
        return report_interruption(error, getattr(command, "after_interruption", WHOLE))
    if isinstance(error, BrokenPipeError):
        with Path(os.devnull).open("wb") as nowhere:  # for what Python still writes at its end
            for stream in (sys.stdout, sys.stderr):
                with suppress(OSError, ValueError):
                    os.dup2(nowhere.fileno(), stream.fileno())
        return PIPE_CLOSED
    line = user_message(error)
    if line is None:
        error.add_note(BUG)
        return None
    write_lines(f"stylesplat: {line}")
    return 1


def _gpu_memory_line(wanted: str, capacity: str, free: str) -> str:
    return (
        f"Out of GPU memory: {wanted} more were needed, and {free} of {capacity} are free. Close "
        "other programs that use the GPU, pass a smaller --max-memory or --max-gaussians where the "
        "command has it, or --device cpu."
    )


def user_message(error: BaseException) -> str | None:
    """The fact and the remedy; None if the user can do nothing about the error."""
    if isinstance(error, StyleSplatError):
        return str(error)
    text = str(error).lower()
    full = isinstance(error, OSError) and error.errno in FILE_DISK_FULL
    if not full and (
        isinstance(error, MemoryError) or any(words in text for words in COMMAND_NO_MEMORY)
    ):
        lacked = OUT_OF_GPU_MEMORY.search(str(error))
        return _gpu_memory_line(*lacked.groups()) if lacked else OUT_OF_MEMORY
    if not isinstance(error, OSError):
        return None
    place = f": {error.filename}" if error.filename else ""
    if full:
        return f"Disk full{place}. Free some space and try again."
    return f"{error.strerror or reason(error)}{place}. Mend that and try again."
