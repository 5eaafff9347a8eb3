import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from stylesplat.errors import StyleSplatError
from stylesplat.studio_app.gallery import Gallery
from stylesplat.studio_app.paint_panel import highlight_region, region_in_pixels
from stylesplat.studio_app.thumbnails import COLUMNS, SIDE, shorten, thumbnail_grid


def picture(width: int = 64, height: int = 48) -> bytes:
    file = io.BytesIO()
    Image.new("RGB", (width, height), (200, 30, 90)).save(file, "PNG")
    return file.getvalue()


def test_a_folder_hangs_its_pictures_and_tells_what_is_none(tmp_path: Path, said: list[str]):
    (tmp_path / "wave.png").write_bytes(picture())
    (tmp_path / "bad.png").write_bytes(b"no picture")
    (tmp_path / "notes.txt").write_text("no picture either")
    gallery = Gallery(tmp_path)
    (wave,) = gallery.pictures.values()
    assert (wave.title, wave.size, wave.thumbnail.shape) == ("wave", (64, 48), (SIDE, SIDE, 3))
    assert len(said) == 1 and "bad.png" in said[0]


def test_uploads_are_checked_and_their_names_are_no_paths(monkeypatch: pytest.MonkeyPatch):
    gallery = Gallery()
    evil = gallery.upload("../../etc/passwd\x00.png", picture())
    assert evil.path.exists() and "etc" not in str(evil.path) and ".." not in str(evil.path)
    assert gallery.upload("passwd.png", picture()).title != evil.title, "titles differ"
    with pytest.raises(StyleSplatError, match="the image a: it is no picture"):  # no path of ours
        gallery.upload("a.png", b"text")
    with pytest.raises(StyleSplatError, match="too little"):
        gallery.upload("a.png", picture(8, 8))
    monkeypatch.setattr("stylesplat.studio_app.gallery.MOST_BYTES", 100)
    with pytest.raises(StyleSplatError, match="at most"):
        gallery.upload("a.png", picture(500, 500))
    gallery.close()
    assert not evil.path.exists()


def test_a_missing_folder_is_told(tmp_path: Path):
    with pytest.raises(StyleSplatError, match="no folder"):
        Gallery(tmp_path / "none")


def test_parts_of_a_picture_are_pixels():
    assert region_in_pixels((25.0, 100.0), (0.0, 50.0), (200, 80)) == (50, 0, 200, 40)


def test_all_but_the_part_is_dark():
    image = np.full((80, 200, 3), 200, np.uint8)
    found = highlight_region(image, (25.0, 100.0), (0.0, 50.0))
    assert (found[:40, 50:] == 200).all() and (found[45:] == 60).all()
    assert highlight_region(image, (0.0, 100.0), (0.0, 100.0)) is image


def test_thumbnail_grids_hold_all_pictures_and_mark_the_picked_ones():
    blank = np.zeros((SIDE, SIDE, 3), np.uint8)
    sheet = thumbnail_grid([blank] * (COLUMNS + 1), list("abcd"), [False, True, False, False])
    assert sheet.shape[1] > COLUMNS * SIDE and sheet.shape[0] > 2 * SIDE
    rims = (sheet[..., 0] == 255).any(axis=0).nonzero()[0]
    assert SIDE < rims.min() and rims.max() < 2 * SIDE + 20
    assert shorten("a very long name indeed") == "a very long na…"
