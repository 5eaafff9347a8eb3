import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from capture_files import film, save, view, walk
from stylesplat.errors import StyleSplatError
from stylesplat.io.images import read_image
from stylesplat.photo_libraries import pycolmap
from stylesplat.structure_from_motion.prepare import prepare


def test_plain_photos_are_taken_as_they_are(tmp_path: Path):
    source = walk(tmp_path / "my photos")
    film(source / "IMG_8.mov", [view(0)])
    prepared = prepare(source, tmp_path / "out")
    assert prepared.names == tuple(f"IMG_{i}.jpg" for i in range(8, 13))  # not 10 before 8
    assert prepared.ordered
    assert prepared.left_out == {"IMG_8.mov": "a video among photos"}
    assert prepared.origins == {name: name for name in prepared.names}
    assert all(0.5 < sharp < 2 for sharp in prepared.sharpness.values())
    for name in prepared.names:
        copy, photo = tmp_path / "out" / name, (source / name).read_bytes()
        assert copy.read_bytes() == photo
        copy.write_bytes(b"edited in place")
        assert (source / name).read_bytes() == photo
    (source / "IMG_8.mov").unlink()
    assert not prepare(source, tmp_path / "out").left_out


@pytest.mark.parametrize("suffix", ["jpg", "HEIC"])
def test_rotated_photos_become_upright_and_keep_their_focal_length(tmp_path: Path, suffix: str):
    for index in range(3):
        turned, file = np.rot90(view(index * 24)), tmp_path / "in" / f"{index}.{suffix}"
        save(file.with_suffix(".jpg"), turned, orientation=6, focal=26)
        if suffix == "HEIC":
            heif = pytest.importorskip("pillow_heif")
            with Image.open(file.with_suffix(".jpg")) as image:
                exif = image.info["exif"]
            picture = heif.from_pillow(Image.fromarray(np.ascontiguousarray(turned)))
            picture.save(file, quality=90, exif=exif)
            file.with_suffix(".jpg").unlink()
    assert prepare(tmp_path / "in", tmp_path / "out").names == ("0.jpg", "1.jpg", "2.jpg")
    written = tmp_path / "out" / "1.jpg"
    assert np.abs(read_image(written).numpy() - view(24).astype(int)).mean() < 8  # coded twice
    camera = pycolmap.infer_camera_from_image(written)
    assert camera.has_prior_focal_length
    assert camera.focal_length == pytest.approx(26 * 400 / np.hypot(36, 24), rel=1e-3)


def test_whatever_is_not_plain_rgb_is_converted(tmp_path: Path):
    pictures = [Image.fromarray(view(index * 24)) for index in range(6)]
    alpha = pictures[3].convert("RGBA")
    alpha.putpixel((0, 0), (0, 0, 0, 0))
    (tmp_path / "in").mkdir()
    pictures[0].convert("L").save(tmp_path / "in" / "0.jpg")
    pictures[1].convert("CMYK").save(tmp_path / "in" / "1.jpg")
    pictures[2].save(tmp_path / "in" / "2.TIFF")
    alpha.save(tmp_path / "in" / "3.png")
    deep = np.asarray(pictures[4].convert("L")).astype(np.uint16) * 257
    Image.fromarray(deep).save(tmp_path / "in" / "4.png")
    pictures[5].save(tmp_path / "in" / "5.webp", lossless=True)
    prepared = prepare(tmp_path / "in", tmp_path / "out")
    assert prepared.names == tuple(f"{i}.jpg" for i in range(6))
    for index, name in enumerate(prepared.names):
        with Image.open(tmp_path / "out" / name) as image:
            assert image.mode == "RGB"
            grey = np.asarray(image.convert("L")).astype(int)
        off = np.abs(grey - np.asarray(pictures[index].convert("L"))).mean()
        assert off < 6, name  # CMYK and JPEG are not exact


def test_names_of_all_kinds_stay_apart(tmp_path: Path):
    names = ("ä ö/1 (2).JPG", "ä ö/2.jpeg", "ä ö/2.png", "c/3.tif", "c/3.jpg", "C4.Png")
    for index, name in enumerate(names):
        save(tmp_path / "in" / name, view(index * 24))
    for name in (".hidden/1.jpg", "object_mask/2.jpg", "x.partial/3.jpg", "._1.jpg"):
        save(tmp_path / "in" / name, view(200))
    (tmp_path / "in" / "notes.txt").write_text("nothing")
    prepared = prepare(tmp_path / "in", tmp_path / "in" / "out")
    assert sorted(prepared.origins.values()) == sorted(names)
    stems = {Path(name).with_suffix("").as_posix().casefold() for name in prepared.names}
    assert len(stems) == len(names)
    assert not prepared.ordered
    assert all((tmp_path / "in" / "out" / name).is_file() for name in prepared.names)
    out = tmp_path / "in" / "out"
    kept, gone = (out / name for name in prepared.names[:2])
    before = kept.stat()
    gone.rename(gone.with_name(".2.0123456789ab.jpg"))  # what a killed process leaves
    assert prepare(tmp_path / "in", out) == prepared  # skips what it wrote
    assert kept.stat() == before and gone.is_file()


def test_unreadable_blurred_and_repeated_photos_are_left_out(tmp_path: Path):
    source = walk(tmp_path / "in", 8)
    whole = (source / "IMG_9.jpg").read_bytes()
    (source / "cut.jpg").write_bytes(whole[: len(whole) // 2])
    (source / "text.jpg").write_text("no picture")
    (source / "raw.DNG").write_bytes(b"raw")
    save(source / "IMG_17.jpg", view(200, blur=12))
    with Image.open(source / "IMG_10.jpg") as image:
        image.resize((160, 120)).save(source / "IMG_10 copy.png")
    prepared = prepare(source, tmp_path / "out")
    assert prepared.names == tuple(f"IMG_{i}.jpg" for i in range(8, 16))
    left_out = dict(prepared.left_out)
    assert left_out.pop("cut.jpg").startswith("no readable picture: ")
    assert left_out.pop("text.jpg").startswith("no readable picture: it is no picture")
    assert left_out == {
        "raw.DNG": "a raw file; give JPEG",
        "IMG_17.jpg": "blurred",
        "IMG_10 copy.png": "nearly the same as IMG_10.jpg",
    }


def test_a_record_writes_and_reads_nothing_outside(tmp_path: Path):
    source, out = walk(tmp_path / "in"), tmp_path / "a" / "b" / "out"
    prepare(source, out)
    record = out / ".prepared.json"
    whole = record.read_text()
    record.write_text(whole.replace('"IMG_9.jpg":', '"../../../victim.jpg":'))
    with pytest.raises(StyleSplatError, match=r"victim.jpg' leads out of the folder"):
        prepare(source, out)
    assert {path.name for path in tmp_path.iterdir()} == {"in", "a"}
    hostile = json.loads(whole)
    hostile["prepared"]["origins"]["IMG_9.jpg"] = "../secret.jpg"
    record.write_text(json.dumps(hostile))
    (out / "IMG_9.jpg").unlink()
    save(tmp_path / "secret.jpg", view(0))
    with pytest.raises(StyleSplatError, match=r"secret.jpg' leads out of the folder"):
        prepare(source, out)


def test_what_changed_is_written_again_and_what_went_is_removed(tmp_path: Path):
    source, out = walk(tmp_path / "in", 5), tmp_path / "out"
    save(source / "sub" / "IMG_13.jpg", view(5 * 24))
    prepare(source, out)
    save(source / "IMG_9.jpg", view(24 + 7))
    (source / "sub" / "IMG_13.jpg").unlink()
    assert len(prepare(source, out).names) == 5
    assert not (out / "sub").exists()
    assert (out / "IMG_9.jpg").read_bytes() == (source / "IMG_9.jpg").read_bytes()


def test_blurred_photos_only(tmp_path: Path):
    for index in range(4):
        small = cv2.resize(view(index * 24), (64, 48), interpolation=cv2.INTER_AREA)
        blurred = cv2.GaussianBlur(cv2.resize(small, (640, 480)), (0, 0), 8)
        save(tmp_path / "in" / f"{index}.jpg", blurred)
    with pytest.raises(StyleSplatError, match="all blurred"):
        prepare(tmp_path / "in", tmp_path / "out")


@pytest.mark.parametrize("level", [0, 255, 90, None])
def test_photos_without_background(tmp_path: Path, level: int | None):
    for index in range(4):
        masked = np.full((480, 640, 3), level or 0, np.uint8)
        masked[120:480, 200:440] = cv2.resize(view(index * 24), (240, 360))  # to the lower edge
        alpha = np.where(masked.any(axis=2, keepdims=True), 255, 0).astype(np.uint8)
        pixels = np.dstack([masked, alpha]) if level is None else masked
        save(tmp_path / "in" / f"{index}.png", pixels)
    save(tmp_path / "in" / "whole.jpg", view(200))
    prepared = prepare(tmp_path / "in", tmp_path / "out")
    assert prepared.cut_outs and len(prepared.names) == 4
    assert prepared.left_out == {"whole.jpg": "it has a background, which most photos lack"}


@pytest.mark.parametrize("plain", [1, 3])
def test_a_white_backdrop_is_no_mask_where_other_photos_show_its_edge(tmp_path: Path, plain: int):
    for index in range(5):
        photo = np.full((480, 640, 3), 255, np.uint8)
        photo[120:400, 200:440] = cv2.resize(view(index * 24), (240, 280))
        if index >= plain:
            photo[468:] = photo[:, :8] = 40  # where the backdrop ends
        save(tmp_path / "in" / f"{index}.png", photo)
    prepared = prepare(tmp_path / "in", tmp_path / "out")
    assert len(prepared.names) == 5 and not prepared.cut_outs and not prepared.left_out


def test_sources_that_are_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    posed, films, out = tmp_path / "posed", tmp_path / "films", tmp_path / "out"
    walk(posed / "images")
    (posed / "sparse" / "0").mkdir(parents=True)
    (posed / "sparse" / "0" / "cameras.bin").write_bytes(b"")
    films.mkdir()
    (films / "a.mp4").write_bytes(b"")
    (films / "b.MOV").write_bytes(b"")
    (tmp_path / "empty").mkdir()
    few = walk(tmp_path / "few", 2)
    (few / "text.jpg").write_text("no picture")
    for source, message in (
        (tmp_path / "none", "no folder or video"),
        (tmp_path / "empty", "has no photos"),
        (walk(tmp_path / "lone", 1), "has 1 photo that"),
        (few, r"has 2 photos .* 1 left out: text\.jpg \(no readable picture"),
        (posed / "images" / "IMG_8.jpg", "is one photo"),
        (posed, "has its poses already .sparse.*find new ones"),
        (films, "2 videos: a.mp4, b.MOV. Give one"),
    ):
        with pytest.raises(StyleSplatError, match=message):
            prepare(source, out)
    with pytest.raises(StyleSplatError, match="Cannot choose 2 frames"):
        prepare(posed / "images", out, frames=2)
    (few / "a.heic").write_bytes(b"\0\0\0\x18ftypheic\0\0\0\0mif1heic")
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(StyleSplatError, match=r"pip install 'stylesplat\[heic\]'"):
        prepare(few, out)
