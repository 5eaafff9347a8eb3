"""Each noun where another is expected: what it is, and the way on from there."""

import shutil
from pathlib import Path

import pytest
from PIL import Image

from balls import BARE, CAMERAS, SPLATS
from processes import complaint
from stylesplat.io.scene_folder import save
from stylesplat.scene.scene import Scene
from stylesplat.verbs.export import export

SCENES = {
    "missing": "There is no scene {at}/missing. Check the name",
    "empty": "empty is an empty folder, not a scene: it has no scene.json. Give the folder",
    "photos": "photos is a folder of photos, not a scene. {train} {at}/photos -o photos-scene`",
    "video.mp4": "is a video, not a scene. {train} {at}/video.mp4 -o video-scene`",
    "capture": "capture is a capture, not a scene. {train} {at}/capture -o capture-scene`",
    "scene/splats.ply": "is a part of the scene {at}/scene. Give the whole folder",
    "scenes": "not a scene, but holds some: {at}/scenes/a. Give one of them",
    "splat.ply": "splat, not a scene. {import_} {at}/splat.ply -o splat-scene`",
    "picture.png": "is a picture, not a scene: it has no scene.json. Give the folder",
}
CAPTURE = {"capture": SCENES["capture"]}
CAPTURES = {
    "missing": "There is no capture {at}/missing. Check the name",
    "scene": "scene is a scene, not a capture. It was made from {at}/capture, which has the photos",
    "import": "Its photos are unknown: name objects by `stylesplat select {at}/import --name",
    "splat.ply": "splat.ply is a splat, not a capture. {import_} {at}/splat.ply -o splat-scene`",
}
RING = {"ring": "or in its own views by `stylesplat mask {at}/ring --box NAME=VIEW"}
POSED = CAPTURES | {
    "photos": "photos is a folder of photos, not a capture, as no camera poses are known. Find",
    "video.mp4": "a video, not a capture, as no camera poses are known. Find the cameras first: "
    "`stylesplat sfm {at}/video.mp4 -o CAPTURE`; or give the capture that was made of it.",
    "capture/images": "holds the photos of the capture {at}/capture, whose poses are known. Give",
    "scenes": "neither sparse/0/cameras.bin (or .txt) nor transforms.json, nor photos. Check",
    "captures": "captures is not a capture, but holds some: {at}/captures/a. Give one of them",
    "empty": "empty is an empty folder, but photos are needed: at least 3",
    "recipe.json": "recipe.json is a file, not a capture",
    "picture.png": "picture.png is a picture, not a capture. Give the folder of all photos",
}
UNPOSED = CAPTURES | {
    "empty": "empty is an empty folder, but photos are needed: at least 3",
    "recipe.json": "recipe.json is no video that can be decoded: Invalid data found when",
    "picture.png": "picture.png is one photo. Give the folder of all photos",
}
SPLAT_FILES = {
    "missing": "There is no file of splats {at}/missing. Check the name",
    "empty": "empty is an empty folder, not a file of splats. Give one that ends in .ply",
    "photos": "photos is a folder of photos, not a file of splats. {train} {at}/photos",
    "video.mp4": "a video, not a file of splats. {train}",
    "capture": "capture is a capture, not a file of splats. {train} {at}/capture -o capture-scene`",
    "scene": "scene is a scene, not a file of splats. It has its splats: `stylesplat objects",
    "splats": "splats is not a file of splats, but holds some: {at}/splats/a.spz. Give one of them",
    "picture.png": "picture.png is a picture, not a file of splats. Give one",
}
PICTURES = {
    "missing": "There is no image {at}/missing. Check the name",
    "photos": "Cannot read {at}/photos: it is a folder. Give a file in it",
    "recipe.json": "it is no picture, or none of JPEG, PNG",
}
RECIPES = {
    "missing": "No such file or directory. Check the name",
    "photos": "it is no recipe. Give a YAML file, or the recipe.json of a styled scene",
    "splat.ply": "it is no YAML text: unacceptable character",
}
LABEL_MAPS = {
    "missing": "There is no folder {at}/missing with label maps. Check `--masks`",
    "photos": "its format changes ids, and it is not black and white. Save it as PNG",
    "capture": "capture is a capture, not a folder of masks. Check `--masks`",
}
FOREIGN = {
    "missing": "There is no folder or .json file {at}/missing. Check the path",
    "capture": "capture is a capture, not a folder of masks. Give --from the folder",
}
BOX = "a=0001.jpg:6,8,23,24"
CALLS = {
    ("objects", "{}"): SCENES,
    ("select", "{}", "--name", "x", "--id", "3"): CAPTURE,
    ("stylize", "{}", "--style", "3={at}/picture.png", "-o", "{at}/out"): CAPTURE,
    ("adjust", "{}", "--intensity", "0.5"): CAPTURE,
    ("sheet", "{}", "--style", "3={at}/picture.png", "-o", "{at}/out.png"): CAPTURE,
    ("render", "{}", "-o", "{at}/out"): CAPTURE,
    ("export", "{}", "{at}/out.ply"): CAPTURE,
    ("view", "{}"): CAPTURE,
    ("mask", "{at}/photos", "--box", BOX, "--scene", "{}"): CAPTURE,
    ("train", "{}", "-o", "{at}/out"): UNPOSED | RING,
    ("mask", "{}", "--box", BOX): {"splat.ply": UNPOSED["splat.ply"]},
    ("sfm", "{}", "-o", "{at}/out"): {"scene": UNPOSED["scene"]},
    ("check", "{}"): POSED | RING,
    ("import", "{at}/splat.ply", "{}", "-o", "{at}/out"): {"photos": POSED["photos"]},
    ("evaluate", "{at}/scene", "--capture", "{}"): {"photos": POSED["photos"]},
    ("import", "{}", "-o", "{at}/out"): SPLAT_FILES,
    ("stylize", "{at}/scene", "--style", "3={}", "-o", "{at}/out"): PICTURES,
    ("stylize", "{at}/scene", "--recipe", "{}", "-o", "{at}/out"): RECIPES,
    ("train", "{at}/capture", "--masks", "{}", "-o", "{at}/out"): LABEL_MAPS,
    ("evaluate", "{at}/scene", "--masks", "{}"): {"missing": LABEL_MAPS["missing"]},
    ("mask", "{at}/photos", "--from", "{}"): FOREIGN,
}
MATRIX = [(call, noun) for call, nouns in CALLS.items() for noun in nouns]


@pytest.fixture(scope="module")
def nouns(capture: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with one of each."""
    at = tmp_path_factory.mktemp("nouns")
    shutil.copytree(capture, at / "capture")
    shutil.copytree(capture / "images", at / "photos")
    scene = Scene(SPLATS, CAMERAS, held_out=CAMERAS.names[:1], capture=at / "capture")
    save(scene, at / "scene")
    save(scene, at / "scenes/a")
    save(Scene(SPLATS, CAMERAS), at / "import")
    save(BARE, at / "ring")
    export(SPLATS, at / "splat.ply")
    (at / "splats").mkdir()
    export(SPLATS, at / "splats/a.spz")
    shutil.copytree(capture, at / "captures/a")
    (at / "empty").mkdir()
    (at / "video.mp4").write_bytes(b"no video")
    (at / "recipe.json").write_text('{"objects": {}}')
    Image.linear_gradient("L").save(at / "picture.png")
    return at


@pytest.mark.parametrize(("call", "noun"), MATRIX, ids=lambda v: v if isinstance(v, str) else v[0])
def test_the_message(
    call: tuple[str, ...], noun: str, nouns: Path, capsys: pytest.CaptureFixture[str]
):
    before = {*nouns.rglob("*")}
    line = complaint(
        capsys, *(part.replace("{}", f"{{at}}/{noun}").format(at=nouns) for part in call)
    )
    made = "A scene is made of it by `stylesplat"
    expected = CALLS[call][noun].format(at=nouns, train=f"{made} train", import_=f"{made} import")
    assert expected in line
    assert line.rstrip(".").count(". ") >= 1, "the fact, then the remedy"
    assert {*nouns.rglob("*")} == before


@pytest.mark.parametrize("name", ["loop", "x" * 300], ids=["loop", "long"])
def test_names_that_nothing_can_have(name: str, tmp_path: Path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("loop").symlink_to("loop")
    for call in (("train", name, "-o", "out"), ("mask", name, "--box", BOX), ("objects", name)):
        line = complaint(capsys, *call)
        assert "There is no" in line or "File name too long" in line
    assert [p.name for p in tmp_path.iterdir()] == ["loop"]


@pytest.mark.parametrize(
    "options",
    [
        "",
        "--method files",
        f"--box {BOX} --method sam2",
        f"--box {BOX} --from {{at}}/photos",
        f"--box {BOX} --scene {{at}}/photos",
        "--from {at}/missing",
    ],
)
def test_contradictions_are_refused_before_photos_are_read(
    options: str, nouns: Path, monkeypatch: pytest.MonkeyPatch, capsys
):
    for reads in ("stylesplat.verbs.sfm.sfm", "stylesplat.load"):
        monkeypatch.setattr(reads, lambda *_, **__: pytest.fail("photos are read"))
    complaint(capsys, "mask", nouns / "photos", *options.format(at=nouns).split())
