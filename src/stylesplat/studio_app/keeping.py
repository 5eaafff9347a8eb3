"""What the panel Keep does: scenes saved, kept against crashes, and given to other programs."""

import io
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from PIL import Image

from stylesplat.errors import StyleSplatError
from stylesplat.figures.web_page import SUFFIX
from stylesplat.io import scene_folder
from stylesplat.io.atomic import changing, refuse_unwritable
from stylesplat.io.json_files import read_json_as, write_json
from stylesplat.io.splats.splat_files import COMPRESSED
from stylesplat.io.video import write_video
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.scene import Scene, check_name
from stylesplat.studio_app.session import Progress, Session
from stylesplat.studio_app.studio_state import State, with_scene
from stylesplat.verbs.export import export
from stylesplat.verbs.orbit import orbit

AUTOSAVE = "autosave"  # the folder inside a scene's
COMMANDS = "commands.json"  # in that folder
FORMATS = (".ply", COMPRESSED, ".spz", ".splat", ".sog", ".glb", SUFFIX)
FRAMES = 120  # of a turntable: four seconds
TURNTABLE = 960  # pixels along its longer side
MOST_PIXELS = 8192  # along a side of a still picture

Stamp = dict[str, tuple[int, int]]


@dataclass(frozen=True)
class Told:
    """What an earlier run did to the scene in the folder."""

    commands: tuple[tuple[str, ...], ...] = ()
    """See `State`."""


class Place:
    """The folder of a scene, which others may change meanwhile."""

    def __init__(self, folder: Path) -> None:
        """Remember how it is now."""
        self.folder = folder
        self._stamp = _stamp(folder)
        self._kept: tuple[State, Stamp] | None = None  # what its `AUTOSAVE` holds, if we know

    def save(self, session: Session) -> None:
        """Write the scene as it is now; paintings can be taken back from it.

        Raises:
            StyleSplatError: If the folder cannot be written, or was changed since it was read.
        """
        scene = session.state.scene
        with changing(self.folder):
            if _stamp(self.folder) != self._stamp:
                raise StyleSplatError(
                    f"{self.folder} was changed by somebody else meanwhile. Save the scene under "
                    "another name."
                )
            refuse_unwritable(self.folder)
            scene_folder.revise(session.saved.scene, scene, self.folder)
            self._stamp = _stamp(self.folder)
        self._now_saved(session, f"Saved {self.folder}.")

    def save_as(self, session: Session, name: str) -> None:
        """Write the scene to another folder beside its own, and go on there.

        Raises:
            StyleSplatError: If it cannot be called so, or there is something.
        """
        check_name(name)  # no slashes: it is a name and no path
        if name.startswith("."):
            raise StyleSplatError("A name must not begin with a dot. Choose another one.")
        folder = self.folder.resolve().parent / name
        scene_folder.save(session.state.scene, folder)
        self._remove_autosave()
        self.folder, self._stamp = folder, _stamp(folder)
        self._now_saved(session, f"Saved {folder}.")

    def _now_saved(self, session: Session, line: str) -> None:
        session.saved = session.state
        self._remove_autosave()
        session.tell(line)
        session.tell_change()

    def _remove_autosave(self) -> None:
        self._kept = None
        with suppress(OSError):
            shutil.rmtree(self.folder / AUTOSAVE)

    def autosave(self, session: Session) -> bool:
        """Keep the scene in its folder if it differs from what is saved; whether it does.

        Only what changed since the last time is written.

        Raises:
            StyleSplatError: If it cannot be written.
        """
        state, folder = session.state, self.folder / AUTOSAVE
        last, stamp = self._kept or (None, None)
        if _stamp(folder) != stamp:  # somebody else's
            last = None
        if not session.unsaved:
            if last is not None:  # it was undone
                self._remove_autosave()
            return False
        if last is not None and state.scene is last.scene and state.commands == last.commands:
            return True
        refuse_unwritable(self.folder)
        self._kept = None  # until all is written
        if last is not None:
            scene_folder.revise(last.scene, state.scene, folder)
        else:
            scene_folder.save(state.scene, folder, overwrite=True)
        known = len(session.saved.commands)
        if state.commands[:known] == session.saved.commands:
            write_json({"commands": state.commands[known:]}, folder / COMMANDS)
        else:  # something was undone that is saved
            (folder / COMMANDS).unlink(missing_ok=True)
        self._kept = state, _stamp(folder)
        return True

    def recovered(self, state: State) -> State | None:
        """What an earlier run left unsaved; None if it left nothing.

        Raises:
            StyleSplatError: If it is damaged.
        """
        kept = self.folder / AUTOSAVE
        if not kept.is_dir():
            return None
        stamp = _stamp(kept)
        scene = replace(scene_folder.open(kept), path=state.scene.path)
        told, remedy = Told(), f"Remove {kept / COMMANDS}."
        if (kept / COMMANDS).exists():
            told = read_json_as(kept / COMMANDS, Told, remedy)
        state = with_scene(state, scene, "Recovered what was not saved")
        state = replace(state, commands=(*state.commands, *told.commands))
        self._kept = state, stamp
        return state


def exported(scene: Scene, ending: str) -> bytes:
    """The scene's splats as a file of another program, or as a page.

    Raises:
        StyleSplatError: As `export` does.
    """
    with tempfile.TemporaryDirectory(prefix="stylesplat-studio-") as folder:
        path = Path(folder) / f"scene{ending}"
        export(scene, path)
        return path.read_bytes()


def still(
    session: Session, camera: Cameras, width: int, behind: tuple[float, float, float]
) -> bytes:
    """A PNG of what a camera sees, so many pixels wide, without a glow.

    Raises:
        StyleSplatError: If it is too wide.
    """
    if not 1 <= width <= MOST_PIXELS:
        raise StyleSplatError(f"A picture has 1 to {MOST_PIXELS} pixels a side, not {width}.")
    camera = camera.downscale(float(camera.sizes[0, 0]) / width)
    pixels = replace(session.shown, glowing=None).render(camera, behind)
    return png(pixels.numpy())


def png(pixels: "object") -> bytes:
    """Pixels as a file."""
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, "PNG")  # pyright: ignore[reportArgumentType]
    return file.getvalue()


def turntable(
    session: Session, behind: tuple[float, float, float], done: "list[bytes]", count: int
) -> Iterator[None]:
    """Make a video of a round trip, frame by frame.

    Args:
        session: Of whose scene.
        behind: The colour behind it.
        done: Gets the file in the end.
        count: Of frames.
    """
    scene, seen = session.state.scene, replace(session.shown, glowing=None)
    cameras, frames = orbit(scene, frames=count).at_most(TURNTABLE), list[torch.Tensor]()
    for row in range(count):
        frames.append(seen.render(cameras[row], behind))
        session.progress = Progress(f"Turntable, frame {row + 1} of {count}", (row + 1) / count)
        session.tell_progress()
        yield
    with tempfile.TemporaryDirectory(prefix="stylesplat-studio-") as folder:
        path = Path(folder) / "turntable.mp4"
        write_video(frames, path)
        done.append(path.read_bytes())


def _stamp(folder: Path) -> Stamp:
    """What tells whether a folder's files were changed."""
    try:
        files = [entry for entry in os.scandir(folder) if entry.is_file()]
        return {file.name: (file.stat().st_mtime_ns, file.stat().st_size) for file in files}
    except OSError:
        return {}
