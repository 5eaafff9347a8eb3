"""Scenes on disk: as they were in memory, changed whole or not at all, damaged, of old."""

import errno
import json
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors.torch import load, save

from stylesplat.errors import StyleSplatError
from stylesplat.io import files, scene_folder
from stylesplat.io.scene_folder import revise
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.paintings import Colors, Painted, Painting, Source, Unsplit
from stylesplat.scene.scene import Scene, SceneObject
from stylesplat.scene.splats import Classifier, Splats

COUNT = 6
# All by which `files` changes what lies in a folder, deletions aside, which are the last it does
CHANGES = [(os, "replace"), (os, "rename"), (os, "link"), (os, "mkdir"), (files, "_exchanged")]


def random(*shape: int) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(sum(shape)))


def plain_scene(dtype: torch.dtype = torch.float32) -> Scene:
    splats = Splats(
        means=random(COUNT, 3),
        quats=random(COUNT, 4),
        scales=random(COUNT, 3),
        opacities=random(COUNT),
        sh0=random(COUNT, 1, 3),
        shN=random(COUNT, 15, 3),
    )
    cameras = Cameras(
        viewmats=random(2, 4, 4).to(dtype) / 3,
        Ks=random(2, 3, 3).to(dtype) / 3,
        sizes=torch.tensor([[640, 480], [500, 400]]),
        names=("a.jpg", "sub/b.png"),
    )
    return Scene(splats, cameras)


def full_scene() -> Scene:
    scene = plain_scene()
    classifier = Classifier(random(3, 16), random(3), ids=(0, 7, 70000))
    nothing = torch.zeros(COUNT, dtype=torch.bool)
    return replace(
        scene,
        splats=replace(
            scene.splats,
            identities=random(COUNT, 16),
            classifier=classifier,
            confidence=random(COUNT).sigmoid(),
        ),
        objects={
            "fox": SceneObject(torch.arange(COUNT) % 2 == 0, {"ids": [7], "count": 3}),
            "a name": SceneObject(nothing, {"count": 0}),
        },
        held_out=("a.jpg",),
        capture=Path("garden"),
        info={"settings": {"steps": 500}},
        metrics={"psnr": 30.5},
        painted=painted(),
    )


def painted() -> Painted:
    picture = Source(Path("/pictures/wave.jpg"), "12ab")
    settings = {"steps": 5, "scale": 2.0, "layers": [3], "intensity": 1.0}
    fox = Painting("fox", torch.arange(COUNT) < 2, (picture,), settings, 0.7, "compact")
    other = Painting(
        name="7",
        picked=torch.arange(COUNT) == 4,
        styles=(picture, Source(None, "34cd")),
        settings={**settings, "steps": 9},
        intensity=1.0,
        features="vgg19",
        weights=Source(Path("/nets/vgg19.pth"), "56ef"),
        upon={"fox": 0.5},
    )
    before = Colors(random(COUNT, 1, 3), random(COUNT, 15, 3))
    full = Colors(random(COUNT, 1, 3) + 1, random(COUNT, 15, 3) + 1)
    return Painted((fox, other), before, full, origin=Path("/scenes/trained"))


def contents(folder: Path) -> dict[str, bytes]:
    files = (path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def inodes(folder: Path) -> dict[str, int]:
    files = (path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path.stat().st_ino for path in files}


@contextmanager
def failing(number: int, error: BaseException, *, for_good: bool = False) -> Iterator[list[str]]:
    """Let a call that changes the file system fail, and all after it; none if it is below 0."""
    calls: list[str] = []
    with pytest.MonkeyPatch.context() as patch:
        for module, name in CHANGES:
            real = getattr(module, name)

            def call(*args: Any, real: Any = real, name: str = name, **options: Any) -> Any:
                calls.append(f"{len(calls)}: {name}")
                due = len(calls) - 1
                if due == number or (for_good and 0 <= number < due):
                    raise error
                return real(*args, **options)

            patch.setattr(module, name, call)
        yield calls


def can_exchange(folder: Path) -> bool:
    one, other = folder / "one", folder / "other"
    one.mkdir()
    other.mkdir()
    exchanged = files._exchanged(one, other)
    one.rmdir()
    other.rmdir()
    return exchanged


def tensors_in(value: object) -> Iterator[torch.Tensor]:
    """All of a noun and of what it holds, in order."""
    if isinstance(value, torch.Tensor):
        yield value
    elif isinstance(value, dict):
        for item in value.values():
            yield from tensors_in(item)
    elif isinstance(value, tuple):
        for item in value:
            yield from tensors_in(item)
    elif hasattr(value, "__dataclass_fields__"):
        yield from tensors_in(vars(value))


def plain_in(value: object) -> object:
    """A noun without its tensors, as what can be compared."""
    if isinstance(value, torch.Tensor):
        return tuple(value.shape), value.dtype
    if isinstance(value, dict):
        return {name: plain_in(item) for name, item in value.items()}
    if isinstance(value, tuple):
        return tuple(map(plain_in, value))
    if hasattr(value, "__dataclass_fields__"):
        return type(value), plain_in(vars(value))
    return value


def assert_same(found: Scene, scene: Scene) -> None:
    """Everything is, but for the folder."""
    found, scene = replace(found, path=None), replace(scene, path=None)
    assert plain_in(found) == plain_in(scene)
    pairs = zip(tensors_in(found), tensors_in(scene), strict=True)
    assert all(torch.equal(one, other) for one, other in pairs)


@pytest.mark.parametrize("make", [plain_scene, full_scene])
def test_round_trip(tmp_path: Path, make: Callable[[], Scene]):
    scene = make()
    scene_folder.save(scene, tmp_path / "scene")
    assert_same(scene_folder.open(tmp_path / "scene"), scene)


def test_what_undoes_a_split_comes_back(tmp_path: Path):
    shape = Unsplit(4, torch.tensor([0, 3]), random(2, 3), random(2))
    split = replace(full_scene(), painted=replace(painted(), unsplit=shape))
    scene_folder.save(split, tmp_path / "scene")
    assert_same(scene_folder.open(tmp_path / "scene"), split)
    scene_folder.save(full_scene(), tmp_path / "scene", overwrite=True)
    assert_same(scene_folder.open(tmp_path / "scene"), full_scene())


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_cameras_are_exact(tmp_path: Path, dtype: torch.dtype):
    scene = plain_scene(dtype)
    scene_folder.save(scene, tmp_path / "scene")
    assert_same(scene_folder.open(tmp_path / "scene"), scene)


def test_the_files_of_a_scene(tmp_path: Path):
    scene_folder.save(plain_scene(), tmp_path / "plain")
    scene_folder.save(full_scene(), tmp_path / "full")
    plain = {"scene.json", "splats.ply", "cameras.json", "objects.json", "picks.safetensors"}
    plain.add("metrics.json")
    assert {p.name for p in (tmp_path / "plain").iterdir()} == plain
    styled = {"base_colors.safetensors", "style_colors.safetensors", "paintings.safetensors"}
    assert {p.name for p in (tmp_path / "full").iterdir()} == plain | styled | {
        *("identities.safetensors", "recipe.json")
    }


def test_base_colors_have_the_bands_that_the_splats_get(tmp_path: Path):
    scene, colors = full_scene(), painted().before
    few = replace(painted(), before=Colors(colors.sh0, colors.shN[:, :3]))
    scene_folder.save(replace(scene, painted=few), tmp_path / "scene")
    found = scene_folder.open(tmp_path / "scene")
    assert found.painted is not None
    assert found.painted.before.shN.shape == found.splats.shN.shape
    assert torch.equal(found.painted.before.shN[:, :3], colors.shN[:, :3])


def test_the_folder_that_it_was_opened_from(tmp_path: Path):
    scene_folder.save(plain_scene(), tmp_path / "scene")
    assert scene_folder.open(tmp_path / "scene").path == tmp_path / "scene"


def test_a_revision_changes_nothing_else(tmp_path: Path):
    scene_folder.save(full_scene(), tmp_path / "scene")
    scene, before = scene_folder.open(tmp_path / "scene"), contents(tmp_path / "scene")
    objects = {"table": SceneObject(torch.ones(COUNT, dtype=torch.bool), {"count": COUNT})}
    after = replace(scene, objects=objects)
    revise(scene, after, tmp_path / "scene")
    found = contents(tmp_path / "scene")
    changed = {name for name in before | found if before.get(name) != found.get(name)}
    assert changed == {"picks.safetensors", "objects.json"}
    later = replace(after, metrics={"psnr": 1.0})
    revise(after, later, tmp_path / "scene")
    assert_same(scene_folder.open(tmp_path / "scene"), later)


EVERYTHING: list[Callable[[Scene], Scene]] = [
    lambda scene: replace(scene, splats=plain_scene().splats),
    lambda scene: replace(scene, splats=replace(scene.splats, confidence=None)),
    lambda scene: replace(scene, cameras=scene.cameras[[1]]),
    lambda scene: replace(scene, held_out=("sub/b.png",)),
    lambda scene: replace(scene, downscale=4.0),
    lambda scene: replace(scene, capture=None),
    lambda scene: replace(scene, objects={}),
    lambda scene: replace(scene, painted=None),
    lambda scene: replace(scene, painted=replace(painted(), origin=None)),
    lambda scene: replace(scene, info={"settings": {"steps": 1}}),
    lambda scene: replace(scene, metrics={}),
]


@pytest.mark.parametrize("change", EVERYTHING)
def test_whatever_changed_is_revised(change: Callable[[Scene], Scene], tmp_path: Path):
    scene_folder.save(full_scene(), tmp_path / "scene")
    before = scene_folder.open(tmp_path / "scene")
    revise(before, change(before), tmp_path / "scene")
    assert_same(scene_folder.open(tmp_path / "scene"), change(before))


def test_a_revision_copies_nothing_and_keeps_what_is_not_ours(tmp_path: Path):
    folder = tmp_path / "scene"
    scene_folder.save(full_scene(), folder)
    (folder / "selections").mkdir()
    (folder / "selections" / "fox.png").write_bytes(b"a fox")
    (folder / "notes.txt").write_text("mine")
    scene, before = scene_folder.open(folder), inodes(folder)
    revise(scene, replace(scene, metrics={"psnr": 1.0}), folder)
    after = inodes(folder)
    assert {name for name in before | after if before.get(name) != after.get(name)} == {
        "metrics.json"
    }
    assert [path.name for path in tmp_path.iterdir()] == ["scene"]


class Killed(BaseException):
    """The end of the process, as far as a test can have it."""


@pytest.mark.parametrize("way", ["exchange", "two renames", "file by file"])
@pytest.mark.parametrize("error", [OSError(errno.EIO, "Input/output error"), Killed()])
def test_a_revision_is_whole_or_not_at_all(
    error: BaseException, way: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """Whichever call to the file system fails, and be it the last call of all."""
    folder = tmp_path / "scene"
    scene_folder.save(full_scene(), folder)
    if way == "two renames":  # where the system cannot exchange
        monkeypatch.setattr(files, "_exchanged", lambda one, other: False)
    if way == "file by file":  # where somebody stands in the folder
        monkeypatch.chdir(folder)
    (folder / "notes.txt").write_text("mine")
    scene = scene_folder.open(folder)
    changed = replace(scene, splats=plain_scene().splats, painted=None, metrics={})
    whole = [contents(folder)]
    with failing(-1, error) as calls:
        revise(scene, changed, folder)
    assert len(calls) > 10
    whole.append(contents(folder))
    assert whole[0] != whole[1]
    for number in range(len(calls)):
        revise(changed, scene, folder)
        assert contents(folder) == whole[0]
        with failing(number, error), suppress(StyleSplatError, Killed):
            revise(scene, changed, folder)
        assert contents(folder) in whole, calls[number]
        assert [path.name for path in tmp_path.iterdir()] == ["scene"], calls[number]


def test_a_revision_survives_its_process(tmp_path: Path):
    """Nothing is done after the call that fails, not even what would mend it."""
    folder = tmp_path / "scene"
    scene_folder.save(full_scene(), folder)
    if not can_exchange(tmp_path):
        pytest.skip("this file system cannot swap two folders at once")
    scene = scene_folder.open(folder)
    changed = replace(scene, splats=plain_scene().splats, painted=None)
    whole = [contents(folder)]
    with failing(-1, Killed()) as calls:
        revise(scene, changed, folder)
    whole.append(contents(folder))
    for number in range(len(calls)):
        revise(changed, scene, folder)
        with failing(number, Killed(), for_good=True), suppress(Killed):
            revise(scene, changed, folder)
        assert contents(folder) in whole, calls[number]


def test_a_folder_that_one_stands_in_stays_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """A shell would else be left in a folder that is gone."""
    folder = tmp_path / "scene"
    scene_folder.save(full_scene(), folder)
    scene = scene_folder.open(folder)
    monkeypatch.chdir(folder)
    revise(scene, replace(scene, painted=None), Path())
    assert_same(scene_folder.open("."), replace(scene, painted=None))
    assert not Path("recipe.json").exists()
    assert [path.name for path in tmp_path.iterdir()] == ["scene"]


def test_a_scene_is_not_overwritten_by_accident(tmp_path: Path):
    scene_folder.save(full_scene(), tmp_path / "scene")
    with pytest.raises(StyleSplatError, match=r"holds an earlier result.*`--overwrite`"):
        scene_folder.save(plain_scene(), tmp_path / "scene")
    assert_same(scene_folder.open(tmp_path / "scene"), full_scene())
    scene_folder.save(plain_scene(), tmp_path / "scene", overwrite=True)
    assert_same(scene_folder.open(tmp_path / "scene"), plain_scene())


def test_no_scene(tmp_path: Path):
    with pytest.raises(StyleSplatError, match=r"is not a scene.*`stylesplat train CAPTURE -o"):
        scene_folder.open(tmp_path)
    with pytest.raises(StyleSplatError, match="is not a scene"):
        revise(plain_scene(), plain_scene(), tmp_path)


@pytest.mark.parametrize(
    ("name", "content", "match"),
    [
        ("scene.json", b"{", "not valid JSON"),
        ("scene.json", b"{}", "not of version 1"),
        ("scene.json", b'{"version": 2}', "not of version 1"),
        ("scene.json", b'{"version": 1, "settings": 3}', "settings must be"),
        ("scene.json", b'{"version": 1, "settings": {"downscale": "x"}}', "downscale is 'x'"),
        ("splats.ply", b"", "not a PLY file"),
        ("splats.ply", None, "No such file"),
        ("cameras.json", None, "No such file"),
        ("cameras.json", b"{}", "no 'dtype'"),
        ("cameras.json", b'{"dtype": "float32", "cameras": [{"name": "a"}]}', "no 'viewmat'"),
        ("cameras.json", b'{"dtype": "float32", "cameras": 1}', "not iterable"),
        ("objects.json", b"[]", "expected a JSON object"),
        ("picks.safetensors", b"1234", "Make the scene again"),
        ("picks.safetensors", None, "No such file"),
        ("identities.safetensors", b"1234", "Make the scene again"),
        ("base_colors.safetensors", b"1234", "Make the scene again"),
        ("style_colors.safetensors", None, "No such file"),
        ("paintings.safetensors", b"1234", "Make the scene again"),
        ("metrics.json", b"", "not valid JSON"),
        ("recipe.json", b"", "not valid JSON"),
        ("recipe.json", None, "No such file"),
        ("recipe.json", b"{}", "does not say what was painted: 'objects'"),
        ("recipe.json", b'{"objects": [], "settings": {}}', "does not say what was painted"),
        ("recipe.json", b'{"objects": [1, 2], "settings": {}}', "does not say what was painted"),
    ],
)
def test_damaged_files(tmp_path: Path, name: str, content: bytes | None, match: str):
    scene_folder.save(full_scene(), tmp_path / "scene")
    path = tmp_path / "scene" / name
    path.unlink() if content is None else path.write_bytes(content)
    with pytest.raises(StyleSplatError, match=match) as caught:
        scene_folder.open(tmp_path / "scene")
    assert name in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["picks", "base_colors", "style_colors", "paintings"])
def test_files_of_different_scenes(name: str, tmp_path: Path):
    scene_folder.save(full_scene(), tmp_path / "scene")
    path = tmp_path / "scene" / f"{name}.safetensors"
    tensors = {key: torch.cat([t, t[:1]]) for key, t in load(path.read_bytes()).items()}
    path.write_bytes(save(tensors))
    with pytest.raises(StyleSplatError, match=r"has the shape \[7.*\], .* 6 Gaussians"):
        scene_folder.open(tmp_path / "scene")


def test_identities_that_were_not_lifted_have_no_confidence(tmp_path: Path):
    scene = full_scene()
    scene = replace(scene, splats=replace(scene.splats, confidence=None))
    scene_folder.save(scene, tmp_path / "scene")
    assert_same(scene_folder.open(tmp_path / "scene"), scene)


def test_confidence_of_another_scene(tmp_path: Path):
    scene = full_scene()
    splats = replace(scene.splats, confidence=None)
    scene_folder.save(replace(scene, splats=splats), tmp_path / "scene")
    path = tmp_path / "scene/identities.safetensors"
    path.write_bytes(save({**load(path.read_bytes()), "confidence": torch.ones(COUNT - 1)}))
    with pytest.raises(StyleSplatError, match=r"confidence has the shape \[5\]"):
        scene_folder.open(tmp_path / "scene")


def test_identities_without_a_classifier(tmp_path: Path):
    scene_folder.save(full_scene(), tmp_path / "scene")
    picks = tmp_path / "scene/picks.safetensors"
    (tmp_path / "scene/identities.safetensors").write_bytes(picks.read_bytes())
    with pytest.raises(StyleSplatError, match="it has no bias"):
        scene_folder.open(tmp_path / "scene")


def test_the_camera_file_is_plain_json(tmp_path: Path):
    scene_folder.save(plain_scene(), tmp_path / "scene")
    content = json.loads((tmp_path / "scene/cameras.json").read_text())
    assert content["cameras"][1]["name"] == "sub/b.png"
    assert content["cameras"][1]["size"] == [500, 400]
