import io
from pathlib import Path

import pytest
from PIL import Image

from stylesplat.errors import StyleSplatError
from stylesplat.studio_app.gallery import Gallery


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
    assert (wave.title, wave.size) == ("wave", (64, 48))
    found = gallery.files.get(wave.url.split("/")[2])
    assert found is not None and Image.open(io.BytesIO(found[1])).size == (64, 48)
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
