from pathlib import Path

import pytest

from balls import TRAINED, opened, painted, painting_quickly, write_pictures
from stylesplat.io import scene_folder


@pytest.fixture(scope="session")
def stack(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of scenes, not to be changed, and of two pictures, `wave.png` and `night.png`.

    In `trained` are the balls; in `once` red is painted on a canvas; in `twice` green as well, on
    its own Gaussians.
    """
    folder = tmp_path_factory.mktemp("stack")
    wave, night = write_pictures(folder)
    scene_folder.save(TRAINED, folder / "trained")
    with painting_quickly():
        once = painted(opened(folder / "trained"), "red", wave, measured=False)
        scene_folder.save(once, folder / "once")
        twice = painted(opened(folder / "once"), "green", night, quality="draft", measured=False)
        scene_folder.save(twice, folder / "twice")
    return folder
