"""Every verb of the command line, on tiny scenes."""

import json
from pathlib import Path

import av
import numpy as np
import pytest
import torch
from PIL import Image

from balls import CAMERAS, SPLATS
from color_detector import ColorDetector
from stylesplat.cli import main
from stylesplat.io.captures.photos import read_image
from stylesplat.io.label_maps import read_label_map
from stylesplat.io.scene_folder import read_scene
from stylesplat.io.splats.splat_ply import read_splat_ply
from stylesplat.selection.pick import pick
from tiny_captures import HEIGHT, WIDTH, write_capture

QUICK = ("--pattern", "large", "--max-growth", 2)
SPLIT = ("sh0", "shN", "scales", "opacities")  # what a Gaussian that is split and painted changes


@pytest.fixture(autouse=True)
def small_measurements(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("stylesplat.evaluation.style.LENGTH", 72.0)


def run(*arguments: object) -> int:
    return main([str(argument) for argument in arguments])


def result(capsys: pytest.CaptureFixture[str], *arguments: object) -> dict:
    assert run(*arguments, "--json") == 0
    return json.loads(capsys.readouterr().out)


def test_train_writes_a_scene(capture: Path, tmp_path: Path, capsys):
    out = tmp_path / "scene"
    metrics = result(capsys, "train", capture, "-o", out, "--steps", 40, "--device", "cpu")
    assert metrics == json.loads((out / "metrics.json").read_text())
    assert {"psnr", "ssim", "seconds", "steps", "gaussians", "steps_per_second"} <= set(metrics)
    assert metrics["steps"] == 40
    scene = read_scene(out)
    assert len(scene.splats) == metrics["gaussians"]
    assert scene.splats.classifier is not None
    assert scene.splats.classifier.ids == (0, 3, 7, 300)
    assert scene.info["test_views"] == ["0000.jpg"]
    assert torch.allclose(scene.cameras.viewmats, CAMERAS.viewmats, atol=1e-6)
    assert not (out / "checkpoint.pt").exists()


def test_train_keeps_what_is_there(capture: Path, scene: Path, capsys):
    before = (scene / "splats.ply").read_bytes()
    assert run("train", capture, "-o", scene, "--steps", 1) == 1
    assert "--overwrite" in capsys.readouterr().err
    assert (scene / "splats.ply").read_bytes() == before
    assert run("train", capture, "-o", scene, "--steps", 1, "--overwrite") == 0
    assert (scene / "splats.ply").read_bytes() != before


def test_train_continues_from_its_checkpoint(
    capture: Path, tmp_path: Path, capsys, monkeypatch: pytest.MonkeyPatch
):
    from stylesplat.verbs import train

    out, real = tmp_path / "scene", train.fit

    def interrupted(*args, **kwargs):
        def stop(state, loss, psnr):
            if state.step == 5:
                import signal

                signal.raise_signal(signal.SIGINT)

        return real(*args, on_progress=stop, **kwargs)

    monkeypatch.setattr(train, "fit", interrupted)
    assert run("train", capture, "-o", out, "--steps", 12) == 130
    assert (out / "checkpoint.pt").exists()
    monkeypatch.setattr(train, "fit", real)
    assert run("train", capture, "-o", out, "--steps", 12) == 0
    assert "Continuing" in capsys.readouterr().err
    assert read_scene(out).metrics["steps"] == 12


def test_objects_lists_ids_and_draws_them(scene: Path, capsys):
    listed = result(capsys, "objects", scene)
    counts = {entry["id"]: entry["gaussians"] for entry in listed["objects"]}
    assert set(counts) == {3, 7, 300}
    assert all(76 <= count <= 80 for count in counts.values()), "all but a few outliers"
    assert "confidence" not in listed["objects"][0], "these labels were not lifted"
    height, width, _ = read_image(listed["sheet"]).shape
    assert width > 3 * 200 and height > 200


def test_select_by_id_and_by_point(scene: Path, capsys):
    by_id = result(capsys, "select", scene, "--name", "red", "--id", 3, "--keep-outliers")
    assert by_id["ids"] == [3] and by_id["gaussians"] == 80
    assert read_image(by_id["picture"]).shape[1] > 3 * 480, "three views of it"
    labels = read_scene(scene)
    from stylesplat.selection.identities import render_labels

    y, x = (render_labels(labels.splats, CAMERAS[2]) == 7).nonzero().median(dim=0).values.tolist()
    place = f"{CAMERAS.names[2]}:{x},{y}"
    assert result(capsys, "select", scene, "--name", "green", "--point", place)["ids"] == [7]
    box = f"{CAMERAS.names[2]}:{x - 1},{y - 1},{x + 2},{y + 2}"
    assert result(capsys, "select", scene, "--name", "also", "--box", box)["ids"] == [7]
    after = read_scene(scene)
    assert set(after.picks) == {"red", "green", "also"}
    assert after.objects["green"]["points"][0][0] == CAMERAS.names[2]
    names = {e["id"]: e["names"] for e in result(capsys, "objects", scene)["objects"]}
    assert names == {3: ["red"], 7: ["green", "also"], 300: []}


def test_select_grows_and_shrinks(scene: Path, capsys):
    red = ("select", scene, "--name", "red", "--id", 3)
    plain = result(capsys, *red)["gaussians"]
    assert result(capsys, *red, "--grow", 0.2)["gaussians"] > plain
    assert 0 < result(capsys, *red, "--shrink", 0.1)["gaussians"] < plain
    for bad in ("nan", 0, 3):
        assert run(*red, "--grow", bad) == 1
        assert "Give more than 0 and at most 1" in capsys.readouterr().err


def test_select_by_text(scene: Path, capsys, monkeypatch):
    from stylesplat.verbs import select as verb

    asked = []
    monkeypatch.setattr(verb, "load_detector", lambda *a: asked.append(a) or ColorDetector())
    found = result(capsys, "select", scene, "--name", "it", "--text", "blue", "--model", "a/b")
    assert found["ids"] == [300] and found["scores"].keys() == {"300"}
    assert asked[0][0] == "a/b"


def test_select_by_text_with_a_real_detector(scene: Path, tiny_model, capsys, monkeypatch):
    """Random weights find what fits by chance, and that is said in one line."""
    monkeypatch.setattr("stylesplat.selection.text.CHANCE", 1.0)
    folder = tiny_model("grounding-dino")
    assert run("select", scene, "--name", "it", "--text", "red ball", "--model", folder) == 1
    assert (
        "what fits 'red ball'. By id, with scores: 3 (0."
        in capsys.readouterr().err.splitlines()[-1]
    )


def test_stylize_changes_only_the_colours_of_the_objects(scene: Path, style: Path, capsys):
    assert run("select", scene, "--name", "red", "--id", 3, "--keep-outliers") == 0
    assert run("select", scene, "--name", "green", "--id", 7, "--keep-outliers") == 0
    out = scene.parent / "styled"
    metrics = result(
        capsys,
        *("stylize", scene, "--style", f"red={style}", "--style", f"green={style}", "-o", out),
        *("--features", "compact", "--steps", 3, "--device", "cpu", *QUICK),
    )
    assert (scene / "selections").exists() and not (out / "selections").exists(), "left behind"
    before, styled = read_scene(scene).splats, read_scene(out)
    after = styled.splats[torch.arange(len(before))]
    new = len(styled.splats) - len(before)
    assert before.identities is not None
    painted = (before.identities[:, 1] + before.identities[:, 2]) > 0
    for name, tensor in before.tensors().items():
        kept = ~painted if name in SPLIT else torch.ones_like(painted)
        assert torch.equal(tensor[kept], after.tensors()[name][kept]), name
    assert (before.sh0[painted] != after.sh0[painted]).any(dim=(1, 2)).all()
    assert metrics["changed_gaussians"] == 160 + new
    assert 0 < new <= 160, "as many again, at most"
    assert set(metrics["nnfm_before"]) == set(metrics["nnfm_after"]) == {"red", "green"}
    assert styled.base_colors is not None
    assert torch.equal(styled.base_colors["sh0"][: len(before)], before.sh0)
    assert styled.recipe is not None and len(styled.recipe["objects"][0]["sha256"]) == 64
    assert styled.metrics["train"] == {"psnr": 30.0}


@pytest.fixture
def styled(scene: Path, style: Path) -> Path:
    """Two balls in stripes, at half intensity."""
    out = scene.with_name("styled")
    options = ("--features", "compact", "--steps", 2, "--intensity", 0.5, *QUICK)
    styles = ("--style", f"3={style}", "--style", f"7={style}")
    assert run("stylize", scene, "-o", out, *options, *styles) == 0
    return out


def test_adjust_blends_exactly_and_can_be_undone(scene: Path, styled: Path, capsys):
    files = {p.name: p.read_bytes() for p in styled.iterdir()}
    (styled / "notes.txt").write_text("mine")
    before, half = read_scene(scene).splats, read_scene(styled).splats
    base = read_scene(styled).base_colors
    assert base is not None
    capsys.readouterr()
    shown = result(capsys, "adjust", styled, "--intensity", 1)
    assert shown["intensity"] == {"3": 1.0, "7": 1.0}
    full = read_scene(styled).splats
    assert torch.allclose(full.sh0 - base["sh0"], 2 * (half.sh0 - base["sh0"]), atol=1e-6)
    assert (full.sh0 - half.sh0).abs().max() > 0.01
    assert run("adjust", styled, "--intensity", 0.5) == 0
    assert torch.allclose(read_scene(styled).splats.sh0, half.sh0, atol=1e-6)
    assert run("adjust", styled, "--intensity", 0) == 0
    assert torch.equal(read_scene(styled).splats.sh0, base["sh0"])
    assert run("adjust", styled, "--intensity", 1) == 0
    assert torch.equal(read_scene(styled).splats.sh0, full.sh0)
    assert (styled / "notes.txt").read_text() == "mine"
    assert (styled / "base_colors.safetensors").read_bytes() == files["base_colors.safetensors"]
    undone = styled.with_name("undone")
    assert run("adjust", styled, "--undo", "-o", undone) == 0
    for name in ("splats.ply", "identities.safetensors", "picks.safetensors"):
        assert (undone / name).read_bytes() == (scene / name).read_bytes()
    assert len(before) < len(half)


def test_adjust_one_object_into_a_new_scene(styled: Path, tmp_path: Path, capsys):
    before, out = (styled / "splats.ply").read_bytes(), tmp_path / "loud"
    capsys.readouterr()
    shown = result(capsys, "adjust", styled, "--object", 3, "--intensity", 1.5, "-o", out)
    assert shown["intensity"] == {"3": 1.5, "7": 0.5}
    assert (styled / "splats.ply").read_bytes() == before
    half, loud = read_scene(styled).splats, read_scene(out).splats
    changed = (loud.sh0 != half.sh0).flatten(1).any(dim=1)
    assert changed.any() and not (changed & ~pick(half, object_id=3, remove_outliers=False)).any()
    assert run("adjust", out, "--intensity", 0.5) == 0
    assert torch.allclose(read_scene(out).splats.sh0, half.sh0, atol=1e-6)
    assert run("adjust", out, "--object", 300, "--intensity", 1) == 1
    assert "Styled objects: 3, 7" in capsys.readouterr().err


def test_render_writes_pictures_and_videos(scene: Path, tmp_path: Path):
    assert run("render", scene, "-o", tmp_path / "all") == 0
    assert len(list((tmp_path / "all").iterdir())) == len(CAMERAS)
    assert read_image(tmp_path / "all" / "0003.png").shape == (36, 48, 3)
    assert run("render", scene, "-o", tmp_path / "test", "--views", "test", "--downscale", 2) == 0
    assert [p.name for p in (tmp_path / "test").iterdir()] == ["0000.png"]
    assert read_image(tmp_path / "test" / "0000.png").shape == (18, 24, 3)
    assert run("render", scene, "-o", tmp_path / "ids", "--what", "labels") == 0
    assert set(np.unique(read_label_map(tmp_path / "ids" / "0000.png"))) == {0, 3, 7, 300}
    for what in ("identities", "depth", "object:7"):
        assert run("render", scene, "-o", tmp_path / what[:5], "--what", what) == 0
    assert run("render", scene, "-o", tmp_path / "orbit.mp4", "--views", "train") == 0
    with av.open(str(tmp_path / "orbit.mp4")) as video:
        assert sum(1 for _ in video.decode(video=0)) == len(CAMERAS) - 1


def test_evaluate_compares_with_the_capture(capture: Path, scene: Path, capsys):
    metrics = result(capsys, "evaluate", scene, "--capture", capture)
    assert metrics["psnr"] > 30  # all but the losses of JPEG
    assert metrics["iou"] == {"3": 1, "7": 1, "300": 1}
    assert read_scene(scene).metrics == {"psnr": 30.0, "evaluate": metrics}
    other = capture / "object_mask"
    assert result(capsys, "evaluate", scene, "--capture", capture, "--masks", other) == metrics


def test_export_keeps_every_bit(scene: Path, tmp_path: Path):
    assert run("export", scene, tmp_path / "out.ply") == 0
    exported = read_splat_ply(tmp_path / "out.ply")
    assert torch.equal(exported.means, SPLATS.means)
    assert torch.equal(exported.sh0, SPLATS.sh0)
    assert run("export", scene, tmp_path / "out.ply") == 1, "never overwrites by itself"
    assert run("export", scene, tmp_path / "out.ply", "--overwrite") == 0
    assert run("export", scene, tmp_path / "out.splat") == 0


def test_labels_lifted_after_training(capture: Path, tmp_path: Path, capsys):
    out = tmp_path / "scene"
    options = ("--steps", 40, "--segment", "lift", "--device", "cpu")
    result(capsys, "train", capture, "-o", out, *options)
    scene = read_scene(out)
    assert scene.splats.classifier is not None
    assert scene.splats.classifier.ids == (0, 3, 7, 300)
    assert scene.info["settings"]["segment"] == "lift"
    assert not [*out.glob("checkpoint*")]


def test_import_and_select_by_shape(scene: Path, capture: Path, tmp_path: Path, capsys):
    splat, out = tmp_path / "balls.ply", tmp_path / "imported"
    assert run("export", scene, splat) == 0
    metrics = result(capsys, "import", splat, capture, "-o", out, "--device", "cpu")
    assert metrics["psnr"] > 30
    found = result(capsys, "select", out, "--name", "red", "--box3d=-1.1,-0.4,0.02,-0.3,0.4,0.7")
    assert found["gaussians"] >= 79
    less = result(capsys, "select", out, "--name", "rest", "--id", 3, 7, "--minus", "red")
    assert 0 < less["gaussians"] <= 81


def test_masks_of_another_program(tmp_path: Path, capsys):
    photos = write_capture(tmp_path / "capture")
    mask = np.zeros((HEIGHT, WIDTH), np.uint8)
    mask[9:30, 20:40] = 255
    (tmp_path / "masks" / "cup").mkdir(parents=True)
    Image.fromarray(mask).save(tmp_path / "masks" / "cup" / "002.png")
    found = result(capsys, "mask", photos, "--from", tmp_path / "masks")
    assert (found["photos"], found["ids"]) == (1, [1])
    assert read_label_map(photos / "object_mask" / "002.png").sum() == 21 * 20
