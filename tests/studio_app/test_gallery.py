import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from stylesplat.errors import StyleSplatError
from stylesplat.studio_app.gallery import KEPT_STYLES, Gallery


def picture(width: int = 64, height: int = 48, red: int = 200) -> bytes:
    file = io.BytesIO()
    Image.new("RGB", (width, height), (red, 30, 90)).save(file, "PNG")
    return file.getvalue()


def test_a_folder_hangs_its_pictures_and_tells_what_is_none(tmp_path: Path, said: list[str]):
    (tmp_path / "wave.png").write_bytes(picture())
    (tmp_path / "bad.png").write_bytes(b"no picture")
    (tmp_path / "notes.txt").write_text("no picture either")
    gallery = Gallery(tmp_path)
    (wave,) = gallery.pictures.values()
    assert (wave.title, wave.size) == ("wave", (64, 48))
    found = gallery.files.get(wave.url.split("/")[2])
    assert found is not None and Image.open(io.BytesIO(found[1])).size == (64, 48)
    assert len(said) == 1 and "bad.png" in said[0]


def test_uploads_are_checked_and_their_names_are_no_paths(monkeypatch: pytest.MonkeyPatch):
    gallery = Gallery()
    evil = gallery.upload("../../etc/passwd\x00.png", picture())
    assert evil.path.exists() and "etc" not in str(evil.path) and ".." not in str(evil.path)
    assert gallery.upload("passwd.png", picture(red=9)).title != evil.title, "titles differ"
    with pytest.raises(StyleSplatError, match="the image a: it is no picture"):  # no path of ours
        gallery.upload("a.png", b"text")
    with pytest.raises(StyleSplatError, match="too little"):
        gallery.upload("a.png", picture(8, 8))
    monkeypatch.setattr("stylesplat.studio_app.gallery.MOST_BYTES", 100)
    with pytest.raises(StyleSplatError, match="at most"):
        gallery.upload("a.png", picture(500, 500))
    gallery.close()
    assert not evil.path.exists()


def test_what_pages_send_stays_with_the_scene(tmp_path: Path):
    gallery = Gallery(kept=tmp_path / "scene" / KEPT_STYLES)
    assert gallery.upload("early.png", picture()).path.exists(), "there is no folder of a scene"
    (tmp_path / "scene").mkdir()
    first, second = (gallery.upload("wave.png", picture(red=red)) for red in (10, 100))
    assert first.own and first.path != second.path
    assert gallery.upload("again.png", picture(red=10)) == first
    assert not first.path.with_name("again.png").exists(), "it stands on the shelf once"
    gallery.close()
    again = Gallery(kept=tmp_path / "scene" / KEPT_STYLES)
    assert {*again.pictures} == {"wave", "wave 2"} and all(e.own for e in again.pictures.values())
    (tmp_path / "other").mkdir()
    again.move_along(tmp_path / "other")
    assert len([*(tmp_path / "other" / KEPT_STYLES).iterdir()]) == 2


def test_the_colours_of_a_picture_are_shown_the_most_frequent_first(tmp_path: Path):
    image = Image.new("RGB", (60, 40), (200, 30, 90))
    image.paste((10, 20, 220), (0, 0, 20, 40))
    image.save(tmp_path / "two.png")
    first, second, *_ = Gallery(tmp_path).pictures["two"].colors
    rgb = [[int(each[n : n + 2], 16) for n in (1, 3, 5)] for each in (first, second)]
    assert np.abs(np.subtract(rgb, [(200, 30, 90), (10, 20, 220)])).max() < 12
