import io
import json
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image
from torch import Tensor

from scenes import random_splats
from stylesplat.errors import StyleSplatError
from stylesplat.io.kinds import kind_of, refuse_other_than_photos
from stylesplat.io.splats.packing import morton_order
from stylesplat.io.splats.splat_files import read_splats, write_splats

COUNT = 100
Files = dict[str, bytes]
PLAIN = replace(random_splats(COUNT), identities=None)
ORDER = morton_order(PLAIN.means)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Files:
    path = tmp_path_factory.mktemp("sog") / "a.sog"
    write_splats(PLAIN, path)
    with zipfile.ZipFile(path) as bundle:
        return {name: bundle.read(name) for name in bundle.namelist()}


def bundled(files: Files, path: Path, **options: Any) -> Path:
    with zipfile.ZipFile(path, "w", **options) as bundle:
        for name, content in files.items():
            bundle.writestr(name, content)
    return path


def laid_out(files: Files, folder: Path) -> Path:
    folder.mkdir()
    for name, content in files.items():
        (folder / name).write_bytes(content)
    return folder / "meta.json"


def declaring(files: Files, change: Callable[[dict[str, Any]], object]) -> Files:
    meta = json.loads(files["meta.json"])
    change(meta)
    return {**files, "meta.json": json.dumps(meta).encode()}


def webp(width: int, height: int, **options: Any) -> bytes:
    file = io.BytesIO()
    Image.new("RGBA", (width, height)).save(file, "WEBP", **options)
    return file.getvalue()


def test_every_number_is_as_near_as_its_bits_allow(tmp_path: Path):
    write_splats(PLAIN, tmp_path / "a.sog")
    found, wanted = read_splats(tmp_path / "a.sog"), PLAIN[ORDER]
    logs = [m.sign() * m.abs().log1p() for m in (found.means, wanted.means)]
    step = (logs[1].amax(dim=0) - logs[1].amin(dim=0)) / 65535
    assert ((logs[0] - logs[1]).abs() <= 0.51 * step + 1e-6).all()  # float32 beside the half
    assert (found.opacities.sigmoid() - wanted.opacities.sigmoid()).abs().max() <= 0.51 / 255
    quats = torch.nn.functional.normalize(wanted.quats, dim=1)
    quats = quats * (quats * found.quats).sum(dim=1, keepdim=True).sign()
    # Half a step of 2 / 255 / sqrt(2) for three parts, and at most the sum of theirs for the last
    assert (found.quats - quats).abs().max() <= 3 * 0.5 * 2**0.5 / 255
    for name in ("scales", "sh0"):  # 300 numbers of a normal distribution, 256 values
        error = (getattr(found, name) - getattr(wanted, name)).abs()
        assert error.max() < 0.05 and error.square().mean().sqrt() < 0.005


def test_extremes(tmp_path: Path):
    """WebP drops colours that opacities of 0 hide, unless told not to; one place has no size."""
    splats = replace(
        PLAIN, opacities=torch.full((COUNT,), -40.0), means=torch.full((COUNT, 3), -7.5)
    )
    write_splats(splats, tmp_path / "a.sog")
    found = read_splats(tmp_path / "a.sog")
    torch.testing.assert_close(found.means, splats.means)
    assert (found.sh0 - splats.sh0).abs().max() < 0.05
    assert (found.opacities < -10).all()


def test_a_folder_is_the_same(files: Files, tmp_path: Path):
    found = read_splats(laid_out(files, tmp_path / "folder"))
    bundle = read_splats(bundled(files, tmp_path / "a.sog", compression=zipfile.ZIP_DEFLATED))
    for name, tensor in found.tensors().items():
        assert torch.equal(tensor, bundle.tensors()[name])


def refused(path: Path, match: str) -> None:
    with pytest.raises(StyleSplatError, match=match) as caught:
        read_splats(path)
    assert "\n" not in str(caught.value)


DECLARATIONS: dict[str, tuple[Callable[[dict[str, Any]], object], str]] = {
    "version 3": (lambda m: m.update(version=3), "SOG of version 3, only 1 and 2 are read"),
    "no count": (lambda m: m.pop("count"), "does not say how many"),
    "no numbers": (lambda m: m["scales"].pop("codebook"), "neither a codebook nor a range"),
    "too many": (lambda m: m.update(count=200_000_000), "claims 200000000 Gaussians, more"),
    "more than pixels": (lambda m: m.update(count=145), "pictures of 144 pixels for 145"),
    "short codebook": (lambda m: m["sh0"].update(codebook=[0.5]), "beyond a codebook of 1"),
    "palette": (lambda m: m["shN"].update(count=1), r"colours beyond the palette's 1"),
}


def of_version_1(meta: dict[str, Any]) -> None:
    """Ranges of the channels in place of codebooks; opacities are logits."""
    del meta["version"]
    meta["means"]["shape"] = [meta.pop("count"), 3]
    meta["scales"] = {"mins": [-6, -5, -4], "maxs": [-3, -2, -1], "files": meta["scales"]["files"]}
    mins, maxs = [-1, -2, -3, -4], [1, 2, 3, 5]
    meta["sh0"] = {"mins": mins, "maxs": maxs, "files": meta["sh0"]["files"]}
    meta["shN"] = {"mins": -0.5, "maxs": 0.75, "files": meta["shN"]["files"]}


def test_version_1_has_ranges_in_place_of_codebooks(files: Files, tmp_path: Path, said: list[str]):
    def bytes_of(name: str) -> Tensor:
        image = Image.open(io.BytesIO(files[name])).convert("RGBA")
        return torch.from_numpy(np.array(image)).flatten(0, 1)[:COUNT] / 255

    found = read_splats(laid_out(declaring(files, of_version_1), tmp_path / "folder"))
    same = read_splats(laid_out(files, tmp_path / "of version 2"))
    assert torch.equal(found.means, same.means) and torch.equal(found.quats, same.quats)
    scales = torch.tensor([-6.0, -5, -4]) + 3 * bytes_of("scales.webp")[:, :3]
    torch.testing.assert_close(found.scales, scales)
    span, low = torch.tensor([2.0, 4, 6, 9]), torch.tensor([-1.0, -2, -3, -4])
    colors = low + span * bytes_of("sh0.webp")
    torch.testing.assert_close(found.sh0[:, 0], colors[:, :3])
    torch.testing.assert_close(found.opacities, colors[:, 3])
    assert found.shN.shape == same.shN.shape
    assert -0.5 <= found.shN.min() and found.shN.max() <= 0.75
    assert not said


def streamed(folder: Path, **changes: object) -> Path:
    """Two parts, of two and of one level, whose finest rows are in two files, and a sky."""
    runs = {"fine": (0, 0, 3), "coarse": (1, 0, 2), "other": (1, 2, 4)}
    fine, coarse, other = (
        dict(zip(("file", "offset", "count"), run, strict=True)) for run in runs.values()
    )
    fine |= changes
    children = [{"lods": {"0": fine, "1": coarse}}, {"children": [{"lods": {"1": other}}]}]
    about = {
        "lodLevels": 2,
        "filenames": ["0.sog", "1.sog"],
        "environment": "sky.sog",
        "tree": {"children": children},
    }
    folder.mkdir()
    for name, rows in {
        "0.sog": slice(0, 5),
        "1.sog": slice(5, 12),
        "sky.sog": slice(12, 14),
    }.items():
        part = PLAIN[rows]
        write_splats(
            replace(part, shN=part.shN[:, :0]) if name == "sky.sog" else part, folder / name
        )
    (folder / "lod-meta.json").write_text(json.dumps(about))
    return folder / "lod-meta.json"


def test_of_a_streamed_one_the_finest_level_of_each_part_is_read(tmp_path: Path, said: list[str]):
    path = streamed(tmp_path / "streamed")
    found = read_splats(path)
    fine, coarse, sky = (read_splats(path.parent / name) for name in ("0.sog", "1.sog", "sky.sog"))
    assert torch.equal(found.means, torch.cat([fine.means[:3], coarse.means[2:6], sky.means]))
    assert found.sh_degree == 3 and not found.shN[7:].any()
    assert said == [f"{path} has 2 levels of detail: the finest is read, the others are not."]


def test_a_streamed_one_whose_parts_are_not_there(tmp_path: Path):
    refused(streamed(tmp_path / "rows", count=6), "rows beyond the 5 of '0.sog'")
    refused(streamed(tmp_path / "files", file=7), "a file beyond its 2")
    refused(streamed(tmp_path / "twice", file=1, offset=3), "rows of '1.sog' twice")
    path = streamed(tmp_path / "gone")
    (path.parent / "1.sog").unlink()
    refused(path, "1.sog")
    (path.parent / "1.sog").write_bytes(b"none")
    refused(path, "Cannot read .*1.sog: ")
    about = json.loads(path.read_text())
    path.write_text(json.dumps({**about, "environment": "0.sog"}))
    refused(path, "names a file twice")
    path.write_text(
        json.dumps({**about, "tree": {"lods": {"fine": about["tree"]["children"][0]["lods"]["0"]}}})
    )
    refused(path, "level 'fine', which is no number")
    path.write_text('{"lodLevels": 0, "filenames": [], "tree": {}}')
    refused(path, "no part with Gaussians")


def test_the_folder_of_a_sog_is_not_taken_for_photos(files: Files, tmp_path: Path):
    folder = laid_out(files, tmp_path / "sog").parent
    refused(folder, "holds some: .*meta.json. Give one of them")
    refused(streamed(tmp_path / "streamed").parent, "holds some: .*lod-meta.json")
    assert kind_of(tmp_path) == "folder"
    remedy = r"folder of splats, not photos.*import .*/meta.json -o sog-scene"
    with pytest.raises(StyleSplatError, match=remedy):
        refuse_other_than_photos(folder)
    (folder / "images").mkdir()
    (folder / "images" / "a.webp").touch()
    assert kind_of(folder) == "photos"


@pytest.mark.parametrize("case", [*DECLARATIONS])
@pytest.mark.parametrize("place", ["bundle", "folder"])
def test_declarations_that_do_not_fit(files: Files, tmp_path: Path, case: str, place: str):
    change, expected = DECLARATIONS[case]
    changed = declaring(files, change)
    if case == "palette":  # whose picture would be of one row as it is
        changed = declaring(changed, lambda m: m["shN"].update(count=1))
    make = bundled if place == "bundle" else laid_out
    refused(make(changed, tmp_path / "a.sog"), expected)


BANDS: dict[str, Callable[[dict[str, Any]], object]] = {
    "names 0 bands": lambda m: m["shN"].update(bands=0),
    "names no bands": lambda m: m["shN"].pop("bands"),
    "names 2 bands": lambda m: m["shN"].update(bands=2),
}


@pytest.mark.parametrize("expected", [*BANDS])
def test_the_palettes_picture_tells_the_bands(
    files: Files, tmp_path: Path, said: list[str], expected: str
):
    plain = read_splats(bundled(files, tmp_path / "a.sog"))
    path = bundled(declaring(files, BANDS[expected]), tmp_path / "b.sog")
    assert torch.equal(read_splats(path).shN, plain.shN) and plain.sh_degree == 3
    assert said == [f"{path} {expected} of colour, but its palette has 3: these are read."]


@pytest.mark.parametrize("shN", [None, {"bands": 0}, {"bands": 0, "files": []}])
def test_no_palette(files: Files, tmp_path: Path, shN: object):
    path = bundled(declaring(files, lambda m: m.update(shN=shN)), tmp_path / "a.sog")
    assert read_splats(path).sh_degree == 0


def test_ranges_beside_codebooks_mean_nothing(files: Files, tmp_path: Path):
    odd = declaring(files, lambda m: m["sh0"].update(mins=[0, 0, 0, 0], maxs=[1, 1, 1, 1]))
    found, same = (read_splats(laid_out(f, tmp_path / n)) for n, f in (("a", odd), ("b", files)))
    assert torch.equal(found.opacities, same.opacities) and torch.equal(found.sh0, same.sh0)


def test_a_palette_without_a_count(files: Files, tmp_path: Path):
    plain = read_splats(bundled(files, tmp_path / "a.sog"))
    path = bundled(declaring(files, lambda m: m["shN"].pop("count")), tmp_path / "b.sog")
    assert torch.equal(read_splats(path).shN, plain.shN)


def test_a_codebook_that_begins_with_null(files: Files, tmp_path: Path):
    """Of splat-transform; PlayCanvas's engine extends the other values."""
    numbers = [n / 16 - 12 for n in range(256)]
    plain = declaring(files, lambda m: m["scales"].update(codebook=numbers))
    changed = declaring(files, lambda m: m["scales"].update(codebook=[None, *numbers[1:]]))
    found, expected = (
        read_splats(bundled(each, tmp_path / "a.sog")).scales for each in (changed, plain)
    )
    (where,) = (found != expected).nonzero(as_tuple=True)[:1]
    assert len(where) == (expected == numbers[0]).sum() > 0
    torch.testing.assert_close(found, expected, atol=0.13, rtol=0)


MARKS: dict[str, tuple[dict[str, Any], bool]] = {
    "specification": ({"antialias": True}, True),
    "splat-transform": ({"model": "antialiased"}, True),
    "2DGS": ({"model": "2dgs", "antialias": False}, False),
    "none": ({}, False),
}


@pytest.mark.parametrize("kind", [*MARKS])
def test_marks_of_anti_aliasing(files: Files, tmp_path: Path, said: list[str], kind: str):
    marks, expected = MARKS[kind]
    path = bundled(declaring(files, lambda m: m.update(marks)), tmp_path / "a.sog")
    assert read_splats(path).antialiased == expected and not said
    read_splats(bundled(declaring(files, lambda m: m.update(model="bokeh")), path))
    assert len(said) == 1 and "'bokeh', which is unknown" in said[0]


def as_large_as_can_be() -> bytes:
    """A picture whose header claims all pixels that WebP allows: 14 bits for each side."""
    content, start = bytearray(webp(4, 4, lossless=True)), 21
    sides = int.from_bytes(content[start : start + 4], "little") | (1 << 28) - 1
    content[start : start + 4] = sides.to_bytes(4, "little")
    return bytes(content)


PICTURES: dict[str, tuple[bytes, str]] = {
    "smaller": (webp(4, 4, lossless=True), r"'quats.webp' has 4 x 4 pixels instead of 12 x 12"),
    "as large as can be": (as_large_as_can_be(), "Cannot read.*268435456 pixels"),
    "lossy": (webp(12, 12, quality=50), "'quats.webp' is no lossless WebP"),
    "no rotations": (webp(12, 12, lossless=True, exact=True), "100 rotations do not name"),
}


@pytest.mark.parametrize("case", [*PICTURES])
def test_pictures_that_do_not_fit(files: Files, tmp_path: Path, case: str):
    content, expected = PICTURES[case]
    refused(bundled({**files, "quats.webp": content}, tmp_path / "a.sog"), expected)


def test_what_is_no_bundle(files: Files, tmp_path: Path):
    path = tmp_path / "a.sog"
    path.write_bytes(b"ply\nformat binary")
    refused(path, "its header has no end_header")
    bundled({"a.ply": b"ply"}, path)
    refused(path, r"a ZIP archive of a\.ply, and no SOG")
    bundled(files, path)
    path.write_bytes(path.read_bytes()[:-30])
    refused(path, "Cannot read")
    (tmp_path / "meta.json").write_text("[]")
    refused(tmp_path / "meta.json", "expected a JSON object")


def test_bombs(files: Files, tmp_path: Path):
    """What would unpack to more than pictures can, is not."""
    path = tmp_path / "a.sog"
    bomb = {**files, "quats.webp": bytes(10**8)}
    bundled(bomb, path, compression=zipfile.ZIP_DEFLATED)
    refused(path, "'quats.webp' would unpack to 100000000 bytes")
    bundled({**files, "meta.json": b" " * 10**8}, path, compression=zipfile.ZIP_DEFLATED)
    refused(path, "'meta.json' would unpack to 100000000 bytes")
    bundled(files, path, compression=zipfile.ZIP_LZMA)
    refused(path, "a compression that SOG does not use")


@pytest.mark.parametrize("name", ["../secret.webp", "/etc/passwd", "..", "a/../../secret.webp"])
def test_names_that_lead_elsewhere(files: Files, tmp_path: Path, name: str):
    changed = declaring(files, lambda m: m["quats"].update(files=[name]))
    (tmp_path / "secret.webp").write_bytes(files["quats.webp"])
    refused(laid_out(changed, tmp_path / "folder"), "leads out of the folder")
    refused(bundled(changed, tmp_path / "a.sog"), "is not in the bundle")
