"""Saves a scene, and autosaves it against crashes."""

import os
import shutil
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from stylesplat.errors import StyleSplatError
from stylesplat.io import scene_folder
from stylesplat.io.atomic import changing, refuse_unwritable
from stylesplat.io.json_files import read_json_as, write_json
from stylesplat.scene.scene import check_name
from stylesplat.studio_app.history import StudioState, replace_scene
from stylesplat.studio_app.session import Session

AUTOSAVE = "autosave"  # the folder inside a scene's
COMMANDS = "commands.json"  # in that folder

Stamp = dict[str, tuple[int, int]]


@dataclass(frozen=True)
class AutosavedCommands:
    """The commands in an autosave; see `StudioState`."""

    commands: tuple[tuple[str, ...], ...] = ()


class SceneStore:
    """Saves a scene into its folder, which other programs may change meanwhile."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._stamp = _stamp(folder)
        self._autosaved: tuple[StudioState, Stamp] | None = None  # content of `AUTOSAVE`, if known

    def save(self, session: Session) -> None:
        scene = session.state.scene
        with changing(self.folder):
            if _stamp(self.folder) != self._stamp:
                raise StyleSplatError(
                    f"Another program has changed {self.folder}. Save the scene under another name."
                )
            refuse_unwritable(self.folder)
            scene_folder.revise(session.saved.scene, scene, self.folder)
            self._stamp = _stamp(self.folder)
        self._finish_save(session, f"Saved {self.folder}.")

    def save_as(self, session: Session, name: str) -> None:
        """Save the scene into a new folder beside its own, and work on that."""
        check_name(name)  # no slashes: it is a name and no path
        if name.startswith("."):
            raise StyleSplatError("A name must not begin with a dot. Choose another one.")
        folder = self.folder.resolve().parent / name
        scene_folder.save(session.state.scene, folder)
        self._remove_autosave()
        self.folder, self._stamp = folder, _stamp(folder)
        self._finish_save(session, f"Saved {folder}.")

    def _finish_save(self, session: Session, line: str) -> None:
        session.saved = session.state
        self._remove_autosave()
        session.tell(line)
        session.on_change.call()

    def _remove_autosave(self) -> None:
        self._autosaved = None
        with suppress(OSError):
            shutil.rmtree(self.folder / AUTOSAVE)

    def autosave(self, session: Session) -> bool:
        """Save an unsaved scene into its own autosave folder; returns whether it was unsaved."""
        state, folder = session.state, self.folder / AUTOSAVE
        last, stamp = self._autosaved or (None, None)
        if _stamp(folder) != stamp:  # another program has changed it
            last = None
        if not session.unsaved:
            if last is not None:  # all changes were undone
                self._remove_autosave()
            return False
        if last is not None and state.scene is last.scene and state.commands == last.commands:
            return True
        refuse_unwritable(self.folder)
        self._autosaved = None  # until all is written
        if last is not None:
            scene_folder.revise(last.scene, state.scene, folder)
        else:
            scene_folder.save(state.scene, folder, overwrite=True)
        known = len(session.saved.commands)
        if state.commands[:known] == session.saved.commands:
            write_json({"commands": state.commands[known:]}, folder / COMMANDS)
        else:  # a saved change was undone
            (folder / COMMANDS).unlink(missing_ok=True)
        self._autosaved = state, _stamp(folder)
        return True

    def recover(self, state: StudioState) -> StudioState | None:
        """The state in the autosave of an earlier run, if there is one."""
        kept = self.folder / AUTOSAVE
        if not kept.is_dir():
            return None
        stamp = _stamp(kept)
        scene = replace(scene_folder.open(kept), path=state.scene.path)
        found, remedy = AutosavedCommands(), f"Remove {kept / COMMANDS}."
        if (kept / COMMANDS).exists():
            found = read_json_as(kept / COMMANDS, AutosavedCommands, remedy)
        state = replace_scene(state, scene, "Recovered what was not saved")
        state = replace(state, commands=(*state.commands, *found.commands))
        self._autosaved = state, stamp
        return state


def _stamp(folder: Path) -> Stamp:
    """Times and sizes of the files in a folder, which tell whether they have changed."""
    try:
        files = [entry for entry in os.scandir(folder) if entry.is_file()]
        return {file.name: (file.stat().st_mtime_ns, file.stat().st_size) for file in files}
    except OSError:
        return {}
