import math
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import ExifTags, Image

from scenes import rand
from stylesplat.errors import StyleSplatError
from stylesplat.io import style_pictures as pictures
from stylesplat.io.style_pictures import MATERIALS, read_style, resize
from stylesplat.stylization.style import Style

PIXELS = np.random.default_rng(0).integers(0, 256, (40, 60, 3), np.uint8)
NOISE = rand(120, 120, 3)


def save(path: Path, pixels: np.ndarray = PIXELS, **how) -> Path:
    Image.fromarray(pixels).save(path, **how)
    return path


def as_bytes(style: torch.Tensor) -> np.ndarray:
    return (255 * style).round().to(torch.uint8).numpy()


@pytest.mark.parametrize(
    "settings",
    [{}, {"rotate": 90.0}, {"rotate": 5.0}, {"region": (3, 2, 50, 39), "rotate": 180.0}],
    ids=str,
)
def test_tensors_are_cropped_and_turned_as_files_are(tmp_path: Path, settings: dict):
    expected = Style(save(tmp_path / "a.png"), **settings).read()[0]
    levels = torch.from_numpy(PIXELS)
    assert torch.equal(Style(levels, **settings).read()[0], expected)
    found = Style(levels.double() / 255, **settings).read()[0]
    torch.testing.assert_close(found, expected, atol=0.5 / 255 + 1e-6, rtol=0)  # levels of files


@pytest.mark.parametrize("name", MATERIALS)
def test_materials_are_pictures_with_texture(name: str):
    (colors,) = Style(f"material:{name}", rotate=90).read()
    assert torch.equal(colors, Style(Path(f"material:{name}"), rotate=90).read()[0])
    assert colors.shape == (512, 512, 3)
    assert float(colors.std()) > 0.05
    assert Style(f"material:{name}").sources()[0].path == Path(f"material:{name}")


def test_unknown_materials_are_refused_with_those_known():
    for use in (Style("material:tin").read, Style("material:tin").sources):
        with pytest.raises(StyleSplatError, match=r"'tin'.+material:bronze.+material:jade"):
            use()


@pytest.mark.parametrize(
    ("colors", "fact"),
    [
        (torch.linspace(0.5, 255, 6000).view(40, 50, 3), "from 0.5 to 255"),
        (torch.linspace(-0.5, 0.5, 6000).view(40, 50, 3), "from -0"),
        (torch.full((40, 50, 3), math.nan), "nan"),
        (torch.rand(40, 31, 3), "31x40"),
    ],
)
def test_tensors_that_are_no_colors_are_refused(colors: torch.Tensor, fact: str):
    with pytest.raises(StyleSplatError, match=fact):
        Style(colors).read()


@pytest.mark.parametrize("degrees", [-270, -90, 0, 90, 180, 270, 360, 450])
def test_quarter_turns_keep_every_pixel(tmp_path: Path, degrees: int):
    style = read_style(save(tmp_path / "a.png"), rotate=float(degrees))
    np.testing.assert_array_equal(as_bytes(style), np.rot90(PIXELS, degrees // 90))
    assert style.min() == 0 and style.max() == 1


def ramp(width: int, height: int) -> np.ndarray:
    """Red tells where a pixel's centre is in x, green in y; four levels a pixel at most."""
    xs, ys = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    return np.stack([255 * xs / width, 255 * ys / height, 0 * xs], axis=-1).round().astype(np.uint8)


@pytest.mark.parametrize("degrees", [-30.0, 45.0, 120.0, 200.0])
@pytest.mark.parametrize("size", [(120, 90), (80, 160)], ids=str)
def test_turning_moves_colours_counter_clockwise(
    tmp_path: Path, size: tuple[int, int], degrees: float
):
    width, height = size
    style = read_style(save(tmp_path / "a.png", ramp(width, height)), rotate=degrees).numpy()
    inner_height, inner_width = style.shape[:2]
    ys, xs = np.mgrid[:inner_height, :inner_width] + 0.5
    right, up = xs - inner_width / 2, inner_height / 2 - ys
    cos, sin = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    # What the picture had there, before all of it was turned the other way
    source_x = width / 2 + cos * right + sin * up
    source_y = height / 2 - (cos * up - sin * right)
    assert source_x.min() >= 0 and source_x.max() <= width, "no empty corners"
    assert source_y.min() >= 0 and source_y.max() <= height, "no empty corners"
    # Half a level for rounding the ramp, which cubic weights raise by 1.25 in x and in y, and half
    # for the result; 1/64 of a pixel, as OpenCV rounds positions to 1/32; half a one at borders
    levels, within = 0.5 * 1.25**2 + 0.5, np.s_[2:-2, 2:-2]
    for channel, source, length in ((0, source_x, width), (1, source_y, height)):
        found, error = style[..., channel] * length, levels * length / 255 + 1 / 64
        np.testing.assert_allclose(found[within], source[within], rtol=0, atol=error)
        np.testing.assert_allclose(found, source, rtol=0, atol=error + 0.5)


def test_a_region_is_of_the_upright_picture(tmp_path: Path):
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation] = 6
    path = save(tmp_path / "a.png", exif=exif)
    upright = np.rot90(PIXELS, -1)
    style = read_style(path, region=(3, 5, 38, 60))
    np.testing.assert_array_equal(as_bytes(style), upright[5:60, 3:38])
    turned = read_style(path, region=(3, 5, 38, 60), rotate=90.0)
    np.testing.assert_array_equal(as_bytes(turned), np.rot90(upright[5:60, 3:38]))
    assert read_style(path, region=(0, 0, 40, 60)).shape == (60, 40, 3)


SMALL = {"a.png": PIXELS, "flat.png": PIXELS[:31], "narrow.png": PIXELS[:, :31]}


@pytest.mark.parametrize(
    ("name", "how", "message"),
    [
        (
            "a.png",
            {"region": (0, 0, 61, 40)},
            r"region 0,0,61,40 of .*a\.png .* reaches outside.* 0,0,60,40",
        ),
        ("a.png", {"region": (-1, 0, 40, 40)}, "reaches outside"),
        ("a.png", {"region": (0, -1, 40, 40)}, "reaches outside"),
        ("a.png", {"region": (0, 0, 40, 41)}, "reaches outside"),
        ("a.png", {"region": (40, 0, 40, 40)}, "is empty .* with x0 < x1"),
        ("a.png", {"region": (0, 40, 40, 0)}, "is empty"),
        ("a.png", {"region": (0, 0, 40, 31)}, r"a\.png is 40x31 pixels, too little .* at least 32"),
        ("a.png", {"rotate": 45.0}, r"Turned by 45\.0, .*a\.png is \d+x\d+ pixels"),
        ("a.png", {"rotate": math.nan}, r"Cannot turn .*a\.png by nan degrees"),
        ("flat.png", {}, r"flat\.png is 60x31 pixels, too little"),
        ("narrow.png", {}, r"narrow\.png is 31x40 pixels, too little"),
        ("none.png", {}, r"There is no image .*none\.png"),
        ("page.png", {}, r"Cannot read the image .*page\.png"),
    ],
)
def test_unfit_pictures_and_regions(tmp_path: Path, name: str, how: dict, message: str):
    (tmp_path / "page.png").write_text("<html>404</html>")
    if name in SMALL:
        save(tmp_path / name, SMALL[name])
    with pytest.raises(StyleSplatError, match=message):
        read_style(tmp_path / name, **how)


def test_transparent_parts_are_white_and_said(tmp_path: Path, said: list[str]):
    alpha = np.full((40, 60, 1), 255, np.uint8)
    alpha[:, :15] = 0
    style = as_bytes(read_style(save(tmp_path / "cut.png", np.dstack([PIXELS, alpha]))))
    assert (style[:, :15] == 255).all() and (style[:, 15:] == PIXELS[:, 15:]).all()
    assert len(said) == 1 and "25% of it is transparent" in said[0]
    path = save(tmp_path / "none.png", np.dstack([PIXELS, 0 * alpha]))
    with pytest.raises(StyleSplatError, match="All of the picture"):
        read_style(path)


@pytest.mark.parametrize("suffix", [".jpg", ".tif"])
def test_pictures_for_print_have_the_colors_that_they_show(tmp_path: Path, suffix: str):
    smooth = np.linspace(0, 255, 40 * 60 * 3).reshape(40, 60, 3).astype(np.uint8)
    Image.fromarray(smooth).convert("CMYK").save(tmp_path / f"print{suffix}", quality=95)
    found = read_style(tmp_path / f"print{suffix}")
    torch.testing.assert_close(found, torch.from_numpy(smooth) / 255, atol=0.03, rtol=0)


def test_huge_pictures_are_scaled_down(tmp_path: Path, said: list[str], capsys, monkeypatch):
    monkeypatch.setattr(pictures, "STYLE_MAX_SIDE", 50)
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 9000)  # below it Pillow would not warn
    pixels = np.random.default_rng(0).integers(0, 256, (100, 100, 3), np.uint8)
    path = save(tmp_path / "a.png", pixels)
    means = pixels.reshape(50, 2, 50, 2, 3).astype(float).mean(axis=(1, 3))
    # Half a level for rounding
    np.testing.assert_allclose(255 * read_style(path).numpy(), means, atol=0.5 + 1e-3)
    assert said == [f"{path}: scaled down from 100x100 to 50x50 pixels"]
    part = read_style(path, region=(60, 50, 100, 100))
    np.testing.assert_array_equal(as_bytes(part), pixels[50:, 60:])
    assert len(said) == 1, "what is left is not huge"
    assert capsys.readouterr() == ("", ""), "the library itself prints nothing"
    with pytest.raises(StyleSplatError, match=r"to 50 pixels of length, .*a\.png is 50x20 pixels"):
        read_style(path, region=(0, 0, 100, 40))


@pytest.mark.parametrize("suffix", ["gif", "png", "webp", "tiff"])
def test_animations_are_refused(tmp_path: Path, suffix: str):
    further = [Image.fromarray(PIXELS[::-1]), Image.fromarray(PIXELS[:, ::-1])]
    path = save(tmp_path / f"a.{suffix}", save_all=True, append_images=further)
    with pytest.raises(StyleSplatError, match=rf"a\.{suffix} has 3 frames .* Save one frame"):
        read_style(path)


def test_a_phones_photo_with_a_second_picture_inside_is_none(tmp_path: Path):
    depth = Image.fromarray(PIXELS[::2, ::2, 0])
    flat = np.full((40, 60, 3), 99, np.uint8)
    path = save(tmp_path / "a.jpg", flat, format="MPO", save_all=True, append_images=[depth])
    assert (as_bytes(read_style(path)) == 99).all()


def test_resizing_keeps_the_shape_and_averages(stripes: torch.Tensor):
    assert resize(stripes, 24.0).shape == (20, 24, 3)
    assert resize(stripes.transpose(0, 1), 96.0).shape == (96, 80, 3)
    assert resize(NOISE, 8.0).std() < 0.1 * NOISE.std()
    torch.testing.assert_close(resize(NOISE, 8.0).mean(), NOISE.mean(), atol=0.01, rtol=0)
