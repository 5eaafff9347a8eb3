from dataclasses import replace
from pathlib import Path

import pytest
import torch

from ball_photos import write_ball_capture
from balls import BALLS, CAMERAS, SPLATS
from stylesplat.errors import StyleSplatError
from stylesplat.verbs.export import export
from stylesplat.io.captures import capture_folder as load_module
from stylesplat.io.scene_folder import read_scene
from stylesplat.scene.frames import known_frames
from stylesplat.selection.pick import pick
from stylesplat.verbs.evaluate import evaluate_scene
from stylesplat.verbs.import_splat import import_splat
from stylesplat.verbs.objects import list_objects
from stylesplat.verbs.select import Choice, select_object

PLAIN = replace(SPLATS, identities=None, classifier=None, shN=SPLATS.shN[:, :0])


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_ball_capture(tmp_path_factory.mktemp("capture"))


@pytest.fixture
def splat(tmp_path: Path) -> Path:
    export(PLAIN, tmp_path / "splat.ply")
    return tmp_path / "splat.ply"


def test_with_photos_and_label_maps(capture: Path, splat: Path, tmp_path: Path):
    metrics = import_splat(splat, tmp_path / "scene", capture_path=capture, device="cpu")
    assert metrics["psnr"] > 30
    assert metrics["miou"] > 0.9
    assert metrics["gaussians"] == len(PLAIN)
    scene = read_scene(tmp_path / "scene")
    for name in ("means", "quats", "scales", "opacities", "sh0"):
        assert torch.equal(getattr(scene.splats, name), getattr(PLAIN, name))
    assert scene.splats.classifier is not None
    assert scene.splats.classifier.ids == (0, *BALLS)
    torch.testing.assert_close(scene.cameras.viewmats, CAMERAS.viewmats, atol=1e-6, rtol=0)
    assert scene.splats.confidence is not None
    seen = scene.splats.confidence[scene.splats.confidence > 0]
    assert metrics["confidence"] == pytest.approx(float(seen.mean()))
    listed = list_objects(tmp_path / "scene")["objects"]
    for each in listed:
        picked = pick(scene.splats, object_id=each["id"])
        mean = float(scene.splats.confidence[picked].mean())
        assert each["confidence"] == pytest.approx(mean, abs=1e-3) and 0.7 < mean <= 1
    found = select_object(tmp_path / "scene", "red", Choice(ids=(3,)))
    assert found["gaussians"] > 60
    again = evaluate_scene(tmp_path / "scene", device="cpu")
    assert again["psnr"] == pytest.approx(metrics["psnr"])


def test_a_capture_is_read_once(
    capture: Path, splat: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    reads, real = [], load_module.read_transforms
    monkeypatch.setattr(load_module, "read_transforms", lambda f: reads.append(f) or real(f))
    import_splat(splat, tmp_path / "scene", capture_path=capture, device="cpu")
    assert reads == [capture]


def test_without_photos(splat: Path, tmp_path: Path, said: list[str]):
    out = tmp_path / "scene"
    metrics = import_splat(splat, out, up="z", device="cpu")
    assert metrics.keys() == {"gaussians", "seconds"}
    assert "36 views around the content" in "\n".join(said)
    scene = read_scene(out)
    assert len(scene.cameras) == 36
    select_object(out, "red", Choice(box3d=(-1.1, -0.4, 0.02, -0.3, 0.4, 0.7)))
    assert read_scene(out).picks["red"].sum() >= 79  # its ball, to rounding
    with pytest.raises(StyleSplatError, match="no identities"):
        select_object(out, "green", Choice(ids=(7,)))


def test_a_splat_in_nerfstudios_frame(capture: Path, tmp_path: Path):
    frame = known_frames(CAMERAS)["nerfstudio"]
    assert frame.shift is not None
    there = replace(
        PLAIN,
        means=frame.scale * PLAIN.means @ frame.rotation.T + frame.shift,
        scales=PLAIN.scales + torch.tensor(frame.scale).log(),
    )
    export(there, tmp_path / "splat.ply")
    with pytest.raises(StyleSplatError, match=r"frame of another program. Pass --frame nerfstudio"):
        import_splat(tmp_path / "splat.ply", tmp_path / "scene", capture_path=capture, device="cpu")
    assert not (tmp_path / "scene").exists()
    metrics = import_splat(
        tmp_path / "splat.ply",
        tmp_path / "scene",
        capture_path=capture,
        frame="nerfstudio",
        device="cpu",
    )
    assert metrics["psnr"] > 25
    scene = read_scene(tmp_path / "scene")
    assert torch.equal(scene.splats.means, there.means), "the splat stays where it is"
    again = evaluate_scene(tmp_path / "scene", device="cpu")
    assert again["psnr"] == pytest.approx(metrics["psnr"])


def test_a_splat_of_something_else(capture: Path, tmp_path: Path):
    generator = torch.Generator().manual_seed(0)
    strange = replace(PLAIN, means=torch.rand(len(PLAIN), 3, generator=generator) * 9 - 4)
    export(strange, tmp_path / "splat.ply")
    with pytest.raises(StyleSplatError, match="Give the capture that it was made from"):
        import_splat(tmp_path / "splat.ply", tmp_path / "scene", capture_path=capture, device="cpu")


def test_options_that_would_change_nothing(capture: Path, splat: Path, tmp_path: Path):
    with pytest.raises(StyleSplatError, match="need the capture"):
        import_splat(splat, tmp_path / "scene", frame="nerfstudio")
    with pytest.raises(StyleSplatError, match=r"without photos\. Leave it out"):
        import_splat(splat, tmp_path / "scene", capture_path=capture, up="z")


def test_what_is_there_stays(splat: Path, tmp_path: Path):
    import_splat(splat, tmp_path / "scene", device="cpu")
    before = (tmp_path / "scene" / "cameras.json").read_bytes()
    with pytest.raises(StyleSplatError, match="--overwrite"):
        import_splat(splat, tmp_path / "scene", up="x", device="cpu")
    assert (tmp_path / "scene" / "cameras.json").read_bytes() == before
    import_splat(splat, tmp_path / "scene", up="x", device="cpu", overwrite=True)
    assert (tmp_path / "scene" / "cameras.json").read_bytes() != before
